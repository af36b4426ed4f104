"""A model's file as text for Drake, with the scenario's fields applied."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np
import yaml
from pydrake.multibody.parsing import PackageMap

from drake_aigto.errors import ModelError
from drake_aigto.world.files import check_installed, find_file, package_of, read_xml
from drake_aigto.world.meshes import explain, find_mesh, is_readable, read_mesh, set_mesh
from drake_aigto.world.mjcf import read_mjcf
from drake_aigto.world.model_facts import ModelFacts, read_numbers, read_range
from drake_aigto.world.model_fields import ModelFields
from drake_aigto.world.pair_errors import MARK
from drake_aigto.world.space_parts import MOST_CORNERS, RIM

_ROUNDING = 1e-12  # Of the largest moment of inertia.
# What of an SDF's link changes its motion: the element, values that do not, and what is missing.
_LEFT_OUT = (
    ("gravity", ("true", "1"), "it has its weight"),
    ("kinematic", ("false", "0"), "forces move it"),
    ("enable_wind", ("false", "0"), "the forces of wind"),
    ("velocity_decay", (), "the forces of damping"),
    ("fluid_added_mass", (), "inertia that is missing"),
)
# With this many shapes, Drake's tree of them bears a half space on a link, whose box is infinite.
_MOST_SHAPES = 12
_ENDS, _CORNERS = {"capsule": 2}, {"box": 8, "cylinder": 2 * RIM, "mesh": MOST_CORNERS}
_MARK_RADIUS = "1e-9"
# What files of Drake's model directives are called, and what those that are read.
_XML, DIRECTIVES = (".xml", ".urdf", ".sdf"), ".dmd.yaml"
MODELS = (*_XML, DIRECTIVES)
_KINDS = {"mujoco": "xml", "robot": "urdf", "sdf": "sdf"}


def read_model_text(
    path: Path,
    fields: ModelFields,
    packages: PackageMap,
    folder: Path,
    mass_scale: float = 1.0,
    stub: Path | None = None,
    in_space: bool = False,
) -> tuple[str | None, str, ModelFacts]:
    """Returns the text that Drake's parser should read, its kind, and the facts beside it.

    The text is None where the file is to be read as it is: no XML, or with relative paths in it. A
    stub takes the place of meshes that are not read else (`ModelFacts`); in space, boxes and meshes
    get shapes at their corners (`add_ends`). Masses of an MJCF are scaled. Files that model
    directives add are read in the same way, and written to a folder, from where Drake has them.
    """
    facts = ModelFacts(fields, mass_scale, stub)
    text, kind = _read_text(path, packages, folder, facts, in_space)
    facts.check(path)
    return text, kind, facts


def _read_text(
    path: Path, packages: PackageMap, folder: Path, facts: ModelFacts, in_space: bool
) -> tuple[str | None, str]:
    """Returns the text of a file and its kind (`read_model_text`), and adds to the facts."""
    if path.name.endswith(DIRECTIVES):
        return _read_directives(path, packages, folder, facts, in_space), DIRECTIVES[1:]
    try:
        root = read_xml(path)
    except ModelError:
        if path.suffix not in _XML:
            return None, ""
        raise
    kind = _KINDS.get(root.tag, "")
    if leftover := next((each.tag for each in root.iter() if each.tag.startswith("xacro:")), None):
        raise ModelError(
            f"model {path}",
            got=f"<{leftover}>: an xacro, not a URDF",
            remedy=f"Expand it: xacro {path.name} > {path.name.partition('.')[0]}.urdf.",
        )
    is_changed = kind == "xml"
    if kind == "xml":
        read_mjcf(root, path, facts)
    elif kind:
        if kind == "urdf":
            root.set("name", root.get("name") or path.stem)
            _tell_materials_apart(root)
            is_changed = _name_shapes(root)
        is_changed |= _read_joints(root, path, facts)
        _read_includes(root, path, packages, facts)
        _refuse_forces(root, path, facts)
        is_changed |= _prune_shapes(root, path, packages, facts)
        is_changed |= _mark_planes(root, path, facts, in_space)
    else:
        return None, kind
    is_changed |= _check_masses(root, path, facts)
    # Drake takes 30 ms to read an SDF's file, and 1 ms to read its text.
    is_changed |= kind == "sdf" and all("://" in (uri.text or "") for uri in root.iter("uri"))
    return tostring(root, encoding="unicode") if is_changed else None, kind


def _read_directives(
    path: Path, packages: PackageMap, folder: Path, facts: ModelFacts, in_space: bool
) -> str:
    """Returns model directives that add the files' texts in a folder in place of the files."""
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        got = " ".join(str(error).split())
        raise ModelError(f"model {path}", got, "model directives in YAML") from error
    listed = found.get("directives") if isinstance(found, dict) else None
    if not isinstance(listed, list) or not all(isinstance(each, dict) for each in listed):
        raise ModelError(f"model {path}", "no list of directives", "model directives")
    kinds = ("add_model", "add_directives")
    added: list[Any] = [each[kind] for each in listed for kind in kinds if kind in each]
    if unlike := [each for each in added if not isinstance(each, dict)]:
        expected = "model directives that add {name: …, file: …}"
        raise ModelError(f"model {path}", f"a directive that adds {unlike[0]!r}", expected)
    facts.is_scene = True
    for each in added:
        file = _find_part(str(each.get("file")), path, packages, "a directive that adds")
        text, kind = _read_text(file, packages, folder, facts, in_space)
        if text is not None:
            file = folder / f"{len(list(folder.iterdir()))}_{file.stem}.{kind}"
            file.write_text(text, encoding="utf-8")
        each["file"] = file.resolve().as_uri()
    return yaml.safe_dump(found, sort_keys=False)


