"""Multi-phase problems of several contacts, which may be struck together, exactly."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from marks import slow
from phase_solutions import MET, Solved, least_rest, optimise
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder
from replay_worlds import make_scenario
from unfolded_flights import MODELS, Flight, are_apart, fold, image_of, scenario_of, touches_of

from benchmarks.optima import walls_optimum
from drake_aigto import Scenario, World
from drake_aigto.contact import JointImpact
from drake_aigto.dynamics import ConstantInertia
from drake_aigto.errors import OptionsError
from drake_aigto.planning import Arcs, PhaseMotion, PhaseProblem
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch, TouchSequence, joint_times, rigid_defects
from drake_aigto.world import models_directory

T = 1.5
place = st.floats(0.15, 0.85)


@cache
def load(model: str) -> World:
    q = {"corridor": [0.5], "floor": [0.5], "two_masses": [0.3, 0.6]}.get(model, [0.1, 0.1])
    zero, name = np.zeros(len(q)), MODELS.format(model)
    return World.from_scenario(
        Scenario(model=name, initial_position=q, initial_velocity=zero, goal_position=q)
    )


def fly(start: float, goal: float, bounces: int, push: float) -> Flight:
    """Returns a flight over so many walls; the push is what it lacks in speed [m/s]."""
    image = image_of(goal, bounces)
    return Flight(start, (image - start) / T - push, image, T)


def evenly(sequence: TouchSequence) -> TouchSequence:
    """Returns the same touches at even times: what is known of a sequence is its order."""
    times = np.linspace(0, T, len(sequence) + 2)[1:-1]
    pairs = zip(times, sequence, strict=True)
    return tuple(Touch.bounce(time, touch.contact) for time, touch in pairs)


def check_unfolds(found: Solved, axes: int) -> None:
    motion, scenario = found.trajectory, found.phases.scenario
    tau = np.diff(motion.times)[:, np.newaxis]
    side = np.ones(axes)
    q, v = scenario.initial_position.copy(), scenario.initial_velocity.copy()
    struck = np.max(motion.impulses.reshape(len(motion.times), axes, 2), axis=2) > 0
    for k, (step, u) in enumerate(zip(tau, motion.controls, strict=True)):
        side = np.where(struck[k], -side, side)
        q = q + step * v + step**2 / 2 * side * u
        v = v + step * side * u
        np.testing.assert_allclose(fold(q), motion.positions[k + 1], atol=1e-7)


def check_replays(found: Solved) -> None:
    """The exactly rigid walls do to its control what was planned."""
    replay = found.replay()
    assert replay.cost == pytest.approx(found.cost, rel=1e-6, abs=1e-12)
    assert replay.max_penetration < 1e-9
    assert replay.bounce_times == pytest.approx([t.start for t in found.sequence], abs=1e-7)
    assert sorted(replay.bounce_contacts) == sorted(touch.contact for touch in found.sequence)


@pytest.mark.parametrize("model", ["corridor", "floor", "room"])
@pytest.mark.parametrize("seed", [1, *slow(2)])
def test_the_known_optimum_is_polished_from_its_contacts(model: str, seed: int) -> None:
    # Listed sequences, with Newton's method for each: nothing of it is a knot or a phase.
    rng = np.random.default_rng(seed)
    size = load(model).num_positions
    scenario = make_scenario(
        rng.uniform(0.2, 0.8, size),
        rng.uniform(-2.5, 2.5, size),
        rng.uniform(0.2, 0.8, size),
        model=MODELS.format(model),
        time_step=0.0125,
        restitution=0.8,
    )
    known = walls_optimum(load(model), scenario, most_touches=3)
    sequence = [Touch(touch.start, touch.end, touch.contact) for touch in known.touches]
    found = optimise(load(model), scenario, *sequence)
    assert found.cost == pytest.approx(known.cost, rel=0.01)
    assert found.cost > known.cost * (1 - 1e-9)
    assert [t.start for t in found.sequence] == pytest.approx(
        [t.start for t in known.touches], abs=0.01
    )
    check_replays(found)


@settings(max_examples=5)
@given(
    q=st.tuples(place, place),
    goal=st.tuples(place, place),
    bounces=st.tuples(st.integers(-3, 3), st.integers(-3, 3)),
    push=st.tuples(st.floats(-0.8, 0.8), st.floats(-0.8, 0.8)),
)
def test_rooms_unfold_along_both_axes(
    q: tuple[float, float],
    goal: tuple[float, float],
    bounces: tuple[int, int],
    push: tuple[float, float],
) -> None:
    flights = [fly(*axis) for axis in zip(q, goal, bounces, push, strict=True)]
    sequence = touches_of(*flights)
    cost = sum(flight.cost for flight in flights)
    assume(len(sequence) == sum(map(abs, bounces)) and are_apart(sequence, T) and cost > 1e-8)
    # Their order does not say where on a wall they are: times near the right ones do.
    shifted = [Touch.bounce(touch.start - 0.02 * T, touch.contact) for touch in sequence]
    found = optimise(load("room"), scenario_of("room", *flights), *shifted)
    assert found.cost == pytest.approx(cost, rel=5e-3)
    check_unfolds(found, axes=2)
    check_replays(found)


@pytest.mark.parametrize("bounces", [-1, 1, 2])
def test_two_walls_at_once(bounces: int) -> None:
    flights = [fly(0.3, 0.6, bounces, push=0.4)] * 2
    corners = evenly(touches_of(flights[0]))
    sequence = [
        Touch.bounce(corner.start, corner.contact + shift) for corner in corners for shift in (0, 2)
    ]
    found = optimise(load("room"), scenario_of("room", *flights), *sequence)
    assert found.cost == pytest.approx(2 * flights[0].cost, rel=1e-3)
    assert len(found.phases.timeline.phases) == abs(bounces) + 1
    check_unfolds(found, axes=2)
    check_replays(found)


def test_into_a_corner_one_after_the_other_and_at_once_cost_the_same() -> None:
    flights = [fly(0.3, 0.6, -1, push=0.4)] * 2
    scenario = scenario_of("room", *flights)
    at_once, x_first, y_first = (
        optimise(load("room"), scenario, Touch.bounce(one, 0), Touch.bounce(other, 2)).cost
        if one <= other
        else optimise(load("room"), scenario, Touch.bounce(other, 2), Touch.bounce(one, 0)).cost
        for one, other in ((0.4, 0.4), (0.35, 0.45), (0.45, 0.35))
    )
    assert x_first == pytest.approx(at_once, rel=1e-3)
    assert y_first == pytest.approx(x_first, rel=1e-6)  # mirrored


@pytest.mark.parametrize(("bounces", "e"), [(1, 0.5), (2, 0.8), (3, 1.0), (3, 0.5)])
def test_a_ball_that_drops_and_bounces_by_itself_costs_nothing(bounces: int, e: float) -> None:
    g, drop = 9.81, 0.5
    time, speed = np.sqrt(2 * drop / g), np.sqrt(2 * drop * g)
    times = []
    for _ in range(bounces):
        times.append(float(time))
        speed *= e
        time += 2 * speed / g
    rise = 2 * speed / g * 0.4
    scenario = make_scenario(
        drop,
        0.0,
        speed * rise - g / 2 * rise**2,
        model=MODELS.format("floor"),
        duration=times[-1] + rise,
        time_step=(times[-1] + rise) / 40,
        restitution=e,
    )
    guess = [Touch.bounce(0.9 * time) for time in times]
    found = optimise(load("floor"), scenario, *guess)
    assert found.cost == pytest.approx(0.0, abs=1e-10)
    assert [touch.start for touch in found.sequence] == pytest.approx(times, rel=1e-4)
    check_replays(found)


@settings(max_examples=5)
@given(
    q=st.tuples(st.floats(0.1, 0.4), st.floats(0.5, 0.9)),
    v=st.tuples(st.floats(-2, 2), st.floats(-2, 2)),
    push=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
)
def test_two_masses_pass_through_each_other(
    q: tuple[float, float], v: tuple[float, float], push: tuple[float, float]
) -> None:
    # Equal masses swap velocities, as if they went on and swapped names; so do the controls.
    flights = [
        Flight(start, speed, start + speed * T + more, T)
        for start, speed, more in zip(q, v, push, strict=True)
    ]
    t = np.linspace(0, T, 3001)
    paths = [fold(flight.position(t)) for flight in flights]
    crossings = np.flatnonzero(np.diff(np.sign(paths[1] - paths[0])))
    met = [(float(t[k]), 1) for k in crossings]
    for path in paths:
        turns = np.flatnonzero(np.diff(np.sign(np.diff(path)))) + 1
        met += [(float(t[k]), 0 if path[k] < 0.5 else 2) for k in turns]
    bounces = sum(len(flight.bounces()) for flight in flights)
    sequence = tuple(Touch.bounce(*touch) for touch in sorted(met))
    ends = sorted(float(path[-1]) for path in paths)
    assume(len(met) == len(crossings) + bounces and len(met) <= 6 and are_apart(sequence, T, 0.03))
    assume(0.02 < ends[0] < ends[1] - 0.02 < 0.96)
    # The soft goal is left a little on the way to the image.
    goals = sorted(float(fold(np.array(flight.image))) for flight in flights)
    order = [float(fold(np.array(flight.image))) for flight in flights]
    assume((order[0] < order[1]) == (paths[0][-1] < paths[1][-1]))
    assume(0 < goals[0] < goals[1] < 1)
    scenario = make_scenario(
        q, v, goals, model=MODELS.format("two_masses"), duration=T, time_step=T / 50
    )
    found = optimise(load("two_masses"), scenario, *sequence)
    cost = sum(flight.cost for flight in flights)
    assert found.cost == pytest.approx(cost, rel=5e-3, abs=1e-9)
    check_replays(found)


def test_every_contact_has_its_own_restitution() -> None:
    world = load("corridor")
    left, right = world.contacts
    lossy = dataclasses.replace(world, contacts=(left, dataclasses.replace(right, restitution=0.5)))
    scenario = scenario_of("corridor", fly(0.4, 0.7, 2, push=0.5), e=0.9)
    found = optimise(lossy, scenario, Touch.bounce(0.4, 1), Touch.bounce(1.0, 0))
    speeds = []
    for touch in found.sequence:
        k = int(np.argmin(np.abs(found.trajectory.times - touch.start)))
        change = found.trajectory.impulses[k] @ [1.0, -1.0]
        before = found.trajectory.velocities[k, 0]
        speeds.append((before, before + change))
    (first, second) = speeds
    assert first[1] == pytest.approx(-0.5 * first[0])
    assert second[1] == pytest.approx(-0.9 * second[0])
    assert max(found.defects.values()) < MET


def test_phases_grow_linearly_in_number_of_rows() -> None:
    sequence = [Touch.bounce(t, i % 2) for i, t in enumerate(np.linspace(0, T, 8)[1:-1])]
    flight = fly(0.4, 0.7, -6, push=0.5)
    sizes = []
    for steps in (20, 40, 60):
        phases = PhaseProblem(
            load("corridor"), scenario_of("corridor", flight, steps=steps), sequence
        )
        nlp = Arcs(phases, range(steps)).nlp
        sizes.append((nlp.num_rows, len(nlp.blocks)))
    (few, _), (some, _), (many, _) = sizes
    assert many - some == some - few


GRAVITY = 9.81


@cache
def load_under(model: str, gravity: tuple[float, float, float] = (0.0, 0.0, -GRAVITY)) -> World:
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
    inertia = load_under("room").constant_inertia
    both = JointImpact.of(inertia, (0, 2), (1.0, 0.5))
    assert not both.coupled.any()
    first = JointImpact.of(inertia, (0,), (1.0,)).velocities
    second = JointImpact.of(inertia, (2,), (0.5,)).velocities
    np.testing.assert_allclose(both.velocities, first @ second, atol=1e-15)


def test_contacts_that_imply_each_other_are_refused() -> None:
    with pytest.raises(OptionsError) as error:
        JointImpact.of(load_under("corridor").constant_inertia, (0, 1), (1.0, 1.0))
    assert str(error.value) == (
        "sequence: got 2 contacts at once that can't all be distinguished, expected contacts with "
        "independent Jacobians. Leave out those that the others imply."
    )


def test_coupled_contacts_push_and_never_pull() -> None:
    # The left ball is hit by the right one as it meets its wall: mirrored, both turn around.
    scenario = make_scenario(
        [0.3, 0.6], [-0.6, -1.2], [0.3, 0.62], model=MODELS.format("two_masses"), time_step=0.025
    )
    world = load_under("two_masses")
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
    world = load_under("room", gravity=(0.0, -3.0, 0.0))
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
    return PhaseProblem(load_under("room"), scenario, touches)


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
    world, motion = load_under("corridor"), two_bounces((0.9, 0.5))
    exact = rigid_defects(world, (0.9, 0.5), motion)
    assert max(exact.values()) == pytest.approx(0, abs=1e-14)
    # The left wall returns another speed than it should; the right one does.
    off = rigid_defects(world, (0.8, 0.5), motion)
    assert off.pop("restitution") == pytest.approx(0.1 * 1.5)
    assert max(off.values()) == pytest.approx(0, abs=1e-14)


def test_impulses_of_the_wrong_wall_push_from_afar() -> None:
    world, motion = load_under("corridor"), two_bounces((1.0, 1.0))
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
