"""The event-driven rigid walls, one and several, judged by exact mathematics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal, localcontext
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from marks import slow
from replay_worlds import (
    hold,
    hold_still,
    make_diagram,
    make_line,
    make_scenario,
    make_task,
    make_wedge,
    shipped,
    shipped_world,
)

from drake_aigto.simulation import Replay, replay_event_driven
from drake_aigto.world import World


@dataclass
class ExactRun:
    """Where the mass ends, and every impact that a series did not sum up."""

    position: float = 0.0
    velocity: float = 0.0
    impact_times: list[float] = field(default_factory=list)
    impact_speeds: list[float] = field(default_factory=list)
    shortest_hop: float = float("inf")  # of those that a push brought back [s]


def run_exactly(
    position: float,
    velocity: float,
    times: Sequence[float],
    controls: Sequence[float],
    restitution: float,
    mass: float = 1.0,
    length: float | None = None,
) -> ExactRun:
    """Returns how a mass moves that starts with (q ≥ 0, v) and is pushed by held forces.

    The wall is at 0; with a length, there is another one that far from it.
    """
    with localcontext() as context:
        context.prec = 40
        q, v, e = Decimal(position), Decimal(velocity), Decimal(restitution)
        # Position of a wall, and which way it faces.
        walls = [(Decimal(0), 1)] + ([(Decimal(length), -1)] if length else [])
        result = ExactRun()
        time = Decimal(times[0])
        for end, control in zip(times[1:], controls, strict=True):
            a, stop = Decimal(control) / Decimal(mass), Decimal(end)
            rests = False
            while True:
                rests = v == 0 and any(q == wall and side * a <= 0 for wall, side in walls)
                waits = [
                    (wait, wall, side)
                    for wall, side in walls
                    if (wait := _time_to_wall(side * (q - wall), side * v, side * a)) is not None
                ]
                if rests or not waits or time + min(waits)[0] > stop:
                    break
                wait, wall, side = min(waits)
                q, v, time = wall, v + a * wait, time + wait
                result.impact_times.append(float(time))
                result.impact_speeds.append(float(abs(v)))
                v = -e * v
                pressed = side * a < 0 and not (length and v * v >= 2 * abs(a) * Decimal(length))
                if pressed and e < 1 and time + 2 * abs(v / a) / (1 - e) <= stop:
                    v = Decimal(0)  # the sum of all hops that follow
                elif pressed:
                    result.shortest_hop = min(result.shortest_hop, float(2 * abs(v / a)))
            left, time = stop - time, stop
            if not rests:
                q, v = q + v * left + a * left * left / 2, v + a * left
        result.position, result.velocity = float(q), float(v)
        return result


def _time_to_wall(q: Decimal, v: Decimal, a: Decimal) -> Decimal | None:
    """Returns when q + v t + a t²/2 next falls to zero, or None if it never does."""
    if q == 0 and (v < 0 or (v == 0 and a < 0)):
        return Decimal(0)
    if q == 0:
        return -2 * v / a if a < 0 else None
    discriminant = v * v - 2 * a * q
    if discriminant <= 0:
        return None  # a graze changes nothing
    if v < 0:
        return 2 * q / (discriminant.sqrt() - v)
    return (v + discriminant.sqrt()) / -a if a < 0 else None


# What the event-driven walls promise; they mostly are a thousand times better.
EXACT = 1e-8
DEEPEST = 1e-12
# Of numbers near 1 [m].
ROUNDING = 1e-15

RESTITUTIONS = [1.0, 0.8, 0.5, 0.2, 0.0]

places = st.floats(0.02, 0.98)
speeds = st.floats(-4, 4)
# To the micronewton: a pull of 1e-85 N lifts a ball by less than its position's rounding.
forces = st.floats(-20, 20).map(lambda f: round(f, 6)) | st.integers(-20, 20).map(float)


def run(
    world: World, q: Any, v: Any, times: npt.ArrayLike, controls: npt.ArrayLike, e: float = 1.0
) -> Replay:
    scenario = make_task("room", q, v, restitution=e)
    return replay_event_driven(world, scenario, times, controls)


@st.composite
def held_forces(draw: st.DrawFn, columns: int) -> tuple[list[float], npt.NDArray[np.float64]]:
    gaps = draw(st.lists(st.floats(0.01, 0.4), min_size=1, max_size=8))
    rows = st.lists(forces, min_size=columns, max_size=columns)
    controls = draw(st.lists(rows, min_size=len(gaps), max_size=len(gaps)))
    return np.concatenate([[0.0], np.cumsum(gaps)]).tolist(), np.array(controls)


# Name → world, mass [kg], where a second wall of each axis is [m], and the largest penetration.
WORLDS: dict[str, tuple[World, float, float | None, float]] = {
    "one wall": (shipped_world(), 1.0, None, ROUNDING),
    "one wall, 2 kg": (shipped_world(2.0), 2.0, None, ROUNDING),
    "corridor": (shipped("corridor"), 1.0, 1.0, DEEPEST),
    "room": (shipped("room"), 1.0, 1.0, DEEPEST),
}


@pytest.mark.parametrize("name", WORLDS)
@settings(max_examples=16)
@given(
    *(st.tuples(places, speeds) for _ in range(2)),
    held_forces(2),
    st.sampled_from(RESTITUTIONS) | st.floats(0, 1),
)
def test_every_axis_moves_as_the_exact_solution(
    name: str, x: tuple[float, float], y: tuple[float, float], control: Any, e: float
) -> None:
    # In the room also rest on one wall, sliding along it into the next, and rest on both.
    world, mass, length, deepest = WORLDS[name]
    times, u = control
    q, v = np.array((x, y)[: world.num_positions]).T
    replay = run(world, q, v, times, u[:, : len(q)], e)
    for axis in range(len(q)):
        exact = run_exactly(q[axis], v[axis], times, u[:, axis].tolist(), e, mass, length)
        # Shorter hops may become rest (`simulation.flights`): a tolerance that is stated.
        assume(exact.shortest_hop > 1e-6 * 20 * replay.times[-1])
        assert abs(replay.positions[-1, axis] - exact.position) < EXACT
        assert abs(replay.velocities[-1, axis] - exact.velocity) < 10 * EXACT
        if len(q) == 1:
            for time in exact.impact_times[: len(replay.bounce_times)]:
                assert min(abs(time - np.array(replay.bounce_times))) < EXACT
    if len(q) == 1:
        np.testing.assert_allclose(replay.energy_ratios, e**2, atol=1e-12)
    assert replay.max_penetration <= deepest
    assert np.all(np.diff(replay.times) >= 0)


@settings(max_examples=40)
@given(places, st.floats(-30, 30))
@example(0.5, -400.0)
def test_elastic_walls_fold_a_free_flight(q: float, v: float) -> None:
    unfolded = q + v
    assume(abs(unfolded - round(unfolded)) > 1e-9)  # At the very end a bounce counts, or does not.
    replay = run(shipped("corridor"), q, v, *hold_still(shipped("corridor")))
    assert replay.positions[-1, 0] == pytest.approx(1 - abs(1 - unfolded % 2), abs=1e-12)
    assert len(replay.bounce_times) == abs(math.floor(unfolded))
    first = int(v > 0)
    sides = [(first + k) % 2 for k in range(len(replay.bounce_times))]
    assert replay.bounce_contacts == tuple(sides)
    if replay.bounce_times:
        to_first = (first - q) / v
        times = to_first + np.arange(len(sides)) / abs(v)
        np.testing.assert_allclose(replay.bounce_times, times, rtol=1e-12)
    assert len(replay.times) == 21 + 2 * len(sides)
    np.testing.assert_allclose(replay.energy_ratios, 1.0, atol=1e-13)


@pytest.mark.parametrize("e", RESTITUTIONS)
@pytest.mark.parametrize("shift", [0.0, *(s * 10.0**-n for n in (5, 10, 16) for s in (1, -1))])
def test_a_corner_turns_the_ball_round_at_once(e: float, shift: float) -> None:
    q, v = np.array([0.5, 0.25 + shift]), np.array([-2.0, -1.0])
    times, u = hold_still(shipped("room"), 0.5)
    replay = run(shipped("room"), q, v, times, u, e)
    assert sorted(replay.bounce_contacts) == [0, 2]
    assert replay.bounce_times == pytest.approx([0.25, 0.25], abs=1.1 * abs(shift) + 1e-14)
    late = np.array([0.25, 0.25 - shift])
    np.testing.assert_allclose(replay.velocities[-1], -e * v, atol=1e-14)
    np.testing.assert_allclose(replay.positions[-1], -e * v * late, atol=1e-13)


def test_the_ball_rests_in_a_corner_and_slides_out_of_it() -> None:
    times = np.linspace(0.0, 3.0, 301)
    u = np.tile([-4.0, -3.0], (300, 1))
    u[200:, 0] = 1.0
    replay = run(shipped("room"), [0.3, 0.2], [0.0, 0.0], times, u, 0.3)
    in_corner = (replay.times > 1.5) & (replay.times < 2.0)
    assert np.all(np.abs(replay.positions[in_corner]) <= 1e-13)
    assert np.all(replay.velocities[in_corner] == 0)
    np.testing.assert_allclose(replay.positions[-1], [1 / 2, 0], atol=1e-11)
    np.testing.assert_allclose(replay.velocities[-1], [1, 0], atol=1e-11)


@pytest.mark.parametrize("n", [5, *slow(2, 3, 4)])
@given(st.floats(0.1, 0.9), st.floats(-3, 3), st.floats(-3, 3))
def test_an_elastic_wedge_of_a_whole_part_of_a_half_turn_folds_a_free_flight(
    n: int, place: float, x: float, y: float
) -> None:
    # Reflections in its walls make 2n copies of the wedge around the corner.
    angle = math.pi / n
    world = make_wedge(angle)
    start, v = np.array([math.cos(place * angle), math.sin(place * angle)]), np.array([x, y])
    assume(np.linalg.norm(v) > 0.1)
    nearest = abs(start[0] * y - start[1] * x) / np.linalg.norm(v)
    assume(nearest > 1e-3)  # A corner itself has no answer.
    replay = run(world, start, v, *hold_still(world))
    free = start + v
    turn = math.atan2(free[1], free[0]) % (2 * angle)
    turn = min(turn, 2 * angle - turn)
    end = np.linalg.norm(free) * np.array([math.cos(turn), math.sin(turn)])
    np.testing.assert_allclose(replay.positions[-1], end, atol=1e-11)
    assert len(replay.bounce_times) <= n
    np.testing.assert_allclose(replay.energy_ratios, 1.0, atol=1e-12)


@pytest.mark.parametrize("e", [1.0, 0.5, 0.0])
def test_a_ball_pressed_into_a_wedge_rests_on_both_walls(e: float) -> None:
    world = make_wedge(math.pi / 3)
    times, u = np.linspace(0.0, 2.0, 101), np.tile([-6.0, 0.0], (100, 1))
    replay = run(world, [0.2, 0.1], [0.0, 0.0], times, u, e)
    assert replay.max_penetration <= DEEPEST
    if e < 1:
        np.testing.assert_allclose(replay.positions[-1], 0, atol=1e-9)
        np.testing.assert_allclose(replay.velocities[-1], 0, atol=1e-9)
    else:
        work = -6.0 * (replay.positions[-1, 0] - 0.2)
        energy = world.calc_kinetic_energy(replay.positions[-1], replay.velocities[-1])
        assert energy == pytest.approx(work, abs=1e-5)


def test_walls_have_the_restitution_of_the_model() -> None:
    world = make_wedge(math.pi / 2, (0.5, None))
    replay = run(world, [0.2, 0.1], [-1.0, -1.0], *hold_still(world), 0.8)
    np.testing.assert_allclose(replay.velocities[-1], [0.8, 0.5])
    assert replay.bounce_contacts == (0, 1)


def test_a_ball_slides_over_the_edge_of_a_block() -> None:
    # Down onto the block, along it to its edge at x = 0.6, and past that down to the wall.
    times = np.linspace(0.0, 0.6, 61)
    u = np.tile([0.0, -5.0], (60, 1))
    replay = run(shipped("room_with_block"), [0.45, 0.65], [0.5, 0.0], times, u, 0.0)
    edge = (0.6 - 0.45) / 0.5
    resting = (replay.times > 0.15) & (replay.times < edge)
    np.testing.assert_allclose(replay.positions[resting, 1], 0.6, atol=1e-13)
    np.testing.assert_allclose(replay.positions[-1, 0], 0.45 + 0.6 * 0.5, atol=1e-12)
    falling = replay.times > edge
    fall = 0.6 - 2.5 * (replay.times[falling] - edge) ** 2
    np.testing.assert_allclose(replay.positions[falling, 1], fall, atol=1e-6)
    np.testing.assert_allclose(replay.velocities[-1], [0.5, -5 * (0.6 - edge)], atol=1e-12)


@pytest.mark.parametrize(
    ("q", "v", "contact", "end"),
    [
        ([0.2, 0.5], [0.5, 0.01], 5, [0.1, 0.51]),
        ([0.8, 0.5], [-0.5, 0.01], 4, [0.9, 0.51]),
        ([0.45, 0.8], [0.1, -0.5], 6, [0.55, 0.9]),
        ([0.45, 0.2], [0.1, 0.5], 7, [0.55, 0.1]),
        ([0.3, 0.3], [0.5, 0.1], None, [0.8, 0.4 - 1e-9]),
    ],
)
def test_a_block_is_bounced_off_on_every_side(
    q: list[float], v: list[float], contact: int | None, end: list[float]
) -> None:
    if contact is None:
        q = [q[0], q[1] - 1e-9]  # A hair below the block.
    replay = run(shipped("room_with_block"), q, v, *hold_still(shipped("room_with_block"), steps=3))
    assert replay.bounce_contacts == (() if contact is None else (contact,))
    np.testing.assert_allclose(replay.positions[-1], end, atol=1e-12)


@given(
    st.sampled_from([(0.2, 0.5), (0.7, 0.3), (0.5, 0.9)]),
    st.tuples(speeds, speeds),
    held_forces(2),
    st.sampled_from(RESTITUTIONS),
)
# Beside the block it falls, and is below as it comes to where the block is.
@example((0.2, 0.5), (0.0, 0.5), ([0.0, 0.375], np.array([[3.0, -5.0]])), 1.0)
def test_nothing_gets_into_a_block_whatever_is_done(
    q: tuple[float, float], v: tuple[float, float], control: Any, e: float
) -> None:
    world, (times, u) = shipped("room_with_block"), control
    replay = run(world, q, v, times, u, e)
    assert replay.max_penetration <= DEEPEST
    assert np.all(np.diff(replay.times) >= 0)
    assert all(ratio <= 1 + 1e-12 for ratio in replay.energy_ratios)
    swapped = run(world, q[::-1], v[::-1], times, u[:, ::-1], e)
    assume(len(replay.bounce_times) < 10)
    np.testing.assert_allclose(swapped.positions[-1], replay.positions[-1, ::-1], atol=1e-6)
    order = [2, 3, 0, 1, 6, 7, 4, 5]  # x and y change places
    assert sorted(swapped.bounce_contacts) == sorted(order[i] for i in replay.bounce_contacts)


@settings(max_examples=40)
@given(places, places, speeds, speeds, held_forces(1))
def test_equal_masses_exchange_their_velocities(
    q0: float, q1: float, v0: float, v1: float, control: Any
) -> None:
    # As if each went through the other one.
    q0, q1 = sorted((q0, q1))
    assume(q1 - q0 > 1e-3)
    times, u = control
    ghosts = [
        run_exactly(q, v, times, u[:, 0].tolist(), 1.0, length=1.0) for q, v in ((q0, v0), (q1, v1))
    ]
    assume(min(ghost.shortest_hop for ghost in ghosts) > 1e-3)
    replay = run(shipped("two_masses"), [q0, q1], [v0, v1], times, np.hstack([u, u]))
    ends = sorted(ghost.position for ghost in ghosts)
    np.testing.assert_allclose(replay.positions[-1], ends, atol=EXACT)
    assert replay.max_penetration <= DEEPEST


@pytest.mark.parametrize(("ratio", "count"), [(1, 3), (100, 31), (10_000, 314)])
def test_a_heavy_ball_a_light_one_and_a_wall_count_the_digits_of_pi(ratio: int, count: int) -> None:
    # Galperin, "Playing pool with π", Regular and Chaotic Dynamics 8 (2003).
    world = make_line((1.0, float(ratio)))
    replay = run(world, [0.3, 0.5], [0.0, -1.0], *hold_still(world, duration=8.0))
    assert len(replay.bounce_times) == count
    energy = world.constant_inertia.mass_matrix @ replay.velocities[-1] ** 2 / 2
    assert np.sum(energy) == pytest.approx(ratio / 2, rel=1e-10)
    assert 0 <= replay.velocities[-1, 0] <= replay.velocities[-1, 1]


@given(places, places, speeds, speeds, held_forces(2), st.sampled_from(RESTITUTIONS))
def test_two_masses_have_a_mirror_and_lose_energy_only(
    q0: float, q1: float, v0: float, v1: float, control: Any, e: float
) -> None:
    q0, q1 = sorted((q0, q1))
    assume(q1 - q0 > 1e-3)
    times, u = control
    world = shipped("two_masses")
    replay = run(world, [q0, q1], [v0, v1], times, u, e)
    assert replay.max_penetration <= DEEPEST
    assert all(ratio <= 1 + 1e-12 for ratio in replay.energy_ratios)
    at_knots = np.searchsorted(replay.times, times, side="right") - 1
    work = np.sum(u * np.diff(replay.positions[at_knots], axis=0))
    gained = (np.sum(replay.velocities[-1] ** 2) - v0**2 - v1**2) / 2
    assert gained <= work + 1e-6
    if len(replay.bounce_times) < 8:
        other = run(world, [1 - q1, 1 - q0], [-v1, -v0], times, -u[:, ::-1], e)
        np.testing.assert_allclose(other.positions[-1], 1 - replay.positions[-1, ::-1], atol=1e-6)


def test_momentum_goes_along_the_contact() -> None:
    world = make_line((1.0, 3.0))
    replay = run(world, [0.4, 0.6], [0.5, -1.0], *hold_still(world, 0.2), 0.5)
    assert replay.bounce_contacts == (0,)
    masses = np.diag(world.constant_inertia.mass_matrix)
    exchanged = masses * (replay.velocities[-1] - [0.5, -1.0])
    assert exchanged == pytest.approx([-exchanged[1], exchanged[1]]) and exchanged[1] > 0
    assert np.diff(replay.velocities[-1])[0] == pytest.approx(0.5 * 1.5)


@pytest.mark.parametrize("e", [0.7, 0.3, 0.0])
def test_a_stack_comes_to_rest(e: float) -> None:
    world = make_line((1.0, 2.0), gravity=9.81)
    times, u = hold_still(world, 3.0, 30)
    replay = run(world, [0.1, 0.3], [0.0, 0.0], times, u, e)
    assert replay.max_penetration <= DEEPEST
    np.testing.assert_allclose(replay.positions[-1], 0, atol=1e-9)
    np.testing.assert_allclose(replay.velocities[-1], 0, atol=1e-9)


def test_a_blow_goes_through_what_rests() -> None:
    # The first ball is pressed to the wall; hit, it kicks back, as a row of balls does.
    world = make_line((1.0, 1.0))
    times, u = np.linspace(0.0, 0.5, 51), np.tile([-1.0, 0.0], (50, 1))
    replay = run(world, [1e-3, 0.4], [0.0, -2.0], times, u, 0.0)
    np.testing.assert_allclose(replay.velocities[-1], 0, atol=1e-12)
    elastic = run(world, [0.0, 0.4], [0.0, -2.0], times, 0 * u, 1.0)
    np.testing.assert_allclose(elastic.velocities[-1], [0, 2], atol=1e-12)
    assert elastic.bounce_contacts == (0, 1, 0)


def test_bodies_that_collapse_onto_each_other_do_not_hang() -> None:
    world = make_line((1.0, 100.0))
    for e in (0.1, 0.5, 0.8):
        replay = run(world, [0.3, 0.5], [0.0, -1.0], *hold_still(world, 2.0), e)
        assert replay.max_penetration <= DEEPEST
        energy = np.diag(world.constant_inertia.mass_matrix) @ replay.velocities[-1] ** 2 / 2
        assert energy <= 50
        assert np.all(np.diff(replay.positions[-1]) >= -DEEPEST)


# Of knots from a bounce [s]: none, or down to the rounding of times.
SHIFTS = st.floats(-1e-6, 1e-6) | st.sampled_from(
    [0.0, *(sign * 10.0**-n for n in range(9, 17) for sign in (1, -1))]
)


@given(
    st.floats(0.1, 1.5),
    st.floats(-3, -0.5),
    st.lists(SHIFTS, min_size=1, max_size=5, unique=True),
    st.sampled_from(RESTITUTIONS),
)
def test_a_bounce_on_a_knot_or_where_knots_crowd_happens_once(
    q: float, v: float, shifts: list[float], e: float
) -> None:
    impact = -q / v
    times = np.array([0.0, *(impact + np.sort(shifts)), impact + 0.5])
    assume(np.all(np.diff(times) > 0))
    forces = [0.0, *(5.0 * (-1) ** k for k in range(len(shifts)))]
    exact = run_exactly(q, v, times.tolist(), forces, e)
    scenario = make_scenario(q, v, restitution=e)
    replay = replay_event_driven(shipped_world(), scenario, times, np.c_[forces])
    assert replay.bounce_times[0] == pytest.approx(exact.impact_times[0], abs=1e-13)
    assert replay.positions[-1, 0] == pytest.approx(exact.position, abs=EXACT)
    # Without rebound, pushes of a microsecond between knots lift it, and it falls once more.
    assert sum(time < impact + 0.02 for time in replay.bounce_times) == 1 or not e


@pytest.mark.parametrize("e", RESTITUTIONS)
@pytest.mark.parametrize("v", [-1.0, -1e-9, 0.0, 1e-9, 1e-3, 1.0])
@pytest.mark.parametrize("push", [-3.0, 0.0, 3.0])
def test_a_start_at_the_wall(e: float, v: float, push: float) -> None:
    times, forces = [0.0, 0.3, 0.6, 1.0], [push, 1.0, -2.0]
    replay = replay_event_driven(
        shipped_world(), make_scenario(0.0, v, restitution=e), times, np.c_[forces]
    )
    assert replay.max_penetration <= ROUNDING
    if e < 1 or abs(v) > 1e-6 or push >= 0:  # Else the exact solution hops 400 million times.
        exact = run_exactly(0.0, v, times, forces, e)
        # 450 elastic hops of a third of a micrometer end 3e-8 m off.
        assert replay.positions[-1, 0] == pytest.approx(exact.position, abs=10 * EXACT)


def test_an_end_at_the_wall_counts_its_bounce() -> None:
    replay = replay_event_driven(shipped_world(), make_scenario(2.0, -2.0), *hold(0.0))
    assert replay.bounce_times == pytest.approx([1.0], abs=1e-14)
    assert replay.positions[-1, 0] == pytest.approx(0.0, abs=1e-12)
    assert replay.velocities[-2:, 0].tolist() == pytest.approx([2.0, 2.0])


@pytest.mark.parametrize("steps", [1, 2, 3, 7, 200])
@pytest.mark.parametrize("e", RESTITUTIONS)
def test_a_graze_changes_nothing(e: float, steps: int) -> None:
    # q(t) = (t − 1)²/2 touches the wall at t = 1 with no speed.
    scenario = make_scenario(0.5, -1.0, restitution=e)
    replay = replay_event_driven(shipped_world(), scenario, *hold(1.0, 2.0, steps))
    assert replay.positions[-1, 0] == pytest.approx(0.5, abs=1e-6)
    assert replay.max_penetration <= ROUNDING


@pytest.mark.parametrize("depth", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("steps", [1, 3, 200])
def test_a_dip_within_one_interval_is_seen(depth: float, steps: int) -> None:
    # Free flight would go this deep, and be out again before the interval ends.
    q, v, times = 0.5 - depth, -1.0, np.linspace(0.0, 2.0, steps + 1)
    exact = run_exactly(q, v, times.tolist(), [1.0] * steps, 0.5)
    scenario = make_scenario(q, v, restitution=0.5)
    replay = replay_event_driven(shipped_world(), scenario, times, np.ones((steps, 1)))
    assert len(replay.bounce_times) == len(exact.impact_times) == 1
    assert replay.positions[-1, 0] == pytest.approx(exact.position, abs=EXACT)


@pytest.mark.parametrize("e", [1.0, 0.999, 0.9, 0.5, 0.0])
def test_a_ball_that_trembles_under_a_push_does_not_hang(e: float) -> None:
    scenario = make_scenario(1e-7, 0.0, restitution=e)
    replay = replay_event_driven(shipped_world(), scenario, *hold(-1.0, steps=20))
    assert len(replay.bounce_times) <= math.sqrt(2 / 1e-6)
    assert 0 <= replay.positions[-1, 0] <= 1e-7
    assert replay.max_penetration <= ROUNDING


@pytest.mark.parametrize("steps", [1, 10, 200])
def test_a_mass_on_a_spring_swings_as_the_closed_form_says(steps: int) -> None:
    # ω = 10 rad/s about the wall itself: it comes back after half a period, and again: |cos|.
    world = World.from_diagram(make_diagram(spring=150.0))
    replay = replay_event_driven(world, make_scenario(0.4, 0.0), *hold(0.0, steps=steps))
    t = replay.times
    np.testing.assert_allclose(replay.positions[:, 0], 0.4 * np.abs(np.cos(10 * t)), atol=EXACT)
    expected = (np.arange(3) + 0.5) * np.pi / 10
    assert replay.bounce_times == pytest.approx(expected.tolist(), abs=EXACT)
    assert replay.energy_ratio == pytest.approx(1.0, abs=1e-12)


def test_a_dip_that_only_the_spring_makes_is_seen() -> None:
    # ω = 10 rad/s about 0.3 m: 10 µm too wide a swing touches the wall for some 2 ms, which nothing
    # at the start of the only interval foretells.
    world = World.from_diagram(make_diagram(spring=150.0, reference=0.3))
    scenario = make_scenario(0.60001, 0.0, restitution=0.5)
    replay = replay_event_driven(world, scenario, *hold(0.0, duration=0.5, steps=1))
    (bounce,) = replay.bounce_times
    assert bounce == pytest.approx(math.acos(-0.3 / 0.30001) / 10, abs=EXACT)
    speed, phase = 10 * math.sqrt(0.30001**2 - 0.3**2), 10 * (0.5 - bounce)
    end = 0.3 - 0.3 * math.cos(phase) + 0.5 * speed / 10 * math.sin(phase)
    assert replay.positions[-1, 0] == pytest.approx(end, abs=EXACT)


def test_an_impact_moves_all_that_hangs_together_and_rest_slides() -> None:
    world = World.from_diagram(make_diagram(num_joints=2))
    M, J = world.constant_inertia.mass_matrix, world.calc_contact_jacobian(np.zeros(2))[0]
    start, v = np.array([0.2, 0.1]), np.array([0.3, -1.5])
    times = np.linspace(0.0, 1.0, 101)
    scenario = make_scenario(start, v, restitution=0.6)
    replay = replay_event_driven(world, scenario, times, np.zeros((100, 2)))
    after = v - 1.6 * (J @ v) / (J @ np.linalg.solve(M, J)) * np.linalg.solve(M, J)
    (bounce,) = replay.bounce_times
    assert bounce == pytest.approx(-(J @ start) / (J @ v), abs=1e-12)
    end = start + bounce * v + (1 - bounce) * after
    np.testing.assert_allclose(replay.velocities[-1], after, atol=1e-12)
    np.testing.assert_allclose(replay.positions[-1], end, atol=1e-11)
    assert replay.energy_ratios[0] == pytest.approx((after @ M @ after) / (v @ M @ v))
    # Pressed to the wall it slides: along J v = 0, where only the tangential force does work.
    scenario, forces = make_scenario(start, v, restitution=0.0), np.array([1.0, -8.0])
    replay = replay_event_driven(world, scenario, times, np.tile(forces, (100, 1)))
    tangent = np.array([J[1], -J[0]])
    resting = replay.times > replay.times[-1] - 0.3
    np.testing.assert_allclose(replay.positions[resting] @ J, 0.0, atol=1e-11)
    speeds = replay.velocities[resting] @ tangent / (tangent @ tangent)
    slope = tangent @ forces / (tangent @ M @ tangent)
    np.testing.assert_allclose(np.diff(speeds) / np.diff(replay.times[resting]), slope, rtol=1e-9)