def _read_joints(root: Element, path: Path, facts: ModelFacts) -> bool:
    """Reads friction and efforts of a URDF's or an SDF's joints, and fixes some."""
    is_changed = root.tag == "robot"  # Which may have got a name, and colors.
    for parent in list(root.iter()):
        for joint in [*parent.findall("joint"), *parent.findall("drake:joint")]:
            name = joint.get("name", "")
            if joint.find("axis") is None and joint.find("parent") is None:
                continue  # That of a transmission.
            if facts.fixes(name):
                _fix(root, joint, name)
                is_changed = True
                continue
            for axis in (joint, *joint.findall("axis")):
                for mimic in axis.findall("mimic"):
                    if joint.get("type") != "fixed":
                        cost = "a joint that follows another one"
                        facts.refuse("mimic", f"<mimic> of joint {name!r}", cost)
                    axis.remove(mimic)
                    is_changed = True
            is_changed |= _read_numbers(path, joint, name, facts)
    return is_changed


def _read_numbers(path: Path, joint: Element, name: str, facts: ModelFacts) -> bool:
    """Reads friction and limits of a joint; returns whether a limit is removed."""
    if friction := _find_number(path, joint, "friction", "dynamics"):
        facts.friction[name] = friction
    ends = (_find_number(path, joint, end) for end in ("lower", "upper"))
    lower, upper = ("" if end is None else repr(end) for end in ends)
    if lower and upper:
        read_range(path, f"{lower} {upper}", f"the range of joint {name!r}")
    effort = _find_number(path, joint, "effort")
    if effort == 0.0:
        facts.no_effort.add(name)
    elif effort is not None and effort > 0.0:
        facts.joint_efforts[name] = effort
    if _find_number(path, joint, "velocity") != 0.0:
        return False
    for limit in [*joint.findall("limit"), *joint.findall("axis/limit")]:
        limit.attrib.pop("velocity", None)
        for each in limit.findall("velocity"):
            limit.remove(each)
    facts.notes.append(f"the velocity limit 0 of joint {name!r} counts as none")
    return True


def _find_number(path: Path, joint: Element, name: str, folder: str = "limit") -> float | None:
    """Returns a number of a joint, as URDF or as SDF has it."""
    text = next((each.get(name) for each in joint.findall(folder)), None)
    text = text or joint.findtext(f"axis/{folder}/{name}")
    return None if text is None else read_numbers(path, text)[0]


