"""Feedback between bounces: gains, phases beyond their ends, bounces that come early or late."""

from __future__ import annotations

import copy
import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from marks import slow
from phase_solutions import optimise
from replay_worlds import make_diagram, make_scenario, make_task, shipped, shipped_world

from drake_aigto import Scenario, World
from drake_aigto.control import Bridge, Catch
from drake_aigto.errors import TrajectoryError
from drake_aigto.paper import rigid_optimum
from drake_aigto.planning import Feedback, Regulator, Sweep, calc_divergence
from drake_aigto.simulation import EVENT_DRIVEN, HeldControl, replay_event_driven, replay_with
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch

# Of costs: the control after a bounce comes up to 4e-7 of the duration late.
REPRODUCED = 1e-5
# Of gains, relative to the largest, through differences of simulated steps.
GAIN = 1e-6
# A row of Table I, and a wall that returns less.
BOUNCES = [(1, 1.0), (4, 0.5)]


@cache
def make_bounce(row: int, e: float) -> tuple[Scenario, Trajectory]:
    """Returns a row of Table I, and its best bounce."""
    scenario = dataclasses.replace(Scenario.named(f"table1/{row}"), restitution=e)
    (time,) = rigid_optimum(shipped_world(), scenario).bounce_times
    return scenario, optimise(shipped_world(), scenario, Touch.bounce(time)).trajectory


@cache
def make_controller(row: int, e: float) -> Feedback:
    return Feedback(shipped_world(), *make_bounce(row, e))


def moved(scenario: Scenario, position: float = 0.0, velocity: float = 0.0) -> Scenario:
    return dataclasses.replace(
        scenario,
        initial_position=scenario.initial_position + position,
        initial_velocity=scenario.initial_velocity + velocity,
    )


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_an_unperturbed_plan_is_reproduced(row: int, e: float) -> None:
    (scenario, plan), controller = make_bounce(row, e), make_controller(row, e)
    open_loop = replay_event_driven(shipped_world(), scenario, plan.times, plan.controls)
    tracked = replay_with(EVENT_DRIVEN, shipped_world(), scenario, controller)
    assert tracked.cost == pytest.approx(open_loop.cost, rel=REPRODUCED)
    assert tracked.bounce_times == pytest.approx(open_loop.bounce_times, abs=1e-10)


def test_a_plan_between_walls_is_reproduced() -> None:
    world, scenario = shipped("corridor"), Scenario.named("corridor/lossy")
    touches = [Touch.bounce(t, c) for t, c in [(0.17, 1), (0.63, 0), (1.31, 1)]]
    plan = optimise(world, scenario, *touches).trajectory
    controller = Feedback(world, scenario, plan)
    assert [stretch.contact for stretch in controller.stretches[:-1]] == [1, 0, 1]
    tracked = replay_with(EVENT_DRIVEN, world, scenario, controller)
    assert tracked.bounce_contacts == (1, 0, 1)
    open_loop = replay_event_driven(world, scenario, plan.times, plan.controls)
    assert tracked.cost == pytest.approx(open_loop.cost, rel=REPRODUCED)
    start = dataclasses.replace(scenario, initial_velocity=1.01 * scenario.initial_velocity)
    open_loop = replay_event_driven(world, start, plan.times, plan.controls)
    tracked = replay_with(EVENT_DRIVEN, world, start, controller)
    assert tracked.bounce_contacts == (1, 0, 1)
    assert tracked.goal_error < 0.2 * open_loop.goal_error


@pytest.mark.slow
def test_a_plan_on_a_spring_is_reproduced() -> None:
    world = World.from_diagram(make_diagram(spring=30.0, reference=0.4))
    scenario = make_scenario(0.6, -1.5, restitution=0.8)
    plan = optimise(world, scenario, Touch.bounce(0.4)).trajectory
    controller = Feedback(world, scenario, plan)
    open_loop = replay_event_driven(world, scenario, plan.times, plan.controls)
    tracked = replay_with(EVENT_DRIVEN, world, scenario, controller)
    # The midpoint rule plans what the replay does but for its error, which feedback takes out.
    assert tracked.cost == pytest.approx(open_loop.cost, rel=1e-3)
    start = moved(scenario, 0.01, -0.02)
    open_loop = replay_event_driven(world, start, plan.times, plan.controls)
    assert replay_with(EVENT_DRIVEN, world, start, controller).cost < open_loop.cost


