"""Contact that lasts on rigid walls with friction, in plans: modes, forces and their edges."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from rubbing_worlds import RADIUS, make_discs
from shooting_problems import check_held, evaluate_hold, weigh
from shooting_problems import pose as pose_shooting

from drake_aigto import PlanOptions, Scenario, World, plan
from drake_aigto.arrays import Floats
from drake_aigto.contact import Closed, Mechanism, Mode, RigidLaw, make_mechanics_memory
from drake_aigto.planning import (
    COASTING,
    Origin,
    RigidMechanismTask,
    drop,
    in_order,
    is_closed,
    lay_out,
    lead_over_edges,
    list_mode_changes,
    make_mechanism_task,
)
from drake_aigto.shooting import Phases, ShootingOptions, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import replay_event_driven
from drake_aigto.transcription import Touch

MU, G = 0.3, 9.81
FEET = ((-0.3, 0.0), (0.3, 0.0))
BLOCK = Scenario.named("sliding_block/to_rest")


@cache
def build(tilts: bool = False, turns: bool = True, has_feet: bool = False) -> World:
    """Returns a ball on the ground, or on a board on a hinge, where M, J and T depend on q."""
    feet = FEET if has_feet else ((0.0, 0.0),)
    return World.from_diagram(make_discs(tilts=tilts, turns=turns, feet=feet))


def mechanize(world: World) -> Mechanism:
    m = world.num_contacts
    return Mechanism.of(world, RigidLaw(np.zeros(m), np.full(m, MU)))


def press(
    mechanism: Mechanism, modes: list[int], x: Floats, u: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Returns f_n and f_t of all contacts in modes, v̇, and the derivatives of λ and v̇."""
    m, signs = len(modes), np.array(modes)
    closed = np.concatenate([np.ones(m, dtype=np.bool_), signs == 0])
    memory = make_mechanics_memory(mechanism.mechanics)
    evaluate_hold(closed, -MU * signs, x, u, mechanism.mechanics, memory)
    normal, stuck = np.split(memory.grip[-1], 2)
    tangent = np.where(signs == 0, stuck, -MU * signs * normal)
    forces = np.concatenate([normal, tangent])
    return forces, memory.acceleration[0], memory.by_force.T, memory.slopes.T


@pytest.mark.slow
@pytest.mark.parametrize("modes", [[0], [1], [-1], [1, 1], [0, -1]])
def test_what_sticks_or_slips_moves_as_coulomb_says_and_its_derivatives_are_those_of_differences(
    modes: list[int],
) -> None:
    world, rng = build(tilts=True, has_feet=len(modes) == 2), np.random.default_rng(5)
    mechanism, n = mechanize(world), world.num_positions
    x, u = rng.uniform(0.2, 0.9, 2 * n), rng.normal(size=world.num_actuators)
    kinds, held = tuple(map(Mode, modes)), np.arange(len(modes))
    closed = Closed(world, held, kinds, np.full(len(modes), MU))
    check_held(lambda x, u: press(mechanism, modes, x, u), closed, x, u, (1e-8, 1e-4, 1e-5))


def pose(world: World, state: list[float], phases: Phases, N: int) -> ShootingProblem:
    n, nu = world.num_positions, world.num_actuators
    cost, none = weigh(np.zeros(n), np.ones(nu)), np.zeros((2, nu))
    return pose_shooting(
        mechanize(world), cost, state, N, phases.total[1], control_bounds=none, phases=phases
    )


def hold(modes: list[int], T: float) -> Phases:
    """Returns one contact that is held in modes, one after the other."""
    P = len(modes)
    return Phases(
        contacts=np.full(P - 1, -1),
        knots=np.arange(1, P),
        durations=np.full(P, T / P),
        total=(T, T),
        held=np.ones((P, 1), dtype=np.bool_),
        modes=np.array(modes)[:, np.newaxis],
    )


@pytest.mark.parametrize("push", [0.0, MU * G - 0.5, MU * G + 1.0])
def test_of_all_modes_only_coulombs_meets_its_bounds(push: float) -> None:
    """A block sticks until the push is μ m g, and then slips at F/m − μ g."""
    world, meets = build(turns=False), []
    for mode in (-1, 0, 1):
        problem = pose(world, [0.0, RADIUS, 0.0, 0.0], hold([mode], 1.0), 4)
        driven = np.full((2, 1), push)
        problem = dataclasses.replace(problem, control_bounds=driven)
        found = problem.simulate(np.full((4, 1), push), 1)
        if found.violation < 1e-9:
            meets.append(mode)
            gain = max(0.0, push - MU * G)
            np.testing.assert_allclose(found.states[-1], [gain / 2, RADIUS, gain, 0.0], atol=1e-12)
    assert meets == [int(push > MU * G)]