def _read_includes(root: Element, path: Path, packages: PackageMap, facts: ModelFacts) -> None:
    """Reads friction and efforts in files that an SDF includes, which are not rewritten."""
    for text in (each.findtext("uri", "") for each in root.iter("include")):
        file = _find_part(text, path, packages, "an <include> of")
        if file.is_dir():
            file /= "model.sdf"
        if not file.is_file() or file == path:
            continue  # Drake's parser says it.
        included = read_xml(file)
        joints = [each.get("name", "") for each in included.iter("joint")]
        if fixed := [name for name in joints if facts.fixes(name)]:
            raise ModelError(
                f"fixed_joints in {path}",
                got=f"{', '.join(fixed)} in the included {file}",
                expected="joints of the model's own file",
            )
        _read_joints(included, file, facts)
        _read_includes(included, file, packages, facts)
        _refuse_forces(included, file, facts)


def _find_part(uri: str, path: Path, packages: PackageMap, what: str) -> Path:
    """Returns a file that a model consists of."""
    file = find_file(uri, path, packages)
    if file is None:
        check_installed(str(path), package_of(uri))
    if file is None or not file.exists():
        raise ModelError(
            f"model {path}",
            got=f"{what} {uri}, which is missing",
            expected="a file that is there",
            remedy="Paths are relative to the model's file."
            if file
            else f"Say where it is by the scenario's packages: {{{package_of(uri)}: ...}}.",
        )
    return file


def _refuse_forces(root: Element, path: Path, facts: ModelFacts) -> None:
    """Refuses what an SDF says of gravity, air and water, which Drake's reader leaves out."""
    for text in (each.text or "" for each in root.findall("world/gravity")):
        if not np.allclose(read_numbers(path, text, 3, "gravity"), [0.0, 0.0, -9.81], atol=0.02):
            cost = "9.81 m/s² downwards counts"
            facts.refuse("gravity", f"the gravity {text} of a world", cost)
    for link in root.iter("link"):
        for tag, plain, cost in _LEFT_OUT:
            for each in link.iter(tag):
                if (each.text or "").strip().lower() not in plain:
                    facts.refuse(tag, f"<{tag}> of link {link.get('name')!r}", cost)


def _fix(root: Element, joint: Element, name: str) -> None:
    """Turns a joint into a weld at zero, without what drives it."""
    joint.tag = "joint"
    joint.set("type", "fixed")
    for tag in ("axis", "axis2", "limit", "dynamics", "mimic", "calibration", "safety_controller"):
        for each in joint.findall(tag):
            joint.remove(each)
    for each in root.findall("transmission"):
        if any(driven.get("name") == name for driven in each.findall("joint")):
            root.remove(each)


def _prune_shapes(root: Element, path: Path, packages: PackageMap, facts: ModelFacts) -> bool:
    """Removes shapes that touch nothing, and pictures that can't be read; returns if any changed.

    Meshes that Drake doesn't read have copies.
    """
    is_changed, is_bare = False, facts.stub is not None
    tags = "collision", "visual"
    pairs = [(link, shape) for link in root.iter("link") for t in tags for shape in link.findall(t)]
    for link, shape in pairs:
        of_link = link.get("name", "")
        name = shape.get("name", of_link)
        mesh, is_drawn = find_mesh(shape, path, packages), shape.tag == "visual"
        is_kept = is_drawn or facts.keeps(name, of_link, f"{of_link}::{name}")
        if is_kept and mesh is not None:
            file = mesh if is_bare and is_readable(mesh) else read_mesh(mesh)
            if file is not None:
                set_mesh(shape, facts.stub or file)
                facts.is_bare |= is_bare
                is_changed |= is_bare or file != mesh
            elif is_drawn:
                facts.undrawn.append(mesh)
            else:
                facts.unread.append(f"{name} ({explain(mesh)})")
            is_kept = not (is_drawn and (is_bare or file is None))
        if not is_kept:
            link.remove(shape)
            is_changed = True
    return is_changed


