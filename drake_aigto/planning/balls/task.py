"""Rigid plans: contact sequences read off AIGO's boxes, polished as multi-phase problems."""

from __future__ import annotations

import copy
import dataclasses
import math
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

from drake_aigto.aigo import AigoResult, Algorithm, Annealing
from drake_aigto.arrays import Floats
from drake_aigto.errors import TrajectoryError
from drake_aigto.local import compile_nlp
from drake_aigto.planning.balls.neighbors import keep_apart, moved_past
from drake_aigto.planning.balls.phases import Path, PhaseTask, Solved, coarsen, transcribe
from drake_aigto.planning.candidate import LARGEST_DEFECT, Candidate, Origin, sample
from drake_aigto.planning.options import PlanOptions
from drake_aigto.planning.rungs import Rung
from drake_aigto.planning.sequences import read_sequences
from drake_aigto.planning.simulated import calc_defects, read_motion
from drake_aigto.simulation import find_contacts, max_penetration
from drake_aigto.transcription import (
    PhaseTranscription,
    RigidTranscription,
    TouchSequence,
    Transcription,
    largest_defect,
    touches_at_once,
)

if TYPE_CHECKING:
    from drake_aigto.world import Scenario, World

# Touches closer than this part of the duration to the start or the end do not count.
_MARGIN = 1e-6
# How often touches are moved past instants of users, at most.
_MOST_MOVES = 20
# Boxes have an immediate bounce within this many steps.
_STEPS_OF_START = 3
# Of the local solver on arcs; the general solver takes over after that.
_ARC_ITERATIONS = 60
# The general solver takes minutes for more steps than the first number, which hardly improve a
# plan; and seconds for more than the second, before the best candidates are known.
_MOST_GENERAL, _MOST_COARSE = 1000, 300
# Last temperature of an anneal, relative to the first. Boxes have a plan's contacts long before
# they are stationary: a loose tolerance at few temperatures finds as many right sequences as
# careful ones. Still fewer Newton steps would lose bounces around the straight line.
_COOLED = 5e-5


def make_ball_task(
    world: World, scenario: Scenario, options: PlanOptions | None = None
) -> BallTask:
    """Returns the scenario, transcribed with the time steps of `coarsen`, and compiled."""
    options = options or PlanOptions()
    return BallTask(transcribe(world, scenario, options), options, scenario.num_steps)


