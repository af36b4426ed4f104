"""A study of random scenarios in a few numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from drake_aigto.study.method_run import PLANNER
from drake_aigto.study.scenario_results import ABSOLUTE, ScenarioResult, ScenarioStudy


@dataclass(frozen=True)
class MethodSummary:
    """How one method did on some scenarios.

    Attributes:
        method: its name.
        num_scenarios: that it is done with.
        num_optimal: of them, those whose optimum it had, for each budget.
        ratios: cost / J* in the end where J* > 1e-7 J, infinity if nothing was found; in order.
        median_seconds: of one core. A method ends when it has the optimum, or with its last budget.
        errors: the different texts of its failures.
        num_errors: how often it failed.
    """

    method: str
    num_scenarios: int
    num_optimal: tuple[int, ...]
    ratios: tuple[float, ...]
    median_seconds: float
    errors: tuple[str, ...]
    num_errors: int

    @property
    def median_ratio(self) -> float:
        """The median of the ratios, NaN without any."""
        # The lower one of two: infinity has no mean with a number.
        return self.ratios[(len(self.ratios) - 1) // 2] if self.ratios else math.nan

    @property
    def worst_ratio(self) -> float:
        """The largest of the ratios, NaN without any."""
        return self.ratios[-1] if self.ratios else math.nan


def summarize(
    study: ScenarioStudy, results: Iterable[ScenarioResult], method: str
) -> MethodSummary:
    """Returns how a method did on those of a study's results that it is done with."""
    done = [result for result in results if method in result.runs]
    runs = [result.runs[method] for result in done]
    budgets = study.question.budgets
    errors = [run.error for run in runs if run.error is not None]
    return MethodSummary(
        method=method,
        num_scenarios=len(done),
        num_optimal=tuple(
            sum(study.succeeds(result, method, budget) for result in done)
            for budget in (budgets[:1] if method == PLANNER else budgets)
        ),
        ratios=tuple(
            sorted(
                study.cost(result, method, budgets[-1]) / result.optimum
                for result in done
                if result.optimum > ABSOLUTE
            )
        ),
        median_seconds=float(np.median([run.seconds for run in runs])) if runs else math.nan,
        errors=tuple(dict.fromkeys(errors)),
        num_errors=len(errors),
    )


def count_right_boxes(
    results: Iterable[ScenarioResult], method: str = PLANNER
) -> tuple[tuple[int, ...], int, int]:
    """Returns how often a method's boxes alone have the optimum's number of contacts.

    Returns:
        Of each rung; of any rung; and of how many scenarios whose boxes were read.
    """
    read = [
        (result.contacts, result.runs[method].boxes)
        for result in results
        if method in result.runs and result.runs[method].boxes
    ]
    rungs = zip(*(boxes for _, boxes in read), strict=True)
    each = tuple(
        sum(found == exact for found, (exact, _) in zip(rung, read, strict=True)) for rung in rungs
    )
    return each, sum(exact in boxes for exact, boxes in read), len(read)
