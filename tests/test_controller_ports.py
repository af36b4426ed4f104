"""Ports of all controllers: reports, limits, fallbacks, commands that act late, goals that move."""

from __future__ import annotations

import dataclasses
import time
from functools import cache
from threading import Event
from typing import Any

import numpy as np
import pytest
from loops import BALL, close_loop, make_plan
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto import (
    ModelPredictiveController,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
)
from drake_aigto.control import (
    Disturbance,
    LoopController,
    Safety,
    TickStatus,
    make_horizon,
    run_in_loop,
    tabulate,
)
from drake_aigto.errors import ControlError, ModelError

POLE = Scenario.named("cart_pole/soft_06")
QUICK = PlanOptions(branches=0, finalists=1, confirm=False)
START = np.concatenate([BALL.initial_position, BALL.initial_velocity])


@cache
def make_planner() -> Planner:
    return Planner(BALL, QUICK)


def make_controller(method: str, **options: Any) -> LoopController:
    if method == "tracking":
        return TrackingController(make_plan(), period=0.02, **options)
    return ModelPredictiveController(make_planner(), 0.02, "shrinking", plan=make_plan(), **options)


class Told:
    """A controller in a Diagram whose states are given, as nothing moves."""

    def __init__(self, controller: LoopController, told: Any, goal: Any = None) -> None:
        self.controller, times = controller, [*told, 9.0]
        rows = np.array([*told.values(), told[max(told)]]).T
        builder = DiagramBuilder()
        builder.AddSystem(controller)
        source = builder.AddSystem(TrajectorySource(PiecewisePolynomial.ZeroOrderHold(times, rows)))
        builder.Connect(source.get_output_port(), controller.get_input_port_estimated_state())
        if goal is not None:
            builder.Connect(
                builder.AddSystem(ConstantVectorSource(goal)).get_output_port(),
                controller.GetInputPort("reference"),
            )
        self._log = LogVectorOutput(controller.get_output_port_control(), builder, 0.005)
        self.simulator = Simulator(builder.Build())

    def advance(self, time: float) -> TickStatus:
        self.simulator.AdvanceTo(time)
        return self.controller.read_status(self.context)

    @property
    def context(self) -> Any:
        return self.controller.GetMyContextFromRoot(self.simulator.get_context())

    @property
    def control(self) -> float:
        return float(self.controller.get_output_port_control().Eval(self.context)[0])

    @property
    def controls(self) -> Any:
        return self._log.FindLog(self.simulator.get_context()).data()[0]


METHODS = pytest.mark.parametrize("method", ["tracking", "replanning"])


@METHODS
@pytest.mark.parametrize("fallback", ["plan", "hold", "brake", "zero"])
def test_what_is_commanded_without_a_sample_is_what_was_declared(
    method: str, fallback: Any
) -> None:
    controller = make_controller(method, safety=Safety(fallback=fallback))
    run = Told(controller, {0.0: START, 0.05: np.array([np.nan, 0.0])})
    before = run.advance(0.049)
    assert (before.mode, before.sample) == ("running", "valid")
    last = run.control
    status = run.advance(0.062)
    assert (status.mode, status.sample, status.deviation) == ("fallback", "not finite", np.inf)
    is_planned = isinstance(controller, ModelPredictiveController)
    path = controller.read_plan(run.context) if is_planned else make_plan().trajectory
    k = int(np.searchsorted(path.times, status.time, side="right")) - 1
    # A mass that moves as planned is stopped in a tenth of the time.
    mass = make_planner().world.calc_mass_matrix(START[:1])[0, 0]
    braking = -mass * path.to_piecewise()[0].value(status.time)[1, 0] / (0.1 * BALL.duration)
    expected = {"plan": path.controls[k, 0], "hold": last, "brake": braking, "zero": 0.0}
    assert run.control == pytest.approx(expected[fallback], rel=0.02)


@METHODS
def test_outliers_and_states_beyond_their_limits_are_told_and_not_answered(method: str) -> None:
    for safety, x, sample in (
        (None, START + np.array([0.0, 1e3]), "far off"),
        (Safety(upper=np.array([np.inf, 0.0])), START + np.array([0.0, 2.5]), "off limits"),
        (Safety(far=0.2), START + np.array([0.5, 0.0]), "far off"),
    ):
        run = Told(make_controller(method, safety=safety), {0.0: START, 0.05: x})
        assert run.advance(0.045).deviation < 0.2
        status = run.advance(0.07)
        assert (status.mode, status.sample) == ("fallback", sample)
        assert 0.2 < status.deviation < np.inf
        assert np.max(np.abs(run.controls)) < 10.0


