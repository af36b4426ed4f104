"""Shooting in phases: impacts, free durations, and what calculus says of a ball."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import WORLD_AT, after, box, build, build_world, joint, link, plane, sphere, wall
from scipy.optimize import minimize, minimize_scalar
from shooting_problems import check_held, evaluate_hold, weigh
from shooting_problems import pose as pose_shooting

from drake_aigto import Plan, Planner, Scenario, World
from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact import (
    Closed,
    Mechanism,
    Mode,
    RigidLaw,
    contact_law,
    make_mechanics_memory,
)
from drake_aigto.errors import ProgramError
from drake_aigto.planning import PlanOptions, add_impulses, keep_off, replay_at_knots, trace
from drake_aigto.shooting import Phases, ShootingOptions, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.show import format_plan
from drake_aigto.simulation import confirms, replay_drake, replay_event_driven, set_stiffness
from drake_aigto.world import STIFFNESS, Scales, SpaceWorld, TaskCost, read_material

RESTITUTION, TOTAL = 0.6, 2.0

BALL = (
    link("ball", 1.0, ">0 0 0 0 0 0", "0 0 0", sphere("ball", "0 0 0", 0.1))
    + joint("prismatic", "world", "ball", "1 0 0")
    + wall(plane("left", "-0.1 0 0 0 1.5707963267948966 0"))
)


@cache
def ball() -> World:
    return build_world(BALL)


def pose(world: World, start: Any, goal: Any, phases: Phases, N: int) -> ShootingProblem:
    """Returns the problem of least effort from a place at rest to another, by way of a wall."""
    n, m = world.num_positions, world.num_contacts
    goals = np.concatenate([goal, np.full(n, np.nan)])
    mechanism = Mechanism.of(world, RigidLaw(np.full(m, RESTITUTION)))
    cost = weigh(goal, np.ones(world.num_actuators))
    start = np.concatenate([start, np.zeros(n)])
    return pose_shooting(mechanism, cost, start, N, TOTAL, hard_goal=goals, phases=phases)


def bounce(N: int, total: tuple[float, float] = (TOTAL, TOTAL)) -> ShootingResult:
    phases = Phases(np.zeros(1, dtype=np.int64), np.array([N // 2]), np.array([0.7, 1.3]), total)
    return pose(ball(), [1.0], [2.0], phases, N).solve(np.full((N, 1), -1.0))


def calc_effort(distance: float, before: float, after: float, time: float) -> float:
    """Returns the least ∫ u² of a unit mass from one speed to another over a distance."""
    speeds = before**2 + before * after + after**2
    return (4 * speeds - 12 * distance * (before + after) / time) / time + (
        12 * distance**2 / time**3
    )


def test_a_ball_hits_the_wall_when_and_as_calculus_says() -> None:
    def calc(x: Any) -> float:
        time, speed, end = x
        first = calc_effort(-1.0, 0.0, -speed, time)
        return first + calc_effort(2.0, RESTITUTION * speed, end, TOTAL - time)

    expected = minimize(calc, [0.7, 1.0, 1.0], method="Nelder-Mead", options={"xatol": 1e-9})
    result = bounce(40)
    assert result.violation < 1e-4
    # Held controls cost more, by the square of their steps: 1/20 of a phase.
    assert expected.fun * (1 - 1e-4) < result.cost < expected.fun * 1.005
    np.testing.assert_allclose(result.phases.durations[0], expected.x[0], atol=0.01)
    assert result.states[20, 1] == pytest.approx(RESTITUTION * expected.x[1], abs=0.02)
    assert result.times[-1] == pytest.approx(TOTAL, abs=1e-3)


def test_more_time_is_taken_where_it_may_be() -> None:
    fixed, longer = bounce(10), bounce(10, (1.0, 3.0))
    assert longer.violation < 1e-4
    assert longer.times[-1] == pytest.approx(3.0, abs=1e-3)
    assert longer.cost < 0.5 * fixed.cost


@pytest.mark.parametrize("push", [1.0, -1.0])
def test_a_wall_is_hit_from_outside_only(push: float) -> None:
    phases = Phases(np.zeros(1, dtype=np.int64), np.array([1]), np.ones(2), (TOTAL, TOTAL))
    start, after = -push / 2, -RESTITUTION * push  # It is at the wall after a second.
    problem = pose(ball(), [start], [after], phases, 2)
    motion = problem.simulate(np.array([[push], [0.0]]), 1)
    np.testing.assert_allclose(motion.states[1:], [[0.0, after], [after, after]], atol=1e-12)
    # Coming out, φ̇ is off by its unit L/T times two, and the end is inside by 0.6 L.
    assert motion.violation == pytest.approx(2.0 if push > 0 else 0.0, abs=1e-12)


def test_walls_are_hit_no_slower_than_asked() -> None:
    phases = Phases(np.zeros(1, dtype=np.int64), np.array([5]), np.array([0.7, 1.3]), (2.0, 2.0))
    problem = pose(ball(), [1.0], [2.0], phases, 10)
    fast = replace(problem, slowest=3.0).solve(np.full((10, 1), -1.0))
    assert fast.violation < 1e-4
    assert fast.states[5, 1] == pytest.approx(3.0 * RESTITUTION, rel=1e-3)
    with pytest.raises(ProgramError, match="slowest: got -1"):
        replace(problem, slowest=-1.0)


def test_a_pendulum_meets_its_wall_at_a_knot_and_stays_in_front_of_it() -> None:
    world = build("cart-pole")
    phases = Phases(
        np.zeros(1, dtype=np.int64), np.array([8]), np.array([1.0, 1.0]), (TOTAL, TOTAL)
    )
    problem = pose(world, [0.0, 0.0], [0.2, 0.0], phases, 16)
    result = problem.solve(np.zeros((16, 1)), options=ShootingOptions(multiplier_updates=20))
    phi = world.calc_signed_distance(result.states[:, :2])
    assert result.violation < 1e-4
    assert phi[8, 0] == pytest.approx(0, abs=1e-4)
    assert np.all(phi > -1e-4)
    assert result.phases.durations.sum() == pytest.approx(TOTAL, abs=1e-3)
    again = problem.starting_from(result).simulate(result.controls, 1)
    np.testing.assert_array_equal(again.states, result.states)

    exact = problem.restore(result)
    assert exact.violation < 1e-11 < result.violation  # For what that takes, and hardly more.
    size = np.linalg.norm(result.controls)
    assert np.linalg.norm(exact.controls - result.controls) < 100 * result.violation * size
    assert exact.cost == pytest.approx(result.cost, rel=100 * result.violation)


def test_what_dips_into_a_wall_just_before_it_bounces_is_lifted_off_it() -> None:
    hit, never = np.zeros(1, dtype=np.int64), np.zeros((2, 1), dtype=np.bool_)
    phases = Phases(hit, np.array([2]), np.ones(2), (TOTAL, TOTAL), never)
    problem = pose(ball(), [1.0], [1.0], phases, 4)
    motion = problem.simulate(np.array([[-8.0], [16.0], [0.0], [0.0]]), 1)  # At the wall twice.
    kept = keep_off(ball(), problem, motion, 0.01)
    assert kept is not None
    assert kept.clearances is not None
    np.testing.assert_allclose(kept.clearances[:3, 0], [0.0, 0.51, 0.0], atol=1e-12)


def test_a_face_of_a_box_is_touched_where_it_is_and_not_beyond_its_edge() -> None:
    # From beside the box to farther off: the nearest point of the top is its edge.
    world = build_world(
        link("rail", 0.5, ">0 0 0 0 0 0")
        + joint("prismatic", "world", "rail", "1 0 0")
        + link("ball", 0.5, after("rail", "0 0 0 0 0 0"), "0 0 0", sphere("ball", "0 0 0", 0.1))
        + joint("prismatic", "rail", "ball", "0 0 1")
        + wall(box("block", "0 0 -0.6 0 0 0", "1 1 1"))
    )
    names = [contact.name for contact in world.contacts]
    top = next(i for i, name in enumerate(names) if name.endswith("+z face"))
    phases = Phases(np.array([top]), np.array([8]), np.array([1.0, 1.0]), (TOTAL, TOTAL))
    problem = pose(world, [0.9, 0.5], [1.4, 0.5], phases, 16)
    result = problem.solve(np.zeros((16, 2)), options=ShootingOptions(multiplier_updates=20))
    assert result.violation < 1e-4
    np.testing.assert_allclose(result.states[8, :2], [0.5, 0.0], atol=1e-3)


def test_phases_that_fit_no_knots_are_refused() -> None:
    with pytest.raises(ProgramError, match=r"phases: durations: got .* expected 2 numbers"):
        Phases(np.zeros(1, dtype=np.int64), np.array([3]), np.ones(3), (1.0, 1.0))
    far = Phases(np.zeros(1, dtype=np.int64), np.array([10]), np.ones(2), (1.0, 1.0))
    with pytest.raises(ProgramError, match=r"phases: .*knots inside of 0 … 10"):
        pose(ball(), [1.0], [2.0], far, 10)


DISTANCE, PACE, WEIGHT = 1.0, 0.8, 3.0
QUICK = PlanOptions(renewals=8, finalists=1)


@cache
def cart(in_space: bool) -> World:
    parts = link("cart", 1.0, WORLD_AT) + joint("prismatic", "world", "cart", "1 0 0")
    kind = SpaceWorld if in_space else World
    return kind.from_diagram(build_world(parts).diagram)


def ask(least: float, most: float, **changed: Any) -> Scenario:
    """Returns the task of a cart at rest that has to go a DISTANCE, and to get to its PACE."""
    fields: dict[str, Any] = {
        "initial_position": [0.0],
        "initial_velocity": [0.0],
        "goal_position": [DISTANCE],
        "goal_velocity": [PACE],
        "hard_goal": True,
        "control_weight": 1.0,
        "velocity_weight": WEIGHT,
        "duration": 1.0,
        "time_step": 0.02,
        "duration_range": (least, most),
        "contact": "compliant",
    }
    return Scenario(**{**fields, **changed})


@cache
def plan(least: float, most: float, in_space: bool = False) -> Plan:
    return Planner(ask(least, most), QUICK, cart(in_space)).plan()


def calc_cost(T: float) -> float:
    """Returns the least ∫ u² + W w² of a speed's error w, w(0) = −PACE, w(T) = 0, in a time.

    As Lagrange has it, w″ = W w + p, so w = A cosh kt + B sinh kt + C with k² = W, and ∫ w is
    what the DISTANCE is beyond PACE·T.
    """
    k, times = np.sqrt(WEIGHT), np.linspace(0.0, T, 4001)
    waves = np.array([np.cosh(k * times), np.sinh(k * times), np.ones_like(times)])
    sums = [np.sinh(k * T) / k, (np.cosh(k * T) - 1) / k, T]
    parts = np.linalg.solve(
        np.array([waves[:, 0], waves[:, -1], sums]), [-PACE, 0.0, DISTANCE - PACE * T]
    )
    w, u = parts @ waves, k * (parts[0] * waves[1] + parts[1] * waves[0])
    return float(np.trapezoid(u**2 + WEIGHT * w**2, times))


@pytest.mark.parametrize("in_space", [False, True])
def test_a_free_duration_is_that_which_calculus_says(in_space: bool) -> None:
    best = minimize_scalar(calc_cost, bounds=(0.5, 4.0), method="bounded")
    found = plan(0.5, 4.0, in_space)
    assert found.holds
    assert 1.1 < best.x < 3.5  # Neither where the search starts nor at an end.
    assert found.trajectory.times[-1] == pytest.approx(best.x, rel=0.01)
    # Held controls cost more, by the square of their steps.
    assert best.fun * (1 - 1e-4) < found.cost < best.fun * (1 + 2e-3)


def test_all_simulations_last_as_long_as_the_plan() -> None:
    found = plan(0.5, 4.0)
    T = found.trajectory.times[-1]
    assert len(found.trajectory.controls) == found.scenario.num_steps
    for replay in (*found.replay, *found.replayed().replay):
        assert replay.times[-1] == pytest.approx(T, rel=1e-9)
        assert replay.cost == pytest.approx(found.cost, rel=1e-4)
        assert replay.positions[-1, 0] == pytest.approx(DISTANCE, abs=1e-3)


@pytest.mark.parametrize(("least", "most", "end"), [(0.5, 1.1, "upper"), (1.0, 1.0, "lower")])
def test_a_duration_at_the_end_of_its_range_is_told(least: float, most: float, end: str) -> None:
    found = plan(least, most)
    assert found.trajectory.times[-1] == pytest.approx(most if end == "upper" else least, rel=1e-6)
    assert found.cost == pytest.approx(calc_cost(found.trajectory.times[-1]), rel=2e-3)
    assert f"its {end} bound" in format_plan(found)


@pytest.mark.slow
def test_a_swing_up_off_a_wall_takes_the_time_that_is_best() -> None:
    """With as much time as its scenario has by default, it costs more."""
    given = Scenario.named("cart_pole/soft_06")
    free = dataclasses.replace(given, duration=1.0, duration_range=(1.0, 2.0))
    planner = Planner(free, QUICK)
    found, at_first = (
        planner.plan(),
        Planner(dataclasses.replace(free, duration_range=None), QUICK, planner.world).plan(),
    )
    assert found.holds
    assert found.cost < at_first.cost
    assert found.replay.drake is not None
    assert found.replay.drake.cost == pytest.approx(found.cost, rel=1e-3)


@cache
def mechanize(world: World) -> Mechanism:
    return Mechanism.of(world, RigidLaw(np.zeros(world.num_contacts)))


def run(
    world: World, contacts: list[int], x: Floats, u: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Returns λ, v̇ and their derivatives by (q, v, u)."""
    mechanics = mechanize(world).mechanics
    memory, leans = make_mechanics_memory(mechanics), np.zeros(world.num_contacts)
    evaluate_hold(hold(world, contacts), leans, x, u, mechanics, memory)
    forces, by_force = memory.grip[-1, contacts], memory.by_force[:, contacts].T
    return forces, memory.acceleration[0], by_force, memory.slopes.T


