"""Contact sequences: read off the impulses of boxes, compared, and read off trajectories."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.solvers import LinearConstraint
from replay_worlds import make_diagram, make_scenario, shipped_world
from rigid_worlds import Array, make_motion, physics_of

from drake_aigto import Scenario, World
from drake_aigto.control import PlannedMotion, choose, find_left
from drake_aigto.planning import is_same, read_sequences
from drake_aigto.simulation import PlannedContact, find_contacts, replay_event_driven
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import ImpulseDirections, RigidTranscription, Touch, TouchSequence

STEPS = 50  # of 0.02 s, as the planner's boxes have them
CRUISE = 2.0  # the largest speed [m/s]


def kick(
    impulses: Mapping[int, float], mass: float = 1.0, duration: float = 1.0, speed: float = CRUISE
) -> tuple[RigidTranscription, Array]:
    """Returns decision variables to whose velocity the wall adds so much at these knots [m/s].

    The control takes it away at once, so that the speed stays what it is.
    """
    scenario = make_scenario(1.0, -speed, duration=duration, time_step=duration / STEPS, mass=mass)
    transcription = RigidTranscription(shipped_world(mass), scenario)
    dt = duration / STEPS
    v, u = np.full((STEPS + 1, 1), -speed), np.zeros((STEPS, 1))
    for k in range(STEPS):
        u[k] = -mass * impulses.get(k, 0.0) / dt
    return transcription, transcription.vector_of(np.ones((STEPS + 1, 1)), v, u)


def times(sequence: TouchSequence) -> list[float]:
    return [touch.start for touch in sequence]


def contacts(sequence: TouchSequence) -> list[int]:
    return [touch.contact for touch in sequence]


def test_what_is_no_contact_is_a_flight() -> None:
    # Nothing, the start, a pull, and a wall that pushes a little from afar.
    for impulses in ({}, {0: 3.0}, {7: -3.0}, dict.fromkeys(range(STEPS), 0.04 * CRUISE)):
        assert read_sequences(*kick(impulses)) == [()]
    assert times(read_sequences(*kick({0: 3.0, 10: 3.0}))[0]) == pytest.approx([0.2])


@pytest.mark.parametrize("mass", [1.0, 4.0])
def test_an_impulse_counts_by_its_share_of_the_largest_velocity(mass: float) -> None:
    assert read_sequences(*kick({20: 0.049 * CRUISE}, mass)) == [()]
    bounce, merged = read_sequences(*kick({20: 0.051 * CRUISE}, mass))
    assert times(bounce) == times(merged) == pytest.approx([0.4])


def test_a_smeared_bounce_is_one_at_its_mean_time() -> None:
    bounces, merged = read_sequences(*kick({20: 1.0, 21: 2.0, 23: 1.0}))
    mean = 0.02 * (20 + 42 + 23) / 4
    assert times(bounces) == times(merged) == pytest.approx([mean])
    assert not bounces[0].lasts


def test_impulses_far_apart_are_bounces_in_order_and_merged_into_one() -> None:
    bounces, merged = read_sequences(*kick({10: 1.0, 12: 3.0, 18: 2.0, 40: 2.0}))
    # 0.24 s and 0.36 s are farther apart than a tenth of the duration.
    assert times(bounces) == pytest.approx([0.02 * (10 + 36) / 4, 0.36, 0.8])
    assert times(merged) == pytest.approx([0.02 * (10 + 36 + 36 + 80) / 8])
    assert not any(touch.lasts for touch in (*bounces, *merged))


@pytest.mark.parametrize(("length", "proposals"), [(3, 2), (4, 3), (12, 3)])
def test_pushes_at_knot_after_knot_may_be_contact_that_lasts(length: int, proposals: int) -> None:
    run = dict.fromkeys(range(15, 15 + length), 0.5)
    sequences = read_sequences(*kick({5: 1.0, 6: 1.0, **run, 40: 1.0}))
    assert len(sequences) == proposals
    if proposals == 3:
        (contact,) = sequences[2]
        assert contact.joints == pytest.approx((0.3, 0.02 * (14 + length)))


@given(
    st.dictionaries(st.integers(1, STEPS - 1), st.floats(0.2, 3.0), min_size=1, max_size=12),
    st.sampled_from([1e-3, 1.0, 50.0]),
)
def test_what_is_proposed_is_in_order_and_inside_of_the_duration(
    impulses: dict[int, float], duration: float
) -> None:
    sequences = read_sequences(*kick(impulses, duration=duration))
    for sequence in sequences:
        joints = [t for touch in sequence for t in touch.joints]
        assert np.all(np.diff([0.0, *joints, duration]) > 0)
    knots = sorted(impulses)
    # A gap of 5 knots is a tenth of the duration, give or take a rounding.
    fewest, most = (1 + sum(b - a > gap for a, b in pairwise(knots)) for gap in (5, 4))
    assert fewest <= len(sequences[0]) <= most
    assert len(sequences[1]) == 1
    total = sum(impulses.values())
    mean = sum(k * p for k, p in impulses.items()) / total * duration / STEPS
    assert sequences[1][0].start == pytest.approx(mean)


def test_exact_motions_propose_their_own_touches(tmp_path_factory: pytest.TempPathFactory) -> None:
    for name in ("point mass", "mirrored", "two joints"):
        physics = physics_of(name, tmp_path_factory.getbasetemp())
        scenario, motion = make_motion(physics, 0.8, seed=7)
        transcription = RigidTranscription(physics.world, scenario)
        hits = motion.times[motion.impulses[:, 0] > 0]
        assert hits[1] - hits[0] > 0.1
        proposed = read_sequences(transcription, transcription.vector(motion))
        assert times(proposed[0]) == pytest.approx(hits.tolist())


def test_sequences_are_the_same_if_they_are_of_a_kind_and_near() -> None:
    bounce, longer = Touch.bounce(0.5), Touch(0.5, 0.7)
    assert is_same((), (), 0.0)
    assert is_same((bounce,), (Touch.bounce(0.52),), 0.03)
    assert not is_same((bounce,), (Touch.bounce(0.54),), 0.03)
    assert is_same((longer,), (Touch(0.52, 0.68),), 0.03)
    assert not is_same((longer,), (Touch(0.5, 0.74),), 0.03)
    assert not is_same((bounce,), (Touch(0.5, 0.52),), 1.0)
    assert not is_same((bounce,), (), 1.0)
    assert not is_same((bounce,), (bounce, Touch.bounce(0.51)), 1.0)
    assert not is_same((bounce, longer), (longer, bounce), 1.0)
    # Soon after the start, a bounce 20 ms later is another.
    assert not is_same((Touch.bounce(0.001),), (Touch.bounce(0.02),), 0.03)
    assert is_same((Touch.bounce(0.001),), (Touch.bounce(0.0012),), 0.03)


def fly(
    impulses: Mapping[int, float],
    forces: Mapping[int, float],
    knots: Array,
    speed: float = -2.0,
    gravity: float = 0.0,
) -> Trajectory:
    """Returns velocities of 1.5 kg that the wall's impulses [N s] and forces [N] change."""
    N = len(knots) - 1
    p, f, v = np.zeros((N + 1, 1)), np.zeros((N, 1)), np.full((N + 1, 1), speed)
    for k, size in impulses.items():
        p[k] = size
    for k, size in forces.items():
        f[k] = size
    for k, tau in enumerate(np.diff(knots)):
        v[k + 1] = v[k] + p[k] / 1.5 + tau * (f[k] / 1.5 - gravity)
    return Trajectory(knots, np.zeros((N + 1, 1)), v, np.zeros((N, 1)), p, f)


