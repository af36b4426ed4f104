"""MuJoCo's XML, rewritten so that Drake's reader takes from it what MuJoCo does.

Drake's reader leaves out springs and friction of joints, gears of efforts, flags, masks of
collision and more, or reads them otherwise. Here classes of defaults are resolved, and what Drake
can't be told in the text becomes `ModelFacts`. What can't be planned for is refused by name.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

from drake_aigto.errors import ModelError
from drake_aigto.world.files import read_xml
from drake_aigto.world.model_facts import (
    ModelFacts,
    Spring,
    read_numbers,
    read_range,
    refuse_element,
)

# Drawing, numerics and measuring: nothing that moves depends on them.
_HARMLESS = {
    *("visual", "statistic", "size", "custom", "sensor", "keyframe"),
    *("extension", "site", "camera", "light", "tendon", "texture", "skin"),
}
_MOTORS = ("motor", "general", "position", "velocity")
_OTHER_ACTUATORS = ("intvelocity", "damper", "cylinder", "muscle", "adhesion", "plugin", "dcmotor")
_UNREAD_BODIES = ("composite", "flexcomp", "replicate", "attach", "plugin")
_MESHES = ("mesh", "hfield", "sdf")
_SPRINGS = ("stiffness", "springref")
_COMPILER = ("angle", "eulerseq", "autolimits", "inertiafromgeom")  # What Drake reads of it.
_PLACES = ("pos", "quat", "axisangle", "xyaxes", "zaxis", "euler")
_TENDON_FORCES = ("stiffness", "damping", "frictionloss", "armature")
_TRANSMISSIONS = ("tendon", "site", "body", "cranksite", "slidersite", "refsite")
_DEFAULT_DENSITY = 1000.0  # MuJoCo's [kg/m³].


def read_mjcf(root: Element, path: Path, facts: ModelFacts) -> None:
    """Rewrites a model in place, and adds to its facts.

    Args:
        root: <mujoco>.
        path: of its file, which includes and meshes are relative to.
        facts: what Drake's reader can't be told in the text.

    Raises:
        ModelError: a file is missing, or something changes the physics that is not planned for.
    """
    _include(root, path.parent, (path,))
    _MjcfReader(root, path, facts).read()


def _include(parent: Element, folder: Path, above: tuple[Path, ...]) -> None:
    """Puts what files include in place of <include>, however deep."""
    for i in reversed(range(len(parent))):
        child = parent[i]
        if child.tag != "include":
            _include(child, folder, above)
            continue
        file = folder / child.get("file", "")
        if file in above or not file.is_file():
            raise ModelError(
                f"model {above[0]}",
                got=f"an <include> of {file}, which "
                + ("includes itself" if file in above else "is missing"),
                expected="a file that is there",
                remedy="Paths of <include> are relative to the model's file.",
            )
        included = read_xml(file)
        _include(included, folder, (*above, file))
        parent[i : i + 1] = list(included)


class _MjcfReader:
    """One pass over a model whose includes are in place."""

    def __init__(self, root: Element, path: Path, facts: ModelFacts) -> None:
        self._root, self._path, self._facts = root, path, facts
        root.set("model", root.get("model") or path.stem)
        self._compiler = _merge(root.findall("compiler"))
        self._in_degrees = self._compiler.get("angle", "degree") == "degree"
        self._option = _merge(root.findall("option"))
        flags = _merge(root.findall("option/flag"))
        self._off = {name for name, value in flags.items() if value == "disable"}
        if "constraint" in self._off:
            self._off |= {"contact", "limit", "frictionloss", "equality"}
        if "passive" in self._off:
            self._off |= {"spring", "damper"}
        for number, frame in enumerate(list(root.iter("frame"))):  # A body that is welded.
            frame.tag = "body"
            frame.set("name", frame.get("name") or f"frame{number}")
        self._classes: dict[str, dict[str, dict[str, str]]] = {}
        for default in root.findall("default"):
            self._read_class(default, "main", {})
        self._bodies = list(self._walk())
        self._parents = {child: body for body, _ in self._bodies for child in body.findall("body")}
        self._owners = self._find_owners()
        self._fixed = set[str]()
        folder = path.parent / self._compiler.get("meshdir", self._compiler.get("assetdir", ""))
        self._meshes = {
            _mesh(mesh): folder / mesh.get("file", "") for mesh in root.findall("asset/mesh")
        }
        self._armatures: dict[str, float] = {}
        self._efforts: dict[str, tuple[float, float]] = {}

    def read(self) -> None:
        """Rewrites all of the model."""
        self._read_option()
        self._read_compiler()
        self._read_bodies()
        self._read_geoms()
        self._read_actuators()
        self._read_tendons()
        for joint, armature in self._armatures.items():
            what = f"the armature {armature:g} of joint {joint!r}, which no actuator drives"
            self._facts.refuse("armature", what, "kg m² or kg that are missing from its inertia")
        self._strip()
        self._chain_joints()

    def _read_class(
        self, default: Element, name: str, inherited: dict[str, dict[str, str]]
    ) -> None:
        """Resolves a class of defaults, and those inside of it."""
        known = self._classes.get(name, inherited)
        mine = {tag: dict(values) for tag, values in known.items()}
        for child in default:
            if child.tag != "default":
                tag = "actuator" if child.tag in _MOTORS else child.tag
                mine.setdefault(tag, {}).update(child.attrib)
        self._classes[name] = mine
        for child in default.findall("default"):
            self._read_class(child, child.get("class", "main"), mine)

    def _walk(self) -> Iterator[tuple[Element, str]]:
        """Yields bodies, and the class of what is in them."""
        pending = [(body, "main") for body in self._root.findall("worldbody")]
        for body, outer in pending:  # It grows meanwhile.
            childclass = body.get("childclass", outer)
            yield body, childclass
            pending += [(child, childclass) for child in body.findall("body")]

    def _resolve(self, element: Element, childclass: str) -> dict[str, str]:
        """Returns an element's attributes with those of its class."""
        tag = "actuator" if element.tag in _MOTORS else element.tag
        name = element.get("class", childclass)
        if name not in self._classes and name != "main":
            raise refuse_element(self._path, element, f"the unknown class {name!r} of defaults")
        return {**self._classes.get(name, {}).get(tag, {}), **element.attrib}

    def _read_option(self) -> None:
        """Keeps gravity, and refuses fluids."""
        for name in ("density", "viscosity", "wind"):
            if any(read_numbers(self._path, self._option.get(name, "0"))):
                what = f"the {name} {self._option[name]} of a fluid"
                self._facts.refuse("fluid", what, "its forces on all links")
        if "filterparent" in self._off:
            what = '<flag filterparent="disable"/>'
            self._facts.refuse("filterparent", what, "contacts of links that a joint connects")
        for each in self._root.findall("option"):
            self._root.remove(each)
        gravity = "0 0 0" if "gravity" in self._off else self._option.get("gravity", "0 0 -9.81")
        SubElement(self._root, "option", gravity=gravity)
        for each in [] if "equality" in self._off else self._root.findall("equality/*"):
            if each.get("active", "true") == "true":
                what = f"<equality><{each.tag}>"
                self._facts.refuse("equality", what, "a loop of links, or coupled joints")
        for each in self._root.findall("equality"):
            self._root.remove(each)

    def _read_compiler(self) -> None:
        """Reads the total mass, refuses what changes inertias, and keeps what Drake knows."""
        mass = read_numbers(self._path, self._compiler.get("settotalmass", "-1"))[0]
        self._facts.total_mass = mass if mass > 0 else None
        for name in ("boundmass", "boundinertia", "balanceinertia"):
            if self._compiler.get(name, "0") not in ("0", "false"):
                what = f"{name} of <compiler>"
                self._facts.refuse("inertias", what, "inertias that are changed to be larger")
        for each in self._root.findall("compiler"):
            for key in set(each.attrib) - set(_COMPILER):
                del each.attrib[key]

    def _find_owners(self) -> dict[Element, tuple[Element, Element | None]]:
        """Returns of each body the one that it moves with, and the one that moves that.

        Geoms of these do not touch each other in MuJoCo, unless the second one is the world.
        """
        found: dict[Element, tuple[Element, Element | None]] = {}
        for body, _ in self._bodies:
            parent = self._parents.get(body)
            if parent is None:
                found[body] = self._bodies[0][0], None
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
        for body, childclass in self._bodies:
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
        for body, childclass in self._bodies:
            if float(body.get("gravcomp", 0)):
                what = f"gravcomp of body {body.get('name')!r}"
                self._facts.refuse("gravcomp", what, "gravity that is compensated")
            for child in body:
                if child.tag in _UNREAD_BODIES:
                    self._facts.refuse(child.tag, f"<{child.tag}>", "all links that are made by it")
            for joint in body.findall("joint"):
                joint.set("name", joint.get("name") or _name_after(body, joint))
                if self._facts.fixes(joint.get("name", "")):
                    self._fixed.add(joint.get("name", ""))
                    body.remove(joint)
                else:
                    self._read_joint(joint.get("name", ""), joint, self._resolve(joint, childclass))

    def _read_joint(self, name: str, joint: Element, values: dict[str, str]) -> None:
        """Reads one joint."""
        number = {
            key: read_numbers(self._path, values[key])[0]
            for key in ("frictionloss", "stiffness", "springref", "armature")
            if key in values
        }
        is_hinge = values.get("type", "hinge") == "hinge"
        if friction := number.get("frictionloss", 0.0) * ("frictionloss" not in self._off):
            self._facts.friction[name] = friction
        if stiffness := number.get("stiffness", 0.0) * ("spring" not in self._off):
            reference = number.get("springref", 0.0)
            reference = math.radians(reference) if is_hinge and self._in_degrees else reference
            self._facts.springs[name] = Spring(stiffness, reference)
        if values.get("springdamper", "0 0") != "0 0":
            self._facts.refuse("springdamper", f"springdamper of joint {name!r}", "its forces")
        if "damper" in self._off:
            joint.set("damping", "0")
        is_limited = "limit" not in self._off and self._is_limited(values, "")
        joint.set("limited", "true" if is_limited else "false")
        if is_limited:
            read_range(self._path, values["range"], f"the range of joint {name!r}")
        joint.attrib.pop("actuatorfrcrange", None)
        for key in ("damping", "stiffness"):
            if len(terms := values.get(key, "0").split()) > 1:
                joint.set(key, terms[0])
                what = f"{key} {values[key]} of joint {name!r}"
                self._facts.refuse("polynomials", what, "its terms of higher degree")
        if number.get("armature", 0.0) > 0:
            self._armatures[name] = number["armature"]
        limited = values.get("actuatorfrclimited", "auto")
        if "actuatorfrcrange" in values and limited != "false":
            what = f"actuatorfrcrange of joint {name!r}"
            self._efforts[name] = read_range(self._path, values["actuatorfrcrange"], what)

    def _read_geoms(self) -> None:
        """Reads which geoms may touch, as their masks say it."""
        kept = []
        for body, childclass in self._bodies:
            for geom in body.findall("geom"):
                values = self._resolve(geom, childclass)
                geom.set("name", geom.get("name") or _name_after(body, geom))
                masks = [int(values.get(mask, "1")) for mask in ("contype", "conaffinity")]
                named = self._facts.keeps(f"{self._root.get('model')}::{geom.get('name')}")
                if "contact" in self._off or not named:
                    masks = [0, 0]
                if values.get("type") in _MESHES and not self._keeps_mesh(body, geom, any(masks)):
                    continue
                kept.append((geom, masks, self._owners[body]))
                self._set_mass(geom, values)
                geom.set("friction", values.get("friction", "1").split()[0])
        pairs = {
            frozenset((pair.get("geom1"), pair.get("geom2")))
            for pair in self._root.findall("contact/pair")
        }
        for one, other in itertools.combinations(kept, 2):
            meets = one[1][0] & other[1][1] or other[1][0] & one[1][1]
            (owner, above), (other_owner, other_above) = one[2], other[2]
            meets = meets and owner not in (other_owner, other_above) and other_owner is not above
            names = one[0].get("name", ""), other[0].get("name", "")
            if not meets and frozenset(names) not in pairs:
                self._facts.apart.append(names)
        touching = {name for pair in pairs for name in pair if "contact" not in self._off}
        for geom, masks, _ in kept:
            touches = any(masks) or geom.get("name") in touching
            for mask in ("contype", "conaffinity"):
                geom.set(mask, "1" if touches else "0")
        if touching:
            self._facts.notes.append("<contact><pair>: its friction and softness are not read")

    def _keeps_mesh(self, body: Element, geom: Element, touches: bool) -> bool:
        """Returns whether a mesh stays; one that can't be read may, if no mass depends on it."""
        values = self._resolve(geom, "main")
        of_class = (each.get("mesh") for each in (geom, values))
        mesh = next((self._meshes[name] for name in of_class if name in self._meshes), None)
        is_read = mesh is not None and mesh.suffix.lower() == ".obj" and mesh.is_file()
        weighs = body.find("inertial") is None or self._compiler.get("inertiafromgeom") == "true"
        is_massless = "0" in (values.get("mass"), values.get("density")) or body.tag == "worldbody"
        is_needed = touches or (weighs and not is_massless)
        if is_read and (is_needed or self._facts.stub is None):
            return True
        self._facts.is_bare |= is_read
        if is_needed:
            kind = mesh.name if mesh else values.get("type")
            self._facts.unread.append(f"{geom.get('name')} ({kind})")
        body.remove(geom)
        return False

    def _set_mass(self, geom: Element, values: dict[str, str]) -> None:
        """Scales what a geom weighs, where the model has a total mass."""
        if values.get("shellinertia") == "true":
            what = f"shellinertia of geom {geom.get('name')!r}"
            self._facts.refuse("inertias", what, "mass at the surface; it is spread evenly instead")
        least, most = read_numbers(self._path, self._compiler.get("inertiagrouprange", "0 5"), 2)
        if not least <= int(values.get("group", "0")) <= most:
            geom.set("mass", "0")
        scale = self._facts.mass_scale
        if scale == 1.0:
            return
        key = "mass" if "mass" in values else "density"
        given = read_numbers(self._path, values.get(key, str(_DEFAULT_DENSITY)))[0]
        geom.set(key, repr(scale * given))

    def _read_actuators(self) -> None:
        """Turns all that drives one joint into motors whose control is the joint's effort."""
        joints = [joint for body, _ in self._bodies for joint in body.findall("joint")]
        names = {joint.get("name") for joint in joints}
        driven = dict[str, str]()
        for group in self._root.findall("actuator"):
            for motor in list(group):
                if "actuation" in self._off or not self._read_motor(motor, names, driven):
                    group.remove(motor)

    def _read_motor(self, motor: Element, names: set[str | None], driven: dict[str, str]) -> bool:
        """Rewrites one actuator; returns whether it stays."""
        values = self._resolve(motor, "main")
        joint, factor = self._find_joint(values)
        label = motor.get("name") or f"{joint or 'actuator'}_{motor.tag}"
        what = f"actuator {label!r}"
        if joint is None:
            through = next((each for each in _TRANSMISSIONS if each in values), "nothing")
            of = f"{what}, which acts through a {through}, not one joint"
            return self._facts.refuse("actuators", of, "an actuator that is missing")
        if joint in self._fixed:
            return False
        if joint not in names:
            if self._facts.refused:  # It may be in what is refused.
                return False
            known = ", ".join(sorted(map(str, names)))
            got = f"{what} at the unknown joint {joint!r}"
            raise refuse_element(self._path, motor, got, f"one of {known}")
        if motor.tag in _OTHER_ACTUATORS or values.get("dyntype", "none") != "none":
            of = f"{what}, which has dynamics of its own"
            return self._facts.refuse("actuators", of, "an actuator that is missing")
        if joint in driven:
            got = f"{driven[joint]!r} and {label!r} at joint {joint!r}"
            raise refuse_element(self._path, motor, got, "one actuator for each joint")
        driven[joint] = label
        effort = self._find_effort(motor, what, values, factor)
        lower, upper = self._efforts.get(joint, (-math.inf, math.inf))
        lower, upper = max(lower, effort[0]), min(upper, effort[1])
        self._facts.efforts[label] = lower, upper
        largest = max(-lower, upper)
        motor.attrib.clear()
        motor.tag = "motor"
        motor.attrib |= {"name": label, "joint": joint, "gear": "1"}
        bound = {"ctrllimited": "true", "ctrlrange": f"{-largest!r} {largest!r}"}
        motor.attrib |= bound if math.isfinite(largest) else {"ctrllimited": "false"}
        self._armatures.pop(joint, None)
        return True

    def _find_joint(self, values: dict[str, str]) -> tuple[str | None, float]:
        """Returns the one joint that an actuator acts on, and the lever with which it does."""
        if joint := values.get("joint") or values.get("jointinparent"):
            return joint, 1.0
        for tendon in self._root.findall("tendon/fixed"):
            if tendon.get("name") == values.get("tendon"):
                levers = {
                    each.get("joint"): read_numbers(self._path, each.get("coef", "1"))[0]
                    for each in tendon.findall("joint")
                }
                acting = {joint: lever for joint, lever in levers.items() if lever != 0.0}
                return next(iter(acting.items())) if len(acting) == 1 else (None, 1.0)
        return None, 1.0

    def _find_effort(
        self, motor: Element, what: str, values: dict[str, str], factor: float
    ) -> tuple[float, float]:
        """Returns the least and the largest effort at the joint, gear × gain × ctrlrange."""
        gear = factor * read_numbers(self._path, values.get("gear", "1"))[0]
        if gear == 0.0:
            raise refuse_element(self._path, motor, f"{what} with a gear of 0", "another gear")
        ends = [(-math.inf, math.inf)]
        is_servo = motor.tag in ("position", "velocity") or (
            motor.tag == "general"
            and (values.get("biastype", "none"), values.get("gaintype", "fixed"))
            != ("none", "fixed")
        )
        if is_servo:
            text = f"{what}, a servo; a plan's control is the force itself"
            self._facts.refuse("servos", text, "the servo's law and the range of its set point")
        elif self._is_limited(values, "ctrl") and "clampctrl" not in self._off:
            gain = read_numbers(self._path, values.get("gainprm", "1"))[0]
            gain = gain if motor.tag == "general" else 1.0
            low, high = read_range(self._path, values["ctrlrange"], f"ctrlrange of {what}")
            ends.append((gain * low, gain * high))
        if self._is_limited(values, "force"):
            ends.append(read_range(self._path, values["forcerange"], f"forcerange of {what}"))
        lower, upper = max(min(end) for end in ends), min(max(end) for end in ends)
        return (gear * lower, gear * upper) if gear > 0 else (gear * upper, gear * lower)

    def _is_limited(self, values: dict[str, str], of: str) -> bool:
        """Returns whether a range counts: that of an actuator, or without a word a joint's."""
        limited, has_range = values.get(f"{of}limited", "auto"), f"{of}range" in values
        if limited == "auto":
            return has_range and self._compiler.get("autolimits", "true") == "true"
        return limited == "true" and has_range

    def _read_tendons(self) -> None:
        """Refuses tendons that pull."""
        for tendon in self._root.findall("tendon/*"):
            values = self._resolve(tendon, "main")
            name = f"tendon {tendon.get('name')!r}"
            limited = values.get("limited", "auto")
            is_limited = limited == "true" or (limited == "auto" and "range" in values)
            pulls = [each for each in _TENDON_FORCES if float(values.get(each, 0)) != 0.0]
            if is_limited and "limit" not in self._off:
                pulls.append("range")
            if pulls:
                self._facts.refuse("tendons", f"{name} with {', '.join(pulls)}", "its forces")

    def _strip(self) -> None:
        """Removes what is harmless, so that Drake does not warn of it, and scales inertias."""
        used = {g.get("mesh") for body, _ in self._bodies for g in body.findall("geom")}
        for parent in list(self._root.iter()):
            for child in list(parent):
                unused = child.tag == "mesh" and parent.tag == "asset" and _mesh(child) not in used
                in_class = parent.tag == "default" and child.tag in (*_MOTORS, *_OTHER_ACTUATORS)
                if child.tag in _HARMLESS or unused or in_class or child.tag == "pair":
                    parent.remove(child)
            for key in ("user", "condim", "texture", "shellinertia", *_SPRINGS, "frictionloss"):
                parent.attrib.pop(key, None)
            if parent.tag == "inertial":
                for key in ("mass", "diaginertia", "fullinertia"):
                    if key in parent.attrib:
                        numbers = read_numbers(self._path, parent.attrib[key], None)
                        scaled = (repr(self._facts.mass_scale * number) for number in numbers)
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


def _merge(elements: list[Element]) -> dict[str, str]:
    """Returns the attributes of several sections, of which later ones count."""
    return {key: value for element in elements for key, value in element.attrib.items()}
