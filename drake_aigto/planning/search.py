"""Candidates by contact sequence: AIGO proposes, and the best are improved."""

from __future__ import annotations

import logging
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any, Generic

from drake_aigto.aigo import AigoResult, Iterate, Status
from drake_aigto.planning.options import Rung
from drake_aigto.planning.origin import Origin
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

    def rungs(self) -> Iterator[tuple[Rung, ...]]:
        """Yields the ladder's rungs in the order to run them, those that may run at once together.

        Each lot is to be added before the next is asked for: rungs may be left out by what others
        have shown, never by clocks.
        """
        yield self.problem.options.rungs

    @property
    def box_contacts(self) -> tuple[int | None, ...]:
        """How many contacts the last box of each of the ladder's rungs shows; None: left out."""
        counts: list[int | None] = []
        for rung in self.problem.options.rungs:
            found = [sequences for each, sequences in self.shown if each == rung]
            counts.append(max(map(len, found[0][:1]), default=0) if found else None)
        return tuple(counts)

    def add_rungs(
        self, rungs: tuple[Rung, ...], tell: Callable[[Rung], None] | None = None
    ) -> None:
        """Adds the candidates of AIGO's sequences under these rungs, unless they are there.

        Args:
            rungs: run at once, in as many threads as the options allow.
            tell: called as each begins.

        Raises:
            KeyboardInterrupt: AIGO was interrupted; its best so far is a candidate by now.
        """
        most = self.problem.num_threads
        for first in range(0, len(rungs), most):
            at_once = rungs[first : first + most]
            for rung in at_once:
                if tell:
                    tell(rung)
            with self._clock("aigo"):
                results, is_interrupted = self._run_at_once(at_once)
            for rung, result in zip(at_once, results, strict=False):
                self._add_result(rung, result)
            if is_interrupted:
                raise KeyboardInterrupt

    def _run_at_once(self, rungs: tuple[Rung, ...]) -> tuple[list[AigoResult], bool]:
        """Returns what AIGO makes of each rung, and whether Ctrl-C came.

        After that it is the best so far, of those rungs that had begun.
        """
        if len(rungs) == 1:
            result = self.problem.run_aigo(rungs[0])
            return [result], result.status is Status.INTERRUPTED
        self.problem.prepare(rungs)
        stopped, runs = threading.Event(), list[Future[AigoResult]]()

        def stop_if_asked(_: Iterate) -> None:
            if stopped.is_set():
                raise KeyboardInterrupt  # In its thread, where `minimize` takes it for Ctrl-C.

        with ThreadPoolExecutor(len(rungs)) as pool:
            try:
                for rung in rungs:
                    runs.append(pool.submit(self.problem.run_aigo, rung, None, stop_if_asked))
                wait(runs)
            except KeyboardInterrupt:
                stopped.set()
        return [run.result() for run in runs], stopped.is_set()

    def _add_result(self, rung: Rung, result: AigoResult) -> None:
        with self._clock("aigo"):
            sequences = self.problem.find_sequences(result, rung)
        self.aigo_steps += result.num_inner_steps
        _LOG.info(
            "  %s after %d inner steps; contact sequences: %d",
            result.status.name.lower(),
            result.num_inner_steps,
            len(sequences),
        )
        self.shown.append((rung, sequences))
        origin = Origin(self.problem.options.algorithm, rung)
        for sequence in sequences:
            if not self.is_known(sequence):
                self.add(origin, result.box.center, sequence)

    def add(self, origin: Origin, center: npt.NDArray[np.float64], sequence: Sequence) -> None:
        """Adds the candidate of a sequence that was read off a box center."""
        self.solve(origin, center, sequence, self.problem.polish)

    def solve(
        self, origin: Origin, center: npt.NDArray[np.float64], sequence: Sequence, polish: Polish
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

    @property
    def flight_left_out(self) -> float | None:
        """What a free flight costs at least, if it was left out for that."""
        return None

    def add_left_out(self) -> None:
        """Adds candidates that were expected not to win, if there are any."""

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