def is_small(u: Any) -> bool:
    return bool(np.max(np.abs(u)) <= 0.05)


def is_slow(u: Any) -> bool:
    return bool(np.max(np.abs(np.diff(u))) <= 2.0 * 0.02 + 1e-12)


@METHODS
def test_commands_and_their_changes_stay_within_limits(method: str) -> None:
    push = np.array([0.05, 0.4])
    for safety, is_within in ((Safety(control=0.05), is_small), (Safety(rate=2.0), is_slow)):
        off = {0.0: START, 0.02: START + push, 0.1: START - push}
        free, limited = (Told(make_controller(method, safety=each), off) for each in (None, safety))
        assert not free.advance(0.13).is_limited
        assert not is_within(free.controls)
        limited.advance(0.03)
        assert limited.advance(0.11).is_limited
        assert is_within(limited.controls)


def test_a_tracker_reports_its_mode_and_the_bounces_that_are_left() -> None:
    told = Told(make_controller("tracking"), {0.0: np.zeros(2), 0.05: START})
    assert (told.advance(0.03).mode, told.advance(0.045).sample) == ("waiting", "none")
    status = told.advance(0.07)
    assert (status.mode, status.touches, status.cost) == ("running", (0,), make_plan().cost)
    assert status.seconds > 0.0
    assert told.advance(BALL.duration + 0.05).mode == "holding"
    columns = tabulate([status, told.controller.read_status(told.context)])
    assert columns["mode"] == ["running", "holding"]
    assert set(columns) == {field.name for field in dataclasses.fields(TickStatus)}


@METHODS
def test_a_plan_begins_at_its_start_time(method: str) -> None:
    begin = 0.1
    late, now = (
        Told(make_controller(method, start_time=each), {0.0: START}) for each in (begin, 0.0)
    )
    assert late.advance(0.085).mode == "waiting"
    np.testing.assert_array_equal(late.controls, 0.0)
    assert late.advance(begin + 0.03).mode == now.advance(0.03).mode == "running"
    assert late.controls[-1] == pytest.approx(now.controls[-1], abs=1e-6)
    path = late.controller.GetOutputPort("planned_state").Eval(late.context)
    assert path.start_time() >= begin
    desired = late.controller.get_output_port_desired_state().Eval(late.context)
    np.testing.assert_allclose(desired, path.value(begin + 0.03)[:, 0], atol=1e-9)


@METHODS
def test_without_a_simulator_a_node_gets_the_same_commands(method: str) -> None:
    controller, run = make_controller(method), Told(make_controller(method), {0.0: START})
    context = controller.CreateDefaultContext()
    controller.get_input_port_estimated_state().FixValue(context, START)
    for tick in range(3):
        context.SetTime(0.02 * tick)
        controller.update(context)
        run.advance(0.02 * tick + 1e-3)
        u = controller.get_output_port_control().Eval(context)
        assert u[0] == pytest.approx(run.control, rel=1e-6)


def test_the_first_plan_may_be_given() -> None:
    run = Told(make_controller("replanning"), {0.0: START})
    status = run.advance(0.01)
    assert status.reason == "the plan that was given"
    assert status.cost == pytest.approx(make_plan().cost, rel=1e-3)
    with pytest.raises(ModelError, match="the world"):
        ModelPredictiveController(Planner(POLE), 0.02, plan=make_plan())


def test_a_goal_that_is_told_is_planned_for() -> None:
    for goal in ([0.6, 0.0], [np.nan, 0.0]):
        controller = ModelPredictiveController(make_planner(), 0.02, "shrinking")
        run = Told(controller, {0.0: START}, goal)
        run.advance(0.01)
        end = controller.read_plan(run.context).positions[-1, 0]
        expected = goal[0] if np.isfinite(goal[0]) else BALL.goal_position[0]
        assert end == pytest.approx(expected, abs=0.01)


