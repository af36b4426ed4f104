"""Worlds and scenarios that are a little other than a plan was made for.

What a study of robustness asks: which tasks, how large perturbations, how many.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from benchmarks.study.scenario_question import ScenarioQuestion
from benchmarks.study.study import StudyQuestion
from drake_aigto.errors import ModelError, OptionsError, ScenarioError
from drake_aigto.paper import ROWS
from drake_aigto.world import Scenario, World

# What can be other, in the order in which random numbers are used.
QUANTITIES = ("start", "velocity", "wall", "mass", "restitution")
RANDOM = "random"


@dataclass(frozen=True)
class Perturbation:
    """By how much the truth is other than what was planned for, each as a part.

    Attributes:
        kind: which of the `QUANTITIES`, or "random" for all at once.
        start: of the first clearance φ(q(0)), by which the start is farther from the nearest wall.
        velocity: of v(0), by which it is larger.
        wall: of the first clearance, by which the nearest wall has come closer.
        mass: of the mass of the body that touches (`World.sphere_mass`), by which it is heavier.
        restitution: of the scenario's e, by which it is larger; never above 1.
    """

    kind: str
    start: float = 0.0
    velocity: float = 0.0
    wall: float = 0.0
    mass: float = 0.0
    restitution: float = 0.0

    def apply(self, world: World, scenario: Scenario) -> tuple[World, Scenario]:
        """Returns the true world and scenario.

        Lengths are parts of the clearance because coordinates have no natural zero. The wall is
        moved, rather than start and goal the other way, so that the goal and all other walls stay
        where they are; before a single wall both are the same problem in other coordinates.

        Raises:
            ScenarioError: start or goal are in a wall then.
            ModelError: the world has no single mass, no restitution of the scenario's, or a nearest
                wall that moves.
        """
        nearest, clearance = _find_nearest(world, scenario)
        J = world.calc_contact_jacobian(scenario.initial_position)[nearest]
        away = self.start * clearance * J / (J @ J)
        true_world = world
        if self.mass:
            true_world = World.from_diagram(world.diagram, world.sphere_mass * (1 + self.mass))
        if self.wall:
            true_world = true_world.with_wall_moved(nearest, self.wall * clearance)
        if self.restitution:
            _check_restitution(world)
        true_scenario = dataclasses.replace(
            scenario,
            initial_position=scenario.initial_position + away,
            initial_velocity=scenario.initial_velocity * (1 + self.velocity),
            mass=true_world.mass,
            restitution=min(1.0, scenario.restitution * (1 + self.restitution)),
        )
        true_world.check(true_scenario)
        return true_world, true_scenario


def perturb_one_at_a_time(size: float, scenario: Scenario) -> list[Perturbation]:
    """Returns every quantity once larger and once smaller by a part of it.

    No wall returns more than it gets: of e = 1 there is only less, and of e = 0 there is no part.
    """
    found = [
        Perturbation(name, **{name: sign * size}) for name in QUANTITIES for sign in (1.0, -1.0)
    ]
    e = scenario.restitution
    return [
        each for each in found if each.kind != "restitution" or (e > 0 and e + each.restitution < 1)
    ]


def perturb_at_random(size: float, count: int, seed: int) -> list[Perturbation]:
    """Returns perturbations of everything at once, each evenly within ± a part.

    The first ones do not depend on the count.
    """
    parts = np.random.default_rng(seed).uniform(-size, size, (count, len(QUANTITIES)))
    return [
        Perturbation(RANDOM, **dict(zip(QUANTITIES, row, strict=True))) for row in parts.tolist()
    ]


def _find_nearest(world: World, scenario: Scenario) -> tuple[int, float]:
    """Returns the contact that the start is nearest to, and its clearance [m]."""
    q = scenario.initial_position
    solid = int(np.argmin(world.calc_clearance(q)))
    distances = world.calc_signed_distance(q)
    face = max(world.solids[solid], key=distances.__getitem__)
    return face, float(distances[face])


def _check_restitution(world: World) -> None:
    """Refuses walls whose restitution is not the scenario's."""
    for contact in world.contacts:
        if contact.restitution is not None:
            raise ModelError(
                f"restitution of {contact.name}",
                got=f"{contact.restitution:g}, the model's own",
                expected="the scenario's",
                remedy="Take it out of the model.",
            )


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
