"""What became of plans under perturbations, as numbers and as a file."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from benchmarks.robustness.question import RobustnessQuestion
from drake_aigto.study.results_file import read_results, refuse_damaged, round_to
from drake_aigto.world import Scenario
from drake_aigto.world.files import write_text

KIND = "robustness"
# Whose plan.
OURS, GRADIENT = "ours", "gradient"
# How it is carried out.
OPEN_LOOP, FEEDBACK, DRAKE = "open loop", "LQR", "LQR on Drake's plant"
# Significant digits in files.
_DIGITS = 6


class Outcome(NamedTuple):
    """What became of one plan under one perturbation."""

    cost: float  # of the control that was applied, and of the end
    goal_error: float  # ‖q(T) − goal‖ [m]
    keeps_contacts: bool  # whether the contacts are those of the plan, in its order


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

    def to_dict(self) -> dict[str, Any]:
        """Returns plain JSON values, rounded."""
        if self.error is not None:
            return {"method": self.method, "error": self.error}
        return {
            "method": self.method,
            "cost": _round(self.cost),
            "goal_error": _round(self.goal_error),
            "bounce_times": [_round(time) for time in self.bounce_times],
            "outcomes": {
                name: [[_round(cost), _round(miss), kept] for cost, miss, kept in outcomes]
                for name, outcomes in self.outcomes.items()
            },
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> PlanResult:
        """Returns the result that `to_dict` gave."""
        parts = {
            "bounce_times": tuple(data.get("bounce_times", ())),
            "outcomes": {
                name: tuple(Outcome(*outcome) for outcome in outcomes)
                for name, outcomes in data.get("outcomes", {}).items()
            },
        }
        return cls(**{**data, **parts})


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

    def to_dict(self) -> dict[str, Any]:
        """Returns plain JSON values, rounded."""
        return {
            "name": self.name,
            "scenario": self.scenario.to_dict(),
            "optimum": _round(self.optimum),
            "kinds": list(self.kinds),
            "optima": [_round(optimum) for optimum in self.optima],
            "plans": [plan.to_dict() for plan in self.plans],
        }

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TaskResult:
        """Returns the result that `to_dict` gave."""
        parts = {
            "scenario": Scenario.from_dict(data["scenario"]),
            "kinds": tuple(data["kinds"]),
            "optima": tuple(data["optima"]),
            "plans": tuple(map(PlanResult.from_dict, data["plans"])),
        }
        return cls(**{**data, **parts})


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

    def to_dict(self) -> dict[str, Any]:
        """Returns plain JSON values, rounded."""
        return {
            "kind": KIND,
            "question": self.question.to_dict(),
            "results": [result.to_dict() for result in self.results],
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a JSON file that `load` reads, whole or not at all.

        Raises:
            OutputFileError: the file can't be written.
        """
        write_text(path, json.dumps(self.to_dict()) + "\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> RobustnessStudy:
        """Reads a file of results.

        Raises:
            ResultsFileError: no such file, damaged, or of another kind.
        """
        data = read_results(path, KIND)
        with refuse_damaged(path):
            return cls(
                RobustnessQuestion.from_dict(data["question"]),
                tuple(map(TaskResult.from_dict, data["results"])),
            )


def _round(value: float) -> float:
    return round_to(value, _DIGITS)