@pytest.mark.parametrize("spin", [0.0, -80.0, 50.0])
def test_a_ball_in_phases_of_slip_and_stick_rolls_once_two_sevenths_of_its_slip_are_lost(
    spin: float,
) -> None:
    slip = 1.5 - RADIUS * spin
    phases = hold([int(np.sign(slip)), 0], 3.0)
    problem = pose(build(), [0.0, RADIUS, 0.0, 1.5, 0.0, spin], phases, 2)
    options = ShootingOptions((Smoothing(0.0, 40, 1e-12),), multiplier_updates=20)
    found = problem.solve(np.zeros((2, 1)), options=dataclasses.replace(options, feasibility=1e-10))
    rolling = 1.5 - 2 / 7 * slip
    assert found.violation < 1e-9
    assert found.phases.durations[0] == pytest.approx(abs(slip) / (3.5 * MU * G), abs=1e-8)
    assert found.states[-1][3:] == pytest.approx([rolling, 0.0, rolling / RADIUS], abs=1e-8)


def test_a_block_that_lands_and_slides_to_rest_is_the_one_of_a_simulation() -> None:
    world, N = build(turns=False), 12
    state = [0.0, 2 * RADIUS, 1.0, 0.0]
    touches = (Touch(0.15, 0.4, 0, 1), Touch(0.4, 1.0, 0, 0))
    times, phases = lay_out(touches, N, 1.0, (1.0, 1.0), 1)
    np.testing.assert_array_equal(phases.contacts, [0, -1])
    np.testing.assert_array_equal(phases.modes[:, 0], [0, 1, 0])
    problem = dataclasses.replace(pose(world, state, phases, N), times=times)
    options = ShootingOptions((Smoothing(0.0, 40, 1e-12),), multiplier_updates=20)
    found = problem.solve(np.zeros((N, 1)), options=dataclasses.replace(options, feasibility=1e-10))
    scenario = dataclasses.replace(
        BLOCK, initial_position=state[:2], initial_velocity=state[2:], duration=1.0, time_step=0.1
    )
    replay = replay_event_driven(world, scenario, found.times, found.controls)
    slips, sticks = replay.contact_phases
    ends = [touch.end for touch in found.touches]
    assert [slips.end, sticks.end] == pytest.approx(ends, abs=1e-8)
    end = np.hstack(replay.states_at(found.times[-1:]))[0]
    np.testing.assert_allclose(end, found.states[-1], atol=1e-9)


def test_touches_are_held_from_the_start_and_go_on_in_other_modes_without_an_impact() -> None:
    touches = (Touch(0.0, 0.3, 1, 1), Touch(0.2, 0.6, 0), Touch(0.3, 0.8, 1, 0), Touch(0.9, 1.0, 1))
    times, phases = lay_out(touches, 20, 1.0, (1.0, 1.0), 2)
    np.testing.assert_array_equal(phases.contacts, [0, -1, -1, -1, 1])
    np.testing.assert_allclose(times[phases.knots], [0.2, 0.3, 0.6, 0.8, 0.9])
    np.testing.assert_array_equal(phases.held[:, 1], [True, True, True, True, False, True])
    np.testing.assert_array_equal(phases.held[:, 0], [False, True, True, False, False, False])
    np.testing.assert_array_equal(phases.modes[:4, 1], [1, 1, 0, 0])


def test_what_goes_on_in_another_mode_as_something_else_is_hit_does_so_at_that_impact() -> None:
    stays, slips, hits = Touch(0.0, 0.5, 1, 0), Touch(0.5, 1.0, 1, 1), Touch(0.5, 0.8, 0)
    for touches in ((stays, hits, slips), (stays, slips, hits)):
        _, phases = lay_out(touches, 20, 1.0, (1.0, 1.0), 2)
        np.testing.assert_array_equal(phases.contacts, [0, -1])
        np.testing.assert_array_equal(phases.modes[:, 1], [0, 1, 1])
        np.testing.assert_array_equal(phases.held, [[False, True], [True, True], [False, True]])


def test_a_touch_that_is_dropped_leaves_its_time_to_the_one_that_it_went_on_from() -> None:
    touches = (Touch(0.0, 0.3, 0, 1), Touch(0.3, 0.8, 0, 0), Touch(0.8, 1.0, 0, 1))
    assert drop(touches, 0) == (Touch(0.0, 0.8, 0, 0), touches[2])
    assert drop(touches, 1) == (Touch(0.0, 1.0, 0, 1),)
    apart = (Touch(0.0, 0.2, 0, 1), Touch(0.3, 0.8, 0, 0))
    assert drop(apart, 0) == apart[1:]
    assert in_order(apart[::-1]) == apart
    law = RigidLaw(np.zeros(1), np.full(1, MU))
    changes = list(list_mode_changes(law, (Touch(0.0, 1.0, 0, 1),)))
    assert (Touch(0.0, 0.5, 0, 1), Touch(0.5, 1.0, 0, 0)) in changes
    assert len(set(changes)) == 6
    assert not list(list_mode_changes(RigidLaw(np.zeros(1)), (Touch(0.0, 1.0, 0),)))


