"""Neighbors of good candidates: other contacts, and other times of the same ones."""

from __future__ import annotations

import dataclasses
import math
from abc import abstractmethod
from collections.abc import Collection, Iterable, Iterator, Sequence
from functools import cached_property
from itertools import chain, pairwise
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError, TrajectoryError, UnsupportedTermError
from drake_aigto.planning.balls.phases import Path, PhaseMotion
from drake_aigto.planning.balls.task import BallTask
from drake_aigto.planning.candidate import LARGEST_DEFECT, ChangeName, Origin
from drake_aigto.planning.search import Proposal, Stopwatch, scaled
from drake_aigto.planning.sequence_search import SequenceSearch, is_same, kinds, neighbors, retimed
from drake_aigto.transcription import Touch, TouchSequence, largest_defect
from drake_aigto.world import World

# Times of two sequences of the same contacts differ by at most these parts of the duration if their
# polish is expected to end in one optimum, and if it has.
SAME_START, SAME_END = 0.05, 1e-3
# Of a growing sequence; a neighbor may have one more than the uncontrolled motion.
MOST_TOUCHES = 8
# Neighbors are tried of candidates that cost at most 3 times the best, with few time steps and
# iterations of the local solver: most are hopeless or infeasible, and infeasible ones take the
# solver longest.
GOOD, _TRIAL_STEPS, _TRIAL_ITERATIONS = 3.0, 20, 30
# A wall is grazed within this part of the length scale.
_GRAZE = 1e-5
# Distance of a new touch to those before and after it, as a part of the time between them.
_ROOM = 0.2
# The same of a touch that comes soon before the next.
_LATE = 0.05
# Shortest time between touches with room for another, as a part of the duration.
_LEAST_GAP = 1e-3
# Contacts are coupled if J M⁻¹ Jᵀ is more than this.
_FELT = 1e-9
# Rests are tried that last at least this part of the duration, and end as long before its end.
_LEAST_REST = 0.02