def hold(world: World, contacts: list[int]) -> Bools:
    return np.isin(np.arange(world.num_contacts), contacts)


# At once, no more contacts than coordinates: else forces are not unique.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "contacts"),
    [
        ("cart-pole", [1]),
        ("two discs", [0]),
        ("double pendulum", [0]),
        ("double pendulum", [0, 2]),
        ("paddle", [0]),
        ("three_carts", [0, 1]),
    ],
)
def test_what_is_held_moves_as_gauss_says_and_its_derivatives_are_those_of_differences(
    name: str, contacts: list[int]
) -> None:
    world, rng = build(name), np.random.default_rng(3)
    n, k = world.num_positions, len(contacts)
    x, u = rng.uniform(0.2, 0.9, 2 * n), rng.normal(size=world.num_actuators)
    closed = Closed(world, np.array(contacts), (Mode.FORWARD,) * k, np.zeros(k))
    check_held(lambda x, u: run(world, contacts, x, u), closed, x, u, (1e-9, 1e-5, 1e-6))


N = 50
CARTS = Scenario.named("three_carts/apart")


@cache
def carts() -> World:
    return World.from_scenario(CARTS)


def pose_carts(
    world: World, scenario: Scenario, start: Any, T: float, N: int, phases: Phases
) -> ShootingProblem:
    bounds = world.bounds(scenario)
    return pose_shooting(
        mechanize(world),
        TaskCost.of(world, scenario),
        np.concatenate(start),
        N,
        T,
        scales=np.full(2 * world.num_positions, 3.0),
        state_bounds=np.hstack([bounds.position, bounds.velocity]),
        control_bounds=bounds.control,
        length=3.0,
        phases=phases,
    )


