"""For tests of studies: quick baselines, an executor in this process, and made-up results."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future
from typing import Any

import numpy as np

from benchmarks.ablations.ablations import AblationQuestion, AblationStudy
from benchmarks.baselines import Baseline, Recorder
from benchmarks.study.scenario_question import RESTITUTIONS, MethodRun, ScenarioQuestion
from benchmarks.study.scenario_study import ScenarioResult, ScenarioStudy
from drake_aigto import Scenario


class Inline(Executor):
    def __init__(self, *arguments: Any) -> None:
        self.num_jobs = 0

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        self.num_jobs += 1
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except BaseException as error:  # Interrupts, too: they are the job's.
            future.set_exception(error)
        return future


class Coast(Baseline):
    """Offers no control at all: optimal if the motion ends at its goal by itself."""

    name = "coast"

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        steps = recorder.scenario.num_steps
        times = np.linspace(0.0, recorder.scenario.duration, steps + 1)
        recorder.offer(times, np.full((steps, 1), 1.0))
        recorder.offer(times, np.zeros((steps, 1)))


class Crash(Baseline):
    name = "crash"

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        raise ZeroDivisionError("no way\nat all")


class Absent(Coast):
    """Needs what nobody has."""

    name = "absent"
    modules = ("no_such_library",)


TOYS: dict[str, Baseline] = {each.name: each for each in (Coast(), Crash(), Absent())}


def coast_or_turn(question: ScenarioQuestion, number: int) -> Scenario:
    """Returns a scenario where coasting is optimal, and one where it is not, in turn."""
    return Scenario(
        initial_position=1.0,
        initial_velocity=0.2,
        goal_position=(1.2, 0.5)[number % 2],
        restitution=RESTITUTIONS[number % 3],
        time_step=1.0 / question.num_steps,
    )


def made_up_study(
    question: ScenarioQuestion, runs: Sequence[dict[str, MethodRun]]
) -> ScenarioStudy:
    """Returns a study with these runs, all optima 1, of which every second has a contact."""
    results = (
        dataclasses.replace(ScenarioResult.of(question, i, 1.0, i % 2), runs=each)
        for i, each in enumerate(runs)
    )
    kind = AblationStudy if isinstance(question, AblationQuestion) else ScenarioStudy
    return kind(question, tuple(results))
