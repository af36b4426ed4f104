"""Newton's method on the conditions of a local optimum that no bound touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.local.factors import make_factors, max_norm
from drake_aigto.local.nlp import PolynomialNlp
from drake_aigto.local.result import LocalResult, LocalStatus

# How far outside of its bounds a variable is that rounding put there, relative to 1 and the bound.
_ROUNDING = 1e-13


@dataclass(frozen=True)
class NewtonLagrange:
    """Minimizes f(x) subject to c(x) = 0 by full Newton steps, where no bound is in the way.

    They are on the conditions ∇f + Aᵀλ = 0, c = 0, and neither shortened nor bent towards a
    minimum: each takes one factorization. From a start where they lead to nothing, or to something
    else, that shows after a few, and `InteriorPoint` remains, whose barriers and filter take three
    times as long where both get there.

    Attributes:
        tolerance: Largest entry of ∇f + Aᵀλ at a solution, in units of the cost.
        feasibility: Largest residual |c_i| of a solution.
        max_iterations: Newton steps.
        cost_unit: Size of a cost that matters.
    """

    tolerance: float = 1e-8
    feasibility: float = 1e-12
    max_iterations: int = 12
    cost_unit: float = 1.0

    def solve(self, nlp: PolynomialNlp, x0: ArrayLike) -> LocalResult | None:
        """Returns a strict local minimum within bounds; None where the steps end in no such point.

        That it is a minimum is read off the inertia of [W Aᵀ; A 0]: as many negative eigenvalues as
        rows.

        Args:
            nlp: The problem; variables of equal bounds are held.
            x0: The start (n,), moved into the bounds first.
        """
        x = np.clip(np.array(x0, dtype=float), nlp.lower, nlp.upper)
        structure = nlp.kkt_structure
        factors = make_factors(structure.storage, structure.is_row)
        scales = np.ones(nlp.num_costs + nlp.num_rows)
        scales[: nlp.num_costs] = 1 / self.cost_unit
        values, multipliers = np.empty(scales.size), np.zeros(structure.rows.size)
        for iterations in range(self.max_iterations + 1):
            gradient, band = structure.assemble(x, scales, multipliers, values)
            residuals = values[nlp.num_costs :]
            of_rows = structure.multiply(band, structure.join(0.0, multipliers))
            force = gradient + structure.split(of_rows)[0]
            num_negative = factors.factorize(band)
            optimality, residual = max_norm(force), max_norm(residuals)
            if optimality <= self.tolerance and residual <= self.feasibility:
                break
            if num_negative < 0 or iterations == self.max_iterations:
                return None
            rows = residuals[structure.rows]
            step, change = structure.split(factors.solve(structure.join(-force, -rows)))
            x[structure.free] += step
            multipliers += change
        within = np.clip(x, nlp.lower, nlp.upper)
        outside = np.abs(x - within) / np.maximum(1.0, np.abs(within))
        if num_negative != multipliers.size or max_norm(outside) > _ROUNDING:
            return None
        all_multipliers = np.zeros(nlp.num_rows)
        all_multipliers[structure.rows] = multipliers * self.cost_unit
        return LocalResult(
            x=within,
            cost=self.cost_unit * float(np.sum(values[: nlp.num_costs])),
            status=LocalStatus.CONVERGED,
            iterations=iterations,
            residual=residual,
            optimality=optimality,
            multipliers=all_multipliers,
            lower_multipliers=np.zeros(nlp.num_variables),
            upper_multipliers=np.zeros(nlp.num_variables),
            storage=structure.storage,
        )
