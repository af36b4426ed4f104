"""The optimum on a line: mirrors, stationarity, and motions by chance.

Optima of two masses between walls: ghosts, mirrors, and what their contacts ask for.
"""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from marks import slow
from optimum_worlds import cost_of, draw, legs_of, seeds, solve, world_of

from benchmarks.optima import masses_optimum
from benchmarks.optima.line_optimum import Line, LineMotion, Wall
from benchmarks.optima.masses_optimum import _make_pair
from benchmarks.worlds import load_unequal
from drake_aigto.world import Scenario


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
restitutions = st.one_of(st.sampled_from([0.0, 0.5, 0.8, 1.0]), st.floats(0, 1))
weights = st.sampled_from([1e-2, 1.0, 3e3, 1e6])
corridors = st.builds(make_corridor, inside, st.floats(-6, 6), inside, restitutions, weights)
floors = st.builds(make_floor, inside, st.floats(-3, 3), inside, restitutions, weights)
walls = st.builds(make_wall, inside, st.floats(-4, 1), inside, restitutions, weights)
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
