"""What methods made of random scenarios: as numbers, as a file, and in few words."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from drake_aigto.errors import ResultsFileError
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.study.method_run import COST_DIGITS, PLANNER, MethodRun
from drake_aigto.study.results_file import read_results, refuse_damaged, round_to
from drake_aigto.study.scenario_question import FIELDS, ScenarioQuestion
from drake_aigto.world import Scenario
from drake_aigto.world.files import write_text

# A method succeeds with a cost of at most so much more than the optimum: relative and absolute.
RELATIVE, ABSOLUTE = 0.01, 1e-7
DIED = "its process died"


def calc_good_enough(optimum: float) -> float:
    """Returns the cost that counts as success, 1.01 J* + 1e-7."""
    return (1.0 + RELATIVE) * optimum + ABSOLUTE


@dataclass(frozen=True)
class ScenarioResult:
    """One scenario, its exact optimum, and what the methods made of it.

    Attributes:
        number: of the scenario in its study.
        scenario: the task.
        optimum: J*, by `rigid_optimum`, which no method knows.
        contacts: of the optimum: 0 for a flight, 1 for a bounce.
        runs: by method; those that are done.
    """

    number: int
    scenario: Scenario
    optimum: float
    contacts: int
    runs: Mapping[str, MethodRun] = field(default_factory=dict)

    @property
    def good_enough(self) -> float:
        """The cost that counts as success."""
        return calc_good_enough(self.optimum)

    @property
    def planner_seconds(self) -> float | None:
        """What the planner took [s]; None while it is not done."""
        run = self.runs.get(PLANNER)
        return None if run is None or run.error == DIED else run.seconds


@dataclass(frozen=True)
class ScenarioStudy:
    """A question, and the answers so far.

    Attributes:
        question: which scenarios and methods.
        results: of the scenarios that any method is done with, by number.
    """

    question: ScenarioQuestion
    results: tuple[ScenarioResult, ...] = ()

    @property
    def is_complete(self) -> bool:
        """Whether every method is done with every scenario."""
        asked = self.question.count * len(self.question.methods)
        return sum(len(result.runs) for result in self.results) == asked

    def unit(self, result: ScenarioResult) -> float | None:
        """Returns the unit of time on a scenario [s]; None while the planner is not done."""
        return self.question.seconds_per_unit or result.planner_seconds

    def cost(self, result: ScenarioResult, method: str, budget: float) -> float:
        """Returns the best cost of a method after so many units of time.

        The planner's is what it ends with: its budget is what it takes.
        """
        run, unit = result.runs[method], self.unit(result)
        return run.cost if method == PLANNER or unit is None else run.cost_within(budget * unit)

    def succeeds(self, result: ScenarioResult, method: str, budget: float) -> bool:
        """Returns whether a method has the optimum after so many units of time."""
        return self.cost(result, method, budget) <= result.good_enough

    def of_method(self, method: str) -> Iterator[ScenarioResult]:
        """Yields the results of scenarios that a method is done with."""
        return (result for result in self.results if method in result.runs)

    def groups(self) -> dict[str, tuple[ScenarioResult, ...]]:
        """Returns the results by restitution, if that is listed; else all in one group."""
        spread = self.question.restitution
        if spread.is_range:
            return {f"e = {spread}": self.results}
        return {
            f"e = {value:g}": tuple(
                each for each in self.results if each.scenario.restitution == value
            )
            for value in dict.fromkeys(spread.values)
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a file that `load` reads, whole or not at all, a line for each scenario.

        Raises:
            OutputFileError: it can't be written.
        """
        head = {"kind": self.question.kind, "question": to_plain(self.question)}
        lines = ",\n".join(json.dumps(to_plain(_Line.of(each))) for each in self.results)
        text = json.dumps(head, indent=1).removesuffix("\n}")
        write_text(path, f'{text},\n "results": [\n{lines}\n]}}\n')

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], question_type: type[ScenarioQuestion] = ScenarioQuestion
    ) -> ScenarioStudy:
        """Reads the file that `save` wrote, of a type of questions.

        Raises:
            ResultsFileError: no such file, damaged, or of other scenarios than are drawn now.
        """
        data = read_results(path, question_type.kind)
        with refuse_damaged(path):
            question = from_plain(question_type, data["question"])
            lines = from_plain(tuple[_Line, ...], data["results"], "results")
        results = tuple(line.result(question) for line in lines)
        for result, line in zip(results, lines, strict=True):
            if _Line.of(result) != line:
                raise ResultsFileError(
                    f"results file {path}",
                    got=f"other numbers for scenario {result.number} than are drawn now",
                    remedy="Another version of this package wrote it.",
                )
        return cls(question, results)


@dataclass(frozen=True)
class _Line:
    """A result as files have it: the scenario is drawn again, and its rounded numbers compared."""

    number: int
    start: float
    velocity: float
    goal: float
    restitution: float
    mass: float
    duration: float
    optimum: float
    contacts: int
    runs: Mapping[str, MethodRun]

    @classmethod
    def of(cls, result: ScenarioResult) -> _Line:
        """Returns the line of a result."""
        values = {name: getattr(result.scenario, field) for name, field in FIELDS.items()}
        task = {name: round_to(np.ravel(value)[0], COST_DIGITS) for name, value in values.items()}
        return cls(
            number=result.number,
            optimum=result.optimum,
            contacts=result.contacts,
            runs=result.runs,
            **task,
        )

    def result(self, question: ScenarioQuestion) -> ScenarioResult:
        """Returns the result of the scenario that the question has under this number."""
        scenario = question.scenario(self.number)
        return ScenarioResult(self.number, scenario, self.optimum, self.contacts, self.runs)


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
    optima = [result for result in done if result.optimum > ABSOLUTE]
    ratios = [study.cost(each, method, budgets[-1]) / each.optimum for each in optima]
    return MethodSummary(
        method=method,
        num_scenarios=len(done),
        num_optimal=tuple(
            sum(study.succeeds(result, method, budget) for result in done)
            for budget in (budgets[:1] if method == PLANNER else budgets)
        ),
        ratios=tuple(sorted(ratios)),
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
