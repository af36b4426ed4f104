"""Arcs: the multi-phase problem in a few unknowns has the optimum of the one with every knot."""

from __future__ import annotations

import dataclasses
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from marks import slow
from phase_solutions import (
    MET,
    Solved,
    bouncing,
    check_clock,
    free_flight_cost,
    least_rest,
    one_bounce,
    optimise,
    solve,
    two_joints,
)
from replay_worlds import make_diagram, make_scenario, make_task, shipped, shipped_world
from rigid_worlds import Array
from unfolded_flights import MODELS, Flight

from drake_aigto import Scenario, World
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.local import InteriorPoint, LocalResult, LocalStatus, PolynomialNlp
from drake_aigto.planning import (
    ArcPrograms,
    Arcs,
    PhaseMotion,
    PhaseProblem,
    sample,
    solve_in_arcs,
    straight_path,
)
from drake_aigto.transcription import Facing, RigidTranscription, Touch, TouchSequence

# Contacts of the room, and of the block in it.
LEFT, FRONT_WALL = 0, 2
BLOCK_RIGHT, BLOCK_LEFT, BACK, FRONT = 4, 5, 6, 7


def solve_nlp(nlp: PolynomialNlp, x: Array) -> LocalResult:
    return InteriorPoint(max_iterations=200).solve(nlp, x)


def check_same(phases: PhaseProblem, cost_within: float = 1e-8) -> PhaseMotion:
    """Solves in long arcs, and compares with arcs between all knots."""
    motion = solve_in_arcs(phases, phases.guess(), solve_nlp)
    assert motion is not None
    found = PhaseMotion(phases, motion)
    assert max(found.defects.values()) < MET
    assert found.cost == pytest.approx(solve(phases).cost, rel=cost_within, abs=1e-9)
    return found


ROOM = make_task("room", [0.3, 0.7], [-1.5, -1.0], time_step=0.05)
MASSES = make_task("two_masses", [0.3, 0.7], [-1.0, -0.5], time_step=0.05)
TASKS: dict[str, tuple[World, Scenario, TouchSequence]] = {
    "flight": (shipped_world(), make_scenario(time_step=0.05), ()),
    "one step": (shipped_world(), make_scenario(time_step=1.0), ()),
    "bounce": (shipped_world(3.0), bouncing(0.8, 20), (Touch.bounce(0.4),)),
    "short phases": (shipped_world(), bouncing(0.8, 2), (Touch.bounce(0.4),)),
    "floor": (
        shipped("floor"),
        make_task("floor", 0.5, -1.0, time_step=0.05, restitution=0.7),
        (Touch.bounce(0.3),),
    ),
    "room": (shipped("room"), ROOM, (Touch.bounce(0.2, LEFT), Touch.bounce(0.6, FRONT_WALL))),
    "two masses": (shipped("two_masses"), MASSES, (Touch.bounce(0.3, 0), Touch.bounce(0.5, 1))),
    "askew": (
        World.from_diagram(make_diagram(num_joints=2, gravity=3.0)),
        two_joints(0.5),
        (Touch.bounce(0.4), Touch.bounce(1.2)),
    ),
    "lasts": (
        World.from_diagram(make_diagram(num_joints=2, gravity=3.0)),
        two_joints(0.0),
        (Touch(0.5, 1.4),),
    ),
}


@pytest.mark.parametrize(
    "name", sorted(TASKS.keys() - {"two masses"})
)  # Which costs next to nothing.
def test_it_does_not_matter_where_arcs_are_cut(name: str) -> None:
    phases = PhaseProblem(*TASKS[name])
    rng = np.random.default_rng(3)
    costs = [check_same(phases).cost]
    for count in {min(count, phases.num_steps) for count in (0, 2, 7)}:
        cuts = rng.choice(np.arange(1, phases.num_steps + 1), count, replace=False).tolist()
        arcs = Arcs(phases, cuts)
        result = solve_nlp(arcs.nlp, arcs.vector(phases.guess()))
        assert result.is_success
        costs.append(result.cost)
    np.testing.assert_allclose(costs, costs[0], rtol=1e-8)


