"""Feedback between bounces: gains, flights beyond their ends, bounces that come early or late."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from phase_solutions import optimise
from replay_worlds import make_diagram, make_scenario, shipped_world
from scipy.integrate import solve_ivp
from several_walls import make_task, shipped

from drake_aigto import Scenario, TrajectoryError, World
from drake_aigto.control import FlightFeedback, track_drake, track_event_driven
from drake_aigto.paper import rigid_optimum
from drake_aigto.simulation import Controller, Held, HeldControl, replay_drake, replay_event_driven
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch

# Of costs: the control after a bounce comes up to 4e-7 of the duration late.
REPRODUCED = 1e-5
# Of gains, relative to the largest, through Drake's integration and interpolation.
GAIN = 5e-6
# A row of Table I, and a wall that returns less.
BOUNCES = [(1, 1.0), (2, 0.8), (4, 0.5)]


@cache
def make_bounce(row: int, e: float) -> tuple[Scenario, Trajectory]:
    """Returns a row of Table I, and its best bounce."""
    scenario = dataclasses.replace(Scenario.named(f"table1/{row}"), restitution=e)
    (time,) = rigid_optimum(shipped_world(), scenario).bounce_times
    return scenario, optimise(shipped_world(), scenario, Touch.bounce(time)).trajectory


@cache
def make_controller(row: int, e: float) -> FlightFeedback:
    return FlightFeedback(shipped_world(), *make_bounce(row, e))


@cache
def make_flight() -> tuple[Scenario, Trajectory]:
    """Returns a row of Table I, and the plan that brakes and turns."""
    scenario = Scenario.named("table1/1")
    return scenario, optimise(shipped_world(), scenario).trajectory


def moved(scenario: Scenario, position: float = 0.0, velocity: float = 0.0) -> Scenario:
    return dataclasses.replace(
        scenario,
        initial_position=scenario.initial_position + position,
        initial_velocity=scenario.initial_velocity + velocity,
    )


def end_of(scenario: Scenario, controller: FlightFeedback) -> Any:
    replay = track_event_driven(shipped_world(), scenario, controller).replay
    return np.array([replay.positions[-1, 0], replay.velocities[-1, 0]])


# Without a perturbation.


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_an_unperturbed_plan_is_reproduced(row: int, e: float) -> None:
    (scenario, plan), controller = make_bounce(row, e), make_controller(row, e)
    open_loop = replay_event_driven(shipped_world(), scenario, plan.times, plan.controls)
    tracked = track_event_driven(shipped_world(), scenario, controller)
    assert tracked.replay.cost == pytest.approx(open_loop.cost, rel=REPRODUCED)
    assert tracked.replay.bounce_times == pytest.approx(open_loop.bounce_times, abs=1e-10)
    # Drake's walls are late by 0.1 ms, with feedback as without.
    open_loop = replay_drake(shipped_world(), scenario, plan.times, plan.controls)
    compliant = track_drake(shipped_world(), scenario, controller)
    assert compliant.replay.cost == pytest.approx(open_loop.cost, rel=5e-3)
    assert compliant.replay.bounce_times == pytest.approx(open_loop.bounce_times, abs=1e-6)


def test_a_plan_between_walls_is_reproduced() -> None:
    world, scenario = shipped("corridor"), Scenario.named("corridor/lossy")
    touches = [Touch.bounce(t, c) for t, c in [(0.17, 1), (0.63, 0), (1.31, 1)]]
    plan = optimise(world, scenario, *touches).trajectory
    controller = FlightFeedback(world, scenario, plan)
    assert [bounce.contact for bounce in controller.bounces] == [1, 0, 1]
    tracked = track_event_driven(world, scenario, controller)
    assert tracked.replay.bounce_contacts == (1, 0, 1)
    open_loop = replay_event_driven(world, scenario, plan.times, plan.controls)
    assert tracked.replay.cost == pytest.approx(open_loop.cost, rel=REPRODUCED)
    start = dataclasses.replace(scenario, initial_velocity=1.01 * scenario.initial_velocity)
    open_loop = replay_event_driven(world, start, plan.times, plan.controls)
    tracked = track_event_driven(world, start, controller)
    assert tracked.replay.bounce_contacts == (1, 0, 1)
    assert tracked.replay.goal_error < 0.2 * open_loop.goal_error


def test_a_plan_on_a_spring_is_reproduced() -> None:
    world = World.from_diagram(make_diagram(spring=30.0, reference=0.4))
    scenario = make_scenario(0.6, -1.5, restitution=0.8)
    plan = optimise(world, scenario, Touch.bounce(0.4)).trajectory
    controller = FlightFeedback(world, scenario, plan)
    open_loop = replay_event_driven(world, scenario, plan.times, plan.controls)
    tracked = track_event_driven(world, scenario, controller)
    # The midpoint rule plans what the replay does but for its error, which feedback takes out.
    assert tracked.replay.cost == pytest.approx(open_loop.cost, rel=1e-3)
    start = moved(scenario, 0.01, -0.02)
    open_loop = replay_event_driven(world, start, plan.times, plan.controls)
    assert track_event_driven(world, start, controller).replay.cost < open_loop.cost


# Gains.


def solve_riccati(scenario: Scenario, mass: float, start: float, end: float, final: Any) -> Any:
    """Returns K(t) and S(start) of the double integrator, by SciPy."""
    A, B = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1 / mass]])

    def rates(_: float, s: Any) -> Any:
        S = s.reshape(2, 2)
        return -(S @ A + A.T @ S - S @ B @ B.T @ S / scenario.control_weight).ravel()

    span = (end, start)
    found = solve_ivp(rates, span, final.ravel(), rtol=1e-11, atol=1e-13, dense_output=True)
    return (
        lambda t: B.T @ found.sol(t).reshape(2, 2) / scenario.control_weight,
        found.sol(start).reshape(2, 2),
    )


def read_gain(controller: FlightFeedback, i: int, time: float) -> Any:
    """Returns K_i(t), from what the controller does about deviations from flight i."""
    flight = controller.flights[i]
    done = [bounce.contact for bounce in controller.bounces[:i]]
    x = flight.calc_state(time)
    nominal = controller.sample(time, x, done).control
    steps = (controller.sample(time, x + dx, done).control for dx in np.eye(len(x)))
    return np.column_stack([nominal - step for step in steps])


@pytest.mark.parametrize("mass", [None, 2.0])
def test_gains_solve_the_riccati_equation(mass: float | None) -> None:
    world, e = shipped_world(mass), 0.8
    scenario = make_scenario(mass=mass, restitution=e)
    plan = optimise(world, scenario, Touch.bounce(0.55)).trajectory
    controller = FlightFeedback(world, scenario, plan)
    (bounce,) = controller.bounces
    final = np.diag([scenario.goal_weight, 0.0])
    gain, S = solve_riccati(scenario, mass or 1.0, bounce.time, 1.0, final)
    # How much a deviation before the bounce is worth, by hand: x̃⁺ = Ξ x̃⁻.
    k = int(np.flatnonzero(plan.impulses[:, 0])[0])
    v, before, after = plan.velocities[k, 0], *(plan.controls[k - 1 : k + 1, 0] / (mass or 1.0))
    saltation = np.array([[-e, 0.0], [(after + e * before) / v, -e]])
    np.testing.assert_allclose(bounce.saltation, saltation, atol=1e-9)
    first_gain, _ = solve_riccati(
        scenario, mass or 1.0, 0.0, bounce.time, saltation.T @ S @ saltation
    )
    for i, expected, times in [
        (1, gain, np.linspace(bounce.time, 0.999, 20)),
        (0, first_gain, np.linspace(0.0, bounce.time - 1e-3, 20)),
    ]:
        largest = max(float(np.max(np.abs(expected(t)))) for t in times)
        for t in times:
            np.testing.assert_allclose(
                read_gain(controller, i, t), expected(t), atol=GAIN * largest
            )


class Unsteered(Controller):
    """Holds the control of the flight that the ball is on: contact switches it, not the clock."""

    feels_contact = True

    def __init__(self, tracking: FlightFeedback) -> None:
        self.start, self.end, self.longest_hold = 0.0, 1.0, 0.01
        self._flights = tracking.flights

    def sample(self, time: float, x: Any, bounces: Sequence[int]) -> Held:
        flight = self._flights[len(bounces)]
        return Held(flight.calc_control(time), flight.find_next_sample(time))


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_saltation_is_what_simulations_show(row: int, e: float) -> None:
    scenario, _ = make_bounce(row, e)
    controller = Unsteered(make_controller(row, e))
    (bounce,) = make_controller(row, e).bounces

    def end(x: Any) -> Any:
        start = dataclasses.replace(scenario, initial_position=x[0], initial_velocity=x[1])
        replay = track_event_driven(shipped_world(), start, controller).replay
        return np.array([replay.positions[-1, 0], replay.velocities[-1, 0]])

    x = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    h = 1e-4
    slopes = np.column_stack([(end(x + dx) - end(x - dx)) / (2 * h) for dx in h * np.eye(2)])
    before, after = (np.array([[1.0, t], [0.0, 1.0]]) for t in (bounce.time, 1 - bounce.time))
    np.testing.assert_allclose(slopes, after @ bounce.saltation @ before, atol=1e-4)


# Flights beyond their ends.


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_flights_follow_the_plan_and_go_on_beyond(row: int, e: float) -> None:
    _, plan = make_bounce(row, e)
    controller = make_controller(row, e)
    first, last = controller.flights
    (k,) = np.flatnonzero(plan.impulses[:, 0])
    for flight, knots in ((first, range(k + 1)), (last, range(k + 1, len(plan.times)))):
        for i in knots:
            x = flight.calc_state(plan.times[i])
            assert x == pytest.approx([plan.positions[i, 0], plan.velocities[i, 0]], abs=1e-9)
    for flight, inside, outside in ((first, -1e-3, 1e-2), (last, 1e-3, -1e-2)):
        u = flight.calc_control(flight.end + inside if flight is first else flight.start + inside)
        joint = controller.bounces[0].time
        q, v = flight.calc_state(joint if flight is last else joint - 1e-12)
        t = outside
        assert flight.calc_control(joint + t) == u
        expected = [q + v * t + u[0] * t**2 / 2, v + u[0] * t]
        assert flight.calc_state(joint + t) == pytest.approx(expected, abs=1e-9)
    for flight in (first, last):
        assert (flight.state.start_time(), flight.state.end_time()) == (0.0, 1.0)
        assert np.all(np.diff(flight.samples) > 0) and flight.samples[-1] == 1.0


@pytest.mark.parametrize("shift", [-0.02, 0.02])
def test_the_next_flight_begins_when_the_ball_bounces(shift: float) -> None:
    scenario, _ = make_bounce(1, 1.0)
    controller = make_controller(1, 1.0)
    (bounce,) = controller.bounces
    tracked = track_event_driven(shipped_world(), moved(scenario, shift), controller)
    (time,) = tracked.replay.bounce_times
    assert (time - bounce.time) * shift > 1e-4  # From farther away it comes later.
    (k,) = np.flatnonzero(np.abs(tracked.times - time) < 1e-6)
    replay = tracked.replay
    # Just before it, and from then on, the deviation is from the flight that the ball is on.
    for i, flight, at in ((k - 1, 0, tracked.times[k - 1]), (k, 1, tracked.times[k])):
        row = int(np.searchsorted(replay.times, at, side="right")) - 1
        x = np.array([replay.positions[row, 0], replay.velocities[row, 0]])
        held = controller.sample(at, x, [0] * flight)
        assert tracked.controls[i] == pytest.approx(held.control, abs=1e-9)
    # Taken for the other flight, it would be off by more than the speed of the bounce.
    x = np.array([replay.positions[-1, 0], replay.velocities[-1, 0]])
    assert np.abs(controller.flights[1].calc_state(1.0) - x).max() < 0.05


def test_bounces_that_the_plan_lacks_change_nothing() -> None:
    controller = make_controller(1, 1.0)
    x = np.array([0.3, 1.0])
    first, second = (controller.sample(0.5, x, bounces).control for bounces in ([], [0]))
    assert first != second
    assert controller.sample(0.5, x, [3, 2]).control == first
    assert controller.sample(0.5, x, [2, 0, 0]).control == second


# With perturbations.


@given(st.floats(-0.01, 0.01), st.floats(-0.02, 0.02), st.sampled_from(BOUNCES))
@settings(max_examples=8)
def test_feedback_is_nearly_as_good_as_hindsight(
    position: float, velocity: float, case: tuple[int, float]
) -> None:
    scenario = moved(make_bounce(*case)[0], position, velocity)
    tracked = track_event_driven(shipped_world(), scenario, make_controller(*case))
    least = rigid_optimum(shipped_world(), scenario).cost
    assert least * (1 - 1e-9) <= tracked.replay.cost <= least * 1.01


@given(st.floats(-1, 1), st.floats(-1, 1))
@settings(max_examples=5)
def test_without_a_bounce_errors_are_linear(position: float, velocity: float) -> None:
    scenario, plan = make_flight()
    controller = FlightFeedback(shipped_world(), scenario, plan)
    nominal = end_of(scenario, controller)
    large, small = (
        end_of(moved(scenario, size * position, size * velocity), controller) - nominal
        for size in (1e-2, 1e-4)
    )
    assert large == pytest.approx(100 * small, abs=1e-8)


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_through_a_bounce_errors_are_linear_but_for_the_second_order(row: int, e: float) -> None:
    scenario, _ = make_bounce(row, e)
    controller = make_controller(row, e)
    nominal = end_of(scenario, controller)
    sizes = [4e-3, 2e-3, 1e-3]
    ends = [end_of(moved(scenario, size, size), controller) - nominal for size in sizes]
    ratios = [end / size for end, size in zip(ends, sizes, strict=True)]
    change, half = ratios[0] - ratios[1], ratios[1] - ratios[2]
    assert np.max(np.abs(ratios[-1])) > 1e-3  # Velocity at the end costs nothing.
    assert half == pytest.approx(change / 2, abs=0.3 * np.max(np.abs(change)) + 1e-4)


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_the_control_that_feedback_applied_does_the_same_again(row: int, e: float) -> None:
    scenario = moved(make_bounce(row, e)[0], 0.01, -0.01)
    tracked = track_event_driven(shipped_world(), scenario, make_controller(row, e))
    again = replay_event_driven(shipped_world(), scenario, tracked.times, tracked.controls)
    assert again.cost == pytest.approx(tracked.replay.cost, rel=1e-9)
    assert again.positions[-1] == pytest.approx(tracked.replay.positions[-1], abs=1e-9)


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_a_held_control_is_open_loop(row: int, e: float) -> None:
    scenario, plan = make_bounce(row, e)
    scenario = moved(scenario, -0.01, 0.01)
    controller = HeldControl(plan.times, plan.controls)
    for track, replay in (
        (track_event_driven, replay_event_driven),
        (track_drake, replay_drake),
    ):
        held = track(shipped_world(), scenario, controller).replay
        direct = replay(shipped_world(), scenario, plan.times, plan.controls)
        assert held.cost == pytest.approx(direct.cost, rel=1e-9)
        assert held.bounce_times == pytest.approx(direct.bounce_times, abs=1e-9)


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_feedback_does_the_same_on_drakes_plant(row: int, e: float) -> None:
    scenario = moved(make_bounce(row, e)[0], 0.01, -0.02)
    rigid, compliant = (
        track(shipped_world(), scenario, make_controller(row, e)).replay
        for track in (track_event_driven, track_drake)
    )
    assert compliant.cost == pytest.approx(rigid.cost, rel=1e-2)
    assert compliant.bounce_times == pytest.approx(rigid.bounce_times, abs=1e-6)


# What no feedback is known for.


def alter(**fields: Any) -> Trajectory:
    return dataclasses.replace(make_bounce(1, 1.0)[1], **fields)


def with_impulse(k: int, value: float = 1.0) -> Any:
    impulses = make_bounce(1, 1.0)[1].impulses.copy()
    impulses[k] = value
    return impulses


def test_a_contact_that_lasts_is_refused() -> None:
    forces = make_bounce(1, 1.0)[1].forces.copy()
    forces[100] = 1.0
    with pytest.raises(TrajectoryError, match=r"one that lasts, at 0\.\d+ s, expected bounces"):
        FlightFeedback(shipped_world(), make_bounce(1, 1.0)[0], alter(forces=forces))


def test_a_literal_plan_is_refused() -> None:
    everywhere = np.full_like(make_bounce(1, 1.0)[1].impulses, 1e-3)
    with pytest.raises(TrajectoryError, match=r"a push at the very start.*rigid transcription"):
        FlightFeedback(shipped_world(), make_bounce(1, 1.0)[0], alter(impulses=everywhere))


def test_a_graze_is_refused() -> None:
    # After the bounce the ball rises.
    with pytest.raises(TrajectoryError, match=r"one that grazes, at 0\.9\d+ s"):
        FlightFeedback(shipped_world(), make_bounce(1, 1.0)[0], alter(impulses=with_impulse(-8)))


def test_a_corner_is_refused() -> None:
    world, scenario = shipped("room"), make_task("room", [0.3, 0.7], [-1.0, -1.0])
    zeros = np.zeros((3, 2))
    impulses = np.zeros((3, world.num_contacts))
    impulses[1, :2] = 1.0
    plan = Trajectory(
        np.arange(3.0), zeros, zeros, zeros[1:], impulses, np.zeros((2, world.num_contacts))
    )
    with pytest.raises(TrajectoryError, match=r"several at once, at 1\.000 s"):
        FlightFeedback(world, scenario, plan)


def test_another_worlds_plan_is_refused() -> None:
    world, scenario = shipped("room"), make_task("room", [0.3, 0.7], [-1.0, -1.0])
    with pytest.raises(TrajectoryError, match=r"got \(1, 1, 1\) .*expected the world's, \(2, 2, 4"):
        FlightFeedback(world, scenario, make_bounce(1, 1.0)[1])