@pytest.fixture(scope="module")
def floor() -> World:
    return World.from_diagram(make_diagram(gravity=10.0))


KNOTS = np.array([0.0, 0.1, 0.15, 0.3, 0.5, 0.6, 0.62, 0.8, 1.0])


def test_a_flight_has_no_contact(floor: World) -> None:
    assert find_contacts(floor, fly({}, {}, KNOTS)) == ()
    # Rounding of a solver is none.
    assert find_contacts(floor, fly({3: 1e-12}, {}, KNOTS)) == ()


# Also at knots next to each other.
@pytest.mark.parametrize(("knot", "size"), [(5, 0.75), (3, 1.5)])
def test_every_impulse_is_a_contact_of_its_own(floor: World, knot: int, size: float) -> None:
    first, second = find_contacts(floor, fly({2: 4.5, knot: size}, {}, KNOTS))
    assert (first.time, first.last_time) == (0.15, 0.15)
    assert (first.velocity_change, first.energy_ratio) == pytest.approx((3.0, 0.25))
    assert (second.time, second.velocity_change) == pytest.approx((KNOTS[knot], size / 1.5))
    assert second.energy_ratio == pytest.approx((1.0 + size / 1.5) ** 2)


def test_a_contact_that_lasts_is_one_from_first_to_last_knot(floor: World) -> None:
    motion = fly({2: 3.0}, {2: 15.0, 3: 15.0}, KNOTS, speed=-0.5, gravity=10.0)
    (contact,) = find_contacts(floor, motion)
    assert (contact.time, contact.last_time) == (0.15, 0.5)
    assert contact.velocity_change == pytest.approx((3.0 + 15.0 * 0.35) / 1.5)
    assert contact.energy_ratio == pytest.approx(0.0, abs=1e-15)  # it landed at 2 m/s, and stays


