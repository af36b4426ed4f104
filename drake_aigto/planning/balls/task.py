"""Tasks of balls between rigid walls: contact sequences read off AIGO's boxes, closed in arcs."""

from __future__ import annotations

import copy
import dataclasses
import math
from functools import cached_property
from typing import ClassVar

from drake_aigto.aigo import AigoResult, Algorithm, Annealing
from drake_aigto.arrays import Floats, interpolate
from drake_aigto.errors import TrajectoryError
from drake_aigto.local import LocalResult, NewtonLagrange, PolynomialNlp
from drake_aigto.planning.balls.arc_program import ArcPrograms
from drake_aigto.planning.balls.arcs import Arcs, solve_in_arcs
from drake_aigto.planning.balls.phases import (
    Path,
    PhaseMotion,
    PhaseProblem,
    coarsen,
    keep_apart,
    least_flight_cost,
    moved_past,
    transcribe,
    unfolds,
)
from drake_aigto.planning.balls.timeline import bend, straight_path
from drake_aigto.planning.candidate import (
    LARGEST_DEFECT,
    Candidate,
    Origin,
    calc_defects,
    read_motion,
    sample,
)
from drake_aigto.planning.options import PlanOptions, Rung
from drake_aigto.planning.program_task import ProgramTask
from drake_aigto.planning.programs import CompiledPrograms, Solution
from drake_aigto.planning.sequence_search import read_sequences
from drake_aigto.simulation import find_contacts, max_penetration
from drake_aigto.transcription import (
    Facing,
    RigidTranscription,
    TouchSequence,
    find_facings,
    joint_times,
    largest_defect,
    touches_at_once,
)
from drake_aigto.world import Scenario, World

# Touches closer than this part of the duration to the start or the end do not count.
_MARGIN = 1e-6
# How often touches are moved past instants of users, at most.
_MOST_MOVES = 20
# Boxes have an immediate bounce within this many steps.
_STEPS_OF_START = 3
# Of the local solver on long arcs; arcs between all knots take over after that.
_ARC_ITERATIONS = 60
# Arcs between all knots take minutes for more steps than the first number, which hardly improve a
# plan; and seconds for more than the second, before the best candidates are known.
_MOST_GENERAL, _MOST_COARSE = 1000, 300
# Last temperature of an anneal, relative to the first. Boxes have a plan's contacts long before
# they are stationary: a loose tolerance at few temperatures finds as many right sequences as
# careful ones. Still fewer Newton steps would lose bounces around the straight line.
_COOLED = 5e-5

# Positions of touches on a path, and the sides on which it passes boxes.
_Seen = tuple[Floats, tuple[Facing, ...]]


def make_ball_task(
    world: World, scenario: Scenario, options: PlanOptions | None = None
) -> BallTask:
    """Returns the scenario, transcribed with the time steps of `coarsen`, and compiled."""
    options = options or PlanOptions()
    return BallTask(transcribe(world, scenario, options), options, scenario.num_steps)


