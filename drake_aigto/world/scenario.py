"""The question: which world, from where to where, in what time, at what price."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, TypeVar

import numpy as np
import yaml

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import STICTION_SPEED
from drake_aigto.errors import ScenarioError
from drake_aigto.plain import write_text
from drake_aigto.world import places
from drake_aigto.world.fields import (
    ArrayField,
    as_number,
    as_range,
    as_table,
    as_vector,
    check_bounds,
    check_counts,
    check_reference,
    check_steps,
)
from drake_aigto.world.files import read_scenario, refuse_name, scenario_files
from drake_aigto.world.model_fields import ModelFields, Named, as_globs

DEFAULT_MODEL = "package://drake_aigto_models/point_mass_and_wall.sdf"

_Made = TypeVar("_Made")


@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario(ModelFields):
    """A contact problem: physics and task, no numerics.

    Bring the system from its start to the goal with little control:

        minimize   ∫₀ᵀ uᵀ R u + e_qᵀ Q e_q + e_vᵀ Q_v e_v dt + e_q(T)ᵀ Q_T e_q(T)
                   + e_v(T)ᵀ Q_vT e_v(T)
        subject to M(q) v̇ + h(q, v) = B u + Jᵀ λ,   contact,   bounds,   q(0), v(0) given

    with e_q, e_v the errors of q and v, at T about the goal and before about the reference, which
    is the goal where none is given. The weights R, Q, Q_v, Q_T, Q_vT are `control_weight`,
    `position_weight`, `velocity_weight`, `goal_weight` and `goal_velocity_weight`. By default all
    but R and Q_T are zero, and these are multiples of the identity (`is_plain`), as in AIGTO
    Sec. IV; `TaskCost` evaluates J.

    Units are those of the coordinates: m, m/s and N of a slider, rad, rad/s and N m of a hinge. A
    vector has one number for each coordinate, or each actuator; scalars are taken for vectors of
    one. A weight is one number for all or a vector, which is a diagonal; it has to be a vector, or
    a matrix, where sliders and hinges are weighed against each other. A bound is one number for all
    or a vector, ±inf where there is none; the model's limits act as well. Immutable;
    `dataclasses.replace` makes a changed copy.

    Attributes:
        model: the world, a ``package://`` URI or a path to an SDF, URDF or MJCF. A relative path
            starts at the working directory; of a scenario's file, at its folder if the model is
            there. How it is read, say the `ModelFields`.
        initial_position: q(0), shape (nq,); or by names of joints and floating bodies, of which
            others are at the model's default: numbers of a joint, or a pose (`place_scenario`).
            Names, here and below, may be globs; names come before these, and the last counts.
        initial_velocity: v(0), shape (nv,); or by names, 0 of others: {}, which is at rest.
        goal_position: where q(T) should be, the same, or {by: numbers} for so far from the start;
            what is not named, where it starts. Of a motion that is `periodic` it is known.
        goal_velocity: v(T), the same; None: zero where it is weighed, free where the goal is hard.
        hard_goal: q(T) has to be the goal, and v(T) the `goal_velocity` that is given.
        periodic: given, the motion repeats: v(T) = v(0), and q(T) = q(0) but for how far joints
            advance, {x: 0.4}, or bodies that float, {body: [0.4, 0, null]} along the world's axes
            [m, rad]; {} for none. q(0) and v(0) are free, and the given ones a guess, but for
            positions that are named, by 0 as well; null names none. Not for rigid walls.
        angles: what the error of a hinge is, in each term: "exact", q − goal; "modulo", the nearest
            to zero of q − goal + 2πk, k any whole number; "chordal", 2 sin((q − goal)/2), whose
            square is 2 − 2 cos(q − goal).
        duration: T, or where the search for it starts [s]; a whole number of time steps.
        time_step: dt [s].
        duration_range: the least and the most that T may be [s], in as many time steps as
            `duration` has; None: T is the `duration`.
        control_weight: R > 0, one number or (nu,) [1/(N² s)], [1/((N m)² s)].
        goal_weight: Q_T ≥ 0, one number, (nv,), or a symmetric matrix (nv, nv) [1/m²], [1/rad²]; or
            by names, 0 of others: numbers of a joint, or xyz and turn of a floating body.
        frame_goals: where frames should be at T, and weights of that: frame or link → xyz, a turn
            (`rpy_deg`, `rpy` or `quaternion`), and weight: {xyz: 1 or 3 numbers, turn: 1 number};
            costs Σ w_k (p − xyz)_k² + w_turn (2 sin(θ/2))² beside the above. Of joints that neither
            a `goal_position` by names nor a weight names, it has inverse kinematics. In space.
        goal_velocity_weight: Q_vT ≥ 0, of the same kinds [s²/m²], [s²/rad²].
        position_weight: Q ≥ 0, one number or (nv,) [1/(m² s)], [1/(rad² s)]; or by names.
        velocity_weight: Q_v ≥ 0, one number or (nv,) [s/m²], [s/rad²]; or by names.
        reference_times: of the reference, increasing, shape (K,) [s].
        reference_positions: at these times, shape (K, nq), piecewise linear between and constant
            before and after; None: the goal.
        reference_velocities: the same, shape (K, nv); None: the goal's.
        position_lower: least q, one number or (nq,), −∞ for none; or by names, bodies' xyz.
        position_upper: largest q, the same.
        velocity_lower: least v, one number or (nv,); or by names, xyz and turn of a floating body.
        velocity_upper: largest v, the same.
        control_lower: least u, one number or (nu,); or by names of actuators or their joints.
        control_upper: largest u, the same.
        control_norm: largest ‖u‖; None: no such bound.
        contact: the law, "rigid", 0 ≤ φ(q) ⊥ λ ≥ 0 with Newton's restitution, or "compliant", the
            model's stiffness and dissipation.
        epsilon: ε > 0 in the contact force λ = ε/(φ + δ) [J]. Literal transcription only.
        delta: δ ≥ 0 that keeps this force finite at the wall [m]. Literal transcription only.
        restitution: speed after / before an impact, e ∈ [0, 1], where the model has none of its own
            (`World.restitutions`). Rigid contact only.
        mass: replaces the mass of the only body with spheres that touch [kg]; None keeps the
            model's.
        friction: μ of every pair that can slide, in place of the model's; 0 leaves friction out,
            None keeps the model's (`World.friction_coefficients`).
        dry_friction: F ≥ 0 of each coordinate, (nv,) or by names [N, N m]: joints have friction
            −F σ(v / v_s), see `calc_friction_share`, which belongs to h(q, v) above; None: the
            model's, if it has any.
        stiction_speed: v_s > 0 of all friction, Drake's stiction tolerance [m/s, rad/s].
        clearance: pairs that must not touch, and the least distance between them: name of a pair as
            `World.contacts` has it, or a glob → distance > 0 [m].
        ignored_shapes: collision shapes that touch nothing, neither in plans nor in simulations,
            such as two meshes that meet: "shape", "link::shape", globs, or all.

    Raises:
        ScenarioError: a value that is no number, not finite, or out of range, or one that
            contradicts another or would count for nothing.
    """

    model: str = DEFAULT_MODEL
    initial_position: ArrayField[Floats] = ArrayField(places.as_positions)
    initial_velocity: ArrayField[Floats] = ArrayField(places.as_velocity, Named())
    goal_position: ArrayField[Floats] = ArrayField(places.as_positions, None)
    goal_velocity: places.Vector = ArrayField(places.as_velocity, None)
    hard_goal: bool = False
    periodic: ArrayField[Named[tuple[float | None, ...]] | None] = ArrayField(
        places.as_period, None
    )
    angles: places.Angles = "exact"
    duration: float = 1.0  # [s]
    time_step: float = 0.005  # [s]
    duration_range: ArrayField[tuple[float, float] | None] = ArrayField(
        partial(as_range, unit="s"), None
    )
    control_weight: places.Weight = ArrayField(places.as_price, 1e-3)
    goal_weight: places.Weight = ArrayField(places.as_final, 1.0)
    frame_goals: ArrayField[Named[places.FrameGoal]] = ArrayField(places.as_frames, Named())
    goal_velocity_weight: places.Weight = ArrayField(places.as_final, 0.0)
    position_weight: places.Weight = ArrayField(places.as_running, 0.0)
    velocity_weight: places.Weight = ArrayField(places.as_running, 0.0)
    reference_times: places.Vector = ArrayField(as_vector, None)  # [s]
    reference_positions: places.Vector = ArrayField(as_table, None)
    reference_velocities: places.Vector = ArrayField(as_table, None)
    position_lower: places.Bound = ArrayField(places.as_limit, None)
    position_upper: places.Bound = ArrayField(places.as_limit, None)
    velocity_lower: places.Bound = ArrayField(places.as_limit, None)
    velocity_upper: places.Bound = ArrayField(places.as_limit, None)
    control_lower: places.Bound = ArrayField(places.as_limit, None)
    control_upper: places.Bound = ArrayField(places.as_limit, None)
    control_norm: float | None = None
    contact: places.ContactKind = "rigid"
    epsilon: float = 0.1  # [J]
    delta: float = 1e-3  # [m]
    restitution: float = 1.0
    mass: float | None = None  # [kg]
    friction: float | None = None
    dry_friction: places.Vector = ArrayField(places.as_friction, None)  # [N, N m]
    stiction_speed: float = STICTION_SPEED  # [m/s, rad/s]
    clearance: ArrayField[Named[float]] = ArrayField(places.as_clearance, Named())  # [m]
    ignored_shapes: ArrayField[tuple[str, ...]] = ArrayField(as_globs, ())

    def __post_init__(self) -> None:
        """Checks everything that can be checked without the model."""
        super().__post_init__()
        if not isinstance(self.model, str | os.PathLike) or not str(self.model):
            raise ScenarioError(
                "model", got=repr(self.model), expected="a package:// URI or a path to a file"
            )
        checked: dict[str, Any] = {"model": str(self.model)}
        if self.__dict__["goal_position"] is None:
            if self.periodic is None:
                raise ScenarioError("missing goal_position", remedy="It has no default.")
            checked["goal_position"] = Named()
        for name, bounds in places.BOUNDS.items():
            value = getattr(self, name)
            if name not in places.OPTIONAL or value is not None:
                checked[name] = as_number(name, value, **bounds)
        for name, choices in places.CHOICES.items():
            if not isinstance(value := getattr(self, name), str) or value not in choices:
                expected = f"one of {', '.join(map(repr, choices))}"
                raise ScenarioError(name, got=repr(value), expected=expected)
        if not isinstance(self.hard_goal, bool | np.bool_):
            raise ScenarioError("hard_goal", got=repr(self.hard_goal), expected="true or false")
        self.__dict__.update(checked, hard_goal=bool(self.hard_goal), _kept={})
        check_steps(self.duration, self.time_step)
        if not self.is_plain:
            self._check_task()

    def _check_task(self) -> None:
        """Refuses fields that contradict each other, or would count for nothing."""
        for name in ("position", "velocity", "control"):
            check_bounds(name, getattr(self, f"{name}_lower"), getattr(self, f"{name}_upper"))
        least, most = self.duration_range or (0.0, math.inf)
        if not least <= self.duration <= most:
            raise ScenarioError(
                "duration",
                got=f"{self.duration:g} s",
                expected=f"within duration_range, {least:g} to {most:g} s",
                remedy="The search starts from it.",
            )
        self._check_targets()
        if self.periodic is not None:
            weight = self.position_weight if self.reference_positions is None else 0.0
            places.check_repeats(self.goal_position, self.goal_velocity_weight, weight)
        if self.contact == "compliant" and self.restitution != 1.0:
            raise ScenarioError(
                "restitution",
                got=f"{self.restitution:g} with compliant contact",
                expected="none, as compliant walls lose what the model's dissipation takes",
                remedy="Leave it out, or ask for contact: rigid.",
            )

    def starting_at(self, state: Floats) -> Scenario:
        """Returns the same of a motion that repeats from q and v, (nq + nv,); else this one."""
        if self.periodic is None or np.array_equal(state, self.initial_state):
            return self
        q, v = np.split(state, [len(self.initial_position)])
        goal = q + self.goal_position - self.initial_position
        moved = dataclasses.replace(self, initial_position=q, initial_velocity=v)
        return dataclasses.replace(moved, goal_position=goal, goal_velocity=v)

    def _check_targets(self) -> None:
        """Refuses a reference, or a velocity of the goal, that is not whole or not weighed."""
        pairs = (
            ("reference_positions", "position_weight"),
            ("reference_velocities", "velocity_weight"),
        )
        given = [pair for pair in pairs if getattr(self, pair[0]) is not None]
        check_reference(self.reference_times, {name: getattr(self, name) for name, _ in given})
        for name, weight in given:
            check_counts(name, {weight: getattr(self, weight)}, "a weight")
        if self.goal_velocity is None or self.periodic is not None:
            return
        names = ["goal_velocity_weight", "hard_goal"]
        if self.reference_velocities is None:  # The way is weighed about the goal's.
            names.append("velocity_weight")
        check_counts("goal_velocity", {name: getattr(self, name) for name in names}, "one of these")

    @property
    def num_steps(self) -> int:
        """The number of time steps, N = duration / time_step."""
        return round(self.duration / self.time_step)

    @property
    def initial_state(self) -> Floats:
        """q(0) and v(0) as numbers, shape (nq + nv,)."""
        return np.concatenate([self.initial_position, self.initial_velocity])

    @property
    def is_plain(self) -> bool:
        """Whether the task is AIGTO's: weights on ‖u‖² and on ‖q(T) − goal_position‖² alone."""
        return not self.extras

    @cached_property
    def extras(self) -> tuple[str, ...]:
        """The fields that ask for more than a plain task does."""
        values = self.__dict__
        weights = (name for name in places.WEIGHTS if isinstance(values[name], np.ndarray | dict))
        given = (
            name
            for name in places.EXTRAS
            if isinstance(values[name], np.ndarray) or values[name] != _DEFAULTS[name]
        )
        return (*weights, *given)

    def check_plain(self, reader: str = "What plans for balls") -> None:
        """Refuses a task that is not plain, for code that would ignore what else it asks for.

        Args:
            reader: name of that code in the error.

        Raises:
            ScenarioError: the task is not plain; names the first field that asks for more.
        """
        for name in self.extras:
            default = _DEFAULTS[name]
            raise ScenarioError(
                name,
                got=places.write_plain(getattr(self, name)),
                expected="one number" if name in places.WEIGHTS else f"its default, {default}",
                remedy=f"{reader} would ignore it.",
            )

    def derive(self, world: Any, make: Callable[[Any, Scenario], _Made]) -> _Made:
        """Returns what a function makes of a world and this scenario, in steps of any length.

        What it made of the last world is kept, here and in all of `in_steps`.
        """
        kept: dict[Any, tuple[Any, _Made]] = self.__dict__["_kept"]
        if (known := kept.get(make)) is None or known[0] is not world:
            known = kept[make] = world, make(world, self)
        return known[1]

    def in_steps(self, num_steps: int) -> Scenario:
        """Returns the same with its duration cut into this number of time steps."""
        other = object.__new__(Scenario)
        other.__dict__.update(self.__dict__, time_step=self.duration / num_steps)
        return other

    def __repr__(self) -> str:
        """Returns the fields that `to_plain` has."""
        return f"Scenario({', '.join(f'{k}={v!r}' for k, v in self.to_plain().items())})"

    def to_plain(self) -> dict[str, Any]:
        """Returns the fields as plain numbers, strings and lists, in order.

        Those that ask for more than a plain task does, and those of how the model is read, are left
        out where they do not.
        """
        left_out = set(places.EXTRAS) - set(self.extras)
        left_out |= {name for name in _MODEL_FIELDS if getattr(self, name) == _DEFAULTS[name]}
        names = [field.name for field in dataclasses.fields(self) if field.name not in left_out]
        return {name: places.write_plain(getattr(self, name)) for name in names}

    @classmethod
    def from_plain(cls, data: object) -> Scenario:
        """Returns the scenario that `to_plain` gave.

        Raises:
            ScenarioError: not a mapping, an unknown or a missing key, or a bad value.
        """
        if not isinstance(data, dict):
            raise ScenarioError("scenario", got=type(data).__name__, expected="a mapping of fields")
        known = [field.name for field in dataclasses.fields(cls)]
        for key in data:
            if key not in known:
                raise refuse_name(f"unknown key {key!r}", str(key), known)
        found = {*data, *(["goal_position"] if data.get("periodic") is not None else [])}
        missing = [name for name in places.REQUIRED if name not in found]
        if missing:
            has = "It has" if len(missing) == 1 else "These have"
            raise ScenarioError(
                f"missing {', '.join(missing)}",
                remedy=f"{has} no default. {{}} is where joints are in the model.",
            )
        return cls(**data)

    @classmethod
    def named(cls, name: str) -> Scenario:
        """Returns a shipped scenario, such as ``"table1/1"``; `scenario_names` lists them.

        Raises:
            ScenarioError: there is none of this name.
        """
        files = scenario_files()
        if name not in files:
            raise refuse_name(f"unknown scenario {name!r}", str(name), list(files))
        return cls.load(files[name])

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Scenario:
        """Reads a YAML file of fields.

        Raises:
            ScenarioError: no such file, broken YAML, an unknown or a missing key, or a bad value.
        """
        data = read_scenario(path)
        try:
            return cls.from_plain(data)
        except ScenarioError as error:
            what = f"{path}: {error.what}"
            raise ScenarioError(what, *error.args[1:]) from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a YAML file that `load` reads back to an equal scenario."""
        # Drake's own dump of a plain mapping would sort the fields.
        write_text(path, yaml.safe_dump(self.to_plain(), sort_keys=False, default_flow_style=None))


_MODEL_FIELDS = [field.name for field in dataclasses.fields(ModelFields)]
_DEFAULTS = {field.name: field.default for field in dataclasses.fields(Scenario)}
