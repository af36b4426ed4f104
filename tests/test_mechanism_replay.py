"""Mechanisms and exactly rigid walls, judged by closed forms, Drake's matrices and parabolas."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from marks import slow
from mechanisms import MECHANISMS, build, build_world
from pydrake.multibody.tree import JacobianWrtVariable
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from replay_worlds import hold, make_diagram, make_scenario, shipped, shipped_world
from scipy.integrate import solve_ivp
from scipy.special import ellipk, ellipkinc

from drake_aigto import Scenario, World
from drake_aigto.contact import Closed, Mode, RigidLaw, Walls, support
from drake_aigto.errors import ModelError, TrajectoryError
from drake_aigto.planning import find_rates, integrate_rates
from drake_aigto.simulation import (
    HeldControl,
    Parabolas,
    Recording,
    Replay,
    RigidMotion,
    replay_drake,
    replay_event_driven,
)


@cache
def read(name: str) -> World:
    return build_world(MECHANISMS[name]) if name in MECHANISMS else build(name)


# The pendulum of `mechanisms`: its tip touches where 0.8 sin θ = 0.55.
INERTIA, MOMENT = 0.03 + 1.3 * 0.7**2, 1.3 * 9.81 * 0.7  # [kg m²], [N m]
WALL = math.asin(0.55 / 0.8)  # [rad]


def replay(name: str, start: Any, times: Any, controls: Any, e: float = 1.0) -> Replay:
    q, v = np.reshape(start, (2, -1))
    scenario = Scenario(initial_position=q, initial_velocity=v, goal_position=0 * q, restitution=e)
    return replay_event_driven(read(name), scenario, times, controls)


def swing(start: Any, duration: float, e: float = 1.0, torque: float = 0.0, steps: int = 1) -> Any:
    times = np.linspace(0.0, duration, steps + 1)
    return replay("pendulum", start, times, np.full((steps, 1), torque), e)


def calc_energy(run: Replay) -> Any:
    q, v = run.positions[:, 0], run.velocities[:, 0]
    return INERTIA * v**2 / 2 - MOMENT * np.cos(q)


def test_a_free_pendulum_keeps_its_energy_over_dozens_of_bounces() -> None:
    # It leans on the wall from above, and hops.
    run = swing((math.pi - WALL + 0.05, 0.0), 7.0)
    assert len(run.bounce_times) >= 30
    np.testing.assert_allclose(calc_energy(run), calc_energy(run)[0], rtol=1e-8)
    assert run.max_penetration <= 1e-12


@pytest.mark.parametrize("e", [0.3, *slow(1.0)])
def test_bounce_times_and_speeds_are_those_of_elliptic_integrals(e: float) -> None:
    start = -2.0
    run = swing((start, 0.0), 8.0, e)
    time, speed_squared = 0.0, 2 * MOMENT / INERTIA * (math.cos(WALL) - math.cos(start))
    omega, expected, first = math.sqrt(MOMENT / INERTIA), list[float](), True
    while True:
        top = math.acos(math.cos(WALL) - speed_squared * INERTIA / (2 * MOMENT))
        k = math.sin(top / 2)
        half = (ellipk(k**2) + ellipkinc(math.asin(min(1.0, math.sin(WALL / 2) / k)), k**2)) / omega
        time += half if first else 2 * half
        first = False
        if time > 8.0:
            break
        expected.append(time)
        speed_squared *= e**2
    assert len(expected) >= 4
    np.testing.assert_allclose(run.bounce_times, expected, atol=1e-9)
    np.testing.assert_allclose(run.energy_ratios, e**2, rtol=1e-12)
    energies = INERTIA / 2 * 2 * MOMENT / INERTIA * (math.cos(WALL) - math.cos(start))
    powers = e ** (2 * np.arange(len(expected)))
    np.testing.assert_allclose(run.energies_before, energies * powers, rtol=1e-8)


@pytest.mark.parametrize("depth", [1e-3, 1e-9])
@pytest.mark.parametrize("steps", [1, 7])
def test_a_dip_within_one_step_is_seen(depth: float, steps: int) -> None:
    # Free flight would turn round this far behind the wall.
    run = swing((-WALL - depth, 0.0), 1.5, 0.5, steps=steps)
    assert len(run.bounce_times) == 1
    expected = MOMENT * (math.cos(WALL) - math.cos(WALL + depth))
    assert run.energies_before[0] == pytest.approx(expected, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("e", [0.0, *slow(1.0)])
def test_a_graze_changes_nothing(e: float) -> None:
    run = swing((-WALL, 0.0), 4.0, e)
    calm = swing((-WALL + 1e-9, 0.0), 4.0, e)
    np.testing.assert_allclose(run.positions[-1], calm.positions[-1], atol=1e-6)
    assert run.max_penetration <= 1e-12


@pytest.mark.parametrize("shift", [0.0, 1e-15, -1e-15, 1e-9, -1e-9])
def test_a_bounce_on_a_knot_happens_once(shift: float) -> None:
    e = 0.5
    whole = swing((-1.0, 2.0), 1.0, e)
    (bounce,) = whole.bounce_times
    times = [0.0, bounce + shift, 1.0]
    run = replay("pendulum", (-1.0, 2.0), times, np.zeros((2, 1)), e)
    assert run.bounce_times == pytest.approx((bounce,), abs=1e-12)
    np.testing.assert_allclose(run.positions[-1], whole.positions[-1], atol=1e-10)


@pytest.mark.parametrize("v", [-3.0, 0.0, 1e-6, 3.0])
@pytest.mark.parametrize("torque", [-30.0, 0.0, 30.0])
@pytest.mark.parametrize("e", [0.6, 0.0])
def test_a_start_at_the_wall(v: float, torque: float, e: float) -> None:
    run = swing((WALL, v), 0.3, e, torque)
    assert run.max_penetration <= 1e-12
    if torque > 0 and v >= -1e-6:  # Pressed on, it hardly leaves.
        assert np.max(np.abs(run.positions - WALL)) <= 1e-5
    if torque <= 0:  # Gravity pulls off, too.
        away = replay("pendulum", (WALL, -e * v if v > 0 else v), [0, 0.3], [[torque]], e)
        np.testing.assert_allclose(run.positions[-1], away.positions[-1], atol=1e-9)
        assert len(run.bounce_times) == (v > 1e-3)


def test_it_rests_while_pressed_and_leaves_when_the_push_falls_below_gravity() -> None:
    holding = MOMENT * math.sin(WALL)
    times, torques = np.linspace(0.0, 2.0, 5), np.array([[20.0], [20.0], [holding + 0.1], [0.0]])
    run = replay("pendulum", (WALL - 0.1, 0.0), times, torques, 0.3)
    resting = (run.times >= 1.0) & (run.times <= 1.5)
    np.testing.assert_allclose(run.positions[resting], WALL, atol=1e-12)
    np.testing.assert_allclose(run.velocities[resting], 0.0, atol=1e-12)
    free = swing((WALL, 0.0), 0.5)
    np.testing.assert_allclose(run.positions[-1], free.positions[-1], atol=1e-9)


def test_an_impact_changes_momentum_as_drakes_matrices_say() -> None:
    world = read("cart-pole")
    times, e = np.linspace(0.0, 1.0, 21), 0.7
    controls = 15 * np.sin(np.arange(20.0))[:, np.newaxis]
    run = replay("cart-pole", [[0.1, 0.5], [2.0, 3.0]], times, controls, e)
    assert len(run.bounce_times) >= 2
    rows = np.flatnonzero(np.diff(run.times) == 0)
    plant = world.plant
    context = plant.GetMyMutableContextFromRoot(world.create_context())
    frames = plant.GetBodyByName("pole").body_frame(), plant.world_frame()
    for row, contact in zip(rows, run.bounce_contacts, strict=True):
        q, before, after = run.positions[row], run.velocities[row], run.velocities[row + 1]
        plant.SetPositions(context, q)
        M = plant.CalcMassMatrix(context)
        J = plant.CalcJacobianTranslationalVelocity(
            context, JacobianWrtVariable.kV, frames[0], [0, 0, -0.8], frames[1], frames[1]
        )[0] * (1.0 if contact == 0 else -1.0)
        impulse = M @ (after - before)
        tangent = np.array([J[1], -J[0]])
        assert tangent @ impulse == pytest.approx(0.0, abs=1e-11)  # It acts along Jᵀ alone,
        assert J @ impulse > 0  # pushes,
        assert J @ after == pytest.approx(-e * (J @ before), abs=1e-11)  # and returns e.
        lost = (before @ M @ before - after @ M @ after) / 2
        effective = 1 / (J @ np.linalg.solve(M, J))
        assert lost == pytest.approx((1 - e**2) / 2 * effective * (J @ before) ** 2, rel=1e-9)


def test_it_slides_along_a_wall_as_the_mechanism_with_its_tip_on_a_line() -> None:
    # Pushed to the right with its tip on the right wall, the cart drives the pole up the wall.
    world, force, angle = read("cart-pole"), 6.0, 0.4
    length, place = 0.8, 0.55
    run = replay(
        "cart-pole",
        [[place - length * math.sin(angle), angle], [0, 0]],
        [0, 0.2, 0.4],
        [[force], [force]],
        0.0,
    )

    def rates(_: float, y: Any) -> Any:
        # θ alone: a = place − l sin θ, virtual work along (−l cos θ, 1).
        theta, w = y
        q = np.array([place - length * math.sin(theta), theta])
        way = np.array([-length * math.cos(theta), 1.0])
        v = way * w
        turn = np.array([length * math.sin(theta) * w**2, 0.0])
        M = world.calc_mass_matrix(q)
        pull = np.array([force, 0.0]) - world.calc_bias(q, v) - M @ turn
        return [w, way @ pull / (way @ M @ way)]

    oracle = solve_ivp(rates, (0, 0.4), [angle, 0.0], rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(run.positions[-1, 1], oracle.y[0, -1], atol=1e-8)
    np.testing.assert_allclose(run.positions @ [1, 0] + length * np.sin(run.positions[:, 1]), place)
    assert run.bounce_times == ()


def test_a_contact_lets_go_on_its_way_when_its_force_would_pull() -> None:
    start = [[0.55 - 0.8 * math.sin(0.4), 0.4], [0, 0]]
    whole = replay("cart-pole", start, [0, 1.8], [[2.0]], 0.0)
    fine = replay("cart-pole", start, np.linspace(0, 1.8, 37), np.full((36, 1), 2.0), 0.0)
    tip = fine.positions[:, 0] + 0.8 * np.sin(fine.positions[:, 1]) - 0.55
    held = (fine.times > 1.0) & (fine.times < 1.3)
    assert np.all(np.abs(tip[held]) <= 1e-12)
    assert tip[-1] < -0.1
    np.testing.assert_allclose(whole.positions[-1], fine.positions[-1], atol=1e-8)


@pytest.mark.parametrize(
    "name", ["cart-pole", *slow("two discs", "acrobot_and_wall", "arm with a slider")]
)
def test_an_interval_cut_in_parts_is_the_same(name: str) -> None:
    world, rng = read(name), np.random.default_rng(3)
    bounced = 0
    for _ in range(4):
        q = rng.uniform(-0.5, 0.5, world.num_positions)
        while np.min(world.calc_clearance(q)) < 0.01:
            q = rng.uniform(-1.0, 1.0, world.num_positions)
        nearest = np.argmax(world.calc_signed_distance(q))
        J = world.calc_contact_jacobian(q)[nearest]
        start = q, rng.uniform(-1, 1, len(q)) - 3 * J / (J @ J)
        times, controls = np.linspace(0, 0.9, 4), rng.uniform(-3, 3, (3, world.num_actuators))
        whole = replay(name, start, times, controls, 0.8)
        fine = np.linspace(0, 0.9, 22)
        cut = replay(name, start, fine, np.repeat(controls, 7, axis=0), 0.8)
        assert whole.bounce_contacts == cut.bounce_contacts
        bounced += len(whole.bounce_contacts)
        np.testing.assert_allclose(whole.bounce_times, cut.bounce_times, atol=1e-8)
        np.testing.assert_allclose(whole.positions[-1], cut.positions[-1], atol=1e-7)
        assert whole.max_penetration <= 1e-12
    assert bounced


def test_motions_that_run_away_or_go_ever_faster_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(TrajectoryError, match="runs away"):
        swing((0.0, 0.0), 1.0, torque=1e300)
    swing((0.0, 0.0), 1.0, torque=-1e3)
    monkeypatch.setattr("drake_aigto.simulation.smooth._MOST_PIECES_IN_ALL", 100)
    monkeypatch.setattr("drake_aigto.simulation.smooth._MOST_EACH", 0)
    swing((0.0, 0.0), 1.0, torque=1.0)
    with pytest.raises(TrajectoryError, match=r"goes ever faster, at 0\.\d+ s"):
        swing((0.0, 0.0), 1.0, torque=-1e3)


@pytest.mark.parametrize(
    "name", ["pendulum", "cart-pole", "double pendulum", "paddle", "two discs"]
)
def test_contacts_accelerate_by_j_and_its_change(name: str) -> None:
    world, rng = read(name), np.random.default_rng(5)
    for _ in range(3):
        q, v, u = (rng.uniform(-1, 1, n) for n in (*2 * [world.num_positions], world.num_actuators))
        step = 1e-6
        ahead, behind = (world.calc_contact_jacobian(q + s * step * v) @ v for s in (1, -1))
        bias = world.calc_contact_bias(q, v)
        np.testing.assert_allclose(bias, (ahead - behind) / (2 * step), atol=1e-7)
        closed = Closed(world, np.array([0]), (Mode.FORWARD,), np.zeros(1))
        push = closed.calc_push(np.concatenate([q, v]), u)
        a, forces = push.acceleration, push.normal
        J = world.calc_contact_jacobian(q)
        assert J[0] @ a + bias[0] == pytest.approx(0.0, abs=1e-9)
        pushed = world.calc_acceleration(q, v, u) + np.linalg.solve(
            world.calc_mass_matrix(q), J[0] * forces[0]
        )
        np.testing.assert_allclose(a, pushed, atol=1e-9)


def test_a_trace_in_steps_that_are_too_long_runs_away_without_an_error() -> None:
    world, law = build("pendulum"), RigidLaw(np.ones(1))
    x = np.array([[np.arcsin(-(0.6 - 0.05) / 0.8), 0.0]])  # The tip rests at the wall.
    x[0, 0] = world.move_onto(x[0, :1], [0])[0]
    rates = find_rates(world, law, x, np.array([[-1e150]]), np.full((1, 1), Mode.OPEN))
    end, _ = integrate_rates(rates, x, np.array([1e150]), 1)
    assert not np.all(np.isfinite(end))


def test_what_has_left_a_wall_is_not_held_in_the_air() -> None:
    """Within an interval, a push may lead off a wall and back to it: no force acts meanwhile."""
    world, law, h = build("pendulum"), RigidLaw(np.ones(1)), 0.01
    q = np.array([-np.pi / 6])
    assert world.calc_signed_distance(q)[0] == pytest.approx(0.0, abs=1e-12)
    J = world.calc_contact_jacobian(q)[0]
    u = np.array([-10.0 * np.sign(J)])  # Into the wall.
    rests, away = np.concatenate([q, [0.0]]), np.concatenate([q + 0.1 * np.sign(J), [0.0]])
    rates = find_rates(world, law, rests[np.newaxis], u, np.full((1, 1), Mode.OPEN))
    held, pushed = integrate_rates(rates, rests[np.newaxis], np.array([h]), 4)
    np.testing.assert_allclose(held[0], rests, atol=1e-9)
    assert pushed[0, 0] > 0
    flown, pushed = integrate_rates(rates, away[np.newaxis], np.array([h]), 4)
    acceleration = world.calc_acceleration(away[:1], away[1:], u[0])
    np.testing.assert_allclose(flown[0, 1], h * acceleration[0], rtol=1e-2)
    assert pushed[0, 0] == 0


Array = npt.NDArray[np.float64]

WORLDS = ["point mass", "floor", "corridor", "room", "room_with_block", "two_masses"]
RESTITUTIONS = [1.0, 0.8, 0.5, 0.0]


def world_of(name: str) -> World:
    return shipped_world() if name == "point mass" else shipped(name)


def draw_task(name: str, seed: int) -> tuple[tuple[Array, Array], Array, Array]:
    rng, world = np.random.default_rng(seed), world_of(name)
    q = np.sort(rng.uniform(0.05, 0.95, world.num_positions))
    while np.any(world.calc_clearance(q) < 0.01):
        q = np.sort(rng.uniform(0.05, 0.95, world.num_positions))
    v = rng.uniform(-4, 4, world.num_velocities)
    gaps = rng.uniform(0.01, 0.2, rng.integers(1, 12))
    controls = rng.uniform(-20, 20, (len(gaps), world.num_actuators))
    return (q, v), np.concatenate([[0.0], np.cumsum(gaps)]), controls


def roll_out(
    name: str, e: float, start: tuple[Array, Array], times: Array, controls: Array
) -> Recording:
    world = world_of(name)
    restitutions = np.full(world.num_contacts, e)
    return Parabolas(world.constant_dynamics, restitutions, start, times).record(controls)


def follows_chatter(recording: Recording) -> bool:
    """Whether rounding decides how many impacts there are: many follow, or they are slow."""
    slow = any(impact.speed < 1e-3 for impact in recording.impacts)
    return slow or len(recording.impacts) > 12


@pytest.mark.parametrize("name", WORLDS)
@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from(RESTITUTIONS))
def test_integrated_motion_is_the_same(name: str, seed: int, e: float) -> None:
    start, times, controls = draw_task(name, seed)
    direct = roll_out(name, e, start, times, controls)
    assume(not follows_chatter(direct))
    world = world_of(name)
    held = HeldControl(times, controls)
    span = held.start, held.end
    law = RigidLaw(np.full(world.num_contacts, e))
    oracle = RigidMotion(world, law, start, span).run(held)
    assert [i.contact for i in direct.impacts] == [i.contact for i in oracle.impacts]
    np.testing.assert_allclose(direct.times, oracle.times, rtol=0, atol=1e-9)
    np.testing.assert_allclose(direct.positions, oracle.positions, rtol=0, atol=1e-9)
    np.testing.assert_allclose(direct.velocities[-1], oracle.velocities[-1], rtol=0, atol=1e-8)
    for ours, theirs in zip(direct.impacts, oracle.impacts, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8)
    assert direct.max_penetration <= 1e-12


def test_the_road_is_chosen_by_what_the_world_does(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("simulated")

    monkeypatch.setattr(RigidMotion, "run", refuse)
    heavy = World.from_diagram(make_diagram(gravity=3.0))
    springy = World.from_diagram(make_diagram(spring=3.0))
    assert all(world_of(name).has_constant_dynamics for name in WORLDS)
    assert heavy.has_constant_dynamics and not springy.has_constant_dynamics
    assert replay_event_driven(heavy, make_scenario(), *hold(0.0)).bounce_times
    with pytest.raises(AssertionError, match="simulated"):
        replay_event_driven(springy, make_scenario(), *hold(0.0))


@pytest.mark.parametrize("name", WORLDS)
@given(st.integers(0, 2**32 - 1), st.sampled_from(RESTITUTIONS), st.integers(2, 9))
def test_an_interval_cut_in_parts_is_the_same_between_walls(
    name: str, seed: int, e: float, parts: int
) -> None:
    # Of the block too: a parabola that passes one side far off and comes back onto another.
    start, times, controls = draw_task(name, seed)
    whole = roll_out(name, e, start, times, controls)
    assume(not follows_chatter(whole))
    steps = np.repeat(np.diff(times) / parts, parts)
    fine = np.concatenate([[0.0], np.cumsum(steps)])
    cut = roll_out(name, e, start, fine, np.repeat(controls, parts, axis=0))
    assert [i.contact for i in whole.impacts] == [i.contact for i in cut.impacts]
    np.testing.assert_allclose(cut.positions[-1], whole.positions[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(cut.velocities[-1], whole.velocities[-1], rtol=0, atol=1e-8)


def test_a_parabola_over_a_block_comes_down_on_it() -> None:
    # In front of its left side until it is above; x passes that side once, y its top twice.
    world, e = shipped("room_with_block"), np.full(8, 1.0)
    start = np.array([0.3, 0.55]), np.array([0.5, 1.5])
    walls = Parabolas(world.constant_dynamics, e, start, np.array([0.0, 0.5]))
    recording = walls.record(np.array([[0.0, -6.0]]))
    (impact,) = recording.impacts
    assert world.contacts[impact.contact].name.endswith("+y face")
    fall = 0.55 + 1.5 * impact.time - 3 * impact.time**2
    assert fall == pytest.approx(0.6, abs=1e-14) and impact.speed > 0


@pytest.mark.parametrize("name", ["two_masses", "room_with_block"])
def test_ends_of_many_are_those_of_each(name: str) -> None:
    start, times, _ = draw_task(name, 3)
    world, rng = world_of(name), np.random.default_rng(1)
    controls = rng.normal(0, 9, (6, len(times) - 1, world.num_actuators))
    walls = Parabolas(world.constant_dynamics, np.full(world.num_contacts, 0.7), start, times)
    each = [walls.record(control).positions[-1].tolist() for control in controls]
    assert walls.find_ends(controls).tolist() == each
    assert walls.find_ends(controls[:0]).shape == (0, world.num_positions)
    kick = np.array([0.5, -0.25])
    kicked = Parabolas(
        *(world.constant_dynamics, np.full(world.num_contacts, 0.7)),
        *((start[0], start[1] + kick), times),
    )
    ends = walls.find_ends(controls, kicks=np.tile(kick, (len(controls), 1)))
    assert ends.tolist() == kicked.find_ends(controls).tolist()


@settings(max_examples=66)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 4))
def test_support_is_the_nearest_point_of_a_cone(seed: int, m: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    J, root, free = rng.normal(size=(m, n)), rng.normal(size=(n, n)), rng.normal(size=n)
    M = root @ root.T + 0.1 * np.eye(n)
    kicks = np.linalg.solve(M, J.T).T
    lifts = np.divide(kicks, np.sum(J * kicks, axis=1)[:, np.newaxis], order="C")
    walls, held = Walls(J, np.zeros(m), lifts, np.arange(m + 1)), rng.random(m) < 0.8
    x = np.empty(n)
    support(walls, held, free, x)
    assert np.all(J[held] @ x >= -1e-9 * np.linalg.norm(free))
    # Moreau's theorem: x is nearest if and only if the way there is square to it, …
    way = M @ (x - free)
    rounding = 1e-9 * float(np.linalg.norm(M) * (free @ free))
    assert way @ x == pytest.approx(0, abs=rounding)
    # … and no direction of the cone goes against it.
    for _ in range(20):
        direction = np.empty(n)
        support(walls, held, rng.normal(size=n), direction)
        assert way @ direction >= -rounding


@pytest.mark.parametrize(("distance", "e"), [(0.013, 0.7), (-0.2, 1.0)])
def test_moving_the_wall_is_moving_start_and_goal_the_other_way(distance: float, e: float) -> None:
    scenario = make_scenario(restitution=e)
    shifted = dataclasses.replace(
        scenario,
        initial_position=scenario.initial_position - distance,
        goal_position=scenario.goal_position - distance,
    )
    world = shipped_world()
    moved = world.with_wall_moved(0, distance)
    for replay in (replay_event_driven, replay_drake):
        there, here = replay(moved, scenario, *hold(0.4)), replay(world, shifted, *hold(0.4))
        # Drake's steps differ in their last bits, within its accuracy.
        close = 1e-12 if replay is replay_event_driven else 1e-7
        assert len(there.bounce_times) == 1
        assert there.bounce_times == pytest.approx(here.bounce_times, abs=close)
        assert there.cost == pytest.approx(here.cost, abs=close)
        assert there.positions[-1] - distance == pytest.approx(here.positions[-1], abs=close)


@pytest.mark.parametrize("name", ["room_with_block/around", "corridor/lossy"])
def test_a_moved_shape_is_where_drakes_geometry_sees_it(name: str) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    q, distance = scenario.initial_position, 0.03
    J = world.calc_contact_jacobian(q)
    for i, shapes in enumerate(world.shapes):
        moved = world.with_wall_moved(i, distance)
        beside = [j for j, pair in enumerate(moved.shapes) if pair == shapes]
        expected = world.calc_signed_distance(q)
        expected[beside] -= distance * J[beside] @ J[i]  # The normals are of unit length here.
        after = moved.calc_signed_distance(q)
        np.testing.assert_allclose(after, expected, rtol=0, atol=1e-12)
        root = moved.create_context()
        context = moved.plant.GetMyMutableContextFromRoot(root)
        moved.plant.SetPositions(context, q)
        query = moved.plant.get_geometry_query_input_port().Eval(context)
        seen = query.ComputeSignedDistancePairClosestPoints(*shapes).distance
        assert seen == pytest.approx(max(after[beside]), abs=1e-12)


@pytest.mark.parametrize("name", ["corridor/lossy", "two_masses/apart"])
def test_a_world_that_is_only_planned_for_has_the_numbers_of_one_that_is_moved(name: str) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    distances = np.zeros(world.num_contacts)
    distances[0] = 0.03
    moved, nearer = world.with_wall_moved(0, 0.03), world.with_walls_nearer(distances)
    for read in (moved, nearer):
        read.check(scenario)
    q, inertia = scenario.initial_position, world.constant_inertia
    np.testing.assert_allclose(
        nearer.calc_signed_distance(q), moved.calc_signed_distance(q), rtol=0, atol=1e-15
    )
    for field in dataclasses.fields(inertia):
        mine, true = (getattr(each.constant_inertia, field.name) for each in (nearer, moved))
        np.testing.assert_allclose(mine, true, rtol=0, atol=1e-15)
    assert world.constant_inertia.offset[0] == pytest.approx(
        nearer.constant_inertia.offset[0] + 0.03
    )


def test_the_world_itself_stays() -> None:
    world = shipped_world(2.0)
    before = world.calc_signed_distance(np.ones(1))
    moved = world.with_wall_moved(0, 0.1)
    assert moved.mass == world.sphere_mass == moved.sphere_mass == 2.0
    assert world.calc_signed_distance(np.ones(1)) == before
    back = moved.with_wall_moved(0, -0.1)
    assert back.calc_signed_distance(np.ones(1)) == pytest.approx(before, abs=1e-15)


def test_the_mass_of_the_model_is_read() -> None:
    assert shipped_world().sphere_mass == 1.0
    assert World.from_diagram(make_diagram(density=3.0)).sphere_mass == pytest.approx(4.5)


def test_walls_of_what_moves_or_can_not_be_copied_are_not_moved() -> None:
    world = World.from_scenario(Scenario.named("two_masses/apart"))
    between = next(i for i, c in enumerate(world.contacts) if "wall" not in c.name)
    with pytest.raises(ModelError, match="which moves, expected one that stands still"):
        world.with_wall_moved(between, 0.1)
    builder = DiagramBuilder()
    builder.AddSystem(make_diagram())
    builder.AddSystem(_Uncopied())
    world = World.from_diagram(builder.Build())
    with pytest.raises(ModelError, match=r"(?s)can't be copied.*systems that Drake can clone"):
        world.with_wall_moved(0, 0.1)


class _Uncopied(LeafSystem):
    """A system written in Python, as users write them: Drake can't copy it."""
