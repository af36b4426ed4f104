"""Starts of AIGO: first temperatures, widths and centers of boxes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from drake_aigto.aigo import Annealing
from drake_aigto.arrays import Bools, Floats
from drake_aigto.errors import OptionsError
from drake_aigto.transcription import CONTACT, DYNAMICS, FLIGHT, NONPENETRATION, RESTITUTION

StartName = Literal["line", "coast"]
MechanismStart = Literal["rest", "coast", "line"]
_STARTS: tuple[MechanismStart, ...] = ("rest", "coast", "line")

_COOLING = 0.2
_TOLERANCE = 0.05  # Of boxes: another method closes their centers, however near these are.
_FAR = 0.5  # largest shift of a slider's path, in `MechanismBoxes.widths`; of a hinge's: π


@dataclass(frozen=True)
class Rung:
    """One start of AIGO: its temperature, and weights of rows while boxes shrink.

    Weights and temperature are in units of the transcription's `cost_scale`.

    Attributes:
        temperature: first temperature μ of the annealing; other algorithms have none.
        weights: constraint name → weight of its penalty r²/dt.
        others: weight of rows not named there, such as those of users.
        start: the center of the first box: "line", the straight line from start to goal, up to
            the walls; or "coast", the uncontrolled motion in simulation, with a box that is narrow
            at first and wider with time.
    """

    temperature: float
    weights: Mapping[str, float]
    others: float = 1.0
    start: StartName = "line"

    def __post_init__(self) -> None:
        """Checks the start."""
        if self.start not in (known := get_args(StartName)):
            raise OptionsError("start", got=repr(self.start), expected=f"one of {known}")

    def describe(self, algorithm: str) -> str:
        """Returns an algorithm's start here, in words; only "annealing" has a temperature."""
        weights = ", ".join(f"{name} {weight:g}" for name, weight in self.weights.items())
        hot = f" from temperature {self.temperature:g}" if algorithm == "annealing" else ""
        return f"{algorithm}{hot}; around the {self.start}; weights {weights}"


def _rigid_rung(temperature: float, restitution: float, start: StartName = "line") -> Rung:
    weights = {FLIGHT: 3e2, DYNAMICS: 3e2, CONTACT: 3e2, RESTITUTION: restitution}
    return Rung(temperature, {**weights, NONPENETRATION: 3e3}, others=3e2, start=start)


# Hot boxes with a light restitution row find the wall, whether a bounce pays or not; cold ones with
# a heavy row, which wide boxes with impulses violate, find the free flight; the rung in between
# often finds the better one. Only the polish shows which is best. Between several walls, boxes
# around the straight line contain every sequence at once and lose all of them; those around the
# uncontrolled motion keep its bounces, or one more or fewer near the end.
BALL_LADDER = (
    _rigid_rung(3.0, 2.0),
    _rigid_rung(0.5, 5.0),
    _rigid_rung(0.03, 1000.0),
    _rigid_rung(0.1, 50.0, "coast"),
    _rigid_rung(1.0, 5.0, "coast"),
)


@dataclass(frozen=True, kw_only=True)
class Shrinking:
    """How boxes shrink.

    Attributes:
        weight: W of rows that no control can meet, in `MechanismBoxes.weight_unit`.
        temperature: first μ, in `MechanismBoxes.temperature_unit`.
        half_width: of the first box, in `MechanismBoxes.widths`; 0: points, without temperature.
        temperatures: their number, each a fifth of the one before.
        newton_steps: at each temperature, at most.
    """

    weight: float = 0.1
    temperature: float = 0.1
    half_width: float = 0.5
    temperatures: int = 3
    newton_steps: int = 10

    def annealing(self, unit: float) -> Annealing:
        """Returns the algorithm, given the unit of temperatures."""
        first = unit * self.temperature
        # Between the last temperature and the next, so that rounding has no effect.
        last = first * _COOLING ** (self.temperatures - 0.5)
        return Annealing(
            initial_temperature=first,
            final_temperature=last,
            cooling=_COOLING,
            tolerance=_TOLERANCE,
            max_newton_steps=self.newton_steps,
        )


