"""A primal-dual interior point method with a filter line search, for sparse problems."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError, check_counts, check_positive
from drake_aigto.local import newton
from drake_aigto.local.kkt import max_norm
from drake_aigto.local.line_search import Filter, LineSearch, Progress, restore
from drake_aigto.local.nlp import LocalIterate, LocalResult, LocalStatus, PolynomialNlp

# Wächter & Biegler's names and values.
_KAPPA_EPSILON = 10.0  # a barrier problem is solved once its error is below κ_ε μ
_KAPPA_MU, _THETA_MU = 0.2, 1.5  # μ ← min(κ_μ μ, μ^θ_μ)
_TAU_MIN = 0.99  # least share of a slack or bound multiplier that a step may use
_KAPPA_SIGMA = 1e10  # how far z may leave μ/slack
_S_MAX = 100.0  # mean multiplier beyond which optimality is measured relative to it
_REQUIRED_REDUCTION = 0.9  # of θ, by a restoration

# Ours.
_UNBOUNDED = 1e20
_EXTRA_STEPS = 3  # from a solution within the tolerances on, for residuals down to rounding


@dataclass(frozen=True)
class InteriorPoint:
    """Minimizes f(x) subject to c(x) = 0, lower ≤ x ≤ upper from a start, to a local optimum.

    Newton's method with the exact Hessian on

        ∇f + Aᵀλ − z_lower + z_upper = 0,    c = 0,    z · slack = μ,    μ → 0

    after Wächter & Biegler (2006), "On the implementation of an interior-point filter line-search
    algorithm for large-scale nonlinear programming", Math. Program. 106:25-57 (IPOPT). Without
    bounds it is a filter SQP-Newton method. Where it differs: the KKT matrix is a band, its LDLᵀ
    factors cost O(n b²), unless dense or sparse ones are predicted to cost less; λ is reset to
    least-squares multipliers after steps that needed a large shift of the Hessian; the restoration
    is a Levenberg-Marquardt method; bounds are not relaxed.

    For a start that is almost a solution, `InteriorPoint.warm()` holds closer to it.

    Attributes:
        tolerance: Largest scaled optimality error and residual of a solution.
        feasibility: Largest residual |s_i c_i| that a solution is given a few more steps for;
            s_i ≤ 1 scales rows that are steep at the start.
        max_iterations: Newton and restoration steps.
        initial_barrier: First μ.
        cost_unit: Size of a cost that matters; the tolerance is in this unit.
        bound_push: Least distance of the start from a bound b, relative to max(1, |b|) and to the
            distance between a variable's bounds.
    """

    tolerance: float = 1e-8
    feasibility: float = 1e-12
    max_iterations: int = 500
    initial_barrier: float = 0.1
    cost_unit: float = 1.0
    bound_push: float = 1e-2

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_positive(self, "tolerance", "feasibility", "initial_barrier", "cost_unit")
        check_positive(self, "bound_push", below=0.5)
        check_counts(self, max_iterations=0)

    @classmethod
    def warm(cls, **options: Any) -> InteriorPoint:
        """Returns options for a start near a solution: a small μ, and almost no push off bounds."""
        return cls(**{"initial_barrier": 1e-6, "bound_push": 1e-9, **options})

    def solve(self, nlp: PolynomialNlp, x0: ArrayLike) -> LocalResult:
        """Solves from x0 (n,), which is moved into the bounds first.

        Raises:
            OptionsError: x0 has another shape, or is not finite.
        """
        start = np.array(x0, dtype=float)
        if start.shape != (nlp.num_variables,):
            raise OptionsError("x0", got=f"shape {start.shape}", expected=f"({nlp.num_variables},)")
        if not np.all(np.isfinite(start)):
            raise OptionsError(
                "x0",
                got=f"{np.count_nonzero(~np.isfinite(start))} entries that are NaN or infinite",
                expected="finite numbers",
                remedy="Fill in the guess; Drake's initial guess is NaN where nothing was set.",
            )
        return _InteriorPointRun(self, nlp, np.clip(start, nlp.lower, nlp.upper)).run()


class _Optimality(NamedTuple):
    """Stationarity and complementarity: eq. (5) without the rows."""

    stationarity: float
    products: Floats  # z · slack of every bound
    bound_scale: float

    def error(self, mu: float) -> float:
        """Returns how far the barrier problem's optimality conditions are from holding."""
        return max(self.stationarity, max_norm(self.products - mu) / self.bound_scale)


