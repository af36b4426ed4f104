"""Drake's own contact where there are several walls and bounces: near to rigid, and how near."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from replay_worlds import hold_still, make_line, make_task, make_wedge, shipped

from drake_aigto.contact import contact_delay, contact_delays
from drake_aigto.simulation import (
    Impact,
    Recording,
    Replay,
    Rest,
    calc_compliance_error,
    find_contacts,
    max_penetration,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import World


def run_both(
    world: World, q: Any, v: Any, times: npt.ArrayLike, controls: npt.ArrayLike, e: float
) -> tuple[Replay, Replay]:
    """Returns the rigid replay and Drake's."""
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


def test_each_contact_has_its_own_delay() -> None:
    world = make_line((1.0, 4.0))
    between, wall, far = contact_delays(world)
    assert wall == pytest.approx(np.pi * np.sqrt(1e-9))
    assert between == pytest.approx(np.pi * np.sqrt(0.8e-9))
    assert contact_delay(world) == far == pytest.approx(np.pi * np.sqrt(4e-9))


@pytest.mark.parametrize(("bounces", "part"), [(1, 0.9), (8, 0.1)])
def test_lateness_stays_lateness_through_later_bounces(bounces: int, part: float) -> None:
    # Of a ball that hops, e = 1: each delay leaves it that much later for good, so the end is off
    # by the last speed times all delays, but for what integration may miss of the energy.
    world = shipped("floor")
    g, speed, tau = 9.81, 2.0, contact_delay(world)
    hop = 2 * speed / g
    impacts = [Impact(n * hop, 0, speed, -g, 2.0, 2.0) for n in range(bounces)]
    end = (bounces - 1 + part) * hop
    recording = Recording(times=[0.0, end], positions=[np.zeros(1), np.ones(1)], impacts=impacts)
    error = calc_compliance_error(world, np.ones(1), recording)
    # Whatever comes before rest is over with it.
    at_rest = dataclasses.replace(recording, rests=[Rest(impacts[-1].time + 1e-3, 0)])
    assert calc_compliance_error(world, np.ones(1), at_rest) == pytest.approx(0.0, abs=1e-15)
    last = speed * abs(1 - 2 * part)
    assert 0 <= error - bounces * last * tau < bounces**2 * 4e-5 * 3 * speed * hop
    times = np.linspace(0.0, (bounces - 0.5 + part) * hop, 201)
    rigid, drake = run_both(world, speed**2 / 2 / g, 0.0, times, np.zeros((200, 1)), 1.0)
    assert len(drake.bounce_times) == len(rigid.bounce_times) == bounces
    assert miss(rigid, drake) < drake.compliance_error == pytest.approx(error, rel=0.02)


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
