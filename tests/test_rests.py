"""Balls that settle on a floor, rest there and jump: phases, plans, and what they are judged by."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from phase_solutions import Solved, solve

from benchmarks.floors import draw, floor_optimum, make_world
from benchmarks.optima import walls_optimum
from drake_aigto import PlanOptions, Scenario, World
from drake_aigto.planning import PhaseProblem, Planner
from drake_aigto.transcription import Touch

OPTIONS = PlanOptions(confirm=False)


def on_floor(q: float, v: float, goal: float, duration: float, e: float) -> Scenario:
    return Scenario(
        model="package://drake_aigto_models/floor.sdf",
        initial_position=q,
        initial_velocity=v,
        goal_position=goal,
        duration=duration,
        restitution=e,
    )


@pytest.fixture(scope="module")
def moon() -> World:
    return make_world(gravity=3.0, mass=1.5)


def rest(world: World, scenario: Scenario, land: float, leave: float) -> Solved:
    return solve(PhaseProblem(world, scenario, [Touch(land, leave)]))


@pytest.mark.parametrize("duration", [2.4, 2.0, 1.8])
@pytest.mark.parametrize("e", [0.1, 0.5, 0.7])
def test_hops_end_before_the_jump_however_short_the_time_is(
    moon: World, e: float, duration: float
) -> None:
    scenario = dataclasses.replace(
        on_floor(0.3, 0.0, 0.3, duration, e), time_step=duration / 40, goal_weight=100.0
    )
    found = rest(moon, scenario, 0.3 * duration, 0.65 * duration)
    (touch,), replay = found.sequence, found.replay()
    motion = found.trajectory
    (k,) = np.flatnonzero(motion.times == touch.start)
    pushed = float(np.diff(motion.times) @ motion.forces[:, 0])
    assert (1 - e) * pushed >= -2 * e * 1.5 * motion.velocities[k, 0] - 1e-9
    assert replay.cost == pytest.approx(found.cost, rel=1e-5)
    assert len(replay.bounce_times) > 2
    assert max(replay.bounce_times) < touch.end


@pytest.mark.parametrize(
    ("scenario", "gravity", "mass"),
    [
        (on_floor(0.290604, -0.07273, 0.303735, 0.9, 0.3), 20.0, 3.0),  # Stays where it fell.
        (on_floor(0.758673, 0.66295, 0.537131, 1.9, 0.3), 13.30707, 1.53598),
        (on_floor(0.595983, -1.02674, 0.903772, 1.5, 0.1), 19.1117, 0.83202),
        (on_floor(0.518778, 1.97036, 0.243520, 1.1, 0.1), 16.23448, 0.42458),
    ],
)
def test_a_ball_that_settles_rests_until_it_is_time_to_jump(
    scenario: Scenario, gravity: float, mass: float
) -> None:
    made = Planner(scenario, OPTIONS, make_world(gravity, mass)).plan()
    known = floor_optimum(scenario, gravity, mass)
    assert made.replay.event_driven.cost <= 1.01 * known.cost
    # The hops are in the plan, as they are simulated.
    times = [contact.time for contact in made.best.contacts]
    assert len(times) > 1
    assert times == pytest.approx(made.replay.event_driven.bounce_times[: len(times)], abs=1e-6)


@pytest.mark.parametrize(
    ("scenario", "gravity", "mass"),
    [
        (on_floor(0.92168282, -1.50178118, 0.30328249, 1.5, 1.0), 9.81, 1.0),  # High and late.
        (on_floor(0.36634367, -0.70831679, 0.10440947, 1.5, 1.0), 9.81, 1.0),  # Once more, late.
        (on_floor(0.373032, -0.35086, 0.014089, 1.0, 1.0), 8.62315, 1.73192),  # Just at the end.
    ],
)
def test_of_high_and_late_and_low_and_early_it_is_the_better_one(
    scenario: Scenario, gravity: float, mass: float
) -> None:
    made = Planner(scenario, OPTIONS, make_world(gravity, mass)).plan()
    assert made.replay.event_driven.cost <= 1.01 * floor_optimum(scenario, gravity, mass).cost


def test_the_reference_of_floors_is_no_worse_than_all_listed_sequences() -> None:
    for scenario, gravity, mass in list(draw(12, seed=7))[::3]:
        world = make_world(gravity, mass)
        listed = walls_optimum(world, scenario, most_touches=4)
        assert floor_optimum(scenario, gravity, mass).cost <= listed.cost * (1 + 1e-6) + 1e-9
