"""Local optima by the planner's own shooting, from random controls: what plans have to beat.

The plan itself: each process has one planner a world.

The other gradient peer: Drake's SNOPT on the transcription that our shooting solves.

Multiple shooting: states at knots and held controls, each stage by the same Runge-Kutta steps with
the same exact derivatives. Where walls yield, their force is smoothed less and less, as we do.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from pydrake.autodiffutils import AutoDiffXd, ExtractValue, InitializeAutoDiff
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from benchmarks.robots.ipopt import MAX_ITERATIONS
from benchmarks.robots.judge import Control
from benchmarks.robots.worlds import Question, scenario_of
from drake_aigto.contact import Mechanism, contact_law
from drake_aigto.errors import AigtoError
from drake_aigto.planning import Planner, PlanOptions
from drake_aigto.shooting import (
    Phases,
    ShootingOptions,
    ShootingProblem,
    ShootingResult,
    Smoothing,
    expand_motion,
    make_memory,
)
from drake_aigto.simulation import replay_drake, state_scales
from drake_aigto.world import Scales, Scenario, TaskCost, World

# They soon tell whether a start is any good.
_COARSE = ShootingOptions(
    rungs=tuple(Smoothing(smoothing, 15, 1e-2) for smoothing in (0.1, 0.01, 0.001)),
    order=2,
    multiplier_updates=0,
)
# What was closed roughly is made exact where it is so near the best: most isn't.
_PROMISING = 1.03
_EXACT = ShootingOptions(rungs=ShootingOptions().rungs[-1:], substeps=2)
# How far bounds may be missed, in parts of the scales, and touches that are listed.
_NEARLY, _HARDLY = 1e-2, 1e-3
# Of J and of the final state, for the steps of an exact motion; and how many steps at most.
_TOLERANCE, _MOST_SUBSTEPS = 1e-4, 32


@cache
def world_of(name: str) -> World:
    """Returns the plant of a world, built once a process."""
    return World.from_scenario(scenario_of(Question(name, 0)))


@cache
def _mechanism(name: str, restitution: float) -> Mechanism:
    world = world_of(name)
    scenario = dataclasses.replace(scenario_of(Question(name, 0)), restitution=restitution)
    return Mechanism.of(world, contact_law(world, scenario))


def pose(question: Question, phases: Phases | None = None) -> ShootingProblem:
    """Returns the question as shooting takes it."""
    scenario, world = scenario_of(question), world_of(question.world)
    bounds, cost = world.bounds(scenario), TaskCost.of(world, scenario)
    return ShootingProblem(
        mechanism=_mechanism(question.world, scenario.restitution),
        cost=cost,
        times=np.linspace(0.0, scenario.duration, scenario.num_steps + 1),
        start=np.concatenate([scenario.initial_position, scenario.initial_velocity]),
        scales=state_scales(world, scenario),
        state_bounds=np.hstack([bounds.position, bounds.velocity]),
        control_bounds=bounds.control,
        hard_goal=cost.hard_goal(scenario),
        control_norm=scenario.control_norm or np.inf,
        length=Scales.of(world, scenario).length,
        phases=phases,
    )


def shoot(
    problems: Iterable[ShootingProblem], guesses: Iterable[np.ndarray]
) -> Iterator[tuple[float, Control]]:
    """Yields J and the control that shooting makes of others (N, nu); infinite if not promising.

    Closed roughly first, as the planner closes its guesses.
    """
    best = np.inf
    for problem, guess in zip(problems, guesses, strict=False):
        found = problem.solve(guess, None, _COARSE)
        is_rough = found.violation > _NEARLY or found.exact_cost > _PROMISING * best
        if problem.phases is not None or not is_rough:
            found = _finish(problem, found)
            is_rough = found.violation > (_NEARLY if problem.phases is None else _HARDLY)
        if not is_rough:
            best = min(best, found.exact_cost)
        yield np.inf if is_rough else found.exact_cost, Control(found.times, found.controls)


def _finish(problem: ShootingProblem, found: ShootingResult) -> ShootingResult:
    """Returns the local optimum near a rough one, with as many substeps as its accuracy takes."""
    found = problem.starting_from(found).solve(found.controls, found.states, _EXACT)
    while found.substeps < _MOST_SUBSTEPS and problem.estimate_error(found) > _TOLERANCE:
        finer = dataclasses.replace(_EXACT, substeps=2 * found.substeps)
        found = problem.starting_from(found).solve(found.controls, None, finer, found.prices)
    return found


def list_phases(scenario: Scenario, walls: int, most: int, rng: np.random.Generator) -> Phases:
    """Returns a sequence of at most `most` touches, drawn evenly, at random times."""
    N, T = scenario.num_steps, scenario.duration
    listed = [
        sequence
        for touches in range(most + 1)
        for sequence in itertools.product(range(walls), repeat=touches)
    ]
    sequence = listed[rng.integers(len(listed))]
    shares = rng.dirichlet(np.full(len(sequence) + 1, 2.0))
    knots = np.linspace(0, N, len(sequence) + 2).astype(int)[1:-1]
    return Phases(np.array(sequence), knots, T * (0.9 * shares + 0.1 / len(shares)), (T, T))


_OPTIONS = PlanOptions(confirm=False, threads=1)


@cache
def _planner(world: str, restitution: float) -> Planner:
    scenario = dataclasses.replace(scenario_of(Question(world, 0)), restitution=restitution)
    return Planner(scenario, _OPTIONS, world_of(world))


def find_plan(question: Question) -> tuple[float, Control]:
    """Returns J that the plan promises, infinite if there is none, and its control."""
    scenario, world = scenario_of(question), world_of(question.world)
    try:
        plan = _planner(question.world, scenario.restitution).plan(
            scenario.initial_position,
            scenario.initial_velocity,
            scenario.goal_position,
            duration=scenario.duration,
        )
    except AigtoError:
        nothing = np.zeros((1, world.num_actuators))
        return np.inf, Control.even(nothing, scenario.duration)
    return plan.cost, Control(plan.trajectory.times, plan.trajectory.controls)


def replay_in_drake(question: Question, control: Control) -> float:
    """Returns J of a control on Drake's plant."""
    return replay_drake(world_of(question.world), scenario_of(question), *control).cost


