"""How a shooting problem is solved: numerics only."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from drake_aigto.errors import OptionsError

# Of 69 boxes around arms of three links, 5 are closed to motions that are better than no control in
# steps that may raise the cost by much, 14 in such as may not, and 24 if Runge-Kutta steps are so
# many times shorter as well. Around a cart-pole between soft walls the former lead to better plans.
_SHORTER = 2


class Smoothing(NamedTuple):
    """A pass at one smoothing.

    Attributes:
        smoothing: ε in units of the problem's length.
        iterations: at most so many.
        tolerance: of what the next step promises, as a share of the cost.
    """

    smoothing: float
    iterations: int
    tolerance: float


@dataclass(frozen=True)
class ShootingOptions:
    """Options of `ShootingProblem.solve`.

    Attributes:
        rungs: passes at falling smoothing. Where nothing yields, the last one with all iterations
            takes the place of all.
        substeps: Runge-Kutta steps of a stage.
        order: of their error: 4, or 2 with half as many evaluations.
        penalty: ρ at first, in units of cost per squared scale.
        multiplier_updates: further passes of the last rung, until bounds at knots hold.
        feasibility: how far they may be off, in units of the state's scales.
        is_wary: whether a step that closes the gaps of a guess may raise the cost by little only.
            Most motions are found sooner without; where they diverge, few are found.
        most_promised: what promises to cost more in the last pass, with what bounds are off, is
            left where it is.

    Raises:
        OptionsError: an option is out of its range.
    """

    rungs: tuple[Smoothing, ...] = (
        Smoothing(0.1, 40, 1e-3),
        Smoothing(0.01, 40, 1e-3),
        Smoothing(0.001, 60, 1e-5),
    )
    substeps: int = 1
    order: int = 4
    penalty: float = 10.0
    multiplier_updates: int = 12
    feasibility: float = 1e-4
    is_wary: bool = False
    most_promised: float = math.inf

    def __post_init__(self) -> None:
        """Checks the ranges."""
        rungs = tuple(Smoothing(*rung) for rung in self.rungs)
        object.__setattr__(self, "rungs", rungs)
        checks = (
            ("rungs", rungs, "at least one", len(rungs) > 0),
            ("smoothing", rungs, "numbers of at least 0", all(r.smoothing >= 0 for r in rungs)),
            ("iterations", rungs, "at least 1", all(r.iterations >= 1 for r in rungs)),
            ("tolerance", rungs, "numbers above 0", all(r.tolerance > 0 for r in rungs)),
            ("substeps", self.substeps, "at least 1", self.substeps >= 1),
            ("order", self.order, "2 or 4", self.order in (2, 4)),
            ("penalty", self.penalty, "a number above 0", self.penalty > 0),
            ("multiplier_updates", self.multiplier_updates, ">= 0", self.multiplier_updates >= 0),
            ("feasibility", self.feasibility, "a number above 0", self.feasibility > 0),
            ("most_promised", self.most_promised, "a number", not math.isnan(self.most_promised)),
        )
        for name, got, expected, holds in checks:
            if not holds:
                raise OptionsError(name, got, expected)

    @property
    def wary(self) -> ShootingOptions:
        """The same for what diverges."""
        return replace(self, substeps=_SHORTER * self.substeps, is_wary=True)
