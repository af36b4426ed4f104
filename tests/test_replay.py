"""Replays on Drake's plant beside rigid ones: how near they are, and what they say of a plan."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
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

from drake_aigto.contact import calc_dissipation, contact_delay, contact_delays
from drake_aigto.errors import DamagedDataError, TrajectoryError
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.simulation import (
    Replay,
    confirms,
    find_contacts,
    max_penetration,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scales, Scenario, World

METRE = Scales(length=1.0, time=1.0, cost=1.0)


@pytest.mark.parametrize("row", [1, 3])
def test_drakes_elastic_wall_is_late_by_its_contact_and_else_agrees(row: int) -> None:
    scenario = Scenario.named(f"table1/{row}")
    world = World.from_scenario(scenario)
    control = hold(0.3)
    rigid = replay_event_driven(world, scenario, *control)
    drake = replay_drake(world, scenario, *control)
    (touch,) = drake.bounce_times
    assert touch == pytest.approx(rigid.bounce_times[0], abs=1e-9)
    speed = math.sqrt(2 * rigid.energies_before[0])
    late = drake.velocities[-1, 0] * contact_delay(world)
    assert rigid.positions[-1, 0] - drake.positions[-1, 0] == pytest.approx(late, rel=0.1)
    assert drake.max_penetration == pytest.approx(speed * math.sqrt(1 / 1e9), rel=1e-3)
    assert drake.energy_ratio == pytest.approx(1.0, abs=3e-5)
    assert drake.matched_speeds == () and drake.bounce_contacts == (0,)
    assert np.all(np.diff(drake.times) >= 0) and len(drake.times) == len(control[0]) + 3
    assert confirms(rigid.cost, drake, Scales.of(world, scenario), rigid.goal_error)


@pytest.mark.parametrize(("e", "speed"), [(1.0, 2.0), (0.9, 20.0), (0.2, 2.0), (0, 20)])
def test_what_a_compliant_wall_does_to_the_end_is_known_beforehand(e: float, speed: float) -> None:
    world, scenario = shipped_world(), make_scenario(1.0, -speed, restitution=e, goal_weight=3.0)
    rigid = replay_event_driven(world, scenario, *hold(0.0))
    drake = replay_drake(world, scenario, *hold(0.0))
    missed = abs(rigid.positions[-1, 0] - drake.positions[-1, 0])
    least = 0.5 if e == 0.2 else 0.65
    assert least * drake.compliance_error < missed < drake.compliance_error
    assert drake.energy_ratio == pytest.approx(e**2, abs=1e-3)
    assert drake.matched_speeds == pytest.approx([speed] if e < 1 else [], rel=1e-4)
    assert rigid.compliance_error == rigid.compliance_cost == 0
    paid = abs(rigid.cost - drake.cost)
    assert least * drake.compliance_cost < paid < drake.compliance_cost


def test_only_what_compliance_explains_is_forgiven() -> None:
    world, scenario = shipped_world(), make_scenario(1.0, -40.0)
    rigid = replay_event_driven(world, scenario, *hold(0.0))
    drake = replay_drake(world, scenario, *hold(0.0))
    ends = drake.goal_error  # 4 mm short of where the rigid wall leads
    promised = ends - drake.compliance_error
    assert confirms(promised**2, drake, METRE, promised - 0.0019)
    assert not confirms(promised**2, drake, METRE, promised - 0.0021)
    assert not confirms(promised**2, rigid, METRE, promised - 0.0021)


@pytest.mark.slow
def test_drake_rests_under_a_push() -> None:
    replay = replay_drake(shipped_world(), make_scenario(0.05, 0.0, restitution=0.1), *hold(-2.0))
    # At low speeds the dissipation takes little: what is left trembles for long.
    assert abs(replay.positions[-1, 0]) < 1e-4
    assert abs(replay.velocities[-1, 0]) < 1e-2


def test_the_contact_delay_is_half_a_period_on_the_pairs_stiffness_for_each_contact() -> None:
    assert contact_delay(shipped_world()) == pytest.approx(math.pi * math.sqrt(1 / 1e9))
    assert contact_delay(shipped_world(2.0)) == pytest.approx(math.pi * math.sqrt(2 / 1e9))
    world = World.from_diagram(make_diagram(num_joints=2, stiffness=1e7))
    J = world.calc_contact_jacobian(np.zeros(2))[0]
    mass = 1 / (J @ np.linalg.solve(world.constant_inertia.mass_matrix, J))
    assert contact_delay(world) == pytest.approx(math.pi * math.sqrt(mass / 5e6))
    world = make_line((1.0, 4.0))
    between, wall, far = contact_delays(world)
    assert wall == pytest.approx(np.pi * np.sqrt(1e-9))
    assert between == pytest.approx(np.pi * np.sqrt(0.8e-9))
    assert contact_delay(world) == far == pytest.approx(np.pi * np.sqrt(4e-9))


@given(st.floats(0.05, 0.999), st.floats(0.1, 10))
def test_dissipation_solves_its_equation(e: float, speed: float) -> None:
    y = calc_dissipation(e, speed) * speed
    excess = y - math.log1p(y) + e * y + math.log1p(-e * y)
    slope = y / (1 + y) + e - e / (1 - e * y)
    assert abs(excess / slope) < 1e-9 * y


def test_dissipation_at_its_ends() -> None:
    assert calc_dissipation(1.0, 2.0) == 0.0
    below, above = (calc_dissipation(1 - 1e-4 * part, 1.0) for part in (1.001, 0.999))
    assert below / 1.001 == pytest.approx(above / 0.999, rel=1e-6)
    assert calc_dissipation(0.0, 2.0) == calc_dissipation(1e-3, 2.0) == pytest.approx(500.0)


def test_a_replay_replaces_the_diagrams_own_controller() -> None:
    driven = World.from_diagram(make_diagram(push=7.0))
    free = World.from_diagram(make_diagram())
    replays = [replay_drake(world, make_scenario(), *hold(0.0)) for world in (driven, free)]
    assert replays[0] == replays[1]


def test_the_cost_is_effort_and_goal_error() -> None:
    scenario = make_scenario(1.0, 0.0, control_weight=0.5, goal_weight=3.0)
    times, forces = [0.0, 0.1, 0.4], [[2.0], [-1.0]]
    replay = replay_event_driven(shipped_world(), scenario, times, forces)
    end = 1.0 + 2.0 * 0.1**2 / 2 + 0.2 * 0.3 - 0.3**2 / 2
    assert replay.goal_error == pytest.approx(abs(end - 0.73))
    assert replay.cost == pytest.approx(0.5 * (0.1 * 4 + 0.3 * 1) + 3.0 * (end - 0.73) ** 2)
    assert replay.energy_ratio is None and replay.energy_ratios == ()


@pytest.mark.parametrize("replay_in", [replay_event_driven, replay_drake])
def test_a_replay_survives_json(replay_in: Any) -> None:
    for q in (1.0, 3.0):  # with and without a bounce
        replay = replay_in(shipped_world(), make_scenario(q, restitution=0.5), *hold(0.1, steps=9))
        read = from_plain(Replay, json.loads(json.dumps(to_plain(replay))))
        assert read == replay and hash(read) == hash(replay)
        assert not read.positions.flags.writeable
    with pytest.raises(DamagedDataError, match=r"Replay\.cost: got nothing, expected a value"):
        from_plain(Replay, {k: v for k, v in to_plain(replay).items() if k != "cost"})


def test_the_energy_ratio_weighs_contacts_by_their_energy() -> None:
    scenario = make_scenario(0.1, restitution=0.5)
    replay = replay_event_driven(shipped_world(), scenario, *hold(-9.0))
    assert len(replay.energy_ratios) > 5
    assert replay.energy_ratio == pytest.approx(0.25)
    fields = to_plain(replay) | {
        "bounce_times": [0.1, 0.2],
        "energies_before": [2.0, 1e-6],
        "energies_after": [0.5, 1e-6],
    }
    assert from_plain(Replay, fields).energy_ratio == pytest.approx(0.25, rel=1e-5)
    # A block that is pushed from rest has no ratio, and hides none.
    pushed = fields | {"energies_before": [2.0, 1e-6], "energies_after": [0.5, 3.0]}
    assert from_plain(Replay, pushed).energy_ratio == pytest.approx(0.25)
    pushed |= {"bounce_times": [0.2], "energies_before": [1e-6], "energies_after": [3.0]}
    assert from_plain(Replay, pushed).energy_ratio is None


@pytest.mark.parametrize("replay_in", [replay_event_driven, replay_drake])
@pytest.mark.parametrize(
    ("times", "forces", "message"),
    [
        ([0.0, 1.0], [[1.0], [2.0]], r"controls: got shape \(2, 1\), expected 1 rows"),
        ([0.0, 1.0], [[1.0, 2.0]], r"controls: got shape \(1, 2\), expected 1 columns, one for e"),
        ([1.0, 0.0], [[1.0]], r"times: got 1 s, then 0 s \(knots 0 and 1\), expected strictly inc"),
        ([0.0, 1.0], [[math.nan]], r"controls: got nan at index \(0, 0\), expected finite numbers"),
    ],
)
def test_a_bad_control_is_refused(
    replay_in: Any, times: npt.ArrayLike, forces: npt.ArrayLike, message: str
) -> None:
    with pytest.raises(TrajectoryError, match=message):
        replay_in(shipped_world(), make_scenario(), times, forces)


def test_a_plan_holds_if_its_replay_costs_and_misses_little_more() -> None:
    replay = replay_event_driven(shipped_world(), make_scenario(), *hold(0.0))
    cost, error = replay.cost, replay.goal_error  # 0.0729, 0.27 m
    assert confirms(cost, replay, METRE, error) and confirms(cost, replay, METRE)
    assert confirms(2 * cost, replay, METRE, 2 * error)  # better than promised
    assert confirms(cost / 1.04, replay, METRE, error)
    assert not confirms(cost / 1.06, replay, METRE, error)
    assert confirms(cost, replay, METRE, error - 0.0019)
    assert not confirms(cost, replay, METRE, error - 0.0021)
    assert confirms(cost - 3.9e-6, replay, METRE, relative_cost=0.0)
    assert not confirms(cost - 4.1e-6, replay, METRE, relative_cost=0.0)
    assert not confirms(math.nan, replay, METRE)
    assert not confirms(cost, replay, METRE, math.nan)


@given(size=st.sampled_from([1e-3, 1e-2, 1.0, 1e3]), miss=st.floats(1e-4, 1e-2))
def test_the_verdict_is_the_same_at_every_size(size: float, miss: float) -> None:
    # The same motion a thousand times smaller, with the same miss in proportion.
    verdicts = []
    for unit in (1.0, size):
        scenario = dataclasses.replace(
            make_scenario(unit, -2.0 * unit), goal_position=0.73 * unit, time_step=0.1
        )
        scales = Scales.of(shipped_world(), scenario)
        replay = replay_event_driven(shipped_world(), scenario, *hold(0.0))
        verdicts += [
            confirms(replay.cost, replay, scales, replay.goal_error - miss * unit),
            confirms(replay.cost - (miss * unit) ** 2, replay, scales, relative_cost=0.0),
        ]
    assert verdicts[:2] == verdicts[2:]
    assert verdicts[:2] == [miss < 2e-3] * 2 or miss == pytest.approx(2e-3, rel=1e-6)


def run_both(
    world: World, q: Any, v: Any, times: npt.ArrayLike, controls: npt.ArrayLike, e: float
) -> tuple[Replay, Replay]:
    scenario = make_task("corridor", q, v, restitution=e)
    rigid = replay_event_driven(world, scenario, times, controls)
    return rigid, replay_drake(world, scenario, times, controls)


def miss(rigid: Replay, drake: Replay) -> float:
    return float(np.linalg.norm(rigid.positions[-1] - drake.positions[-1]))


@pytest.mark.parametrize("e", [1.0, 0.8])
@pytest.mark.parametrize("bounces", [1, 6])
def test_lateness_adds_up_in_the_corridor_as_foretold(bounces: int, e: float) -> None:
    # From the middle at such a speed that the n-th flight ends at 1.3 s of 1.5.
    v = (0.5 + sum(e**-n for n in range(1, bounces))) / 1.3
    world = shipped("corridor")
    rigid, drake = run_both(world, 0.5, v, *hold_still(world, 1.5, 100), e)
    assert len(rigid.bounce_times) == len(drake.bounce_times) == bounces
    assert drake.bounce_contacts == rigid.bounce_contacts
    assert drake.bounce_times == pytest.approx(rigid.bounce_times, abs=2e-4 * bounces)
    np.testing.assert_allclose(drake.energy_ratios, e**2, atol=1e-4)
    assert 0.5 * drake.compliance_error < miss(rigid, drake) < drake.compliance_error
    late = bounces * contact_delay(world) * v * e**bounces
    assert miss(rigid, drake) >= 0.9 * late
    speeds = np.sqrt(2 * np.array(rigid.energies_before)) if e < 1 else []
    assert drake.matched_speeds == pytest.approx(list(speeds), rel=1e-4)


@pytest.mark.parametrize(("v", "e"), [(-3.0, 1.0), (1.1, 0.5), (4.0, 0.8)])
def test_a_control_does_not_lead_farther_astray_than_foretold(v: float, e: float) -> None:
    world = shipped("corridor")
    times = np.linspace(0.0, 1.5, 101)
    u = 3 * np.sin(7 * times[:-1])[:, np.newaxis]
    rigid, drake = run_both(world, 0.5, v, times, u, e)
    assert drake.bounce_contacts == rigid.bounce_contacts
    assert miss(rigid, drake) < drake.compliance_error < 0.01
    if (v, e) == (4.0, 0.8):  # With a contact's Jacobian after it Radau's rule ends 3 cm off.
        assert miss(rigid, drake) < 3e-4
    np.testing.assert_allclose(drake.energy_ratios, e**2, atol=1e-3)


@pytest.mark.parametrize("e", [1.0, 0.6])
def test_each_wall_of_a_corner_returns_its_part(e: float) -> None:
    world = shipped("room")
    rigid, drake = run_both(world, [0.5, 0.25], [-2.0, -1.0], *hold_still(world, 0.5), e)
    assert sorted(drake.bounce_contacts) == [0, 2]
    np.testing.assert_allclose(drake.velocities[-1], rigid.velocities[-1], atol=1e-3)
    assert miss(rigid, drake) < drake.compliance_error < 1e-3
    elastic = 2.0 * np.sqrt(1e-9)
    assert (0.7 if e < 1 else 0.999) * elastic < drake.max_penetration < 1.001 * elastic


def test_the_models_own_restitution_is_matched_at_its_wall_only() -> None:
    world = make_wedge(np.pi / 2, (0.5, None))
    _, drake = run_both(world, [0.2, 0.1], [-1.0, -1.0], *hold_still(world), 1.0)
    np.testing.assert_allclose(drake.velocities[-1], [1.0, 0.5], atol=1e-4)
    assert drake.matched_speeds == pytest.approx([1.0])
    # The plant is as it was: without the model's restitution all is elastic.
    elastic = make_wedge(np.pi / 2)
    _, drake = run_both(elastic, [0.2, 0.1], [-1.0, -1.0], *hold_still(elastic), 1.0)
    np.testing.assert_allclose(drake.velocities[-1], [1.0, 1.0], atol=1e-4)


@pytest.mark.parametrize("speed", [20.0, 100.0])
def test_what_a_dead_stop_gives_back_is_explained_and_no_more(speed: float) -> None:
    # No finite dissipation takes all of the speed: Drake's wall returns a thousandth.
    world = shipped("corridor")
    rigid, drake = run_both(world, 0.5, -speed, *hold_still(world), 0.0)
    missed = miss(rigid, drake)
    assert 0.9e-3 * speed < missed < drake.compliance_error < 1.1e-3 * speed


@pytest.mark.parametrize("e", [1.0, 0.7])
def test_bodies_that_meet_do_as_rigid_ones(e: float) -> None:
    world = shipped("two_masses")
    rigid, drake = run_both(world, [0.2, 0.6], [2.0, -1.0], *hold_still(world, 0.7), e)
    assert drake.bounce_contacts == rigid.bounce_contacts == ((1, 2, 0) if e == 1 else (1, 2))
    assert miss(rigid, drake) < 1.1 * drake.compliance_error < 2e-3
    np.testing.assert_allclose(drake.velocities[-1], rigid.velocities[-1], atol=1e-3)


def test_rest_on_one_wall_hides_no_bounce_off_the_next() -> None:
    world = shipped("room")
    times, u = np.linspace(0.0, 0.6, 61), np.tile([0.0, -5.0], (60, 1))
    rigid, drake = run_both(world, [0.5, 1e-3], [1.5, 0.0], times, u, 0.5)
    assert 1 in drake.bounce_contacts
    np.testing.assert_allclose(drake.positions[-1], rigid.positions[-1], atol=1e-3)


def test_a_ball_that_passes_a_block_touches_nothing() -> None:
    world = shipped("room_with_block")
    rigid, drake = run_both(world, [0.2, 0.35], [0.5, 0.0], *hold_still(world), 1.0)
    assert drake.bounce_times == rigid.bounce_times == ()
    assert drake.max_penetration == 0
    # Both see its left face.
    rigid, drake = run_both(world, [0.2, 0.5], [0.5, 0.0], *hold_still(world), 1.0)
    assert drake.bounce_contacts == rigid.bounce_contacts == (5,)
    assert miss(rigid, drake) < drake.compliance_error < 1e-4


@pytest.mark.parametrize(("bounces", "part"), [(1, 0.9), (8, 0.1)])
def test_lateness_stays_lateness_through_later_bounces(bounces: int, part: float) -> None:
    # Of a ball that hops, e = 1: each delay leaves it that much later for good, so the end is off
    # by the last speed times all delays, but for what integration may miss of the energy.
    world = shipped("floor")
    g, speed, tau = 9.81, 2.0, contact_delay(world)
    hop = 2 * speed / g
    last = speed * abs(1 - 2 * part)
    times = np.linspace(0.0, (bounces - 0.5 + part) * hop, 201)
    rigid, drake = run_both(world, speed**2 / 2 / g, 0.0, times, np.zeros((200, 1)), 1.0)
    assert len(drake.bounce_times) == len(rigid.bounce_times) == bounces
    late = drake.compliance_error - bounces * last * tau
    assert 0 <= late < bounces**2 * 4e-5 * 3 * speed * hop
    assert miss(rigid, drake) < drake.compliance_error
    # Whatever comes before rest is over with it.
    _, rests = run_both(world, 0.1, 0.0, *hold_still(world, 2.0), 0.5)
    assert rests.bounce_times and rests.compliance_error < 1e-12


def test_planned_contacts_say_where_they_are() -> None:
    world = shipped("corridor")
    times = np.linspace(0.0, 1.0, 11)
    impulses = np.zeros((11, 2))
    impulses[2, 1], impulses[7, 0] = 4.0, 3.0
    velocities = np.concatenate([np.full(3, 2.0), np.full(5, -2.0), np.full(3, 1.0)])[:, np.newaxis]
    positions = np.linspace(0.5, 1.2, 11)[:, np.newaxis]
    trajectory = Trajectory(
        times, positions, velocities, np.zeros((10, 1)), impulses, np.zeros((10, 2))
    )
    first, second = find_contacts(world, trajectory)
    assert [first.index, second.index] == [1, 0]
    assert [first.time, second.time] == pytest.approx([0.2, 0.7])
    assert first.velocity_change == pytest.approx(4.0) and first.energy_ratio == pytest.approx(1.0)
    assert second.energy_ratio == pytest.approx(0.25)
    assert max_penetration(world, trajectory) == pytest.approx(0.2)
    # A force of rounding in the step before a touch does not make it begin there.
    forces = np.zeros((10, 2))
    forces[1, 1] = 1e-14
    rounded = Trajectory(times, positions, velocities, np.zeros((10, 1)), impulses, forces)
    assert [each.time for each in find_contacts(world, rounded)] == pytest.approx([0.2, 0.7])


def test_a_corner_is_two_planned_contacts_at_once_and_between_faces_is_outside() -> None:
    world = shipped("room_with_block")
    times = np.array([0.0, 0.5, 1.0])
    impulses = np.zeros((3, 8))
    impulses[1, [0, 2]] = 2.0
    positions = np.array([[0.2, 0.3], [0.0, 0.0], [0.5, 0.3]])
    velocities = np.array([[-1.0, -1.0], [-1.0, -1.0], [1.0, 1.0]])
    trajectory = Trajectory(
        times, positions, velocities, np.zeros((2, 2)), impulses, np.zeros((2, 8))
    )
    assert [contact.index for contact in find_contacts(world, trajectory)] == [0, 2]
    assert all(c.energy_ratio == pytest.approx(1.0) for c in find_contacts(world, trajectory))
    # Behind three planes of the block, in front of the fourth.
    assert max_penetration(world, trajectory) == 0