@pytest.mark.parametrize("name", ["bounce", "room", "askew", "two masses"])
def test_one_program_serves_walls_elsewhere_that_return_something_else(name: str) -> None:
    world, scenario, sequence = TASKS[name]
    programs = ArcPrograms()
    first = Arcs(PhaseProblem(world, scenario, sequence), (), programs).nlp
    moved = world.with_walls_nearer(np.linspace(0.02, -0.03, world.num_contacts))
    phases = PhaseProblem(moved, dataclasses.replace(scenario, restitution=0.6), sequence)
    arcs = Arcs(phases, (), programs)
    assert arcs.nlp.terms is first.terms
    found = solve_nlp(arcs.nlp, arcs.vector(phases.guess()))
    assert found.cost == pytest.approx(check_same(phases).cost, rel=1e-9)


def test_arcs_keep_out_of_walls_between_their_ends() -> None:
    scenario = make_scenario(0.3, -3.0, time_step=0.02)
    phases = PhaseProblem(shipped_world(), scenario)
    arcs = Arcs(phases)
    through = arcs.trajectory(solve_nlp(arcs.nlp, arcs.vector(phases.guess())).x)
    assert np.min(through.positions) < -0.05
    found = check_same(phases, 1e-6)
    assert np.min(found.trajectory.positions) > -1e-11


@pytest.mark.parametrize("side", [BACK, FRONT])
def test_arcs_pass_a_block_on_the_side_that_was_asked_for(side: int) -> None:
    scenario = make_task("room_with_block", [0.1, 0.5], [0.0, 0.0], time_step=0.05)
    scenario = dataclasses.replace(scenario, goal_position=[0.9, 0.5])
    facings = [Facing(0.0, BLOCK_LEFT), Facing(0.3, side), Facing(0.7, BLOCK_RIGHT)]
    phases = PhaseProblem(shipped("room_with_block"), scenario, (), facings)
    x, y = check_same(phases, 1e-6).trajectory.positions.T
    beside = y[(x > 0.4) & (x < 0.6)]
    assert beside.size > 2
    assert np.all(beside > 0.6 - MET if side == BACK else beside < 0.4 + MET)


def test_a_motion_through_arcs_and_back_is_the_same() -> None:
    phases = PhaseProblem(*TASKS["lasts"])
    arcs = Arcs(phases, [3, 4, 11])
    motion = arcs.trajectory(solve_nlp(arcs.nlp, arcs.vector(phases.guess())).x)
    again = arcs.trajectory(arcs.vector(motion))
    for name in ("times", "positions", "velocities", "controls", "forces"):
        np.testing.assert_allclose(getattr(again, name), getattr(motion, name), atol=1e-9)


def test_springs_and_dampers_have_an_arc_for_each_step() -> None:
    world = World.from_diagram(make_diagram(spring=30.0))
    phases = PhaseProblem(world, make_scenario(time_step=0.05))
    assert not phases.has_long_arcs
    assert Arcs(phases).trajectory(Arcs(phases).vector(phases.guess())).times.size == 21


def test_no_arcs_where_the_solver_fails_or_walls_would_pull() -> None:
    phases = PhaseProblem(*TASKS["lasts"])

    def stop_early(nlp: PolynomialNlp, x: Array) -> LocalResult:
        return InteriorPoint(max_iterations=1).solve(nlp, x)

    assert solve_in_arcs(phases, phases.guess(), stop_early) is None
    arcs = Arcs(phases)
    result = solve_nlp(arcs.nlp, arcs.vector(phases.guess()))
    assert not arcs.would_pull(result)
    # Were the cost tiny, what is left of the barrier would count.
    result = InteriorPoint(tolerance=1e-2).solve(arcs.nlp, arcs.vector(phases.guess()))
    assert arcs.would_pull(result)


def test_walls_that_leave_no_place_are_refused() -> None:
    scenario = make_task("room_with_block", [0.7, 0.7], [0.0, 0.0], time_step=0.05)
    facings = [Facing(0.0, BLOCK_RIGHT)]
    phases = PhaseProblem(shipped("room_with_block"), scenario, (Touch.bounce(0.5, LEFT),), facings)
    with pytest.raises(UnsupportedTermError) as error:
        solve_in_arcs(phases, phases.guess(), solve_nlp)
    assert "leave it no value: got [0.6, 0], expected lower ≤ upper." in str(error.value)


