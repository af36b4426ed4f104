"""Contacts that are struck together, that rest while others bounce, and how far a motion is off."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from phase_solutions import MET, least_rest, optimise
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from replay_worlds import make_scenario
from unfolded_flights import MODELS, Flight

from drake_aigto import World
from drake_aigto.contact import JointImpact
from drake_aigto.dynamics import ConstantInertia
from drake_aigto.errors import OptionsError
from drake_aigto.planning import PhaseMotion, PhaseProblem
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch, TouchSequence, joint_times, rigid_defects
from drake_aigto.world import models_directory

G = 9.81


@cache
def load(model: str, gravity: tuple[float, float, float] = (0.0, 0.0, -G)) -> World:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    text = (models_directory() / f"{model}.sdf").read_text(encoding="utf-8")
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.mutable_gravity_field().set_gravity_vector(gravity)
    plant.Finalize()
    plant.SetDefaultPositions(np.linspace(0.3, 0.6, plant.num_positions()))
    return World.from_diagram(builder.Build())


def make_inertia(rng: np.random.Generator, count: int, size: int) -> ConstantInertia:
    """Returns contacts and a mass matrix by chance."""
    root = rng.normal(size=(size, size))
    M, J = root @ root.T + np.eye(size), rng.normal(size=(count, size))
    solids = tuple((i,) for i in range(count))
    return ConstantInertia(M, np.eye(size), J, np.zeros(count), solids)


@given(seed=st.integers(0, 1000), count=st.integers(1, 3))
def test_contacts_struck_at_once_return_their_speeds_and_nothing_else(
    seed: int, count: int
) -> None:
    rng = np.random.default_rng(seed)
    inertia = make_inertia(rng, count, size=3)
    M, J, every = inertia.mass_matrix, inertia.jacobian, tuple(range(count))
    e, before = rng.uniform(0, 1, count), rng.normal(size=3)
    impact = JointImpact.of(inertia, every, tuple(e))
    after = impact.velocities @ before
    np.testing.assert_allclose(J @ after, -e * (J @ before), atol=1e-7)
    # Nothing but these impulses acts.
    np.testing.assert_allclose(M @ (after - before), J.T @ impact.impulses @ before, atol=1e-7)
    elastic = JointImpact.of(inertia, every, (1.0,) * count).velocities @ before
    assert elastic @ M @ elastic == pytest.approx(before @ M @ before)
    assert np.all(impact.coupled) == (count > 1)


def test_walls_at_right_angles_do_not_feel_each_other() -> None:
    inertia = load("room").constant_inertia
    both = JointImpact.of(inertia, (0, 2), (1.0, 0.5))
    assert not both.coupled.any()
    first = JointImpact.of(inertia, (0,), (1.0,)).velocities
    second = JointImpact.of(inertia, (2,), (0.5,)).velocities
    np.testing.assert_allclose(both.velocities, first @ second, atol=1e-15)


def test_contacts_that_imply_each_other_are_refused() -> None:
    with pytest.raises(OptionsError) as error:
        JointImpact.of(load("corridor").constant_inertia, (0, 1), (1.0, 1.0))
    assert str(error.value) == (
        "sequence: got 2 contacts at once that can't all be distinguished, expected contacts with "
        "independent Jacobians. Leave out those that the others imply."
    )


def test_coupled_contacts_push_and_never_pull() -> None:
    # The left ball is hit by the right one as it meets its wall: mirrored, both turn around.
    scenario = make_scenario(
        [0.3, 0.6], [-0.6, -1.2], [0.3, 0.62], model=MODELS.format("two_masses"), time_step=0.025
    )
    world = load("two_masses")
    found = optimise(world, scenario, Touch.bounce(0.5, 0), Touch.bounce(0.5, 1))
    motion = found.trajectory
    (k,) = np.flatnonzero(motion.impulses.any(axis=1))
    left, between, right = motion.impulses[k]
    assert left > between > 0.5 and right == 0.0
    np.testing.assert_allclose(motion.positions[k], 0.0, atol=MET)
    # As if there were no right ball, and no left one.
    assert left == pytest.approx(-2 * motion.velocities[k].sum())
    assert between == pytest.approx(-2 * motion.velocities[k, 1])
    # Equal elastic balls end alike if their impacts come one after the other.
    assert found.replay().cost == pytest.approx(found.cost, rel=1e-4)


def test_it_slides_along_a_floor_and_bounces_off_a_wall_meanwhile() -> None:
    world = load("room", gravity=(0.0, -3.0, 0.0))
    T, y = 2.0, 0.3
    flight = Flight(0.5, -0.4, -0.45, T, goal_weight=100.0)
    scenario = make_scenario(
        [flight.start, y],
        [flight.speed, 0.0],
        [-flight.image, y],
        model=MODELS.format("room"),
        duration=T,
        time_step=T / 60,
        goal_weight=100.0,
        restitution=1.0,
    )
    vertical, land, leave = least_rest(y, T, e=1.0, mass=1.0, gravity=3.0, goal_weight=100.0)
    ((meets, _),) = flight.bounces()
    assert land < meets < leave
    found = optimise(world, scenario, Touch(0.8, 1.5, 2), Touch.bounce(1.1, 0))
    slide, bounce = found.sequence
    assert found.cost == pytest.approx(vertical + flight.cost, rel=0.01)
    assert (slide.start, slide.end) == pytest.approx((land, leave), abs=0.03)
    assert bounce.start == pytest.approx(meets, abs=0.01)
    motion = found.trajectory
    held = motion.forces[:, 2] > 0
    np.testing.assert_allclose(motion.forces[held, 2], 3.0, rtol=1e-5)
    assert np.all(np.diff(motion.positions[:-1, 0][held]) != 0)
    assert not motion.forces[:, [0, 1, 3]].any()
    # The wall does not lift it, nor does the floor push it on.
    (k,) = np.flatnonzero(motion.impulses[:, 0])
    assert motion.velocities[k, 1] == pytest.approx(0, abs=1e-6)
    assert found.replay().cost == pytest.approx(found.cost, rel=1e-6)


@pytest.mark.parametrize(
    ("touches", "phases", "held"),
    [
        ((Touch(0.2, 0.6, 0), Touch(0.4, 0.8, 2)), 5, (2, 2)),
        ((Touch(0.2, 0.6, 0), Touch(0.2, 0.6, 2)), 3, (1, 1)),
        ((Touch(0.2, 0.6, 0), Touch.bounce(0.6, 2)), 3, (1, 0)),
        ((Touch.bounce(0.2, 0), Touch(0.2, 0.6, 2), Touch.bounce(0.4, 0)), 4, (0, 2)),
    ],
)
def test_touches_overlap_start_and_end_together(
    touches: TouchSequence, phases: int, held: tuple[int, int]
) -> None:
    made = make_phases(touches)
    line = made.timeline
    assert len(line.phases) == phases == len(joint_times(touches)) + 1
    for contact, count in zip((0, 2), held, strict=True):
        assert sum(contact in phase.rests for phase in line.phases) == count
    # What they are is read off again, and a guess is at the walls at all joints.
    guess = made.guess()
    again = PhaseMotion(made, guess).sequence
    assert [touch.contact for touch in again] == [touch.contact for touch in touches]
    for one, other in zip(again, touches, strict=True):
        assert one.joints == pytest.approx(other.joints, abs=1e-12)
        for time in one.joints:
            k = int(np.argmin(np.abs(guess.times - time)))
            distance = made.world.calc_signed_distance(guess.positions[k])[one.contact]
            assert distance == pytest.approx(0, abs=1e-15)


def make_phases(touches: TouchSequence) -> PhaseProblem:
    scenario = make_scenario(
        [0.4, 0.4], [-1.0, -1.0], [0.3, 0.5], model=MODELS.format("room"), time_step=0.025
    )
    return PhaseProblem(load("room"), scenario, touches)


def test_joint_times_are_in_order_and_once_each() -> None:
    assert joint_times(()) == ()
    touches = Touch(0.2, 0.6, 0), Touch.bounce(0.3, 1), Touch.bounce(0.6, 2), Touch(0.6, 0.8, 3)
    assert joint_times(touches) == (0.2, 0.3, 0.6, 0.8)


@pytest.mark.parametrize(
    ("touches", "message"),
    [
        ((Touch.bounce(0.5, 4),), "got a touch of contact 4, expected 0 … 3, for the world has 4."),
        (
            (Touch.bounce(0.6, 0), Touch.bounce(0.4, 2)),
            "got touches that start at [0.6, 0.4] s, expected the order of time.",
        ),
        (
            (Touch(0.2, 0.6, 0), Touch.bounce(0.4, 2), Touch.bounce(0.5, 0)),
            "got contacts at [0.2, 0.6, 0.5] s (ball against left_wall), expected increasing times "
            "between 0 and 1 s.",
        ),
        (
            (Touch.bounce(0.5, 0), Touch.bounce(0.5, 1)),
            "got 2 contacts at once that can't all be distinguished, expected contacts with "
            "independent Jacobians. Leave out those that the others imply.",
        ),
    ],
)
def test_sequences_that_can_not_be_are_refused(touches: TouchSequence, message: str) -> None:
    with pytest.raises(OptionsError) as error:
        make_phases(touches)
    assert str(error.value) == f"sequence: {message}"


def two_bounces(e: tuple[float, float]) -> Trajectory:
    """Returns a motion in the corridor that meets the right wall, then the left one."""
    times = np.array([0.0, 0.2, 0.4, 0.4 + 1 / (3 * e[1]), 0.5 + 1 / (3 * e[1])])
    speeds = np.array([3.0, 3.0, 3.0, -3.0 * e[1], 3.0 * e[0] * e[1]])
    positions = np.array([-0.2, 0.4, 1.0, 0.0, 0.3 * e[0] * e[1]])
    impulses = np.zeros((5, 2))
    impulses[2, 1], impulses[3, 0] = 3.0 * (1 + e[1]), 3.0 * e[1] * (1 + e[0])
    return Trajectory(
        times, positions[:, None], speeds[:, None], np.zeros((4, 1)), impulses, np.zeros((4, 2))
    )


def test_defects_are_those_of_each_contact() -> None:
    world, motion = load("corridor"), two_bounces((0.9, 0.5))
    exact = rigid_defects(world, (0.9, 0.5), motion)
    assert max(exact.values()) == pytest.approx(0, abs=1e-14)
    # The left wall returns another speed than it should; the right one does.
    off = rigid_defects(world, (0.8, 0.5), motion)
    assert off.pop("restitution") == pytest.approx(0.1 * 1.5)
    assert max(off.values()) == pytest.approx(0, abs=1e-14)


def test_impulses_of_the_wrong_wall_push_from_afar() -> None:
    world, motion = load("corridor"), two_bounces((1.0, 1.0))
    swapped = Trajectory(
        motion.times,
        motion.positions,
        motion.velocities,
        motion.controls,
        -motion.impulses[:, ::-1],
        motion.forces,
    )
    found = rigid_defects(world, 1.0, swapped)
    assert found["flight"] == pytest.approx(0, abs=1e-14)
    assert found["contact"] == pytest.approx(1.0)  # the width of the corridor
    assert found["restitution"] == pytest.approx(6.0)  # it pulls
    assert not math.isnan(sum(found.values()))
