"""How much plans suffer where the truth is a little other than they were made for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

from benchmarks.robustness.question import RobustnessQuestion, Task
from benchmarks.study.study import Call, Study, round_to
from drake_aigto.errors import AigtoError
from drake_aigto.local import as_program, solve_with_drake
from drake_aigto.paper import rigid_optimum
from drake_aigto.plain import from_plain
from drake_aigto.planning import Arcs, Feedback, PhaseProblem, Planner, PlanOptions
from drake_aigto.progress import Count
from drake_aigto.simulation import DRAKE as DRAKES_PLANT
from drake_aigto.simulation import (
    EVENT_DRIVEN,
    Replay,
    find_contacts,
    replay_event_driven,
    replay_with,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

_OPTIONS = PlanOptions(confirm=False, threads=1)
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
class RobustnessStudy(Study[RobustnessQuestion, TaskResult]):
    """Plans for all tasks, each replayed under all perturbations."""

    question_type: ClassVar[Any] = RobustnessQuestion
    result_type: ClassVar[Any] = TaskResult

    def order(self) -> list[str]:
        """Returns the names of the tasks."""
        return [task.name for task in self.question.tasks()]

    def key_of(self, result: TaskResult) -> str:
        """Returns its name."""
        return result.name

    def calls(self, key: str, result: TaskResult | None) -> Iterator[Call]:
        """Yields the job of a task that is not done."""
        if result is None:
            (task,) = (each for each in self.question.tasks() if each.name == key)
            yield Call("", run_task, (task, self.question))

    def taken(
        self, key: str, result: TaskResult | None, name: str, future: Future[TaskResult]
    ) -> TaskResult:
        """Returns what a task's job found."""
        return future.result()

    def progress(self) -> Count:
        """Returns how many tasks are done."""
        return Count(len(self.results), len(self.order()), "tasks done")


def run_task(task: Task, question: RobustnessQuestion) -> TaskResult:
    """Plans for one task, both ways, and replays the plans under its perturbations."""
    scenario, perturbations = task.scenario, question.perturbations(task.scenario)
    world = World.from_scenario(scenario)
    truths = [perturbation.apply(world, scenario) for perturbation in perturbations]
    planners = {OURS: _plan, GRADIENT: plan_without_contact}
    return TaskResult(
        name=task.name,
        scenario=scenario,
        optimum=round_as_filed(rigid_optimum(world, scenario).cost),
        kinds=tuple(perturbation.kind for perturbation in perturbations),
        optima=tuple(round_as_filed(rigid_optimum(*truth).cost) for truth in truths),
        plans=tuple(
            _judge(method, make_plan, world, scenario, truths, question)
            for method, make_plan in planners.items()
        ),
    )


def _plan(world: World, scenario: Scenario) -> Trajectory:
    return Planner(scenario, _OPTIONS, world).plan().trajectory


def plan_without_contact(world: World, scenario: Scenario) -> Trajectory:
    """Returns what IPOPT makes of exact flight with φ ≥ 0, from the straight line: no contact.

    It is what gradient solvers find for AIGTO's Table I: brake, turn, accelerate.
    """
    phases = PhaseProblem(world, scenario)
    arcs = Arcs(phases, range(phases.num_steps))
    guess = arcs.vector(phases.guess())
    return arcs.trajectory(solve_with_drake(as_program(arcs.nlp), guess, "ipopt"))


def _judge(
    method: str,
    make_plan: Callable[[World, Scenario], Trajectory],
    world: World,
    scenario: Scenario,
    truths: list[tuple[World, Scenario]],
    question: RobustnessQuestion,
) -> PlanResult:
    """Returns what becomes of a plan, or why there is none that can be tracked."""
    try:
        plan = make_plan(world, scenario)
        controller = Feedback(world, scenario, plan)
    except AigtoError as error:
        return PlanResult(method, error=str(error))
    control = plan.times, plan.controls
    contacts = tuple(contact.index for contact in find_contacts(world, plan))
    nominal = replay_event_driven(world, scenario, *control)
    runs: dict[str, Callable[[World, Scenario], Replay]] = {
        OPEN_LOOP: lambda world, scenario: replay_event_driven(world, scenario, *control),
        FEEDBACK: lambda world, scenario: replay_with(EVENT_DRIVEN, world, scenario, controller),
    }
    if question.confirm:
        runs[DRAKE] = lambda world, scenario: replay_with(DRAKES_PLANT, world, scenario, controller)
    return PlanResult(
        method,
        round_as_filed(nominal.cost),
        round_as_filed(nominal.goal_error),
        tuple(map(round_as_filed, nominal.bounce_times)),
        {
            name: tuple(_summarize(run(*truth), contacts) for truth in truths)
            for name, run in runs.items()
        },
    )


def _summarize(replay: Replay, contacts: tuple[int, ...]) -> Outcome:
    return Outcome(
        round_as_filed(replay.cost),
        round_as_filed(replay.goal_error),
        replay.bounce_contacts == contacts,
    )


def round_as_filed(value: float) -> float:
    """Returns a number with as many digits as results have."""
    return round_to(value, _DIGITS)
