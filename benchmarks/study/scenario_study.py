"""How often, and how fast, methods find the global optimum of random scenarios."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np

from benchmarks.study.scenario_question import (
    COST_DIGITS,
    PLANNER,
    RESTITUTIONS,
    Job,
    MethodRun,
    ScenarioQuestion,
    find_optimum,
    round_to,
    run_job,
)
from drake_aigto.errors import AigtoError, ResultsFileError
from drake_aigto.plain import from_plain, read_json, to_plain, write_text

# A method succeeds with a cost of at most this much more than the optimum: relative and absolute.
RELATIVE, ABSOLUTE = 0.01, 1e-7
_Self = TypeVar("_Self", bound="ScenarioStudy")


def calc_good_enough(optimum: float) -> float:
    """Returns the cost that counts as success, 1.01 J* + 1e-7."""
    return (1.0 + RELATIVE) * optimum + ABSOLUTE


@dataclass(frozen=True)
class ScenarioResult:
    """One scenario, its exact optimum, and what the methods made of it.

    Attributes:
        number: of the scenario in its study.
        start, velocity, goal, restitution: of the scenario, to the digits of files.
        optimum: J*, by `rigid_optimum`, which no method knows.
        contacts: of the optimum: 0 for a flight, 1 for a bounce.
        runs: by method; those that are done.
    """

    number: int
    start: float
    velocity: float
    goal: float
    restitution: float
    optimum: float
    contacts: int
    runs: Mapping[str, MethodRun] = field(default_factory=dict)

    @classmethod
    def of(
        cls, question: ScenarioQuestion, number: int, optimum: float, contacts: int
    ) -> ScenarioResult:
        """Returns the result of a question's scenario before any run."""
        scenario = question.scenario(number)
        ends = scenario.initial_position, scenario.initial_velocity, scenario.goal_position
        start, velocity, goal = (round_to(float(each[0]), COST_DIGITS) for each in ends)
        return cls(number, start, velocity, goal, scenario.restitution, optimum, contacts)

    @property
    def good_enough(self) -> float:
        """The cost that counts as success."""
        return calc_good_enough(self.optimum)

    @property
    def planner_seconds(self) -> float | None:
        """What the planner took [s]; None while it is not done."""
        run = self.runs.get(PLANNER)
        return run.seconds if run else None


def answer(asked: tuple[ScenarioQuestion, int]) -> ScenarioResult:
    """Returns what all methods make of one scenario.

    The planner goes first, as its time is the unit of the others' budgets.
    """
    question, number = asked
    scenario = question.scenario(number)
    exact = find_optimum(scenario)
    optimum, contacts = round_to(exact.cost, COST_DIGITS), len(exact.bounce_times)
    result = ScenarioResult.of(question, number, optimum, contacts)
    runs: dict[str, MethodRun] = {}
    unit = question.seconds_per_unit or 0.0
    for method in sorted(question.methods, key=lambda each: each != PLANNER):
        job = Job(
            scenario,
            method,
            seconds=question.budgets[-1] * unit,
            good_enough=result.good_enough,
            seed=question.method_seed(number),
            reads_boxes=question.reads_boxes,
            runner=question.runner,
        )
        runs[method] = run_job(job)
        unit = unit or runs[method].seconds
    ends = [budget * unit for budget in question.budgets]
    return replace(result, runs={name: runs[name].thinned(ends) for name in question.methods})


