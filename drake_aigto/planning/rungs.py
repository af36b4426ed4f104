"""Starts of AIGO: first temperatures, widths and centers of boxes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

from drake_aigto.errors import OptionsError
from drake_aigto.transcription import CONTACT, DYNAMICS, FLIGHT, NONPENETRATION, RESTITUTION

StartName = Literal["line", "coast"]


@dataclass(frozen=True)
class Rung:
    """One start of AIGO: its temperature, and weights of rows while boxes shrink.

    Weights and temperature are in units of the transcription's `cost_scale`.

    Attributes:
        temperature: first temperature μ of the annealing; other algorithms have none.
        weights: constraint name → weight of its penalty r²/dt.
        others: weight of rows not named there, such as those of users.
        start: the center of the first box: "line", the straight line from start to goal, up to
            the walls; or `"coast"`, the uncontrolled motion in simulation, with a box that is
            narrow at first and wider with time.
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
