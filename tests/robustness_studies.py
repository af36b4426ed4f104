"""A study of robustness with made-up results: nothing is planned or replayed."""

from __future__ import annotations

from benchmarks.robustness.question import QUANTITIES, RANDOM, RobustnessQuestion
from benchmarks.robustness.study import (
    DRAKE,
    FEEDBACK,
    GRADIENT,
    OPEN_LOOP,
    OURS,
    Outcome,
    PlanResult,
    TaskResult,
)
from drake_aigto import Scenario

QUESTION = RobustnessQuestion(rows=(1, 2), restitutions=(1.0,), samples=2)


def make_result(name: str, kinds: tuple[str, ...] = (*QUANTITIES, RANDOM, RANDOM)) -> TaskResult:
    outcomes = tuple(Outcome(1e-3 * (i + 1), 1e-3, i != 1) for i in range(len(kinds)))
    ways = {OPEN_LOOP: outcomes, FEEDBACK: outcomes, DRAKE: outcomes}
    plans = (PlanResult(OURS, 1e-3, 1e-3, (0.5,), ways), PlanResult(GRADIENT, 2e-3, 0, (), ways))
    scenario = Scenario.named("table1/1")
    return TaskResult(
        name, scenario, 9e-4, kinds, tuple(outcome.cost for outcome in outcomes), plans
    )
