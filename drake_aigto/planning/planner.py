"""The whole road: scenario → world → transcription → AIGO → polish → replay → plan."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.certify import bound_plans, out_of_reach
from drake_aigto.contact import contact_delay
from drake_aigto.errors import ModelError, OptionsError, ScenarioError, TrajectoryError
from drake_aigto.planning.balls.phases import transcribe
from drake_aigto.planning.balls.search import BallSearch
from drake_aigto.planning.balls.task import BallTask
from drake_aigto.planning.candidate import Candidate
from drake_aigto.planning.mechanisms.rigid_task import make_mechanism_task
from drake_aigto.planning.mechanisms.search import MechanismSearch
from drake_aigto.planning.mechanisms.task import MechanismTask
from drake_aigto.planning.options import PlanOptions, check_periodic, needs_shooting
from drake_aigto.planning.plans import Plan, PlanningError
from drake_aigto.planning.search import Progress, Search, Stopwatch, name_obstacles, scaled
from drake_aigto.planning.stretches import check_sizes
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import MotionProgram, OpenProgram, RigidTranscription
from drake_aigto.world import Scenario, World

# Values that `Planner.plan` may be given in place of the scenario's.
_CHANGEABLE = (
    *("initial_position", "initial_velocity", "goal_position"),
    *("control_weight", "goal_weight", "duration"),
)
# A plan found on the way is shown if this times its cost is still less than the last one's.
_WORTH_SHOWING = 1.01
# A guess ends with the task, within this part of the duration.
_LATE = 1e-6
# Candidates that an error tells of, at most.
_MOST_TOLD = 4


def plan(
    scenario: Scenario,
    options: PlanOptions | None = None,
    world: World | None = None,
    initial_guess: Trajectory | None = None,
) -> Plan:
    """Plans for a scenario: `Planner(scenario, options, world).plan(initial_guess=…)`."""
    return Planner(scenario, options, world).plan(initial_guess=initial_guess)


class Planner:
    """Walks the road from a scenario to a plan; each step is public and may be called alone.

    Args:
        scenario: the question.
        options: numerics; the defaults if None.
        world: a plant of your own (`World.from_diagram`); built from the scenario's model if None.

    Raises:
        OptionsError: an option does not count for this task, or they are no `PlanOptions`.
        ScenarioError, ModelError: the scenario does not fit the world, or the model can't be used.
    """

    def __init__(
        self, scenario: Scenario, options: PlanOptions | None = None, world: World | None = None
    ) -> None:
        """Builds the world, and checks the scenario against it; programs are compiled later."""
        if not isinstance(scenario, Scenario):
            raise ScenarioError(
                "scenario",
                got=repr(scenario)[:60],
                expected="a Scenario",
                remedy="Scenario.named finds a shipped one, Scenario.load reads a file.",
            )
        if not isinstance(options, PlanOptions | None):
            raise OptionsError(
                "options",
                got=type(options).__name__,
                expected="PlanOptions",
                remedy="Literal plans are made by drake_aigto.paper.plan_literal.",
            )
        self.world = world or World.from_scenario(scenario)
        self.scenario = scenario = self.world.place(scenario)
        self.world.check(scenario)
        _check_friction(self.world, scenario)
        check_periodic(self.world, scenario)
        self.is_of_balls = not needs_shooting(self.world, scenario)
        asked = options or PlanOptions()
        asked.check(self.is_of_balls)
        # Plans of balls keep options with their ladder.
        ladder = asked.ball_ladder if self.is_of_balls else None
        self.options = dataclasses.replace(asked, ladder=ladder)
        if self.options.confirm and scenario.contact == "rigid" and self.world.contacts:
            contact_delay(self.world)  # A wall without stiffness is refused before long work.
        self._build_clock = Stopwatch()
        with self._build_clock("build"):
            self._transcription: OpenProgram = (
                transcribe(self.world, scenario, self.options)
                if self.is_of_balls
                else MotionProgram(self.world, scenario)
            )

    @property
    def transcription(self) -> OpenProgram:
        """The program, open to costs and constraints until the first plan.

        These count wherever motions are closed, in `Plan.cost`, and in simulations, whose motion
        has to meet the constraints, too; and, for balls between rigid walls, in AIGO's boxes.
        `AddRunningCost`, `AddFinalCost` and `AddConstraintToAllKnotPoints` are about every knot of
        the plan, wherever it has them. Additions to `prog()`, on variables of `state(k)` and
        `input(k)`, are about knot k of this program: the state at its time (`GetSampleTimes`,
        `knot_at`), and the control that is held from it to the next, in plans as here. The knots of
        balls are those of AIGO's boxes (`PlanOptions.aigo_steps`), those of mechanisms the
        scenario's; where `plan` is given another duration, k/N of it.

        For mechanisms, functions are sums of products of powers, sin and cos, and each reads one
        knot; between rigid walls, or where the duration is free, every knot or the last.
        """
        return self._transcription

    @cached_property
    def task(self) -> BallTask | MechanismTask:
        """The task, compiled; no more additions from now on.

        Raises:
            ProgramError, UnsupportedTermError: an addition can't be planned; says why.
        """
        world, scenario, program = self.world, self.scenario, self._transcription
        task: BallTask | MechanismTask
        with self._build_clock("build"):
            if isinstance(program, RigidTranscription):
                task = BallTask(program, self.options, scenario.num_steps)
            else:
                additions = program.closed().additions()
                task = make_mechanism_task(world, scenario, self.options, additions)
        program.freeze()
        return task

    def plan(
        self,
        initial_position: ArrayLike | None = None,
        initial_velocity: ArrayLike | None = None,
        goal_position: ArrayLike | None = None,
        control_weight: float | None = None,
        goal_weight: float | None = None,
        duration: float | None = None,
        progress: Progress | None = None,
        initial_guess: Trajectory | None = None,
    ) -> Plan:
        """Plans for the scenario, or for a changed one, with the program that is compiled already.

        The plan is that of a new planner for the changed scenario, to the last bit; or nearly, if
        boxes are left out (`PlanOptions.exhaustive`). Programs are compiled again only if their
        structure changes: more steps, if a wall is touched sooner (`coarsen`), or motions past
        other faces of a block. Ctrl-C ends the search; the best candidate so far is returned.

        Args:
            initial_position: instead of the scenario's, shape (nq,) [m].
            initial_velocity: instead of the scenario's, shape (nv,) [m/s].
            goal_position: instead of the scenario's, shape (nq,) [m].
            control_weight: instead of the scenario's [1/(N² s)].
            goal_weight: instead of the scenario's [1/m²].
            duration: instead of the scenario's, of time steps of its length [s].
            progress: called with a line of text before each candidate, and with a `Notice` if
                machine code has to be compiled first.
            initial_guess: a motion to start from, beside all that the search proposes itself; it
                need not obey the equations of motion, nor begin at the start. Between rigid walls
                its touches are those of its impulses and forces.

        Raises:
            ScenarioError: a changed value does not fit.
            TrajectoryError: the guess is of another world, or lasts another time.
            ProgramError: additions to the program contradict each other or the start, can't be
                moved to other knots, or came after the first plan.
            UnsupportedTermError: an addition has no mean over boxes.
            PlanningError: it is proven that no motion meets the hard goal (`is_proven`), no
                candidate meets the transcription's rows, or none that does holds in simulation.
        """
        search, scenario = self._begin(
            initial_guess,
            initial_position=initial_position,
            initial_velocity=initial_velocity,
            goal_position=goal_position,
            control_weight=control_weight,
            goal_weight=goal_weight,
            duration=duration,
        )
        return run_search(search, scenario, progress)

    def plans(
        self,
        progress: Progress | None = None,
        initial_guess: Trajectory | None = None,
        **changed: Any,
    ) -> Iterator[Plan]:
        """Yields plans as the search finds better ones, and at last the plan of `plan`.

        Those before the last were judged alone, as they were found: each of them passed its
        simulations, and costs at least 1 % less than the one before. Whoever leaves the loop ends
        the search. Judging them takes time: the last plan, the same to the last bit, comes later
        than from `plan`.

        Args:
            progress: see `plan`, as for the initial guess.
            initial_guess: a motion to start from.
            changed: instead of the scenario's values, as `plan` takes them.

        Raises:
            Exceptions of `plan`; PlanningError only after all that was found.
        """
        if unknown := changed.keys() - _CHANGEABLE:
            got, known = ", ".join(sorted(unknown)), ", ".join(_CHANGEABLE)
            raise OptionsError("a changed value", got=got, expected=f"one of {known}")
        search, scenario = self._begin(initial_guess, **changed)
        promise = cost = math.inf
        for _ in search.explore_in_waves(progress):
            if not scaled(_WORTH_SHOWING, search.promise) < min(promise, cost):
                continue
            promise, tried = search.promise, search.so_far()
            tried.finish()
            with suppress(PlanningError):
                found = _conclude(tried, scenario)
                if scaled(_WORTH_SHOWING, found.cost) < cost:
                    cost = found.cost
                    yield found
        search.finish()
        yield _conclude(search, scenario)

    def _begin(self, initial_guess: Trajectory | None, **given: Any) -> tuple[Search, Scenario]:
        """Returns the search for the plan of a changed scenario, and that."""
        changed = {key: value for key, value in given.items() if value is not None}
        if changed and self.scenario.periodic is not None:  # The goal moves with the start.
            changed = {"goal_position": None, "goal_velocity": None} | changed
        scenario = dataclasses.replace(self.scenario, **changed) if changed else self.scenario
        scenario = self.world.place(scenario)
        self.world.check(scenario)
        if self.is_of_balls and self.world.lies_at_wall(scenario):
            raise ScenarioError(
                "initial_position or goal_position",
                got="one against a wall",
                expected="both away from walls, where balls are planned for by contact sequences",
                remedy="A new Planner of this scenario plans for it by shooting.",
            )
        if initial_guess is not None:
            _check_guess(self.world, scenario, initial_guess)
        _check_reach(self.world, scenario)
        _check_friction(self.world, scenario)
        check_periodic(self.world, scenario)
        self._transcription.check_frozen()
        clock, task = Stopwatch(), self.task
        if scenario is self.scenario:
            clock.seconds.update(self._build_clock.seconds)
        else:
            with clock("build"):
                task = task.again(scenario)
        search: Search
        if isinstance(task, BallTask):
            search = BallSearch(task, clock, is_again=task is not self.task)
        else:
            search = MechanismSearch(task, clock)
        search.guess = initial_guess
        return search, scenario


def _check_guess(world: World, scenario: Scenario, guess: Trajectory) -> None:
    """Refuses a guess that is of another world, or lasts another time."""
    if not isinstance(guess, Trajectory):
        raise TrajectoryError(
            "initial_guess",
            got=type(guess).__name__,
            expected="a Trajectory",
            remedy="Of a plan, give its trajectory.",
        )
    check_sizes(world, guess, "initial_guess")
    T, (begin, end) = scenario.duration, guess.times[[0, -1]]
    least, most = scenario.duration_range or (T, T)
    late = _LATE * most
    if abs(begin) > late or not least - late <= end <= most + late:
        lasts = f"{least:g} s" if least == most else f"{least:g} to {most:g} s"
        raise TrajectoryError(
            "initial_guess",
            got=f"times from {begin:g} to {end:g} s",
            expected=f"from 0 to {lasts}",
            remedy="Stretch its times, or change the scenario's duration.",
        )


def _check_friction(world: World, scenario: Scenario) -> None:
    """Refuses friction of rigid walls if no impact ends in a mode that can be planned."""
    if scenario.contact != "rigid" or world.num_velocities > 1:
        return
    friction = world.friction_coefficients(scenario)
    for contact in np.flatnonzero(friction > 0).tolist():
        raise ModelError(
            f"contact {world.contacts[contact].name}",
            got=f"friction {friction[contact]:g} and a mechanism of one coordinate",
            expected="bounces off rigid walls with friction in which sliding ends or goes on",
            remedy="Ask for contact: compliant, or leave friction out by the scenario's "
            "friction: 0 (--friction 0).",
        )


def run_search(search: Search, scenario: Scenario, progress: Progress | None = None) -> Plan:
    """Returns the plan that a search ends with: the first candidate that all replays confirm.

    Args:
        search: that has not begun.
        scenario: of the plan.
        progress: called with a line of text before each candidate.

    Raises:
        PlanningError: no candidate meets the transcription's rows, or none that does holds in
            simulation.
    """
    search.run(progress)
    return _conclude(search, scenario)


def _conclude(search: Search, scenario: Scenario) -> Plan:
    """Returns the plan of a search that was judged; raises as `run_search`."""
    search.add_idle()
    found = search.make_plan(scenario, _choose(search))
    options = search.task.options
    if isinstance(options, PlanOptions) and options.certify:
        cost = found.replay.event_driven.cost
        bound = bound_plans(search.task.world, found.scenario, cost)
        if found.best.added_costs:
            reason = "costs of your own may be of any sign"
            bound = dataclasses.replace(bound, lower_bound=None, reason=reason)
        found = dataclasses.replace(found, bound=bound)
    if not found.holds:
        raise _nothing_holds(found, search.task.sources)
    return found


def _check_reach(world: World, scenario: Scenario) -> None:
    """Refuses a hard goal that is proven to be out of reach."""
    if reason := out_of_reach(world, scenario):
        error = PlanningError(
            "it is proven that no motion meets the hard goal",
            got=reason,
            remedy="Move the goal, allow more control, another duration or higher restitution, or "
            "weigh the goal (hard_goal: false).",
        )
        error.is_proven = True
        raise error


def _choose(search: Search) -> Candidate:
    """Returns the best candidate that holds; if none does, the best."""
    best = search.find_best()
    tried = [best]
    while not search.confirm(tried[-1]):
        search.add_left_out()
        others = (other for other in search.find_feasible() if other.is_confirmed)
        untried = (other for other in others if all(other is not each for each in tried))
        if (candidate := next(untried, None)) is None:
            return best
        tried.append(candidate)
    return tried[-1]


def _nothing_holds(found: Plan, sources: str) -> PlanningError:
    """Returns the error of a search if replays contradict all candidates."""
    tried = [candidate.describe_verdict() for candidate in found.candidates[:_MOST_TOLD]]
    drake = found.replay.drake
    if drake is not None and found.best.is_confirmed:
        miss = f"{drake.goal_error:.1e} {found.find_world().position_unit}"
        tried[0] += f", in Drake {drake.cost:.2e} and {miss} off the goal"
        tried[0] += f", where it breaks {', '.join(map(repr, drake.broken))}" * bool(drake.broken)
    more = f"; {untold} more" if (untold := len(found.candidates) - len(tried)) else ""
    obstacles = name_obstacles(found.find_world(), found.scenario, found.candidates)
    error = PlanningError(
        "nothing that was planned holds in simulation",
        got=f"{len(found.candidates)} candidates from {sources} of AIGO ({'; '.join(tried)}{more})",
        expected="simulations that come near a plan's cost and goal",
        remedy=f"{obstacles}Allow more time, move the goal closer, or try another ladder.",
    )
    error.plan = found
    return error
