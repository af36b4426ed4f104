"""Optimal control by shooting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.shooting.optimal_control import OptimalControlProblem
from drake_aigto.shooting.program import make_program
from drake_aigto.shooting.solve import ShootingOptions, ShootingResult, ShootingRun, Smoothing
from drake_aigto.shooting.tables import Program


@dataclass(frozen=True, eq=False)
class ShootingProblem(OptimalControlProblem):
    """The best held controls u_k for a task from one start, with exact derivatives.

    Motion is integrated by Runge-Kutta steps, and the cost with it.
    """

    def solve(
        self,
        controls: Floats,
        states: Floats | None = None,
        options: ShootingOptions | None = None,
        prices: Floats | None = None,
        most: float = np.inf,
    ) -> ShootingResult:
        """Returns a local optimum near a motion.

        Args:
            controls: u_k, shape (N, nu); those out of bounds are moved into them.
            states: q and v at knots, shape (N + 1, 2n), which need not follow from the controls;
                None: those that do.
            options: numerics.
            prices: initial ones of bounds, from a result of this problem under other options.
            most: a motion with larger J after a pass that ended is returned as it is, and one with
                far larger J after a pass that was cut off: as bounds count more, J rises.

        Raises:
            ProgramError: a shape does not fit.
        """
        options = options or ShootingOptions()
        return self._start(controls, states, options, prices).run(most)

    def simulate(
        self, controls: Floats, substeps: int, smoothing: float = 0.0, order: int = 4
    ) -> ShootingResult:
        """Returns the motion of given controls.

        Args:
            controls: u_k, shape (N, nu); those out of bounds are moved into them.
            substeps: Runge-Kutta steps between knots.
            smoothing: ε in units of the problem's length.
            order: see `ShootingOptions`.

        Raises:
            ProgramError: a shape does not fit.
        """
        options = ShootingOptions((Smoothing(smoothing, 1, 1.0),), substeps, order)
        return self._start(controls, None, options).finish()

    def calc_gains(self, controls: Floats, substeps: int, smoothing: float = 0.0) -> Floats:
        """Returns optimal feedback gains of held controls, shape (N, nu, 2n).

        ũ_k = K_k x̃_k has the least cost to go to second order, in the Gauss-Newton form, about the
        motion of given controls. Where a control is at its bound, K_k is 0.

        Args:
            controls: see `simulate`, as for substeps and smoothing.
            substeps: Runge-Kutta steps between knots.
            smoothing: ε in units of the problem's length.

        Raises:
            ProgramError: a shape does not fit, or the motion diverges.
        """
        options = ShootingOptions((Smoothing(smoothing, 1, np.inf),), substeps)
        return self._start(controls, None, options).find_gains()

    def estimate_error(self, result: ShootingResult) -> float:
        """Returns the error of a result's steps, against twice as many of order 4.

        It is the larger one of the cost's change, in units of the cost or of `cost_scale` if that
        is larger, and the final state's, in units of its scales.
        """
        question = self.starting_from(result)
        finer = question.simulate(result.controls, 2 * result.substeps)
        same = question.simulate(result.controls, result.substeps, order=result.order)
        unit = max(abs(finer.exact_cost), self.cost_scale)
        off = np.abs(finer.states[-1] - same.states[-1]) / self.scales
        error = max(abs(finer.exact_cost - same.exact_cost) / unit, float(off.max()))
        return error if np.isfinite(error) else np.inf

    def make_program(self, options: ShootingOptions) -> Program:
        """Returns the tables that compiled code reads, with multipliers of their own, zero.

        The rest is made once for each order and number of substeps.
        """
        key = options.order, options.substeps
        if key not in self._programs:
            self._programs[key] = make_program(self, options.substeps, options.order)
        program = self._programs[key]
        multipliers = np.zeros_like(program.bounds.multipliers)
        return program._replace(bounds=program.bounds._replace(multipliers=multipliers))

    @cached_property
    def _programs(self) -> dict[tuple[int, int], Program]:
        return {}

    def _start(
        self,
        controls: Floats,
        states: Floats | None,
        options: ShootingOptions,
        prices: Floats | None = None,
    ) -> ShootingRun:
        return ShootingRun(self, self.make_program(options), controls, states, options, prices)

    def lasting(self, duration: float) -> ShootingProblem:
        """Returns the same problem with guessed durations of phases of this sum [s]."""
        if self.phases is None:
            return self
        return self._with_durations(duration / self.phases.durations.sum() * self.phases.durations)

    def starting_from(self, result: ShootingResult) -> ShootingProblem:
        """Returns the same problem with guessed durations of phases from a result."""
        return self if self.phases is None else self._with_durations(result.phases.durations)

    def _with_durations(self, durations: Floats) -> ShootingProblem:
        assert self.phases is not None
        return replace(self, phases=replace(self.phases, durations=durations))
