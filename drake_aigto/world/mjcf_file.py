"""An MJCF whose includes and classes of defaults are resolved, and its actuators and tendons.

Those are motors whose control is the effort at one joint.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

from drake_aigto.errors import ModelError
from drake_aigto.world.files import read_xml
from drake_aigto.world.model_facts import ModelFacts, read_numbers, read_range, refuse_element
from drake_aigto.world.model_fields import Servo

MOTORS = ("motor", "general", "position", "velocity")


class MjcfFile:
    """An MJCF, and what holds for all of it.

    Attributes:
        root: <mujoco>.
        path: of its file.
        facts: what Drake's reader can't read in the text.
        compiler: attributes of all <compiler>.
        option: of all <option>.
        off: names of flags that are disabled, and of what they imply.
        bodies: every body, the world first, with the class of what is in it.
    """

    def __init__(self, root: Element, path: Path, facts: ModelFacts) -> None:
        """Puts includes in their places."""
        _include(root, path.parent, (path,))
        self.root, self.path, self.facts = root, path, facts
        root.set("model", root.get("model") or path.stem)
        self.compiler = _merge(root.findall("compiler"))
        self.option = _merge(root.findall("option"))
        flags = _merge(root.findall("option/flag"))
        self.off = {name for name, value in flags.items() if value == "disable"}
        if "constraint" in self.off:
            self.off |= {"contact", "limit", "frictionloss", "equality"}
        if "passive" in self.off:
            self.off |= {"spring", "damper"}
        for number, frame in enumerate(list(root.iter("frame"))):  # A body that is welded.
            frame.tag = "body"
            frame.set("name", frame.get("name") or f"frame{number}")
        named = {body.get("name") for body in root.iter("body")}
        free = (name for i in itertools.count() if (name := f"body{i}") not in named)
        for body in root.iter("body"):  # As parts without a name are named after their body.
            body.set("name", body.get("name") or next(free))
        self._classes: dict[str, dict[str, dict[str, str]]] = {}
        for default in root.findall("default"):
            self._read_class(default, "main", {})
        # Bodies, and the class of what is in them; the list grows while it is walked along.
        self.bodies = [(body, "main") for body in root.findall("worldbody")]
        for i, (body, outer) in enumerate(self.bodies):
            childclass = body.get("childclass", outer)
            self.bodies[i] = body, childclass
            self.bodies += [(child, childclass) for child in body.findall("body")]
            # As Drake has no defaults of a class that says nothing of them, but those above it do.
            for each in (*body.findall("joint"), *body.findall("geom")):
                each.attrib.update(self.resolve(each, childclass))

    def resolve(self, element: Element, childclass: str) -> dict[str, str]:
        """Returns an element's attributes with those of its class."""
        tag = "actuator" if element.tag in MOTORS else element.tag
        name = element.get("class", childclass)
        if name not in self._classes and name != "main":
            raise refuse_element(self.path, element, f"the unknown class {name!r} of defaults")
        return {**self._classes.get(name, {}).get(tag, {}), **element.attrib}

    def is_limited(self, values: dict[str, str], of: str) -> bool:
        """Returns whether a range counts: that of an actuator, or without a word a joint's."""
        limited, has_range = values.get(f"{of}limited", "auto"), f"{of}range" in values
        if limited == "auto":
            return has_range and self.compiler.get("autolimits", "true") == "true"
        return limited == "true" and has_range

    def _read_class(
        self, default: Element, name: str, inherited: dict[str, dict[str, str]]
    ) -> None:
        """Resolves a class of defaults, and those inside of it."""
        known = self._classes.get(name, inherited)
        mine = {tag: dict(values) for tag, values in known.items()}
        for child in default:
            if child.tag != "default":
                tag = "actuator" if child.tag in MOTORS else child.tag
                mine.setdefault(tag, {}).update(child.attrib)
        self._classes[name] = mine
        for child in default.findall("default"):
            self._read_class(child, child.get("class", "main"), mine)


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


def _merge(elements: list[Element]) -> dict[str, str]:
    """Returns the attributes of several sections, of which later ones count."""
    return {key: value for element in elements for key, value in element.attrib.items()}


