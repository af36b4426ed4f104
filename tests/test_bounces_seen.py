"""What is learned of walls from bounces: right for any wall, and nothing from what is none."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from drake_aigto import ModelPredictiveController, Planner, PlanOptions, Scenario, World
from drake_aigto.arrays import Floats
from drake_aigto.control import Disturbance, SeenBounces, run_in_loop

CORRIDOR = Scenario.named("corridor/three_bounces")
OFF, WEIGHT = 0.05, 1e-9  # [m], [m²/s²]


@cache
def make_world() -> World:
    return World.from_scenario(CORRIDOR)


def fly(x: float, v: float, a: float, t: float) -> tuple[float, float]:
    return x + t * v + t * t * a / 2, v + t * a


def bounce(
    rng: np.random.Generator, e: float
) -> tuple[tuple[Floats, Floats], float, Floats, tuple[int, float]]:
    """Returns samples about a bounce off a wall that is nearer or not, h, u, which, by how much."""
    world = make_world()
    u, side = rng.uniform(-1, 1, 1), rng.integers(2)
    v = -world.calc_contact_jacobian(CORRIDOR.initial_position)[side] * rng.uniform(0.5, 2)
    (a,) = world.calc_acceleration(CORRIDOR.initial_position, v, u)
    before, after = rng.uniform(0.001, 0.01, 2)
    nearer = rng.uniform(-0.02, 0.02)
    wall = CORRIDOR.initial_position + v / np.abs(v) * (
        world.calc_signed_distance(CORRIDOR.initial_position)[side] - nearer
    )
    early = np.array(fly(wall[0], v[0], a, -before))
    late = np.array(fly(wall[0], -e * v[0], a, after))
    return (early, late), before + after, u, (int(side), nearer)


def test_what_a_wall_returns_and_where_it_stands_is_learned() -> None:
    rng = np.random.default_rng(2026)
    for e in rng.uniform(0.1, 1.0, 20):
        seen = SeenBounces()
        for _ in range(3):
            samples, elapsed, control, (side, nearer) = bounce(rng, e)
            seen = seen.watch(make_world(), samples, elapsed, control, OFF)
            assert seen.latest == side
            # Both flights are straight lines in t, which misses a h².
            assert seen.nearer[side] == pytest.approx(nearer, abs=1e-4)
        assert seen.find_restitution(0.5, WEIGHT) == pytest.approx(e, abs=1e-3)


def test_a_kick_in_mid_air_is_no_bounce_and_a_slow_one_tells_little() -> None:
    x = np.concatenate([CORRIDOR.initial_position, [0.7]])
    kicked = x + 0.01 * x[1] + np.array([0.0, -1.2])
    seen = SeenBounces().watch(make_world(), (x, kicked), 0.01, np.zeros(1), OFF)
    assert seen == SeenBounces() and seen.find_restitution(0.8, WEIGHT) == 0.8
    # Nor is one beside a wall that leaves it faster than it came.
    x[0] -= (
        make_world().calc_signed_distance(x[:1])[1]
        * make_world().calc_contact_jacobian(x[:1])[1, 0]
    )
    for faster, latest in ((-1.6, None), (-1.2, 1)):
        kicked = x + np.array([0.0, faster])
        assert (
            SeenBounces().watch(make_world(), (x, kicked), 0.01, np.zeros(1), OFF).latest == latest
        )
    assert SeenBounces(1e-4, 0.2e-4).find_restitution(0.8, 1e-2) == pytest.approx(0.8, abs=0.01)
    assert SeenBounces(1.0, 1.3).find_restitution(0.8, 0.0) == 1.0


def test_a_wall_that_a_ball_is_deep_inside_of_is_farther_and_no_other() -> None:
    world, off = make_world(), 0.1
    q = CORRIDOR.initial_position
    q = q - world.calc_contact_jacobian(q)[0] * (world.calc_signed_distance(q)[0] + 0.05)
    seen = SeenBounces().pass_walls(world, q, off)
    assert 0 < world.calc_signed_distance(q)[0] - seen.nearer[0] <= 0.1 * off
    assert seen.nearer[1] == 0
    # What is touched, or much deeper than walls are off, tells of none.
    for depth in (0.001, 0.06):
        touching = q - world.calc_contact_jacobian(q)[0] * (depth - 0.05)
        assert SeenBounces().pass_walls(world, touching, 0.05) == SeenBounces()


@pytest.mark.slow
def test_a_controller_that_learns_loses_less_between_walls_that_return_less() -> None:
    truth = Disturbance(
        restitution_factor=0.9, wall_shift=-0.02, kick=np.array([0.4]), kick_time=0.3
    )
    planner = Planner(CORRIDOR, PlanOptions(branches=0, finalists=1, threads=1), make_world())
    learned, held = (
        run_in_loop(
            ModelPredictiveController(planner, 0.02, "shrinking", learns=learns),
            CORRIDOR,
            make_world(),
            truth,
        )
        for learns in (True, False)
    )
    assert learned.cost < 0.6 * held.cost
    e = [run.ticks[-1].restitution for run in (learned, held)]
    assert e == pytest.approx([0.9 * CORRIDOR.restitution, CORRIDOR.restitution], abs=3e-3)
    assert learned.ticks[-1].nearer == pytest.approx((-0.02, -0.02), abs=1e-3)
    assert held.ticks[-1].nearer == ()
