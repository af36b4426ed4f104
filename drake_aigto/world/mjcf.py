"""MuJoCo's XML, rewritten so that Drake's reader takes from it what MuJoCo does.

Drake's reader leaves out springs and friction of joints, gears of efforts, flags, masks of
collision and more, or reads them otherwise. Here classes of defaults are resolved, and what Drake
can't read in the text becomes `ModelFacts`. What can't be planned for is refused by name.
"""

from __future__ import annotations

import itertools
import math
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from drake_aigto.world.meshes import explain, is_readable, read_mesh
from drake_aigto.world.mjcf_file import (
    MOTORS,
    OTHER_ACTUATORS,
    MjcfFile,
    Range,
    read_actuators,
    read_tendons,
)
from drake_aigto.world.model_facts import ModelFacts, Spring, read_numbers, read_range

# Drawing, numerics and measuring: nothing that moves depends on them.
_HARMLESS = {
    *("visual", "statistic", "size", "custom", "sensor", "keyframe"),
    *("extension", "site", "camera", "light", "tendon", "texture", "skin"),
}
_UNREAD_BODIES = ("composite", "flexcomp", "replicate", "attach", "plugin")
_MESHES = ("mesh", "hfield", "sdf")
_READ = (".obj",)  # of meshes in MJCFs, by Drake
_SPRINGS = ("stiffness", "springref")
_COMPILER = ("angle", "eulerseq", "autolimits", "inertiafromgeom")  # What Drake reads of it.
_PLACES = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler")
_DEFAULT_DENSITY = 1000.0  # MuJoCo's [kg/m³].


def read_mjcf(root: Element, path: Path, facts: ModelFacts) -> None:
    """Rewrites a model, <mujoco> of the file at a path, in place, and adds to its facts.

    Raises:
        ModelError: a file is missing, or something changes the physics that is not planned for.
    """
    _MjcfReader(root, path, facts).read()