def solve_riccati(scenario: Scenario, mass: float, steps: Any, final: Any) -> Any:
    """Returns the gains of held forces on a mass, and what a deviation costs at the start."""
    gains, S = [], final
    for h in steps[::-1]:
        F, G = np.array([[1.0, h], [0.0, 1.0]]), np.array([[h**2 / 2], [h]]) / mass
        gains.append(-np.linalg.solve(scenario.control_weight * h + G.T @ S @ G, G.T @ S @ F))
        S = F.T @ S @ F + F.T @ S @ G @ gains[-1]
    return np.array(gains[::-1]), S


@pytest.mark.parametrize("mass", [None, 2.0])
def test_gains_solve_the_riccati_equation(mass: float | None) -> None:
    world, e = shipped_world(mass), 0.8
    scenario = make_scenario(mass=mass, restitution=e)
    plan = optimise(world, scenario, Touch.bounce(0.55)).trajectory
    (k,) = np.flatnonzero(plan.impulses[:, 0])
    steps, final = np.diff(plan.times), np.diag([scenario.goal_weight, 0.0])
    last, S = solve_riccati(scenario, mass or 1.0, steps[k:], final)
    # How much a deviation before the bounce is worth, by hand: x̃⁺ = Ξ x̃⁻.
    v, before, after = plan.velocities[k, 0], *(plan.controls[k - 1 : k + 1, 0] / (mass or 1.0))
    saltation = np.array([[-e, 0.0], [(after + e * before) / v, -e]])
    sweep = Sweep(world, scenario, plan)
    np.testing.assert_allclose(sweep.calc_saltation(int(k)), saltation, atol=1e-8)
    first, _ = solve_riccati(scenario, mass or 1.0, steps[:k], saltation.T @ S @ saltation)
    phases = Feedback(world, scenario, plan).phases
    for phase, gains, start in zip(phases, (first, last), (0.0, plan.times[k]), strict=True):
        row = int(np.argmin(np.abs(phase.times - start)))
        got = phase.gains[row : row + len(gains)]
        np.testing.assert_allclose(got, gains, atol=GAIN * np.max(np.abs(gains)))


def hold(tracking: Feedback) -> Feedback:
    """Returns the controls of the phase that it is in: contact switches them, not the clock."""
    held = copy.copy(tracking)
    held.phases = [dataclasses.replace(each, gains=0 * each.gains) for each in tracking.phases]
    return held


@pytest.mark.parametrize(("row", "e"), [BOUNCES[0], *slow(BOUNCES[1])])
def test_saltation_is_what_simulations_show(row: int, e: float) -> None:
    scenario, plan = make_bounce(row, e)
    controller = hold(make_controller(row, e))
    (k,) = np.flatnonzero(plan.impulses[:, 0])
    saltation = Sweep(shipped_world(), scenario, plan).calc_saltation(int(k))

    def end(x: Any) -> Any:
        start = dataclasses.replace(scenario, initial_position=x[0], initial_velocity=x[1])
        replay = replay_with(EVENT_DRIVEN, shipped_world(), start, controller)
        return np.array([replay.positions[-1, 0], replay.velocities[-1, 0]])

    x = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    h = 1e-4
    slopes = np.column_stack([(end(x + dx) - end(x - dx)) / (2 * h) for dx in h * np.eye(2)])
    before, after = (np.array([[1.0, t], [0.0, 1.0]]) for t in (plan.times[k], 1 - plan.times[k]))
    np.testing.assert_allclose(slopes, after @ saltation @ before, atol=1e-4)


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_phases_follow_the_plan_and_go_on_beyond(row: int, e: float) -> None:
    _, plan = make_bounce(row, e)
    controller = make_controller(row, e)
    first, last = controller.phases
    (k,) = np.flatnonzero(plan.impulses[:, 0])
    for phase, knots in ((first, range(k + 1)), (last, range(k + 1, len(plan.times)))):
        for i in knots:
            x = phase.calc_state(plan.times[i])
            assert x == pytest.approx([plan.positions[i, 0], plan.velocities[i, 0]], abs=1e-9)
    joint = controller.stretches[0].end
    for phase, u, t in ((first, plan.controls[k - 1], 0.3), (last, plan.controls[k], -0.3)):
        q, v = phase.calc_state(joint)
        expected = [q + v * t + u[0] * t**2 / 2, v + u[0] * t]
        assert phase.calc_state(joint + t) == pytest.approx(expected, abs=1e-9)
        assert phase.controls[np.searchsorted(phase.times, joint + t) - 1] == u
        # Both go on over all of the plan's time.
        assert phase.times[0] < 1e-9 and phase.times[-1] > 1 - 1e-9