Range = tuple[float, float]

OTHER_ACTUATORS = ("intvelocity", "damper", "cylinder", "muscle", "adhesion", "plugin", "dcmotor")
_TENDON_FORCES = ("stiffness", "damping", "frictionloss", "armature")
_TRANSMISSIONS = ("tendon", "site", "body", "cranksite", "slidersite", "refsite")


def read_actuators(
    file: MjcfFile, fixed: Collection[str], efforts: Mapping[str, Range]
) -> set[str]:
    """Turns all that drives one joint into motors, and returns the joints that are driven.

    Forces of several at one joint add up; fixed joints move no more. Efforts limit those of joints
    that have limits of their own [N, N m].
    """
    joints = [
        each for body, _ in file.bodies for each in body if each.tag in ("joint", "freejoint")
    ]
    names = {joint.get("name", ""): joint for joint in joints}
    off_groups = file.option.get("actuatorgroupdisable", "").split()
    driven = dict[str, str]()
    labels = {each.get("name") for each in file.root.iterfind("actuator/*")}
    for group in file.root.findall("actuator"):
        for motor in list(group):
            values = file.resolve(motor, "main")
            joint, lever = _find_joint(file, values)
            label = motor.get("name") or _name_motor(f"{joint or 'actuator'}_{motor.tag}", labels)
            is_off = "actuation" in file.off or values.get("group", "0") in off_groups
            is_off |= joint in fixed
            if is_off or not _acts(file, motor, values, joint, label, names):
                group.remove(motor)
                continue
            assert joint is not None
            if joint in driven and joint in efforts:
                got = f"{driven[joint]!r} and {label!r} at joint {joint!r} with an actuatorfrcrange"
                expected = "one actuator there, or none that bounds their sum"
                raise refuse_element(file.path, motor, got, expected)
            driven[joint] = label
            servo = None if joint in efforts else _find_servo(file, motor, values)
            effort = _find_effort(file, motor, f"actuator {label!r}", values, lever, servo)
            if servo is not None:
                gear = lever * read_numbers(file.path, values.get("gear", "1"))[0]
                known = file.facts.servos.get(joint, Servo(0.0))
                added = (one + gear**2 * other for one, other in zip(known, servo, strict=True))
                file.facts.servos[joint] = Servo(*added)
            _make_motor(file, motor, joint, label, (effort, efforts.get(joint, effort)))
    return set(driven)


def _name_motor(name: str, taken: set[str | None]) -> str:
    """Returns a name for an actuator without one, and takes it."""
    free = itertools.chain([name], (f"{name}{i}" for i in itertools.count(1)))
    taken.add(found := next(each for each in free if each not in taken))
    return found


def _acts(
    file: MjcfFile,
    motor: Element,
    values: dict[str, str],
    joint: str | None,
    label: str,
    joints: Mapping[str, Element],
) -> bool:
    """Returns whether an actuator is one that is read."""
    what = f"actuator {label!r}"
    if joint is None:
        through = next((each for each in _TRANSMISSIONS if each in values), "nothing")
        of = f"{what}, which acts through a {through}, not one joint"
        return file.facts.refuse("actuators", of, "an actuator that is missing")
    if joint not in joints:
        if file.facts.refused or file.facts.ignored:  # It may be in what is left out.
            of = f"{what} at joint {joint!r}, which is left out"
            return file.facts.refuse("actuators", of, "an actuator that is missing")
        got = f"{what} at the unknown joint {joint!r}"
        raise refuse_element(file.path, motor, got, f"one of {', '.join(sorted(joints))}")
    if joints[joint].tag == "freejoint" or joints[joint].get("type") in ("ball", "free"):
        of = f"{what} at joint {joint!r}, which turns in space"
        return file.facts.refuse("actuators", of, "an actuator that is missing")
    if motor.tag in OTHER_ACTUATORS or values.get("dyntype", "none") != "none":
        of = f"{what}, which has dynamics of its own"
        return file.facts.refuse("actuators", of, "an actuator that is missing")
    return True


