"""What a model says and Drake's reader does not hear, and what of it can't be planned for."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import yaml
from pydrake.multibody.plant import MultibodyPlant

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.meshes import MESHES, explain
from drake_aigto.world.model_fields import ModelFields, Servo
from drake_aigto.world.scenario import Scenario


class FixableError(ModelError):
    """A model that fields of a scenario make fit to be read.

    Attributes:
        fields: that do, or begin to.
    """

    def __init__(
        self,
        what: str,
        got: object = None,
        expected: object = None,
        remedy: str | None = None,
        fields: Mapping[str, Any] = MappingProxyType({}),
    ) -> None:
        """Stores the fields beside the parts of the message."""
        super().__init__(what, got, expected, remedy)
        self.fields = dict(fields)


class Spring(NamedTuple):
    """A spring of a joint."""

    stiffness: float  # k [N/m, N m/rad]
    reference: float  # Where it is at rest [m, rad].


@dataclass
class ModelFacts:
    """What a model says and Drake's reader does not hear."""

    fields: ModelFields  # how it is to be read
    mass_scale: float = 1.0  # what masses and inertias are multiplied with to get the `total_mass`
    # A mesh of four points in place of those that may touch; others are not read. None: meshes are
    # read, which may take seconds.
    stub: Path | None = None
    is_bare: bool = False  # whether it stands for any
    # F of joints that have any, −F σ(v / v_s) [N, N m].
    friction: dict[str, float] = field(default_factory=dict)
    springs: dict[str, Spring] = field(default_factory=dict)  # of joints that Drake gives none
    servos: dict[str, Servo] = field(default_factory=dict)  # of joints, by the file or the scenario
    # Least and largest u of actuators whose limits are not the same both ways [N, N m].
    efforts: dict[str, tuple[float, float]] = field(default_factory=dict)
    no_effort: set[str] = field(default_factory=set)  # joints whose actuator has the limit 0
    # Largest effort of joints, where the model has one, driven or not [N, N m].
    joint_efforts: dict[str, float] = field(default_factory=dict)
    apart: list[tuple[str, str]] = field(default_factory=list)  # pairs of shapes that may not touch
    is_scene: bool = False  # whether several files make the model
    # Normals of those in whose place the text has marks, shape (3,) each.
    planes: list[list[float]] = field(default_factory=list)
    total_mass: float | None = None  # of all links [kg]; None: as they are
    # What can't be planned for: the word that allows to leave it out, what it is, and what is
    # missing without it.
    refused: list[tuple[str, str, str]] = field(default_factory=list)
    # The same of what is left out, as it was allowed.
    ignored: list[tuple[str, str, str]] = field(default_factory=list)
    # Shapes with meshes that can't be read, and may touch; and why.
    unread: list[str] = field(default_factory=list)
    unweighed: list[str] = field(default_factory=list)  # those that give links their mass
    undrawn: list[Path] = field(default_factory=list)  # such meshes that would only be drawn
    notes: list[str] = field(default_factory=list)  # what else differs from the file

    def refuse(self, word: str, what: str, cost: str) -> bool:
        """Keeps what is not planned for, to refuse all at once (`check`); returns False."""
        allowed = word in self.fields.allow_ignored
        (self.ignored if allowed else self.refused).append((word, what, cost))
        return False

    def keeps(self, *names: str) -> bool:
        """Returns whether a shape may touch anything, by its names."""
        return any(fits(name, glob) for name in names for glob in self.fields.collisions)

    def fixes(self, joint: str) -> bool:
        """Returns whether a joint is to stand still."""
        return any(fits(joint, glob) for glob in self.fields.fixed_joints)

    def check(self, path: Path) -> None:
        """Refuses all that is not planned for."""
        got, remedies, answer = [], [], dict[str, Any]()
        if self.unweighed:
            raise ModelError(
                f"model {path}",
                got="meshes that can't be read and give links their mass: "
                f"{', '.join(self.unweighed)}",
                remedy=f"Convert them to {' or '.join(MESHES)}, or give the links masses and "
                "inertias in the model.",
            )
        if self.unread:
            answer["collisions"] = "none"
            got.append(f"meshes that can't be read: {', '.join(self.unread)}")
            remedies.append(
                "Name the shapes that may touch by the scenario's collisions: [...], or take "
                "collisions: none."
            )
        if self.refused:
            words = ", ".join(dict.fromkeys(word for word, _, _ in self.refused))
            parts = dict.fromkeys(f"{what} ({cost})" for _, what, cost in self.refused)
            answer["allow_ignored"] = list(dict.fromkeys(word for word, _, _ in self.refused))
            got.append(f"what is not planned for: {'; '.join(parts)}")
            remedies.append(
                f"Change the model, or leave it out by the scenario's allow_ignored: [{words}]."
            )
        if names := list(dict.fromkeys(self.undrawn)):
            self.notes.append(f"not drawn: {explain(names[0], len(names) - 1)}")
        if got:
            remedy = " ".join(remedies)
            raise FixableError(f"model {path}", "; and ".join(got), None, remedy, answer)


