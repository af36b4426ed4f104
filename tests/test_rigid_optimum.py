"""The exact optimum: known values, rivals, a solver that does not know it, its symmetries."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from line_rivals import cost_of, legs_of, transcribe
from replay_worlds import make_diagram, make_scenario, shipped_world

from benchmarks.optima.line_optimum import Line, LineBounce, Wall
from drake_aigto.dynamics import Contact
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.paper import RigidOptimum, rigid_optimum
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import Scenario, World, models_directory

# Table I's row, e → cost, bounce time [s], impact velocity [m/s], cost of the flight; from a search
# over grids of touches with refinement, made before this package.
KNOWN = {
    (1, 1.0): (2.180459e-04, 0.549853, -1.678032, 8.951844e-03),
    (1, 0.8): (2.147621e-05, 0.513393, -1.906369, 8.951844e-03),
    (1, 0.5): (4.262723e-04, 0.457682, -2.333144, 8.951844e-03),
    (2, 1.0): (1.196411e-04, 0.311641, -1.357376, 9.690927e-03),
    (2, 0.8): (5.058810e-04, 0.295909, -1.485600, 9.690927e-03),
    (2, 0.5): (2.027782e-03, 0.278351, -1.636952, 9.690927e-03),
    (3, 1.0): (2.991027e-05, 0.386994, -1.593354, 1.079761e-02),
    (3, 0.8): (3.197998e-04, 0.364246, -1.773291, 1.079761e-02),
    (3, 0.5): (1.928658e-03, 0.336250, -2.019960, 1.079761e-02),
    (4, 1.0): (0.0, 0.500000, -2.000000, 1.196411e-02),
    (4, 0.8): (1.721251e-04, 0.468084, -2.247148, 1.196411e-02),
    (4, 0.5): (1.894365e-03, 0.423090, -2.655217, 1.196411e-02),
}

# Wide: touches come early and late, gentle and at hundreds of m/s.
lengths = st.floats(-2, 1).map(lambda x: 10**x)
scenarios = st.builds(
    make_scenario,
    q=lengths,
    v=st.one_of(st.floats(-3, 0.5), st.floats(-2, 2).map(lambda x: -(10**x))),
    restitution=st.one_of(st.sampled_from([0.0, 0.5, 0.8, 1.0]), st.floats(0, 1)),
    goal_weight=st.sampled_from([0.0, 1e-3, 1.0, 1e6]),
)


def line_of(scenario: Scenario) -> Line:
    """Returns the same problem on a line with one wall, at a cost of 1 / w_u."""
    return Line(
        position=scenario.initial_position[0],
        velocity=scenario.initial_velocity[0],
        goal=scenario.goal_position[0],
        weight=scenario.goal_weight / scenario.control_weight,
        gravity=0.0,
        walls=(Wall(0.0, 1, scenario.restitution),),
    )


def bounces_of(optimum: RigidOptimum) -> list[LineBounce]:
    touches = zip(optimum.bounce_times, optimum.impact_velocities, strict=True)
    return [LineBounce(time, 0, -velocity) for time, velocity in touches]


def set_goal(scenario: Scenario, goal: float) -> Scenario:
    return dataclasses.replace(scenario, goal_position=goal)


def solve(scenario: Scenario) -> RigidOptimum:
    return rigid_optimum(shipped_world(scenario.mass), scenario)


@pytest.mark.parametrize("key", KNOWN)
def test_table_1_has_its_known_optima(key: tuple[int, float]) -> None:
    row, e = key
    cost, time, velocity, flight_cost = KNOWN[key]
    optimum = solve(dataclasses.replace(Scenario.named(f"table1/{row}"), restitution=e))
    assert optimum.cost == pytest.approx(cost, rel=1e-6, abs=1e-20)
    # The values above are rounded to six places.
    assert optimum.bounce_times == pytest.approx([time], abs=6e-7)
    assert optimum.impact_velocities == pytest.approx([velocity], abs=6e-7)
    assert optimum.flight_cost == pytest.approx(flight_cost, rel=1e-6)


def images_cost(scenario: Scenario) -> float:
    """Returns the optimum of e = 1: a flight through the wall to the goal or its mirror image."""
    T, w_u, w_f = scenario.duration, scenario.control_weight, scenario.goal_weight
    ballistic = scenario.initial_position[0] + scenario.initial_velocity[0] * T
    miss = abs(ballistic) - scenario.goal_position[0]
    return w_f * miss**2 / (1 + w_f * T**3 / (3 * w_u))


@given(scenarios, lengths)
def test_an_elastic_wall_is_a_mirror(scenario: Scenario, goal: float) -> None:
    scenario = dataclasses.replace(set_goal(scenario, goal), restitution=1.0)
    assert solve(scenario).cost == pytest.approx(images_cost(scenario), rel=1e-8, abs=1e-18)


@pytest.mark.parametrize("position", np.linspace(0.05, 1.7, 12))
def test_a_ball_that_comes_to_the_wall_at_the_very_end_has_an_optimum(position: float) -> None:
    optimum = solve(make_scenario(position, -position, goal_weight=0.0))
    assert optimum.cost == pytest.approx(0.0, abs=1e-20)


@given(scenarios, lengths)
def test_a_flight_that_no_wall_meets_costs_the_linear_quadratic_optimum(
    scenario: Scenario, goal: float
) -> None:
    scenario = set_goal(scenario, goal)
    p, v = scenario.initial_position[0], scenario.initial_velocity[0]
    w = scenario.goal_weight / scenario.control_weight
    force = 3 * w / (3 + w) * (goal - p - v)  # u(t) = force (1 − t)
    t = np.linspace(0, 1, 2001)
    path = p + v * t + force * (t**2 / 2 - t**3 / 6)
    cost = scenario.control_weight * force**2 / 3 + scenario.goal_weight * (path[-1] - goal) ** 2
    optimum = solve(scenario)
    if np.min(path) < -1e-12:
        assert optimum.flight_cost == math.inf
        assert len(optimum.bounce_times) == 1
    elif np.min(path) > 1e-4 * (p + abs(v)):
        assert optimum.flight_cost == pytest.approx(cost, rel=1e-9, abs=1e-18)
    assert optimum.cost <= optimum.flight_cost


@given(scenarios, lengths)
def test_the_optimum_is_a_motion_that_costs_as_much(scenario: Scenario, goal: float) -> None:
    scenario = set_goal(scenario, goal)
    optimum = solve(scenario)
    assert all(0 < time <= 1 for time in optimum.bounce_times)
    assert all(velocity < 0 for velocity in optimum.impact_velocities)
    cost = scenario.control_weight * cost_of(line_of(scenario), bounces_of(optimum))
    assert cost == pytest.approx(optimum.cost, rel=1e-8, abs=1e-16)


# Rivals: motions made by chance, of one touch, two touches, or a rest at the wall.


def costs_by_chance(line: Line, touches: int, rng: np.random.Generator) -> Iterator[float]:
    """Yields the costs of motions that touch so often; infinite where they leave the line."""
    p, v = line.position, line.velocity
    for number in range(120):
        times = np.sort(rng.uniform(0.01, 0.99, touches))
        if number % 2:  # Half of the first touches are about when it would come by itself.
            times[0] = min(0.9, p / max(p, -v)) * np.exp(0.1 * rng.normal())
        # Some come gently: with two of them in a row, contact lasts.
        gentle = rng.random(touches) < 0.7
        speeds = rng.uniform(0, 1.5, touches) * gentle * max(abs(v), p)
        if np.min(np.diff(times, prepend=0.0, append=1.0)) > 1e-4:
            yield cost_of(
                line, [LineBounce(t, 0, speed) for t, speed in zip(times, speeds, strict=True)]
            )


@settings(max_examples=60)
@given(scenarios, lengths, st.integers(0, 2**32 - 1))
def test_no_motion_by_chance_is_cheaper(scenario: Scenario, goal: float, seed: int) -> None:
    scenario = set_goal(scenario, goal)
    cost = solve(scenario).cost / scenario.control_weight
    for touches in (1, 2):
        rivals = list(costs_by_chance(line_of(scenario), touches, np.random.default_rng(seed)))
        assert np.sum(np.isfinite(rivals)) > 3
        assert min(rivals) >= cost * (1 - 1e-9)


# A direct transcription, solved by SNOPT.


def random_scenario(rng: np.random.Generator) -> Scenario:
    return make_scenario(
        q=rng.uniform(0.2, 1.5),
        v=rng.uniform(-3, 0.5),
        restitution=rng.choice([1.0, 0.8, 0.5, 0.0]),
    )


def guess_touches(scenario: Scenario, touches: int, rng: np.random.Generator) -> list[LineBounce]:
    """Returns up to two touches, the first near where it comes by itself."""
    p, v = scenario.initial_position[0], scenario.initial_velocity[0]
    first = rng.uniform(0.8, 1.1) * min(0.7, p / max(p, -v))
    speeds = max(p, -v) * rng.uniform(0.3, 1.2, 2)
    times = (first, rng.uniform(first, 0.95))
    return [LineBounce(t, 0, speed) for t, speed in zip(times, speeds, strict=True)][:touches]


def transcribed_costs(
    scenario: Scenario, rng: np.random.Generator, guesses: Sequence[int], K: Sequence[int]
) -> list[float]:
    """Returns the best cost with 0, 1, 2 touches from so many guesses each, K intervals a phase."""
    best = []
    for touches, (count, intervals) in enumerate(zip(guesses, K, strict=True)):
        tries = [guess_touches(scenario, touches, rng) for _ in range(count)]
        costs = (transcribe(line_of(scenario), guess, intervals) for guess in tries)
        best.append(scenario.control_weight * min(costs))
    return best


@pytest.mark.slow
@pytest.mark.usefixtures("quiet_drake")
def test_snopt_finds_the_optimum_and_nothing_below() -> None:
    rng = np.random.default_rng(0)
    for _ in range(24):
        scenario = set_goal(random_scenario(rng), rng.uniform(0.2, 1.5))
        optimum = solve(scenario)
        costs = transcribed_costs(scenario, rng, guesses=(1, 1, 1), K=(40, 40, 12))
        # Forces that are held over 1/K of a phase are dearer by up to 1/K² than linear ones.
        assert optimum.cost * (1 - 1e-6) < min(costs) < optimum.cost * (1 + 1 / 40**2)
        # Two touches are never worth it.
        assert np.argmin(costs) == len(optimum.bounce_times)


# The optimal control, replayed.


def optimal_control(scenario: Scenario, optimum: RigidOptimum, K: int = 100) -> tuple[Any, Any]:
    """Returns knots and held forces: means of the optimal control in K intervals a phase."""
    time, parts = 0.0, (np.arange(K) + 0.5) / K
    knots, controls = [np.zeros(1)], []
    for leg in legs_of(line_of(scenario), bounces_of(optimum)):
        controls.append(leg.a + leg.b * leg.time * parts)
        knots.append(time + leg.time * np.arange(1, K + 1) / K)
        time += leg.time
    return np.concatenate(knots), np.concatenate(controls)[:, None]


@pytest.mark.parametrize("e", [1.0, 0.8, 0.5, 0.0])
@pytest.mark.parametrize("row", [1, 2, 4])
def test_the_replayed_optimum_bounces_and_costs_as_it_says(row: int, e: float) -> None:
    scenario = dataclasses.replace(Scenario.named(f"table1/{row}"), restitution=e)
    optimum = solve(scenario)
    replay = replay_event_driven(shipped_world(), scenario, *optimal_control(scenario, optimum))
    assert replay.cost == pytest.approx(optimum.cost, rel=1e-4, abs=1e-12)
    assert replay.bounce_times == pytest.approx(optimum.bounce_times, abs=1e-4)
    speeds = [math.sqrt(2 * energy) for energy in replay.energies_before]
    assert speeds == pytest.approx([-v for v in optimum.impact_velocities], rel=1e-3)


# What must not matter.


def assert_same(one: RigidOptimum, other: RigidOptimum, **scales: float) -> None:
    """Two optima agree but for factors of cost, time and velocity."""
    cost, time, velocity = (scales.get(name, 1.0) for name in ("cost", "time", "velocity"))
    assert other.cost == pytest.approx(one.cost * cost, rel=1e-7, abs=1e-16)
    assert other.flight_cost == pytest.approx(one.flight_cost * cost, rel=1e-9, abs=1e-16)
    # Flight and bounce may cost the same.
    if abs(one.cost - one.flight_cost) > 1e-9 * one.cost:
        times = [t * time for t in one.bounce_times]
        assert other.bounce_times == pytest.approx(times, rel=1e-5)
        velocities = [v * velocity for v in one.impact_velocities]
        assert other.impact_velocities == pytest.approx(velocities, rel=1e-5)


moderate = st.builds(
    make_scenario,
    q=st.floats(0.2, 1.5),
    v=st.floats(-3, 0.5),
    restitution=st.sampled_from([0.0, 0.5, 0.8, 1.0]),
)


@given(moderate, st.floats(0.2, 1.5))
def test_twice_the_mass_is_four_times_the_control_weight(scenario: Scenario, goal: float) -> None:
    scenario = set_goal(scenario, goal)
    heavy = dataclasses.replace(scenario, mass=2.0)
    dear = dataclasses.replace(scenario, control_weight=4 * scenario.control_weight)
    assert_same(solve(heavy), solve(dear))


@given(moderate, st.floats(0.2, 1.5), st.floats(0.1, 10))
def test_costs_grow_with_the_square_of_lengths(
    scenario: Scenario, goal: float, scale: float
) -> None:
    scenario = set_goal(scenario, goal)
    large = dataclasses.replace(
        scenario,
        initial_position=scale * scenario.initial_position,
        initial_velocity=scale * scenario.initial_velocity,
        goal_position=scale * scenario.goal_position,
    )
    assert_same(solve(scenario), solve(large), cost=scale**2, velocity=scale)


@given(moderate, st.floats(0.2, 1.5), st.sampled_from([0.25, 3.0]))
def test_time_can_be_told_in_other_units(scenario: Scenario, goal: float, scale: float) -> None:
    scenario = set_goal(scenario, goal)
    slow = dataclasses.replace(
        scenario,
        initial_velocity=scenario.initial_velocity / scale,
        duration=scenario.duration * scale,
        control_weight=scenario.control_weight * scale**3,
    )
    assert_same(solve(scenario), solve(slow), time=scale, velocity=1 / scale)


def write_model(directory: Path, old: str, new: str) -> str:
    text = (models_directory() / "point_mass_and_wall.sdf").read_text(encoding="utf-8")
    assert old in text
    path = directory / "variant.sdf"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("row", [1, 2])
def test_the_wall_may_be_elsewhere(row: int, tmp_path: Path) -> None:
    scenario = Scenario.named(f"table1/{row}")
    old, new = "<pose>-0.05 0 0 0 0 0</pose>", "<pose>0.15 0 0 0 0 0</pose>"
    shifted = dataclasses.replace(
        scenario,
        model=write_model(tmp_path, old, new),
        initial_position=scenario.initial_position + 0.2,
        goal_position=scenario.goal_position + 0.2,
    )
    assert_same(solve(scenario), rigid_optimum(World.from_scenario(shifted), shifted))


def test_the_joint_may_point_at_the_wall(tmp_path: Path) -> None:
    scenario = Scenario.named("table1/1")
    mirrored = dataclasses.replace(
        scenario,
        model=write_model(tmp_path, "<xyz>1 0 0</xyz>", "<xyz>-1 0 0</xyz>"),
        initial_position=-scenario.initial_position,
        initial_velocity=-scenario.initial_velocity,
        goal_position=-scenario.goal_position,
    )
    assert_same(solve(scenario), rigid_optimum(World.from_scenario(mirrored), mirrored))


def test_a_joint_askew_to_the_wall_meets_it_more_slowly(tmp_path: Path) -> None:
    scenario = Scenario.named("table1/1")
    skew = dataclasses.replace(
        scenario, model=write_model(tmp_path, "<xyz>1 0 0</xyz>", "<xyz>0.6 0.8 0</xyz>")
    )
    assert_same(solve(scenario), rigid_optimum(World.from_scenario(skew), skew), velocity=0.6)


# Bad input.


def test_two_coordinates_are_refused() -> None:
    world = World.from_diagram(make_diagram(num_joints=2))
    with pytest.raises(ModelError) as error:
        rigid_optimum(world, make_scenario([0.0, 1.0], [0.0, -2.0]))
    assert str(error.value) == (
        "the exact optimum: got 2 coordinates, expected one coordinate. For other worlds no exact "
        "optimum is known here; judge a plan by its replays."
    )


def test_a_spring_is_refused() -> None:
    world = World.from_diagram(make_diagram(spring=3.0, reference=0.5))
    with pytest.raises(ModelError, match=r"the bias h\(q, v\): got .*3 \*.*, expected a constant"):
        rigid_optimum(world, make_scenario())


def test_a_distance_that_is_not_affine_is_refused() -> None:
    world = shipped_world()
    (q,) = world.positions
    bent = Contact("bent", q**2, np.array([2 * q]))
    with pytest.raises(ModelError, match=r"∂φ/∂q of bent: got \(2 \* .*\), expected a constant"):
        rigid_optimum(dataclasses.replace(world, contacts=(bent,)), make_scenario())


def test_a_scenario_of_another_world_is_refused() -> None:
    with pytest.raises(ScenarioError, match="mass: got 3 kg, expected None, the model's"):
        rigid_optimum(shipped_world(), make_scenario(mass=3.0))