def _mark_planes(root: Element, path: Path, facts: ModelFacts, in_space: bool) -> bool:
    """Puts marks, tiny spheres, where planes are among many shapes (`set_planes`)."""
    ends = _ENDS | (_CORNERS if in_space else {})
    shapes = [shape for link in root.iter("link") for shape in link.findall("collision")]
    planes = [shape for shape in shapes if shape.find("geometry/plane") is not None]
    kinds = [(each.find(f"geometry/{kind}"), n) for each in shapes for kind, n in ends.items()]
    count = len(shapes) + sum(n for found, n in kinds if found is not None)
    uris = (include.findtext("uri", "") for include in root.iter("include"))
    is_small = count <= _MOST_SHAPES and not facts.is_scene
    if is_small or any("://" not in uri for uri in uris):
        return False
    marked = [shape for shape in planes if shape.get("name")]
    for shape in marked:
        normal = shape.findtext("geometry/plane/normal", "0 0 1")
        name = shape.get("name")
        what = f"the normal of plane {name!r}"
        if not any(numbers := read_numbers(path, normal, 3, what)):
            raise ModelError(f"{what} in {path}", got=repr(normal), expected="a direction")
        shape.set("name", f"{name}{MARK}{len(facts.planes)}")
        facts.planes.append(numbers)
        for geometry in shape.findall("geometry"):
            geometry.clear()
            SubElement(SubElement(geometry, "sphere"), "radius").text = _MARK_RADIUS
    return bool(marked)


def _tell_materials_apart(root: Element) -> None:
    """Gives each picture a material of its own: Drake takes no two of one name, nor one without."""
    known = {each.get("name"): each.find("color") for each in root.iter("material")}
    for each in root.findall("material"):
        root.remove(each)
    for number, visual in enumerate(root.iter("visual")):
        for each in visual.findall("material"):
            color = (
                each.find("color") if each.find("color") is not None else known[each.get("name")]
            )
            visual.remove(each)
            if color is not None:
                SubElement(visual, "material", name=f"material{number}").append(color)


def _name_shapes(root: Element) -> bool:
    """Names collision shapes without a name after their links, which Drake calls by their kinds."""
    is_changed = False
    for link in root.iter("link"):
        unnamed = [shape for shape in link.findall("collision") if not shape.get("name")]
        for number, shape in enumerate(unnamed):
            shape.set("name", link.get("name", "") + (number > 0) * f"_{number + 1}")
            is_changed = True
    return is_changed


def _check_masses(root: Element, path: Path, facts: ModelFacts) -> bool:
    """Refuses masses and inertias that no link has; returns whether an inertia is left out."""
    is_changed = False
    for link in root.iter():
        for inertial in [*link.findall("inertial"), *link.findall("geom")]:
            mass = inertial.find("mass")
            text = inertial.get("mass", "0") if mass is None else mass.get("value") or mass.text
            number = read_numbers(path, text or "", what=f"mass of {link.get('name')!r}")[0]
            if number < 0:
                raise ModelError(
                    f"mass of {link.get('name')!r} in {path}", got=text, expected="0 or more"
                )
            name = link.get("name", "")
            for inertia in inertial.findall("inertia") if name != "world" else ():
                is_changed |= _check_inertia(path, name, inertia, number == 0, facts)
    return is_changed


def _check_inertia(
    path: Path, link: str, inertia: Element, is_massless: bool, facts: ModelFacts
) -> bool:
    """Refuses an inertia that Drake would replace; returns whether it is left out."""
    what, numbers = f"inertia of link {link!r}", dict[str, float]()
    for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"):
        text = inertia.get(key) or inertia.findtext(key) or "0"
        numbers[key] = read_numbers(path, text, what=what)[0]
    matrix = [[numbers["i" + "".join(sorted(a + b))] for b in "xyz"] for a in "xyz"]
    moments = np.linalg.eigvalsh(matrix)
    if is_massless and moments.any():
        facts.refuse("inertias", f"{what} without a mass", "its inertia, which is left out")
        for key in numbers:
            if (element := inertia.find(key)) is None:
                inertia.set(key, "0")
            else:
                element.text = "0"
        return True
    if moments[0] < 0 or moments[2] > (1 + _ROUNDING) * (moments[0] + moments[1]):
        text = f"{what} with moments of {', '.join(f'{m:.3g}' for m in moments)} kg m²"
        cost = "no body has such; a ball of its mass, of water, takes its place"
        facts.refuse("inertias", text, cost)
    return False
