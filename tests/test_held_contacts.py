"""Contact that lasts: what holds it, its derivatives, and carts that push each other."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import build
from shooting_problems import check_held, evaluate_hold
from shooting_problems import pose as pose_shooting

from drake_aigto import Scenario, World
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
from drake_aigto.planning import add_impulses, replay_at_knots, trace
from drake_aigto.shooting import Phases, ShootingOptions, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import confirms, replay_drake, replay_event_driven, set_stiffness
from drake_aigto.world import STIFFNESS, Scales, TaskCost, read_material


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


def pose(
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
    problem = pose(world, CARTS, start, 5.0, N, phases)
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
def test_drake_confirms_carts_that_push_each_other_and_refuses_what_they_do_not() -> None:
    result, world = push_apart(), carts()
    replay = replay_drake(world, CARTS, result.times, result.controls)
    rigid = replay_event_driven(world, CARTS, result.times, result.controls)
    assert replay.cost == pytest.approx(rigid.cost, rel=1e-3)
    scales = Scales.of(world, CARTS)
    assert confirms(result.cost, replay, scales, rigid.goal_error)
    assert not confirms(0.9 * result.cost, replay, scales)
    weaker = replay_drake(world, CARTS, result.times, 0.9 * result.controls)
    assert not confirms(result.cost, weaker, scales, rigid.goal_error)


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


@pytest.mark.slow
def test_what_is_held_stays_at_the_wall_and_pushes() -> None:
    result, world = push_apart(), carts()
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


def test_what_slides_along_a_wall_without_a_push_keeps_its_energy() -> None:
    world = build("cart-pole")
    n, q, v = 2, np.array([0.0, 0.4]), np.array([0.3, -0.5])
    J = world.calc_contact_jacobian(q)[0]
    q[0] = -world.calc_signed_distance(q)[0] / J[0]
    kick = np.linalg.solve(world.calc_mass_matrix(q), J)
    v -= kick * (J @ v) / (J @ kick)
    problem = pose(
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
