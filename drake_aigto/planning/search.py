"""Candidates by contact sequence: AIGO proposes, and the best are improved."""

from __future__ import annotations

import logging
import threading
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any

from drake_aigto.aigo import AigoResult, Iterate, Status
from drake_aigto.arrays import Floats
from drake_aigto.kernels import tell_compilation
from drake_aigto.planning.candidate import Candidate
from drake_aigto.planning.idle import idle_candidate
from drake_aigto.planning.options import Rung
from drake_aigto.planning.origin import Origin
from drake_aigto.planning.pool import CandidatePool, Progress, Stopwatch
from drake_aigto.planning.problem import ContactSequence, PlanningProblem

_LOG = logging.getLogger(__name__)

Polish = Callable[..., tuple[Any, Any]]


class Search(CandidatePool):
    """Candidates by contact sequence; the work is cut off by counts, never by clocks.

    Attributes:
        problem: that is searched.
        by_sequence: the candidates so far, in the order that they were found.
        centers: of the boxes that each sequence was read off.
        solved: the transcription that each polish solved, and its decision variables.
        shown: the rungs so far, each with the contact sequences that its last box shows, the most
            literal first.
    """

    problem: PlanningProblem

    def __init__(self, problem: PlanningProblem, clock: Stopwatch | None = None) -> None:
        """Starts with no candidate."""
        super().__init__(problem, clock)
        self.by_sequence: dict[ContactSequence, Candidate] = {}
        self.centers: dict[ContactSequence, Floats] = {}
        self.solved: dict[ContactSequence, tuple[Any, Floats]] = {}
        self.shown: list[tuple[Rung, list[ContactSequence]]] = []

    @property
    def candidates(self) -> Iterable[Candidate]:
        """Those that were searched for, in the order that they were found."""
        return self.by_sequence.values()

    def run(self, progress: Progress | None = None) -> None:
        """Runs the ladder, and refines what comes out.

        Args:
            progress: called with a line of text before each part, and once, with a `Notice`, if
                machine code has to be compiled.

        Raises:
            KeyboardInterrupt: before there was any candidate; after that, it ends the search.
        """
        options, begun = self.problem.options, list[Rung]()
        self._progress = progress

        def tell_rung(rung: Rung) -> None:
            begun.append(rung)
            start = rung.describe(self.problem.algorithm_name)
            self.tell(f"AIGO {len(begun)} of {len(options.ladder)}: {start}")

        with self.ended_by_ctrl_c(lambda: self.by_sequence), tell_compilation(self.tell):
            for rungs in self.rungs():
                self.add_rungs(rungs, tell_rung)
            self.refine()

    def rungs(self) -> Iterator[tuple[Rung, ...]]:
        """Yields the ladder's rungs in the order to run them, those that may run at once together.

        Each lot is to be added before the next is asked for: rungs may be left out by what others
        have shown, never by clocks.
        """
        yield self.problem.options.ladder

    @property
    def box_contacts(self) -> tuple[int | None, ...]:
        """How many contacts the last box of each of the ladder's rungs shows; None: left out."""
        counts: list[int | None] = []
        for rung in self.problem.options.ladder:
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
            with self.clock("aigo"):
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
        with self.clock("aigo"):
            sequences = self.problem.find_sequences(result, rung)
        self.aigo_steps += result.num_inner_steps
        _LOG.info(
            "  %s after %d inner steps; contact sequences: %d",
            result.status.name.lower(),
            result.num_inner_steps,
            len(sequences),
        )
        self.shown.append((rung, sequences))
        origin = Origin(self.problem.algorithm_name, rung)
        for sequence in sequences:
            if not self.is_known(sequence):
                self.add(origin, result.box.center, sequence)

    def add(self, origin: Origin, center: Floats, sequence: ContactSequence) -> None:
        """Adds the candidate of a sequence that was read off a box center."""
        self.solve(origin, center, sequence, self.problem.polish)

    def solve(
        self,
        origin: Origin,
        center: Floats,
        sequence: ContactSequence,
        polish: Polish,
    ) -> None:
        """Makes a candidate of a sequence by a polish; it replaces one of equal sequence."""
        with self.clock("polish"):
            self.solved[sequence] = solved, x = polish(center, sequence)
        with self.clock("replay"):
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

    def add_idle(self) -> None:
        """Adds doing nothing, which a plan has to beat."""
        with self.clock("replay"):
            self.others.append(idle_candidate(self.problem))

    @abstractmethod
    def is_known(self, sequence: ContactSequence) -> bool:
        """Returns whether there is a candidate of nearly this sequence."""

    def refine(self) -> None:
        """Improves the best candidates."""
        finalists = self.finalists()[: self.problem.options.finalists]
        for number, sequence in enumerate(finalists, 1):
            self.tell(f"{len(self.by_sequence)} candidates; improving number {number}")
            self.improve(sequence)

    @abstractmethod
    def finalists(self) -> list[ContactSequence]:
        """Returns the sequences that are worth improving, the best first."""

    @abstractmethod
    def improve(self, sequence: ContactSequence) -> None:
        """Adds candidates near a sequence, or a better one in its place."""

    def rank_of(self, sequence: ContactSequence) -> tuple[float, ...]:
        """Returns what its candidate is ordered by."""
        return self.rank(self.by_sequence[sequence])
