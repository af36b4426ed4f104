"""Whoever plans, judges or tracks plain tasks alone refuses others before any work."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest
from refusals import check_refused
from replay_worlds import hold, make_scenario, shipped_world
from several_walls import make_task, shipped

from benchmarks.baselines import BASELINES, run_baseline
from benchmarks.optima import block_optimum, masses_optimum, walls_optimum
from drake_aigto import Planner, PlanOptions, Scenario, ScenarioError, World
from drake_aigto.control import track_drake, track_event_driven
from drake_aigto.paper import (
    LiteralWithForces,
    RigidWithForces,
    SingleShooting,
    bounce_costs,
    make_literal_task,
    plan_literal,
    rigid_optimum,
)
from drake_aigto.planning import make_ball_task
from drake_aigto.simulation import HeldControl
from drake_aigto.transcription import PhaseTranscription, RigidTranscription
from drake_aigto.world import Scales


def _run_baseline(name: str, world: World, task: Scenario) -> None:
    run_baseline(name, world, task, seconds=1.0)


# One field of each kind: costs, ends, bounds, contact, and time.
EXTRAS: dict[str, Any] = {
    "velocity_weight": 1.0,
    "hard_goal": True,
    "control_upper": 1.0,
    "contact": "compliant",
    "duration_range": (0.5, 2.0),
}
CONTROLLER = HeldControl(*hold(0.0))
DOORS: dict[str, Callable[[World, Scenario], Any]] = {
    "plan_literal": lambda world, task: plan_literal(task, world=world),
    "make_literal_task": make_literal_task,
    "make_ball_task": make_ball_task,
    "SingleShooting": SingleShooting,
    "LiteralWithForces": LiteralWithForces,
    "RigidWithForces": RigidWithForces,
    "RigidTranscription": RigidTranscription,
    "PhaseTranscription": PhaseTranscription,
    "rigid_optimum": rigid_optimum,
    "bounce_costs": lambda world, task: bounce_costs(world, task, [0.5], [1.0]),
    "walls_optimum": walls_optimum,
    "masses_optimum": masses_optimum,
    "block_optimum": block_optimum,
    "track_event_driven": lambda world, task: track_event_driven(world, task, CONTROLLER),
    "track_drake": lambda world, task: track_drake(world, task, CONTROLLER),
    **{name: partial(_run_baseline, name) for name in BASELINES},
}


@pytest.mark.parametrize("field", EXTRAS)
@pytest.mark.parametrize("door", DOORS)
def test_a_task_that_would_lose_something_is_refused(door: str, field: str) -> None:
    task = make_scenario(**{field: EXTRAS[field]})
    with pytest.raises(ScenarioError, match=rf"^{field}: got .* would ignore it"):
        DOORS[door](shipped_world(), task)


def test_a_planner_refuses_such_weights_for_its_next_plan_too() -> None:
    task = make_task("room", [0.3, 0.7], [0.0, 0.0], time_step=0.1)
    planner = Planner(task, PlanOptions(confirm=False), shipped("room"))
    for name in ("goal_weight", "control_weight"):
        changed: dict[str, Any] = {name: [1.0, 2.0]}
        with pytest.raises(ScenarioError, match=rf"^{name}: got \[1.0, 2.0\], expected one number"):
            planner.plan(**changed)


def test_the_command_line_refuses_what_its_planner_would_ignore(capsys: Any) -> None:
    message = "control_norm: got 9.0, expected its default, None. What plans for balls"
    words = ["--transcription", "literal", "--control-norm", "9"]
    check_refused(["plan", "table1/1", *words], message, capsys)


def test_the_unit_of_costs_of_such_a_task_is_what_it_costs_to_stay() -> None:
    world, task = shipped_world(), make_scenario(2.0, 0.0, goal_weight=3.0, duration=2.0)
    miss = 2.0 - 0.73
    assert (
        Scales.of(world, task).cost
        == 3.0 * max(miss, world.calc_signed_distance(np.array([2.0]))[0]) ** 2
    )
    weighed = dataclasses.replace(task, position_weight=5.0)
    np.testing.assert_allclose(Scales.of(world, weighed).cost, (3.0 + 2.0 * 5.0) * miss**2)
    hard = dataclasses.replace(task, hard_goal=True)
    alone = dataclasses.replace(task, goal_weight=0.0)
    assert Scales.of(world, hard).cost == Scales.of(world, alone).cost > 0