def _make_motor(
    file: MjcfFile, motor: Element, joint: str, label: str, ranges: tuple[Range, Range]
) -> None:
    """Rewrites an actuator, whose effort is within both ranges."""
    (one, other) = ranges
    lower, upper = max(one[0], other[0]), min(one[1], other[1])
    file.facts.efforts[label] = lower, upper
    largest = max(-lower, upper)
    motor.attrib.clear()
    motor.tag = "motor"
    motor.attrib |= {"name": label, "joint": joint, "gear": "1"}
    bound = {"ctrllimited": "true", "ctrlrange": f"{-largest!r} {largest!r}"}
    motor.attrib |= bound if math.isfinite(largest) else {"ctrllimited": "false"}


def _find_joint(file: MjcfFile, values: dict[str, str]) -> tuple[str | None, float]:
    """Returns the one joint that an actuator acts on, and the lever with which it does."""
    if joint := values.get("joint") or values.get("jointinparent"):
        return joint, 1.0
    for tendon in file.root.findall("tendon/fixed"):
        if tendon.get("name") == values.get("tendon"):
            levers = {
                each.get("joint"): read_numbers(file.path, each.get("coef", "1"))[0]
                for each in tendon.findall("joint")
            }
            acting = {joint: lever for joint, lever in levers.items() if lever != 0.0}
            return next(iter(acting.items())) if len(acting) == 1 else (None, 1.0)
    return None, 1.0


def _find_servo(file: MjcfFile, motor: Element, values: dict[str, str]) -> Servo | None:
    """Returns the law kp (u − l) − kv l̇ of a <position>; None: none, or its force is clamped."""
    is_other = {"timeconst", "dampratio", "inheritrange"} & set(values)
    if motor.tag != "position" or is_other or file.is_limited(values, "force"):
        return None
    gains = (("kp", "1"), ("kv", "0"))
    return Servo(*(read_numbers(file.path, values.get(key, usual))[0] for key, usual in gains))


def _find_effort(
    file: MjcfFile,
    motor: Element,
    what: str,
    values: dict[str, str],
    factor: float,
    servo: Servo | None,
) -> tuple[float, float]:
    """Returns the least and the largest effort at the joint, gear × gain × ctrlrange."""
    gear = factor * read_numbers(file.path, values.get("gear", "1"), what=f"gear of {what}")[0]
    if gear == 0.0:
        raise refuse_element(file.path, motor, f"{what} with a gear of 0", "another gear")
    ends = [(-math.inf, math.inf)]
    is_servo = motor.tag in ("position", "velocity") or (
        motor.tag == "general"
        and (values.get("biastype", "none"), values.get("gaintype", "fixed")) != ("none", "fixed")
    )
    if is_servo and servo is None:
        text = f"{what}, a servo; a plan's control is the force itself"
        file.facts.refuse("servos", text, "the servo's law and the range of its set point")
    elif file.is_limited(values, "ctrl") and "clampctrl" not in file.off:
        gain = read_numbers(file.path, values.get("gainprm", "1"))[0]
        gain = gain if motor.tag == "general" else servo.stiffness if servo else 1.0
        low, high = read_range(file.path, values["ctrlrange"], f"ctrlrange of {what}")
        ends.append((gain * low, gain * high))
    if file.is_limited(values, "force"):
        ends.append(read_range(file.path, values["forcerange"], f"forcerange of {what}"))
    lower, upper = max(min(end) for end in ends), min(max(end) for end in ends)
    return (gear * lower, gear * upper) if gear > 0 else (gear * upper, gear * lower)


def read_tendons(file: MjcfFile) -> None:
    """Refuses tendons that pull."""
    for tendon in file.root.findall("tendon/*"):
        values = file.resolve(tendon, "main")
        name = f"tendon {tendon.get('name')!r}"
        pulls = [each for each in _TENDON_FORCES if float(values.get(each, 0)) != 0.0]
        if file.is_limited(values, "") and "limit" not in file.off:
            pulls.append("range")
        if pulls:
            file.facts.refuse("tendons", f"{name} with {', '.join(pulls)}", "its forces")
