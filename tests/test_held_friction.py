"""Contact that lasts on rigid walls with friction, in plans: modes, forces and their edges."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from rubbing_worlds import RADIUS, make_discs
from shooting_problems import check_held, evaluate_hold, pose, weigh

from drake_aigto import Plan, PlanOptions, Scenario, World, plan, replay_drake
from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Closed,
    Mechanism,
    Mobility,
    Mode,
    RigidLaw,
    calc_impulse,
    make_mechanics_memory,
)
from drake_aigto.errors import FrictionError, ProgramError
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
from drake_aigto.show import motions_of_plan, plot_friction
from drake_aigto.simulation import Replay, replay_event_driven
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


def pose_held(world: World, state: list[float], phases: Phases, N: int) -> ShootingProblem:
    n, nu = world.num_positions, world.num_actuators
    cost, none = weigh(np.zeros(n), np.ones(nu)), np.zeros((2, nu))
    return pose(
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
        problem = pose_held(world, [0.0, RADIUS, 0.0, 0.0], hold([mode], 1.0), 4)
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
    problem = pose_held(build(), [0.0, RADIUS, 0.0, 1.5, 0.0, spin], phases, 2)
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
    problem = dataclasses.replace(pose_held(world, state, phases, N), times=times)
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
        problem = pose_held(world, [0.0, RADIUS, speed, 0.0], phases, N)
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


G, MU = 9.81, 0.3


@cache
def build_discs(**options: Any) -> World:
    return World.from_diagram(make_discs(**options))


def ask(world: World, q: list[float], v: list[float], **fields: Any) -> Scenario:
    task = {"goal_position": q, "goal_weight": np.ones(len(q)), **fields}
    return Scenario(initial_position=q, initial_velocity=v, **task)


def replay(
    world: World, q: list[float], v: list[float], pushes: list[float] | None = None, **fields: Any
) -> Replay:
    controls = np.array(pushes or [0.0])[:, np.newaxis]
    times = np.arange(len(controls) + 1.0)
    return replay_event_driven(world, ask(world, q, v, **fields), times, controls)


def test_a_block_decelerates_at_mu_g_and_stays_where_it_stops() -> None:
    found = replay(build_discs(turns=False), [0.0, RADIUS], [2.0, 0.0])
    assert found.positions[-1] == pytest.approx([4 / (2 * MU * G), RADIUS], abs=1e-9)
    assert found.velocities[-1] == pytest.approx([0.0, 0.0], abs=1e-9)


def test_a_push_below_mu_m_g_moves_nothing_and_one_above_only_by_what_is_more() -> None:
    pushes = [MU * G - 0.01, MU * G + 1.0]
    for world, rest in (
        (build_discs(turns=False), []),
        (build_discs(feet=((-0.3, 0.0), (0.3, 0.0))), [0.0]),
    ):
        found = replay(world, [0.0, RADIUS, *rest], [0.0] * (2 + len(rest)), pushes)
        first, last = (found.positions[found.times == time][-1] for time in (1.0, 2.0))
        assert first == pytest.approx([0.0, RADIUS, *rest], abs=1e-9)
        assert last == pytest.approx([0.5, RADIUS, *rest], abs=1e-9)


@pytest.mark.parametrize("spin", [0.0, -20.0, -80.0, 50.0])
def test_a_ball_rolls_once_two_sevenths_of_its_slip_are_lost(spin: float) -> None:
    """With enough backspin it comes back: v = 5/7 v₀ + 2/7 r ω₀, after |s₀| / (3.5 μ g)."""
    found = replay(build_discs(), [0.0, RADIUS, 0.0], [1.5, 0.0, spin], [0.0] * 3)
    slip = 1.5 - RADIUS * spin
    rolling, until = 1.5 - 2 / 7 * slip, abs(slip) / (3.5 * MU * G)
    way = (1.5 + rolling) / 2 * until + (3.0 - until) * rolling
    assert found.velocities[-1] == pytest.approx([rolling, 0.0, rolling / RADIUS], abs=1e-9)
    assert found.positions[-1][0] == pytest.approx(way, abs=1e-9)
    assert (rolling < 0) == (spin == -80.0)
    slides, rolls = found.contact_phases
    assert (slides.mode, rolls.mode) == ("forward" if slip > 0 else "backward", "stick")
    assert (slides.end, rolls.end) == pytest.approx((until, 3.0), abs=1e-9)


@pytest.mark.parametrize("push", [5.0, 15.0])
def test_a_ball_that_is_pushed_rolls_or_slips(push: float) -> None:
    """It rolls at 5/7 F/m as long as 2/7 F ≤ μ m g, and else slips at F/m − μ g."""
    found = replay(build_discs(), [0.0, RADIUS, 0.0], [0.0] * 3, [push])
    rolls = 2 / 7 * push <= MU * G
    acceleration = 5 / 7 * push if rolls else push - MU * G
    turning = acceleration / RADIUS if rolls else MU * G / (0.4 * RADIUS)
    assert found.velocities[-1] == pytest.approx([acceleration, 0.0, turning], abs=1e-9)


@pytest.mark.parametrize("e", [0.6, 1.0])
def test_a_spinning_ball_bounces_as_impulses_say_and_as_drake_does(e: float) -> None:
    world = build_discs()
    task = ask(world, [0.0, 0.4, 0.0], [1.0, 0.0, -20.0], restitution=e)
    times, controls = np.array([0.0, 0.4]), np.zeros((1, 1))
    found = replay_event_driven(world, task, times, controls)
    fall = np.sqrt(2 * G * 0.3)
    lost = min(2 / 7 * 3.0, MU * (1 + e) * fall)
    after = 1.0 - lost, e * fall, -20.0 + lost / (0.4 * RADIUS)
    row = np.flatnonzero(np.diff(found.times) == 0)[0] + 1
    assert found.velocities[row] == pytest.approx(after, abs=1e-9)
    assert len(found.bounce_times) == 1
    drake = replay_drake(world, task, times, controls)
    off = np.linalg.norm(found.positions[-1] - drake.positions[-1])
    assert 0 < off <= drake.compliance_error < 0.05


def test_a_ball_that_slides_and_then_rolls_is_in_drake_where_it_should_be() -> None:
    """But for what it creeps at the stiction speed as it should roll."""
    world = build_discs()
    task = ask(world, [0.0, RADIUS, 0.0], [2.0, 0.0, -60.0], restitution=0.0)
    times, controls = np.array([0.0, 0.5]), np.zeros((1, 1))
    found = replay_event_driven(world, task, times, controls)
    drake = replay_drake(world, task, times, controls)
    off = np.linalg.norm(found.positions[-1] - drake.positions[-1])
    assert off <= drake.compliance_error + 1e-3
    assert drake.compliance_error <= 0.5 * world.stiction_speed * 5 / 7 / RADIUS * 1.1


def test_energy_never_grows_whatever_falls_and_rubs() -> None:
    world = build_discs(radii=(0.1, 0.15))
    rng = np.random.default_rng(4)
    for _ in range(4):
        q = np.array([0.0, 0.4, 0.0, 0.28, 0.3, 0.0])
        v = np.concatenate([rng.uniform(-3.0, 3.0, 6) * [1, 1, 20, 1, 1, 20]])
        friction = float(rng.uniform(0.1, 1.0))
        found = replay(world, q.tolist(), v.tolist(), friction=friction, restitution=0.8)
        energy = calc_energy(world, found)
        assert np.all(np.diff(energy) <= 1e-9 * energy[0])
        assert found.max_penetration <= 1e-10


def calc_energy(world: World, found: Replay) -> Floats:
    kinetic = world.calc_kinetic_energy(found.positions, found.velocities)
    return kinetic + G * found.positions[:, 1::3].sum(axis=1)


@pytest.mark.slow
def test_a_rod_that_jams_is_refused_by_name() -> None:
    """Painlevé's: a long rod pushed along ground that is rougher than 4/3, tip ahead."""
    world = build_discs(feet=((0.5, -1.0),))
    start = [0.0, 1.0 + RADIUS, 0.0]
    with pytest.raises(FrictionError, match=r"Painlevé\): got (none|several) of the ways"):
        replay(world, start, [-2.0, 0.0, 0.0], friction=3.0)


