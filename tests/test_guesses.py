"""Guesses of motions: drawn in units of the task, or given by a user."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from mechanisms import build_world, drop_ball, joint, link, plane, sphere, wall
from scaled_worlds import Factors, scale_scenario
from space_models import ball_and_finger, make_scenario

from drake_aigto import PlanOptions, Scenario, World, plan
from drake_aigto.contact import RigidLaw
from drake_aigto.errors import TrajectoryError
from drake_aigto.planning import (
    Candidate,
    Measures,
    MechanismTask,
    make_mechanism_task,
    needs_shooting,
    soften,
)
from drake_aigto.world import SpaceWorld


@cache
def make_task(name: str) -> MechanismTask:
    scenario = Scenario.named(name)
    return make_mechanism_task(World.from_scenario(scenario), scenario, PlanOptions())


@pytest.mark.parametrize("name", ["cart_pole/soft_06", "acrobot/swing_up", "paddle/bat"])
def test_the_same_draw_gives_the_same_bits_from_the_start_within_bounds(name: str) -> None:
    task = make_task(name)
    start = np.concatenate([task.scenario.initial_position, task.scenario.initial_velocity])
    for start_name in task.guesses.starts:
        one, other = (task.guesses.draw(start_name, np.random.default_rng(7)) for _ in range(2))
        np.testing.assert_array_equal(one.controls, other.controls)
        assert np.all(one.controls >= task.bounds.control[0])
        assert np.all(one.controls <= task.bounds.control[1])
        if one.states is not None:
            np.testing.assert_allclose(one.states[0], start, atol=1e-12)


def test_lines_lead_to_the_goal_from_both_sides_where_turns_do_not_count() -> None:
    task = make_task("cart_pole/soft_06")
    ends = [task.guesses.plain(start).states for start in ("line", "turn")]
    angles = [states[-1, 1] for states in ends if states is not None]
    assert abs(angles[0] - angles[1]) == pytest.approx(2 * np.pi)
    assert np.cos(angles[0]) == pytest.approx(np.cos(task.scenario.goal_position[1]))
    exact = dataclasses.replace(task.scenario, angles="exact")
    assert "turn" not in MechanismTask(task.world, exact, PlanOptions()).guesses.starts


def slide(length: float, mass: float, time: float, damping: float = 0.0) -> tuple[World, Scenario]:
    """Returns a ball on a rail before a wall, in other units of length, mass and time."""
    world = build_world(
        link("ball", mass, ">0 0 0 0 0 0", shape=sphere("ball", "0 0 0", radius=0.1 * length))
        + joint("prismatic", "world", "ball", "1 0 0", brake(damping))
        + wall(plane("wall", "0 0 0 0 1.5707963267948966 0"))
    )
    scenario = Scenario(
        model="ball",
        initial_position=[length],
        initial_velocity=[-length / time],
        goal_position=[2 * length],
        duration=2 * time,
        time_step=0.05 * time,
        contact="compliant",
    )
    return world, scenario


@pytest.mark.parametrize("units", [(10.0, 1.0, 1.0), (1.0, 0.01, 1.0), (1.0, 1.0, 100.0)])
def test_units_scale_with_lengths_masses_and_times_and_with_nothing_else(units: Any) -> None:
    length, _, time = units
    one, other = (Measures.of(*slide(*each)) for each in ((1.0, 1.0, 1.0), units))
    np.testing.assert_allclose(other.position, length * one.position)
    np.testing.assert_allclose(other.velocity, length / time * one.velocity)
    assert other.length == pytest.approx(length * one.length)
    assert other.speed == pytest.approx(length / time * one.speed)


def brake(damping: float) -> str:
    return f"<dynamics><damping>{damping}</damping></dynamics>"


@pytest.mark.parametrize("damping", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("is_in_space", [False, True])
def test_the_scale_of_controls_moves_by_the_unit_in_the_duration_whatever_brakes(
    damping: float, is_in_space: bool, tmp_path: Path
) -> None:
    world, scenario = slide(1.0, 1.0, 1.0, damping)
    scenario = dataclasses.replace(scenario, contact="rigid")
    if is_in_space:
        text = ball_and_finger().replace(brake(0.2), brake(damping))
        scenario = make_scenario(tmp_path, text)
        world = SpaceWorld.from_scenario(scenario)
        scenario = world.place(scenario)
    problem = make_mechanism_task(world, scenario, PlanOptions()).shooting(20)
    i, T = int(np.argmax(world.actuation[:, 0])), scenario.duration
    m = world.calc_mass_matrix(scenario.initial_position)[i, i]
    # From rest, as m v̇ = u − d v.
    decay = m / damping
    way = problem.control_scales[0] / damping * (T - decay * (1 - np.exp(-T / decay)))
    assert 0.5 < way / problem.scales[i] < 1.0


def test_servos_are_no_forces_that_move_a_mechanism_without_control() -> None:
    bare = Scenario.named("acrobot/swing_up")
    held = Scenario.from_plain({**bare.to_plain(), "servos": {"*": [1e4, 1.0]}})
    one, other = (Measures.of(World.from_scenario(each), each) for each in (bare, held))
    assert other.period == pytest.approx(one.period)


def test_springs_in_place_of_rigid_walls_return_what_these_do_at_one_speed() -> None:
    law = soften(drop_ball(), RigidLaw(np.array([0.6])), 0.02, 1.5)
    assert law.stiffness[0] == pytest.approx(2.0 / 0.02**2)
    depth, speed, h = 0.0, 1.5, 1e-5  # Of its motion into the spring, without gravity.
    while depth >= 0.0:
        depth += h * speed
        push = law.stiffness[0] * depth * (1 + law.dissipation[0] * speed)
        speed -= h * push / 2.0
    assert speed == pytest.approx(-0.6 * 1.5, rel=1e-3)


FEW: dict[str, Any] = {"renewals": 0, "starts": 1, "confirm": False}
PENDULUM = Scenario.named("pendulum/off_the_wall")


@pytest.mark.parametrize(
    ("name", "share"), [("cart_pole/soft_10", 0.95), *slow(("cart_pole/rigid_10", 1.0))]
)
def test_a_motion_that_is_known_is_led_on(name: str, share: float) -> None:
    """One start alone finds less."""
    scenario = Scenario.named(name)
    known = plan(scenario, PlanOptions(renewals=8, confirm=False))
    found = plan(scenario, PlanOptions(**FEW), initial_guess=known.trajectory)
    assert str(found.best.origin) == "the given guess"
    assert found.cost < known.cost * (1 + 1e-3)
    assert found.cost < share * plan(scenario, PlanOptions(**FEW)).cost


def test_the_touches_of_a_guess_are_a_candidate_of_balls() -> None:
    scenario = Scenario.named("table1/1")
    known = plan(scenario)
    found = plan(scenario, initial_guess=known.trajectory)
    assert "the given guess" in [str(each.origin) for each in found.candidates]
    assert found.cost == pytest.approx(known.cost, rel=1e-9)


@pytest.mark.slow
def test_guesses_that_fit_nothing_are_refused_before_the_search() -> None:
    known = plan(PENDULUM, PlanOptions(**FEW))
    other = Scenario.named("cart_pole/rigid_06")
    motion = known.trajectory
    twice = dataclasses.replace(motion, times=2 * np.asarray(motion.times))
    refused: tuple[tuple[Scenario, Any, str], ...] = (
        (PENDULUM, known, "initial_guess: got Plan, expected a Trajectory. Of a plan, give its"),
        (PENDULUM, twice, f"from 0 to {2 * PENDULUM.duration:g} s, expected from 0 to"),
        (other, motion, r"initial_guess: got \(1, 1, 1\) positions, controls and contacts"),
    )
    for scenario, guess, message in refused:
        with pytest.raises(TrajectoryError, match=message):
            plan(scenario, initial_guess=guess)


# Ten and a hundred times as large, heavy or long-lasting, and as small; where gravity counts,
# lengths go with the square of times.
ANY = (Factors(0.1, 10.0, 100.0), Factors(100.0, 0.01, 10.0), Factors(0.01, 1.0, 1.0))
FALLING = (Factors(100.0, 10.0, 10.0), Factors(0.01, 0.1, 0.1))


def check(name: str, all_factors: tuple[Factors, ...], options: PlanOptions, folder: Path) -> None:
    """Plans in each of these units, and compares."""

    def find(factors: Factors) -> Candidate:
        return plan(scale_scenario(name, folder, factors), options).best

    shipped = find(Factors(1.0, 1.0, 1.0))
    for factors in all_factors:
        best = find(factors)
        assert best.cost == pytest.approx(shipped.cost, rel=1e-6), factors
        assert best.replay.cost == pytest.approx(shipped.replay.cost, rel=1e-6), factors
        assert [each.index for each in best.contacts] == [each.index for each in shipped.contacts]
        times = [[each.time for each in found.contacts] for found in (best, shipped)]
        assert np.array(times[0]) / factors.time == pytest.approx(times[1], rel=1e-6)


BALLS = PlanOptions(confirm=False)
FEW_STARTS = PlanOptions(confirm=False, starts=6, renewals=8, search_steps=30)


def test_a_ball_in_other_units_has_the_same_plan(tmp_path: Path) -> None:
    scenario = Scenario.named("table1/1")
    assert not needs_shooting(World.from_scenario(scenario), scenario)
    check("table1/1", ANY, BALLS, tmp_path)


@pytest.mark.slow
def test_an_acrobot_in_other_units_has_the_same_plan(tmp_path: Path) -> None:
    check("acrobot/swing_up", FALLING, FEW_STARTS, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factors"), [("corridor/lossy", ANY), ("two_masses/apart", ANY)])
def test_balls_between_walls_in_other_units_have_the_same_plan(
    name: str, factors: tuple[Factors, ...], tmp_path: Path
) -> None:
    check(name, factors, BALLS, tmp_path)
