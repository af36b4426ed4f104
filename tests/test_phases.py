"""The multi-phase problem of a contact sequence: closed forms, replays, and what users add."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from marks import slow
from phase_solutions import (
    MET,
    bouncing,
    check_clock,
    free_flight_cost,
    least_rest,
    one_bounce,
    optimise,
    solve,
    two_joints,
)
from replay_worlds import make_diagram, make_scenario, shipped_world

from drake_aigto import Scenario, World
from drake_aigto.errors import OptionsError
from drake_aigto.local import LocalStatus
from drake_aigto.planning import Arcs, PhaseProblem, sample, straight_path
from drake_aigto.transcription import RigidTranscription, Touch, TouchSequence


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
