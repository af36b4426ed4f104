"""Penalty continuation: boxes are points by now, and penalties rise until constraints hold."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from drake_aigto.aigo.newton import newton, point_objective
from drake_aigto.arrays import Bools, Floats
from drake_aigto.box import BoxPolynomial


@dataclass(frozen=True, kw_only=True)
class PenaltyContinuation:
    """Raises penalty weights in steps, and at each minimizes f(x) itself by a banded Newton method.

    A penalty W r² leaves a residual of (multiplier)/(2W): weights raised by R shrink it by 1/R.

    Attributes:
        raises: how often the weights are raised.
        factor: by how much each time.
        max_newton_steps: the most Newton steps at each weight.
        tolerance: each minimization ends at √(gᵀ diag(H)⁻¹ g) ≤ tolerance.
    """

    raises: int = 5
    factor: float = 10.0
    max_newton_steps: int = 10
    tolerance: float = 1e-10

    def run(self, f: BoxPolynomial, penalties: Collection[str], x: Floats, free: Bools) -> Floats:
        """Returns the minimizer at the last weights.

        Args:
            f: the penalized cost.
            penalties: names of the blocks that are penalties.
            x: where to start, shape (n,).
            free: which variables may move, shape (n,).
        """
        weights = {name: f.weights[name] for name in penalties}
        y, damping = x[f.order], 0.0
        for k in range(1, self.raises + 1):
            raised = f.with_weights({name: w * self.factor**k for name, w in weights.items()})
            objective = point_objective(raised, free, self.tolerance)
            result = newton(objective, y, self.max_newton_steps, damping)
            y, damping = result.y, result.damping
        (center,) = f.to_variables(y)
        return center