@cache
def push_apart() -> ShootingResult:
    """Returns a motion in which the middle cart pushes one cart, then the other."""
    world = carts()
    phases = Phases(
        contacts=np.array([0, -1, 1, -1]),
        knots=np.array([8, 18, 30, 42]),
        durations=np.array([0.5, 0.8, 1.2, 0.9, 1.6]),
        total=(5.0, 5.0),
        held=np.array([hold(world, each) for each in ([], [0], [], [1], [])]),
    )
    start = CARTS.initial_position, CARTS.initial_velocity
    problem = pose_carts(world, CARTS, start, 5.0, N, phases)
    controls = np.repeat([-8.0, -12.0, 12.0, 12.0, -10.0], [8, 10, 12, 12, 8])[:, np.newaxis]
    rungs = (Smoothing(1e-3, 300, 1e-6),)
    return problem.solve(controls, options=ShootingOptions(rungs, 2, multiplier_updates=20))


def test_carts_push_each_other_apart_and_a_simulation_agrees() -> None:
    result, world = push_apart(), carts()
    assert result.violation < 1e-4
    assert result.is_converged
    replay = replay_event_driven(world, CARTS, result.times, result.controls)
    assert replay.cost == pytest.approx(result.cost, rel=1e-3)
    assert replay.bounce_contacts == (0, 1)
    np.testing.assert_allclose(replay.bounce_times, result.times[[8, 30]], atol=1e-3)
    beyond = np.setdiff1d(np.arange(9, N + 1), 30)  # Off impacts.
    states = np.hstack(replay.states_at(result.times[beyond]))
    np.testing.assert_allclose(states, result.states[beyond], atol=0.01)


