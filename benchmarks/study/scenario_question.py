"""What a study of random scenarios asks: which scenarios, which methods, how much time for each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from benchmarks.baselines import check_baselines
from benchmarks.study.scenario_runs import PLANNER, Runner
from benchmarks.study.spread import Spread
from benchmarks.study.study import StudyQuestion
from drake_aigto.errors import OptionsError, ScenarioError
from drake_aigto.world import Scenario, World

# Field of the question → that of a scenario. In the order in which random numbers are used.
FIELDS = {
    "start": "initial_position",
    "velocity": "initial_velocity",
    "goal": "goal_position",
    "restitution": "restitution",
    "mass": "mass",
    "duration": "duration",
}
# To try the ends of one spread with.
_USUAL = {**dict.fromkeys(FIELDS, 1.0), "velocity": 0.0}


@dataclass(frozen=True, kw_only=True)
class ScenarioQuestion(StudyQuestion):
    """Random scenarios of the point mass before a wall, and the methods that are to solve them.

    Scenario i depends on the seed, on i, and on the spreads: not on the count, the methods, or who
    works on it. Where several spreads are lists, all combinations come in turn.

    Attributes:
        count: of scenarios.
        seed: of all chance, the methods' too.
        start: p₀, the ball's distance from the wall at first [m].
        velocity: v₀, negative towards the wall [m/s].
        goal: p_f [m].
        restitution: e.
        mass: [kg].
        duration: T [s].
        num_steps: N; the time step is T / N.
        methods: "aigto" for the planner, the others are of `BASELINES`.
        budgets: multiples of a scenario's unit of time, increasing. Methods other than the planner
            are judged at each, and run for the last.
        seconds_per_unit: the unit of time [s], of one core. None: what the planner took on that
            scenario.
        reads_boxes: whether it is also told what AIGO's boxes alone say, before any polish.

    Raises:
        OptionsError: a value out of range, or a method named twice.
    """

    count: int = 500
    seed: int = 0
    start: Spread = Spread((0.2, 1.5), is_range=True)
    velocity: Spread = Spread((-3.0, 0.5), is_range=True)
    goal: Spread = Spread((0.2, 1.5), is_range=True)
    restitution: Spread = Spread((1.0, 0.8, 0.5))
    mass: Spread = Spread((1.0,))
    duration: Spread = Spread((1.0,))
    num_steps: int = 200
    methods: tuple[str, ...] = (PLANNER,)
    budgets: tuple[float, ...] = (1.0, 10.0, 100.0)
    seconds_per_unit: float | None = None
    reads_boxes: bool = False

    kind: ClassVar[str] = "scenarios"
    command: ClassVar[str] = "python -m benchmarks scenarios"
    flags: ClassVar[Mapping[str, str]] = {"num_steps": "steps", "reads_boxes": "read-boxes"}
    told: ClassVar[Sequence[str]] = ("count", "seed")

    def __post_init__(self) -> None:
        """Checks what needs neither the world nor other people's libraries."""
        for name, least in (("count", 1), ("seed", 0), ("num_steps", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise OptionsError(name, got=value, expected=f"a whole number, {least} or more")
        twice = [name for name in dict.fromkeys(self.methods) if self.methods.count(name) > 1]
        if twice or not self.methods:
            got = f"{', '.join(twice)} twice" if twice else "none"
            raise OptionsError("methods", got=got, expected="some, each once")
        self._check_times()

    @property
    def runner(self) -> Runner | None:
        """What runs a method on a scenario, without budget; None: the planner and baselines."""
        return None

    def check(self) -> None:
        """Checks the rest, which would else fail in the middle of long work.

        Raises:
            OptionsError: an unknown method, or nothing to take the unit of time from.
            MissingExtraError: a method needs a library that is not installed.
            ScenarioError: a start or goal in the wall, or another value that no scenario can have.
        """
        self._check_methods()
        self._check_spreads()

    def _check_methods(self) -> None:
        """Refuses what is no method, or can't be run."""
        try:
            check_baselines(name for name in self.methods if name != PLANNER)
        except OptionsError as error:
            expected = f"{PLANNER}, the planner, or {error.expected}"
            raise OptionsError(error.what, error.got, expected, error.remedy) from error
        if self.seconds_per_unit is None and PLANNER not in self.methods:
            raise OptionsError(
                "seconds_per_unit",
                got="none",
                expected="seconds, as the planner is not among the methods",
                remedy=f"Give seconds, or add {PLANNER}, whose time is then the unit.",
            )

    def _check_times(self) -> None:
        budgets = self.budgets
        if not budgets or not all(0.0 < budget < math.inf for budget in budgets):
            raise OptionsError("budgets", got=budgets, expected="numbers above 0")
        if any(after <= before for before, after in itertools.pairwise(budgets)):
            raise OptionsError("budgets", got=budgets, expected="increasing numbers")
        if self.seconds_per_unit is not None and not 0.0 < self.seconds_per_unit < math.inf:
            raise OptionsError(
                "seconds_per_unit", got=self.seconds_per_unit, expected="a number above 0"
            )

    def _check_spreads(self) -> None:
        """Refuses ends of spreads that no scenario can have."""
        world = World.from_scenario(usual := self._make(_USUAL))
        world.check_frictionless(usual)
        for name in FIELDS:
            spread: Spread = getattr(self, name)
            for value in spread.values:
                try:
                    scenario = self._make({**_USUAL, name: value})
                    if name in ("start", "goal"):
                        world.check(scenario)
                except ScenarioError as error:
                    raise ScenarioError(
                        f"{name} {spread}: {error.what}", error.got, error.expected, error.remedy
                    ) from error

    def scenarios(self) -> Iterator[Scenario]:
        """Yields the scenarios; the first ones do not depend on the count."""
        return map(self.scenario, range(self.count))

    def scenario(self, number: int) -> Scenario:
        """Returns the scenario of a number, 0 or more."""
        shares = np.random.default_rng((self.seed, number)).random(len(FIELDS))
        turn, values = number, {}
        for name, share in zip(FIELDS, shares.tolist(), strict=True):
            spread: Spread = getattr(self, name)
            turn, at = divmod(turn, spread.num_turns)
            values[name] = spread.pick(at, share)
        return self._make(values)

    def method_seed(self, number: int) -> int:
        """Returns the seed of the methods on a scenario, which its own numbers do not share."""
        return int(np.random.SeedSequence((self.seed, number, 1)).generate_state(1)[0])

    def _make(self, values: Mapping[str, float]) -> Scenario:
        fields: dict[str, Any] = {field: values[name] for name, field in FIELDS.items()}
        return Scenario(time_step=values["duration"] / self.num_steps, **fields)