def test_contacts_that_last_end_where_others_begin(floor: World) -> None:
    # It bounces, lasts from 0.3 s, ends at 0.6 s, and bounces there and at the next knot.
    motion = fly({1: 1.0, 3: 2.0, 5: 1.0, 6: 1.0}, {3: 15.0, 4: 15.0}, KNOTS, gravity=10.0)
    spans = [(c.time, c.last_time) for c in find_contacts(floor, motion)]
    assert spans == [(0.1, 0.1), (0.3, 0.6), (0.62, 0.62)]
    # Two that last with a flight between.
    motion = fly({}, {1: 15.0, 2: 15.0, 5: 15.0}, KNOTS, gravity=10.0)
    assert [(c.time, c.last_time) for c in find_contacts(floor, motion)] == [
        (0.1, 0.3),
        (0.6, 0.62),
    ]


def test_what_lands_and_leaves_at_no_speed_keeps_its_energy(floor: World) -> None:
    # 1 m/s fast on the way; at the wall only what a solver leaves.
    at_rest = fly({}, {2: 15.0, 3: 15.0}, KNOTS, speed=1.0)
    velocities = np.array([-1.0, -0.5, 1e-9, 0.0, 3e-8, 0.5, 1.0, 1.0, 1.0])[:, np.newaxis]
    (contact,) = find_contacts(floor, dataclasses.replace(at_rest, velocities=velocities))
    assert contact.energy_ratio == 1.0
    velocities[4] = 0.1
    (contact,) = find_contacts(floor, dataclasses.replace(at_rest, velocities=velocities))
    assert contact.energy_ratio is None  # after / before means nothing


PERIOD, LEFT = 0.01, 1.0
PLAN = (Touch.bounce(0.5), Touch.bounce(0.8, 1))
COMES, LEAVES = np.array([-1.0, 1.0]), np.array([1.0, -1.0])


def left_contacts(
    now: float, rates: np.ndarray, bounced: int | None = None
) -> list[tuple[int, ...]]:
    found = find_left(PLAN, now, LEFT, PERIOD, rates, bounced)
    return [tuple(touch.contact for touch in touches) for touches in found]


