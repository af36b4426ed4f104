"""Random starts of the T of benchmarks/space.py, and what a T covers of its goal."""

from __future__ import annotations

import numpy as np
import pytest
from marks import slow

from benchmarks.space import count_held, cover, draw_in_air, draw_pose
from drake_aigto import Planner, PlanOptions, World
from drake_aigto.arrays import Bools, Floats

GOAL = np.array([0.1, -0.2, 0.7])


def is_in_tee(points: Floats, pose: Floats) -> Bools:
    """Returns which of points (n, 2) are in the T at a pose."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    x, y = ((points - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])).T
    bar = np.maximum(np.abs(x) / 0.06, np.abs(y - 0.02571) / 0.015) <= 1.0
    stem = np.maximum(np.abs(x) / 0.015, np.abs(y + 0.03429) / 0.045) <= 1.0
    return np.logical_or(bar, stem)


@pytest.mark.parametrize(
    "moved",
    [(0.0, 0.0, 0.0), (0.02, -0.03, 1.0), (0.0, 0.0, np.pi), (-0.01, 0.01, 0.2), (1.0, 0.0, 0.0)],
)
def test_what_a_tee_covers_is_the_share_of_points_in_both(moved: tuple[float, ...]) -> None:
    pose = GOAL + np.array(moved)
    points = GOAL[:2] + np.random.default_rng(0).uniform(-0.1, 0.1, (100_000, 2))
    inside = is_in_tee(points, GOAL)
    share = np.sum(inside & is_in_tee(points, pose)) / np.sum(inside)
    assert cover(pose, GOAL) == pytest.approx(share, abs=0.01)
    assert cover(pose + np.array([0.0, 0.0, 2.0 * np.pi]), GOAL) == pytest.approx(cover(pose, GOAL))


def test_poses_are_drawn_where_diffusion_policy_draws_them() -> None:
    scenarios = [draw_pose(seed) for seed in (0, 14)]
    assert scenarios[0].to_plain() == draw_pose(0).to_plain()
    for drawn in scenarios:
        world = World.from_scenario(drawn)
        scenario = world.place(drawn)
        start, goal = scenario.initial_position, scenario.goal_position
        assert np.all((start[3:] >= 0.05) & (start[3:] <= 0.45))
        assert abs(goal[2] - start[2]) <= np.pi
        edge = start[:2] + 0.04071 * np.array([-np.sin(start[2]), np.cos(start[2])])
        assert np.all((edge >= 0.1) & (edge <= 0.4))
        assert np.min(world.calc_signed_distance(start)) > 0.0


@pytest.mark.parametrize("name", ["three_fingers/lift", *slow("three_fingers/flip")])
def test_cubes_start_on_the_ground_and_have_goals_in_the_air(name: str) -> None:
    for seed in range(2):
        world = World.from_scenario(drawn := draw_in_air(name, seed))
        scenario = world.place(drawn)
        start, goal = scenario.initial_position, scenario.goal_position
        assert np.all(np.abs(start[-3:-1]) <= 0.025) and np.all(np.abs(goal[-3:-1]) <= 0.1)
        assert np.min(world.calc_signed_distance(start)) > -0.0003  # By its weight.
        assert 0.05 <= goal[-1] <= 0.1 and start[-5:-3] == pytest.approx([0.0, start[-4]])
        assert drawn.to_plain() == draw_in_air(name, seed).to_plain()


def test_a_cube_is_held_where_it_is_near_its_goal_until_the_end() -> None:
    goal = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    there = np.tile(goal, (30, 1))
    assert count_held(there, goal) == 30
    there[12, -1] = 0.125
    assert count_held(there, goal) == 17
    there[20, :4] = -np.cos(0.15), np.sin(0.15), 0.0, 0.0  # 1 - (q q*)² is 0.022.
    assert count_held(there, goal) == 17
    there[20, :4] = np.cos(0.21), np.sin(0.21), 0.0, 0.0  # 0.043
    assert count_held(there, goal) == 9


@pytest.mark.slow  # 15 to 60 CPU s: which motions a search finds depends on a machine's rounding.
def test_pushes_whose_errors_grow_a_hundred_thousand_times_are_held_by_feedback() -> None:
    plan = Planner(draw_pose(9), PlanOptions(renewals=16)).plan()
    assert plan.holds and plan.reached
    unstable = [each for each in plan.candidates if each.gains and each.growth]
    assert all(each.growth is not None and each.growth.factor > 1e5 for each in unstable)
    excess = [max(off.cost for off in each.perturbed) / each.cost for each in unstable]
    # Gains that know of contact from 1e-3 of the length on: 98 for the best one, 1.8 at least.
    assert min(excess) < 1.5
