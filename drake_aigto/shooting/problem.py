"""Optimal control by shooting: a problem, its tables for compiled code, and its solution."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import AnyMechanism, TreeMechanism, calc_start_speed
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.added import NO_TERMS, AddedTerms
from drake_aigto.shooting.optimal_control import OptimalControlProblem
from drake_aigto.shooting.program import TWO_STAGES, is_implicit, make_program
from drake_aigto.shooting.solve import (
    MotionExpansion,
    ShootingOptions,
    ShootingResult,
    ShootingRun,
    Smoothing,
)
from drake_aigto.shooting.tables import Program
from drake_aigto.simulation import MOST_GROWTH, calc_growth, tangent_scales
from drake_aigto.world import Limits, Scales, Scenario, TaskCost, World

# Transitions that differ by this part are those of the motion; with more steps none is sought.
_AGREE, _MOST_SUBSTEPS = 0.1, 512
# Bounds alone are met with this penalty: with 1e4 times as much, some motions went far off for what
# they can hardly change; with 1e-4 of it, bounds were met to 1e-8 only. Steps end at 1e-12.
_MET = ShootingOptions((Smoothing(0.0, 12, 1e-26),), penalty=1e-4, multiplier_updates=0)


@dataclass(frozen=True, eq=False)
class ShootingProblem(OptimalControlProblem):
    """The best held controls u_k for a task from one start, with exact derivatives.

    Motion is integrated by Runge-Kutta steps, and the cost with it.
    """

    @classmethod
    def of(
        cls,
        world: World,
        scenario: Scenario,
        mechanism: AnyMechanism,
        times: Floats,
        added: AddedTerms = NO_TERMS,
    ) -> ShootingProblem:
        """Returns a scenario's task with a mechanism of its world, at these knots, of fixed times.

        Args:
            world: the mechanism.
            scenario: start, cost and bounds.
            mechanism: its tables, with the contact law to plan with.
            times: of the knots, shape (N + 1,) [s].
            added: terms of users.
        """
        bounds, cost = world.bounds(scenario), TaskCost.of(world, scenario)
        goal, speed = np.split(cost.hard_goal(scenario), [world.num_positions])
        in_space = isinstance(mechanism, TreeMechanism)
        turn = np.array([0.0 if scenario.hard_goal else np.nan])
        return cls(
            mechanism=mechanism,
            cost=cost,
            times=times,
            start=scenario.initial_state,
            scales=tangent_scales(world, scenario),
            state_bounds=limit_states(world, bounds),
            control_bounds=bounds.control,
            hard_goal=np.concatenate([world.in_tangent(goal, turn), speed]),
            control_norm=scenario.control_norm or np.inf,
            length=Scales.of(world, scenario).length,
            # Steps of trees need none.
            fastest=0.0 if in_space else calc_start_speed(world, scenario),
            added=added,
        )

    def solve(
        self,
        controls: Floats,
        states: Floats | None = None,
        options: ShootingOptions | None = None,
        prices: Floats | None = None,
    ) -> ShootingResult:
        """Returns a local optimum near a motion.

        Args:
            controls: u_k, shape (N, nu); those out of bounds are moved into them.
            states: q and v at knots, shape (N + 1, 2n), which need not follow from the controls;
                None: those that do.
            options: numerics.
            prices: initial ones of bounds, from a result of this problem under other options.

        Raises:
            ProgramError: a shape does not fit.
        """
        options = options or ShootingOptions()
        return self._start(controls, states, options, prices).run()

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

    def restore(self, motion: ShootingResult) -> ShootingResult:
        """Returns a motion that meets bounds at knots to rounding, as near a given one as it takes.

        Gauss-Newton steps for the violations alone, damped in units of controls' scales, converge
        quadratically. Multipliers do only as far as expansions have all curvature, and motions that
        nearly meet their bounds cost nearly as much wherever they are changed to meet them.
        """
        options = replace(_MET, substeps=motion.substeps, order=motion.order)
        question = self.starting_from(motion)
        program = question.make_program(options)
        weights, factors = ("control", "running", "final"), 0 * program.added.factors
        task = program.task._replace(**{each: 0 * getattr(program.task, each) for each in weights})
        added = program.added._replace(factors=factors)
        program = program._replace(task=task, added=added)
        met = ShootingRun(question, program, motion.controls, None, options).run()
        steps, order = motion.substeps, motion.order
        found = question.starting_from(met).simulate(met.controls, steps, order=order)
        count, prices = motion.iterations + met.iterations, motion.prices
        return replace(found, iterations=count, prices=prices, is_converged=motion.is_converged)

    def linearize(
        self,
        controls: Floats,
        substeps: int,
        smoothing: float = 0.0,
        states: Floats | None = None,
        order: int = 4,
    ) -> MotionExpansion:
        """Returns the problem about a motion, and optimal feedback gains of held controls.

        ũ_k = K_k x̃_k has the least cost to go to second order, in the Gauss-Newton form, as if
        controls had no bounds: cut to them, one that is at a bound answers what leads away from it.

        Args:
            controls: see `simulate`, as for substeps and smoothing.
            substeps: Runge-Kutta steps between knots.
            smoothing: ε in units of the problem's length.
            states: q and v of the motion at knots, shape (N + 1, 2n); None: those that the controls
                lead to.
            order: see `ShootingOptions`.

        Raises:
            ProgramError: a shape does not fit, or the motion diverges.
        """
        options = ShootingOptions((Smoothing(smoothing, 1, np.inf),), substeps, order)
        return self._start(controls, states, options).linearize()

    def resolve(
        self,
        controls: Floats,
        substeps: int,
        states: Floats | None = None,
        order: int = 4,
        is_exact: bool = False,
    ) -> tuple[MotionExpansion, int]:
        """Returns the problem about a motion, and the number of steps that resolve its friction.

        Bodies that stick have stiff friction: in explicit steps that are too long errors grow by
        powers of ten where those of the motion fade. So these are halved until their transitions
        agree. In the plane friction follows the steps, which are halved only where it has to be
        exact. In implicit steps of any length friction is stable, but springs of contacts are not:
        these steps have two stages here, and are halved only where they have to be exact, too.

        Args:
            controls: see `linearize`, as for states and order.
            substeps: Runge-Kutta steps between knots, at least.
            states: of the motion.
            order: of steps.
            is_exact: whether steps in the plane and implicit ones are halved, too.

        Raises:
            ProgramError: from `linearize`.
        """
        known: Floats | float = np.nan
        is_exact = is_exact or (
            isinstance(self.mechanism, TreeMechanism) and not is_implicit(order)
        )
        order = TWO_STAGES if is_implicit(order) else order
        while True:
            is_last = substeps >= _MOST_SUBSTEPS or not is_exact
            try:
                found = self.linearize(controls, substeps, 0.0, states, order)
            except ProgramError:  # Errors exceed all numbers.
                if is_last:
                    raise
            else:
                transitions = found.transitions * self.scales / self.scales[:, np.newaxis]
                off, size = (
                    np.linalg.norm(each, axis=(1, 2)) for each in (transitions - known, transitions)
                )
                if is_last or np.all(off <= _AGREE * size):
                    return found, substeps
                known = transitions
            substeps *= 2

    def is_unstable(self, result: ShootingResult) -> bool:
        """Returns whether errors grow so much along a result that feedback has to judge it.

        False if the result diverged: nothing follows that.
        """
        if not np.isfinite(result.states).all():
            return False
        motion = result.controls, result.substeps, result.states, result.order
        try:
            found, _ = self.resolve(*motion)
        except ProgramError:  # Its squares exceed all numbers.
            return False
        return calc_growth(found.transitions, self.scales, MOST_GROWTH).factor > MOST_GROWTH

    def estimate_error(self, result: ShootingResult) -> float:
        """Returns the error of a result's steps, against twice as many of order 4, or implicit.

        It is the larger one of the cost's change, in units of the cost or of `effort_scale` if that
        is larger, and the final state's, in units of its scales. Of an unstable result, which only
        feedback can follow, errors of all stages are added up as they are without their growth.
        """
        question = self.starting_from(result)
        if question.is_unstable(result):
            return question.add_errors(result)
        substeps, order = _refine(result)
        finer = question.simulate(result.controls, substeps, order=order)
        same = question.simulate(result.controls, result.substeps, order=result.order)
        unit = max(abs(finer.exact_cost), self.effort_scale)
        off = np.abs(self.mechanism.subtract(finer.states[-1], same.states[-1])) / self.scales
        error = max(abs(finer.exact_cost - same.exact_cost) / unit, float(off.max()))
        return error if np.isfinite(error) else np.inf

    def refine_cost(self, result: ShootingResult) -> tuple[float, float]:
        """Returns J of a result in steps of half the length, and by how much that differs.

        With friction, whose stiction speed follows the steps, it is J in its own steps.
        """
        (substeps, order), same = _refine(result), result.exact_cost
        if self.is_unstable(result):
            if (both := self._expand_twice(result)) is None:
                return same, np.inf
            finer, same = (each.cost for each in both)
        else:
            finer = self.simulate(result.controls, substeps, order=order).exact_cost
        return same if self.mechanism.has_friction else finer, abs(finer - same)

    def add_errors(self, result: ShootingResult) -> float:
        """Returns the errors of all stages of a result, added up without their growth.

        Each stage is compared with twice as many steps of order 4, or implicit ones, from its own
        state; units are those of `estimate_error`.
        """
        if (both := self._expand_twice(result)) is None:
            return np.inf
        finer, same = both
        off = np.sum(np.abs(finer.gaps - same.gaps), axis=0) / self.scales
        change = abs(finer.cost - same.cost) / max(abs(finer.cost), self.effort_scale)
        error = max(change, float(off.max()))
        return error if np.isfinite(error) else np.inf

    def _expand_twice(self, result: ShootingResult) -> tuple[MotionExpansion, ...] | None:
        """Returns the problem about a result in half its steps (`_refine`), and in its own.

        None: its squares exceed all numbers.
        """
        u, x, steps = result.controls, result.states, (result.substeps, result.order)
        try:
            return tuple(
                self.linearize(u, each, 0.0, x, order) for each, order in (_refine(result), steps)
            )
        except ProgramError:
            return None

    def make_program(self, options: ShootingOptions) -> Program:
        """Returns the tables that compiled code reads, with multipliers of their own, zero.

        The rest is made once, and what depends on them for each order and number of substeps.
        """
        key = options.substeps, options.order
        if key not in self._programs:
            other = next(iter(self._programs.values()), None)
            self._programs[key] = make_program(self, *key, other)
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
        problem = self if states is None else self.beginning_at(states[0])
        return ShootingRun(problem, self.make_program(options), controls, states, options, prices)

    def lasting(self, duration: float) -> ShootingProblem:
        """Returns the same problem with guessed durations of phases of this sum [s]."""
        if self.phases is None:
            return self
        return self._with_durations(duration / self.phases.durations.sum() * self.phases.durations)

    def starting_from(self, result: ShootingResult) -> ShootingProblem:
        """Returns the same problem with guesses of durations and of the start from a result."""
        if self.phases is None:
            return self
        return self._with_durations(result.phases.durations).beginning_at(result.states[0])

    def beginning_at(self, start: Floats) -> ShootingProblem:
        """Returns the same problem, where the start is free, with a guess of it, (nq + n,)."""
        if self.free_start is None or not np.isfinite(start).all():
            return self
        change = self.mechanism.subtract(start, self.start)
        return replace(self, free_start=replace(self.free_start, change=change))

    def _with_durations(self, durations: Floats) -> ShootingProblem:
        assert self.phases is not None
        return replace(self, phases=replace(self.phases, durations=durations))


def limit_states(world: World, bounds: Limits) -> Floats:
    """Returns bounds of q and v in the tangent space, (2, 2n); turns in space have none."""
    free = np.array([[-np.inf], [np.inf]])
    return np.hstack([world.in_tangent(bounds.position, free), bounds.velocity])


def _refine(result: ShootingResult) -> tuple[int, int]:
    """Returns the number and the order of steps that those of a result are compared with."""
    return 2 * result.substeps, result.order if is_implicit(result.order) else 4