@pytest.mark.slow
def test_what_is_held_stays_at_the_wall_and_pushes_and_drake_confirms_it() -> None:
    result, world = push_apart(), carts()
    replay = replay_drake(world, CARTS, result.times, result.controls)
    rigid = replay_event_driven(world, CARTS, result.times, result.controls)
    assert replay.cost == pytest.approx(rigid.cost, rel=1e-3)
    scales = Scales.of(world, CARTS)
    assert confirms(result.cost, replay, scales, rigid.goal_error)
    assert not confirms(0.9 * result.cost, replay, scales)
    weaker = replay_drake(world, CARTS, result.times, 0.9 * result.controls)
    assert not confirms(result.cost, weaker, scales, rigid.goal_error)
    phi = world.calc_signed_distance(result.states[:, :3])
    rate = np.einsum(
        "kij,kj->ki", world.calc_contact_jacobian(result.states[:, :3]), result.states[:, 3:]
    )
    for contact, first, last in ((0, 8, 18), (1, 30, 42)):
        np.testing.assert_allclose(phi[first : last + 1, contact], 0.0, atol=1e-3)
        np.testing.assert_allclose(rate[first : last + 1, contact], 0.0, atol=1e-9)
        for k in range(first, last):
            forces, *_ = run(world, [contact], result.states[k].copy(), result.controls[k].copy())
            assert forces > -0.05


