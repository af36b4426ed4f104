"""How much a tick of the controller that plans again may do, in counts."""

from __future__ import annotations

import threading
from collections import Counter
from typing import Any

import numpy as np
import pytest
from pydrake.systems.framework import Context, EventStatus, State

from drake_aigto import ModelPredictiveController, Planner, PlanOptions, Scenario, World
from drake_aigto.control import Disturbance, ModelEstimate, run_in_loop
from drake_aigto.planning import MechanismSearch
from drake_aigto.shooting import ShootingProblem, ShootingResult

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