@cache
def room() -> World:
    return World.from_scenario(make_block_task([0.1, 0.1], [0, 0], [0.9, 0.9]))


def make_block_task(q: Any, v: Any, goal: Any, steps: int = 40) -> Scenario:
    return make_scenario(q, v, goal, model=MODELS.format("room_with_block"), time_step=1 / steps)


def clearances(found: Solved) -> Array:
    """Returns them between knots, too: positions are parabolas there."""
    state, _ = found.trajectory.to_piecewise()
    times = np.linspace(0, 1, 801)
    return np.array([room().calc_clearance(state.value(t)[:2, 0])[-1] for t in times])


def test_a_flight_goes_around_the_block_as_close_as_it_may() -> None:
    scenario = make_block_task([0.1, 0.5], [1.0, 0.0], [0.9, 0.52])
    found = optimise(room(), scenario)
    facings = found.facings
    assert [facing.contact for facing in facings] == [BLOCK_LEFT, BACK, BLOCK_RIGHT]
    # The turns are free, so that nothing keeps it from passing the corners closely.
    motion = found.trajectory
    knots = np.searchsorted(motion.times, [facing.start - 1e-12 for facing in facings[1:]])
    nearest = np.linalg.norm(motion.positions[knots] - [[0.4, 0.6], [0.6, 0.6]], axis=1)
    assert np.min(nearest) < 1e-6
    assert np.min(clearances(found)) > -1e-6
    assert np.min(clearances(found)) < 1e-3
    # Around the other side it is farther, for the goal is higher.
    other = optimise(
        room(),
        scenario,
        facings=[Facing(0.0, BLOCK_LEFT), Facing(0.35, FRONT), Facing(0.65, BLOCK_RIGHT)],
    )
    assert other.cost > 1.05 * found.cost
    assert np.min(clearances(other)) > -1e-6


def test_a_bounce_off_the_block_unfolds() -> None:
    # Mirrored at x = 0.4; along y nothing is in the way.
    flights = Flight(0.1, 0.5, 0.8 - 0.2, 1.0), Flight(0.3, 0.4, 0.6, 1.0)
    scenario = make_block_task([0.1, 0.3], [0.5, 0.4], [0.2, 0.6])
    found = optimise(room(), scenario, Touch.bounce(0.5, BLOCK_LEFT))
    assert found.cost == pytest.approx(sum(flight.cost for flight in flights), rel=2e-3)
    (touch,) = found.sequence
    assert touch.contact == BLOCK_LEFT
    assert np.min(clearances(found)) > -1e-9
    replay = found.replay()
    assert replay.cost == pytest.approx(found.cost, rel=1e-6)
    assert replay.bounce_contacts == (BLOCK_LEFT,)


def test_a_face_is_touched_within_its_edges() -> None:
    # By itself it would pass the face's height at y = 0.65, above the corner.
    scenario = make_block_task([0.1, 0.65], [0.8, 0.0], [0.1, 0.65])
    found = optimise(room(), scenario, Touch.bounce(0.4, BLOCK_LEFT))
    (touch,) = found.sequence
    k = int(np.argmin(np.abs(found.trajectory.times - touch.start)))
    np.testing.assert_allclose(found.trajectory.positions[k], [0.4, 0.6], atol=1e-6)


@pytest.mark.parametrize(
    ("facings", "message"),
    [
        ([], "got faces of one box from [] s on, expected the first from 0 s, and increasing"),
        ([Facing(0.2, BLOCK_LEFT)], "got faces of one box from [0.2] s on"),
        ([Facing(0.0, BLOCK_LEFT), Facing(1.0, BACK)], "got faces of one box from [0.0, 1.0] s on"),
        ([Facing(0.0, 0)], "got contacts [0], expected those of [4, 5, 6, 7], the faces of boxes"),
        ([Facing(0.0, 8)], "got contacts [8], expected those of [4, 5, 6, 7], the faces of boxes"),
        (
            [Facing(0.0, BACK)],
            "got another face than ball against block, -x face, which is touched, expected that "
            "one at 0.5 s",
        ),
    ],
)
def test_faces_that_leave_out_the_box_are_refused(facings: list[Facing], message: str) -> None:
    scenario = make_block_task([0.1, 0.1], [0, 0], [0.2, 0.2])
    with pytest.raises(OptionsError) as error:
        PhaseProblem(room(), scenario, [Touch.bounce(0.5, BLOCK_LEFT)], facings)
    assert str(error.value).startswith(f"facings: {message}")