def test_what_lasts_yields_more_and_other_contacts_as_before() -> None:
    world, root = carts(), carts().create_context()

    def read(contact: int) -> float:
        k = [
            read_material(world.scene_graph, root, shape).GetProperty(*STIFFNESS)
            for shape in world.shapes[contact]
        ]
        return k[0] * k[1] / (k[0] + k[1])

    for factor in (0.01, 1.0):
        set_stiffness(world, root, 1, factor)
        assert read(1) == pytest.approx(factor * world.stiffness[1])
        assert read(0) == pytest.approx(world.stiffness[0])


def test_what_slides_along_a_wall_without_a_push_keeps_its_energy() -> None:
    world = build("cart-pole")
    n, q, v = 2, np.array([0.0, 0.4]), np.array([0.3, -0.5])
    J = world.calc_contact_jacobian(q)[0]
    q[0] = -world.calc_signed_distance(q)[0] / J[0]
    kick = np.linalg.solve(world.calc_mass_matrix(q), J)
    v -= kick * (J @ v) / (J @ kick)
    problem = pose_carts(
        world,
        Scenario.named("cart_pole/soft_06"),
        (q, v),
        0.5,
        20,
        dataclasses.replace(Phases.free(0.5, (0.5, 0.5)), held=hold(world, [0])[np.newaxis]),
    )
    states = problem.simulate(np.zeros((20, 1)), substeps=8).states
    assert np.abs(states[-1] - states[0]).max() > 0.1
    energies = []
    for x in states:
        context = world.plant.CreateDefaultContext()
        world.plant.SetPositionsAndVelocities(context, x)
        energies.append(
            world.plant.CalcPotentialEnergy(context) + world.plant.CalcKineticEnergy(context)
        )
    np.testing.assert_allclose(energies, energies[0], rtol=1e-7)
    np.testing.assert_allclose(world.calc_signed_distance(states[:, :n])[:, 0], 0.0, atol=1e-7)
    back = replace(problem, start=np.concatenate([q, -v]))
    coarse = back.simulate(np.zeros((20, 1)), substeps=1)
    assert world.calc_signed_distance(coarse.states[-1, :n])[0] < -1e-10
    assert coarse.violation == 0.0  # It drifts by the error of steps, which no control can change.


