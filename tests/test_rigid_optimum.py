"""Exact optima on a line: known values, closed forms, symmetries, and motions by chance."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from marks import slow
from optimum_worlds import (
    SAMPLES,
    Leg,
    cost_of,
    draw,
    ends,
    legs_of,
    restitutions,
    seeds,
    solve,
    world_of,
)
from replay_worlds import make_diagram, make_scenario, shipped_world
from rigid_worlds import AXIS, write_model

from benchmarks.optima import ContactOptimum, block_optimum, masses_optimum, walls_optimum
from benchmarks.optima.line_optimum import Line, LineBounce, LineMotion, Wall
from benchmarks.optima.masses_optimum import _make_pair
from benchmarks.worlds import WORLDS, load_unequal
from drake_aigto.dynamics import Contact
from drake_aigto.errors import ModelError, ScenarioError
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


def solve_row(scenario: Scenario) -> RigidOptimum:
    return rigid_optimum(shipped_world(scenario.mass), scenario)


@pytest.mark.parametrize("key", KNOWN)
def test_table_1_has_its_known_optima(key: tuple[int, float]) -> None:
    row, e = key
    cost, time, velocity, flight_cost = KNOWN[key]
    optimum = solve_row(dataclasses.replace(Scenario.named(f"table1/{row}"), restitution=e))
    assert optimum.cost == pytest.approx(cost, rel=1e-6, abs=1e-20)
    # The values above are rounded to six places.
    assert optimum.bounce_times == pytest.approx([time], abs=6e-7)
    assert optimum.impact_velocities == pytest.approx([velocity], abs=6e-7)
    assert optimum.flight_cost == pytest.approx(flight_cost, rel=1e-6)


@pytest.mark.parametrize("position", np.linspace(0.05, 1.7, 12))
def test_a_ball_that_comes_to_the_wall_at_the_very_end_has_an_optimum(position: float) -> None:
    optimum = solve_row(make_scenario(position, -position, goal_weight=0.0))
    assert optimum.cost == pytest.approx(0.0, abs=1e-20)


@given(scenarios, lengths)
def test_the_optimum_of_one_wall_is_a_motion_that_costs_as_much_and_no_more_than_a_flight(
    scenario: Scenario, goal: float
) -> None:
    scenario = set_goal(scenario, goal)
    p, v = scenario.initial_position[0], scenario.initial_velocity[0]
    w = scenario.goal_weight / scenario.control_weight
    force = 3 * w / (3 + w) * (goal - p - v)  # u(t) = force (1 − t)
    t = np.linspace(0, 1, 2001)
    path = p + v * t + force * (t**2 / 2 - t**3 / 6)
    cost = scenario.control_weight * force**2 / 3 + scenario.goal_weight * (path[-1] - goal) ** 2
    optimum = solve_row(scenario)
    if np.min(path) < -1e-12:
        assert optimum.flight_cost == math.inf
        assert len(optimum.bounce_times) == 1
    elif np.min(path) > 1e-4 * (p + abs(v)):
        assert optimum.flight_cost == pytest.approx(cost, rel=1e-9, abs=1e-18)
    assert optimum.cost <= optimum.flight_cost
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
    assert_same(
        solve_row(scenario), rigid_optimum(World.from_scenario(moved), moved), velocity=slowed
    )


def test_motions_without_an_optimum_that_is_known_exactly_are_refused() -> None:
    world, across = shipped_world(), World.from_diagram(make_diagram(num_joints=2))
    scenario, pushed = make_scenario(), make_scenario([0.0, 1.0], [0.0, -2.0])
    bent = Contact("bent", world.positions[0] ** 2, np.array([2 * world.positions[0]]))
    with pytest.raises(ModelError, match=r"∂φ/∂q of bent: got \(2 \* .*\), expected a constant"):
        rigid_optimum(dataclasses.replace(world, contacts=(bent,)), scenario)
    springy = World.from_diagram(make_diagram(spring=3.0, reference=0.5))
    for optimum in (rigid_optimum, walls_optimum):
        with pytest.raises(ModelError, match=r"the bias h\(q, v\): got .*3 \*.*, expected a const"):
            optimum(springy, scenario)
    with pytest.raises(ModelError, match=r"got M = \[\[.*, expected a diagonal matrix"):
        walls_optimum(across, pushed)
    with pytest.raises(ModelError) as error:
        rigid_optimum(across, pushed)
    assert str(error.value) == (
        "the exact optimum: got 2 coordinates, expected one coordinate. For other worlds no exact "
        "optimum is known here; judge a plan by its replays."
    )


def make_corridor(
    position: float = 0.3, velocity: float = 2.0, goal: float = 0.6, e: float = 0.8, w: float = 3e3
) -> Line:
    return Line(position, velocity, goal, w, 0.0, (Wall(0.0, 1, e), Wall(1.0, -1, e)))


def make_floor(
    position: float = 0.6,
    velocity: float = 0.0,
    goal: float = 0.4,
    e: float = 0.8,
    w: float = 3e3,
    gravity: float = 22.0,
) -> Line:
    return Line(position, velocity, goal, w, gravity, (Wall(0.0, 1, e),))


def make_wall(
    position: float = 0.6, velocity: float = -1.5, goal: float = 0.4, e: float = 0.8, w: float = 1e3
) -> Line:
    return make_floor(position, velocity, goal, e, w, gravity=0.0)


inside = st.floats(0.05, 0.95)
any_restitutions = st.one_of(st.sampled_from([0.0, 0.5, 0.8, 1.0]), st.floats(0, 1))
weights = st.sampled_from([1e-2, 1.0, 3e3, 1e6])
corridors = st.builds(make_corridor, inside, st.floats(-6, 6), inside, any_restitutions, weights)
floors = st.builds(make_floor, inside, st.floats(-3, 3), inside, any_restitutions, weights)
walls = st.builds(make_wall, inside, st.floats(-4, 1), inside, any_restitutions, weights)
lines = corridors | floors | walls


def solve_line(line: Line) -> LineMotion:
    return line.optimum(most_touches=4)


@given(corridors)
def test_elastic_walls_are_mirrors_and_coasting_tells_the_touches(line: Line) -> None:
    walls = tuple(wall._replace(restitution=1.0) for wall in line.walls)
    line = dataclasses.replace(line, walls=walls)
    end = line.position + line.velocity
    folded = abs((end + 1) % 2 - 1)
    motion = solve_line(line)
    k = 3 * line.weight / (3 + line.weight)
    assert motion.cost == pytest.approx(k * (folded - line.goal) ** 2, rel=1e-7, abs=1e-12)
    if abs(end - round(end)) > 1e-6:
        assert len(motion.bounces) == abs(math.floor(end))


@settings(max_examples=15)
@given(lines)
def test_the_optimum_is_a_motion_that_costs_as_much(line: Line) -> None:
    motion = solve_line(line)
    if motion.rest is None:
        assert cost_of(line, motion.bounces) == pytest.approx(motion.cost, rel=1e-7, abs=1e-12)


@settings(max_examples=5)
@given(lines)
@example(make_corridor(0.9453125, 0.9375, 0.5, 0.0, 0.01))
def test_forces_and_energy_follow_the_maximum_principle(line: Line) -> None:
    # The costate of the velocity, 2u, is divided by −e at a bounce; H = 2u̇v − u² + 2ug is kept.
    motion = solve_line(line)
    g, legs = line.gravity, legs_of(line, motion.bounces)
    if motion.rest is not None:
        return
    scale = max(abs(u) for leg in legs for u in leg.end_controls(g))
    for (before, after), bounce in zip(itertools.pairwise(legs), motion.bounces, strict=True):
        wall = line.walls[bounce.wall]
        last, first = before.end_controls(g)[1], after.end_controls(g)[0]
        assert wall.restitution * first == pytest.approx(-last, abs=1e-4 * scale + 1e-8)
        v = -wall.side * bounce.speed
        energy = 2 * before.b * v - last**2 + 2 * g * last
        again = -2 * after.b * wall.restitution * v - first**2 + 2 * g * first
        largest = scale * (abs(v) * scale / min(before.time, after.time) + scale + g)
        # Where a bounce takes all of the speed its time is found to 4e-4: J is flat there.
        assert again == pytest.approx(energy, abs=1e-3 * largest + 1e-8)


def test_without_rebound_a_ball_waits_on_the_floor_and_jumps() -> None:
    # From rest at T − τ: k (X + gτ²/2)² is least where X = gτ²/6, for a goal that must be met.
    X, g = 0.05, 22.0
    motion = solve_line(make_floor(position=0.3, goal=X, e=0.0, w=1e12, gravity=g))
    tau = math.sqrt(6 * X / g)
    assert motion.cost == pytest.approx(48 * X**2 / tau**3, rel=1e-6)
    assert motion.rest is not None
    assert motion.rest.end == pytest.approx(1 - tau, rel=1e-4)
    (bounce,) = motion.bounces
    assert bounce.time == pytest.approx(math.sqrt(2 * 0.3 / g), rel=1e-6)


def test_a_ball_settles_for_nothing() -> None:
    # Bounces after the first last 2y/g (e + e² + …).
    e, g = 0.3, 40.0
    motion = solve_line(make_floor(position=0.3, goal=0.001, e=e, gravity=g))
    assert motion.rest is not None
    (first,) = motion.bounces
    y = math.sqrt(2 * 0.3 * g)
    assert first.speed == pytest.approx(y, rel=1e-6)
    assert motion.rest.start == pytest.approx(first.time + 2 * y / g * e / (1 - e), rel=1e-6)


@pytest.mark.slow
@settings(max_examples=3)
@given(seeds)
def test_ghosts_that_fly_through_each_other_cost_what_listed_sequences_cost(seed: int) -> None:
    scenario = draw("two_masses", seed)
    pair, _, price = _make_pair(world_of("two_masses"), scenario)
    exact = solve("two_masses", scenario)
    cost, contacts = pair.solve_listed(most_meetings=1)
    # Listed sequences are motions, so none can be below; and all are, up to one meeting.
    assert price * cost >= exact.cost * (1 - 1e-9)
    if exact.contacts.count(1) <= 1:
        assert price * cost == pytest.approx(exact.cost, rel=1e-6, abs=1e-14)
        found = sorted(contacts)
        assert [kind for _, kind, _ in found] == list(exact.contacts)
        speeds = [speed / scenario.duration for _, _, speed in found]
        assert speeds == pytest.approx([t.impact_speed for t in exact.touches], rel=1e-3)


@pytest.mark.parametrize(("ratio", "e"), [(3.0, 1.0), (0.3, 0.8)])
@pytest.mark.parametrize("seed", [1, *slow(4)])
def test_unequal_masses_cost_what_the_times_of_their_contacts_ask_for(
    ratio: float, e: float, seed: int
) -> None:
    scenario = draw("two_masses", seed, restitution=e)
    world = load_unequal(scenario, ratio)
    found = masses_optimum(world, scenario, most_meetings=1)
    contacts, times = list(found.contacts), np.array([touch.start for touch in found.touches])
    least = cost_of_times(scenario, ratio, contacts, times)
    assert found.cost == pytest.approx(least, rel=1e-6, abs=1e-15)
    rng = np.random.default_rng(seed)
    for size in (1e-4, 1e-2):
        for moves in rng.uniform(-size, size, (20, times.size)):
            others = times + moves
            if np.all(np.diff([0.0, *others, scenario.duration]) > 0):
                cost = cost_of_times(scenario, ratio, contacts, others)
                assert cost >= found.cost * (1 - 1e-6) - 1e-15


def cost_of_times(
    scenario: Scenario, ratio: float, contacts: list[int], times: np.ndarray
) -> float:
    """Returns the least cost of two masses that are at these contacts at these times.

    Between given times all is linear: state x = (q, v), contact c at distance g · q + φ₀, where it
    sends v to V v. Each thing that is asked for, aᵀ x(t) = b, is ∫ k(s) · u(s) ds = b − aᵀ x₀(t),
    with x₀ the motion without control and k(s) the costate that a leaves at s. So the least of
    w_u ∫ u² is w_u rᵀ (∫ k kᵀ)⁻¹ r; a miss of the goal at a price w_f adds w_u/w_f to the diagonal.
    """
    masses, T = np.array([1.0, ratio]), scenario.duration
    slopes = np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, -1.0]])
    maps = []
    for contact in contacts:
        J, kick = slopes[contact], slopes[contact] / masses
        V = np.eye(2) - (1 + scenario.restitution) * np.outer(kick, J) / (J @ kick)
        maps.append(np.block([[np.eye(2), np.zeros((2, 2))], [np.zeros((2, 2)), V]]))
    asked = [
        (t, np.append(slopes[c], [0, 0]), -float(c == 2))
        for t, c in zip(times, contacts, strict=True)
    ]
    asked += [(T, np.eye(4)[i], scenario.goal_position[i]) for i in range(2)]
    can_miss = np.array([0.0] * len(times) + [1.0, 1.0])
    joints = np.array([0.0, *times, T])
    start = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    kernels, misses = [], []
    for t, row, value in asked:
        # At both ends and in the middle of each interval, for Simpson's rule.
        kernel = np.zeros((len(joints) - 1, 3, 2))
        for j in reversed(range(len(joints) - 1)):
            h = joints[j + 1] - joints[j]
            if joints[j + 1] <= t:
                for k, left in enumerate((h, h / 2, 0.0)):
                    kernel[j, k] = (row[2:] + left * row[:2]) / masses
                row = np.concatenate([row[:2], row[2:] + h * row[:2]])
                if j > 0:
                    row = row @ maps[j - 1]
        kernels.append(kernel)
        misses.append(value - row @ start)
    h = np.diff(joints)[:, np.newaxis, np.newaxis] * np.array([1, 4, 1])[:, np.newaxis] / 6
    gram = np.einsum("aijk,bijk->ab", np.array(kernels), h * np.array(kernels))
    gram += np.diag(can_miss) * scenario.control_weight / scenario.goal_weight
    return float(scenario.control_weight * np.dot(misses, np.linalg.solve(gram, misses)))


Optimum = Callable[[World, Scenario], Any]


@given(
    st.floats(0.1, 2),
    st.floats(-4, 1),
    st.floats(0.1, 2),
    restitutions,
    st.sampled_from([1e-3, 1.0, 1e3]),
)
def test_one_wall_has_the_optimum_by_algebra(
    p: float, v: float, goal: float, e: float, weight: float
) -> None:
    scenario = dataclasses.replace(
        make_scenario(p, v, restitution=e, goal_weight=weight), goal_position=goal
    )
    known = rigid_optimum(shipped_world(), scenario)
    found = walls_optimum(shipped_world(), scenario)
    assert found.cost == pytest.approx(known.cost, rel=1e-6, abs=1e-14)
    if abs(known.cost - known.flight_cost) > 1e-6 * known.cost + 1e-12:
        times = [touch.start for touch in found.touches]
        assert times == pytest.approx(known.bounce_times, rel=1e-3)


@settings(max_examples=5)
@given(seeds, restitutions)
def test_a_room_costs_what_its_two_corridors_cost(seed: int, e: float) -> None:
    scenario = draw("room", seed, restitution=e)
    room = solve("room", scenario)
    corridors = [
        solve("corridor", draw("corridor", 0, restitution=e, **ends(scenario, axis)))
        for axis in range(2)
    ]
    assert room.cost == pytest.approx(sum(each.cost for each in corridors), rel=1e-9)
    for axis, corridor in enumerate(corridors):
        mine = [touch for touch in room.touches if touch.contact // 2 == axis]
        assert [touch.contact % 2 for touch in mine] == list(corridor.contacts)
        assert [touch.start for touch in mine] == [touch.start for touch in corridor.touches]


@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_a_room_with_a_block_costs_no_more_than_the_empty_one_if_that_is_clear(seed: int) -> None:
    scenario = draw("room_with_block", seed)
    empty = dataclasses.replace(scenario, model=draw("room", 0).model)
    optimum, other = solve("room_with_block", scenario), solve("room", empty)
    if is_off_block(scenario, other):
        assert optimum.cost <= other.cost * (1 + 1e-9)
    else:
        assert optimum.cost != pytest.approx(other.cost, rel=1e-6)


def test_a_block_on_the_way_is_passed_at_its_corner_or_bounced_off() -> None:
    # Straight across the middle, at rest: the way around touches nothing, and passes corners.
    scenario = draw(
        "room_with_block",
        0,
        initial_position=[0.3, 0.35],
        initial_velocity=[0.0, 0.0],
        goal_position=[0.45, 0.7],
        restitution=1.0,
    )
    straight = 3e-3 * np.sum((scenario.goal_position - scenario.initial_position) ** 2) / 1.5**3
    around = solve("room_with_block", scenario)
    assert around.touches == ()
    # The line passes 0.4 at 0.58, inside the block: a detour, but a short one.
    assert straight < around.cost < 1.5 * straight


@pytest.mark.parametrize("name", WORLDS)
def test_random_scenarios_fit_their_world_and_are_the_same_again(name: str) -> None:
    study = WORLDS[name]
    scenarios = list(study.draw(20, seed=3))
    assert scenarios[:5] == list(study.draw(5, seed=3))
    assert scenarios[0] != next(study.draw(1, seed=4))
    assert {scenario.restitution for scenario in scenarios} == set(study.restitutions)
    for scenario in scenarios:
        world_of(name).check(scenario)


def axis_line(scenario: Scenario, axis: int) -> Line:
    """Returns the problem of one axis, in unit time; a wall for each contact, if of this axis."""
    name = scenario.model.rpartition("/")[2].removesuffix(".sdf")
    world, T, q = world_of(name), scenario.duration, scenario.initial_position
    distances, jacobian = world.calc_signed_distance(q), world.calc_contact_jacobian(q)
    walls = tuple(
        Wall(q[axis] - distances[i] / J[axis], int(J[axis]), scenario.restitution)
        if J[axis]
        else Wall(0.0, 0, 0.0)
        for i, J in enumerate(jacobian)
    )
    return Line(
        position=q[axis],
        velocity=scenario.initial_velocity[axis] * T,
        goal=scenario.goal_position[axis],
        weight=scenario.goal_weight * T**3 / scenario.control_weight,
        gravity=world.bias[axis].Evaluate() * T**2,
        walls=walls,
    )


def axis_legs(scenario: Scenario, optimum: ContactOptimum, axis: int) -> list[Leg]:
    line, T = axis_line(scenario, axis), scenario.duration
    bounces = [
        LineBounce(touch.start / T, touch.contact, touch.impact_speed * T)
        for touch in optimum.touches
        if line.walls[touch.contact].side
    ]
    return legs_of(line, bounces)


def passes_corner(scenario: Scenario, optimum: ContactOptimum) -> bool:
    """Returns whether the optimum costs more than its touches alone make it."""
    cost = 0.0
    for axis in range(len(scenario.initial_position)):
        line, legs = axis_line(scenario, axis), axis_legs(scenario, optimum, axis)
        cost += sum(leg.effort(line.gravity) for leg in legs)
        cost += line.weight * (legs[-1].path()[-1] - line.goal) ** 2
    return optimum.cost > cost * scenario.control_weight / scenario.duration**3 * (1 + 1e-6) + 1e-12


def is_off_block(scenario: Scenario, optimum: ContactOptimum) -> bool:
    paths = []
    for axis in range(2):
        legs = axis_legs(scenario, optimum, axis)
        starts = np.cumsum([0.0, *(leg.time for leg in legs[:-1])])
        times = np.concatenate(
            [t + leg.time * SAMPLES for t, leg in zip(starts, legs, strict=True)]
        )
        path = np.concatenate([leg.path() for leg in legs])
        paths.append(np.interp(np.linspace(0, 1, 5001), times, path))
    return not np.any(np.max(np.abs(np.array(paths) - 0.5), axis=0) < 0.1 - 1e-6)


def optimal_controls(
    scenario: Scenario, optimum: ContactOptimum, steps: int
) -> tuple[np.ndarray, np.ndarray]:
    """Returns knots, those of touches among them, and what forces are in the middle between."""
    T = scenario.duration
    knots = np.unique([*np.linspace(0, T, steps + 1), *(t.start for t in optimum.touches)])
    middles = (knots[1:] + knots[:-1]) / 2 / T
    columns = []
    for axis in range(len(scenario.initial_position)):
        legs = axis_legs(scenario, optimum, axis)
        gravity = axis_line(scenario, axis).gravity
        starts = np.cumsum([0.0, *(leg.time for leg in legs[:-1])])
        which = np.searchsorted(starts, middles, side="right") - 1
        u = [
            legs[i].a + legs[i].b * (t - starts[i]) + gravity
            for i, t in zip(which, middles, strict=True)
        ]
        columns.append(np.array(u) / T**2)
    return knots, np.column_stack(columns)


@pytest.mark.parametrize("name", ["corridor", "floor", "room", "room_with_block"])
@pytest.mark.parametrize(("seed", "e"), [(0, 1.0), *slow((1, 0.8), (2, 0.8))])
def test_the_replayed_optimum_touches_and_costs_as_it_says(name: str, seed: int, e: float) -> None:
    scenario = draw(name, seed, restitution=e)
    optimum = solve(name, scenario)
    if any(touch.lasts for touch in optimum.touches) or passes_corner(scenario, optimum):
        return
    knots, controls = optimal_controls(scenario, optimum, 1000)
    replay = replay_event_driven(world_of(name), scenario, knots, controls)
    assert replay.cost == pytest.approx(optimum.cost, rel=1e-3, abs=1e-9)
    assert replay.bounce_contacts == optimum.contacts
    assert replay.bounce_times == pytest.approx([t.start for t in optimum.touches], abs=1e-4)


@pytest.mark.parametrize(
    ("optimum", "model", "message"),
    [
        (walls_optimum, "room_with_block", "a box with several faces, expected walls. For other"),
        (walls_optimum, "two_masses", r"right_ball, expected a wall across one axis. For other wo"),
        (masses_optimum, "corridor", "expected two masses on a line: a wall, a mass, a mass"),
        (masses_optimum, "room", r"got ∂φ/∂q = \[\(1.0, 0.0\), \(-1.0, 0.0\)"),
        (block_optimum, "room", "expected four walls and one box across two axes"),
    ],
)
def test_worlds_of_another_shape_are_refused(optimum: Optimum, model: str, message: str) -> None:
    with pytest.raises(ModelError, match=message):
        optimum(world_of(model), draw(model, 0))


@pytest.mark.parametrize("optimum", [rigid_optimum, walls_optimum, masses_optimum, block_optimum])
def test_a_scenario_of_another_world_is_refused(optimum: Optimum) -> None:
    with pytest.raises(ScenarioError, match="mass: got 3 kg, expected None, the model's"):
        optimum(world_of("corridor"), draw("corridor", 0, mass=3.0))
