"""How a model is read: fields of a scenario that stand in place of an edited file."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple, TypeVar, get_args

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw

from drake_aigto.arrays import ArrayRecord
from drake_aigto.errors import ScenarioError
from drake_aigto.world.fields import ArrayField, as_names, as_number, as_vector

Limited = Literal["model", "ignore"]

# Largest entry of R Rᵀ − 1 by rounding: numbers in files have some seven digits.
_ROUNDING = 1e-6


class Material(NamedTuple):
    """What a collision shape is made of; None: as the model has it."""

    stiffness: float | None = None  # k [N/m]
    dissipation: float | None = None  # d [s/m]
    friction: float | None = None  # μ
    restitution: float | None = None  # e


class Servo(NamedTuple):
    """A position controller in a joint, τ = k (q* − q) − d q̇, whose set point is q* = u / k."""

    stiffness: float  # k [N/m, N m/rad]
    damping: float = 0.0  # d [N s/m, N m s/rad]


class Thruster(NamedTuple):
    """A force of its control u along a direction in a link's frame, with a moment about it."""

    body: str
    xyz: tuple[float, ...] = (0.0, 0.0, 0.0)  # where it acts [m]
    direction: tuple[float, ...] = (0.0, 0.0, 1.0)  # of unit length
    drag: float = 0.0  # moment about the direction, per u [m]


_Item = TypeVar("_Item")


class Named(Mapping[str, _Item]):
    """A mapping of names that nobody changes, equal and hashed by value."""

    def __init__(self, items: Mapping[str, _Item] | None = None) -> None:
        """Copies the items, if any."""
        self._items = dict(items or {})

    def __getitem__(self, name: str) -> _Item:
        """Returns the item of a name."""
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        """Yields the names."""
        return iter(self._items)

    def __len__(self) -> int:
        """Returns the number of items."""
        return len(self._items)

    def __hash__(self) -> int:
        """Hashes all items."""
        return hash(frozenset(self.items()))

    def __repr__(self) -> str:
        """Returns what a dict of the items shows."""
        return repr(self._items)


_BOUNDS: dict[str, dict[str, Any]] = {
    "stiffness": {"above": 0.0},
    "dissipation": {"at_least": 0.0},
    "friction": {"at_least": 0.0},
    "restitution": {"at_least": 0.0, "at_most": 1.0},
}


def as_pose(name: str, value: Any) -> tuple[float, ...]:
    """Returns a pose as the rows of a matrix (4, 4), 16 numbers.

    It is x, y, z [m]; these and roll, pitch, yaw [rad]; or a matrix (4, 4).
    """
    numbers = as_vector(name, np.ravel(np.array(value, dtype=object)))
    if numbers.size in (3, 6):
        turn = RollPitchYaw(numbers[3:] if numbers.size == 6 else np.zeros(3))
        return tuple(RigidTransform(turn, numbers[:3]).GetAsMatrix4().ravel().tolist())
    if numbers.size != 16:
        raise ScenarioError(
            name,
            got=f"{numbers.size} numbers",
            expected="x, y, z [m], or x, y, z, roll, pitch, yaw [m, rad], or a matrix (4, 4)",
        )
    X = numbers.reshape(4, 4)
    R = X[:3, :3]
    is_rigid = np.allclose(R @ R.T, np.eye(3), rtol=0.0, atol=_ROUNDING) and np.linalg.det(R) > 0
    if not is_rigid or X[3].tolist() != [0.0, 0.0, 0.0, 1.0]:
        raise ScenarioError(
            name,
            got=f"a matrix that is no rotation and translation, {X.tolist()}",
            expected="a rotation, with a translation beside it and 0, 0, 0, 1 below",
            remedy="Give x, y, z, roll, pitch, yaw instead.",
        )
    return tuple(numbers.tolist())


def as_mapping(
    check: Callable[[str, Any], _Item], example: str
) -> Callable[[str, object], Named[_Item]]:
    """Returns the check of a mapping of names, whose values have a check of their own."""

    def as_checked(name: str, value: object) -> Named[_Item]:
        if not isinstance(value, Mapping) or not all(isinstance(k, str) and k for k in value):
            expected = f"a mapping of names, such as {example}"
            raise ScenarioError(name, got=repr(value), expected=expected)
        return Named({key: check(f"{name}[{key}]", item) for key, item in value.items()})

    return as_checked


def as_text(name: str, value: object) -> str:
    """Returns a text that is not empty."""
    if not isinstance(value, str) or not value:
        raise ScenarioError(name, got=repr(value), expected="a text")
    return value


def as_material(name: str, value: object) -> Material:
    """Returns the material of shapes, from a mapping of some of its fields."""
    given = value._asdict() if isinstance(value, Material) else value
    if not isinstance(given, Mapping) or not given or set(given) - set(Material._fields):
        expected = f"a mapping of some of {', '.join(Material._fields)}"
        raise ScenarioError(name, got=repr(value), expected=expected)
    numbers = {key: item for key, item in given.items() if item is not None}
    return Material(**{k: as_number(f"{name}.{k}", x, **_BOUNDS[k]) for k, x in numbers.items()})


def as_servo(name: str, value: object) -> Servo:
    """Returns a servo, from its stiffness, or from stiffness and damping."""
    numbers = np.ravel(as_vector(name, value, at_least=0.0)).tolist()
    if not 1 <= len(numbers) <= 2 or numbers[0] <= 0.0:
        raise ScenarioError(name, got=repr(value), expected="stiffness > 0, and damping ≥ 0")
    return Servo(*numbers)


