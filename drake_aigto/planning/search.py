"""Candidates by contact sequence: AIGO proposes, and the best are improved."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Generic

from drake_aigto.aigo import Status
from drake_aigto.planning.options import Rung
from drake_aigto.planning.plan import Candidate
from drake_aigto.planning.problem import PlanningProblem, Sequence

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

_LOG = logging.getLogger(__name__)

Clock = Callable[[str], AbstractContextManager[None]]
Polish = Callable[..., tuple[Any, Any]]


class Search(ABC, Generic[Sequence]):
    """Candidates by contact sequence; the work is cut off by counts, never by clocks.

    Attributes:
        problem: that is searched.
        by_sequence: the candidates so far, in the order that they were found.
        centers: of the boxes that each sequence was read off.
        solved: the transcription that each polish solved, and its decision variables.
        aigo_steps: inner iterations of AIGO so far.
        shown: the rungs so far, each with the contact sequences that its last box shows, the most
            literal first.
    """

    def __init__(self, problem: PlanningProblem[Any, Sequence], clock: Clock) -> None:
        """Starts with no candidate; the clock measures parts by name."""
        self.problem, self._clock = problem, clock
        self.by_sequence: dict[Sequence, Candidate] = {}
        self.centers: dict[Sequence, npt.NDArray[np.float64]] = {}
        self.solved: dict[Sequence, tuple[Any, npt.NDArray[np.float64]]] = {}
        self.aigo_steps = 0
        self.shown: list[tuple[Rung, list[Sequence]]] = []

    def rungs(self) -> Iterator[Rung]:
        """Yields the ladder's rungs in the order to run them, each after the one before was added.

        Rungs may be left out, by what the others have shown: never by clocks.
        """
        yield from self.problem.options.rungs

    @property
    def box_contacts(self) -> tuple[int | None, ...]:
        """How many contacts the last box of each of the ladder's rungs shows; None: left out."""
        counts: list[int | None] = []
        for rung in self.problem.options.rungs:
            found = [sequences for each, sequences in self.shown if each == rung]
            counts.append(max(map(len, found[0][:1]), default=0) if found else None)
        return tuple(counts)

    def add_rung(self, rung: Rung) -> None:
        """Adds the candidates of AIGO's sequences under this rung, unless they are there.

        Raises:
            KeyboardInterrupt: AIGO was interrupted; its best so far is a candidate by now.
        """
        with self._clock("aigo"):
            result = self.problem.run_aigo(rung)
            sequences = self.problem.find_sequences(result, rung)
        self.aigo_steps += result.num_inner_steps
        _LOG.info(
            "  %s after %d inner steps; contact sequences: %d",
            result.status.name.lower(),
            result.num_inner_steps,
            len(sequences),
        )
        self.shown.append((rung, sequences))
        for sequence in sequences:
            if not self.is_known(sequence):
                self.add(self.problem.options.describe(rung), result.box.center, sequence)
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt

    def add(self, origin: str, center: npt.NDArray[np.float64], sequence: Sequence) -> None:
        """Adds the candidate of a sequence that was read off a box center."""
        self.solve(origin, center, sequence, self.problem.polish)

    def solve(
        self, origin: str, center: npt.NDArray[np.float64], sequence: Sequence, polish: Polish
    ) -> None:
        """Makes a candidate of a sequence by a polish; it replaces one of equal sequence."""
        with self._clock("polish"):
            self.solved[sequence] = solved, x = polish(center, sequence)
        with self._clock("replay"):
            candidate = self.problem.judge(origin, center, solved, x)
        self.by_sequence[sequence] = candidate
        _LOG.info(
            "  %s: cost %.3e, replayed %.3e, largest defect %.0e, in %d steps",
            candidate.describe_contacts(),
            candidate.cost,
            candidate.replay.cost,
            candidate.max_defect,
            len(candidate.trajectory.controls),
        )
        self.centers[sequence] = center

    def ranked(self) -> list[Candidate]:
        """Returns all candidates, the best first."""
        return sorted(self.by_sequence.values(), key=self.rank)

    @abstractmethod
    def is_known(self, sequence: Sequence) -> bool:
        """Returns whether there is a candidate of nearly this sequence."""

    def branch(self) -> None:
        """Adds candidates near the best one in the space of sequences, where there is a way to."""

    @abstractmethod
    def finalists(self) -> list[Sequence]:
        """Returns the sequences that are worth improving, the best first."""

    @abstractmethod
    def improve(self, sequence: Sequence) -> None:
        """Adds candidates near a sequence, or a better one in its place."""

    @abstractmethod
    def rank(self, candidate: Candidate) -> tuple[float, ...]:
        """Returns what candidates are ordered by, the best least."""