@pytest.mark.parametrize("shift", [-0.02, 0.02])
def test_the_next_phase_begins_when_the_ball_bounces(shift: float) -> None:
    scenario, _ = make_bounce(1, 1.0)
    controller = make_controller(1, 1.0)
    planned, _ = controller.stretches
    tracked = EVENT_DRIVEN.simulate(shipped_world(), moved(scenario, shift), controller)
    replay = replay_with(EVENT_DRIVEN, shipped_world(), moved(scenario, shift), controller)
    (time,) = replay.bounce_times
    assert (time - planned.end) * shift > 1e-4  # From farther away it comes later.
    (k,) = np.flatnonzero(np.abs(np.array(tracked.control_times) - time) < 1e-6)
    # Just before it, and from then on, the deviation is from the phase that the ball is in.
    for i, phase, at in (
        (k - 1, 0, tracked.control_times[k - 1]),
        (k, 1, tracked.control_times[k]),
    ):
        row = int(np.searchsorted(replay.times, at, side="right")) - 1
        x = np.array([replay.positions[row, 0], replay.velocities[row, 0]])
        held = controller.sample(at, x, [0] * phase)
        assert tracked.controls[i] == pytest.approx(held.control, abs=1e-9)
    # Taken for the other phase, it would be off by more than the speed of the bounce.
    x = np.array([replay.positions[-1, 0], replay.velocities[-1, 0]])
    assert np.abs(controller.phases[1].calc_state(1.0) - x).max() < 0.05


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_no_control_is_held_beyond_the_end_where_a_bounce_is_missing(row: int, e: float) -> None:
    controller = make_controller(row, e)
    before = controller.phases[0].times
    assert before[-1] > controller.end  # It goes on as if there were no wall.
    for time in before[before < controller.end]:
        assert controller.sample(time, np.array([0.3, 1.0]), []).until <= controller.end


def test_bounces_that_the_plan_lacks_change_nothing() -> None:
    controller = make_controller(1, 1.0)
    x = np.array([0.3, 1.0])
    first, second = (controller.sample(0.5, x, bounces).control for bounces in ([], [0]))
    assert first != second
    assert controller.sample(0.5, x, [3, 2]).control == first
    assert controller.sample(0.5, x, [2, 0, 0]).control == second


@given(st.floats(-0.01, 0.01), st.floats(-0.02, 0.02), st.sampled_from(BOUNCES))
@settings(max_examples=4)
def test_feedback_is_nearly_as_good_as_hindsight(
    position: float, velocity: float, case: tuple[int, float]
) -> None:
    scenario = moved(make_bounce(*case)[0], position, velocity)
    tracked = replay_with(EVENT_DRIVEN, shipped_world(), scenario, make_controller(*case))
    least = rigid_optimum(shipped_world(), scenario).cost
    assert least * (1 - 1e-9) <= tracked.cost <= least * 1.01


@pytest.mark.parametrize(("row", "e"), BOUNCES)
def test_the_control_that_feedback_applied_does_the_same_again(row: int, e: float) -> None:
    scenario, controller = moved(make_bounce(row, e)[0], 0.01, -0.01), make_controller(row, e)
    tracked = replay_with(EVENT_DRIVEN, shipped_world(), scenario, controller)
    applied = EVENT_DRIVEN.simulate(shipped_world(), scenario, controller)
    times = np.append(applied.control_times, controller.end)
    again = replay_event_driven(shipped_world(), scenario, times, np.array(applied.controls))
    assert again.cost == pytest.approx(tracked.cost, rel=1e-9)
    assert again.positions[-1] == pytest.approx(tracked.positions[-1], abs=1e-9)


def alter(**fields: Any) -> Trajectory:
    return dataclasses.replace(make_bounce(1, 1.0)[1], **fields)


def with_impulse(k: int, value: float = 1.0) -> Any:
    impulses = make_bounce(1, 1.0)[1].impulses.copy()
    impulses[k] = value
    return impulses


