"""Newton steps: on the barrier problem of a scaled program, and where no bound is in the way."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats
from drake_aigto.local.kkt import make_factors, max_norm
from drake_aigto.local.nlp import LocalResult, LocalStatus, PolynomialNlp

ROUNDING = 10 * float(np.finfo(float).eps)  # relative to the summands
_STEEPEST = 100.0  # of a cost or row at the start, once scaled (Wächter & Biegler sec. 3.8)


@dataclass(frozen=True)
class Point:
    """Free variables y (nf,), with values there."""

    y: Floats  # The free variables
    cost: float  # s f
    rows: Floats  # s c (ma,)
    slacks: Floats  # Distances to lower bounds, then to upper bounds (nb,), kept positive

    @cached_property
    def violation(self) -> float:
        """θ = ‖s c‖₁."""
        return float(np.sum(np.abs(self.rows)))

    @cached_property
    def _log_slacks(self) -> float:
        return float(np.sum(np.log(self.slacks)))

    def barrier(self, mu: float) -> float:
        """Returns φ_μ = s f − μ Σ log slack."""
        return self.cost - mu * self._log_slacks if self.slacks.size else self.cost


class Duals(NamedTuple):
    """Multipliers of the rows, λ (ma,), and of the bounds, z ≥ 0 (nb,)."""

    rows: Floats
    bounds: Floats


class Linearization(NamedTuple):
    """Derivatives at a point: s ∇f (nf,), Aᵀλ (nf,) and the KKT matrix [W Aᵀ; A 0] as stored."""

    gradient: Floats
    row_force: Floats
    band: Floats


class ScaledProblem:
    """Minimize s f(y) subject to s c(y) = 0 and bounds, over the variables that are not held.

    Bounds are numbered: nb of them, the lower ones first. The cost is divided by its unit; then,
    factors ≤ 1 keep its and every row's largest slope at the start from exceeding a hundred.

    Attributes:
        structure: Where the unknowns stand in KKT matrices.
        lower: Lower bounds (nf,).
        upper: Upper bounds (nf,).
        bounded: Free variable that each bound is on (nb,).
        num_lower: Number of lower bounds among them.
        held_residual: Largest residual of a row that reads no free variable.
        cost_scale: s of the cost.
        row_scales: s of the rows (ma,).
    """

    def __init__(self, nlp: PolynomialNlp, x: Floats, cost_unit: float = 1.0) -> None:
        """Holds the variables with equal bounds, and scales at x (n,), which is within bounds."""
        self._nlp, self._x = nlp, x
        self.structure = nlp.kkt_structure
        free = self.structure.free
        self.lower, self.upper = nlp.lower[free], nlp.upper[free]
        low, high = np.flatnonzero(np.isfinite(self.lower)), np.flatnonzero(np.isfinite(self.upper))
        self.bounded = np.concatenate([low, high])
        self.num_lower = low.size
        self._signs = np.repeat([1.0, -1.0], [low.size, high.size])
        self._limits = np.concatenate([self.lower[low], -self.upper[high]])
        # On a bound, which rounding leads to, barriers are infinite: a slack too small to move y.
        least = np.finfo(float).eps ** 1.5 * np.abs(self._limits)
        self._least_slacks = np.maximum(least, np.finfo(float).tiny)
        held_rows = np.delete(nlp.evaluate(x)[1], self.structure.rows)
        self.held_residual = float(np.max(np.abs(held_rows), initial=0.0))
        self._scales = np.ones(nlp.num_costs + nlp.num_rows)
        self.cost_scale, self.row_scales = self._find_scales(x, cost_unit)
        self._scales[: nlp.num_costs] = self.cost_scale
        self._scales[nlp.num_costs + self.structure.rows] = self.row_scales

    def _find_scales(self, x: Floats, cost_unit: float) -> tuple[float, Floats]:
        no_multipliers = np.zeros(self.structure.rows.size)
        gradient, band = self.structure.assemble(x, self._scales, no_multipliers)
        steepest = np.max(np.abs(gradient), initial=0.0)
        # Gradients that overflow leave scales above 0.
        slopes = np.minimum(self.structure.steepest_slopes(band), 1e300)
        relative = min(steepest / cost_unit, 1e300)
        return (
            float(_STEEPEST / max(_STEEPEST, relative) / cost_unit),
            _STEEPEST / np.maximum(_STEEPEST, slopes),
        )

    def full(self, y: Floats) -> Floats:
        """Returns all variables x (n,), held ones included."""
        x = self._x.copy()
        x[self.structure.free] = y
        return x

    def start(self, x: Floats, push: float) -> Point:
        """Returns the point of x (n,), moved inside bounds by `push` of their size and distance."""
        y, low, high = x[self.structure.free], *np.split(self.bounded, [self.num_lower])
        room = np.minimum(
            np.maximum(1.0, np.abs(self._limits)), (self.upper - self.lower)[self.bounded]
        )
        least = push * room
        y[low] = np.maximum(y[low], self.lower[low] + least[: self.num_lower])
        y[high] = np.minimum(y[high], self.upper[high] - least[self.num_lower :])
        return self.point(y)

    def point(self, y: Floats) -> Point:
        """Evaluates."""
        cost, rows = self._nlp.evaluate(self.full(y))
        slacks = np.maximum(self._signs * y[self.bounded] - self._limits, self._least_slacks)
        return Point(y, self.cost_scale * cost, self.row_scales * rows[self.structure.rows], slacks)

    def cost_rounding(self, y: Floats) -> float:
        """Returns the rounding of s f: relative to its terms, not to their sum."""
        return ROUNDING * self.cost_scale * self._nlp.cost_magnitude(self.full(y))

    def row_roundings(self, y: Floats) -> Floats:
        """Returns the rounding of each s c (ma,)."""
        magnitudes = self._nlp.row_magnitudes(self.full(y))[self.structure.rows]
        return ROUNDING * self.row_scales * magnitudes

    def linearize(self, y: Floats, multipliers: Floats) -> Linearization:
        """Differentiates, with W for these multipliers of the rows."""
        gradient, band = self.structure.assemble(self.full(y), self._scales, multipliers)
        force = self.structure.multiply(band, self.structure.join(0.0, multipliers))
        return Linearization(gradient, self.structure.split(force)[0], band)

    def bound_force(self, pushes: Floats) -> Floats:
        """Returns Σ over bounds of a push away from each (nb,), over the free variables (nf,)."""
        return self.bound_curvature(self._signs * pushes)

    def bound_curvature(self, curvatures: Floats) -> Floats:
        """Returns Σ over bounds of a curvature of each (nb,), over the free variables (nf,)."""
        total = np.zeros(self.lower.size)
        np.add.at(total, self.bounded, curvatures)
        return total

    def slack_step(self, step: Floats) -> Floats:
        """Returns the change of the slacks (nb,) with a step of the free variables."""
        return self._signs * step[self.bounded]

    def longest(self, point: Point, step: Floats, fraction: float) -> float:
        """Returns the part of a step, up to 1, that uses at most a fraction of any slack."""
        return longest(point.slacks, self.slack_step(step), fraction)


def longest(values: Floats, steps: Floats, fraction: float) -> float:
    """Returns the part of a step, up to 1, that uses at most a fraction of any of these values."""
    falling = np.max(-steps / values, initial=0.0)
    return 1.0 if falling <= fraction else float(fraction / falling)


# Wächter & Biegler 2006, sec. 3.1: shifts δ_w of the Hessian.
_FIRST_SHIFT, _LEAST_SHIFT, _LARGEST_SHIFT = 1e-4, 1e-20, 1e20
_LOWER, _RAISE_FIRST, _RAISE = 1 / 3, 100.0, 8.0
_LARGEST_ESTIMATE = 1e3  # least-squares multipliers beyond it are replaced by 0 (their sec. 3.6)

# δ_c of every KKT matrix: keeps it regular where rows depend on each other, and costs nothing at
# a solution, as it multiplies the step of the multipliers.
ROW_SHIFT = 1e-10

# Distance of a variable from its bounds that is rounding, relative to 1 and the bound.
_OUTSIDE = 1e-13

# Size of δ_w past which a step's multipliers are not used (ours, see `NewtonStep.is_distorted`).
_DISTORTING_SHIFT = 100 * _FIRST_SHIFT


@dataclass(frozen=True)
class NewtonStep:
    """A step of y and all multipliers; valid until the next one is sought.

        [W + Σ + δ_w   Aᵀ ] [dy]     [∇φ_μ + Aᵀλ]
        [A            −δ_c] [dλ] = − [c         ]       dz = μ/slack − z − Σ dslack,    Σ = z/slack

    (Wächter & Biegler 2006, eq. (11)-(13).)
    """

    dy: Floats  # Step of the free variables
    duals: Duals  # Step of the multipliers
    slope: float  # ∇φ_μᵀ dy
    shift: float  # δ_w
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
        self.problem = problem
        self._structure = problem.structure
        self._factors = make_factors(self._structure.storage, self._structure.is_row)
        self._last_shift = 0.0

    def solve(self, variables: Floats | float, rows: Floats | float) -> tuple[Floats, Floats]:
        """Solves with the matrix that was factorized last."""
        right = self._structure.join(variables, rows)
        return self._structure.split(self._factors.solve(right))

    def factorize(self, band: Floats, diagonal: Floats | float, row_shift: float) -> bool:
        """Factorizes [W + diagonal, Aᵀ; A, −row_shift]; returns if W + … is convex on A's kernel.

        It is where the matrix has as many negative eigenvalues as rows. The band is changed.
        """
        structure = self._structure
        band[0, structure.variable_places] = diagonal
        band[0, structure.row_places] = -row_shift
        return self._factors.factorize(band) == structure.rows.size

    def step(
        self, point: Point, duals: Duals, linearization: Linearization, mu: float
    ) -> NewtonStep | None:
        """Returns the step at a point; None if no shift makes the Hessian convex."""
        problem, slacks = self.problem, point.slacks
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
        """Returns λ that minimizes ‖∇φ_μ + Aᵀλ‖; 0 where that is too large to be useful."""
        problem, structure = self.problem, self._structure
        linearization = problem.linearize(point.y, np.zeros(structure.rows.size))
        descent = linearization.gradient - problem.bound_force(mu / point.slacks)
        self.factorize(structure.without_couplings(linearization.band), 1.0, ROW_SHIFT)
        estimate = self.solve(-descent, 0.0)[1]
        if not max_norm(estimate) <= _LARGEST_ESTIMATE:
            return np.zeros(structure.rows.size)
        return estimate


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
        if num_negative != multipliers.size or max_norm(outside) > _OUTSIDE:
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