_LADDER_OPTIONS = ShootingOptions(substeps=2)


class Transcription:
    """Variables are z₁, …, z_K and u₀, …, u_{K−1}; rows are f(z_k, u_k) − z_{k+1} = 0."""

    def __init__(self, problem: ShootingProblem) -> None:
        """Makes Drake's program of a problem between walls that yield, or without any."""
        self._problem, self._tables = problem, problem.make_program(_LADDER_OPTIONS)
        bounds, nz = self._tables.bounds, len(problem.start)
        K, nu = bounds.lower_control.shape
        self._stages, self._nz, self._nu = K, nz, nu
        self._memory = make_memory(self._tables)
        self._smoothing, self._at = 0.0, np.full(K * (self._nz + nu), np.nan)
        self._cost = np.inf
        self._prog = MathematicalProgram()
        x = self._prog.NewContinuousVariables(self._at.size)
        lower = np.concatenate([bounds.lower[1:, :nz].ravel(), bounds.lower_control.ravel()])
        upper = np.concatenate([bounds.upper[1:, :nz].ravel(), bounds.upper_control.ravel()])
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
        for rung in _LADDER_OPTIONS.rungs:
            self._smoothing = rung.smoothing * self._problem.length
            self._at[:] = np.nan
            result = SnoptSolver().Solve(self._prog, guess, options)
            guess = result.get_x_val()
            if not result.is_success():
                break
        values = guess[-controls.size :].reshape(controls.shape)
        promised = result.get_optimal_cost() if result.is_success() else np.inf
        return promised, Control(self._problem.times, values)