@pytest.mark.parametrize("N", [1, 50])
@pytest.mark.parametrize(
    ("mass", "gravity"), [(1.0, 0.0), (3.0, 0.0), (1.5, 2.0)], ids=["unit", "heavy", "falling"]
)
def test_a_free_flight_is_the_linear_quadratic_optimum(mass: float, gravity: float, N: int) -> None:
    scenario = make_scenario(1.2, 0.4, duration=1.5, time_step=1.5 / N, goal_weight=0.2)
    world = World.from_diagram(make_diagram(gravity=gravity)) if gravity else shipped_world(mass)
    flight = optimise(world, scenario)
    assert flight.cost == pytest.approx(free_flight_cost(scenario, mass, mass * gravity), rel=1e-9)
    assert flight.replay().cost == pytest.approx(flight.cost, rel=1e-9)


@pytest.mark.parametrize("e", [1.0, 0.5, 0.0])
def test_a_bounce_is_the_continuous_optimum_up_to_the_held_controls(e: float) -> None:
    exact, time, speed = one_bounce(1.0, -2.0, 0.73, e)
    errors = []
    for N in (10, 20, 40):
        bounce = optimise(shipped_world(), bouncing(e, N), Touch.bounce(0.4))
        errors.append(bounce.cost / exact - 1)
        (touch,) = bounce.sequence
        assert touch.start == pytest.approx(time, abs=0.2 / N**2)
        assert bounce.replay().bounce_times == pytest.approx([touch.start], abs=1e-9)
        assert np.max(bounce.trajectory.impulses) == pytest.approx((1 + e) * speed, rel=1 / N**2)
    assert 0 < errors[-1] < 1e-3
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4.0, rtol=0.15)


@settings(max_examples=10)
@given(q=st.floats(0.2, 1.5), v=st.floats(-3, -0.5), goal=st.floats(0.2, 1.5), e=st.floats(0.3, 1))
def test_bounces_hold_and_cost_what_they_should(q: float, v: float, goal: float, e: float) -> None:
    exact, time, speed = one_bounce(q, v, goal, e)
    # Else the best bounce is one that touches lightly, or at once, or at the end.
    assume(0.05 < time < 0.95 and speed > 0.1)
    scenario = bouncing(e, 40, q, v, goal)
    bounce = optimise(shipped_world(), scenario, Touch.bounce(min(0.9, -q / v)))
    assert bounce.cost == pytest.approx(exact, rel=5e-3, abs=1e-12)
    replay = bounce.replay()
    assert replay.cost == pytest.approx(bounce.cost, rel=1e-9, abs=1e-14)
    assert replay.max_penetration < 1e-12
    assert len(replay.bounce_times) == 1


@pytest.fixture(scope="module")
def floor() -> World:
    """1.5 kg over a floor, under 3 m/s²."""
    return World.from_diagram(make_diagram(gravity=3.0))


def resting(e: float, N: int) -> Scenario:
    """To stay up costs too much for 2 s: better to wait on the floor, and jump in time."""
    return make_scenario(
        0.3, 0.0, 0.3, duration=2.0, time_step=2.0 / N, goal_weight=100.0, restitution=e
    )


