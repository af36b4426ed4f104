"""Methods on the same questions with the same seconds, all judged by the same judge."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, suppress
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from benchmarks.robots.judge import Control, judge
from benchmarks.robots.known import find_known, keep, load_known
from benchmarks.robots.methods import METHODS, PLANS, Attempt
from benchmarks.robots.plans import replay_in_drake
from benchmarks.robots.results import Comparison, Outcome, Results, Row, Step
from benchmarks.robots.worlds import WORLDS, Question
from drake_aigto.count import Count
from drake_aigto.jobs import Jobs, open_jobs
from drake_aigto.plain import to_plain
from drake_aigto.study.results_file import check_results_file, check_same_question, round_to

_DIGITS = 6
_LEAST = 1.0  # CPU seconds of a peer where plans take less
_WARM_UP = 0.5  # seconds of a method that count for nothing: libraries load, kernels compile


class Found(NamedTuple):
    """What a method found, and its best control."""

    outcome: Outcome
    control: Control | None


def run_comparison(
    comparison: Comparison,
    path: str | os.PathLike[str] | None = None,
    *,
    resume: bool = False,
    executor: AbstractContextManager[Executor] | None = None,
    progress: Callable[[str], None] | None = None,
    refresh: bool = False,
    minutes: float = math.inf,
) -> Results:
    """Runs all methods on all questions; what is done is written after each question.

    Args:
        comparison: what to run.
        path: of the results; None keeps them in memory only.
        resume: go on from the results that are there.
        executor: where questions are answered, each in a process of one thread.
        progress: called with a line of text after each question.
        refresh: whether what is better than the best known takes its place.
        minutes: after which what is not answered is left out.

    Raises:
        OutputFileError: the results can't be written.
        ResultsFileError: there are results and they are not to be gone on from; or they are damaged
            or another comparison's.
    """
    results = Results(comparison)
    if path and check_results_file(path, resume):
        results = Results.load(path)
        check_same_question(path, to_plain(results.question), to_plain(comparison))
    # One of each world at first: time may be up.
    asked = sorted(comparison.questions(), key=lambda each: each.number)
    questions = {(each.world, each.number): each for each in asked}
    done = {(row.world, row.number) for row in results.rows}
    known = load_known()
    with open_jobs(executor) as jobs:
        for key, question in questions.items():
            if key not in done:
                jobs.start(key, answer, question, comparison, find_known(known, question).cost)
        for key, future in _until(jobs, minutes):
            row, found = future.result()
            results = results.with_row(row)
            if refresh:
                _refresh(questions[key], found)
            if path:
                results.save(path)
            if progress:
                progress(Count(len(results.rows), len(questions), "questions answered"))
    return results


def _until(jobs: Jobs, minutes: float) -> Iterator[tuple[Any, Future[Any]]]:
    """Yields jobs as they end, until time is up."""
    with suppress(TimeoutError):
        yield from jobs.ended(60.0 * minutes)


def _refresh(question: Question, controls: dict[str, Control]) -> None:
    """Keeps what is better than the best known."""
    before = known = find_known(load_known(), question)
    for name, each in controls.items():
        known = known.offered(question, name, each)
    if known is not before:
        keep(question, known)


def answer(
    question: Question, comparison: Comparison, known: float
) -> tuple[Row, dict[str, Control]]:
    """Returns what all methods make of a question, and the best control of each."""
    outcomes: list[Outcome] = []
    controls: dict[str, Control] = {}
    for name in comparison.methods_for(question.world):
        warm = _first_alike(question.world) if name in PLANS else question.world
        _warm_up(name, warm, question.is_tuning)
        seconds = math.inf
        if name not in PLANS:
            seconds = comparison.seconds or max(_LEAST, outcomes[0].cpu)
        found = run_method(name, question, seconds)
        outcomes.append(found.outcome)
        if found.control is not None:
            controls[name] = found.control
    return Row(question.world, question.number, question.is_deep, known, tuple(outcomes)), controls


def _first_alike(world: str) -> str:
    """Returns the first world between walls of the same kind: plans there run the same code."""
    kind = WORLDS[world].is_soft, WORLDS[world].is_rigid
    return next(name for name, each in WORLDS.items() if (each.is_soft, each.is_rigid) == kind)


@cache
def _warm_up(name: str, world: str, is_tuning: bool) -> None:
    """Has a method load and compile what it needs, once in a process."""
    _run(name, Question(world, 0, is_tuning), _WARM_UP)


class _Timed(NamedTuple):
    """Attempts that are each better than those before, with the CPU seconds until then."""

    better: list[tuple[float, Attempt]]
    cpu: float
    wall: float
    attempts: int


def _run(name: str, question: Question, seconds: float) -> _Timed:
    """Runs a method until no attempt may start any more; the last one may end later."""
    better: list[tuple[float, Attempt]] = []
    best, count = math.inf, 0
    cpu, wall = time.process_time(), time.perf_counter()
    for attempt in METHODS[name].run(question, 0):
        spent = time.process_time() - cpu
        count += 1
        if attempt.promised < best:
            best = attempt.promised
            better.append((spent, attempt))
        if spent > seconds:
            break
    return _Timed(better, time.process_time() - cpu, time.perf_counter() - wall, count)


def run_method(name: str, question: Question, seconds: float) -> Found:
    """Returns what a method finds in these CPU seconds, judged."""
    timed = _run(name, question, seconds)
    scores = [judge(question, attempt.control).score for _, attempt in timed.better]
    best = int(np.argmin(scores)) if scores else None
    control = None if best is None or math.isinf(scores[best]) else timed.better[best][1].control
    outcome = Outcome(
        method=name,
        steps=tuple(
            Step(round(spent, 4), _rounded(score))
            for (spent, _), score in zip(timed.better, scores, strict=True)
        ),
        cpu=round(timed.cpu, 4),
        wall=round(timed.wall, 4),
        attempts=timed.attempts,
        promised=_rounded(timed.better[-1][1].promised) if timed.better else math.inf,
        drake=None
        if name not in PLANS or control is None
        else _rounded(replay_in_drake(question, control)),
    )
    return Found(outcome, control)


def _rounded(cost: float) -> float:
    return round_to(cost, _DIGITS) if math.isfinite(cost) else math.inf