def fits(name: str, glob: str) -> bool:
    """Returns whether a name, or its end after a ``::``, fits a glob."""
    return fnmatchcase(name, glob) or fnmatchcase(name, f"*::{glob}")


def pick(what: str, globs: Iterable[str], names: Collection[str]) -> list[str]:
    """Returns the names that globs choose, in order of the names."""
    globs = tuple(globs)
    for glob in globs:
        if not any(fits(name, glob) for name in names):
            raise ModelError(
                what, got=repr(glob), expected=f"one of {', '.join(sorted(names)) or '(none)'}"
            )
    return [name for name in names if any(fits(name, glob) for glob in globs)]


def calc_servo_forces(
    plant: MultibodyPlant, servos: Mapping[str, Servo], positions: Floats
) -> Floats:
    """Returns k q of servos in driven joints, shape (…, nv), at positions of shape (…, nq)."""
    forces = np.zeros((*np.shape(positions)[:-1], plant.num_velocities()))
    for actuator in map(plant.get_joint_actuator, plant.GetJointActuatorIndices()):
        joint = actuator.joint()
        for k in [each.stiffness for glob, each in servos.items() if fits(joint.name(), glob)]:
            forces[..., joint.velocity_start()] = k * positions[..., joint.position_start()]
    return forces


def read_numbers(
    path: Path, text: str, count: int | None = 1, what: str = "a number"
) -> list[float]:
    """Returns numbers of an attribute, at least `count`."""
    try:
        numbers = [float(each) for each in text.split()]
    except ValueError:
        numbers = [math.nan]
    if len(numbers) < (count or 0) or not all(map(math.isfinite, numbers)):
        raise ModelError(f"{what} in {path}", got=repr(text), expected="finite numbers")
    return numbers


def read_range(path: Path, text: str, what: str) -> tuple[float, float]:
    """Returns the least and the most of a range."""
    lower, upper = read_numbers(path, text, 2, what)[:2]
    if lower > upper:
        raise ModelError(
            f"{what} in {path}", got=f"from {lower:g} to {upper:g}", expected="least first"
        )
    return lower, upper


def refuse_element(path: Path, element: Element, got: str, expected: str = "") -> ModelError:
    """Returns the error of an element that is wrong in itself."""
    return ModelError(
        f"model {path}, <{element.tag}>", got=got, expected=expected or "what the model has"
    )


_MOST = 8  # Answers; there are fewer kinds of errors that have one.


def find_errors(*checks: Callable[[], object]) -> list[ModelError]:
    """Returns what checks raise that do not depend on each other."""
    found = []
    for check in checks:
        try:
            check()
        except ModelError as error:
            found.append(error)
    return found


def gather(
    find: Callable[[Scenario], list[ModelError]], scenario: Scenario, first: FixableError
) -> FixableError:
    """Returns an error of all that is wrong, with one remedy: answers are tried one after another.

    Args:
        find: returns what is wrong with the model as a scenario says it.
        scenario: as it was given.
        first: what was raised for it.
    """
    found: list[ModelError] = [first]
    errors: list[ModelError] = [first]
    answers: dict[str, Any] = {}
    for _ in range(_MOST):
        for error in errors:
            answers = _add(scenario, answers, getattr(error, "fields", {}))
        try:
            errors = find(dataclasses.replace(scenario, **answers))
        except ScenarioError:
            break
        told = set(map(str, found))
        errors = [error for error in errors if str(error) not in told]
        found += errors
        if not errors or not all(isinstance(error, FixableError) for error in errors):
            break
    if len(found) == 1:
        return first
    name = f"model {scenario.model}"
    text = yaml.safe_dump(answers, default_flow_style=True, width=10_000).strip()
    rest = found[-1]
    left = "" if isinstance(rest, FixableError) else f" What is left: {rest.remedy or 'the last'}"
    if scenario.contact == "rigid" and answers.keys() & {"weld", "fixed_joints"}:
        left += " With contact: compliant, links may float, and joints may be many."
    return FixableError(
        name,
        got="; ".join(
            f"{error.what}: {error.got}".removeprefix(f"{name}: ").removesuffix(": None")
            for error in found
        ),
        remedy=f"These fields of the scenario answer that: {text}, or change the model.{left}",
        fields=answers,
    )


def _add(scenario: Scenario, answers: dict[str, Any], more: dict[str, Any]) -> dict[str, Any]:
    """Returns answers with others, beside what the scenario has."""
    added = dict(answers)
    for name, value in more.items():
        own = added.get(name, getattr(scenario, name))
        if isinstance(value, dict):
            added[name] = {**own, **value}
        elif isinstance(value, list):
            added[name] = list(dict.fromkeys([*own, *value]))
        else:
            added[name] = value
    if isinstance(driven := added.get("actuators"), list):
        still: Any = added.get("fixed_joints", scenario.fixed_joints)
        added["actuators"] = [each for each in driven if not any(fits(each, g) for g in still)]
    return added