@pytest.mark.parametrize("e", [0.0, 0.3, 1.0])
def test_a_contact_that_lasts_carries_the_weight_and_is_optimal(floor: World, e: float) -> None:
    errors = []
    for N in (20, 40):
        scenario = resting(e, N)
        cost, land, leave = least_rest(0.3, 2.0, e, mass=1.5, gravity=3.0, goal_weight=100.0)
        rest = optimise(floor, scenario, Touch(0.6, 1.4))
        errors.append(rest.cost / cost - 1)
        (touch,) = rest.sequence
        assert touch.joints == pytest.approx((land, leave), abs=1 / N)
        motion, forces = rest.trajectory, rest.trajectory.forces[:, 0]
        lasts = (motion.times[:-1] >= touch.start - 1e-9) & (motion.times[:-1] < touch.end - 1e-9)
        np.testing.assert_allclose(forces[lasts], 1.5 * 3.0, rtol=1e-5)
        np.testing.assert_array_equal(forces[~lasts], 0.0)
        np.testing.assert_allclose(motion.positions[:-1][lasts], 0.0, atol=MET)
        np.testing.assert_allclose(motion.controls[lasts], 0.0, atol=1e-4)
        speed = math.sqrt(2 * 3.0 * 0.3) if e < 1 else 0.0
        assert np.max(motion.impulses) == pytest.approx(1.5 * speed, abs=1e-6)
        replay = rest.replay()
        assert replay.cost == pytest.approx(rest.cost, rel=1e-8)
        assert replay.max_penetration < 1e-9
    assert 0 < errors[1] < errors[0] < 0.02
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.3)


def test_a_spring_presses_to_the_wall_by_its_force_there() -> None:
    pressed = World.from_diagram(make_diagram(spring=30.0, reference=-0.5))
    errors = []
    for N in (20, 40, 80):
        rest = optimise(pressed, resting(0.0, N), Touch(0.4, 1.5))
        motion = rest.trajectory
        loads = motion.forces[motion.forces > 0]
        np.testing.assert_allclose(loads, 30.0 * 0.5, rtol=1e-5)
        assert len(loads) > N / 4
        errors.append(abs(rest.replay().cost / rest.cost - 1))
    # The midpoint rule is of second order.
    assert errors[0] / errors[2] == pytest.approx(16.0, rel=0.6)


@pytest.mark.slow
def test_a_flight_on_a_spring_replays_to_second_order() -> None:
    sprung = World.from_diagram(make_diagram(spring=30.0, reference=0.5))
    errors = []
    for N in (40, 80, 160):
        scenario = make_scenario(1.0, -6.0, time_step=1 / N, restitution=0.8)
        bounce = optimise(sprung, scenario, Touch.bounce(0.3))
        replay = bounce.replay()
        assert len(replay.bounce_times) == 1
        (touch,) = bounce.sequence
        errors.append([replay.cost - bounce.cost, replay.bounce_times[0] - touch.start])
    rates = np.divide(errors[:-1], errors[1:])
    np.testing.assert_allclose(rates, 4.0, rtol=0.2)


TWO_JOINTS: list[tuple[float, TouchSequence]] = [
    *(
        (e, touches)
        for e in (1.0, 0.5)
        for touches in (
            (),
            (Touch.bounce(0.5),),
            (Touch.bounce(0.4), Touch.bounce(1.2)),
            (Touch(0.5, 1.4),),
        )
    ),
    (0.5, (Touch.bounce(0.4), Touch(0.9, 1.4))),
]


@pytest.mark.parametrize(("e", "touches"), TWO_JOINTS)
def test_two_joints_replay_as_planned(e: float, touches: TouchSequence) -> None:
    world = World.from_diagram(make_diagram(num_joints=2, gravity=3.0))
    found = optimise(world, two_joints(e), *touches)
    replay = found.replay()
    assert replay.cost == pytest.approx(found.cost, rel=1e-7)
    motion = found.trajectory
    ends = np.searchsorted(replay.times, motion.times, side="right") - 1
    lasting = [touch for touch in found.sequence if touch.lasts]
    # Where it hops before it rests, the phases only know how long that takes.
    hops = [each for each in lasting if 0 < e < 1]
    known = np.ones(motion.times.size, dtype=bool)
    for each in hops:
        known &= (motion.times <= each.start) | (motion.times >= each.end)
    np.testing.assert_allclose(replay.positions[ends][known], motion.positions[known], atol=1e-6)
    assert np.any(motion.forces > 1.0) == bool(lasting)
    # It slides while it rests.
    for touch in lasting:
        held = motion.forces[:, 0] > 0
        assert np.ptp(motion.positions[:-1][held], axis=0).min() > 0.01
        np.testing.assert_allclose(found.distances[:-1][held], 0, atol=MET)
        assert touch.start < motion.times[:-1][held][1] < touch.end


