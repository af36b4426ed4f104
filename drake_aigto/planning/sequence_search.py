"""Searches whose candidates have a contact sequence each: boxes of AIGO propose it; sequences."""

from __future__ import annotations

import logging
import math
import threading
from abc import abstractmethod
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Sequence
from concurrent.futures import Future
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.aigo import AigoResult, Iterate, Status
from drake_aigto.arrays import Floats
from drake_aigto.planning.candidate import Candidate, Origin
from drake_aigto.planning.options import Rung
from drake_aigto.planning.program_task import ContactSequence, ProgramTask
from drake_aigto.planning.search import Proposal, Search, Stopwatch
from drake_aigto.planning.threads import start_threads, wait_for
from drake_aigto.simulation import find_contacts
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch, TouchSequence, Transcription
from drake_aigto.world import World

# An impulse in a box belongs to a contact if it changes the velocity by this part of the largest
# one: with ε > 0 the wall pushes a little at every knot.
_SHARE = 0.05
# Impulses closer than this part of the duration are one contact: boxes smear a bounce over several
# knots.
GAP = 0.1
# Bounces off two walls at one knot are put this part of the duration apart; the polish decides
# their order, and whether they are simultaneous.
_APART = 1e-3
# A bounce that is moved to its neighbor's time keeps this part of the distance.
_SOON = 0.125
# This many successive knots with impulses may be a sustained contact.
_LASTING = 4


class _Pushes(NamedTuple):
    """The impulses of one contact that count."""

    contact: int
    times: Floats  # [s]
    sizes: Floats  # [N s]

    def bounce(self) -> Touch:
        """Returns a bounce at the mean time of the impulses."""
        return Touch.bounce(np.average(self.times, weights=self.sizes), self.contact)

    def split(self, gap: float) -> Iterator[_Pushes]:
        """Yields runs of impulses that are closer than a gap [s]."""
        ends = np.flatnonzero(np.diff(self.times) >= gap) + 1
        for times, sizes in zip(
            np.split(self.times, ends), np.split(self.sizes, ends), strict=True
        ):
            yield _Pushes(self.contact, times, sizes)


def read_sequences(transcription: Transcription, x: Floats) -> list[TouchSequence]:
    """Returns the contact sequences of a box center, the most literal first.

    A contact is a cluster of one wall's impulses. Boxes may split one contact into several,
    and do not distinguish bounces from sustained contacts. So these are returned: each cluster as a
    bounce; all clusters of a wall as one bounce, at the mean time of their impulses; and if a wall
    pushes at successive knots, one sustained contact instead of that wall's bounces.

    Args:
        transcription: of these decision variables.
        x: the box center, shape (n,); the rows need not hold.
    """
    world, q0 = transcription.world, transcription.scenario.initial_position
    motion, pushes = transcription.trajectory(x), list[_Pushes]()
    kicks = np.linalg.norm(world.calc_velocity_change(q0, np.eye(world.num_contacts)), axis=1)
    least = _SHARE * np.max(np.linalg.norm(motion.velocities, axis=1)) / kicks
    for contact, sizes in enumerate(motion.impulses.T):  # After the start.
        pushed = np.flatnonzero(sizes[1:] > least[contact]) + 1
        if pushed.size:
            pushes.append(_Pushes(contact, motion.times[pushed], sizes[pushed]))
    if not pushes:
        return [()]
    T, dt = transcription.scenario.duration, transcription.time_step()
    bounces = [run.bounce() for one in pushes for run in one.split(GAP * T)]
    sequences = [bounces, [one.bounce() for one in pushes]]
    runs = [run for one in pushes for run in one.split(1.5 * dt)]
    longest = max(runs, key=lambda run: run.times.size)
    if longest.times.size >= _LASTING:
        first, last = map(float, longest.times[[0, -1]])
        others = [touch for touch in bounces if touch.contact != longest.contact]
        sequences.append([*others, Touch(first, last, longest.contact)])
    return [put_apart(sequence, T) for sequence in sequences]


def read_touches_of(world: World, trajectory: Trajectory) -> TouchSequence:
    """Returns the touches of a trajectory with impulses and forces, by time."""
    contacts = find_contacts(world, trajectory)
    return tuple(Touch(each.time, each.last_time, each.index) for each in contacts)


def neighbors(sequence: TouchSequence, grazes: Iterable[Touch]) -> list[TouchSequence]:
    """Returns the sequences that boxes may have mistaken for this one.

    They lack the last touch of a wall, for each wall, as boxes are widest at the end, where they do
    not distinguish n bounces from n + 1; or they have one more bounce where a wall is grazed.

    Args:
        sequence: as polished.
        grazes: bounces to try.
    """
    last = {touch.contact: place for place, touch in enumerate(sequence)}
    found = [
        (*sequence[:place], *sequence[place + 1 :]) for place in sorted(last.values(), reverse=True)
    ]
    return found + [
        tuple(sorted((*sequence, graze), key=lambda touch: touch.start)) for graze in grazes
    ]