class Shown(NamedTuple):
    """A contact sequence that was read off a motion."""

    center: Floats | None  # of the box that led to it, if one did
    sequence: TouchSequence  # the contacts
    path: Path | None = None  # along which they are; the box center's if None
    solved: PhaseMotion | None = None  # the closed motion, if known


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

    def vary(self) -> Iterator[Sequence[Proposal]]:
        """Yields neighbors (`neighbors`) of good sequences, the best first, once for each."""
        self.tell(f"{len(self.by_sequence)} candidates; looking for others near the best")
        branched: set[PhaseMotion] = set()
        while len(branched) < self.task.options.branches and (good := self._list_good(branched)):
            branched.add(self.solved[good[0]])
            yield from self._branch(good[0])
        yield from self.propose_far()
        for _ in range(self.task.options.branches):
            best = self._list_good(set())[:1]
            if not best or self.solved[best[0]] in branched:
                return
            branched.add(self.solved[best[0]])
            yield from self._branch(best[0])

    @abstractmethod
    def propose_far(self) -> Iterator[Sequence[Proposal]]:
        """Yields sequences that need not be near the best."""

    def _list_good(self, branched: Collection[PhaseMotion]) -> list[TouchSequence]:
        """Returns good sequences that were not branched, the best first."""
        costs = (candidate.replay.cost for candidate in self.by_sequence.values())
        least = min(costs, default=math.inf)
        good = [
            sequence
            for sequence, candidate in self.by_sequence.items()
            if self.solved[sequence] not in branched
            and candidate.is_feasible
            and candidate.replay.cost <= scaled(GOOD, least)
        ]
        return sorted(good, key=self.rank_of)

    def _branch(self, sequence: TouchSequence) -> Iterator[Sequence[Proposal]]:
        """Yields the neighbors of a sequence whose trial is good."""
        motion, origin = self.solved[sequence], self.by_sequence[sequence].origin
        more = [*find_grazes(motion), *find_insertions(motion)]
        optimum = motion.sequence
        for path in find_other_sides(motion):
            change = origin.changed("passed", sequence)
            yield from self.propose_good(change, self.centers[sequence], optimum, path)
        others = [*find_rests(motion), *retimed(optimum, self._pulling, self._duration)]
        for other in [*others, *neighbors(optimum, more)]:
            # Times of a plan that holds are the best ones, unless something pulls to a wall; those
            # of others may not be.
            held = [kinds(each) for each, it in self.by_sequence.items() if it.is_confirmed]
            is_pulled = any(touch.contact in self._pulling for touch in other)
            is_new = (is_pulled or kinds(other) not in held) and not self.is_known(other)
            if is_new:
                kind: ChangeName = "dropped" if len(other) < len(sequence) else "added"
                kind = "moved" if kinds(sequence) == kinds(other) else kind
                change = origin.changed(kind, sequence)
                yield from self.propose_good(change, self.centers[sequence], other, motion.path)

    def propose_good(
        self, origin: Origin, center: Floats | None, sequence: TouchSequence, path: Path
    ) -> Iterator[Sequence[Proposal]]:
        """Yields the proposal of a sequence along a path if its trial is good, and new."""
        # A fast ball bounces often by itself.
        most = max(MOST_TOUCHES, 1 + len(self.task.coast.bounce_times))
        if len(sequence) > most or not self.task.fits(sequence):
            return
        tried = self._try(sequence, path)
        optima = map(self._optimum, self.by_sequence)
        is_new = tried and not self._is_among(tried.sequence, optima, SAME_END)
        if tried and (is_new or self._is_better(tried, sequence)):
            # If long arcs sufficed, the trial was the polish.
            solved = tried if tried.is_of_arcs else None
            yield [propose(origin, Shown(center, sequence, path, solved))]
        else:
            self._refused.append(sequence)

    def _is_better(self, motion: PhaseMotion, sequence: TouchSequence) -> bool:
        """Returns whether the candidate of a sequence passes a block on a side that costs more."""
        known = self.by_sequence.get(sequence)
        return known is not None and not (
            known.is_confirmed and known.cost <= self.task.cost(motion)
        )

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
        # Of many touches, a polish with arcs between all knots takes seconds.
        is_quick = found.is_of_arcs or len(sequence) <= MOST_TOUCHES
        return found if is_feasible and is_good and is_quick else None

    def is_known(self, sequence: TouchSequence) -> bool:
        """Returns whether nearly this sequence was polished, refused, or the result of a polish."""
        optima = map(self._optimum, self.by_sequence)
        known = chain(self.by_sequence, optima, self._refused)
        return self._is_among(sequence, known, SAME_START)

    def _optimum(self, sequence: TouchSequence) -> TouchSequence:
        """Returns a sequence with its times after the polish."""
        motion: PhaseMotion = self.solved[sequence]
        return motion.sequence

    def _is_among(
        self, sequence: TouchSequence, others: Iterable[TouchSequence], share: float
    ) -> bool:
        return any(is_same(sequence, other, share * self._duration) for other in others)


def find_insertions(motion: PhaseMotion) -> list[Touch]:
    """Returns one more bounce for each wall and each gap between touches coupled to it.

    Contacts are not coupled if no impulse of one changes the other's speed, J_i M⁻¹ J_jᵀ = 0; their
    order makes no difference. The wall of the last or next touch is left out, unless something
    pulls towards it. Each bounce is where the motion comes nearest to the wall; with such a pull
    there is another one soon before the next touch, high and late.
    """
    world, T = motion.phases.world, motion.phases.scenario.duration
    times, distances = motion.trajectory.times, motion.distances
    felt = np.abs(world.constant_inertia.delassus) > _FELT
    pulls = find_pulls(world, motion.trajectory.positions[-1])
    sequence, found = motion.sequence, []
    for contact in range(world.num_contacts):
        touches = [t for t in sequence if felt[contact, t.contact]]
        starts, ends = [0.0, *(t.end for t in touches)], [*(t.start for t in touches), T]
        walls = [None, *(t.contact for t in touches), None]
        for gap, (start, end) in enumerate(zip(starts, ends, strict=True)):
            is_next_to_itself = contact in walls[gap : gap + 2] and pulls[contact] <= 0
            if is_next_to_itself or end - start < _LEAST_GAP * T:
                continue
            margin = _ROOM * (end - start)
            inside = np.flatnonzero((times > start + margin) & (times < end - margin))
            nearest = inside[np.argmin(distances[inside, contact])] if inside.size else None
            time = (start + end) / 2 if nearest is None else float(times[nearest])
            found.append(Touch.bounce(time, contact))
            if pulls[contact] > 0:
                found.append(Touch.bounce(end - _LATE * (end - start), contact))
    return found


