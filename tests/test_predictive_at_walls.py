"""Plans of mechanisms that are made again while they move between rigid walls."""

from __future__ import annotations

import dataclasses
import threading
from collections import Counter
from typing import Any

import numpy as np
import pytest
from loops import start_at
from pydrake.systems.framework import Context, EventStatus, State

from drake_aigto import (
    ModelPredictiveController,
    Plan,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
    World,
)
from drake_aigto.control import ClosedLoopRun, Disturbance, ModelEstimate, make_horizon, run_in_loop
from drake_aigto.errors import ControlError
from drake_aigto.planning import MechanismSearch, make_mechanism_task
from drake_aigto.shooting import ShootingProblem, ShootingResult
from drake_aigto.transcription import Touch
from drake_aigto.world import TaskCost

PENDULUM = Scenario.named("pendulum/off_the_wall")


def swing(scenario: Scenario, truth: Disturbance, renewals: int, **options: Any) -> ClosedLoopRun:
    world = World.from_scenario(scenario)
    counts = PlanOptions(renewals=renewals, search_steps=30, threads=1)
    planner = Planner(scenario, counts, world)
    controller = ModelPredictiveController(planner, 0.02, "shrinking", **options)
    return run_in_loop(controller, scenario, world, truth)


@pytest.mark.slow
def test_a_pendulum_is_brought_to_its_goal_off_a_rigid_wall() -> None:
    truth = Disturbance(kick=np.array([0.3]), kick_time=0.4, noise=np.full(2, 1e-3))
    run = swing(PENDULUM, truth, renewals=0)
    np.testing.assert_allclose(run.replay.positions[-1], PENDULUM.goal_position, atol=5e-3)
    assert np.all(np.isfinite(run.controls))
    (bounce,) = run.replay.bounce_times
    assert {tick.touches for tick in run.ticks if tick.time < bounce} == {(0,)}
    assert {tick.touches for tick in run.ticks if tick.time > bounce + 0.02} == {()}
    # But for the kick and the touch, the last plan led on.
    assert sum(tick.reason != "warm" for tick in run.ticks) < 6


@pytest.mark.slow
def test_a_pole_that_is_kicked_bounces_off_a_rigid_wall_as_it_promises_then() -> None:
    truth = Disturbance(kick=np.array([0.3, 0.5]), kick_time=0.4)
    run = swing(Scenario.named("cart_pole/rigid_06"), truth, renewals=8, feedback_period=0.005)
    assert run.replay.bounce_contacts
    # Where a later tick misses, the plan that the pole is on goes on: nothing worse is taken.
    kicked = next(tick for tick in run.ticks if tick.time >= truth.kick_time)
    assert "no motion" not in kicked.reason
    assert sum("no motion" in tick.reason for tick in run.ticks) <= 2
    assert run.cost < 1.05 * (calc_spent(run, truth.kick_time) + kicked.cost)


@pytest.mark.slow
def test_a_tick_keeps_what_its_search_finds() -> None:
    scenario = Scenario.named("cart_pole/rigid_06")
    options = PlanOptions(renewals=8, search_steps=30, threads=1)
    x = np.array([0.86, -0.77, -0.35, 2.8])
    left = dataclasses.replace(
        scenario, initial_position=x[:2], initial_velocity=x[2:], duration=1.1
    )
    left = dataclasses.replace(left, time_step=left.duration / scenario.num_steps)
    search = MechanismSearch(make_mechanism_task(World.from_scenario(left), left, options))
    search.explore()
    found = make_horizon(Planner(left, options), False, 5, 0.02).search(0.0, x)
    # With penalties from the beginning, steps left it for none at all.
    assert found is not None and found.cost < 1.02 * search.motions[0].result.cost


def calc_spent(run: ClosedLoopRun, until: float) -> float:
    replay = run.replay
    rows = np.flatnonzero(replay.times <= until)
    held = np.searchsorted(run.control_times, replay.times[rows], side="right") - 1
    motion = replay.times[rows], replay.positions[rows], replay.velocities[rows]
    rates = TaskCost.of(run.world, run.scenario).running(*motion, run.controls[held])
    return float(np.trapezoid(rates, motion[0]))


