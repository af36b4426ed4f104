"""How often, and how fast, methods find the global optimum of random scenarios."""

from __future__ import annotations

import json
import logging
import math
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np

from benchmarks.study import scenario_question
from benchmarks.study.scenario_question import (
    COST_DIGITS,
    PLANNER,
    RESTITUTIONS,
    Job,
    MethodRun,
    ScenarioQuestion,
    find_optimum,
    round_to,
)
from drake_aigto.errors import AigtoError, ResultsFileError
from drake_aigto.jobs import ProcessDiedError, open_jobs
from drake_aigto.output import check_writable, write_text
from drake_aigto.plain import from_plain, read_json, to_plain
from drake_aigto.progress import Count

# A method succeeds with a cost of at most this much more than the optimum: relative and absolute.
RELATIVE, ABSOLUTE = 0.01, 1e-7
DIED = "its process died"
_SECONDS_BETWEEN_SAVES = 5.0
_LOG = logging.getLogger(__name__)
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
        return None if run is None or run.error == DIED else run.seconds


@dataclass(frozen=True)
class ScenarioStudy:
    """All methods on all scenarios: a question, and the results so far, in their order.

    The planner goes first on each scenario, as its time is the unit of the others' budgets. Jobs
    whose processes died are tried again when it is gone on from.
    """

    question: ScenarioQuestion
    results: tuple[ScenarioResult, ...] = ()

    question_type: ClassVar[Any] = ScenarioQuestion

    def run(
        self: _Self,
        path: str | os.PathLike[str] | None = None,
        *,
        resume: bool = False,
        executor: AbstractContextManager[Executor] | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> _Self:
        """Runs all jobs that are not done, and returns the study with what came of them.

        What is done is written every few seconds, and at the end, whatever that is: Ctrl-C, a
        crash, a pool that broke.

        Args:
            path: of the results; None keeps them in memory only.
            resume: go on from the results that are there.
            executor: where jobs run, entered once all is checked; `open_workers`, with a process a
                core, if None. Its processes should have one thread each.
            progress: called with a line of text after each job.

        Raises:
            OptionsError, MissingExtraError, ScenarioError: from `check` of the question.
            OutputFileError: the results can't be written.
            ResultsFileError: there are results and they are not to be gone on from; or they are
                damaged or another study's.
            StudyError: from `open_workers`; or the executor broke.
        """
        self.question.check()
        study = self.resumed(path) if path and check_results_file(path, resume) else self
        done = {result.number: result for result in study.results}
        begun: set[tuple[int, str]] = set()

        def so_far() -> _Self:
            return replace(study, results=tuple(done[number] for number in sorted(done)))

        with open_jobs(executor) as jobs:

            def start(number: int) -> None:
                for job in study._jobs(number, done.get(number)):
                    if (number, job.method) not in begun:
                        begun.add((number, job.method))
                        jobs.start((number, job.method), scenario_question.run_job, job)

            saved = time.monotonic()
            try:
                for number in range(self.question.count):
                    start(number)
                for (number, method), future in jobs.ended():
                    done[number] = study._taken(number, done.get(number), method, future)
                    _LOG.info("%s, %s: done", number, method)
                    start(number)
                    if path and time.monotonic() - saved > _SECONDS_BETWEEN_SAVES:
                        so_far().save(path)
                        saved = time.monotonic()
                    if progress:
                        progress(so_far().progress())
            finally:
                if path and done:
                    so_far().save(path)
        return so_far()

    def _jobs(self, number: int, result: ScenarioResult | None) -> Iterator[Job]:
        """Yields the jobs of methods whose time is known and that are not done."""
        question, scenario = self.question, self.question.scenario(number)
        runs = result.runs if result else {}
        unit = question.seconds_per_unit or (result.planner_seconds if result else None)
        for method in question.methods:
            if method in runs and runs[method].error != DIED:
                continue
            job = Job(number, scenario, method, reads_boxes=question.reads_boxes)
            if question.runner is not None:
                job = replace(job, runner=question.runner)
            elif method != PLANNER:
                if unit is None:
                    continue
                good_enough = (result or self._new(number)).good_enough
                seconds, seed = question.budgets[-1] * unit, question.method_seed(number)
                job = replace(job, seconds=seconds, good_enough=good_enough, seed=seed)
            yield job

    def _new(self, number: int) -> ScenarioResult:
        exact = find_optimum(self.question.scenario(number))
        optimum, contacts = round_to(exact.cost, COST_DIGITS), len(exact.bounce_times)
        return ScenarioResult.of(self.question, number, optimum, contacts)

    def _taken(
        self, number: int, result: ScenarioResult | None, method: str, future: Future[MethodRun]
    ) -> ScenarioResult:
        """Returns the result with a run more, and be it that its process died."""
        result = result or self._new(number)
        try:
            run = future.result()
        except ProcessDiedError:
            run = MethodRun((), 0.0, error=DIED)
        unit = self.unit(result) or 0.0
        thinned = run.thinned(budget * unit for budget in self.question.budgets)
        runs = {**result.runs, method: thinned}
        in_order = {name: runs[name] for name in self.question.methods if name in runs}
        return replace(result, runs=in_order)

    def progress(self) -> Count:
        """Returns in a line how much is done, and how often each method has found the optimum."""
        counts = []
        for method in self.question.methods:
            done = list(self.of_method(method))
            solved = sum(
                self.succeeds(result, method, self.question.budgets[-1]) for result in done
            )
            counts.append(f"{method} {solved}/{len(done)}")
        return Count(self.num_runs, self.num_asked, f"runs; optimal: {', '.join(counts)}")

    def resumed(self: _Self, path: str | os.PathLike[str]) -> _Self:
        """Returns this study with the results of a file, of fewer scenarios and methods perhaps.

        Raises:
            ResultsFileError: the file is damaged, or another study's.
        """
        known = self.load(path)
        here, there = to_plain(self.question), to_plain(known.question)
        if known.question.count <= self.question.count:
            there["count"] = here["count"]
        if set(known.question.methods) <= set(self.question.methods):
            there["methods"] = here["methods"]
        check_same_question(path, there, here)
        return replace(self, results=known.results)

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


def check_results_file(path: str | os.PathLike[str] | None, resume: bool = False) -> bool:
    """Returns whether there is a file to go on from; None, for no file, passes.

    Raises:
        OutputFileError: the file can't be written.
        ResultsFileError: there is one, and nobody asked to go on from it.
    """
    check_writable(path)
    if path is None or not Path(path).exists():
        return False
    if not resume:
        raise ResultsFileError(
            f"results file {path}",
            got="one that exists",
            remedy="Go on from it (--resume), name another, or delete it first.",
        )
    return True


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


def check_same_question(
    path: str | os.PathLike[str], there: Mapping[str, Any], here: Mapping[str, Any]
) -> None:
    """Refuses to go on from results whose question's fields are others than those asked for here.

    Raises:
        ResultsFileError: says which fields differ.
    """
    names = [name for name in {**here, **there} if there.get(name) != here.get(name)]
    if names:
        raise ResultsFileError(
            f"results file {path} is of another study",
            got=", ".join(f"{name} {there.get(name)}" for name in names),
            expected=", ".join(f"{name} {here.get(name)}" for name in names),
            remedy="Name another file, or ask the same question.",
        )
