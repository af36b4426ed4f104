"""Newton steps on the barrier problem's optimality conditions, with the inertia put right."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.local.factors import make_factors, max_norm
from drake_aigto.local.scaled import Duals, Linearization, Point, ScaledProblem

# Wächter & Biegler 2006, sec. 3.1: shifts δ_w of the Hessian.
_FIRST_SHIFT, _LEAST_SHIFT, _LARGEST_SHIFT = 1e-4, 1e-20, 1e20
_LOWER, _RAISE_FIRST, _RAISE = 1 / 3, 100.0, 8.0
_LARGEST_ESTIMATE = 1e3  # least-squares multipliers beyond it are replaced by 0 (their sec. 3.6)

# δ_c of every KKT matrix: keeps it regular where rows depend on each other, and costs nothing at
# a solution, as it multiplies the step of the multipliers.
ROW_SHIFT = 1e-10

# Size of δ_w past which a step's multipliers are not used (ours, see `NewtonStep.is_distorted`).
_DISTORTING_SHIFT = 100 * _FIRST_SHIFT


@dataclass(frozen=True)
class NewtonStep:
    """A step of y and all multipliers; valid until the next one is sought.

        [W + Σ + δ_w   Aᵀ ] [dy]     [∇φ_μ + Aᵀλ]
        [A            −δ_c] [dλ] = − [c         ]       dz = μ/slack − z − Σ dslack,    Σ = z/slack

    (Wächter & Biegler 2006, eq. (11)-(13).)

    Attributes:
        dy: Step of the free variables.
        duals: Step of the multipliers.
        slope: ∇φ_μᵀ dy.
        shift: δ_w.
    """

    dy: Floats
    duals: Duals
    slope: float
    shift: float
    _search: NewtonSearch
    _force: Floats

    @property
    def is_distorted(self) -> bool:
        """Whether the shift is so large that λ + dλ estimates nothing.

        Near rows that almost depend on each other such multipliers grow by orders of magnitude, and
        so does the indefiniteness of the next W.
        """
        return self.shift > _DISTORTING_SHIFT

    def corrected(self, rows: Floats) -> Floats:
        """Returns the step dy for other residuals of the rows (second-order correction)."""
        return self._search.solve(-self._force, -rows)[0]


class NewtonSearch:
    """Finds steps, and remembers the last shift."""

    def __init__(self, problem: ScaledProblem) -> None:
        """Allocates the factors."""
        self._problem = problem
        self._structure = problem.structure
        self._factors = make_factors(self._structure.storage, self._structure.is_row)
        self._last_shift = 0.0

    def solve(self, variables: Floats | float, rows: Floats | float) -> tuple[Floats, Floats]:
        """Solves with the matrix that was factorized last."""
        right = self._structure.join(variables, rows)
        return self._structure.split(self._factors.solve(right))

    def factorize(self, band: Floats, diagonal: Floats | float, row_shift: float) -> bool:
        """Factorizes [W + diagonal, Aᵀ; A, −row_shift]; tells if W + … is convex on A's kernel.

        By the inertia: as many negative eigenvalues as rows. The band is changed.
        """
        structure = self._structure
        band[0, structure.variable_places] = diagonal
        band[0, structure.row_places] = -row_shift
        return self._factors.factorize(band) == structure.rows.size

    def step(
        self, point: Point, duals: Duals, linearization: Linearization, mu: float
    ) -> NewtonStep | None:
        """Returns the step at a point; None if no shift makes the Hessian convex."""
        problem, slacks = self._problem, point.slacks
        sigma = duals.bounds / slacks
        descent = linearization.gradient - problem.bound_force(mu / slacks)
        shift = self._factorize_convex(linearization.band, problem.bound_curvature(sigma))
        if shift is None:
            return None
        force = descent + linearization.row_force
        dy, dl = self.solve(-force, -point.rows)
        dz = mu / slacks - duals.bounds - sigma * problem.slack_step(dy)
        return NewtonStep(dy, Duals(dl, dz), float(descent @ dy), shift, self, force)

    def _factorize_convex(self, band: Floats, curvature: Floats) -> float | None:
        diagonal = band[0, self._structure.variable_places] + curvature
        if not np.all(np.isfinite(diagonal)):
            return None
        shift, last = 0.0, self._last_shift
        while not self.factorize(band, diagonal + shift, ROW_SHIFT):
            if shift == 0.0:
                shift = max(_LEAST_SHIFT, _LOWER * last) if last else _FIRST_SHIFT
            else:
                shift *= _RAISE if last else _RAISE_FIRST
            if shift > _LARGEST_SHIFT:
                return None
        if shift > 0.0:
            self._last_shift = shift
        return shift

    def least_squares_multipliers(self, point: Point, mu: float) -> Floats:
        """Returns λ that minimizes ‖∇φ_μ + Aᵀλ‖; 0 where that is too large to mean anything."""
        problem, structure = self._problem, self._structure
        linearization = problem.linearize(point.y, np.zeros(structure.rows.size))
        descent = linearization.gradient - problem.bound_force(mu / point.slacks)
        self.factorize(structure.without_couplings(linearization.band), 1.0, ROW_SHIFT)
        estimate = self.solve(-descent, 0.0)[1]
        if not max_norm(estimate) <= _LARGEST_ESTIMATE:
            return np.zeros(structure.rows.size)
        return estimate