class BallTask(ProgramTask):
    """The rigid transcription: a contact sequence is the times of touches (`PhaseProblem`).

    Attributes:
        asked_steps: time steps of plans.
        num_steps: those that candidates are judged with, `PlanOptions.aigo_steps` at least: costs
            with few steps do not show which contacts are best.
    """

    transcription: RigidTranscription
    options: PlanOptions

    transcription_name: ClassVar[str] = "rigid"

    # Gravity and springs may cost far more than the motion.
    _cost_units = (1.0, 1e2, 1e4)

    # Iterations of a run of the solver in polishes after plain Newton steps, in turn; (): no limit.
    # Long runs take a third of a search, and no good plan is among what they lead to.
    _brief: tuple[int, ...] = ()

    def __init__(
        self,
        transcription: RigidTranscription,
        options: PlanOptions | None = None,
        num_steps: int | None = None,
        programs: CompiledPrograms | None = None,
    ) -> None:
        """Compiles, unless there is a program of this structure already.

        Plans have these steps, or the transcription's. Programs are of the same world, wherever its
        walls stand, and the same additions.
        """
        options = options or PlanOptions()
        options.check(is_of_balls=True)
        super().__init__(transcription, options, options.ball_ladder, programs)
        self.asked_steps = num_steps or transcription.scenario.num_steps
        self.num_steps = max(self.asked_steps, self.options.aigo_steps)
        self._arc_programs = ArcPrograms()
        self._scenarios: dict[int, Scenario] = {}  # By their number of steps.

    @property
    def coast_steps(self) -> int:
        """Time steps of the uncontrolled motion: a multiple of the transcription's, like plans'."""
        coarse = self.transcription.scenario.num_steps
        return coarse * math.ceil(self.num_steps / coarse)

    def in_steps(self, num_steps: int) -> BallTask:
        """Returns the same problem, with plans polished in this number of time steps."""
        other = copy.copy(self)
        other.num_steps = num_steps
        return other

    def in_brief(self, most_iterations: int) -> BallTask:
        """Returns the same problem for searches that may not take long.

        With long arcs, a polish takes plain Newton steps alone, and tries no others: few plans
        are lost, and most of the time is saved. Up to most_iterations follow these steps if a
        search has found no plan otherwise (`patient`).
        """
        return self._in(0, most_iterations)

    def in_turn(self) -> BallTask:
        """Returns the same problem, with long polishes left to searches without a plan."""
        return self if self._brief or self.options.exhaustive else self._in(_ARC_ITERATIONS)

    @property
    def patient(self) -> BallTask | None:
        """The same problem for searches without a plan so far; None: there is no other."""
        return self._in(*self._brief[1:]) if self._brief else None

    def _in(self, *brief: int) -> BallTask:
        other = copy.copy(self)
        other._brief = brief
        return other

    def in_world(self, world: World) -> BallTask:
        """Returns the same problem, without additions, with walls elsewhere.

        Args:
            world: see `EquationsOfMotion.with_walls_nearer`.
        """
        return self._with(self.transcription.in_world(world), self.asked_steps)

    def make_algorithm(self, rung: Rung) -> Algorithm:
        """Returns an annealing that ends as soon as contacts can be read off boxes."""
        start = rung.temperature * self._cost_scale
        return Annealing(
            initial_temperature=start,
            final_temperature=_COOLED * start,
            cooling=0.1,
            tolerance=0.1,
            narrowing=0.5,
        )

    def again(self, scenario: Scenario) -> BallTask:
        """Returns the problem of another scenario in the same world, with additions of users.

        A program is compiled only for a new structure. Additions stay at their knots, so that the
        number of knots stays the same.
        """
        coarse = coarsen(self.transcription.world, scenario, self.options)
        if self.additions:
            coarse = scenario.in_steps(self.transcription.scenario.num_steps)
        transcription = self.transcription.again(coarse)
        return self._with(transcription, scenario.num_steps)

    def _with(self, transcription: RigidTranscription, num_steps: int) -> BallTask:
        """Returns the problem of another transcription, with the programs that are compiled."""
        other = BallTask(transcription, self.options, num_steps, self._programs)
        other._arc_programs = self._arc_programs
        other._brief = self._brief
        return other

    def find_sequences(self, result: AigoResult, rung: Rung) -> list[TouchSequence]:
        """Returns the contact sequences that AIGO proposes (`read_sequences`) and that fit."""
        read = read_sequences(self.start(rung.start).transcription, result.box.center)
        found, soon = [], _STEPS_OF_START * self.transcription.time_step()
        for sequence in filter(self.fits, read):
            for touch in reversed(self._at_once):  # Boxes have these late or never.
                late = [t for t in sequence if t.contact == touch.contact and t.start < soon]
                sequence = (touch, *(other for other in sequence if other not in late[:1]))
            found.append(sequence)
        return found

    @property
    def _at_once(self) -> TouchSequence:
        return self.scenario.derive(self.world, touches_at_once)

    def _transcribe_around(self, positions: Floats) -> RigidTranscription:
        """Returns the transcription with the faces of boxes that a path goes along."""
        first = self.transcription
        if first.world.num_solids == first.world.num_contacts:
            return first
        return first.again(first.scenario, positions)

    def fits(self, sequence: TouchSequence) -> bool:
        """Returns whether all touches are within the duration."""
        T = self.transcription.scenario.duration
        first = min([_MARGIN * T, *(touch.start / 2 for touch in self._at_once)])
        joints = (t for touch in sequence for t in touch.joints)
        return all(first < t < (1 - _MARGIN) * T for t in joints)

    def polish(self, center: Floats, sequence: TouchSequence) -> PhaseMotion:
        """Returns the local optimum of the multi-phase problem of a contact sequence.

        Of AIGO's box center only the sequence, the positions of touches, and the sides on which
        blocks are passed are kept.
        """
        path = self.transcription.split(center)[0]
        return self.polish_along((self.transcription.GetSampleTimes(), path), sequence)

    def polish_along(
        self,
        path: Path,
        sequence: TouchSequence,
        num_steps: int | None = None,
        max_iterations: int | None = None,
    ) -> PhaseMotion:
        """Returns the same, for a contact sequence along any path.

        Touches that an instant of users blocks are tried on its other side. All phases together
        have these steps, without long arcs, and a single run of the local solver these iterations
        at most.

        Raises:
            OptionsError, TrajectoryError, UnsupportedTermError: infeasible touches.
        """
        counts, instants = (num_steps, max_iterations), self.additions.instants
        if not instants.size:
            return self._polish_once(path, sequence, *counts)
        apart = keep_apart(sequence, instants, self.transcription.scenario.duration)
        best = self._polish_once(path, apart, *counts)
        for _ in range(_MOST_MOVES):
            others = (self._polish_once(best.path, each, *counts) for each in moved_past(best))
            merit = self._merit(best)
            better = next((other for other in others if self._merit(other) < merit), None)
            if better is None:
                break
            best = better
        return best

    def _merit(self, motion: PhaseMotion) -> tuple[float, float]:
        """Returns the merit, less for a better motion: its violation of rows, then its cost."""
        defect = largest_defect(self.defects(motion), self.scales)
        return max(defect, LARGEST_DEFECT), self.cost(motion)

    def _polish_once(
        self, path: Path, sequence: TouchSequence, num_steps: int | None, max_iterations: int | None
    ) -> PhaseMotion:
        """Returns the local optimum of one multi-phase problem.

        Long arcs that lead to the optimum have the last polish's steps at once, as their number
        makes no difference. Otherwise there are arcs between all knots, `_MOST_GENERAL` at most.
        """
        through, facings = seen = self._look_along(path, sequence)
        if self._has_arcs:
            allowed = self._brief[0] if self._brief else _ARC_ITERATIONS
            most = min(allowed, max_iterations or _ARC_ITERATIONS)
            if found := self._solve_in_arcs(seen, sequence, most):
                return found
            coarse = min(self.transcription.scenario.num_steps, _MOST_COARSE)
            num_steps = min(num_steps or coarse, _MOST_GENERAL)
            if self._brief:
                found = self._solve_in_arcs(seen, sequence, most, num_steps) if most else None
                if found is None:
                    raise TrajectoryError("touches", f"no motion in {most} steps", "feasible ones")
                return found
        phases = self._phases(sequence, facings, num_steps)
        arcs = Arcs(phases, range(phases.num_steps))
        x = self.solve_nlp(arcs.nlp, arcs.vector(phases.guess(through)), max_iterations)
        return PhaseMotion(phases, arcs.trajectory(x))

    def follow(
        self, path: Path, sequence: TouchSequence, max_iterations: int
    ) -> PhaseMotion | None:
        """Returns the same for controllers at every tick, or None if iterations do not suffice.

        These follow plain Newton steps. With long arcs, others are not tried; otherwise, infeasible
        motions are None.
        """
        if self._has_arcs:
            return self._solve_in_arcs(self._look_along(path, sequence), sequence, max_iterations)
        found = self.polish_along(path, sequence, max_iterations=max(max_iterations, 1))
        missed = largest_defect(self.defects(found), self.scales)
        return found if missed <= LARGEST_DEFECT else None

    def _look_along(self, path: Path, sequence: TouchSequence) -> _Seen:
        """Returns the positions of touches on a path, and the sides on which it passes boxes."""
        world = self.transcription.world
        through = interpolate(joint_times(sequence), *path)
        if world.num_solids == world.num_contacts:
            return through, ()
        # Box centers miss the goal, and neighbors the walls: the side on which a block is passed is
        # read off a path that does not.
        stops = straight_path(world, self.transcription.scenario, sequence, through)
        times, bent = bend(path, *stops)
        leaning = interpolate(times, *path)
        return through, find_facings(world, times, bent, sequence, leaning)

    def _solve_in_arcs(
        self, seen: _Seen, sequence: TouchSequence, most: int, num_steps: int | None = None
    ) -> PhaseMotion | None:
        """Returns the local optimum if long arcs lead to it, or arcs of one step for num_steps."""
        through, facings = seen
        phases = self._phases(sequence, facings, num_steps or self.num_steps)
        motion = solve_in_arcs(
            phases,
            phases.guess(through),
            lambda nlp, start: self._settle(nlp, start, most),
            self._arc_programs,
            range(phases.num_steps) if num_steps else (),
        )
        return None if motion is None else PhaseMotion(phases, motion, is_of_arcs=not num_steps)

    def _settle(self, nlp: PolynomialNlp, guess: Floats, max_iterations: int) -> LocalResult | None:
        """Returns the result of plain Newton steps, or else of one run of our local solver.

        For most sequences no bound is active in the optimum: phases have some length.
        """
        quick = NewtonLagrange(cost_unit=self._cost_scale)
        found = quick.solve(nlp, guess)
        if found is None and max_iterations:
            return self._minimize(nlp, guess, max_iterations)
        return found

    def _phases(
        self, sequence: TouchSequence, facings: tuple[Facing, ...], num_steps: int | None
    ) -> PhaseProblem:
        """Returns the multi-phase problem in num_steps or AIGO's, at least one per phase."""
        scenario, instants = self.transcription.scenario, self.additions.instants.tolist()
        turns = (facing.start for facing in facings)
        phases = {0.0, *joint_times(sequence), *turns, *instants}
        steps = max(num_steps or scenario.num_steps, len(phases))
        if steps not in self._scenarios:
            self._scenarios[steps] = scenario.in_steps(steps)
        args = self._scenarios[steps], sequence, facings, self.additions
        return PhaseProblem(self.world, *args)

    @cached_property
    def _has_arcs(self) -> bool:
        """Whether flights are parabolas, without additions of users at every knot."""
        is_exact = self.world.has_constant_dynamics and not self.additions.are_everywhere
        return self.options.local_solver == "newton" and is_exact

    @property
    def _is_closed_form(self) -> bool:
        return self.world.has_constant_dynamics and not self.additions

    @property
    def least_flight_cost(self) -> float:
        """Lower bound of the cost without contact; 0 if it has no closed form."""
        scenario = self.transcription.scenario
        return least_flight_cost(self.world, scenario) if self._is_closed_form else 0.0

    @cached_property
    def unfolds(self) -> bool:
        """Whether the contacts and their order are expected to determine a plan."""
        return self._is_closed_form and unfolds(self.world, self.transcription.scenario)

    def judge(self, origin: Origin, start: Floats | None, found: Solution) -> Candidate:
        """Returns the candidate of a motion; hops that lead to rest are simulated ones.

        The multi-phase problem has their times, not their heights.
        """
        judged = super().judge(origin, start, found)
        if not (isinstance(found, PhaseMotion) and found.hops):
            return judged
        planned = judged.trajectory
        args = judged.replay, planned.times, planned.controls, self.scales.length
        motion = read_motion(self.world, *args)
        missed = self.additions.violations(sample(motion)) if self.additions else {}
        return dataclasses.replace(
            judged,
            trajectory=motion,
            defects={**calc_defects(self.world, motion), **missed},
            max_penetration=max_penetration(self.world, motion),
            contacts=find_contacts(self.world, motion),
        )
