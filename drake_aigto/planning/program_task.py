"""A transcription, compiled for AIGO and for the local solvers: the road's steps one by one."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, TypeAlias

import numpy as np

from drake_aigto.aigo import AigoResult, Algorithm, Box, Iterate, minimize, raise_penalties
from drake_aigto.arrays import Floats
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import OptionsError
from drake_aigto.local import (
    InteriorPoint,
    LocalResult,
    PolynomialNlp,
    as_program,
    compile_nlp,
    solve_with_drake,
)
from drake_aigto.planning.candidate import (
    LARGEST_DEFECT,
    NO_CONTROL,
    Candidate,
    Origin,
    Replays,
    add_to_replay,
    calc_defects,
    read_motion,
    sample,
)
from drake_aigto.planning.options import Rung, SearchOptions, StartName
from drake_aigto.planning.programs import CompiledPrograms, Solution, check_added_rows
from drake_aigto.simulation import (
    Replay,
    find_contacts,
    max_penetration,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Transcription, calc_cost, largest_defect
from drake_aigto.world import Scales, Scenario, World

_LOG = logging.getLogger(__name__)

# Touches, or whatever the task counts as contacts; () is a free flight.
ContactSequence: TypeAlias = tuple[Any, ...]

# Of the local solver; a candidate that needs more has vanishing phases.
_MAX_ITERATIONS = 200
# A box around the uncontrolled motion has this part of the first box's size at the end.
_COAST_SHARE = 0.2
# Boxes with at least this many variables are worth a thread.
_MANY = 1000
# How often knots are doubled, at most, until springs and dampers agree with the midpoint rule of
# the rows of plans.
_MOST_DOUBLINGS = 5
# An impact this part of the duration before a knot is on it, but for rounding.
_ON_KNOT = 1e-12


@dataclass(frozen=True, eq=False)
class Start:
    """A start of AIGO."""

    transcription: Transcription  # the constrained program
    polynomial: BoxPolynomial  # its penalized cost
    box: Box  # the first box
    row_names: tuple[str, ...]  # of the penalized rows


class ProgramTask(ABC):
    """A task as a program over knots, compiled for AIGO and for the local solvers.

    Earlier additions to the transcription count. Subclasses define contact sequences and their
    polish.

    Attributes:
        transcription: the constrained program, as AIGO takes it (`OpenProgram.closed`).
        additions: of users.
        options: numerics.
        ladder: the starts of AIGO.
    """

    # Its name in plan files.
    transcription_name: ClassVar[str]

    # Of the local solver's cost, in `cost_scale`, in turn until it converges.
    _cost_units: tuple[float, ...] = (1.0,)

    def __init__(
        self,
        transcription: Transcription,
        options: SearchOptions,
        ladder: tuple[Rung, ...],
        programs: CompiledPrograms | None = None,
    ) -> None:
        """Compiles, unless given programs (of the same world and additions) have its structure.

        Without rungs, nothing is compiled.

        Raises:
            UnsupportedTermError: a cost or constraint that has no mean in closed form.
            OptionsError: a rung has a weight for rows that do not exist.
            ProgramError: additions of users contradict each other or the start, or can't be moved
                to the knots of other programs.
        """
        self.transcription = transcription = transcription.closed()
        self.additions = transcription.additions()
        self.options, self.ladder = options, ladder
        self._programs = programs or CompiledPrograms()
        self._starts: dict[StartName, Start] = {}
        if ladder and programs is None:
            known = dict.fromkeys((*transcription.ROWS, *self.start("line").row_names))
            for name in (name for rung in ladder for name in rung.weights if name not in known):
                expected = f"names of rows: {', '.join(known)}"
                raise OptionsError("ladder", f"a weight for {name!r}", expected)
        if self.additions.constraints:
            check_added_rows(transcription.prog(), self.additions)

    @property
    def polynomial(self) -> BoxPolynomial:
        """The penalized cost, for AIGO."""
        return self.start("line").polynomial

    @property
    def box(self) -> Box:
        """The first box of AIGO, around the straight line from start to goal."""
        return Box(*self.transcription.initial_box())

    def start(self, name: StartName) -> Start:
        """Returns the start of this name."""
        if name not in self._starts:
            around = self.transcription
            if name == "line":
                compiled, box = self._programs.compile(around), around.initial_box()
            else:  # Around the uncontrolled motion.
                times, coast = around.GetSampleTimes(), self.coast
                # The first row of an impact on a knot: velocities before impulses.
                rows = np.searchsorted(coast.times, times - _ON_KNOT * times[-1])
                q, v = coast.positions[rows], coast.velocities[rows]
                around = self._transcribe_around(q)
                compiled = self._programs.compile(around)
                box = around.box_around(q, v, _COAST_SHARE)
            of_box = compiled.at(around), Box(*box), compiled.row_names
            self._starts[name] = Start(around, *of_box)
        return self._starts[name]

    @cached_property
    def coast(self) -> Replay:
        """The uncontrolled motion, between rigid walls, in `coast_steps`."""
        return self.replay_coast(self.coast_steps)

    @property
    def coast_steps(self) -> int:
        """Time steps of the uncontrolled motion: a multiple of the transcription's."""
        return self.transcription.scenario.num_steps

    def replay_coast(self, num_steps: int) -> Replay:
        """Returns the uncontrolled motion, between rigid walls, in this number of steps."""
        world, scenario = self.transcription.world, self.transcription.scenario
        times = np.linspace(0.0, scenario.duration, num_steps + 1)
        controls = np.zeros((num_steps, world.num_actuators))
        return replay_event_driven(world, scenario, times, controls)

    def _transcribe_around(self, positions: Floats) -> Transcription:
        """Returns the transcription for boxes around a path, shape (N+1, nq) [m]."""
        return self.transcription

    @property
    def num_threads(self) -> int:
        """The number of rungs that run in parallel, see `PlanOptions.threads`."""
        is_small = self.transcription.elimination_order().size < _MANY
        return 1 if self.options.threads is None and is_small else self.options.num_threads

    def prepare(self, origins: Iterable[Origin]) -> None:
        """Prepares shared data of these origins, so that they may run in parallel."""
        for origin in origins:
            if isinstance(origin.rung, Rung):
                self._weights(origin.rung)

    def run_aigo(
        self,
        rung: Rung,
        algorithm: Algorithm | None = None,
        callback: Callable[[Iterate], None] | None = None,
    ) -> AigoResult:
        """Returns AIGO's result from the rung's first box under its weights.

        Args:
            rung: the start.
            algorithm: how to shrink boxes; the problem's own (`make_algorithm`) if None.
            callback: called with every iterate, the first box included.
        """
        algorithm = algorithm or self.make_algorithm(rung)
        start = self.start(rung.start)
        weighted = start.polynomial.with_weights(self._weights(rung))
        return minimize(weighted, start.box, algorithm, callback)

    @property
    def world(self) -> World:
        """The world of the task."""
        return self.transcription.world

    @property
    def scenario(self) -> Scenario:
        """The task's question."""
        return self.transcription.scenario

    @property
    def sources(self) -> str:
        """The sources of candidates, in words."""
        return f"{len(self.ladder)} rungs"

    @property
    def remedy(self) -> str:
        """Advice to the user if no candidate meets the rows."""
        relax = "Relax what was added, or try" if self.additions else "Try"
        return f"{relax} another ladder or local solver."

    @property
    def scales(self) -> Scales:
        """The task's own units."""
        return self.transcription.scales

    @abstractmethod
    def make_algorithm(self, rung: Rung) -> Algorithm:
        """Returns the algorithm of a rung, with temperatures in the cost's unit."""

    @property
    def algorithm_name(self) -> str:
        """Name of the algorithm in origins of candidates."""
        return "annealing"

    def pull(self, center: Floats, rung: Rung) -> Floats:
        """Returns a box center pulled towards the constraints by raising the rung's penalties."""
        start, weights = self.start(rung.start), self._weights(rung)
        weighted = start.polynomial.with_weights(weights)
        return raise_penalties(weighted, weights, center, start.box.free)

    @abstractmethod
    def find_sequences(self, result: AigoResult, rung: Rung) -> list[ContactSequence]:
        """Returns the contact sequences that AIGO proposes; () is a free flight."""

    @abstractmethod
    def polish(self, center: Floats, sequence: ContactSequence) -> Solution:
        """Returns the local optimum next to a contact sequence that was read off a box center."""

    def solve_locally(self, guess: Floats) -> Floats:
        """Returns the local optimum near a guess, all decision variables (n,)."""
        prog = self.transcription.prog()
        if self.options.local_solver == "newton":
            return self.transcription.close_rows(self.solve_nlp(self._nlp, guess))
        x = solve_with_drake(prog, guess, self.options.local_solver)
        return self.transcription.close_rows(x)

    @cached_property
    def _nlp(self) -> PolynomialNlp:
        return compile_nlp(self.transcription.prog())

    def solve_nlp(
        self, nlp: PolynomialNlp, guess: Floats, max_iterations: int | None = None
    ) -> Floats:
        """Returns the local optimum of a compiled program near a guess.

        Args:
            nlp: the program.
            guess: all its decision variables.
            max_iterations: of our local solver, which then only runs once.
        """
        if self.options.local_solver != "newton":
            return solve_with_drake(as_program(nlp), guess, self.options.local_solver)
        for factor in self._cost_units:
            result = self._minimize(nlp, guess, max_iterations or _MAX_ITERATIONS, factor)
            if result.is_success or max_iterations:
                break
        return result.x

    def _minimize(
        self, nlp: PolynomialNlp, guess: Floats, max_iterations: int, factor: float = 1.0
    ) -> LocalResult:
        """Returns the result of one run of our local solver, costs in factor times `cost_scale`."""
        unit = factor * self._cost_scale
        return InteriorPoint(max_iterations=max_iterations, cost_unit=unit).solve(nlp, guess)

    @cached_property
    def _cost_scale(self) -> float:
        return self.transcription.cost_scale()

    def judge(self, origin: Origin, start: Floats | None, found: Solution) -> Candidate:
        """Returns the candidate of a motion, replayed between rigid walls.

        Args:
            origin: where it came from.
            start: decision variables of this problem's transcription; None: it began elsewhere.
            found: the motion.
        """
        world, scenario, trajectory = self.world, self.transcription.scenario, found.trajectory
        replay = replay_event_driven(world, scenario, trajectory.times, trajectory.controls)
        return self._describe(
            trajectory,
            add_to_replay(replay, self.additions, trajectory),
            origin=origin,
            start_cost=None if start is None else self.transcription.scenario_cost(start),
            start_defects={} if start is None else self.transcription.defects(start),
            cost=self.cost(found),
            goal_error=float(np.linalg.norm(trajectory.positions[-1] - scenario.goal_position)),
            defects=self.defects(found),
            added_costs=self.additions.costs(sample(trajectory)),
        )

    def _describe(self, trajectory: Trajectory, replay: Replay, **fields: Any) -> Candidate:
        """Returns the candidate of a trajectory and its replay, with these fields."""
        return Candidate(
            trajectory=trajectory,
            max_penetration=max_penetration(self.world, trajectory),
            contacts=find_contacts(self.world, trajectory),
            replay=replay,
            scales=self.scales,
            **fields,
        )

    def cost(self, found: Solution) -> float:
        """Returns J of a motion, with costs of users."""
        motion, scenario = found.trajectory, self.transcription.scenario
        cost = calc_cost(scenario, motion.times, motion.positions, motion.controls)
        return cost + sum(self.additions.costs(sample(motion)).values())

    def defects(self, found: Solution) -> dict[str, float]:
        """Returns a motion's largest violation of each kind of row, and of users' constraints."""
        defects = dict(found.defects)
        if self.additions:
            for name, missed in self.additions.violations(sample(found.trajectory)).items():
                defects[name] = max(missed, defects.get(name, 0.0))
        return defects

    def confirm(self, candidate: Candidate) -> Replays:
        """Returns the candidate's replays: its own, and Drake's if the options confirm."""
        if not self.options.confirm:
            return candidate.own_replays
        motion, scenario = candidate.trajectory, self.transcription.scenario
        drake = replay_drake(self.world, scenario, motion.times, motion.controls)
        return Replays(candidate.replay, add_to_replay(drake, self.additions, motion))

    def idle_candidate(self) -> Candidate:
        """Returns the uncontrolled motion between rigid walls as a candidate.

        Its knots are those of `coast`, and the times of impacts.
        """
        world, replay = self.transcription.world, self.coast
        no_control = np.zeros((1, world.num_actuators))
        for doubling in range(_MOST_DOUBLINGS + 1):
            if doubling:
                replay = self.replay_coast(self.coast_steps << doubling)
            ends = replay.times[[0, -1]]
            trajectory = read_motion(world, replay, ends, no_control, self.scales.length)
            missed = self.additions.violations(sample(trajectory)) if self.additions else {}
            defects = {**calc_defects(world, trajectory), **missed}
            if largest_defect(defects, self.scales) <= LARGEST_DEFECT:
                break
        replay = add_to_replay(replay, self.additions, trajectory)
        return self._describe(
            trajectory,
            replay,
            origin=Origin(NO_CONTROL),
            start_cost=replay.cost,
            start_defects=defects,
            cost=replay.cost,
            goal_error=replay.goal_error,
            defects=defects,
            added_costs=replay.added_costs,
        )

    def _weights(self, rung: Rung) -> dict[str, float]:
        """Returns the rung's weights of this problem's rows."""
        unit, names = self._cost_scale, self.start(rung.start).row_names
        return {name: unit * rung.weights.get(name, rung.others) for name in names}