RESTITUTION, FRICTION = 0.6, 0.5
# When what is about to hit does, in problems that last so long [s].
SOON, BRIEFLY = 1e-6, 1e-3


@cache
def tilted() -> World:
    return World.from_diagram(make_discs(tilts=True))


def hit(state: Floats, mode: int) -> ShootingProblem:
    world = tilted()
    n, nu, m = world.num_positions, world.num_actuators, world.num_contacts
    phases = Phases(
        np.zeros(1, dtype=np.int64),
        np.array([1]),
        np.array([SOON, BRIEFLY - SOON]),
        (BRIEFLY, BRIEFLY),
        modes=np.array([[0] * m, [mode] * m]),
    )
    mechanism = Mechanism.of(world, RigidLaw(np.full(m, RESTITUTION), np.full(m, FRICTION)))
    times = np.array([0.0, SOON, BRIEFLY])
    return pose(mechanism, weigh(np.zeros(n), np.ones(nu)), state, times=times, phases=phases)


def draw(seed: int) -> tuple[Floats, Mobility, float, float]:
    world, rng = tilted(), np.random.default_rng(seed)
    q, v = rng.normal(size=world.num_positions), rng.normal(size=world.num_positions)
    q[3] = 0.2 * q[3]
    for _ in range(10):
        J = world.calc_contact_jacobian(q)
        q -= np.linalg.pinv(J) @ world.calc_signed_distance(q)
    J, T = world.calc_contact_jacobian(q)[0], world.rubbing.calc_tangent_jacobian(q)[0]
    v *= -np.sign(J @ v)
    mobility = Mobility.of(J, T, world.calc_mass_matrix(q))
    return np.concatenate([q, v]), mobility, float(J @ v), float(T @ v)