def test_phases_that_hold_what_is_not_there_are_refused() -> None:
    with pytest.raises(ProgramError, match=r"(?s)phases: held: got .* expected 1 rows"):
        none = np.zeros(0, dtype=np.int64)
        Phases(none, none, np.ones(1), (1.0, 1.0), np.zeros((2, 1), dtype=np.bool_))


def test_a_cart_that_runs_into_two_that_touch_moves_on_with_both() -> None:
    """Impulses of all turns are summed: what each contact passes on is momentum of what follows."""
    world = carts()
    start = dataclasses.replace(
        CARTS, initial_position=[-3.0, 0.0, 2.0], initial_velocity=[3.0, 0.0, 0.0], duration=1.0
    )
    times, controls, replay = replay_at_knots(
        world, start, np.linspace(0.0, 1.0, 21), np.zeros((20, 1))
    )
    flight, gaps = trace(world, RigidLaw(np.zeros(2)), replay, times, controls)
    trajectory, missed = add_impulses(world, start, replay, flight)
    assert max(missed, gaps.max()) < 1e-9
    (knot,) = np.flatnonzero(trajectory.impulses.any(axis=1))
    # It has rolled 1 m under 3 m/s and a damping of 2/s, which leaves 1 m/s.
    np.testing.assert_allclose(trajectory.impulses[knot], [2 / 3, 1 / 3], rtol=1e-4)
    np.testing.assert_allclose(replay.velocities[-1], replay.velocities[-1, 0])


def test_touches_too_slow_for_impacts_are_part_of_the_last_one_before() -> None:
    """The middle cart leans on the left one when both run into the right one."""
    world = carts()
    start = dataclasses.replace(
        CARTS, initial_position=[-2.5, -0.5, 2.0], initial_velocity=[3.0, 3.0, 0.0], duration=0.5
    )
    controls = np.full((10, 1), -10.0)
    times, controls, replay = replay_at_knots(world, start, np.linspace(0.0, 0.5, 11), controls)
    assert set(replay.bounce_contacts) == {0, 1}
    flight, gaps = trace(world, RigidLaw(np.zeros(2)), replay, times, controls)
    _, missed = add_impulses(world, start, replay, flight)
    assert max(missed, gaps.max()) < 1e-9


def test_a_pole_that_grazes_a_soft_wall_for_a_moment_obeys_the_law_to_what_plans_ask_for() -> None:
    """In one pass between knots, the check misses such touches by up to 2e-6 rad/s."""
    start = dataclasses.replace(
        Scenario.named("cart_pole/soft_06"),
        initial_position=[0.17748869, 0.55030908],
        initial_velocity=[-4.75023279, 7.7033905],
        duration=0.05,
    )
    world, times = World.from_scenario(start), np.array([0.0, 0.025, 0.05])
    for control in np.linspace(-20.0, 20.0, 3001)[1340:1348]:
        controls = np.full((2, 1), control)
        replay = replay_event_driven(world, start, times, controls)
        _, gaps = trace(world, contact_law(world, start), replay, times, controls)
        assert np.all(gaps < 3e-7)