def test_a_guess_goes_straight_from_stop_to_stop() -> None:
    world = World.from_diagram(make_diagram(num_joints=2))
    scenario = make_scenario([0.3, 0.6], [-0.4, -1.0], time_step=0.05)
    phases = PhaseProblem(world, scenario, (Touch.bounce(0.2), Touch(0.5, 0.9)))
    stops = np.array([[0.3, 0.6], [0.1, -0.1], [-0.5, 0.4], [0.2, -0.2], [0.73, 0.73]])
    guess = phases.guess(stops[1:-1])
    _, stops = straight_path(world, scenario, phases.sequence, stops[1:-1])
    on_wall = [world.calc_signed_distance(stop)[0] for stop in stops[1:-1]]
    np.testing.assert_allclose(on_wall, 0.0, atol=1e-15)
    for time, stop in zip([0.0, 0.2, 0.5, 0.9, 1.0], stops, strict=True):
        (k,) = np.flatnonzero(np.isclose(guess.times, time))
        np.testing.assert_allclose(guess.positions[k], stop, atol=1e-15)
    np.testing.assert_array_equal(guess.velocities[0], [-0.4, -1.0])
    # Up to the jump, which takes control.
    tau = np.diff(guess.times)[:-4, np.newaxis]
    np.testing.assert_allclose(np.diff(guess.positions, axis=0)[:-4], tau * guess.velocities[1:-4])
    np.testing.assert_array_equal(guess.controls[:-4], np.zeros((16, 2)))


@pytest.mark.parametrize("sequence", [(), (Touch.bounce(0.4),)], ids=["flight", "bounce"])
def test_nothing_pulls_the_end_through_the_wall(sequence: TouchSequence) -> None:
    boxes = RigidTranscription(shipped_world(), bouncing(0.8, 20))
    boxes.AddFinalCost(100.0 * (boxes.state()[0] + 1.0) ** 2, "behind the wall")
    added = boxes.additions()
    found = solve(PhaseProblem(shipped_world(), boxes.scenario, sequence, additions=added))
    assert found.status is LocalStatus.CONVERGED
    assert found.trajectory.positions[-1, 0] == pytest.approx(0.0, abs=1e-6)
    assert np.min(found.trajectory.positions) >= 0.0


@pytest.mark.parametrize("sequence", [(), (Touch.bounce(0.5),)], ids=["flight", "bounce"])
def test_what_was_added_to_boxes_holds_in_phases(sequence: TouchSequence) -> None:
    world, scenario = shipped_world(), bouncing(0.8, 40)
    boxes = RigidTranscription(world, scenario)
    (u,), (q, v) = boxes.input(), boxes.state()
    boxes.AddRunningCost(0.3 * (q - 0.9) ** 2, "stay")
    boxes.AddFinalCost(2.0 * (v - 2.0) ** 2, "rush")
    boxes.AddConstraintToAllKnotPoints(u <= 4.0)
    boxes.AddConstraintToAllKnotPoints(np.array([u >= -3.0, v <= 1.25]))
    phases = PhaseProblem(world, scenario, sequence, additions=boxes.additions())
    found = solve(phases)
    assert found.status is LocalStatus.CONVERGED
    motion = found.trajectory
    positions, velocities, controls = motion.positions, motion.velocities, motion.controls
    assert np.max(controls) <= 4.0 + MET
    assert np.min(controls) >= -3.0 - MET
    assert np.max(velocities) <= 1.25 + MET
    assert velocities[-1, 0] == pytest.approx(1.25)  # in vain: it would rather end at 2 m/s
    costs, tau = boxes.additions().costs(sample(motion)), np.diff(motion.times)
    assert costs["stay"] == pytest.approx(0.3 * tau @ (positions[:-1, 0] - 0.9) ** 2)
    assert costs["rush"] == pytest.approx(2.0 * 0.75**2)
    # The program's own cost counts all of it.
    arcs = Arcs(phases)
    nlp = arcs.nlp
    whole, _ = nlp.evaluate(np.clip(arcs.vector(motion), nlp.lower, nlp.upper))
    assert whole == pytest.approx(found.cost + sum(costs.values()))