def test_near_a_touch_the_speed_tells_what_is_likelier() -> None:
    # Far from it, only what leaves its wall may have been there.
    assert left_contacts(0.2, COMES) == [(0, 1)]
    assert left_contacts(0.2, LEAVES) == [(0, 1), (1,)]
    assert left_contacts(0.49, COMES) == [(0, 1), (1,)]
    assert left_contacts(0.49, LEAVES) == [(1,), (0, 1)]
    # One that was just seen is near, however late it was planned; one that is over may be late.
    assert left_contacts(0.2, LEAVES, bounced=0) == [(1,), (0, 1)]
    assert left_contacts(0.51, COMES)[0] == (0, 1)
    assert left_contacts(0.51, LEAVES) == [(1,)]


HOLDS = (Touch(0.1, 0.4, 0, 1), Touch(0.2, 1.0, 1), Touch(0.4, 1.0, 0, 0))
STILL = np.zeros(2)


def hold(now: float, rates: np.ndarray = STILL, **slips: int) -> list[tuple[float, ...]]:
    """Returns the likeliest touches left as start, end, contact and mode; slips by contact."""
    lying = {int(name[1:]): slip for name, slip in slips.items()}
    touches = find_left(HOLDS, now, LEFT - now, PERIOD, rates, None, lying)[0]
    return [(touch.start, touch.end, touch.contact, touch.mode) for touch in touches]


def test_what_lasts_overlaps_goes_on_in_another_mode_and_to_the_end() -> None:
    expected = [(0.1, 0.4, 0, 1), (0.2, 1.0, 1, 0), (0.4, 1.0, 0, 0)]
    np.testing.assert_allclose(hold(0.0), expected, atol=1e-12)
    # Both have begun, and lie: they last from now on.
    expected = [(0.0, 0.1, 0, 1), (0.0, 0.7, 1, 0), (0.1, 0.7, 0, 0)]
    np.testing.assert_allclose(hold(0.3, c0=1, c1=0), expected, atol=1e-12)


def test_what_is_late_to_lie_comes_at_once_and_what_slips_otherwise_does_so_first() -> None:
    late = hold(0.3, COMES, c1=0)
    assert late[0][0] > 0 and late[1][0] == 0
    slips = hold(0.3, c0=-1, c1=0)
    assert [(row[2], row[3]) for row in slips] == [(0, -1), (0, 1), (1, 0), (0, 0)]
    assert slips[0][1] == slips[1][0] == PERIOD
    # It lies there early: a period before it was to.
    assert hold(0.1 - PERIOD, c0=1)[0][0] == 0


def test_the_first_motion_that_is_not_dearer_is_taken_or_else_the_cheapest() -> None:
    def motion(cost: float) -> PlannedMotion:
        row = np.zeros((2, 1))
        still = Trajectory(np.array([0.0, 1.0]), row, row, row[:1], row, row[:1])
        return PlannedMotion(still, cost, ())

    same, cheap, dear = motion(1.01), motion(0.5), motion(2.0)
    assert choose([None, dear, same, cheap], 1.0) is same
    assert choose([dear, None, motion(3.0)], 1.0) is dear
    assert choose([None], 1.0) is None


def test_a_ratio_that_an_earlier_version_saved_as_infinite_is_none() -> None:
    assert PlannedContact(0.0, 0.1, 2.0, np.inf).energy_ratio is None
    assert PlannedContact(0.0, 0.1, 2.0, 0.5).energy_ratio == 0.5
    assert PlannedContact(0.1, 0.1, 2.0, np.inf).energy_ratio == np.inf  # from nowhere


