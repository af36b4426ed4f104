"""Neighbors of good candidates: other contacts, and other times of the same ones."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np

from drake_aigto.aigo import AigoResult
from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError, TrajectoryError, UnsupportedTermError
from drake_aigto.planning.balls.neighbors import (
    find_grazes,
    find_insertions,
    find_pulls,
    find_rests,
)
from drake_aigto.planning.balls.phases import Path, PhaseMotion
from drake_aigto.planning.balls.task import BallTask
from drake_aigto.planning.candidate import LARGEST_DEFECT, ChangeName, Origin
from drake_aigto.planning.search import Proposal, Stopwatch, scaled
from drake_aigto.planning.sequence_search import SequenceSearch
from drake_aigto.planning.sequences import is_same, kinds, neighbors, retimed
from drake_aigto.transcription import TouchSequence, largest_defect

# Times of two sequences of the same contacts differ by at most these parts of the duration if their
# polish is expected to end in one optimum, and if it has.
SAME_START, SAME_END = 0.05, 1e-3
# Of a growing sequence.
MOST_TOUCHES = 8
# Neighbors are tried of candidates that cost at most 3 times the best, with few time steps and
# iterations of the local solver: most are hopeless or infeasible, and infeasible ones take the
# solver longest.
GOOD, _TRIAL_STEPS, _TRIAL_ITERATIONS = 3.0, 20, 30


class Shown(NamedTuple):
    """A contact sequence that was read off a motion.

    Attributes:
        center: of the box that led to it.
        sequence: the contacts.
        path: along which they are; the box center's if None.
        solved: the closed motion, if known.
    """

    center: Floats
    sequence: TouchSequence
    path: Path | None = None
    solved: PhaseMotion | None = None


def propose(origin: Origin, shown: Shown) -> Proposal:
    """Returns the proposal of a sequence, which is closed when it is added."""
    return Proposal(origin, lambda: shown)


class BranchingSearch(SequenceSearch):
    """Search among the neighbors of its best candidates."""

    task: BallTask

    def __init__(self, task: BallTask, clock: Stopwatch | None = None) -> None:
        """Starts with no candidate."""
        super().__init__(task, clock)
        self._duration = task.transcription.scenario.duration
        self._refused: list[TouchSequence] = []

    @abstractmethod
    def add(
        self,
        origin: Origin,
        center: Floats,
        sequence: TouchSequence,
        path: Path | None = None,
        solved: PhaseMotion | None = None,
    ) -> None:
        """Adds the candidate of a sequence (`Shown`)."""

    def keep(self, origin: Origin, found: AigoResult | Shown) -> None:
        """Adds the candidate of a sequence, or those of the sequences of boxes."""
        if isinstance(found, Shown):
            self.add(origin, *found)
        else:
            super().keep(origin, found)

    def vary(self) -> Iterator[Sequence[Proposal]]:
        """Yields neighbors (`neighbors`) of good sequences, the best first, once for each."""
        self.tell(f"{len(self.by_sequence)} candidates; looking for others near the best")
        branched: set[TouchSequence] = set()
        while len(branched) < self.task.options.branches:
            least = min(candidate.replay.cost for candidate in self.by_sequence.values())
            good = [
                sequence
                for sequence, candidate in self.by_sequence.items()
                if sequence not in branched
                and candidate.is_feasible
                and candidate.replay.cost <= scaled(GOOD, least)
            ]
            if not good:
                break
            best = min(good, key=self.rank_of)
            branched.add(best)
            yield from self._branch(best)

    def _branch(self, sequence: TouchSequence) -> Iterator[Sequence[Proposal]]:
        """Yields the neighbors of a sequence whose trial is good."""
        motion, origin = self.solved[sequence], self.by_sequence[sequence].origin
        more = [*find_grazes(motion), *find_insertions(motion)]
        optimum = motion.sequence
        others = [*find_rests(motion), *retimed(optimum, self._pulling, self._duration)]
        for other in [*others, *neighbors(optimum, more)]:
            # Times of a plan that holds are the best ones, unless something pulls to a wall; those
            # of others may not be.
            held = [kinds(each) for each, it in self.by_sequence.items() if it.is_confirmed]
            is_pulled = any(touch.contact in self._pulling for touch in other)
            is_new = (is_pulled or kinds(other) not in held) and not self.is_known(other)
            if is_new and len(other) <= MOST_TOUCHES and self.task.fits(other):
                tried = self._try(other, motion.path)
                if tried and not self._has_optimum(tried):
                    # If long arcs sufficed, the trial was the polish.
                    solved = tried if tried.is_of_arcs else None
                    shown = Shown(self.centers[sequence], other, motion.path, solved)
                    yield [propose(origin.changed(_change(sequence, other), sequence), shown)]
                else:
                    self._refused.append(other)

    @cached_property
    def _pulling(self) -> frozenset[int]:
        """The contacts that the uncontrolled acceleration points to."""
        transcription = self.task.transcription
        pulls = find_pulls(transcription.world, transcription.scenario.goal_position)
        return frozenset(np.flatnonzero(pulls > 0).tolist())

    def _try(self, sequence: TouchSequence, path: Path) -> PhaseMotion | None:
        """Returns a trial polish, if it is feasible and costs little more than the best."""
        least = min(candidate.replay.cost for candidate in self.by_sequence.values())
        try:
            with self.clock("polish"):
                found = self.task.polish_along(path, sequence, _TRIAL_STEPS, _TRIAL_ITERATIONS)
        except (OptionsError, TrajectoryError, UnsupportedTermError):
            return None
        defects = self.task.defects(found)
        is_feasible = largest_defect(defects, self.task.scales) <= LARGEST_DEFECT
        is_good = self.task.cost(found) <= scaled(GOOD, least)
        return found if is_feasible and is_good else None

    def is_known(self, sequence: TouchSequence) -> bool:
        """Returns whether nearly this sequence was polished, refused, or the result of a polish."""
        optima = map(self._optimum, self.by_sequence)
        known = chain(self.by_sequence, optima, self._refused)
        return self._is_among(sequence, known, SAME_START)

    def _optimum(self, sequence: TouchSequence) -> TouchSequence:
        """Returns a sequence with its times after the polish."""
        motion: PhaseMotion = self.solved[sequence]
        return motion.sequence

    def _has_optimum(self, solved: PhaseMotion) -> bool:
        """Returns whether a known candidate has these times."""
        optima = map(self._optimum, self.by_sequence)
        return self._is_among(solved.sequence, optima, SAME_END)

    def _is_among(
        self, sequence: TouchSequence, others: Iterable[TouchSequence], share: float
    ) -> bool:
        return any(is_same(sequence, other, share * self._duration) for other in others)


def _change(sequence: TouchSequence, other: TouchSequence) -> ChangeName:
    if kinds(sequence) == kinds(other):
        return "moved"
    return "dropped" if len(other) < len(sequence) else "added"