@pytest.mark.parametrize("e", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("guess", [1e-4, 0.01])
def test_a_bounce_right_after_the_start(e: float, guess: float) -> None:
    exact, time, _ = one_bounce(1e-3, -2.0, 0.73, e)
    assert time < 1e-3
    bounce = optimise(shipped_world(), bouncing(e, 50, q=1e-3), Touch.bounce(guess))
    assert bounce.cost == pytest.approx(exact, rel=1e-3)
    (touch,) = bounce.sequence
    assert touch.start == pytest.approx(time, rel=1e-3)
    assert bounce.replay().cost == pytest.approx(bounce.cost, rel=1e-9)


@pytest.mark.parametrize("e", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("guess", [0.9, 0.999])
def test_a_bounce_right_before_the_end(e: float, guess: float) -> None:
    # Control is so dear that it comes to the wall nearly by itself, too late to turn back.
    scenario = dataclasses.replace(bouncing(e, 50, v=-1.001), control_weight=1e3)
    bounce = optimise(shipped_world(), scenario, Touch.bounce(guess))
    (touch,) = bounce.sequence
    assert 0.998 < touch.start < 1.0
    assert bounce.cost == pytest.approx(0.73**2, rel=5e-3)
    assert bounce.replay().cost == pytest.approx(bounce.cost, rel=1e-7)


@pytest.mark.parametrize("e", [1.0, *slow(0.8), 0.0])
@pytest.mark.parametrize(
    "touches",
    [
        (Touch.bounce(0.5), Touch.bounce(0.52)),
        (Touch(0.4, 0.6),),
        (Touch(0.4, 0.6), Touch.bounce(0.8)),
        (Touch.bounce(0.2), Touch.bounce(0.4), Touch.bounce(0.6)),
    ],
    ids=["two close", "lasts", "lasts, bounce", "three"],
)
def test_touches_that_had_better_merge_stay_apart_and_feasible(
    touches: TouchSequence, e: float
) -> None:
    scenario = bouncing(e, 50)
    found = solve(PhaseProblem(shipped_world(), scenario, touches))
    check_clock(found)
    assert max(found.defects.values()) < 1e-8
    assert len(found.sequence) == len(touches)
    # One bounce is better, and a plan that is feasible is not better than it promises.
    assert found.cost > one_bounce(1.0, -2.0, 0.73, e)[0]
    assert found.replay().cost == pytest.approx(found.cost, rel=1e-4)


def test_each_phase_gets_a_step_though_it_is_short() -> None:
    scenario = make_scenario(time_step=0.2)
    touches = Touch.bounce(1e-9), Touch(0.5, 0.5 + 1e-9), Touch.bounce(1 - 1e-9)
    with pytest.raises(OptionsError) as error:
        PhaseProblem(shipped_world(), scenario, (*touches[:2], Touch.bounce(0.7), touches[2]))
    assert str(error.value) == (
        "sequence: got 6 phases, expected at most the 5 steps of the scenario."
    )
    phases = PhaseProblem(shipped_world(), scenario, touches)
    guess = phases.guess(np.zeros((4, 1)))
    np.testing.assert_allclose(guess.times, [0, 1e-9, 0.5, 0.5 + 1e-9, 1 - 1e-9, 1])


@pytest.mark.parametrize(
    ("touches", "times"),
    [
        ((Touch.bounce(0.0),), "[0.0]"),
        ((Touch.bounce(1.0),), "[1.0]"),
        ((Touch.bounce(1.5),), "[1.5]"),
        ((Touch.bounce(-0.5),), "[-0.5]"),
        ((Touch(0.5, 1.0),), "[0.5, 1.0]"),
        ((Touch.bounce(0.6), Touch.bounce(0.4)), "[0.6, 0.4]"),
        ((Touch.bounce(0.6), Touch.bounce(0.6)), "[0.6, 0.6]"),
        ((Touch(0.2, 0.6), Touch.bounce(0.5)), "[0.2, 0.6, 0.5]"),
    ],
)
def test_times_out_of_order_or_outside_are_refused(touches: TouchSequence, times: str) -> None:
    with pytest.raises(OptionsError) as error:
        PhaseProblem(shipped_world(), make_scenario(), touches)
    assert str(error.value) == (
        f"sequence: got contacts at {times} s, expected increasing times between 0 and 1 s."
    )