def find_grazes(motion: PhaseMotion) -> list[Touch]:
    """Returns bounces where the motion keeps off a wall at φ = 0 by its control alone.

    A touch may pay there. There is one bounce per run of such knots.
    """
    times, length = motion.trajectory.times, motion.phases.scales.length
    near = motion.phases.timeline.marks.apart & (motion.distances < _GRAZE * length)
    found = []
    for contact, knots in enumerate(near[1:-1].T):
        where = np.flatnonzero(knots) + 1
        runs = np.split(where, np.flatnonzero(np.diff(where) > 1) + 1) if where.size else []
        found += [Touch.bounce(float(np.mean(times[run])), contact) for run in runs]
    return found


def find_other_sides(motion: PhaseMotion) -> Iterator[Path]:
    """Yields paths that pass a block on its other side, one per face that is passed untouched.

    While a face, after and before others, is in force, the path is mirrored about the middle of the
    block: q + Jᵀ (φ' − φ) / ‖J‖² with J and φ of that face, and φ' of the opposite one.
    """
    world, (times, positions), phi = motion.phases.world, motion.path, motion.distances
    jacobian = world.calc_contact_jacobian(positions[0])
    for faces in world.solids:
        passed = [facing for facing in motion.facings if facing.contact in faces]
        for facing, later in pairwise(passed[1:]):
            face, start, end = facing.contact, facing.start, later.start
            if any(t.contact == face and start <= t.end <= end for t in motion.sequence):
                continue
            row, beside = jacobian[face], (times >= start) & (times <= end)
            opposite = min(faces, key=lambda other: float(jacobian[other] @ row))
            mirrored, off = positions.copy(), (phi[:, opposite] - phi[:, face])[beside]
            mirrored[beside] += np.outer(off, row / (row @ row))
            yield times, mirrored


def find_pulls(world: World, q: Floats) -> Floats:
    """Returns the acceleration towards each contact at rest and without control, (m,) [m/s²]."""
    still = np.zeros(world.num_velocities), np.zeros(world.num_actuators)
    return -world.constant_inertia.jacobian @ world.calc_acceleration(q, *still)


def find_rests(motion: PhaseMotion) -> list[TouchSequence]:
    """Returns sequences with one touch sustained, and no later touches of its wall.

    Off an elastic wall no bounce ends in rest. The contact is left in time for the cheapest
    jump to the goal's distance d from the wall, against the acceleration a towards it: from rest,
    of all durations √(6 d/a) takes the least effort, 3 (d + a τ²/2)²/τ³.
    """
    world, scenario = motion.phases.world, motion.phases.scenario
    T, restitutions = scenario.duration, motion.phases.restitutions
    pulls = find_pulls(world, scenario.goal_position)
    heights = world.calc_signed_distance(scenario.goal_position)
    sequence, found = motion.sequence, []
    for place, touch in enumerate(sequence):
        i = touch.contact
        if pulls[i] <= 0 or restitutions[i] == 1:
            continue
        left = min(T - touch.start, math.sqrt(6 * max(heights[i], 0.0) / pulls[i]))
        end = min(max(T - left, touch.start + _LEAST_REST * T), (1 - _LEAST_REST) * T)
        if end > touch.start:
            after = (other for other in sequence[place + 1 :] if other.contact != i)
            rest = dataclasses.replace(touch, end=end)
            found.append((*sequence[:place], rest, *after))
    return found
