"""The exact optimum: known values, closed forms, both simulations, its symmetries.

That no other motion is cheaper, test_line_optimum says, of the search that agrees with it.
"""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from optimum_worlds import cost_of
from replay_worlds import make_diagram, make_scenario, shipped_world
from rigid_worlds import AXIS, write_model

from benchmarks.optima.line_optimum import Line, LineBounce, Wall
from drake_aigto.dynamics import Contact
from drake_aigto.errors import ModelError
from drake_aigto.paper import RigidOptimum, rigid_optimum
from drake_aigto.simulation import confirms, replay_drake, replay_event_driven
from drake_aigto.world import Scales, Scenario, World

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

METRE = Scales(length=1.0, time=1.0, cost=1.0)

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


@pytest.mark.slow
@pytest.mark.parametrize("key", KNOWN)
def test_the_optimum_bounces_and_costs_as_it_says_in_both_simulations(
    key: tuple[int, float],
) -> None:
    (row, e), (cost, bounce, velocity, _) = key, KNOWN[key]
    scenario = dataclasses.replace(Scenario.named(f"table1/{row}"), restitution=e)
    world = World.from_scenario(scenario)
    q, v = scenario.initial_position[0], scenario.initial_velocity[0]
    n, rest = 200, 1.0 - bounce
    # Least squares: to the wall with this speed, then as near to the goal as is worth it. A unit of
    # force over an interval adds `dt` to the speed and `reach` to the way.
    dt, reach = bounce / n, (bounce / n) ** 2 * (n - np.arange(n) - 0.5)
    to_wall = np.vstack([np.full(n, dt), reach])
    approach = np.linalg.pinv(to_wall) @ [velocity - v, -q - v * bounce]
    dt, reach = rest / n, (rest / n) ** 2 * (n - np.arange(n) - 0.5)
    missing = scenario.goal_position[0] + e * velocity * rest
    departure = reach * missing / (reach @ reach + scenario.control_weight * dt)
    times = np.concatenate([np.linspace(0.0, bounce, n + 1), np.linspace(bounce, 1.0, n + 1)[1:]])
    control = times, np.concatenate([approach, departure])[:, np.newaxis]
    rigid = replay_event_driven(world, scenario, *control)
    drake = replay_drake(world, scenario, *control)
    assert rigid.cost == pytest.approx(cost, rel=1e-5, abs=1e-12)
    assert rigid.bounce_times == pytest.approx([bounce], abs=1e-12)
    assert np.sqrt(2 * rigid.energies_before[0]) == pytest.approx(-velocity, rel=1e-9)
    assert drake.cost == pytest.approx(cost, rel=5e-3, abs=1e-7)
    for replay in (rigid, drake):
        assert confirms(cost, replay, METRE, rigid.goal_error)


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


MODELS: dict[str, tuple[str, str, float, float, float]] = {
    # Name → text, its replacement, sign and shift of coordinates, speed of impact over that of q.
    "elsewhere": ("<pose>-0.05 0 0 0 0 0</pose>", "<pose>0.15 0 0 0 0 0</pose>", 1.0, 0.2, 1.0),
    "joint to the wall": (AXIS, "<xyz>-1 0 0</xyz>", -1.0, 0.0, 1.0),
    "joint askew": (AXIS, "<xyz>0.6 0.8 0</xyz>", 1.0, 0.0, 0.6),
}


@pytest.mark.parametrize("row", [1, 2])
@pytest.mark.parametrize("name", MODELS)
def test_the_wall_may_be_elsewhere_and_the_joint_turned(
    name: str, row: int, tmp_path: Path
) -> None:
    scenario = Scenario.named(f"table1/{row}")
    old, new, sign, shift, slowed = MODELS[name]
    moved = dataclasses.replace(
        scenario,
        model=write_model(tmp_path, old, new),
        initial_position=sign * scenario.initial_position + shift,
        initial_velocity=sign * scenario.initial_velocity,
        goal_position=sign * scenario.goal_position + shift,
    )
    assert_same(solve(scenario), rigid_optimum(World.from_scenario(moved), moved), velocity=slowed)


def test_two_coordinates_are_refused() -> None:
    world = World.from_diagram(make_diagram(num_joints=2))
    with pytest.raises(ModelError) as error:
        rigid_optimum(world, make_scenario([0.0, 1.0], [0.0, -2.0]))
    assert str(error.value) == (
        "the exact optimum: got 2 coordinates, expected one coordinate. For other worlds no exact "
        "optimum is known here; judge a plan by its replays."
    )


def test_a_distance_that_is_not_affine_is_refused() -> None:
    world = shipped_world()
    (q,) = world.positions
    bent = Contact("bent", q**2, np.array([2 * q]))
    with pytest.raises(ModelError, match=r"∂φ/∂q of bent: got \(2 \* .*\), expected a constant"):
        rigid_optimum(dataclasses.replace(world, contacts=(bent,)), make_scenario())