def test_plans_that_no_feedback_follows_are_refused() -> None:
    scenario, plan = make_bounce(1, 1.0)
    literal = alter(impulses=np.full_like(plan.impulses, 1e-3))
    grazing = alter(impulses=with_impulse(-8))  # After the bounce the ball rises.
    for other, message in (
        (literal, r"a push at the very start.*rigid transcription"),
        (grazing, r"one that grazes, at 0\.9\d+ s"),
    ):
        with pytest.raises(TrajectoryError, match=message):
            Feedback(shipped_world(), scenario, other)
    world, scenario = shipped("room"), make_task("room", [0.3, 0.7], [-1.0, -1.0])
    zeros, impulses = np.zeros((3, 2)), np.zeros((3, 4))
    impulses[1, :2] = 1.0
    corner = Trajectory(np.arange(3.0), zeros, zeros, zeros[1:], impulses, np.zeros((2, 4)))
    for other, message in (
        (corner, r"several at once, at 1\.000 s"),
        (plan, r"got \(1, 1, 1\) .*expected the world's, \(2, 2, 4"),
    ):
        with pytest.raises(TrajectoryError, match=message):
            Feedback(world, scenario, other)


@pytest.mark.parametrize(("name", "off"), [("acrobot/swing_up", 0.02), ("cart_pole/soft_10", 0.05)])
def test_a_goal_is_held_from_near_it_by_the_regulator(name: str, off: float) -> None:
    scenario = Scenario.named(name)
    world, n = World.from_scenario(scenario), 2
    period, x = 0.01, np.concatenate([scenario.goal_position, np.zeros(n)])
    about, planned, gains, *_ = Regulator.of(world, scenario, x, period) or pytest.fail("none")
    np.testing.assert_allclose(about, x, atol=1e-12)
    x = about + off * np.array([1.0, -1.0, 0.0, 0.0])
    for _ in range(round(8.0 / period)):
        u = planned + gains @ (x - about)

        def rate(x: Any, u: Any = u) -> Any:
            return np.concatenate([x[n:], world.calc_acceleration(x[:n], x[n:], u)])

        k1 = rate(x)
        k2 = rate(x + period / 2 * k1)
        k3 = rate(x + period / 2 * k2)
        x = x + period / 6 * (k1 + 2 * k2 + 2 * k3 + rate(x + period * k3))
    np.testing.assert_allclose(x, about, atol=1e-3)


def test_a_goal_is_caught_from_where_its_regulator_lets_it_fall() -> None:
    # An acrobot of nine tenths of its mass is there at the end of its plan, after a kick.
    scenario, off = Scenario.named("acrobot/swing_up"), np.array([-0.13, -0.011, -0.228, -0.243])
    world, goal = World.from_scenario(scenario), np.append(scenario.goal_position, [0.0, 0.0])
    catch, x, u = Catch(world, scenario, 0.01), goal + off, np.zeros(1)
    # Before the end nothing is asked for; soon before it, a motion from there.
    np.testing.assert_array_equal(catch.begin(catch.nothing, 1.9, 2.0, x, u), catch.nothing)
    asked = catch.begin(catch.nothing, 2.0 - 1e-6, 2.0, x, u)
    followed = catch.follow(asked, 2.0, x)
    assert followed.is_new
    law, end = followed.law, 2.0 + scenario.duration
    assert isinstance(law, Feedback) and law.end == pytest.approx(end)
    # On its way nothing else is asked for. Off it the next one is, and taken a moment later.
    on = law.find_state(2.5, ())
    same = catch.follow(followed.asked, 2.5, on)
    assert same.law is law and not same.is_new
    other = catch.follow(same.asked, 2.5, on + 0.5)
    assert isinstance(other.law, Bridge) and other.motion is same.motion
    late = catch.follow(other.asked, 2.5 + catch.soon, on + 0.5)
    assert late.is_new or late.motion is None
    start = {"initial_position": x[:2], "initial_velocity": x[2:]}
    regulator = Regulator.of(world, scenario, goal, 0.01) or pytest.fail("none")
    caught = EVENT_DRIVEN.simulate(world, dataclasses.replace(scenario, **start), law)
    error = world.calc_error(np.append(caught.positions[-1], caught.velocities[-1]), goal)
    assert error @ regulator.value @ error < 0.05 * (off @ regulator.value @ off)


