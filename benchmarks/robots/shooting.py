"""Random multistart with the planner's own local method: shooting, without boxes or renewals."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator
from functools import cache

import numpy as np

from benchmarks.robots.cart_pole import LENGTH, Question
from drake_aigto.shooting import Mechanism, ShootingOptions, ShootingProblem
from drake_aigto.world import Scenario, TaskCost, World

# What was closed roughly is made exact where it is so near the best: most isn't.
_PROMISING = 1.03
_EXACT = ShootingOptions(rungs=ShootingOptions().rungs[-1:], substeps=2)
_NEARLY = 1e-2  # how far bounds may be missed before that, in parts of `_SCALES`
_SCALES = np.array([LENGTH, 1.0, LENGTH, 1.0])  # of q and v
# Of J and of the final state, for the steps of an exact motion; and how many steps at most.
_TOLERANCE, _MOST_SUBSTEPS = 1e-4, 32


def scenario_of(question: Question) -> Scenario:
    """Returns the shipped scenario from this start."""
    start = np.array(question.start)
    return dataclasses.replace(
        Scenario.named(question.scenario),
        initial_position=start[[0, 2]],
        initial_velocity=start[[1, 3]],
    )


@cache
def world_of(name: str) -> World:
    """Returns a scenario's world, built once a process."""
    return World.from_scenario(Scenario.named(name))


@cache
def _mechanism(name: str) -> Mechanism:
    world = world_of(name)
    return Mechanism.of(world, world.contact_law(Scenario.named(name)))


def pose(question: Question) -> ShootingProblem:
    """Returns the question as shooting takes it."""
    scenario, world = scenario_of(question), world_of(question.scenario)
    bounds = world.bounds(scenario)
    return ShootingProblem(
        mechanism=_mechanism(question.scenario),
        cost=TaskCost.of(world, scenario),
        times=np.linspace(0.0, scenario.duration, scenario.num_steps + 1),
        start=np.concatenate([scenario.initial_position, scenario.initial_velocity]),
        scales=_SCALES,
        state_bounds=np.hstack([bounds.position, bounds.velocity]),
        control_bounds=bounds.control,
        hard_goal=np.full(4, np.nan),
        length=LENGTH,
    )


def shoot(question: Question, guesses: Iterable[np.ndarray]) -> Iterator[tuple[float, np.ndarray]]:
    """Yields J, and the controls (N,), of what shooting makes of others; infinite if not promising.

    Closed roughly first, as the planner closes the centers of its boxes.
    """
    problem = pose(question)
    best = np.inf
    for guess in guesses:
        found = problem.solve(guess[:, None], None, ShootingOptions.coarse())
        is_rough = found.violation > _NEARLY or found.exact_cost > _PROMISING * best
        if not is_rough:
            found = problem.solve(found.controls, found.states, _EXACT)
            found = problem.refine(found, _EXACT, _TOLERANCE, _MOST_SUBSTEPS)
            is_rough = found.violation > _NEARLY
        if not is_rough:
            best = min(best, found.exact_cost)
        yield np.inf if is_rough else found.exact_cost, found.controls[:, 0]