@pytest.mark.slow
def test_a_pole_on_a_cart_is_told_where_to_go() -> None:
    asked = dataclasses.replace(
        POLE, initial_position=[0.0, np.pi], initial_velocity=[0.0, 0.0], duration=1.0
    )
    options = PlanOptions(renewals=0, starts=3, finalists=1, confirm=False, threads=1)
    controller = ModelPredictiveController(Planner(asked, options), 0.05)
    goal = np.array([0.2, np.pi, 0.0, 0.0])
    run = Told(controller, {0.0: [0.0, np.pi, 0.0, 0.0]}, goal)
    run.advance(0.12)
    np.testing.assert_allclose(controller.read_plan(run.context).positions[-1], goal[:2], atol=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "delay"), [("tracking", 0.04), ("replanning", 0.01), ("replanning", 0.04)]
)
def test_commands_that_act_late_answer_the_state_of_then(method: str, delay: float) -> None:
    wrong = Disturbance(delay=delay, start_offset=np.array([0.02]))
    controller = make_controller(method, delay=delay)
    run = run_in_loop(controller, BALL, make_planner().world, wrong)
    off = abs(run.replay.positions[-1, 0] - run.plan.states[-1, 0])
    assert run.replay.bounce_contacts == (0,)
    assert off < (3e-4 if method == "tracking" else 1e-3)
    # What holds the goal from the end on acts after it: it stops the ball with 12 N.
    assert np.max(np.abs(run.controls)) < 1.0


@pytest.mark.slow
def test_a_pole_stands_up_though_commands_act_late() -> None:
    planner = Planner(POLE, PlanOptions(renewals=32, threads=1))
    for told, is_near in ((0.0, False), (0.04, True)):
        controller = ModelPredictiveController(
            planner, 0.02, "shrinking", surprise=np.inf, delay=told
        )
        wrong = Disturbance(delay=0.04, start_offset=np.full(2, 0.02))
        run = run_in_loop(controller, POLE, planner.world, wrong)
        off = np.linalg.norm(run.replay.positions[-1] - POLE.goal_position)
        assert (off < 0.1) == is_near


def test_a_search_that_is_not_waited_for_is_late_until_it_is_done(monkeypatch: Any) -> None:
    is_released, kind = Event(), type(make_horizon(make_planner(), False, 5, 0.02))
    search = kind.search

    def search_late(self: Any, now: float, x: Any) -> Any:
        is_released.wait(60.0)
        return search(self, now, x)

    monkeypatch.setattr(kind, "search", search_late)
    controller = make_controller("replanning", search_every=2, search_ticks=1, waits=False)
    run = Told(controller, {0.0: START})
    assert run.advance(0.07).is_late
    assert run.advance(0.13).reason == "warm"
    is_released.set()
    for tick in range(7, 45):
        time.sleep(0.1)
        if run.advance(0.02 * tick + 0.01).reason != "warm":
            break
    assert run.controller.read_status(run.context).reason.startswith(("warm; a search", "switched"))


@pytest.mark.slow
def test_feedback_between_ticks_answers_what_ticks_are_too_rare_for() -> None:
    ends = []
    for often in (None, 0.01):
        controller = ModelPredictiveController(
            make_planner(), 0.2, "shrinking", plan=make_plan(), feedback_period=often
        )
        kick = Disturbance(kick=np.array([-0.5]), kick_time=0.805)
        run = run_in_loop(controller, BALL, make_planner().world, kick)
        ends.append(abs(run.replay.positions[-1, 0] - BALL.goal_position[0]))
    assert ends[1] < 0.8 * ends[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"delay": -0.1}, r"^delay: got -0.1, expected seconds of at least zero"),
        ({"delay": 3.0}, r"^delay: got 3 s, expected at most the task's duration, 1 s"),
        ({"start_time": np.inf}, r"^start_time: got inf"),
        ({"safety": Safety(lower=np.zeros(3) - 1)}, r"^lower: got 3 numbers, expected 1 or 2"),
    ],
)
@METHODS
def test_what_makes_no_sense_is_refused(method: str, options: Any, message: str) -> None:
    with pytest.raises(ControlError, match=message):
        make_controller(method, **options)


def test_a_plant_of_other_joints_is_refused_where_it_can_be_seen() -> None:
    floor = Scenario.named("floor/rebound")
    diagram, _ = close_loop(floor.model, make_controller("tracking"), feels=True)
    message = "^joints of the plant: got .*, expected .*plan for this plant"
    with pytest.raises(ControlError, match=message):
        Simulator(diagram).Initialize()


def test_limits_that_leave_nothing_are_refused() -> None:
    with pytest.raises(ControlError, match=r"^period: got 2 s, expected at most the task's dura"):
        TrackingController(make_plan(), period=2.0)
    with pytest.raises(ControlError, match=r"^feedback_period: got 1 s, expected at most"):
        ModelPredictiveController(make_planner(), 0.1, feedback_period=1.0)
    for given, message in (
        ({"control": 0.0}, "^control: got .*, expected limits above zero"),
        ({"lower": 1.0, "upper": 1.0}, "^lower and upper: got .*, expected lower ones below"),
        ({"fallback": "stop"}, "^fallback: got stop, expected one of plan, hold, brake, zero"),
    ):
        with pytest.raises(ControlError, match=message):
            Safety(**given)