class BallTask(PhaseTask):
    """The rigid transcription: a contact sequence is the times of touches."""

    transcription_name: ClassVar[str] = "rigid"

    # Gravity and springs may cost far more than the motion.
    _cost_units = (1.0, 1e2, 1e4)

    # Iterations of polishes after plain Newton steps, in turn; (): no limit.
    _brief: tuple[int, ...] = ()

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

        With arcs, a polish takes plain Newton steps alone, without the general solver: few plans
        are lost, and most of the time is saved. Up to most_iterations follow these steps if a
        search has found no plan otherwise (`patient`).
        """
        other = copy.copy(self)
        other._brief = (0, most_iterations)
        return other

    @property
    def patient(self) -> BallTask | None:
        """The same problem for searches without a plan so far; None: there is no other."""
        if len(self._brief) < 2:
            return None
        other = copy.copy(self)
        other._brief = self._brief[1:]
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
        return [self._with_touches_at_once(sequence) for sequence in filter(self.fits, read)]

    def _with_touches_at_once(self, sequence: TouchSequence) -> TouchSequence:
        """Returns a sequence with its immediate bounces, which boxes have late or never."""
        soon = _STEPS_OF_START * self.transcription.time_step()
        for touch in reversed(self._at_once):
            late = [
                other for other in sequence if other.contact == touch.contact and other.start < soon
            ]
            sequence = (touch, *(other for other in sequence if other not in late[:1]))
        return sequence

    @cached_property
    def _at_once(self) -> TouchSequence:
        return touches_at_once(self.transcription.world, self.transcription.scenario)

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

    def polish(self, center: Floats, sequence: TouchSequence) -> tuple[PhaseTranscription, Floats]:
        """Returns the multi-phase problem of a contact sequence, and its local optimum.

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
    ) -> tuple[PhaseTranscription, Floats]:
        """Returns the same, for a contact sequence along any path.

        Touches that an instant of users blocks are tried on its other side.

        Args:
            path: times and positions.
            sequence: the contacts.
            num_steps: of all phases together, without arcs; this problem's if None.
            max_iterations: of a single run of the local solver; None: no limit.

        Raises:
            OptionsError, TrajectoryError, UnsupportedTermError: infeasible touches.
        """
        counts = num_steps, max_iterations
        if not self._instants.size:
            return self._polish_once(path, sequence, *counts)
        duration = self.transcription.scenario.duration
        apart = keep_apart(sequence, self._instants, duration)
        best = self._polish_once(path, apart, *counts)
        for _ in range(_MOST_MOVES):
            phases, x = best
            along = phases.sample_times(x), phases.split(x)[0]
            others = (self._polish_once(along, moved, *counts) for moved in moved_past(phases, x))
            merit = self._merit(*best)
            better = next((other for other in others if self._merit(*other) < merit), None)
            if better is None:
                break
            best = better
        return best

    def judge(
        self,
        origin: Origin,
        start: Floats,
        solved: Transcription,
        x: Floats,
    ) -> Candidate:
        """Returns the candidate of a solution; hops that lead to rest are simulated ones.

        The multi-phase problem has their times, not their heights.
        """
        found = super().judge(origin, start, solved, x)
        if not (isinstance(solved, PhaseTranscription) and solved.hops(x)):
            return found
        world, planned = solved.world, found.trajectory
        motion = read_motion(
            world, found.replay, planned.times, planned.controls, self.scales.length
        )
        missed = self.additions.violations(sample(motion)) if self.additions else {}
        return dataclasses.replace(
            found,
            trajectory=motion,
            defects={**calc_defects(world, motion), **missed},
            max_penetration=max_penetration(world, motion),
            contacts=find_contacts(world, motion),
        )

    def _merit(self, phases: PhaseTranscription, x: Floats) -> tuple[float, float]:
        """Returns the merit, less for a better solution: its violation of rows, then its cost."""
        defect = largest_defect(self.defects(phases, x), self.scales)
        return max(defect, LARGEST_DEFECT), self.cost(phases, x)

    def _polish_once(
        self,
        path: Path,
        sequence: TouchSequence,
        num_steps: int | None,
        max_iterations: int | None,
    ) -> Solved:
        """Returns the local optimum of one multi-phase problem.

        Arcs that lead to the optimum have the last polish's steps at once, as their number makes no
        difference. Otherwise, there are `_MOST_GENERAL` steps at most.
        """
        through, facings = self._look_along(path, sequence)
        if self._has_arcs:
            allowed = self._brief[0] if self._brief else _ARC_ITERATIONS
            most = min(allowed, max_iterations or _ARC_ITERATIONS)
            solved = self._solve_in_arcs(through, facings, sequence, most)
            if solved is not None:
                return solved
            if self._brief:
                raise TrajectoryError(
                    "touches", f"no motion in {most} iterations", "one that has them"
                )
            coarse = min(self.transcription.scenario.num_steps, _MOST_COARSE)
            num_steps = min(num_steps or coarse, _MOST_GENERAL)
        phases = self._phases(sequence, facings, num_steps)
        prog, guess = phases.prog(), phases.vector(phases.guess(through))
        order = phases.elimination_order()
        x = self.solve_program(prog, guess, lambda: compile_nlp(prog, order), max_iterations)
        return phases, x

    def follow(self, path: Path, sequence: TouchSequence, max_iterations: int) -> Solved | None:
        """Returns the same for controllers at every tick, or None if iterations do not suffice.

        With arcs, the general solver is not tried; otherwise, infeasible solutions are None.

        Args:
            path: see `polish_along`, as sequence.
            sequence: the contacts.
            max_iterations: of the local solver, after plain Newton steps; 0: these alone.
        """
        if self._has_arcs:
            return self._solve_in_arcs(*self._look_along(path, sequence), sequence, max_iterations)
        solved = self.polish_along(path, sequence, max_iterations=max(max_iterations, 1))
        missed = largest_defect(self.defects(*solved), self.scales)
        return solved if missed <= LARGEST_DEFECT else None
