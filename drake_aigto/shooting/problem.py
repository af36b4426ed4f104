"""Optimal control by shooting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.bounds import measure_bounds
from drake_aigto.shooting.descent import clip_controls, descend
from drake_aigto.shooting.memory import make_memory
from drake_aigto.shooting.options import ShootingOptions, Smoothing
from drake_aigto.shooting.phases import Layout
from drake_aigto.shooting.program import copy_multipliers, count_substeps, make_program
from drake_aigto.shooting.question import ShootingQuestion
from drake_aigto.shooting.result import ShootingResult
from drake_aigto.shooting.tables import FLOW, Program

# Bounds can't be kept near a motion where so many updates in a row, each at a penalty that has
# grown, leave more than this part of what they are off.
_PATIENCE, _STUCK = 4, 0.9
# What a pass that was cut off leaves may still cost so many times less after the next ones: of 280
# motions of discs that swap places, no dearer one did.
_FALLING = 2.5


@dataclass(frozen=True, eq=False)
class ShootingProblem(ShootingQuestion):
    """The best held controls u_k for a task from one start.

        minimize J   subject to   v̇ = M⁻¹ (B u − h + Jᵀ f),   bounds on u_k, and on q, v at knots

    Motion is integrated by Runge-Kutta steps, the cost with it, and the derivatives of both are
    exact.
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
            states: q and v at knots, shape (N + 1, 2n), which need not follow from the controls
                and are taken there; None: those that do.
            options: numerics.
            prices: of bounds at first: those of a result of this problem under other options.
            most: a motion whose J is larger after a pass that ended is left as it is then, and one
                that was cut off where J is far larger: as bounds count more, J rises.

        Raises:
            ProgramError: a shape does not fit.
        """
        options = options or ShootingOptions()
        return _Descent(self, controls, states, options, prices).run(most)

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
        return _Descent(self, controls, None, options).finish(is_converged=False)

    def calc_gains(self, controls: Floats, substeps: int, smoothing: float = 0.0) -> Floats:
        """Returns how held controls best answer deviations of the state, shape (N, nu, 2n).

        ũ_k = K_k x̃_k has the least cost to go to second order, in the Gauss-Newton form, about the
        motion of given controls. Where a control is at its bound, K_k is 0.

        Args:
            controls: see `simulate`, as for substeps and smoothing.
            substeps: Runge-Kutta steps between knots.
            smoothing: ε in units of the problem's length.

        Raises:
            ProgramError: a shape does not fit, or the motion runs away.
        """
        options = ShootingOptions((Smoothing(smoothing, 1, np.inf),), substeps)
        return _Descent(self, controls, None, options).find_gains()

    def estimate_error(self, result: ShootingResult) -> float:
        """Returns how far off the steps of a result are: against twice as many of order 4.

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

    def refine(
        self,
        result: ShootingResult,
        options: ShootingOptions | None = None,
        tolerance: float = 1e-3,
        most_substeps: int = 64,
    ) -> ShootingResult:
        """Returns the optimum near a result with as many substeps as its accuracy takes.

        Args:
            result: of this problem.
            options: numerics; the last rung alone is run, with twice the substeps each time.
            tolerance: of `estimate_error`.
            most_substeps: where it ends anyway.
        """
        options = options or ShootingOptions()
        while result.substeps < most_substeps and self.estimate_error(result) > tolerance:
            finer = replace(options, rungs=options.rungs[-1:], substeps=2 * result.substeps)
            problem = self.starting_from(result)
            result = problem.solve(result.controls, None, finer, result.prices)
        return result

    def make_program(self, options: ShootingOptions) -> Program:
        """Returns the tables that compiled code reads, with multipliers of their own, zero.

        All else is made once for each order and number of substeps.
        """
        key = options.order, options.substeps
        if key not in self._programs:
            self._programs[key] = make_program(self, self.layout, options)
        return copy_multipliers(self._programs[key])

    @cached_property
    def _programs(self) -> dict[tuple[int, int], Program]:
        return {}

    @cached_property
    def layout(self) -> Layout:
        """Its stages."""
        return Layout.of(self.times, self.phases, self.mechanism.num_contacts)

    @property
    def rubbing_substeps(self) -> int:
        """In how many Runge-Kutta steps between knots friction is as steep as the world has it."""
        return count_substeps(self)

    @property
    def knot_times(self) -> Floats:
        """When knots are [s], shape (N + 1,), where phases last as long as at first."""
        if self.phases is None:
            return self.times
        return self.layout.calc_times(self.phases.durations)

    def lasting(self, duration: float) -> ShootingProblem:
        """Returns the same problem, whose phases, if any, last so long in sum at first [s]."""
        if self.phases is None:
            return self
        durations = self.phases.durations * (duration / self.phases.durations.sum())
        return replace(self, phases=replace(self.phases, durations=durations))

    def starting_from(self, result: ShootingResult) -> ShootingProblem:
        """Returns the same problem, whose phases last as long at first as those of a result."""
        if self.phases is None:
            return self
        return replace(self, phases=replace(self.phases, durations=result.durations))


