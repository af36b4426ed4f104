"""Net impulses taken apart: one wall, walls that face each other, rooms, bodies in a row."""

from __future__ import annotations

import dataclasses

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.solvers import LinearConstraint

from drake_aigto import Scenario, World
from drake_aigto.simulation import replay_event_driven
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import ImpulseDirections, RigidTranscription

Array = npt.NDArray[np.float64]

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
