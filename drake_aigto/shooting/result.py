"""The answer to a shooting problem."""

from __future__ import annotations

from dataclasses import dataclass, field

from drake_aigto.arrays import ArrayRecord, Floats, read_only
from drake_aigto.simulation.replay import Replay


@dataclass(frozen=True, eq=False)
class ShootingResult(ArrayRecord):
    """A motion, exactly that of its controls, as far as its steps are.

    Attributes:
        times: of the knots, shape (N + 1,) [s].
        states: q and v at the knots, shape (N + 1, 2n); after impacts.
        controls: u between them, shape (N, nu).
        cost: with the contact law smoothed as it was at the end; infinite if the start's controls
            lead nowhere.
        exact_cost: of the same controls, contact as it is.
        violation: of bounds at knots, in units of the state's scales, at most.
        iterations: how many it took.
        is_converged: whether nothing was left to gain at the end.
        smoothing: ε at the end [m].
        substeps: Runge-Kutta steps between knots.
        order: of their error.
        durations: of phases, shape (P,) [s]; none without phases.
        prices: of bounds at knots: ρ, then all multipliers.
        is_left: whether it was left half-way (`ShootingOptions.most_promised`).
        replay: of the controls, where they were simulated on the way to this; None: they were not.
    """

    times: Floats
    states: Floats
    controls: Floats
    cost: float
    exact_cost: float
    violation: float
    iterations: int
    is_converged: bool
    smoothing: float
    substeps: int
    order: int
    durations: Floats
    prices: Floats
    is_left: bool = field(default=False, kw_only=True)
    replay: Replay | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        for name in ("times", "states", "controls", "durations", "prices"):
            object.__setattr__(self, name, read_only(getattr(self, name)))