def stand_between_walls(
    disturbance: Disturbance | None = None, **options: Any
) -> tuple[Plan, ClosedLoopRun]:
    """Returns a plan between rigid walls, and a loop that begins with it and searches no more."""
    asked = Scenario.named("cart_pole/rigid_06")
    planner = Planner(asked, PlanOptions(threads=1))
    found = planner.plan()
    given = {"surprise": np.inf, "plan": found, **options}
    controller = ModelPredictiveController(planner, 0.02, "shrinking", **given)
    return found, run_in_loop(controller, asked, planner.world, disturbance)


@pytest.mark.slow
def test_a_pole_that_nothing_disturbs_grazes_no_rigid_wall() -> None:
    """A motion that is in a wall between its knots alone promised less, and ended at 106."""
    found, run = stand_between_walls(feedback_period=0.005)
    assert run.cost < 1.01 * found.cost
    assert run.replay.bounce_contacts == tuple(each.index for each in found.best.contacts)


@pytest.mark.slow
def test_a_wall_that_is_nearer_than_anyone_knew_is_not_hit_in_passing() -> None:
    """The plan passes a wall by 0.3 mm; 6 cm nearer that was hit, and the pole ended at 174."""
    found, run = stand_between_walls(Disturbance(wall_shift=0.06), estimate=["walls"])
    assert run.cost < 1.1 * found.cost


@pytest.mark.parametrize("name", ["cart_pole/rigid_06", "cart_pole/soft_06"])
def test_walls_in_doubt_are_kept_off_where_nothing_is_to_touch_them(name: str) -> None:
    asked = Scenario.named(name)
    world, q, v = World.from_scenario(asked), np.array([0.0, np.pi]), np.zeros(2)
    goal = np.array([world.calc_signed_distance(q)[1] - 0.05, np.pi])
    asked = dataclasses.replace(asked, initial_position=q, initial_velocity=v, goal_position=goal)
    planner = Planner(asked, world=world)
    horizon, nearest = make_horizon(planner, False, 15, 0.02), []
    for doubts in ([0.0, 0.0], [0.0, 0.6]):
        wary = horizon.wary(np.array(doubts))
        motion = wary.advance(wary.rest(0.0, asked.initial_state), 0.0, asked.initial_state)
        assert motion and not motion.touches
        nearest.append(np.min(world.calc_signed_distance(motion.trajectory.positions)[:, 1]))
    assert nearest[0] < 0.1 and nearest[1] > 0.19