@pytest.mark.slow
def test_far_off_its_goal_a_mechanism_brakes_until_a_search_leads_to_rest() -> None:
    # Fallen over, where the regulator's response leads to nothing.
    scenario, off = Scenario.named("acrobot/swing_up"), np.array([0.93, -2.49, 2.13, -7.59])
    world, period = World.from_scenario(scenario), 0.01
    x = np.append(scenario.goal_position, [0.0, 0.0]) + off
    runs = []
    for _ in range(2):
        catch, motion = Catch(world, scenario, period), None
        asked, state, times = catch.nothing, x, 0.0
        while motion is None and times < scenario.duration:
            asked, law, motion, _ = catch.follow(asked, times, state)
            held = HeldControl(
                np.array([times, times + period]), law.sample(times, state, ()).control[np.newaxis]
            )
            moved = EVENT_DRIVEN.simulate(world, scenario, held, world.split(state))
            state, times = np.append(moved.positions[-1], moved.velocities[-1]), times + period
        assert motion is not None and catch.task is not None
        assert not catch.task.is_off(motion.calc_state(np.inf))
        runs.append((times, state))
    # It is taken when it is due, whenever it was found: runs are the same again.
    assert runs[0][0] == runs[1][0] > 0.1 * scenario.duration
    np.testing.assert_array_equal(runs[0][1], runs[1][1])


def test_brakes_take_the_energy_that_actuators_can_take() -> None:
    # In a rigid wall nothing is planned.
    scenario = Scenario.named("cart_pole/rigid_06")
    world = World.from_scenario(scenario)
    x, catch = np.array([0.7, 1.0, -3.0, 1.0]), Catch(world, scenario, 0.01)
    asked, law, motion, _ = catch.follow(catch.nothing, 0.0, x)
    assert motion is None
    # Of a cart M_c v̇ = u + …, whose pole is free: (Bᵀ M⁻¹ B)⁻¹ is its own inertia there.
    M = world.calc_mass_matrix(x[:2])
    inertia = M[0, 0] - M[0, 1] ** 2 / M[1, 1]
    expected = min(inertia * 3.0 / (0.2 * scenario.duration), world.bounds(scenario).control[1][0])
    assert law.sample(0.0, x, ()).control == pytest.approx([expected])
    # Nor is anything later: they go on.
    assert catch.follow(asked, catch.soon, x).motion is None


@pytest.mark.parametrize(
    ("name", "joint"), [("acrobot/swing_up", 0), ("cart_pole/soft_10", 1), ("drone/deliver", 7)]
)
@pytest.mark.parametrize("digits", [2, *slow(5)])
def test_a_goal_that_is_typed_with_few_digits_means_the_equilibrium_beside_it(
    name: str, joint: int, digits: int
) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    scenario = world.place(scenario)
    goal = np.array(scenario.goal_position)
    # A load that hangs, and a pole that stands, are off by as much as π is.
    goal[joint] += round(np.pi, digits) - np.pi
    typed = dataclasses.replace(scenario, goal_position=goal)
    rest = np.zeros(world.num_velocities)
    meant, known = (
        Regulator.of(world, each, np.append(each.goal_position, rest), 0.01) or pytest.fail("none")
        for each in (typed, scenario)
    )
    # An acrobot may rest in many poses, and the nearest of them is a little bent.
    off = np.abs(round(np.pi, digits) - np.pi)
    q, v = world.split(meant.state)
    np.testing.assert_allclose(world.calc_acceleration(q, v, meant.control), 0.0, atol=1e-6)
    assert np.max(np.abs(world.calc_error(meant.state, np.append(goal, rest)))) <= 1.01 * off
    np.testing.assert_allclose(meant.gains, known.gains, rtol=0.05, atol=0.05)
    pace = calc_divergence(world, scenario)
    assert (pace > 0) == (name != "drone/deliver"), "a drone drifts, no more"
    assert calc_divergence(world, typed) == pytest.approx(pace, rel=0.01)


def test_goals_that_can_not_be_held_have_no_regulator() -> None:
    scenario = Scenario.named("acrobot/swing_up")
    world, end = World.from_scenario(scenario), np.array([np.pi, 0.0, 0.0, 0.0])
    sideways = dataclasses.replace(scenario, goal_position=[np.pi / 2, 0.0])
    moving = dataclasses.replace(scenario, goal_velocity=[1.0, 0.0])
    beside = dataclasses.replace(scenario, goal_position=[np.pi - 0.01, 0.0])
    assert Regulator.of(world, scenario, end, 0.01)
    assert Regulator.of(world, beside, end, 0.01) is None
    assert Regulator.of(world, sideways, np.array([np.pi / 2, 0.0, 0.0, 0.0]), 0.01) is None
    assert Regulator.of(world, moving, end, 0.01) is None
    # Its unactuated disc cannot be stabilized without contact.
    spinner = Scenario.named("spinner/two_radians")
    disc = World.from_scenario(spinner)
    end = np.concatenate([spinner.goal_position, np.zeros(disc.num_positions)])
    assert Regulator.of(disc, spinner, end, 0.01) is None
