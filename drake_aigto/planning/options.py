"""Options of planning: numerics only. Physics and task belong to the Scenario."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from drake_aigto.errors import OptionsError, ScenarioError, check_counts
from drake_aigto.transcription import CONTACT, DYNAMICS, FLIGHT, NONPENETRATION, RESTITUTION

if TYPE_CHECKING:
    from drake_aigto.world import Scenario, World

StartName = Literal["line", "coast"]

# Goals of motions that repeat are the start's by this part of them, or in m and rad.
_SAME_GOAL = 1e-9


@dataclass(frozen=True)
class Rung:
    """One start of AIGO: its temperature, and weights of rows while boxes shrink.

    Weights and temperature are in units of the transcription's `cost_scale`.

    Attributes:
        temperature: first temperature μ of the annealing; other algorithms have none.
        weights: constraint name → weight of its penalty r²/dt.
        others: weight of rows not named there, such as those of users.
        start: the center of the first box: "line", the straight line from start to goal, up to
            the walls; or `"coast"`, the uncontrolled motion in simulation, with a box that is
            narrow at first and wider with time.
    """

    temperature: float
    weights: Mapping[str, float]
    others: float = 1.0
    start: StartName = "line"

    def __post_init__(self) -> None:
        """Checks the start."""
        if self.start not in (known := get_args(StartName)):
            raise OptionsError("start", got=repr(self.start), expected=f"one of {known}")

    def describe(self, algorithm: str) -> str:
        """Returns an algorithm's start here, in words; only "annealing" has a temperature."""
        weights = ", ".join(f"{name} {weight:g}" for name, weight in self.weights.items())
        hot = f" from temperature {self.temperature:g}" if algorithm == "annealing" else ""
        return f"{algorithm}{hot}; around the {self.start}; weights {weights}"


def _rigid_rung(temperature: float, restitution: float, start: StartName = "line") -> Rung:
    weights = {FLIGHT: 3e2, DYNAMICS: 3e2, CONTACT: 3e2, RESTITUTION: restitution}
    return Rung(temperature, {**weights, NONPENETRATION: 3e3}, others=3e2, start=start)


# Hot boxes with a light restitution row find the wall, whether a bounce pays or not; cold ones with
# a heavy row, which wide boxes with impulses violate, find the free flight; the rung in between
# often finds the better one. Only the polish shows which is best. Between several walls, boxes
# around the straight line contain every sequence at once and lose all of them; those around the
# uncontrolled motion keep its bounces, or one more or fewer near the end.
BALL_LADDER = (
    _rigid_rung(3.0, 2.0),
    _rigid_rung(0.5, 5.0),
    _rigid_rung(0.03, 1000.0),
    _rigid_rung(0.1, 50.0, "coast"),
    _rigid_rung(1.0, 5.0, "coast"),
)


LocalSolverName = Literal["newton", "ipopt", "snopt"]

