"""The plan, and the plan without boxes. Each process has one planner of each kind a world."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from benchmarks.robots.judge import Control
from benchmarks.robots.shooting import world_of
from benchmarks.robots.worlds import Question, scenario_of
from drake_aigto.errors import AigtoError
from drake_aigto.planning import Planner, PlanOptions
from drake_aigto.simulation import replay_drake

_OPTIONS = PlanOptions(confirm=False, threads=1)
_POINTS = dataclasses.replace(
    _OPTIONS,
    ladder=tuple(dataclasses.replace(rung, half_width=0.0) for rung in _OPTIONS.mechanism_ladder),
)


@cache
def _planner(world: str, restitution: float, has_boxes: bool) -> Planner:
    scenario = dataclasses.replace(scenario_of(Question(world, 0)), restitution=restitution)
    return Planner(scenario, _OPTIONS if has_boxes else _POINTS, world_of(world))


def find_plan(question: Question, has_boxes: bool) -> tuple[float, Control]:
    """Returns J that the plan promises, infinite if there is none, and its control.

    Args:
        question: where it starts.
        has_boxes: or else points in place of boxes.
    """
    scenario, world = scenario_of(question), world_of(question.world)
    try:
        plan = _planner(question.world, scenario.restitution, has_boxes).plan(
            scenario.initial_position,
            scenario.initial_velocity,
            scenario.goal_position,
            duration=scenario.duration,
        )
    except AigtoError:
        nothing = np.zeros((1, world.num_actuators))
        return np.inf, Control.even(nothing, scenario.duration)
    return plan.cost, Control(plan.trajectory.times, plan.trajectory.controls)


def replay_in_drake(question: Question, control: Control) -> float:
    """Returns J of a control on Drake's plant."""
    return replay_drake(world_of(question.world), scenario_of(question), *control).cost
