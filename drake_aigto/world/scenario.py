"""The question: which world, from where to where, in what time, at what price."""

from __future__ import annotations

import dataclasses
import difflib
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from pydrake.common.yaml import yaml_load_data

from drake_aigto.arrays import ArrayRecord
from drake_aigto.errors import ScenarioError
from drake_aigto.world.fields import VectorField, as_number
from drake_aigto.world.files import models_directory, write_text

DEFAULT_MODEL = "package://drake_aigto_models/point_mass_and_wall.sdf"

_REQUIRED = ("initial_position", "initial_velocity", "goal_position")

_BOUNDS: dict[str, dict[str, Any]] = {
    "duration": {"above": 0.0, "unit": "s"},
    "time_step": {"above": 0.0, "unit": "s"},
    "control_weight": {"above": 0.0},  # At zero no optimum is unique.
    "goal_weight": {"at_least": 0.0},
    "epsilon": {"above": 0.0, "unit": "J"},
    "delta": {"at_least": 0.0, "unit": "m"},
    "restitution": {"at_least": 0.0, "at_most": 1.0},
    "mass": {"above": 0.0, "unit": "kg"},
    "friction": {"at_least": 0.0},
}
# These keep what the model has if they are None.
_OPTIONAL = ("mass", "friction")

# Whole numbers of steps are recognized up to this relative error: 1.0 / 0.005 is not 200 exactly.
_STEP_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False, kw_only=True)
class Scenario(ArrayRecord):
    """A contact problem: physics and task, no numerics.

    Bring the system from its start to the goal with little control (AIGTO Sec. IV):

        minimize   control_weight ∫₀ᵀ ‖u(t)‖² dt + goal_weight ‖q(T) − goal_position‖²
        subject to M(q) v̇ + h(q, v) = B u + Jᵀ λ,   0 ≤ φ(q) ⊥ λ ≥ 0,   q(0), v(0) given

    Immutable; `dataclasses.replace` makes a changed copy. Scalars are taken for one coordinate.

    Attributes:
        model: the world, a ``package://`` URI or a path to an SDF or URDF. A relative path starts
            at the working directory.
        initial_position: q(0), shape (nq,) [m].
        initial_velocity: v(0), shape (nv,) [m/s].
        goal_position: where q(T) should be, shape (nq,) [m].
        duration: T [s], a whole number of time steps.
        time_step: dt [s].
        control_weight: w_u > 0 [1/(N² s)].
        goal_weight: w_f ≥ 0 [1/m²].
        epsilon: ε > 0 in the contact force λ = ε/(φ + δ) [J]. Literal transcription only.
        delta: δ ≥ 0 that keeps this force finite at the wall [m]. Literal transcription only.
        restitution: speed after / before an impact, e ∈ [0, 1], where the model has none of its own
            (`World.restitutions`).
        mass: replaces the mass of the only body with spheres that touch [kg]; None keeps the
            model's.
        friction: 0 leaves out the friction of every pair that can slide; None keeps the model's,
            which has to be 0 there (`World.check`), for plans know of none.

    Raises:
        ScenarioError: a value that is no number, not finite, or out of range.
    """

    model: str = DEFAULT_MODEL
    initial_position: VectorField = VectorField()  # [m]  # noqa: RUF009 (a descriptor)
    initial_velocity: VectorField = VectorField()  # [m/s]  # noqa: RUF009 (a descriptor)
    goal_position: VectorField = VectorField()  # [m]  # noqa: RUF009 (a descriptor)
    duration: float = 1.0  # [s]
    time_step: float = 0.005  # [s]
    control_weight: float = 1e-3  # [1/(N² s)]
    goal_weight: float = 1.0  # [1/m²]
    epsilon: float = 0.1  # [J]
    delta: float = 1e-3  # [m]
    restitution: float = 1.0
    mass: float | None = None  # [kg]
    friction: float | None = None

    def __post_init__(self) -> None:
        """Checks everything that can be checked without the model."""
        if not isinstance(self.model, str | os.PathLike) or not str(self.model):
            raise ScenarioError(
                "model", got=repr(self.model), expected="a package:// URI or a path to a file"
            )
        object.__setattr__(self, "model", str(self.model))
        for name, bounds in _BOUNDS.items():
            value = getattr(self, name)
            if name not in _OPTIONAL or value is not None:
                object.__setattr__(self, name, as_number(name, value, **bounds))
        if self.friction:
            raise ScenarioError(
                "friction",
                got=f"{self.friction:g}",
                expected="0, which leaves it out, or None, the model's",
                remedy="Plans know of no friction yet.",
            )
        self._check_steps()

    def _check_steps(self) -> None:
        """Refuses a duration that is no whole number of time steps."""
        steps = self.duration / self.time_step
        if not math.isfinite(steps):
            raise ScenarioError(
                "time_step",
                got=f"{self.time_step:g} s for a duration of {self.duration:g} s",
                expected="a number of steps that can be counted",
            )
        if round(steps) >= 1 and abs(steps - round(steps)) <= _STEP_TOLERANCE * steps:
            return
        fewer, more = max(1, math.floor(steps)), math.ceil(steps)
        durations = " or ".join(f"{n * self.time_step:.12g} s" for n in sorted({fewer, more}))
        time_steps = " or ".join(f"{self.duration / n:.12g} s" for n in sorted({fewer, more}))
        raise ScenarioError(
            "duration",
            got=f"{self.duration:.12g} s, which is {steps:.6g} steps of {self.time_step:.12g} s",
            expected="a whole number of time steps",
            remedy=f"The nearest that fit: duration {durations}, or time_step {time_steps}.",
        )

    @property
    def num_steps(self) -> int:
        """The number of time steps, N = duration / time_step."""
        return round(self.duration / self.time_step)

    def in_steps(self, num_steps: int) -> Scenario:
        """Returns the same, its duration cut into so many time steps."""
        other = object.__new__(Scenario)
        other.__dict__.update(self.__dict__, time_step=self.duration / num_steps)
        return other

    def to_plain(self) -> dict[str, Any]:
        """Returns the fields as plain numbers, strings and lists, in order."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {k: v.tolist() if hasattr(v, "tolist") else v for k, v in values.items()}

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
                raise ScenarioError(
                    f"unknown key {key!r}",
                    expected=f"one of {', '.join(known)}",
                    remedy=_suggestion(str(key), known),
                )
        missing = [name for name in _REQUIRED if name not in data]
        if missing:
            raise ScenarioError(f"missing {', '.join(missing)}", remedy="These have no default.")
        return cls(**data)

    @classmethod
    def named(cls, name: str) -> Scenario:
        """Returns a shipped scenario, such as ``"table1/1"``; `scenario_names` lists them.

        Raises:
            ScenarioError: there is none of this name.
        """
        names = scenario_names()
        if name not in names:
            raise ScenarioError(
                f"unknown scenario {name!r}",
                expected=f"one of {', '.join(names)}",
                remedy=_suggestion(str(name), names),
            )
        return cls.load(_scenarios_directory() / f"{name}.yaml")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Scenario:
        """Reads a YAML file of fields.

        Raises:
            ScenarioError: no such file, broken YAML, an unknown or a missing key, or a bad value.
        """
        data = _read_yaml(path)
        try:
            return cls.from_plain(data)
        except ScenarioError as error:
            what = f"{path}: {error.what}"
            raise ScenarioError(what, error.got, error.expected, error.remedy) from error

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a YAML file that `load` reads back to an equal scenario."""
        # Drake's own dump of a plain mapping would sort the fields.
        write_text(path, yaml.safe_dump(self.to_plain(), sort_keys=False, default_flow_style=None))


def scenario_names() -> list[str]:
    """Returns the names that `Scenario.named` knows, sorted."""
    directory = _scenarios_directory()
    paths = directory.glob("**/*.yaml")
    return sorted(path.relative_to(directory).with_suffix("").as_posix() for path in paths)


def _scenarios_directory() -> Path:
    return models_directory() / "scenarios"


def _suggestion(word: str, known: list[str]) -> str | None:
    close = difflib.get_close_matches(word, known, n=1)
    return f"Did you mean {close[0]!r}?" if close else None


def _read_yaml(path: str | os.PathLike[str]) -> object:
    """Returns what is in a YAML file; all but the model may be numbers."""
    try:
        data = yaml_load_data(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"scenario file {path} can't be read", got=error) from error
    except yaml.YAMLError as error:
        raise ScenarioError(
            f"{path} is not valid YAML", got=" ".join(str(error).split())
        ) from error
    if not isinstance(data, dict):
        return data
    return {k: v if k == "model" else _parse_numbers(v) for k, v in data.items()}


def _parse_numbers(value: object) -> object:
    """Reads numbers that YAML 1.1 takes for text, such as 1e-3; leaves anything else alone."""
    if isinstance(value, list):
        return [_parse_numbers(item) for item in value]
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value
