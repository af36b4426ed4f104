"""What a study of robustness asks: which tasks, how large perturbations, how many."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from benchmarks.robustness.perturbation import (
    Perturbation,
    perturb_at_random,
    perturb_one_at_a_time,
)
from benchmarks.study.scenario_question import ScenarioQuestion
from benchmarks.study.study import StudyQuestion
from drake_aigto.errors import OptionsError, ScenarioError
from drake_aigto.paper import ROWS
from drake_aigto.world import Scenario, World


class Task(NamedTuple):
    """A scenario, by name."""

    name: str
    scenario: Scenario


@dataclass(frozen=True, kw_only=True)
class RobustnessQuestion(StudyQuestion):
    """Rows of Table I at several restitutions, random scenarios besides, and perturbations.

    Attributes:
        rows: of Table I.
        restitutions: e, each with every row.
        scenarios: how many random ones besides, those that `ScenarioQuestion` has by default.
        percent: how much each quantity is other at most.
        samples: how many random perturbations of everything at once.
        seed: of these and of the scenarios.
        confirm: whether feedback is also tried on Drake's compliant plant.

    Raises:
        OptionsError: a value out of range, a row that there is not, or no task.
    """

    rows: tuple[int, ...] = ROWS
    restitutions: tuple[float, ...] = (1.0, 0.8, 0.5)
    scenarios: int = 0
    percent: float = 1.0
    samples: int = 20
    seed: int = 0
    confirm: bool = True

    kind: ClassVar[str] = "robustness"
    command: ClassVar[str] = "python -m benchmarks robustness"
    flags: ClassVar[Mapping[str, str]] = {"confirm": "no-confirm"}
    told: ClassVar[Sequence[str]] = ("percent", "seed")

    def __post_init__(self) -> None:
        """Checks what needs no world."""
        for name in ("scenarios", "samples", "seed"):
            value = getattr(self, name)
            if not isinstance(value, int) or value < 0:
                raise OptionsError(name, got=value, expected="a whole number, 0 or more")
        if unknown := [row for row in self.rows if row not in ROWS]:
            expected = f"some of {', '.join(map(str, ROWS))}"
            raise OptionsError("rows", got=", ".join(map(str, unknown)), expected=expected)
        for e in self.restitutions:
            if not 0.0 <= e <= 1.0:
                raise OptionsError("restitutions", got=e, expected="numbers from 0 to 1")
        if not (math.isfinite(self.percent) and self.percent > 0):
            raise OptionsError("percent", got=self.percent, expected="a number above 0")
        if not self.scenarios and not (self.rows and self.restitutions):
            raise OptionsError("rows", got="none", expected="some, or random scenarios")

    def check(self) -> None:
        """Checks that every task can bear the perturbations.

        Raises:
            OptionsError: so large that a start or goal would be in the wall, or a mass nothing.
        """
        size = self.percent / 100
        worst = Perturbation("", start=-size, wall=size, mass=-size)
        for task in self.tasks():
            try:
                worst.apply(World.from_scenario(task.scenario), task.scenario)
            except ScenarioError as error:
                raise OptionsError(
                    f"percent, for {task.name}",
                    got=f"{self.percent:g}, by which {error.what}: {error.got}",
                    expected=error.expected,
                    remedy="Perturb by less.",
                ) from error

    def tasks(self) -> list[Task]:
        """Returns the tasks, in the order that they are shown."""
        found = [
            Task(f"table1/{row}, e = {e:g}", dataclasses.replace(scenario, restitution=e))
            for row in self.rows
            for scenario in (Scenario.named(f"table1/{row}"),)
            for e in self.restitutions
        ]
        if self.scenarios:
            random = ScenarioQuestion(count=self.scenarios, seed=self.seed).scenarios()
            found += [
                Task(f"random {number}, e = {scenario.restitution:g}", scenario)
                for number, scenario in enumerate(random)
            ]
        return found

    def perturbations(self, scenario: Scenario) -> list[Perturbation]:
        """Returns what a scenario is tried with; the random ones are the same for all."""
        size = self.percent / 100
        return [
            *perturb_one_at_a_time(size, scenario),
            *perturb_at_random(size, self.samples, self.seed),
        ]
