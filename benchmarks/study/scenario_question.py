"""One method on one scenario: what it is asked, and what it did.

What a study of random scenarios asks: which scenarios, which methods, how much time for each.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import shlex
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Context
from functools import cache, lru_cache
from typing import Any, ClassVar, TypeAlias

import numpy as np

from benchmarks.baselines import check_baselines, run_baseline
from drake_aigto.errors import OptionsError
from drake_aigto.paper import RigidOptimum, rigid_optimum
from drake_aigto.plain import to_plain
from drake_aigto.planning import Plan, Planner, PlanOptions
from drake_aigto.world import Scenario, World

PLANNER = "aigto"
OPTIONS = PlanOptions(confirm=False, threads=1)
# The same, with the boxes of every rung and every candidate, whether or not they can win.
EXHAUSTIVE = dataclasses.replace(OPTIONS, exhaustive=True)
# Significant digits in files: of costs so that ratios near 1 are still told apart.
COST_DIGITS, _SECONDS_DIGITS = 7, 4
# What a process does at first is not measured: it loads libraries and kernels. [s]
_WARM_UP = 0.2


@dataclass(frozen=True)
class MethodRun:
    """What one method did on one scenario.

    Attributes:
        improvements: seconds of one core since it began, and the cost then, by event-driven replay
            on the rigid wall; each cheaper than the one before. Only those that were the best when
            a budget ended, and the last.
        seconds: of one core, that it took.
        evaluations: how many controls were replayed; of the planner, how many candidates it had.
        error: what it failed with, if it did.
        boxes: of the planner, if the question asks: the number of contacts in the last box of each
            rung, before any polish.
    """

    improvements: tuple[tuple[float, float], ...]
    seconds: float
    evaluations: int = 0
    error: str | None = None
    boxes: tuple[int, ...] = ()

    @property
    def cost(self) -> float:
        """The best; infinity if nothing was found."""
        return self.cost_within(math.inf)

    def cost_within(self, seconds: float) -> float:
        """Returns the best after these seconds, infinity if there was none."""
        return min((cost for at, cost in self.improvements if at <= seconds), default=math.inf)

    def thinned(self, ends: Iterable[float]) -> MethodRun:
        """Returns this run as files have it: what was best at these times, and in the end.

        Times are rounded down, so that what was in time still is.
        """
        kept = {}
        for end in (*ends, math.inf):
            for at, cost in [each for each in self.improvements if each[0] <= end][-1:]:
                kept[round_to(at, _SECONDS_DIGITS, down=True)] = round_to(cost, COST_DIGITS)
        seconds = round_to(self.seconds, _SECONDS_DIGITS)
        return MethodRun(
            tuple(sorted(kept.items())), seconds, self.evaluations, self.error, self.boxes
        )


@dataclass(frozen=True)
class Job:
    """One method on one scenario.

    Attributes:
        scenario: the task.
        method: "aigto", or a baseline's name.
        seconds: of one core that a baseline has.
        good_enough: the cost at which a baseline may stop.
        seed: of a baseline.
        reads_boxes: whether it is kept what the planner's boxes say without any polish.
        runner: what runs it, if not the planner or a baseline; a function of a module, so that it
            can be sent to another process.
    """

    scenario: Scenario
    method: str
    seconds: float = 0.0
    good_enough: float = -math.inf
    seed: int = 0
    reads_boxes: bool = False
    runner: Runner | None = None


Runner: TypeAlias = Callable[[World, Job], MethodRun]


def run_job(job: Job) -> MethodRun:
    """Returns what a method made of a scenario, and be it an error.

    Time is the CPU time of this process, after the method has run here once.
    """
    start = time.process_time()
    try:
        _warm_up(job.method if job.runner is None else PLANNER)
        world = _make_world(job.scenario.mass)
        run = (job.runner or _run_method)(world, job)
    except Exception as error:  # Whatever it is, this is how the method did.
        text = f"{type(error).__name__}: {error}"
        run = MethodRun((), time.process_time() - start, error=text)
    return run


def find_optimum(scenario: Scenario) -> RigidOptimum:
    """Returns the exact optimum, which no job knows."""
    return rigid_optimum(_make_world(scenario.mass), scenario)


def _run_method(world: World, job: Job) -> MethodRun:
    if job.method != PLANNER:
        run = run_baseline(job.method, world, job.scenario, job.seconds, job.seed, job.good_enough)
        return MethodRun(run.improvements, run.seconds, run.evaluations)
    start = time.process_time()
    plan = Planner(job.scenario, OPTIONS, world).plan()
    seconds = time.process_time() - start
    cost = plan.replay.event_driven.cost
    boxes: tuple[int, ...] = ()
    if job.reads_boxes:
        boxes = read_boxes(Planner(job.scenario, EXHAUSTIVE, world).plan())
    return MethodRun(((seconds, cost),), seconds, len(plan.candidates), boxes=boxes)


def read_boxes(plan: Plan) -> tuple[int, ...]:
    """Returns how many contacts the last box of each rung shows, for a plan with all rungs."""
    return tuple(count for count in plan.stats.box_contacts if count is not None)


@lru_cache(maxsize=4)
def _make_world(mass: float | None) -> World:
    """Returns the world of all scenarios with this mass, made once a process."""
    return World.from_scenario(dataclasses.replace(Scenario.named("table1/1"), mass=mass))


@cache
def _warm_up(method: str) -> None:
    """Runs a method once in this process."""
    scenario = Scenario.named("table1/1")
    world = _make_world(scenario.mass)
    if method == PLANNER:
        Planner(scenario, OPTIONS, world).plan()
    else:
        run_baseline(method, world, scenario, _WARM_UP)


# What is drawn evenly, in this order: a scenario's field, from, to [m, m/s].
RANGES = {
    "initial_position": (0.2, 1.5),
    "initial_velocity": (-3.0, 0.5),
    "goal_position": (0.2, 1.5),
}
RESTITUTIONS = (1.0, 0.8, 0.5)  # in turn
_DRAWS = 6  # of chance for each scenario, as there once were more ranges


@dataclass(frozen=True, kw_only=True)
class ScenarioQuestion:
    """Random scenarios of the point mass before a wall, and the methods that are to solve them.

    Scenario i depends on the seed and on i: not on the count, the methods, or who works on it.

    Attributes:
        count: of scenarios.
        seed: of all chance, the methods' too.
        num_steps: N; the time step is 1 s / N.
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
    num_steps: int = 200
    methods: tuple[str, ...] = (PLANNER,)
    budgets: tuple[float, ...] = (1.0, 10.0, 100.0)
    seconds_per_unit: float | None = None
    reads_boxes: bool = False

    kind: ClassVar[str] = "scenarios"  # of files with answers
    command: ClassVar[str] = "python -m benchmarks scenarios"
    # Field → flag, where they differ.
    flags: ClassVar[Mapping[str, str]] = {"num_steps": "steps", "reads_boxes": "read-boxes"}
    # What `command_of` tells even where it is as usual.
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
        """
        try:
            check_baselines(name for name in self.methods if name != PLANNER)
        except OptionsError as error:
            expected = f"{PLANNER}, the planner, or {error.expected}"
            raise OptionsError(error.what, expected=expected, hint=error.hint) from error
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

    def scenarios(self) -> Iterator[Scenario]:
        """Yields the scenarios; the first ones do not depend on the count."""
        return map(self.scenario, range(self.count))

    def scenario(self, number: int) -> Scenario:
        """Returns the scenario of a number, 0 or more."""
        shares = np.random.default_rng((self.seed, number)).random(_DRAWS).tolist()
        drawn: dict[str, Any] = {
            name: low + share * (high - low)
            for (name, (low, high)), share in zip(RANGES.items(), shares, strict=False)
        }
        e = RESTITUTIONS[number % len(RESTITUTIONS)]
        return Scenario(time_step=1.0 / self.num_steps, restitution=e, mass=1.0, **drawn)

    def method_seed(self, number: int) -> int:
        """Returns the seed of the methods on a scenario, which its own numbers do not share."""
        return int(np.random.SeedSequence((self.seed, number, 1)).generate_state(1)[0])


def command_of(question: ScenarioQuestion) -> str:
    """Returns the command line that asks a question."""
    words = [question.command]
    asked, usual = to_plain(question), to_plain(type(question)())
    for name, value in asked.items():
        if value == usual[name] and name not in question.told:
            continue
        words.append(f"--{question.flags.get(name, name).replace('_', '-')}")
        if isinstance(value, list):
            words.extend(shlex.quote(_as_word(each)) for each in value)
        elif not isinstance(value, bool):
            words.append(_as_word(value))
    return " ".join(words)


def _as_word(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def round_to(value: float, digits: int, down: bool = False) -> float:
    """Returns a number with that many significant digits, as files of results have them.

    It is the nearest one, or the next towards 0; what is not finite stays as it is.
    """
    if not math.isfinite(value):
        return value
    rounding = ROUND_DOWN if down else ROUND_HALF_EVEN
    return float(Context(prec=digits, rounding=rounding).create_decimal(repr(float(value))))