def test_what_leaves_or_is_apart_is_not_closed() -> None:
    world = build(turns=False)
    for state, closed in (([0.0, 0.0], True), ([0.0, 0.1], False), ([1e-3, 0.0], False)):
        q, v = np.array([0.0, RADIUS + state[0]]), np.array([1.0, state[1]])
        assert is_closed(world, q, v).tolist() == [closed]


def test_what_sticks_with_all_friction_is_led_to_slip_and_what_hardly_slips_to_stick() -> None:
    world, N = build(turns=False), 8
    law = RigidLaw(np.zeros(1), np.full(1, MU))

    def drive(speed: float, mode: int, controls: list[float]) -> ShootingResult:
        phases = hold([mode], 1.0)
        problem = pose(world, [0.0, RADIUS, speed, 0.0], phases, N)
        driven = dataclasses.replace(problem, control_bounds=np.array([[-9.0], [9.0]]))
        return driven.simulate(np.array(controls)[:, None], 1)

    edge = MU * G
    pulled = drive(0.0, 0, [0.0] * 4 + [edge] * 4)
    assert lead_over_edges(world, law, pulled) == (Touch(0.0, 0.5, 0, 0), Touch(0.5, 1.0, 0, 1))
    # It is braked from 1 m/s to 0.01 m/s, and kept there.
    slow = drive(1.0, 1, [edge - 0.99 / 0.5] * 4 + [edge] * 4)
    assert lead_over_edges(world, law, slow) == (Touch(0.0, 0.5, 0, 1), Touch(0.5, 1.0, 0, 0))
    for mode, control in ((0, 0.9 * edge), (1, 2 * edge)):
        inside = drive(float(mode), mode, [control] * N)
        assert lead_over_edges(world, law, inside) is None


# The cheapest push to rest: J = 4/3 (μ m g)² τ with τ² = 6 d/(μ g), F = 2 μ m g (1 − t/τ).
UNTIL = np.sqrt(6 / (MU * G))
LEAST = 4 / 3 * (MU * G) ** 2 * UNTIL


@pytest.mark.slow
def test_the_cheapest_push_to_rest_lets_the_floor_brake() -> None:
    problem = make_mechanism_task(World.from_scenario(BLOCK), BLOCK, PlanOptions())
    assert isinstance(problem, RigidMechanismTask)
    assert [(touch.start, touch.mode) for touch in problem.coasting] == [(0.0, 0)]
    near = problem.bounce((Touch(0.0, 1.0, 0, -1), Touch(1.0, 2.0, 0, 0)), problem.idle_motion)
    found = problem.polish(near)
    # What a search leaves unfinished, and keeps nonetheless, is polished like any other motion.
    left = problem.polish(dataclasses.replace(near, is_left=True))
    assert not left.is_left and left.cost == found.cost
    candidate = problem.judge(Origin(COASTING), near, found)
    assert found.cost == pytest.approx(LEAST, rel=5e-4)
    assert candidate.replay.cost == pytest.approx(found.cost, rel=1e-9)
    assert candidate.is_confirmed
    assert max(candidate.defects.values()) < 1e-9
    slips, sticks = candidate.replay.contact_phases
    assert (slips.mode, sticks.mode) == ("backward", "stick")
    assert slips.end == pytest.approx(UNTIL, rel=1e-3)
    assert found.touches[0].end == pytest.approx(slips.end, abs=1e-8)
    (contact,) = candidate.contacts
    assert (contact.time, contact.last_time) == pytest.approx((0.0, 2.0))


@pytest.mark.slow
def test_a_ball_that_is_pushed_and_rolls_is_as_dear_as_seven_fifths_of_its_mass() -> None:
    """J = 12 (7/5 m d)²/T³ from rest to rest, while 2/7 F stays below μ m g."""
    world = build()
    scenario = dataclasses.replace(
        BLOCK,
        initial_position=[0.0, RADIUS, 0.0],
        initial_velocity=[0.0] * 3,
        goal_position=[1.0, RADIUS, 1 / RADIUS],
        goal_velocity=[0.0] * 3,
    )
    problem = make_mechanism_task(world, scenario, PlanOptions())
    assert isinstance(problem, RigidMechanismTask)
    assert [(touch.start, touch.mode) for touch in problem.coasting] == [(0.0, 0)]
    near = problem.bounce(problem.coasting, problem.idle_motion)
    found = problem.polish(near)
    assert found.cost == pytest.approx(12 * 1.4**2 / 2**3, rel=5e-4)
    candidate = problem.judge(Origin(COASTING), near, found)
    assert candidate.is_confirmed
    assert [phase.mode for phase in candidate.replay.contact_phases] == ["stick"]


@pytest.mark.slow
def test_a_plan_finds_the_cheapest_push_and_both_replays_agree() -> None:
    options = PlanOptions(starts=3, renewals=0)
    found = plan(BLOCK, options)
    drake = found.replay.drake
    assert found.holds
    assert found.cost == pytest.approx(LEAST, rel=2e-4)
    assert drake is not None
    assert drake.cost == pytest.approx(found.cost, rel=1e-6)
    assert drake.goal_error < 1e-4
