"""The plan, and the plan without boxes. Each process has one planner of each kind a scenario."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np

from benchmarks.robots.cart_pole import Question
from benchmarks.robots.shooting import scenario_of, world_of
from drake_aigto.errors import AigtoError
from drake_aigto.planning import MechanismOptions, Planner
from drake_aigto.simulation import replay_drake
from drake_aigto.world import Scenario

_OPTIONS = MechanismOptions(confirm=False, threads=1)
_POINTS = dataclasses.replace(
    _OPTIONS, ladder=tuple(dataclasses.replace(rung, half_width=0.0) for rung in _OPTIONS.ladder)
)


@cache
def _planner(name: str, has_boxes: bool) -> Planner:
    options = _OPTIONS if has_boxes else _POINTS
    return Planner(Scenario.named(name), options, world_of(name))


def find_plan(question: Question, has_boxes: bool) -> tuple[float, np.ndarray]:
    """Returns J that the plan promises, infinite if there is none, and its controls (N,).

    Args:
        question: where it starts.
        has_boxes: or else points in place of boxes.
    """
    scenario = scenario_of(question)
    start = scenario.initial_position, scenario.initial_velocity
    try:
        plan = _planner(question.scenario, has_boxes).plan(*start)
    except AigtoError:
        return np.inf, np.zeros(scenario.num_steps)
    return plan.cost, plan.trajectory.controls[:, 0]


def replay_in_drake(question: Question, controls: np.ndarray) -> float:
    """Returns J of controls (N,), held for equal times, on Drake's plant."""
    scenario = scenario_of(question)
    times = np.linspace(0.0, scenario.duration, controls.size + 1)
    return replay_drake(world_of(question.scenario), scenario, times, controls[:, None]).cost