def as_thrusters(name: str, value: Any) -> tuple[Thruster, ...]:
    """Returns thrusters, from a list of mappings."""
    if not isinstance(value, list | tuple):
        raise ScenarioError(name, got=repr(value), expected="a list of thrusters")
    return tuple(_as_thruster(f"{name}[{i}]", item) for i, item in enumerate(value))


def _as_thruster(name: str, value: Any) -> Thruster:
    given = value._asdict() if isinstance(value, Thruster) else value
    if not isinstance(given, Mapping) or "body" not in given or set(given) - set(Thruster._fields):
        expected = f"a mapping of body, and some of {', '.join(Thruster._fields[1:])}"
        raise ScenarioError(name, got=repr(value), expected=expected)
    made = Thruster(**given)
    places = [as_vector(f"{name}.{key}", getattr(made, key)) for key in ("xyz", "direction")]
    length = float(np.linalg.norm(places[1]))
    if {place.size for place in places} != {3} or not length > 0.0:
        expected = "3 numbers in each, and a direction that is not 0"
        raise ScenarioError(f"{name}.xyz, direction", f"{made.xyz}, {made.direction}", expected)
    xyz, direction = places[0], places[1] / length
    drag = as_number(f"{name}.drag", made.drag, unit="m")
    body = as_text(f"{name}.body", made.body)
    return Thruster(body, tuple(xyz.tolist()), tuple(direction.tolist()), drag)


def as_globs(name: str, value: object) -> tuple[str, ...]:
    """Returns patterns of names, from a list of them, or from "all" or "none"."""
    if isinstance(value, str) and value in ("all", "none"):
        return ("*",) if value == "all" else ()
    globs = as_names(name, value)
    if len(set(globs)) < len(globs):
        twice = next(each for each in globs if globs.count(each) > 1)
        raise ScenarioError(name, got=f"{twice!r} twice", expected="each name once")
    return globs


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelFields(ArrayRecord):
    """Fields that say how a model's file is read.

    Names of shapes, joints and links may be globs where it is said so, such as ``wall_*``.

    Attributes:
        packages: of package:// URIs in the model, name → folder. A ``package.xml`` in a folder
            above the model is found by itself.
        weld: link → its pose in the world, where nothing holds it in the model: x, y, z [m]; then
            roll, pitch, yaw [rad]; or a matrix (4, 4).
        fixed_joints: joints that stand still at zero, globs; their actuators go with them.
        actuators: joints to drive where the model has no actuator.
        effort_limits: largest effort of an actuator, by its own or its joint's name, a glob
            [N, N m], in place of the model's.
        servos: driven joint, a glob → stiffness k and damping d of a position controller in it, of
            which the control is u = k q*, with q* the set point [N, N m] (`Servo`).
        thrusters: forces that turn with their links, whose controls follow those of the actuators:
            mappings of body, xyz where it acts in the link's frame [m], direction there, and drag,
            the moment about the direction per force [m] (`Thruster`). In space.
        weightless: models in the file whose gravity is compensated, globs of their names.
        limits: "model", or "ignore": limits of positions and velocities count for nothing.
        collisions: shapes that may touch anything, "all", "none" or globs; others are not even
            read, such as meshes in files that are missing.
        material: of collision shapes, glob → `Material`, in place of the model's.
        allow_ignored: what changes the physics, is not planned for, and is left out: the words in
            errors that refuse it.
    """

    packages: ArrayField[Named[str]] = ArrayField(
        as_mapping(as_text, "{arm_description: ~/robots/arm}"), Named()
    )
    weld: ArrayField[Named[tuple[float, ...]]] = ArrayField(
        as_mapping(as_pose, "{base_link: [0, 0, 0.4]}"), Named()
    )
    fixed_joints: ArrayField[tuple[str, ...]] = ArrayField(as_globs, ())
    actuators: ArrayField[tuple[str, ...]] = ArrayField(as_globs, ())
    effort_limits: ArrayField[Named[float]] = ArrayField(
        as_mapping(partial(as_number, above=0.0, unit="N or N m"), "{shoulder: 20}"), Named()
    )
    servos: ArrayField[Named[Servo]] = ArrayField(
        as_mapping(as_servo, "{shoulder: [100, 5]}"), Named()
    )
    thrusters: ArrayField[tuple[Thruster, ...]] = ArrayField(as_thrusters, ())
    weightless: ArrayField[tuple[str, ...]] = ArrayField(as_globs, ())
    limits: Limited = "model"
    collisions: ArrayField[tuple[str, ...]] = ArrayField(as_globs, ("*",))
    material: ArrayField[Named[Material]] = ArrayField(
        as_mapping(as_material, "{'foot_*': {stiffness: 1.0e+5}}"), Named()
    )
    allow_ignored: ArrayField[tuple[str, ...]] = ArrayField(as_globs, ())

    def __post_init__(self) -> None:
        """Checks the one field that is a choice."""
        if self.limits not in get_args(Limited):
            raise ScenarioError("limits", got=repr(self.limits), expected="'model' or 'ignore'")

    @property
    def model_fields(self) -> ModelFields:
        """These fields alone, of a record that has others."""
        names = (field.name for field in dataclasses.fields(ModelFields))
        return ModelFields(**{name: getattr(self, name) for name in names})
