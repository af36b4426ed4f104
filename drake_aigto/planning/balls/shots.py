"""Shots: motions after a kick at the start, or under a control that fades."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from drake_aigto.planning.balls.phases import calc_compliance
from drake_aigto.simulation import Parabolas, Replay, replay_event_driven
from drake_aigto.world import Scenario, World

# How many are drawn, and in how many steps controls are held.
_DRAWS, _STEPS = 1000, 8
# They cost from this part to this many times what is known.
_LEAST, _MOST = 1e-4, 10.0


def draw_shots(world: World, scenario: Scenario, known: float, num_steps: int) -> Iterator[Replay]:
    """Yields motions between rigid walls, first what promises to cost least.

    It costs dᵀ C⁻¹ d to change the end of a flight by d (`calc_compliance`), and so it does where
    walls mirror flights. A shot that misses the goal by s promises

        (√(dᵀ C⁻¹ d) + √(sᵀ C⁻¹ s))²

    Of each d that is drawn there are two: the velocity d/T is added at the start, or the control
    is what changes a flight by d. They bounce elsewhere.

    Args:
        world: flights in it are parabolas.
        scenario: the task.
        known: what a plan costs.
        num_steps: of motions.
    """
    T, goal, nv = scenario.duration, scenario.goal_position, world.num_velocities
    worth = np.linalg.inv(calc_compliance(world, scenario))
    rng = np.random.default_rng(0)
    ways = np.linalg.solve(np.linalg.cholesky(worth).T, rng.normal(size=(nv, _DRAWS))).T
    costs = known * _LEAST * (_MOST / _LEAST) ** rng.uniform(size=_DRAWS)
    ways *= np.sqrt(costs / np.sum(ways @ worth * ways, axis=1))[:, np.newaxis]
    times = np.linspace(0.0, T, _STEPS + 1)
    fading = T - (times[1:] + times[:-1]) / 2
    pushes = ways @ worth @ world.constant_dynamics.gain / scenario.control_weight
    controls = np.concatenate(
        [np.zeros((_DRAWS, _STEPS, world.num_actuators)), np.einsum("k,ci->cki", fading, pushes)]
    )
    kicks = np.concatenate([ways / T, np.zeros((_DRAWS, nv))])
    start = scenario.initial_position, scenario.initial_velocity
    shots = Parabolas(world.constant_dynamics, world.restitutions(scenario), start, times)
    misses = shots.find_ends(controls, kicks=kicks) - goal
    promised = (np.sqrt(np.tile(costs, 2)) + np.sqrt(np.sum(misses @ worth * misses, axis=1))) ** 2
    steps = np.linspace(0.0, T, num_steps + 1)
    held = np.searchsorted(times, (steps[1:] + steps[:-1]) / 2) - 1
    for each in np.argsort(promised, kind="stable"):
        kicked = dataclasses.replace(
            scenario, initial_velocity=scenario.initial_velocity + kicks[each]
        )
        yield replay_event_driven(world, kicked, steps, controls[each, held])