class _MjcfReader(MjcfFile):
    """One pass over a model whose includes are in place."""

    def __init__(self, root: Element, path: Path, facts: ModelFacts) -> None:
        super().__init__(root, path, facts)
        self._parents = {child: body for body, _ in self.bodies for child in body.findall("body")}
        self._owners = self._find_owners()
        self._fixed = set[str]()
        folder = path.parent / self.compiler.get("meshdir", self.compiler.get("assetdir", ""))
        self._meshes = {
            _mesh(mesh): folder / mesh.get("file", "") for mesh in root.findall("asset/mesh")
        }
        self._armatures: dict[str, float] = {}
        self._efforts: dict[str, Range] = {}

    def read(self) -> None:
        """Rewrites all of the model."""
        self._read_option()
        self._read_compiler()
        self._read_bodies()
        self._read_geoms()
        driven = read_actuators(self, self._fixed, self._efforts)
        read_tendons(self)
        idle = {name: each for name, each in self._armatures.items() if name not in driven}
        for joint, armature in idle.items():
            what = f"the armature {armature:g} of joint {joint!r}, which no actuator drives"
            self.facts.refuse("armature", what, "kg m² or kg that are missing from its inertia")
        self._strip()
        self._chain_joints()

    def _read_option(self) -> None:
        """Keeps gravity, and refuses fluids."""
        for name in ("density", "viscosity", "wind"):
            if any(read_numbers(self.path, self.option.get(name, "0"))):
                what = f"the {name} {self.option[name]} of a fluid"
                self.facts.refuse("fluid", what, "its forces on all links")
        if "filterparent" in self.off:
            what = '<flag filterparent="disable"/>'
            self.facts.refuse("filterparent", what, "contacts of links that a joint connects")
        for each in self.root.findall("option"):
            self.root.remove(each)
        gravity = self.option.get("gravity", "0 0 -9.81")
        gravity = "0 0 0" if "gravity" in self.off else gravity
        SubElement(self.root, "option", gravity=gravity)
        for each in [] if "equality" in self.off else self.root.findall("equality/*"):
            if each.get("active", "true") == "true":
                what = f"<equality><{each.tag}>"
                self.facts.refuse("equality", what, "a loop of links, or coupled joints")
        for each in self.root.findall("equality"):
            self.root.remove(each)

    def _read_compiler(self) -> None:
        """Reads the total mass, refuses what changes inertias, and keeps what Drake knows."""
        mass = read_numbers(self.path, self.compiler.get("settotalmass", "-1"))[0]
        self.facts.total_mass = mass if mass > 0 else None
        for name in ("boundmass", "boundinertia", "balanceinertia"):
            if self.compiler.get(name, "0") not in ("0", "false"):
                what = f"{name} of <compiler>"
                self.facts.refuse("inertias", what, "inertias that are changed to be larger")
        for each in self.root.findall("compiler"):
            for key in set(each.attrib) - set(_COMPILER):
                del each.attrib[key]

    def _find_owners(self) -> dict[Element, tuple[Element, Element | None]]:
        """Returns of each body the one that it moves with, and the one that moves that.

        Geoms of these do not touch each other in MuJoCo, unless the second one is the world.
        """
        found: dict[Element, tuple[Element, Element | None]] = {}
        for body, _ in self.bodies:
            parent = self._parents.get(body)
            if parent is None:
                found[body] = self.bodies[0][0], None
            elif body.find("joint") is None and body.find("freejoint") is None:
                found[body] = found[parent]
            else:
                above = found[parent][0]
                found[body] = body, None if above.tag == "worldbody" else above
        return found

    def _chain_joints(self) -> None:
        """Gives each joint of a body with several of them a body of its own.

        Drake's reader takes axes and places of such joints to be in other frames than MuJoCo's.
        """
        for body, childclass in self.bodies:
            joints = body.findall("joint")
            for joint in joints[:-1]:
                parent, name = self._parents[body], f"{body.get('name')}_{joint.get('name')}"
                outer = Element("body", name=name, childclass=childclass)
                outer.attrib |= {key: body.attrib.pop(key) for key in _PLACES if key in body.attrib}
                body.remove(joint)
                parent[list(parent).index(body)] = outer
                outer.extend([joint, body])
                self._parents[body] = outer

    def _read_bodies(self) -> None:
        """Reads springs, friction and armature of joints."""
        for body, childclass in self.bodies:
            if float(body.get("gravcomp", 0)):
                what = f"gravcomp of body {body.get('name')!r}"
                self.facts.refuse("gravcomp", what, "gravity that is compensated")
            for child in body:
                if child.tag in _UNREAD_BODIES:
                    self.facts.refuse(child.tag, f"<{child.tag}>", "all links that are made by it")
            for joint in body.findall("joint"):
                joint.set("name", joint.get("name") or _name_after(body, joint))
                if self.facts.fixes(joint.get("name", "")):
                    self._fixed.add(joint.get("name", ""))
                    body.remove(joint)
                else:
                    self._read_joint(joint.get("name", ""), joint, self.resolve(joint, childclass))

    def _read_joint(self, name: str, joint: Element, values: dict[str, str]) -> None:
        """Reads one joint."""
        number = {
            key: read_numbers(self.path, values[key])[0]
            for key in ("frictionloss", "stiffness", "springref", "armature")
            if key in values
        }
        is_hinge = values.get("type", "hinge") == "hinge"
        if friction := number.get("frictionloss", 0.0) * ("frictionloss" not in self.off):
            self.facts.friction[name] = friction
        if stiffness := number.get("stiffness", 0.0) * ("spring" not in self.off):
            reference = number.get("springref", 0.0)
            if is_hinge and self.compiler.get("angle", "degree") == "degree":
                reference = math.radians(reference)
            self.facts.springs[name] = Spring(stiffness, reference)
        if values.get("springdamper", "0 0") != "0 0":
            self.facts.refuse("springdamper", f"springdamper of joint {name!r}", "its forces")
        if "damper" in self.off:
            joint.set("damping", "0")
        is_limited = "limit" not in self.off and self.is_limited(values, "")
        joint.set("limited", "true" if is_limited else "false")
        if is_limited:
            read_range(self.path, values["range"], f"the range of joint {name!r}")
        joint.attrib.pop("actuatorfrcrange", None)
        for key in ("damping", "stiffness"):
            if len(terms := values.get(key, "0").split()) > 1:
                joint.set(key, terms[0])
                what = f"{key} {values[key]} of joint {name!r}"
                self.facts.refuse("polynomials", what, "its terms of higher degree")
        if number.get("armature", 0.0) > 0:
            self._armatures[name] = number["armature"]
        limited = values.get("actuatorfrclimited", "auto")
        if "actuatorfrcrange" in values and limited != "false":
            what = f"actuatorfrcrange of joint {name!r}"
            self._efforts[name] = read_range(self.path, values["actuatorfrcrange"], what)

    def _read_geoms(self) -> None:
        """Reads which geoms may touch, as their masks say it."""
        kept = []
        for body, childclass in self.bodies:
            for geom in body.findall("geom"):
                values = self.resolve(geom, childclass)
                geom.set("name", geom.get("name") or _name_after(body, geom))
                masks = [int(values.get(mask, "1")) for mask in ("contype", "conaffinity")]
                named = self.facts.keeps(f"{self.root.get('model')}::{geom.get('name')}")
                if "contact" in self.off or not named:
                    masks = [0, 0]
                if values.get("type") in _MESHES and not self._keeps_mesh(body, geom, any(masks)):
                    continue
                kept.append((geom, masks, self._owners[body]))
                self._set_mass(geom, values)
                if "fromto" in values and values.get("type") in ("box", "ellipsoid"):
                    self._place_along(geom, values)
                geom.set("friction", values.get("friction", "1").split()[0])
        pairs = {
            frozenset((pair.get("geom1"), pair.get("geom2")))
            for pair in self.root.findall("contact/pair")
        }
        for one, other in itertools.combinations(kept, 2):
            meets = one[1][0] & other[1][1] or other[1][0] & one[1][1]
            (owner, above), (other_owner, other_above) = one[2], other[2]
            meets = meets and owner not in (other_owner, other_above) and other_owner is not above
            names = one[0].get("name", ""), other[0].get("name", "")
            if not meets and frozenset(names) not in pairs:
                self.facts.apart.append(names)
        touching = {name for pair in pairs for name in pair if "contact" not in self.off}
        for geom, masks, _ in kept:
            touches = any(masks) or geom.get("name") in touching
            for mask in ("contype", "conaffinity"):
                geom.set(mask, "1" if touches else "0")
        if touching:
            self.facts.notes.append("<contact><pair>: its friction and softness are not read")

    def _place_along(self, geom: Element, values: dict[str, str]) -> None:
        """Gives a box or an ellipsoid from one point to another a pose, as Drake has none such."""
        ends = np.array(read_numbers(self.path, values["fromto"], 6, "fromto")).reshape(2, 3)
        width = read_numbers(self.path, values.get("size", ""), 1, "size")[0]
        x, y, z = ends[0] - ends[1]
        length = math.hypot(x, y, z)
        turn = (length + z, -y, x, 0.0) if length + z > 0 else (0.0, 1.0, 0.0, 0.0)
        size = width, width, length / 2
        for key, numbers in (("pos", ends.mean(axis=0)), ("quat", turn), ("size", size)):
            geom.set(key, " ".join(repr(float(each)) for each in numbers))
        geom.attrib.pop("fromto", None)

    def _keeps_mesh(self, body: Element, geom: Element, touches: bool) -> bool:
        """Returns whether a mesh stays; one that can't be read may, if no mass depends on it."""
        values = self.resolve(geom, "main")
        of_class = (each.get("mesh") for each in (geom, values))
        name = next((name for name in of_class if name in self._meshes), "")
        mesh = self._meshes.get(name)
        weighs = body.find("inertial") is None or self.compiler.get("inertiafromgeom") == "true"
        is_massless = "0" in (values.get("mass"), values.get("density")) or body.tag == "worldbody"
        weighs = weighs and not is_massless
        is_needed = touches or weighs
        is_read = mesh is not None and is_readable(mesh, _READ)
        if mesh is not None and (is_needed or self.facts.stub is None):
            if (file := read_mesh(mesh, _READ)) is not None:
                self._meshes[name] = file
                return True
            is_read = False
        self.facts.is_bare |= is_read
        if is_needed:
            why = explain(mesh) if mesh else values.get("type")
            unread = self.facts.unweighed if weighs else self.facts.unread
            unread.append(f"{geom.get('name')} ({why})")
        elif mesh is not None and not is_read:
            self.facts.undrawn.append(mesh)
        body.remove(geom)
        return False

    def _set_mass(self, geom: Element, values: dict[str, str]) -> None:
        """Scales what a geom weighs, where the model has a total mass."""
        if values.get("shellinertia") == "true":
            what = f"shellinertia of geom {geom.get('name')!r}"
            self.facts.refuse("inertias", what, "mass at the surface; it is spread evenly instead")
        least, most = read_numbers(self.path, self.compiler.get("inertiagrouprange", "0 5"), 2)
        if not least <= int(values.get("group", "0")) <= most:
            geom.set("mass", "0")
        scale = self.facts.mass_scale
        if scale == 1.0:
            return
        key = "mass" if "mass" in values else "density"
        given = read_numbers(self.path, values.get(key, str(_DEFAULT_DENSITY)))[0]
        geom.set(key, repr(scale * given))

    def _strip(self) -> None:
        """Removes what is harmless, so that Drake does not warn of it, and scales inertias."""
        used = {g.get("mesh") for body, _ in self.bodies for g in body.findall("geom")}
        for parent in list(self.root.iter()):
            for child in list(parent):
                unused = child.tag == "mesh" and parent.tag == "asset" and _mesh(child) not in used
                in_class = parent.tag == "default" and child.tag in (*MOTORS, *OTHER_ACTUATORS)
                if child.tag in _HARMLESS or unused or in_class or child.tag == "pair":
                    parent.remove(child)
            for key in ("user", "condim", "texture", "shellinertia", *_SPRINGS, "frictionloss"):
                parent.attrib.pop(key, None)
            if parent.tag == "inertial":
                for key in ("mass", "diaginertia", "fullinertia"):
                    if key in parent.attrib:
                        numbers = read_numbers(self.path, parent.attrib[key], None)
                        scaled = (repr(self.facts.mass_scale * number) for number in numbers)
                        parent.set(key, " ".join(scaled))
            if parent.tag == "mesh" and "file" in parent.attrib:
                parent.set("file", str(self._meshes[_mesh(parent)].resolve()))


def _mesh(mesh: Element) -> str:
    """Returns a mesh's name, which is its file's where it has none."""
    return mesh.get("name") or Path(mesh.get("file", "")).stem


def _name_after(body: Element, element: Element) -> str:
    """Returns a name for an element without one."""
    number = body.findall(element.tag).index(element)
    return f"{body.get('name', 'world')}_{element.tag}{number}"