class _InteriorPointRun:
    """One run: the iterate, and the memory of the way to it."""

    def __init__(self, options: InteriorPoint, nlp: PolynomialNlp, start: Floats) -> None:
        self._options = options
        self._nlp = nlp
        self._problem = newton.ScaledProblem(nlp, start, options.cost_unit)
        self._search = newton.NewtonSearch(self._problem)
        has_bounds = self._problem.bounded.size > 0
        self._mu = options.initial_barrier if has_bounds else 0.0
        self._least_mu = options.tolerance / 10 if has_bounds else 0.0
        self._point = self._problem.start(start, options.bound_push)
        self._filter = Filter(self._point.violation)
        self._duals = newton.Duals(
            np.zeros(self._point.rows.size), np.zeros(self._point.slacks.size)
        )
        self._progress = Progress()
        self._history: list[LocalIterate] = []
        self._iterations = self._extra_steps = 0
        self._is_solution = False

    def run(self) -> LocalResult:
        """Iterates until a status is found."""
        if not np.isfinite(self._point.barrier(self._mu) + self._point.violation):
            return self._result(LocalStatus.NOT_FINITE)
        if self._problem.held_residual > self._options.tolerance:
            return self._result(LocalStatus.INFEASIBLE)
        self._duals = self._fresh_duals(self._point)
        step: newton.NewtonStep | None = None
        status, length = None, 0.0
        while status is None:
            linearization = self._problem.linearize(self._point.y, self._duals.rows)
            optimality = self._optimality(linearization)
            cost, residual = self._point.cost / self._problem.cost_scale, max_norm(self._point.rows)
            shift, error = step.shift if step else 0.0, optimality.error(0.0)
            self._history.append(LocalIterate(cost, residual, error, self._mu, shift, length))
            status = self._status(optimality)
            if status is None:
                self._lower_barrier(optimality)
                step = self._search.step(self._point, self._duals, linearization, self._mu)
                self._iterations += 1
                status, length = self._advance(step, optimality)
        return self._result(status)

    def _status(self, optimality: _Optimality) -> LocalStatus | None:
        """Returns whether the current point ends the run."""
        tolerance, residual = self._options.tolerance, max_norm(self._point.rows)
        self._is_solution = optimality.error(0.0) <= tolerance and residual <= tolerance
        if self._is_solution:
            if residual <= self._options.feasibility or self._extra_steps == _EXTRA_STEPS:
                return LocalStatus.CONVERGED
            self._extra_steps += 1
        if max_norm(self._point.y) > _UNBOUNDED:
            return LocalStatus.UNBOUNDED
        if self._iterations >= self._options.max_iterations:
            return LocalStatus.ITERATION_LIMIT
        return None

    def _optimality(self, linearization: newton.Linearization) -> _Optimality:
        z, multipliers = self._duals.bounds, self._duals.rows
        force = linearization.gradient + linearization.row_force - self._problem.bound_force(z)
        of_bounds = float(np.sum(z))
        of_all = of_bounds + float(np.sum(np.abs(multipliers)))
        scale = max(_S_MAX, of_all / max(1, z.size + multipliers.size)) / _S_MAX
        bound_scale = max(_S_MAX, of_bounds / max(1, z.size)) / _S_MAX
        return _Optimality(max_norm(force) / scale, z * self._point.slacks, bound_scale)

    def _lower_barrier(self, optimality: _Optimality) -> None:
        """Lowers μ for as long as its barrier problem is solved well enough, eq. (7), or can be."""
        while self._mu > self._least_mu:
            error = max(optimality.error(self._mu), max_norm(self._point.rows))
            if error > _KAPPA_EPSILON * self._mu and not self._progress.has_ended:
                break
            self._mu = max(self._least_mu, min(_KAPPA_MU * self._mu, self._mu**_THETA_MU))
            self._filter.clear()
            self._progress.restart()

    def _advance(
        self, step: newton.NewtonStep | None, optimality: _Optimality
    ) -> tuple[LocalStatus | None, float]:
        """Takes a step, or restores feasibility.

        Returns:
            The status if neither works, and the step length.
        """
        if step is None:
            return (LocalStatus.CONVERGED if self._is_solution else LocalStatus.STALLED), 0.0
        fraction = max(_TAU_MIN, 1.0 - self._mu)
        search = LineSearch(self._problem, self._filter, self._point, self._mu, fraction)
        found = None if self._progress.has_ended else search.run(step)
        if found is None:
            if self._rows_hold():
                return self._stuck(step, optimality, search.rounding), 0.0
            return self._restore(), 0.0
        point, length = found
        self._progress.add(
            (self._point.violation, point.violation),
            (self._point.barrier(self._mu), point.barrier(self._mu)),
            search.rounding,
            optimality.error(self._mu),
        )
        multipliers = self._duals.rows + length * step.duals.rows
        bound_length = newton.longest(self._duals.bounds, step.duals.bounds, fraction)
        z = self._duals.bounds + bound_length * step.duals.bounds
        near = self._mu / point.slacks
        z = np.clip(z, near / _KAPPA_SIGMA, near * _KAPPA_SIGMA)  # eq. (16)
        if step.is_distorted:
            multipliers = self._search.least_squares_multipliers(point, self._mu)
        self._point, self._duals = point, newton.Duals(multipliers, z)
        return None, length

    def _stuck(
        self, step: newton.NewtonStep, optimality: _Optimality, rounding: float
    ) -> LocalStatus:
        """Returns the status where rows hold and no step helps: converged if rounding stops it.

        A gradient beyond the tolerance is overlooked where Newton's step changes φ by less than its
        rounding, unless it is the shift that makes the step short.
        """
        # A step that corrects rounding of the rows changes φ at the multipliers' price.
        of_rows = self._problem.row_roundings(self._point.y)
        rounding += float(np.abs(self._duals.rows) @ of_rows)
        complementarity = max_norm(optimality.products) / optimality.bound_scale
        is_solution = self._is_solution or (
            not step.is_distorted
            and abs(step.slope) <= rounding
            and complementarity <= self._options.tolerance
        )
        return LocalStatus.CONVERGED if is_solution else LocalStatus.STALLED

    def _rows_hold(self) -> bool:
        """Returns whether residuals are within the tolerance, but for rounding."""
        residuals, tolerance = np.abs(self._point.rows), self._options.tolerance
        return max_norm(residuals) <= tolerance or bool(
            np.all(residuals <= tolerance + self._problem.row_roundings(self._point.y))
        )

    def _restore(self) -> LocalStatus | None:
        """Moves to a point of less violation that the filter accepts."""
        violation = self._point.violation
        self._filter.add(violation, self._point.barrier(self._mu))
        point, taken = restore(
            self._search,
            self._point,
            lambda p: (
                p.violation <= _REQUIRED_REDUCTION * violation
                and self._filter.accepts(p.violation, p.barrier(self._mu))
            ),
            self._options.max_iterations - self._iterations,
        )
        self._iterations += taken
        if point is None:
            ran_out = self._iterations >= self._options.max_iterations
            return LocalStatus.ITERATION_LIMIT if ran_out else LocalStatus.INFEASIBLE
        self._point, self._duals = point, self._fresh_duals(point)
        self._progress.restart()
        return None

    def _fresh_duals(self, point: newton.Point) -> newton.Duals:
        multipliers = self._search.least_squares_multipliers(point, self._mu)
        return newton.Duals(multipliers, self._mu / point.slacks)

    def _result(self, status: LocalStatus) -> LocalResult:
        """Unscales."""
        problem, nlp = self._problem, self._nlp
        free, scale = problem.structure.free, problem.cost_scale
        x = problem.full(self._point.y)
        cost, rows = nlp.evaluate(x)
        multipliers, z = np.zeros(nlp.num_rows), np.zeros((2, nlp.num_variables))
        multipliers[problem.structure.rows] = self._duals.rows * problem.row_scales / scale
        is_upper = (np.arange(problem.bounded.size) >= problem.num_lower).astype(int)
        z[is_upper, free[problem.bounded]] = self._duals.bounds / scale
        optimality = self._history[-1].optimality if self._history else np.inf
        return LocalResult(
            *(x, cost, status, self._iterations, max_norm(rows), optimality),
            *(multipliers, z[0], z[1], problem.structure.storage, tuple(self._history)),
        )