def test_a_contact_that_begins_at_rest_has_no_energy_ratio(floor: World) -> None:
    # Pushed off at 1e-3 of the speed that it ends with, thrown, and thrown back.
    motion = fly({2: 3.0, 5: 1.5, 7: 6.0}, {2: 15.0, 3: 15.0}, KNOTS, speed=-1e-3)
    ratios = [contact.energy_ratio for contact in find_contacts(floor, motion)]
    assert ratios[0] is None and all(each is not None for each in ratios[1:])
    # A blow adds energy from nowhere, however slowly it begins.
    blown = fly({2: 3.0, 5: 1.5, 7: 6.0}, {}, KNOTS, speed=-1e-3)
    first = find_contacts(floor, blown)[0].energy_ratio
    assert first is not None and first > 1e4


NAMES = ("corridor/three_bounces", "floor/rebound", "room/bank_shot", "two_masses/apart")


def world_of(name: str) -> World:
    return World.from_scenario(Scenario.named(name))


@pytest.fixture(scope="module", params=[*NAMES, "table1/1", "room_with_block/around"])
def world(request: pytest.FixtureRequest) -> World:
    return world_of(request.param)


def test_directions_hold_every_contact_and_tangents_none(world: World) -> None:
    ways = ImpulseDirections.of(world.constant_inertia)
    # What no direction holds and no tangent sees would be an impulse out of nowhere.
    assert np.linalg.matrix_rank(np.vstack([ways.readers, ways.tangents.T])) == world.num_velocities
    np.testing.assert_allclose(ways.jacobians @ ways.tangents, 0.0, atol=1e-14)
    assert np.all(np.any(ways.shares != 0, axis=0))
    np.testing.assert_allclose(ways.shares, ways.readers @ ways.jacobians.T, atol=1e-12)
    M = world.constant_inertia.mass_matrix
    np.testing.assert_allclose(ways.masses, [rho @ M @ rho for rho in ways.readers])
    np.testing.assert_allclose(np.max(np.abs(ways.shares), axis=1), 1.0)
    if ways.are_independent:
        assert np.all(np.sum(ways.shares != 0, axis=0) == 1)


def test_only_bodies_in_a_row_push_in_directions_that_depend_on_each_other() -> None:
    for name in NAMES:
        expected = not name.startswith("two_masses")
        assert ImpulseDirections.of(world_of(name).constant_inertia).are_independent is expected


def pushes_of(world: World, one: Array, distances: Array) -> Array:
    ways = ImpulseDirections.of(world.constant_inertia)
    net = ways.jacobians.T @ one
    in_force = np.ones((1, world.num_contacts), dtype=bool)
    return ways.contact_impulses(net[np.newaxis], distances[np.newaxis], in_force)[0]


@given(st.integers(0, 3), st.floats(0.01, 10.0))
def test_a_single_push_is_told_from_its_net_impulse(contact: int, size: float) -> None:
    for name in NAMES:
        world = world_of_cached(name)
        if contact < world.num_contacts:
            impulses = size * np.eye(world.num_contacts)[contact]
            distances = 1.0 - np.eye(world.num_contacts)[contact]
            np.testing.assert_allclose(
                pushes_of(world, impulses, distances), impulses, rtol=1e-9, atol=1e-9 * size
            )


_WORLDS: dict[str, World] = {}


def world_of_cached(name: str) -> World:
    if name not in _WORLDS:
        _WORLDS[name] = world_of(name)
    return _WORLDS[name]


def motion(name: str, restitution: float) -> tuple[Scenario, RigidTranscription, Trajectory]:
    """Returns a motion without control whose impacts are all on knots, of uniform steps."""
    base = Scenario.named(name)
    world = world_of(name)
    velocity = {"corridor": [4.0], "room": [4.0, 2.0], "two_masses": [2.0, -2.0]}
    position = {"corridor": [0.5], "room": [0.5, 0.5], "two_masses": [0.25, 0.75]}
    kind = name.split("/")[0]
    scenario = dataclasses.replace(
        base,
        initial_position=position[kind],
        initial_velocity=velocity[kind],
        goal_position=position[kind],
        duration=0.75,
        time_step=0.125 / 4,
        restitution=restitution,
    )
    transcription = RigidTranscription(world, scenario, relaxation=0.0)
    times = transcription.GetSampleTimes()
    controls = np.zeros((len(times) - 1, world.num_actuators))
    replay = replay_event_driven(world, scenario, times, controls)
    rows = np.searchsorted(replay.times, times - 1e-9)
    q, v = replay.positions[rows], replay.velocities[rows]
    zeros = np.zeros((len(times), world.num_contacts))
    return scenario, transcription, Trajectory(times, q, v, controls, zeros, zeros[1:])