@pytest.mark.parametrize("doubts", [[0.0, 0.0], [0.3, 0.6]])
def test_walls_in_doubt_that_a_plan_touches_take_no_second_descent(
    doubts: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    planner, counted, solve = (
        Planner(Scenario.named("cart_pole/soft_06")),
        [],
        ShootingProblem.solve,
    )

    def count(*given: Any) -> Any:
        counted.append(1)
        return solve(*given)

    monkeypatch.setattr(ShootingProblem, "solve", count)
    horizon, x = make_horizon(planner, False, 5, 0.02), planner.scenario.initial_state
    # A plan that promises what none can keep: no other one is within what keeping off is worth.
    touches = tuple(Touch.bounce(0.5, contact) for contact in range(2))
    last = dataclasses.replace(horizon.rest(0.0, x), cost=1e-3, touches=touches)
    assert horizon.wary(np.array(doubts)).advance(last, 0.0, x)
    assert len(counted) == 1


@pytest.mark.slow
def test_what_whole_steps_lead_far_off_goes_on_at_a_rigid_wall() -> None:
    """Whatever they led to was taken, and a pendulum that is kicked ended at 29 times the cost."""
    planner = Planner(PENDULUM, PlanOptions(renewals=0, threads=1))
    found = planner.plan()
    controller = ModelPredictiveController(
        planner, 0.02, "shrinking", surprise=np.inf, plan=found, iterations=5
    )
    kicked = Disturbance(kick=np.array([-0.3]), kick_time=0.4)
    run = run_in_loop(controller, PENDULUM, planner.world, kicked)
    assert run.cost < 2 * found.cost


def test_a_mechanism_is_not_planned_for_from_inside_of_a_rigid_wall() -> None:
    planner = Planner(PENDULUM, PlanOptions(renewals=0))
    inside = np.array([-0.7, 0.0])
    assert planner.world.calc_signed_distance(inside[:1])[0] < 0
    with pytest.raises(ControlError, match="inside of a wall, expected one outside"):
        start_at(planner, inside)


SPIN_SHOT = Scenario.named("billiard/spin_shot")


@pytest.mark.slow
@pytest.mark.parametrize("method", ["tracking", "replanning"])
def test_a_ball_with_spin_is_brought_off_a_rigid_wall_with_friction(method: str) -> None:
    options = PlanOptions(renewals=0, starts=3, finalists=1, confirm=False, threads=1)
    planner = Planner(SPIN_SHOT, options)
    planned = planner.plan()
    assert planned.cost < 0.44 and len(planned.best.contacts) == 1  # 0.638 without friction
    for wrong, most in ((Disturbance(), 0.434), (Disturbance(mass_factor=1.07), 0.5)):
        controller = (
            TrackingController(planned)
            if method == "tracking"
            else ModelPredictiveController(planner, 0.02, "shrinking", surprise=np.inf)
        )
        # With the heavier ball the plan's control alone costs 0.514.
        assert run_in_loop(controller, SPIN_SHOT, planner.world, wrong).cost < most


SCENARIO = Scenario.named("cart_pole/soft_06")
UNKNOWN: Any = "mass", "stiffness", "walls"


class Counting(ModelPredictiveController):
    """One that keeps the `counts` of what each tick has called."""

    counted: Counter[str]

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.counts: list[Counter[str]] = []

    def _tick(self, context: Context, state: State) -> EventStatus:
        self.counted.clear()
        status = super()._tick(context, state)
        self.counts.append(Counter(self.counted))
        return status


@pytest.mark.slow
def test_the_work_of_a_tick_is_bounded_where_a_wall_stands_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted, beside = Counter[str](), list[str]()

    def count(of: type, name: str) -> None:
        called = getattr(of, name)

        def call(*args: Any, **options: Any) -> Any:
            is_beside = threading.current_thread() is not threading.main_thread()
            if is_beside:
                beside.append(name)
            else:
                counted[name] += 1
            return called(*args, **options)

        monkeypatch.setattr(of, name, call)

    count(MechanismSearch, "explore")
    count(ModelEstimate, "build")
    count(ShootingProblem, "solve")
    monkeypatch.setattr(Counting, "counted", counted, raising=False)
    world = World.from_scenario(SCENARIO)
    count(type(ModelEstimate.of(world, SCENARIO, UNKNOWN).models[0]), "find_end")
    planner = Planner(SCENARIO, PlanOptions(threads=1), world)
    plan = planner.plan()
    beside.clear()
    for nearer in (0.12, 0.06):  # A fifth and a tenth of its room [m].
        given: Any = {"plan": plan, "estimate": UNKNOWN, "search_ticks": "auto", "surprise": 0.05}
        controller = Counting(planner, 0.02, "shrinking", feedback_period=0.005, **given)
        run_in_loop(controller, SCENARIO, world, Disturbance(wall_shift=nearer))
        most = Counter[str]()
        for each in controller.counts:
            most |= each
        models = 1 + 2 * len(controller.estimated)
        assert most["explore"] == 0
        assert most["build"] == 1
        # A sample that surprises is looked at by all models, then by those that are built anew; by
        # models with a wall at five depths or none, and again what each of these leads to. One more
        # leads on to the end of the plan.
        assert most["find_end"] <= 2 * models + (1 + 2 * 5) + 4
        # From the last plan, from what a search has found, and each again where bounds are missed.
        assert most["solve"] <= 4
    assert "explore" in beside


@pytest.mark.slow
def test_a_tick_of_a_push_descends_twice_at_most_and_each_time_by_one_pass(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = Scenario.named("pushed_block/slide")
    world, passes = World.from_scenario(scenario), list[int]()
    planner = Planner(scenario, PlanOptions(threads=1), world)
    plan, solve = planner.plan(), ShootingProblem.solve

    def note(*args: Any, **options: Any) -> ShootingResult:
        found = solve(*args, **options)
        passes.append(found.iterations)
        return found

    monkeypatch.setattr(ShootingProblem, "solve", note)
    ends = [0]

    class Noting(ModelPredictiveController):
        def _tick(self, context: Context, state: State) -> EventStatus:
            status = super()._tick(context, state)
            ends.append(len(passes))
            return status

    given: Any = {"plan": plan, "surprise": np.inf}
    controller = Noting(planner, scenario.time_step, "shrinking", **given)
    passes.clear()
    run_in_loop(controller, scenario, world, Disturbance(friction_factor=0.8))
    assert max(np.diff(ends)) == 2
    assert max(passes) == 5
