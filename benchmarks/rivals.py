"""Rivals of plans on any task: IPOPT, shooting and samplers, each from random controls.

Where contact is compliant or none, IPOPT and our shooting start from roll-outs, with contact wide
at first. Where walls are rigid, shooting has listed touches. Samplers have controls that are linear
between a few knots, for balls `baselines.sampling`'s. Of balls, `benchmarks.optima` says the least
cost, where it knows it.
"""

from __future__ import annotations

import dataclasses
import itertools
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import TypeAlias

import numpy as np

from benchmarks.baselines import run_baseline, weigh
from benchmarks.local_peers import casadi
from benchmarks.optima import block_optimum, masses_optimum, walls_optimum
from benchmarks.robots.judge import Control
from benchmarks.shooting_ipopt import ShootingProgram
from drake_aigto import AigtoError, PlanOptions, Scenario, World
from drake_aigto.arrays import Floats
from drake_aigto.planning import make_mechanism_task, needs_shooting
from drake_aigto.shooting import Phases, ShootingOptions, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import replay_event_driven

_Found: TypeAlias = Iterator[tuple[float, Control]]

# What promises more than this times the best is not replayed.
_PROMISING = 1.05
_MOST_TOUCHES = 2
SAMPLERS = ("cross-entropy", "MPPI", "predictive sampling")
# Of these: knots, samples, and generations of a run.
_KNOTS, _SAMPLES, _GENERATIONS = 8, 60, 20
# Of cross-entropy: samples that are kept, and the part of the spread that is.
_ELITE, _KEPT = 10, 0.3
# Of MPPI: the temperature, as a part of the mean excess, and what is left of the spread each time.
_TEMPERATURE, _NARROWS = 0.03, 0.95
# Of bounds that a sample leaves by their scale, in the task's.
_PRICE = 10.0
# They soon tell whether a start is any good.
_COARSE = ShootingOptions(
    rungs=tuple(Smoothing(smoothing, 15, 1e-2) for smoothing in (0.1, 0.01, 0.001)),
    order=2,
    multiplier_updates=0,
)
# What was closed roughly is made exact where it is so near the best: most isn't.
_NEARLY_BEST = 1.03
_EXACT = ShootingOptions(rungs=ShootingOptions().rungs[-1:], substeps=2)
# How far bounds may be missed, in parts of the scales, and touches that are listed.
_NEARLY, _HARDLY = 1e-2, 1e-3
# Of J and of the final state, for the steps of an exact motion; and how many steps at most.
_TOLERANCE, _MOST_SUBSTEPS = 1e-4, 32


def ask_rivals(world: World, scenario: Scenario, seconds: float, best: float) -> float:
    """Returns the least cost that rivals find in CPU seconds, infinite if there is nothing.

    They take turns, whoever had the least time so far first. A motion that promises more than the
    best known is not replayed. Optima that are known exactly have no such limit of time.
    """
    if not needs_shooting(world, scenario):
        found = np.inf
        for optimum in (walls_optimum, masses_optimum, block_optimum):
            with suppress(AigtoError):  # It is of other worlds.
                found = min(found, optimum(world, scenario).cost)
        with suppress(AigtoError):  # Flight is no parabola there.
            found = min(found, run_baseline("cross-entropy", world, scenario, seconds).cost)
        return found
    end, found = time.process_time() + seconds, np.inf
    rivals = list(_list_rivals(world, scenario))
    spent = [0.0] * len(rivals)
    while (start := time.process_time()) < end:
        turn = int(np.argmin(spent))
        promised, control = next(rivals[turn])
        if promised < _PROMISING * min(best, found):
            found = min(found, _replay(world, scenario, control))
        spent[turn] += time.process_time() - start
    return found


def _replay(world: World, scenario: Scenario, control: Control) -> float:
    """Returns what a control costs in our simulation, infinite if it breaks bounds there."""
    try:
        replay = replay_event_driven(world, scenario, *control)
    except AigtoError:
        return np.inf
    return np.inf if replay.broken else replay.cost


def _list_rivals(world: World, scenario: Scenario) -> Iterator[_Found]:
    """Yields the rivals of a task, each an endless stream of costs and controls."""
    problem = make_mechanism_task(world, scenario, PlanOptions()).shooting(scenario.num_steps)
    if scenario.contact == "rigid" and world.contacts:
        yield _shoot(problem, lambda rng: _list_touches(world, scenario, problem, rng))
        yield sample(problem, lambda each: _replay(world, scenario, each))
        return
    yield _shoot(problem, lambda _: problem)
    yield sample(problem, lambda each: roll_out(problem, each))
    if casadi is not None and ShootingProgram.fits(problem):
        yield _ask_ipopt(problem)


def _list_touches(
    world: World, scenario: Scenario, problem: ShootingProblem, rng: np.random.Generator
) -> ShootingProblem:
    phases = list_phases(scenario, world.num_contacts, _MOST_TOUCHES, rng)
    return dataclasses.replace(problem, phases=phases)


