"""Searches whose candidates have a contact sequence each: boxes of AIGO propose it."""

from __future__ import annotations

import logging
import math
import threading
from abc import abstractmethod
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from itertools import count
from typing import Any

from drake_aigto.aigo import AigoResult, Iterate, Status
from drake_aigto.arrays import Floats
from drake_aigto.planning.candidate import Candidate, Origin
from drake_aigto.planning.options import Rung
from drake_aigto.planning.program_task import ContactSequence, ProgramTask
from drake_aigto.planning.search import Proposal, Search, Stopwatch, wait_for

_LOG = logging.getLogger(__name__)

Polish = Callable[..., Any]


class SequenceSearch(Search):
    """Search for candidates by contact sequence, each judged as soon as it is closed.

    Attributes:
        by_sequence: the candidates so far, in the order that they were found.
        centers: of the boxes that each sequence was read off.
        solved: the motion of each.
        shown: the rungs so far, each with the contact sequences of its last box, the most literal
            first.
    """

    task: ProgramTask

    def __init__(self, task: ProgramTask, clock: Stopwatch | None = None) -> None:
        """Starts with no candidate."""
        super().__init__(task, clock)
        self.by_sequence: dict[ContactSequence, Candidate] = {}
        self.centers: dict[ContactSequence, Floats] = {}
        self.solved: dict[ContactSequence, Any] = {}
        self.shown: list[tuple[Rung, list[ContactSequence]]] = []
        self._is_stopped = threading.Event()  # By Ctrl-C, while boxes run in threads.

    @property
    def candidates(self) -> Iterable[Candidate]:
        """Candidates of the search, in the order that they were found."""
        return self.by_sequence.values()

    @property
    def promise(self) -> float:
        """The least replayed cost of candidates that hold so far."""
        costs = (e.replay.cost for e in self.candidates if e.is_feasible and e.is_confirmed)
        return min(costs, default=math.inf)

    def propose(self) -> Iterator[Sequence[Proposal]]:
        """Yields boxes of the ladder's rungs, grouped if they may run in parallel."""
        numbers, total = count(1), len(self.task.ladder)
        for rungs in self.rungs():
            yield [
                self.propose_boxes(
                    rung,
                    f"AIGO {next(numbers)} of {total}: {rung.describe(self.task.algorithm_name)}",
                )
                for rung in rungs
            ]

    def propose_boxes(self, rung: Rung, text: str = "") -> Proposal:
        """Returns the proposal of a rung's boxes: after Ctrl-C, AIGO's best so far."""
        run = partial(self.task.run_aigo, rung, None, self._stop_if_asked)
        return Proposal(Origin(self.task.algorithm_name, rung), run, text)

    def vary(self) -> Iterator[Sequence[Proposal]]:
        """Yields nothing: the best are improved as they are judged."""
        yield from ()

    def add_left_out(self) -> None:
        """Adds nothing: all were judged as they were found."""

    def list_found(self) -> Collection[object]:
        """Returns the candidates so far."""
        return self.by_sequence

    def rungs(self) -> Iterator[tuple[Rung, ...]]:
        """Yields the ladder's rungs in the order to run them, grouped if they may run in parallel.

        Results of each group have to be added before the next is requested: rungs may be left out
        because of results of others, never by clocks.
        """
        yield self.task.ladder

    @property
    def box_contacts(self) -> tuple[int | None, ...]:
        """Numbers of contacts of the last box of each rung, None if that was left out."""
        counts: list[int | None] = []
        for rung in self.task.ladder:
            found = [sequences for each, sequences in self.shown if each == rung]
            counts.append(max(map(len, found[0][:1]), default=0) if found else None)
        return tuple(counts)

    def _close_at_once(self, wave: Sequence[Proposal]) -> Iterable[Any]:
        """Yields the result of each proposal; of interrupted ones, the best so far."""
        most = self.task.num_threads if len(wave) > 1 else 1
        for first in range(0, len(wave), most):
            at_once = wave[first : first + most]
            for each in at_once:
                if each.text:
                    self.tell(each.text)
            if len(at_once) == 1:
                with self.clock("aigo"):
                    found = at_once[0].close()
                yield found
                continue
            with self.clock("aigo"):
                self.task.prepare(each.origin for each in at_once)
                runs, is_interrupted = self._run_in_threads(at_once)
            yield from (run.result() for run in runs)
            if is_interrupted:
                raise KeyboardInterrupt

    def _run_in_threads(self, wave: Sequence[Proposal]) -> tuple[list[Future[Any]], bool]:
        """Returns the runs, and whether Ctrl-C came, which ends boxes at once."""
        runs: list[Future[Any]] = []
        with ThreadPoolExecutor(len(wave)) as pool:
            try:
                runs.extend(pool.submit(each.close) for each in wave)
                wait_for(runs)
            except KeyboardInterrupt:
                self._is_stopped.set()
        return runs, self._is_stopped.is_set()

    def _stop_if_asked(self, _: Iterate) -> None:
        if self._is_stopped.is_set():
            raise KeyboardInterrupt  # In its thread, where `minimize` handles it as Ctrl-C.

    def keep(self, origin: Origin, found: AigoResult) -> None:
        """Adds the candidates of the sequences of boxes, unless they are known.

        Raises:
            KeyboardInterrupt: AIGO was interrupted; its best so far is a candidate by now.
        """
        rung = origin.rung
        assert isinstance(rung, Rung)
        with self.clock("aigo"):
            sequences = self.task.find_sequences(found, rung)
        self.aigo_steps += found.num_inner_steps
        _LOG.info(
            "  %s after %d inner steps; contact sequences: %d",
            found.status.name.lower(),
            found.num_inner_steps,
            len(sequences),
        )
        self.shown.append((rung, sequences))
        for sequence in sequences:
            if not self.is_known(sequence):
                self.add(origin, found.box.center, sequence)
        if found.status is Status.INTERRUPTED and not self._is_stopped.is_set():
            raise KeyboardInterrupt

    def add(self, origin: Origin, center: Floats, sequence: ContactSequence) -> None:
        """Adds the candidate of a sequence read off a box center."""
        self.solve(origin, center, sequence, self.task.polish)

    def solve(
        self, origin: Origin, center: Floats, sequence: ContactSequence, polish: Polish
    ) -> None:
        """Polishes a sequence to a candidate; it replaces one of equal sequence."""
        with self.clock("polish"):
            self.solved[sequence] = polish(center, sequence)
        with self.clock("replay"):
            candidate = self.task.judge(origin, center, self.solved[sequence])
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

    @abstractmethod
    def is_known(self, sequence: ContactSequence) -> bool:
        """Returns whether there is a candidate of nearly this sequence."""

    def judge(self) -> None:
        """Improves the best candidates, unless Ctrl-C ended the search."""
        if self.is_interrupted:
            return
        finalists = self.finalists()[: self.task.options.finalists]
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
        """Returns the sorting key of its candidate."""
        return self.rank(self.by_sequence[sequence])