@dataclass(frozen=True, kw_only=True)
class MechanismRung(Shrinking):
    """One start of AIGO.

    Attributes:
        start: the path at the center of the first box: "rest", standing still; "coast", the
            uncontrolled motion; "line", the straight line to the goal.
        num_steps: N of its program.
        shift: of the middle of that path, per coordinate, in `MechanismBoxes.widths`; empty: none.
    """

    start: MechanismStart = "rest"
    num_steps: int = 30
    shift: tuple[float, ...] = ()

    @classmethod
    def draw(cls, rng: np.random.Generator, num_steps: int, is_hinge: Bools) -> MechanismRung:
        """Returns a random rung."""
        far = np.where(is_hinge, np.pi, _FAR)
        return cls(
            start=_STARTS[rng.integers(len(_STARTS))],
            num_steps=num_steps,
            shift=tuple((far * rng.uniform(-1.0, 1.0, len(far))).tolist()),
            weight=10 ** rng.uniform(-2.0, 0.5),
            temperature=10 ** rng.uniform(-1.0, 1.0),
            half_width=10 ** rng.uniform(-0.7, 0.3),
            temperatures=1,
        )

    def describe(self, algorithm: str) -> str:
        """Returns an algorithm's start here, in words."""
        how = f"from temperature {self.temperature:.3g}" if self.half_width else "of points"
        path = f"around the {self.start}" + (", moved" if self.shift else "")
        return f"{algorithm} {how}; {path}; weight {self.weight:.3g}; {self.num_steps} time steps"


@dataclass(frozen=True, kw_only=True)
class Renewal(Shrinking):
    """A stretch of a motion that is perturbed and opened again, while the rest is held.

    Attributes:
        first: its first knot, 1 or more.
        count: its number of knots; those beyond the last one do not count.
        shift: of its middle, in `MechanismBoxes.widths`, shape (n,).
    """

    first: int
    count: int
    shift: Floats
    temperatures: int = 1

    @classmethod
    def draw(cls, rng: np.random.Generator, num_steps: int, num_positions: int) -> Renewal:
        """Returns a random renewal of a quarter, half, three quarters or all of the steps."""
        count = max(1, num_steps * int(rng.integers(1, 5)) // 4)
        half_width = 10 ** rng.uniform(-1.0, 0.3)
        return cls(
            first=int(rng.integers(1, max(2, num_steps - count + 2))),
            count=count,
            shift=half_width * rng.uniform(-1.0, 1.0, num_positions),
            weight=10 ** rng.uniform(-2.5, 0.5),
            temperature=10 ** rng.uniform(-1.0, 1.0),
            half_width=half_width,
        )


def _rung(
    start: MechanismStart, weight: float, temperature: float, num_steps: int
) -> MechanismRung:
    return MechanismRung(start=start, weight=weight, temperature=temperature, num_steps=num_steps)


# No rung is right everywhere: boxes with heavily weighted dynamics keep to passive motions, others
# jump to the goal. Hence both starts, decades of weights and temperatures, fine and coarse steps.
MECHANISM_LADDER = (
    _rung("rest", 0.1, 0.1, 60),
    _rung("coast", 0.1, 1.0, 30),
    _rung("rest", 1.0, 0.1, 30),
    _rung("coast", 1.0, 10.0, 60),
    _rung("rest", 0.01, 10.0, 60),
    _rung("coast", 0.001, 10.0, 30),
    _rung("coast", 0.01, 10.0, 30),
    _rung("coast", 1.0, 1.0, 30),
    _rung("rest", 0.001, 10.0, 30),
    _rung("rest", 0.01, 1.0, 30),
    _rung("rest", 0.01, 0.1, 30),
)