def is_newtons(mobility: Mobility, rate: float, slip: float) -> bool:
    """Returns whether Routh's impact returns e of the speed, and slip that it has does not turn."""
    p = calc_impulse(mobility, rate, slip, RESTITUTION, FRICTION)
    returned = rate + mobility.a * p.normal + mobility.b * p.tangent
    turns = abs(p.mode) == 1 and p.mode * slip < 0
    return not turns and returned == pytest.approx(-RESTITUTION * rate, rel=1e-9)


def test_impacts_of_phases_are_rouths_in_the_mode_that_they_end_in_and_in_no_other() -> None:
    world, seen = tilted(), set()
    n = world.num_positions
    for seed in range(40):
        state, mobility, rate, slip = draw(seed)
        if not is_newtons(mobility, rate, slip):
            continue
        p = calc_impulse(mobility, rate, slip, RESTITUTION, FRICTION)
        J = world.calc_contact_jacobian(state[:n])[0]
        T = world.rubbing.calc_tangent_jacobian(state[:n])[0]
        M = world.calc_mass_matrix(state[:n])
        after = state[n:] + np.linalg.solve(M, J * p.normal + T * p.tangent)
        none = np.zeros((2, world.num_actuators))
        motions = {mode: hit(state, mode).simulate(none, 1) for mode in (-1, 0, 1)}
        np.testing.assert_allclose(motions[int(p.mode)].states[1, n:], after, atol=1e-3)
        # Elsewhere Coulomb's cone is left, or slip turns round.
        assert min(motions, key=lambda mode: motions[mode].violation) == p.mode
        assert motions[int(p.mode)].violation < 1e-3
        seen.add(int(p.mode))
    assert seen == {-1, 0, 1}


def test_modes_that_are_no_signs_are_refused() -> None:
    one = np.ones(1, dtype=np.int64)
    with pytest.raises(ProgramError, match=r"(?s)phases: modes: got .* expected −1, 0 or 1"):
        Phases(0 * one, one, np.ones(2), (1.0, 1.0), modes=np.full((2, 1), 2))


BRIEF = PlanOptions(starts=3, renewals=0)


@cache
def shot(friction: float | None = None) -> Plan:
    scenario = dataclasses.replace(Scenario.named("billiard/spin_shot"), friction=friction)
    return plan(scenario, BRIEF)


@pytest.mark.slow
def test_a_shot_with_spin_costs_less_than_any_without_friction_and_holds_in_both_replays() -> None:
    rough, smooth = shot(), shot(0.0)
    drake = rough.replay.drake
    assert drake is not None
    assert rough.holds
    assert drake.cost == pytest.approx(rough.cost, rel=1e-2)
    assert rough.replay.event_driven.cost == pytest.approx(rough.cost, rel=1e-6)
    assert rough.cost < 0.9 * smooth.cost
    assert max(rough.best.defects.values()) < 1e-9
    assert rough.best.energy_ratio == pytest.approx(rough.replay.event_driven.energy_ratio)


@cache
def problem() -> RigidMechanismTask:
    scenario = Scenario.named("billiard/spin_shot")
    found = make_mechanism_task(World.from_scenario(scenario), scenario, BRIEF)
    assert isinstance(found, RigidMechanismTask)
    return found


@pytest.mark.slow
def test_a_figure_has_the_impulse_of_an_impact_that_sticks_at_the_edge_of_its_cone() -> None:
    rough = shot()
    world, motion = rough.find_world(), motions_of_plan(rough)[0]
    plot_friction(axes := Figure().subplots(), motion, world, rough.scenario)
    (bar,) = axes.patches
    (mark,) = (line for line in axes.lines if line.get_marker() == "o")
    assert isinstance(bar, Rectangle)
    most = 0.3 * np.max(rough.trajectory.impulses)
    assert bar.get_height() == pytest.approx(2 * most, rel=1e-6)
    assert 2 * abs(np.asarray(mark.get_ydata())[0]) == pytest.approx(bar.get_height(), rel=1e-3)


def test_an_impact_at_the_edge_of_its_mode_is_led_to_the_best_from_every_mode() -> None:
    of = problem()
    costs = []
    for mode in (-1, 0, 1):
        touches: tuple[Touch, ...] = tuple(
            dataclasses.replace(touch, mode=mode) for touch in of.coasting[:1]
        )
        costs.append(of.bounce(touches, of.idle_motion).cost)
    np.testing.assert_allclose(costs, min(costs), rtol=1e-3)