# Transcription → its options, by name, as the paper's modules import this one.
_KINDS = {
    "rigid": "drake_aigto.planning.options:PlanOptions",
    "literal": "drake_aigto.paper.planner:LiteralOptions",
    "shooting": "drake_aigto.planning.options:PlanOptions",
}
# Options that count for one kind of task only.
_OF_BALLS = ("ladder", "local_solver", "relaxation", "aigo_steps", "exhaustive", "branches")
_OF_MECHANISMS = ("starts", "renewals", "patience", "search_steps", "search_substeps", "seed")


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Numerics of any search for a plan.

    Attributes:
        local_solver: refines AIGO's results where they are solutions of programs: "newton"
            (`local.InteriorPoint`), or "ipopt" or "snopt" through Drake.
        finalists: how many of the best candidates are improved.
        threads: how many starts run in parallel, in threads of this process: plans are the same to
            the last bit. None: one per core if that pays, else one.
        confirm: whether the plan is also replayed on Drake's plant; the independent replay is
            always run.
    """

    local_solver: LocalSolverName = "newton"
    finalists: int = 2
    threads: int | None = None
    confirm: bool = True

    def __post_init__(self) -> None:
        """Checks what does not depend on the task."""
        self._check_choice("local_solver", get_args(LocalSolverName))
        check_counts(self, finalists=1)
        if self.threads is not None and self.threads < 1:
            raise OptionsError("threads", got=self.threads, expected="1 or more, or None")

    @property
    def num_threads(self) -> int:
        """The requested threads, or one per core."""
        if self.threads is not None:
            return self.threads
        if hasattr(os, "sched_getaffinity"):  # Not on macOS.
            return len(os.sched_getaffinity(0))
        return os.cpu_count() or 1

    @staticmethod
    def kind_of(transcription: str) -> type[SearchOptions]:
        """Returns the options that a transcription has, by its name in files.

        Raises:
            OptionsError: there is no such transcription.
        """
        if transcription not in _KINDS:
            known = ", ".join(_KINDS)
            raise OptionsError("transcription", got=repr(transcription), expected=f"one of {known}")
        kind: type[SearchOptions] = resolve_name(_KINDS[transcription])
        return kind

    def _check_choice(self, name: str, known: tuple[str, ...]) -> None:
        if (got := getattr(self, name)) not in known:
            raise OptionsError(name, got=repr(got), expected=f"one of {', '.join(known)}")


@dataclass(frozen=True, kw_only=True)
class PlanOptions(SearchOptions):
    """Numerics of a plan, for every world.

    Some count only for balls between rigid walls, others only for any other task, a mechanism's;
    where they do not count, only their defaults are accepted.

    Attributes:
        ladder: balls: the starts of AIGO, from each of which candidates come; None: `BALL_LADDER`;
            (): none, and no program is compiled for boxes: candidates come from a guess that is
            given, the uncontrolled motion, and neighbors of both.
        finalists: how many of the best candidates are improved; for mechanisms at most: fewer if
            the next ones promise no lower cost than those found, and not to the end if they cost
            more.
        certify: whether a lower bound of all plans is found, too (`Plan.lower_bound`), or the
            reason why there is none.
        local_solver: balls: see `SearchOptions`, as for threads and confirm. Threads pay where
            boxes are of a thousand variables or more; for less, starting them takes longer than it
            saves.
        relaxation: balls: ε of the complementarity φ p = dt ε, which the wall pushes from afar with
            while boxes shrink (`RigidTranscription`).
        aigo_steps: balls: number of time steps of boxes: coarse ones show the contact sequence, and
            the last refinement, of finalists, has the scenario's. Candidates are judged with as
            many or more; only the plan itself has the scenario's if these are fewer, or one per
            phase.
        exhaustive: balls: whether planning again runs boxes, too, where contacts determine a plan
            and one is found without them (`BallSearch.vary`), and flights refined that cost too
            much (`BallSearch.add`).
        branches: balls: number of candidates with neighbors tried, with one bounce more or fewer.
        starts: mechanisms: how many guesses of motions are closed first; in space up to eight more,
            with contact that is hardly smoothed.
        renewals: mechanisms: how many more guesses are closed at most, near the best motions and
            around other starts in turn.
        patience: mechanisms: there are no more renewals once as many would find less than one
            better motion, by an estimate from how often the best ones were found
            (`MechanismSearch.chance`).
        search_steps: mechanisms: number of time steps of candidates, at most; finalists have the
            scenario's.
        search_substeps: mechanisms: number of Runge-Kutta steps in each of these, at least. The
            search itself takes as many as resolve springs, and shorter ones once errors of the
            best motion's steps add up (`MechanismTask.is_coarse`).
        seed: mechanisms: of random draws.
    """

    ladder: tuple[Rung, ...] | None = field(default=None, repr=False)
    certify: bool = False
    relaxation: float = 1e-4
    aigo_steps: int = 50
    exhaustive: bool = False
    branches: int = 3
    starts: int = 12
    renewals: int = 240
    patience: int = 280
    search_steps: int = 60
    search_substeps: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks what does not depend on the task."""
        super().__post_init__()
        check_counts(self, aigo_steps=1, branches=0, starts=1, renewals=0, patience=1, seed=0)
        check_counts(self, search_steps=2, search_substeps=1)
        if not 0 <= self.relaxation < float("inf"):
            raise OptionsError("relaxation", got=self.relaxation, expected="a number, 0 or more")

    @property
    def ball_ladder(self) -> tuple[Rung, ...]:
        """The starts of AIGO for balls."""
        return BALL_LADDER if self.ladder is None else self.ladder

    def check(self, is_of_balls: bool) -> None:
        """Refuses options that do not count for a task, of balls between rigid walls or another.

        Raises:
            OptionsError: an option is not at its default, or a rung is none.
        """
        tasks = "balls between rigid walls", "a mechanism"
        task, other = tasks if is_of_balls else tasks[::-1]
        names = _OF_MECHANISMS if is_of_balls else _OF_BALLS
        defaults = {each.name: each.default for each in dataclasses.fields(self)}
        for name in names:
            if (got := getattr(self, name)) != defaults[name]:
                raise OptionsError(
                    name,
                    got=f"{got} for {task}",
                    expected=f"the default, {defaults[name]}",
                    remedy=f"It counts only for {other}: leave it out here.",
                )
        for each in self.ladder or ():
            if not isinstance(each, Rung):
                raise OptionsError(
                    "ladder", got=f"a {type(each).__name__} for {task}", expected="every one a Rung"
                )


def check_periodic(world: World, scenario: Scenario) -> None:
    """Refuses a motion that should repeat where that is not planned for."""
    if scenario.periodic is None:
        return
    if scenario.contact == "rigid" and world.contacts:
        raise ScenarioError(
            "periodic",
            got="rigid walls",
            expected="contact: compliant, or a model in which nothing can touch",
            remedy="Between rigid walls, and for balls, motions begin where they are given.",
        )
    v, speed = scenario.initial_velocity, scenario.goal_velocity
    assert speed is not None, "the world placed it"
    way = world.subtract(scenario.goal_position, scenario.initial_position)
    off = np.concatenate([way - np.nan_to_num(world.find_advance(scenario)), speed - v])
    if np.any(np.abs(off) > _SAME_GOAL * (1 + np.abs(np.concatenate([way, v])))):
        raise ScenarioError(
            "goal_position or goal_velocity",
            got=f"{scenario.goal_position.tolist()}, {speed.tolist()}",
            expected="the start, advanced by what periodic says",
            remedy="Leave them out.",
        )


def needs_shooting(world: World, scenario: Scenario) -> bool:
    """Returns whether a task is more than one of balls between rigid walls.

    It is where a joint turns or has limits, M or J depends on q, there is friction, contact is
    compliant, nothing can touch, start or goal lies at a wall, or the task is not AIGTO's
    (`Scenario.is_plain`).
    """
    is_ball = bool(world.contacts) and world.has_constant_inertia and not world.is_hinge.any()
    is_free = is_ball and not world.limits.are_any and not world.lies_at_wall(scenario)
    has_friction = scenario.contact == "rigid" and world.friction_coefficients(scenario).any()
    return not (is_free and not has_friction and scenario.is_plain)
