"""The search for rigid plans: which contact sequences are tried, and in what order."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import combinations, islice, starmap

import numpy as np

from drake_aigto.aigo import AigoResult
from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError, TrajectoryError, UnsupportedTermError
from drake_aigto.planning.balls.branching import (
    GOOD,
    MOST_TOUCHES,
    SAME_END,
    SAME_START,
    BranchingSearch,
    Shown,
    propose,
)
from drake_aigto.planning.balls.phases import Path, PhaseMotion
from drake_aigto.planning.balls.shots import draw_shots
from drake_aigto.planning.balls.task import BallTask
from drake_aigto.planning.candidate import COASTING, GIVEN, SHOT, Candidate, Origin
from drake_aigto.planning.search import Proposal, Stopwatch, scaled
from drake_aigto.planning.sequence_search import (
    GAP,
    are_near,
    kinds,
    put_apart,
    read_touches_of,
    swapped,
)
from drake_aigto.transcription import Touch, TouchSequence, joint_times

_LOG = logging.getLogger(__name__)

# Touches of one wall that are closer than this part of the duration are chatter.
_CHATTER = 0.02
# Price of another time step than the scenario's, relative to the cost.
_STEPS_PRICE = 1e-2
# A candidate that costs at most this times the best may become the best.
_PROMISING = 20.0
# Shots that are looked at, and sequences of them that are tried, at most.
_MOST_SHOTS, _MOST_TRIED = 100, 12


class BallSearch(BranchingSearch):
    """Search in which AIGO proposes touches; they are polished, the best again if coarse.

    If a candidate's replay bounces where its plan does not, the plan with that bounce is another
    candidate: knots may miss a short contact, and those of AIGO miss one right after the start.
    """

    def __init__(
        self, task: BallTask, clock: Stopwatch | None = None, is_again: bool = False
    ) -> None:
        """Starts with no candidate.

        Args:
            task: to be planned for.
            clock: of its parts.
            is_again: whether a planner plans again, with other ends.
        """
        super().__init__(task.in_turn(), clock)
        self._is_again = is_again
        self._num_steps = task.num_steps
        # Arguments of `add` of a flight, and those whose polish failed.
        self._left_out: tuple[Origin, Shown] | None = None
        self._given_up: list[tuple[Origin, Shown]] = []
        self._is_open = False  # Whether candidates that cost too much are improved, too.

    @property
    def _grows_first(self) -> bool:
        """Whether boxes are left to searches that find nothing without them.

        If contacts determine a plan (`BallTask.unfolds`), the best sequence grows out of the
        uncontrolled motion's, contact by contact: planning again takes half the time without boxes.
        """
        has_reason = self._is_again or not self.task.ladder
        return self.task.unfolds and has_reason and not self.task.options.exhaustive

    def keep(self, origin: Origin, found: AigoResult | Shown) -> None:
        """Adds the candidate of a sequence, or those of the sequences of boxes."""
        if isinstance(found, Shown):
            self.add(origin, *found)
        else:
            super().keep(origin, found)

    def add(
        self,
        origin: Origin,
        center: Floats | None,
        sequence: TouchSequence,
        path: Path | None = None,
        solved: PhaseMotion | None = None,
    ) -> None:
        """Adds the candidate of a sequence, and one of its replay if that bounces more often.

        It is along a path, or that of the box center that led to it, and may be solved already. A
        flight is left out if another candidate costs so little that not even the flight's neighbors
        would be tried.
        """
        may_leave = not (sequence or self._is_open or self.task.options.exhaustive)
        if may_leave and self.task.least_flight_cost > GOOD * self.promise:
            _LOG.info("  free flight: left out, costs %.3e at least", self.task.least_flight_cost)
            self._left_out = origin.changed("left out", ()), Shown(center, (), path)
            self._refused.append(())
            return

        def polish(center: Floats, touches: TouchSequence) -> PhaseMotion:
            if solved or path is None:
                return solved or self.task.polish(center, touches)
            return self.task.polish_along(path, touches)

        try:
            self.solve(origin, center, sequence, polish)
        except (OptionsError, TrajectoryError, UnsupportedTermError):
            # Boxes may propose infeasible touches, such as of opposite walls at once.
            self._refused.append(sequence)
            self._given_up.append((origin, Shown(center, sequence, path)))
            return
        candidate = self.by_sequence[sequence]
        costs = (other.replay.cost for other in self.by_sequence.values() if other.is_confirmed)
        if not candidate.cost <= scaled(_PROMISING, min(costs, default=np.inf)):
            return
        self._add_swapped(sequence)
        if not (candidate.is_confirmed or self._chatters(sequence)):
            seen_path = candidate.replay.times, candidate.replay.positions
            for seen in self._with_unplanned_bounce(sequence):
                if len(seen) <= MOST_TOUCHES and not self.is_known(seen):
                    self.add(origin.changed("seen", sequence), center, seen, seen_path)

    @property
    def flight_left_out(self) -> float | None:
        """Lower bound of the cost of a free flight, if it was left out because of that."""
        return None if self._left_out is None else self.task.least_flight_cost

    def add_left_out(self) -> None:
        """Adds the flight that `add` left out, if any, and improves costly candidates."""
        self._is_open = True
        super().judge()
        if self._left_out is not None:
            (origin, shown), self._left_out = self._left_out, None
            self.add(origin, *shown)

    def _chatters(self, sequence: TouchSequence) -> bool:
        """Returns whether a wall is touched again at once: more touches make it no better."""
        optimum, near = self._optimum(sequence), _CHATTER * self._duration
        return any(
            later.contact == touch.contact and later.start - touch.end < near
            for touch, later in combinations(optimum, 2)
        )

    def _add_swapped(self, sequence: TouchSequence) -> None:
        """Adds a candidate's sequence with touches swapped that became simultaneous."""
        candidate, motion = self.by_sequence[sequence], self.solved[sequence]
        if candidate.is_feasible:
            for other in swapped(motion.sequence, SAME_END * self._duration):
                if not self.is_known(other):
                    origin = candidate.origin.changed("swapped", sequence)
                    self.add(origin, self.centers[sequence], other, motion.path)

    def _with_unplanned_bounce(self, sequence: TouchSequence) -> list[TouchSequence]:
        """Returns a sequence with the first bounce that it lacks, cut off there, and whole."""
        optimum, near = self._optimum(sequence), SAME_START * self._duration
        replay = self.by_sequence[sequence].replay
        for time, contact in zip(replay.bounce_times, replay.bounce_contacts, strict=True):
            planned = (touch for touch in optimum if touch.contact == contact)
            nearest = (min(max(time, touch.start), touch.end) for touch in planned)
            if not any(are_near(time, touched, near) for touched in nearest):
                before = tuple(touch for touch in optimum if touch.end < time)
                seen = (*before, Touch.bounce(time, contact))
                longer = (*seen, *optimum[len(before) :])
                return [sequence for sequence in (seen, longer) if self.task.fits(sequence)]
        return []

    def propose(self) -> Iterator[Sequence[Proposal]]:
        """Yields the guess of a user, boxes of rungs, and contacts of the uncontrolled motion.

        If these lead to no plan, failed polishes are repeated, with more iterations.
        """
        if self.guess is not None:
            touches = read_touches_of(self.task.transcription.world, self.guess)
            path = self.guess.times, self.guess.positions
            if self.task.fits(touches):
                yield [propose(Origin(GIVEN), Shown(None, touches, path))]
        # Boxes tell bounces apart that are `GAP` of the duration apart: of a fast ball, few.
        is_fast = len(self.task.coast.bounce_times) * GAP >= 1
        if is_fast or self._grows_first:
            yield from self._propose_uncontrolled()
        if not self._grows_first:
            yield from super().propose()
        patient = self.task.patient
        if patient is not None and self.promise == np.inf:
            self.task, given_up, self._given_up = patient, self._given_up, []
            for each in given_up:
                yield [propose(*each)]
        if not (is_fast or self.task.unfolds):  # Boxes around it are a rung.
            yield from self._propose_uncontrolled()

    def vary(self) -> Iterator[Sequence[Proposal]]:
        """Yields neighbors of good sequences, and boxes that are needed after all."""
        yield from super().vary()
        if self._grows_first and self.promise == np.inf:
            yield from super().propose()
            yield from super().vary()

    def propose_far(self) -> Iterator[Sequence[Proposal]]:
        """Yields sequences of the shots that promise least, where there is a block.

        A motion past its corner that bounces off another face goes on elsewhere: it is no neighbor.
        """
        task, seen = self.task, set[tuple[tuple[int, bool], ...]]()
        has_block = task.world.num_solids < task.world.num_contacts
        if not (has_block and self.task.least_flight_cost > 0 and 0 < self.promise < np.inf):
            return
        shots = draw_shots(task.world, task.scenario, self.promise, task.coast_steps)
        for shot in islice(shots, _MOST_SHOTS):
            bounces = zip(shot.bounce_times, shot.bounce_contacts, strict=True)
            sequence = tuple(starmap(Touch.bounce, bounces))
            if (key := tuple(kinds(sequence))) not in seen:
                seen.add(key)
                if not self.is_known(sequence):
                    path = shot.times, shot.positions
                    yield from self.propose_good(Origin(SHOT), None, sequence, path)
            if len(seen) >= _MOST_TRIED:
                return

    def _propose_uncontrolled(self) -> Iterator[Sequence[Proposal]]:
        """Yields the contacts of the uncontrolled motion, if they may lead to another plan.

        Plans may also pass a block that it bounces off. Without boxes, they may be free flights.
        """
        coast, world = self.task.coast, self.task.transcription.world
        bounces = zip(coast.bounce_times, coast.bounce_contacts, strict=True)
        all_of_it = tuple(starmap(Touch.bounce, bounces))
        solids = Counter(contact.solid for contact in world.contacts)
        of_walls = (t for t in all_of_it if solids[world.contacts[t.contact].solid] == 1)
        has_boxes = self.task.ladder and not self._grows_first
        for touches in (all_of_it, tuple(of_walls), *([] if has_boxes else [()])):
            sequence = put_apart(touches, self._duration)
            if self.task.fits(sequence) and not self.is_known(sequence):
                path = coast.times, coast.positions
                yield [propose(Origin(COASTING), Shown(None, sequence, path))]

    def improve(self, sequence: TouchSequence) -> None:
        """Replaces a candidate by its polish with the steps that all are judged with."""
        self._polish_again(sequence, self.task)

    def find_best(self) -> Candidate:
        """Returns the best candidate, polished with as few time steps as the scenario has.

        If that makes another one the best, that one is polished, and so on.
        """
        few, presented = self.task.in_steps(self.task.asked_steps), set[int]()
        while True:
            best = self.find_feasible()[0]
            sequence = next((key for key, each in self.by_sequence.items() if each is best), None)
            if sequence is None or id(best) in presented or few.num_steps >= self._num_steps:
                return best
            presented.add(id(self._polish_again(sequence, few)))

    def _polish_again(self, sequence: TouchSequence, problem: BallTask) -> Candidate:
        """Replaces a candidate by one with a problem's steps, if it holds, and returns it."""
        known, optimum = self.by_sequence[sequence], self._optimum(sequence)
        steps = max(problem.num_steps, 1 + len(joint_times(optimum)))
        # A contact at the very end leaves a vanishing phase: more steps do not help.
        vanishes = optimum and optimum[-1].end > (1 - SAME_END) * self._duration
        if steps == self.solved[sequence].phases.num_steps or vanishes:
            return known
        self.tell(f"polishing {known.describe_contacts()} with {steps} time steps")
        path = known.trajectory.times, known.trajectory.positions

        def polish(_: Floats, touches: TouchSequence) -> PhaseMotion:
            return problem.polish_along(path, touches, steps)

        try:
            self.solve(known.origin, self.centers[sequence], optimum, polish)
        except TrajectoryError:  # No short run leads to it in these steps.
            return known
        other = self.by_sequence[optimum]
        if (other.is_feasible, other.is_confirmed) < (known.is_feasible, known.is_confirmed):
            self.by_sequence[sequence] = known
            return known
        if optimum != sequence:
            del self.by_sequence[sequence]
        return other

    def finalists(self) -> list[TouchSequence]:
        """Returns the sequences that may still win by rank, one per optimum."""
        kept: list[TouchSequence] = []
        for sequence in sorted(self.by_sequence, key=self.rank_of):
            optima = map(self._optimum, kept)
            if not self._is_among(self._optimum(sequence), optima, SAME_END):
                kept.append(sequence)
        most = np.inf if self._is_open else scaled(GOOD, self.promise)
        return [sequence for sequence in kept if self.by_sequence[sequence].cost <= most]

    def rank(self, candidate: Candidate) -> tuple[float, ...]:
        """Orders by feasibility, confirmation by the event-driven replay, and cost.

        Other time steps than those that candidates are judged with have a small price.
        """
        has_other_steps = len(candidate.trajectory.controls) != self._num_steps
        price = scaled(1 + _STEPS_PRICE * has_other_steps, candidate.replay.cost)
        return not candidate.is_feasible, not candidate.is_confirmed, price
