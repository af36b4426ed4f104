"""The other gradient peer: Drake's SNOPT on the transcription that our shooting solves.

Multiple shooting: states at knots and held controls, each stage by the same Runge-Kutta steps with
the same exact derivatives. Where walls yield, their force is smoothed less and less, as we do.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractValue, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from benchmarks.robots.ipopt import MAX_ITERATIONS
from benchmarks.robots.judge import Control
from drake_aigto.shooting import ShootingOptions, ShootingProblem, expand_motion, make_memory

_OPTIONS = ShootingOptions(substeps=2)


class Transcription:
    """Variables are z₁, …, z_K and u₀, …, u_{K−1}; rows are f(z_k, u_k) − z_{k+1} = 0."""

    def __init__(self, problem: ShootingProblem) -> None:
        """Makes Drake's program of a problem between walls that yield, or without any."""
        self._problem, self._tables = problem, problem.make_program(_OPTIONS)
        bounds, (K, nu) = self._tables.bounds, self._tables.bounds.lower_control.shape
        self._stages, self._nz, self._nu = K, len(problem.start), nu
        self._memory = make_memory(self._tables)
        self._smoothing, self._at = 0.0, np.full(K * (self._nz + nu), np.nan)
        self._cost = np.inf
        self._prog = MathematicalProgram()
        x = self._prog.NewContinuousVariables(self._at.size)
        lower = np.concatenate([bounds.lower[1:].ravel(), bounds.lower_control.ravel()])
        upper = np.concatenate([bounds.upper[1:].ravel(), bounds.upper_control.ravel()])
        self._prog.AddBoundingBoxConstraint(lower, upper, x)
        self._prog.AddCost(self._calc_cost, x)
        rest = np.zeros(K * self._nz)
        rows = self._prog.AddConstraint(self._calc_rows, rest, rest, x)
        rows.evaluator().SetGradientSparsityPattern(list(zip(*self._pattern(), strict=True)))

    def _pattern(self) -> tuple[Sequence[int], Sequence[int]]:
        """Returns the rows and columns where derivatives may differ from zero."""
        self._memory.expansion.F[:] = 1.0
        rows, columns = np.nonzero(self._lay_out())
        return rows.tolist(), columns.tolist()

    def _lay_out(self) -> np.ndarray:
        """Returns the rows' derivatives by all variables."""
        K, nz, nu = self._stages, self._nz, self._nu
        F, slopes = self._memory.expansion.F, np.zeros((K, nz, K * (nz + nu)))
        for k in range(K):
            slopes[k, :, k * nz : (k + 1) * nz] = -np.eye(nz)
            slopes[k, :, K * nz + k * nu : K * nz + (k + 1) * nu] = F[k, :, nz:]
            if k > 0:
                slopes[k, :, (k - 1) * nz : k * nz] = F[k, :, :nz]
        return slopes.reshape(K * nz, -1)

    def _expand(self, x: np.ndarray) -> None:
        """Computes cost, rows and derivatives, once at each point."""
        if np.array_equal(x, self._at):
            return
        size = self._stages * self._nz
        states = np.vstack([self._problem.start, x[:size].reshape(-1, self._nz)])
        controls = x[size:].reshape(-1, self._nu).copy()
        self._cost = expand_motion(self._tables, states, controls, self._smoothing, self._memory)
        self._at = np.array(x)

    def _calc_cost(self, x: np.ndarray) -> Any:
        """Returns J; Drake's solvers ask with all derivatives of x by itself, the identity."""
        self._expand(ExtractValue(x).ravel() if x.dtype == object else x)
        l1 = self._memory.expansion.l1
        slope = np.concatenate([l1[1:, : self._nz].ravel(), l1[:-1, self._nz :].ravel()])
        return AutoDiffXd(self._cost, slope) if x.dtype == object else self._cost

    def _calc_rows(self, x: np.ndarray) -> Any:
        """Returns the rows, likewise."""
        self._expand(ExtractValue(x).ravel() if x.dtype == object else x)
        gaps = self._memory.expansion.gaps.reshape(-1, 1)
        return InitializeAutoDiff(gaps, self._lay_out()) if x.dtype == object else gaps

    def solve(self, states: np.ndarray, controls: np.ndarray) -> tuple[float, Control]:
        """Returns J and the held control; infinite if a rung is not solved.

        Args:
            states: q and v of the guess at the knots (N + 1, 2n).
            controls: of the guess (N, nu).
        """
        options = SolverOptions()
        options.SetOption(SnoptSolver.id(), "Major iterations limit", MAX_ITERATIONS)
        guess = np.concatenate([states[1:].ravel(), controls.ravel()])
        for rung in _OPTIONS.rungs:
            self._smoothing = rung.smoothing * self._problem.length
            self._at[:] = np.nan
            result = SnoptSolver().Solve(self._prog, guess, options)
            guess = result.get_x_val()
            if not result.is_success():
                break
        values = guess[-controls.size :].reshape(controls.shape)
        promised = result.get_optimal_cost() if result.is_success() else np.inf
        return promised, Control(self._problem.times, values)