@dataclass(frozen=True)
class ScenarioStudy:
    """All methods on all scenarios: a question, and the results that there are, in their order."""

    question: ScenarioQuestion
    results: tuple[ScenarioResult, ...] = ()

    question_type: ClassVar[Any] = ScenarioQuestion

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a file that `load` reads, whole or not at all, a line for each result.

        Raises:
            OutputFileError: it can't be written.
        """
        head = {"kind": self.question.kind, "question": to_plain(self.question)}
        lines = ",\n".join(json.dumps(to_plain(each)) for each in self.results)
        text = json.dumps(head, indent=1).removesuffix("\n}")
        write_text(path, f'{text},\n "results": [\n{lines}\n]}}\n')

    @classmethod
    def load(cls: type[_Self], path: str | os.PathLike[str]) -> _Self:
        """Reads the file that `save` wrote.

        Raises:
            ResultsFileError: no such file, damaged, of another kind, or of other scenarios than are
                drawn now.
        """
        data = read_results(path, cls.question_type.kind)
        with refuse_damaged(path):
            question = from_plain(cls.question_type, data["question"])
            kind: Any = tuple[ScenarioResult, ...]
            results: Any = from_plain(kind, data["results"], "results")
        study = cls(question, results)
        for result in study.results:
            drawn = ScenarioResult.of(
                study.question, result.number, result.optimum, result.contacts
            )
            if replace(drawn, runs=result.runs) != result:
                raise ResultsFileError(
                    f"results file {path}",
                    got=f"other numbers for scenario {result.number} than are drawn now",
                    remedy="Another version of this package wrote it.",
                )
        return study

    @property
    def num_runs(self) -> int:
        """How many runs there are."""
        return sum(len(result.runs) for result in self.results)

    @property
    def num_asked(self) -> int:
        """How many runs are asked for."""
        return self.question.count * len(self.question.methods)

    @property
    def is_complete(self) -> bool:
        """Whether every method is done with every scenario."""
        return self.num_runs == self.num_asked

    def unit(self, result: ScenarioResult) -> float | None:
        """Returns the unit of time on a scenario [s]; None while the planner is not done."""
        return self.question.seconds_per_unit or result.planner_seconds

    def cost(self, result: ScenarioResult, method: str, budget: float) -> float:
        """Returns the best cost of a method after a number of units of time.

        The planner's is what it ends with: its budget is what it takes.
        """
        run, unit = result.runs[method], self.unit(result)
        return run.cost if method == PLANNER or unit is None else run.cost_within(budget * unit)

    def succeeds(self, result: ScenarioResult, method: str, budget: float) -> bool:
        """Returns whether a method has the optimum after a number of units of time."""
        return self.cost(result, method, budget) <= result.good_enough

    def of_method(self, method: str) -> Iterator[ScenarioResult]:
        """Yields the results of scenarios that a method is done with."""
        return (result for result in self.results if method in result.runs)

    def groups(self) -> dict[str, tuple[ScenarioResult, ...]]:
        """Returns the results by restitution."""
        return {
            f"e = {value:g}": tuple(each for each in self.results if each.restitution == value)
            for value in RESTITUTIONS
        }


@dataclass(frozen=True)
class MethodSummary:
    """How one method did on some scenarios.

    Attributes:
        num_scenarios: that it is done with.
        num_optimal: of them, those whose optimum it had, for each budget.
        ratios: cost / J* in the end where J* > 1e-7 J, infinity if nothing was found; in order.
        median_seconds: of one core. A method ends when it has the optimum, or with its last budget.
        errors: the different texts of its failures.
        num_errors: how often it failed.
    """

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
    optima = [result for result in done if result.optimum > ABSOLUTE]
    return MethodSummary(
        num_scenarios=len(done),
        num_optimal=tuple(
            sum(study.succeeds(result, method, budget) for result in done)
            for budget in (budgets[:1] if method == PLANNER else budgets)
        ),
        ratios=tuple(sorted(study.cost(r, method, budgets[-1]) / r.optimum for r in optima)),
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


def read_results(path: str | os.PathLike[str], kind: str | None = None) -> dict[str, Any]:
    """Returns what is in a results file: a JSON object with a field "kind", of any kind if None.

    Raises:
        ResultsFileError: no such file, damaged, or of another kind.
    """
    data = read_json(path, "results file", ResultsFileError)
    found = data.get("kind") if isinstance(data, dict) else None
    if not isinstance(found, str) or kind not in (None, found):
        raise ResultsFileError(
            f"results file {path}",
            got=f"kind {found!r}",
            expected=f"kind {kind!r}" if kind else 'an object with a field "kind"',
        )
    return data


@contextmanager
def refuse_damaged(path: str | os.PathLike[str]) -> Iterator[None]:
    """Reports what is wrong with the values of a results file as its damage.

    Raises:
        ResultsFileError: something was missing, of the wrong type, or out of range.
    """
    try:
        yield
    except (AigtoError, KeyError, TypeError) as error:
        raise ResultsFileError(
            f"results file {path} is damaged",
            got=f"no {error}" if isinstance(error, KeyError) else error,
            remedy="Delete it, and measure again.",
        ) from error