def draw_controls(problem: ShootingProblem, rng: np.random.Generator) -> np.ndarray:
    """Returns controls that are linear between three to eight random values, shape (N, nu)."""
    values = rng.normal(size=(int(rng.integers(3, 9)), len(problem.control_scales)))
    return hold_linear(problem, 10 ** rng.uniform(-1.0, 0.7) * values)


def hold_linear(problem: ShootingProblem, values: np.ndarray, steps: int = 0) -> np.ndarray:
    """Returns controls between values (L, nu) in their units, held in (N or `steps`, nu)."""
    N = steps or len(problem.times) - 1
    shares, middles = np.linspace(0, 1, len(values)), (np.arange(N) + 0.5) / N
    each = np.column_stack([np.interp(middles, shares, column) for column in values.T])
    return np.clip(each * problem.control_scales, *problem.control_bounds)


def _shoot(
    problem: ShootingProblem, pose: Callable[[np.random.Generator], ShootingProblem]
) -> _Found:
    rng = np.random.default_rng(0)
    problems = (pose(rng) for _ in itertools.count())
    yield from shoot(problems, (draw_controls(problem, rng) for _ in itertools.count()))


def _ask_ipopt(problem: ShootingProblem) -> _Found:
    rng, program = np.random.default_rng(1), ShootingProgram(problem)
    while True:
        controls = draw_controls(problem, rng)
        yield program.solve(problem.simulate(controls, substeps=2).states, controls)


def sample(
    problem: ShootingProblem, calc_cost: Callable[[Control], float], method: str = "cross-entropy"
) -> _Found:
    """Yields the best of each generation, of a mean and samples about it.

    The next mean is that of the best samples, as is the spread (cross-entropy); the mean of all,
    weighed by exp(-excess / temperature) (MPPI); or the best of all (predictive sampling). Runs
    begin at zero with random spreads.
    """
    sampler = Sampler(problem, method)
    while True:
        mean, spread = sampler.start()
        for _ in range(_GENERATIONS):
            points = sampler.draw(mean, spread)
            controls = [Control(problem.times, hold_linear(problem, each)) for each in points]
            costs = np.array([calc_cost(each) for each in controls])
            best = int(np.argmin(costs))
            yield float(costs[best]), controls[best]
            mean, spread = sampler.improve(points, costs, mean, spread)


class Sampler:
    """Draws values of controls at knots, in their units, and learns from what these cost.

    Args:
        problem: whose controls they are.
        method: one of `SAMPLERS`.
    """

    def __init__(self, problem: ShootingProblem, method: str) -> None:
        self._rng, self._size = np.random.default_rng(2), (_KNOTS, len(problem.control_scales))
        self._method = method

    def start(self) -> tuple[Floats, Floats]:
        """Returns a mean of zero and a random spread, (L, nu) each."""
        return np.zeros(self._size), np.full(self._size, 10 ** self._rng.uniform(-1.0, 0.7))

    def draw(self, mean: Floats, spread: Floats) -> Floats:
        """Returns the mean and samples about it, (S, L, nu)."""
        points = mean + spread * self._rng.normal(size=(_SAMPLES, *self._size))
        points[0] = mean
        return points

    def improve(
        self, points: Floats, costs: Floats, mean: Floats, spread: Floats
    ) -> tuple[Floats, Floats]:
        """Returns the next mean and spread after samples (S, L, nu) of some costs (S,)."""
        order = np.argsort(costs, kind="stable")
        if not np.isfinite(costs[order[0]]):
            return mean, spread
        if self._method == "cross-entropy":
            elite, kept = points[order[:_ELITE]], _KEPT
            return (
                kept * mean + (1 - kept) * elite.mean(axis=0),
                kept * spread + (1 - kept) * elite.std(axis=0),
            )
        if self._method == "MPPI":
            weights = weigh(costs, _TEMPERATURE)
            mean = np.einsum("i,i...->...", weights / weights.sum(), points)
            return mean, _NARROWS * spread
        return points[order[0]], spread


def roll_out(problem: ShootingProblem, control: Control, order: int = 4) -> float:
    """Returns what the motion of a control costs, and a price for how far it leaves its bounds.

    Args:
        problem: of the task.
        control: what acts.
        order: of Runge-Kutta steps, see `ShootingOptions`.
    """
    motion = problem.simulate(control.values, substeps=4, order=order)
    cost = motion.exact_cost + _PRICE * problem.cost_scale * motion.violation
    return cost if np.isfinite(cost) else np.inf


def shoot(
    problems: Iterable[ShootingProblem], guesses: Iterable[np.ndarray]
) -> Iterator[tuple[float, Control]]:
    """Yields J and the control that shooting makes of others (N, nu); infinite if not promising.

    Closed roughly first, as the planner closes its guesses.
    """
    best = np.inf
    for problem, guess in zip(problems, guesses, strict=False):
        found = problem.solve(guess, None, _COARSE)
        is_rough = found.violation > _NEARLY or found.exact_cost > _NEARLY_BEST * best
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