def swapped(sequence: TouchSequence, near: float) -> list[TouchSequence]:
    """Returns the sequences with simultaneous bounces off two walls in the other order.

    The polish can't change their order, and stops where they meet if the other one is better. In a
    corner of two walls, where a motion bounces off them in turn, a run of such bounces may begin
    with the other wall as well.

    Args:
        sequence: as polished.
        near: bounces no farther apart are simultaneous [s].
    """
    found = []
    for first in range(len(sequence)):
        for end in range(first + 2, len(sequence) + 1):
            run = sequence[first:end]
            contacts = [touch.contact for touch in run]
            at_once = all(later.start - each.start <= near for each, later in pairwise(run))
            is_in_turn = contacts == (contacts[:2] * len(run))[: len(run)] and len({*contacts}) == 2
            if not (at_once and is_in_turn) or any(touch.lasts for touch in run):
                break
            others = (contacts[1 - place % 2] for place in range(len(run)))
            moved = (Touch.bounce(t.start, i) for t, i in zip(run, others, strict=True))
            found.append((*sequence[:first], *moved, *sequence[end:]))
    return found


def retimed(
    sequence: TouchSequence, contacts: Container[int], duration: float
) -> list[TouchSequence]:
    """Returns the sequences with a bounce of contacts soon after the touch before, or the next.

    Under gravity, high late bounces and low early ones are two optima of the same contacts.
    """
    found = []
    for place, touch in enumerate(sequence):
        if touch.lasts or touch.contact not in contacts:
            continue
        before = sequence[place - 1].end if place else 0.0
        after = sequence[place + 1].start if place + 1 < len(sequence) else duration
        for near in (before, after):
            moved = Touch.bounce(near + _SOON * (touch.start - near), touch.contact)
            found.append((*sequence[:place], moved, *sequence[place + 1 :]))
    return found


def kinds(sequence: TouchSequence) -> list[tuple[int, bool]]:
    """Returns the contact of each touch, and whether it is sustained."""
    return [(touch.contact, touch.lasts) for touch in sequence]


def is_same(one: TouchSequence, other: TouchSequence, near: float) -> bool:
    """Returns whether both have the same contacts, at times that `are_near` [s]."""
    return kinds(one) == kinds(other) and all(
        are_near(mine.start, yours.start, near) and are_near(mine.end, yours.end, near)
        for mine, yours in zip(one, other, strict=True)
    )


def are_near(one: float, other: float, near: float) -> bool:
    """Returns whether times differ by at most `near`, and soon after the start by a quarter [s]."""
    return abs(one - other) <= min(near, max(one, other) / 4)


def put_apart(touches: Iterable[Touch], duration: float) -> TouchSequence:
    """Returns touches of a motion [s] by their starts, with bounces moved apart if they meet."""
    found: list[Touch] = []
    for touch in sorted(touches, key=lambda touch: touch.start):
        earliest = found[-1].start + _APART * duration if found else 0.0
        if touch.start < earliest and not touch.lasts:
            touch = Touch.bounce(earliest, touch.contact)
        found.append(touch)
    return tuple(found)


_LOG = logging.getLogger(__name__)

Polish = Callable[..., Any]


class SequenceSearch(Search):
    """Search for candidates by contact sequence, each judged as soon as it is closed.

    Attributes:
        by_sequence: the candidates so far, in the order that they were found.
        centers: of the box that led to each sequence, if one did.
        solved: the motion of each.
        shown: the rungs so far, each with the contact sequences of its last box, the most literal
            first.
    """

    task: ProgramTask

    def __init__(self, task: ProgramTask, clock: Stopwatch | None = None) -> None:
        """Starts with no candidate."""
        super().__init__(task, clock)
        self.by_sequence: dict[ContactSequence, Candidate] = {}
        self.centers: dict[ContactSequence, Floats | None] = {}
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
        """Yields boxes of the ladder's rungs, which may run in parallel.

        After Ctrl-C, each returns AIGO's best so far.
        """
        wave, total, name = [], len(self.task.ladder), self.task.algorithm_name
        for number, rung in enumerate(self.task.ladder, 1):
            run = partial(self.task.run_aigo, rung, None, self._stop_if_asked)
            text = f"AIGO {number} of {total}: {rung.describe(name)}"
            wave.append(Proposal(Origin(name, rung), run, text))
        yield wave

    def vary(self) -> Iterator[Sequence[Proposal]]:
        """Yields nothing: the best are improved as they are judged."""
        yield from ()

    def add_left_out(self) -> None:
        """Adds nothing: all were judged as they were found."""

    def list_found(self) -> Collection[object]:
        """Returns the candidates so far."""
        return self.by_sequence

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
        with start_threads(len(wave)) as pool:
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
        text = "  %s after %d inner steps; contact sequences: %d"
        _LOG.info(text, found.status.name.lower(), found.num_inner_steps, len(sequences))
        self.shown.append((rung, sequences))
        for sequence in sequences:
            if not self.is_known(sequence):
                self.add(origin, found.box.center, sequence)
        if found.status is Status.INTERRUPTED and not self._is_stopped.is_set():
            raise KeyboardInterrupt

    def add(self, origin: Origin, center: Floats | None, sequence: ContactSequence) -> None:
        """Adds the candidate of a sequence read off a box center."""
        self.solve(origin, center, sequence, self.task.polish)

    def solve(
        self, origin: Origin, center: Floats | None, sequence: ContactSequence, polish: Polish
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
