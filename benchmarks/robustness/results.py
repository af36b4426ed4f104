"""What became of plans under perturbations, as numbers and as a file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from benchmarks.robustness.question import RobustnessQuestion
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.study.results_file import read_results, refuse_damaged, round_to
from drake_aigto.world import Scenario
from drake_aigto.world.files import write_text

KIND = "robustness"
# Whose plan.
OURS, GRADIENT = "ours", "gradient"
# How it is carried out.
OPEN_LOOP, FEEDBACK, DRAKE = "open loop", "LQR", "LQR on Drake's plant"
# Significant digits of results.
_DIGITS = 6


class Outcome(NamedTuple):
    """What became of one plan under one perturbation."""

    cost: float  # of the control that was applied, and of the end
    goal_error: float  # ‖q(T) − goal‖ [m]
    keeps_contacts: bool  # whether the contacts are those of the plan, in its order

    @classmethod
    def from_plain(cls, data: object) -> Outcome:
        """Returns the outcome that files have as a list."""
        return cls(*from_plain(tuple[float, float, bool], data))


@dataclass(frozen=True)
class PlanResult:
    """A plan, and what became of it.

    Attributes:
        method: whose it is.
        cost: of its unperturbed replay, as all on rigid walls where nothing else is said.
        goal_error: of that [m].
        bounce_times: of that [s].
        outcomes: way to carry it out → one outcome for each perturbation.
        error: why there is no plan that can be tracked, or None.
    """

    method: str
    cost: float = float("inf")
    goal_error: float = float("inf")
    bounce_times: tuple[float, ...] = ()
    outcomes: Mapping[str, tuple[Outcome, ...]] = field(default_factory=dict)
    error: str | None = None


@dataclass(frozen=True)
class TaskResult:
    """What became of all plans for one task.

    Attributes:
        name: of the task.
        scenario: of the task.
        optimum: the exact one.
        kinds: what each perturbation is of (`Perturbation.kind`).
        optima: the exact optimum under each perturbation, for who knows of it beforehand.
        plans: one of each method.
    """

    name: str
    scenario: Scenario
    optimum: float
    kinds: tuple[str, ...]
    optima: tuple[float, ...]
    plans: tuple[PlanResult, ...]


@dataclass(frozen=True)
class RobustnessStudy:
    """A study of robustness, as far as it was run.

    Attributes:
        question: what it asks.
        results: of the tasks that are done, in the question's order.
    """

    question: RobustnessQuestion
    results: tuple[TaskResult, ...] = ()

    def with_result(self, result: TaskResult) -> RobustnessStudy:
        """Returns the study with one more task done."""
        done = {each.name: each for each in (*self.results, result)}
        names = [task.name for task in self.question.tasks()]
        return replace(self, results=tuple(done[name] for name in names if name in done))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a JSON file that `load` reads, whole or not at all.

        Raises:
            OutputFileError: the file can't be written.
        """
        write_text(path, json.dumps({"kind": KIND, **to_plain(self)}) + "\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RobustnessStudy:
        """Reads a file of results.

        Raises:
            ResultsFileError: no such file, damaged, or of another kind.
        """
        data = read_results(path, KIND)
        with refuse_damaged(path):
            return cls(
                from_plain(RobustnessQuestion, data["question"]),
                from_plain(tuple[TaskResult, ...], data["results"], "results"),
            )


def round_as_filed(value: float) -> float:
    """Returns a number with as many digits as results have."""
    return round_to(value, _DIGITS)
