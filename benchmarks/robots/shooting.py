"""Local optima by the planner's own shooting, from random controls: what boxes have to beat."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Iterator
from functools import cache

import numpy as np

from benchmarks.robots.judge import Control
from benchmarks.robots.worlds import WORLDS, Question, scenario_of
from drake_aigto.contact import contact_law
from drake_aigto.shooting import (
    Mechanism,
    Phases,
    ShootingOptions,
    ShootingProblem,
    ShootingResult,
    Smoothing,
)
from drake_aigto.simulation import state_scales
from drake_aigto.world import Scales, TaskCost, World

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
    bounds, n = world.bounds(scenario), world.num_positions
    hard_goal = np.full(2 * n, np.nan)
    if scenario.hard_goal:
        hard_goal[:n] = scenario.goal_position
    return ShootingProblem(
        mechanism=_mechanism(question.world, scenario.restitution),
        cost=TaskCost.of(world, scenario),
        times=np.linspace(0.0, scenario.duration, scenario.num_steps + 1),
        start=np.concatenate([scenario.initial_position, scenario.initial_velocity]),
        scales=state_scales(world, scenario),
        state_bounds=np.hstack([bounds.position, bounds.velocity]),
        control_bounds=bounds.control,
        hard_goal=hard_goal,
        control_norm=scenario.control_norm or np.inf,
        length=Scales.of(world, scenario).length,
        phases=phases,
    )


def shoot(
    problems: Iterable[ShootingProblem], guesses: Iterable[np.ndarray]
) -> Iterator[tuple[float, Control]]:
    """Yields J and the control that shooting makes of others (N, nu); infinite if not promising.

    Closed roughly first, as the planner closes the centers of its boxes.
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


def list_phases(question: Question, rng: np.random.Generator) -> Phases:
    """Returns one of all sequences of so many touches, at random times."""
    scenario, world = scenario_of(question), WORLDS[question.world]
    N, T = scenario.num_steps, scenario.duration
    walls = range(world.mechanism.walls)
    listed = [
        sequence
        for touches in range(world.touches + 1)
        for sequence in itertools.product(walls, repeat=touches)
    ]
    sequence = listed[rng.integers(len(listed))]
    shares = rng.dirichlet(np.full(len(sequence) + 1, 2.0))
    knots = np.linspace(0, N, len(sequence) + 2).astype(int)[1:-1]
    return Phases(np.array(sequence), knots, T * (0.9 * shares + 0.1 / len(shares)), (T, T))