@pytest.mark.parametrize("name", ["corridor/three_bounces", "room/bank_shot", "two_masses/apart"])
def test_exact_elastic_motions_meet_every_row(name: str) -> None:
    scenario, transcription, trajectory = motion(name, 1.0)
    x = transcription.vector(trajectory)
    assert scenario.num_steps == len(trajectory.controls)
    impulses = transcription.impulses(x)
    assert np.count_nonzero(impulses > 1.0) >= 3
    assert np.min(impulses) > -1e-6
    for binding in transcription.prog().GetAllConstraints():
        value = transcription.prog().EvalBinding(binding, x)
        constraint = binding.evaluator()
        name = constraint.get_description()
        assert np.all(value >= constraint.lower_bound() - 1e-6), name
        assert np.all(value <= constraint.upper_bound() + 1e-6), name


@pytest.mark.parametrize("name", ["corridor/three_bounces", "room/bank_shot", "two_masses/apart"])
def test_rows_see_a_wrong_restitution_and_a_push_from_afar(name: str) -> None:
    _, transcription, trajectory = motion(name, 1.0)
    lossy = dataclasses.replace(transcription.scenario, restitution=0.5)
    assert (
        worst(RigidTranscription(transcription.world, lossy, 0.0), trajectory)["restitution"] > 0.1
    )
    kicked = trajectory.velocities.copy()
    kicked[2:4] += 0.5
    pushed = dataclasses.replace(trajectory, velocities=kicked)
    assert worst(transcription, pushed)["contact"] > 0.01


def worst(transcription: RigidTranscription, trajectory: Trajectory) -> dict[str, float]:
    """Returns the largest residual of each kind of row."""
    x, found = transcription.vector(trajectory), dict[str, float]()
    for binding in transcription.prog().GetAllConstraints():
        name = binding.evaluator().get_description()
        value = np.max(np.abs(transcription.prog().EvalBinding(binding, x)))
        found[name] = max(found.get(name, 0.0), float(value))
    return found


def test_relaxed_walls_that_face_each_other_share_their_push() -> None:
    world = world_of("corridor/three_bounces")
    scenario = dataclasses.replace(Scenario.named("corridor/three_bounces"), time_step=0.05)
    transcription = RigidTranscription(world, scenario, relaxation=1e-2)
    L, T, dt = transcription.length_scale(), scenario.duration, scenario.time_step
    rng = np.random.default_rng(0)
    N = scenario.num_steps
    q, v = rng.uniform(0.1, 0.9, (N + 1, 1)), rng.uniform(-1, 1, (N + 1, 1))
    # The control leaves to the walls what the law λ = dt ε/φ gives, in units of m L²/T².
    law = 1e-2 * dt * L**2 / T**2 * (1 / q[:-1] - 1 / (1 - q[:-1]))
    u = (np.diff(v, axis=0) - law) / dt
    x = transcription.vector_of(q, v, u)
    rows = [
        transcription.prog().EvalBinding(binding, x)
        for binding in transcription.prog().GetAllConstraints()
        if binding.evaluator().get_description() == "contact"
        and not isinstance(binding.evaluator(), LinearConstraint)  # that of the start
    ]
    np.testing.assert_allclose(np.concatenate(rows), 0.0, atol=1e-12)
    found = transcription.impulses(x)[1:-1]
    np.testing.assert_allclose(found[:, 0] - found[:, 1], law[1:, 0], atol=1e-12)