class _Descent:
    """One solve: the motion, the multipliers and the memory."""

    def __init__(
        self,
        problem: ShootingProblem,
        controls: Floats,
        states: Floats | None,
        options: ShootingOptions,
        prices: Floats | None = None,
    ) -> None:
        """Takes the motion's shape from the problem."""
        self._problem, self._options, self._has_gaps = problem, options, states is not None
        self._layout, self._program = problem.layout, problem.make_program(options)
        self._controls = self._lay_out_controls(controls)
        self._states = self._lay_out_states(states)
        clip_controls(self._program, self._controls)
        self._memory = make_memory(self._program, len(self._controls), self._states.shape[1])
        self._penalty, self._violation = options.penalty * problem.cost_scale, np.inf
        # Of the controls, once a rung has been run.
        self._cost, self._has_run = np.inf, False
        if prices is not None:
            self._take_prices(prices)
        self._iterations, self._has_ended, self._is_left = 0, False, False

    @property
    def _multipliers(self) -> tuple[Floats, ...]:
        """Those of all bounds at knots."""
        of = self._program.bounds
        contacts = of.approach_multipliers, of.mode_multipliers
        return of.multipliers, of.distance_multipliers, *contacts

    def _take_prices(self, prices: Floats) -> None:
        ends = np.cumsum([1, *(own.size for own in self._multipliers)])
        self._penalty = float(_take("prices", prices, (int(ends[-1]),))[0])
        for own, known in zip(self._multipliers, np.split(prices, ends)[1:], strict=False):
            own[...] = known.reshape(own.shape)

    def _lay_out_controls(self, controls: Floats) -> Floats:
        """Returns what each stage chooses, shape (K, nu): durations where phases start."""
        problem, layout = self._problem, self._layout
        nu = problem.mechanism.num_controls
        chosen = np.zeros((len(layout.kinds), nu))
        chosen[layout.flights] = _take("controls", controls, (len(layout.flights), nu))
        if problem.phases is not None:
            chosen[layout.starts, 0] = problem.phases.durations
        return chosen

    def _lay_out_states(self, states: Floats | None) -> Floats:
        """Returns z at each stage, shape (K + 1, nz), and at the end."""
        problem, layout = self._problem, self._layout
        K, N, nx = len(layout.kinds), len(problem.times) - 1, len(problem.start)
        laid = np.zeros((K + 1, nx + (0 if problem.phases is None else 2)))
        if states is not None:
            knots = np.cumsum(layout.kinds == FLOW)
            laid[:, :nx] = _take("states", states, (N + 1, nx))[np.concatenate([[0], knots])]
        laid[0, :nx] = problem.start
        if problem.phases is not None:
            laid[0, nx:] = problem.phases.durations[0], 0.0
            phase = np.cumsum(layout.kinds != FLOW) - 1
            laid[1:, nx] = problem.phases.durations[phase]
            laid[1:, nx + 1] = np.cumsum(layout.shares * laid[1:, nx])
        return laid

    def run(self, most: float) -> ShootingResult:
        """Runs all rungs, then the last one until bounds hold, or J is above the most."""
        rungs = self._choose_rungs()
        is_converged = False
        for rung in rungs:
            is_converged = self._run_rung(rung)
        stuck = 0
        for _ in range(self._options.multiplier_updates if self._program.bounds.is_any else 0):
            is_done = self._violation <= self._options.feasibility or stuck == _PATIENCE
            if is_done or self._costs_more(most):
                break
            before = self._violation
            is_converged = self._run_rung(rungs[-1])
            stuck = stuck + 1 if self._violation > _STUCK * before else 0
        return self.finish(is_converged)

    def _costs_more(self, most: float) -> bool:
        """Returns whether J is above the most after the last pass, far above if it was cut off."""
        return self._cost > (most if self._has_ended else most + (_FALLING - 1) * abs(most))

    def find_gains(self) -> Floats:
        """Returns the gains of one sweep about the motion: no gain is worth a step here."""
        cost, _, is_converged, _ = self._descend(self._options.rungs[-1], self._states)
        if not is_converged:
            raise ProgramError(
                "controls", got=f"a motion that costs {cost}", expected="a finite one"
            )
        gains = self._memory.sweep.gains[self._layout.flights]
        return np.array(gains[:, :, : len(self._problem.start)])

    def _choose_rungs(self) -> tuple[Smoothing, ...]:
        """Returns the rungs; without springs and friction, one."""
        rungs = self._options.rungs
        mechanics = self._program.mechanics
        if np.any(mechanics.contacts[:, 0] > 0) or len(mechanics.rubs):
            return rungs
        return (rungs[-1]._replace(iterations=sum(rung.iterations for rung in rungs)),)

    def _run_rung(self, rung: Smoothing) -> bool:
        """Returns whether a rung ended in its tolerance; updates multipliers."""
        self._cost, count, is_converged, self._is_left = self._descend(rung, self._states)
        self._has_run, self._has_ended = True, count < rung.iterations
        self._iterations, self._has_gaps = self._iterations + count, False
        if self._program.bounds.is_any:
            self._update_multipliers()
        return is_converged

    def _descend(self, rung: Smoothing, states: Floats) -> tuple[float, int, bool, bool]:
        """Returns the cost without penalties, how many iterations it took, and how they ended."""
        is_last = rung.smoothing == self._options.rungs[-1].smoothing
        return descend(
            self._program,
            states,
            self._controls,
            rung.smoothing * self._problem.length,
            self._penalty,
            rung.iterations,
            rung.tolerance,
            1e-3 * self._problem.cost_scale,
            self._has_gaps,
            self._options.is_wary,
            self._options.most_promised if is_last else np.inf,
            self._memory,
        )

    def _update_multipliers(self) -> None:
        before = self._violation
        self._violation = measure_bounds(
            self._program, self._states, self._controls, self._penalty, True, self._memory
        )
        if self._violation > before / 4:
            self._penalty *= 10

    def finish(self, is_converged: bool) -> ShootingResult:
        """Returns the motion of the controls, and what it costs."""
        last = self._options.rungs[-1]._replace(iterations=0)
        cost = self._cost
        if not self._has_run:
            cost, _, _, _ = self._descend(last, self._states)
        exact = cost
        if last.smoothing:
            exact, _, _, _ = self._descend(last._replace(smoothing=0.0), self._states.copy())
        problem, layout, nx = self._problem, self._layout, len(self._problem.start)
        at_knots = self._states[[*layout.flights, -1]]
        return ShootingResult(
            times=problem.times if problem.phases is None else at_knots[:, nx + 1],
            states=at_knots[:, :nx],
            controls=self._controls[layout.flights],
            cost=cost if np.isfinite(cost) else np.inf,
            exact_cost=exact if np.isfinite(exact) else np.inf,
            violation=self._find_violation(),
            iterations=self._iterations,
            is_converged=is_converged,
            smoothing=last.smoothing * self._problem.length,
            substeps=self._options.substeps,
            order=self._options.order,
            durations=self._controls[layout.starts, 0],
            prices=np.concatenate([[self._penalty], *map(np.ravel, self._multipliers)]),
            is_left=self._is_left,
        )

    def _find_violation(self) -> float:
        """Returns how far bounds are off, which the last rung has measured if there are any."""
        if self._has_run and self._program.bounds.is_any:
            return self._violation
        return measure_bounds(self._program, self._states, self._controls, 1.0, False, self._memory)


def _take(name: str, values: Floats, shape: tuple[int, ...]) -> Floats:
    """Returns a copy to work on.

    Raises:
        ProgramError: its shape is another.
    """
    array = np.array(values, dtype=float)
    if array.shape != shape:
        raise ProgramError(name, got=f"shape {array.shape}", expected=f"{shape}")
    return array
