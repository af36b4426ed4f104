"""Neighbors of good candidates: other contacts, and other times of the same ones."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from functools import cached_property
from itertools import chain

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError, TrajectoryError, UnsupportedTermError
from drake_aigto.planning.candidate import LARGEST_DEFECT
from drake_aigto.planning.insertions import find_insertions, find_pulls
from drake_aigto.planning.origin import ChangeName, Origin
from drake_aigto.planning.pool import Stopwatch
from drake_aigto.planning.rests import find_rests
from drake_aigto.planning.rigid import RigidProblem
from drake_aigto.planning.rigid_phases import Path, Solved
from drake_aigto.planning.search import Search
from drake_aigto.planning.touches import is_same, kinds, neighbors, retimed
from drake_aigto.transcription import TouchSequence
from drake_aigto.transcription.rows import largest_defect

# Parts of the duration by which the times of two sequences of the same contacts differ at most, if
# their polish is expected to end in one optimum, and if it has.
SAME_START, SAME_END = 0.05, 1e-3
# Of a sequence that grows.
MOST_TOUCHES = 8
# Neighbors are tried of candidates that cost at most so many times the best, with so few time
# steps and iterations of the local solver: most are hopeless, or no motion has them, which takes
# the solver longest to find out.
GOOD, _TRIAL_STEPS, _TRIAL_ITERATIONS = 3.0, 20, 30


class BranchingSearch(Search):
    """Goes on from its best candidates to their neighbors."""

    problem: RigidProblem

    def __init__(self, problem: RigidProblem, clock: Stopwatch | None = None) -> None:
        """Starts with no candidate."""
        super().__init__(problem, clock)
        self._duration = problem.transcription.scenario.duration
        self._refused: list[TouchSequence] = []

    @abstractmethod
    def add(
        self,
        origin: Origin,
        center: Floats,
        sequence: TouchSequence,
        path: Path | None = None,
        solved: Solved | None = None,
    ) -> None:
        """Adds the candidate of a sequence, near a path if one is given; its polish may be done."""

    def branch(self) -> None:
        """Adds neighbors (`neighbors`) of good sequences, the best first, of each once."""
        branched: set[TouchSequence] = set()
        while len(branched) < self.problem.options.branches:
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
            self._branch(best)

    def _branch(self, sequence: TouchSequence) -> None:
        """Adds those neighbors of a sequence that a trial finds good."""
        phases, x = self.solved[sequence]
        origin = self.by_sequence[sequence].origin
        path = phases.sample_times(x), phases.split(x)[0]
        more = [*phases.grazes(x), *find_insertions(phases, x)]
        optimum = phases.contact_sequence(x)
        others = [*find_rests(phases, x), *retimed(optimum, self._pulling, self._duration)]
        for other in [*others, *neighbors(optimum, more)]:
            # Where a plan holds, its times are the best ones, unless something pulls to a wall; of
            # others they may not be.
            held = [kinds(each) for each, it in self.by_sequence.items() if it.is_confirmed]
            is_pulled = any(touch.contact in self._pulling for touch in other)
            is_new = (is_pulled or kinds(other) not in held) and not self.is_known(other)
            if is_new and len(other) <= MOST_TOUCHES and self.problem.fits(other):
                tried = self._try(other, path)
                if tried and not self._has_optimum(tried):
                    # Where arcs did without the program, the trial was the polish.
                    solved = tried if tried[0].is_as_made else None
                    near = origin.changed(_change(sequence, other), sequence)
                    self.add(near, self.centers[sequence], other, path, solved)
                else:
                    self._refused.append(other)

    @cached_property
    def _pulling(self) -> frozenset[int]:
        """The contacts that something but the control pulls towards."""
        transcription = self.problem.transcription
        pulls = find_pulls(transcription.world, transcription.scenario.goal_position)
        return frozenset(np.flatnonzero(pulls > 0).tolist())

    def _try(self, sequence: TouchSequence, path: Path) -> Solved | None:
        """Returns a trial polish, if it meets the rows, and costs little more than the best."""
        least = min(candidate.replay.cost for candidate in self.by_sequence.values())
        try:
            with self.clock("polish"):
                phases, x = self.problem.polish_along(
                    path, sequence, _TRIAL_STEPS, _TRIAL_ITERATIONS
                )
        except (OptionsError, TrajectoryError, UnsupportedTermError):
            return None
        defects = self.problem.defects(phases, x)
        is_feasible = largest_defect(defects, self.problem.scales) <= LARGEST_DEFECT
        is_good = self.problem.cost(phases, x) <= scaled(GOOD, least)
        return (phases, x) if is_feasible and is_good else None

    def is_known(self, sequence: TouchSequence) -> bool:
        """Returns whether nearly this sequence has been polished or refused, or came out."""
        optima = map(self._optimum, self.by_sequence)
        known = chain(self.by_sequence, optima, self._refused)
        return self._is_among(sequence, known, SAME_START)

    def _optimum(self, sequence: TouchSequence) -> TouchSequence:
        """Returns what the polish made of a sequence's times."""
        phases, x = self.solved[sequence]
        return phases.contact_sequence(x)

    def _has_optimum(self, solved: Solved) -> bool:
        """Returns whether a candidate has these times already."""
        phases, x = solved
        optima = map(self._optimum, self.by_sequence)
        return self._is_among(phases.contact_sequence(x), optima, SAME_END)

    def _is_among(
        self, sequence: TouchSequence, others: Iterable[TouchSequence], share: float
    ) -> bool:
        return any(is_same(sequence, other, share * self._duration) for other in others)


def _change(sequence: TouchSequence, other: TouchSequence) -> ChangeName:
    if kinds(sequence) == kinds(other):
        return "moved"
    return "dropped" if len(other) < len(sequence) else "added"


def scaled(factor: float, cost: float) -> float:
    """Returns so many times a cost; of one below 0, which users may add, as much more."""
    return cost + (factor - 1) * abs(cost)
