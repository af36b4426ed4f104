"""The search for a mechanism's plan between rigid walls: other touches near the best motions'."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from itertools import chain, pairwise
from typing import ClassVar, TypeAlias

import numpy as np

from drake_aigto.contact import read_mode
from drake_aigto.planning.candidate import COASTING, ChangeName, Origin
from drake_aigto.planning.mechanisms.closing import Aim
from drake_aigto.planning.mechanisms.modes import (
    drop,
    is_closed,
    list_hold_changes,
    list_mode_changes,
)
from drake_aigto.planning.mechanisms.phases import BouncingResult
from drake_aigto.planning.mechanisms.rigid_task import RigidMechanismTask
from drake_aigto.planning.mechanisms.search import (
    SAME,
    Closed,
    KeptMotion,
    MechanismSearch,
)
from drake_aigto.planning.mechanisms.task import MechanismTask
from drake_aigto.planning.search import Proposal, Stopwatch, scaled
from drake_aigto.planning.sequences import swapped
from drake_aigto.shooting import ShootingResult
from drake_aigto.transcription import Touch, TouchSequence

# Neighbors are tried of at most 3 of the best motions, which cost at most 1.5 times the best, and
# of at most 6 per wave of proposals: along a wall the number of sequences has no bound.
_MOST_BRANCHED, _PROMISING, _MOST_BRANCHES = 3, 1.5, 6
# With friction, motions that cost more than this times the best while violations only have a price
# are left unfinished (without it: `polish_ratio`). Of 185 neighbors in a shot with spin no costlier
# one led to a new and better motion, and they took three quarters of the time.
_HOPELESS = 3.0
# How many of the first touches of the uncontrolled motion are tried.
_MOST_UNCONTROLLED = 3
# Touches closer than this part of the duration count as the same, and may be swapped.
_NEAR = 0.05

# Which contacts are touched, how the impacts end, and roughly when and for how long.
_Key: TypeAlias = tuple[tuple[int, int, int, int], ...]


class RigidMechanismSearch(MechanismSearch):
    """The search on springs and in phases, and neighbors of the best sequences of touches.

    After each wave of proposals a touch of the best motions is dropped, added, swapped with the
    next, or, with friction, changed to another mode or divided into two, until no change improves
    a motion. Most time of a polish is spent on meeting walls to rounding, which lowers the cost by
    less than half a percent: motions that cost more than that are not polished so far.
    """

    task: RigidMechanismTask
    polish_ratio: ClassVar[float] = 1.2
    simulate_ratio: ClassVar[float] = 1.01

    def __init__(self, task: RigidMechanismTask, clock: Stopwatch | None = None) -> None:
        """Starts with no motion."""
        super().__init__(task, clock)
        self._tried: set[_Key] = set()
        self._branched: list[KeptMotion] = []

    def propose(self) -> Iterator[Sequence[Proposal]]:
        """Yields the centers of all rungs, and motions with the first touches without control.

        A fast start touches a wall at once, where boxes and springs are too coarse to tell how.
        """
        yield from super().propose()
        first = self.task.coasting[:_MOST_UNCONTROLLED]
        sequences = [first[: count + 1] for count in range(len(first))]
        guess = self.task.idle_motion
        yield [
            Proposal(Origin(COASTING), partial(self._bounce, touches, guess))
            for touches in sequences
        ]

    def close(self, wave: Sequence[Proposal]) -> None:
        """Closes motions, and neighbors of the best until none of these leads to a better one."""
        super().close(wave)
        for _ in range(_MOST_BRANCHES):
            motion = self._find_unbranched()
            if motion is None:
                return
            self._branched.append(motion)
            self._branch(motion.origin, _read(motion))

    def _find_aim(self) -> Aim:
        """Returns the aim that leaves motions unfinished that cost far more than the best."""
        misses, cost = self.motions[0].rank if self.motions else (True, np.inf)
        times = _HOPELESS if self.task.rigid_law.has_friction else self.polish_ratio
        return Aim(np.inf if misses else scaled(times, cost))

    def _improve(self, problem: MechanismTask, motion: ShootingResult) -> ShootingResult:
        assert isinstance(problem, RigidMechanismTask)
        return problem.polish(motion, self._scale_best(self.simulate_ratio))

    def _find_unbranched(self) -> KeptMotion | None:
        """Returns one of the best motions with neighbors that were not tried yet."""
        best = self.motions[:_MOST_BRANCHED]
        for motion in best:
            is_promising = motion.cost <= scaled(_PROMISING, best[0].cost)
            known = (each for each in self._branched if self._are_same(each, motion))
            if is_promising and all(self._is_better(motion, each) for each in known):
                return motion
        return None

    def _is_better(self, motion: KeptMotion, known: KeptMotion) -> bool:
        """Returns whether a motion costs less, or as much with fewer touches.

        One optimum has many sequences, with touches that hardly push. Each touch makes it more
        likely that a simulation deviates.
        """
        costs_same = abs(motion.cost - known.cost) <= SAME * abs(known.cost)
        fewer = len(_read(motion).touches) - len(_read(known).touches)
        if motion.rank[0] == known.rank[0] and costs_same and fewer:
            return fewer < 0
        return motion.rank < known.rank

    def _branch(self, origin: Origin, motion: BouncingResult) -> None:
        """Closes the neighbors of a motion that were not tried yet."""
        proposals = []
        for change, touches in self._find_neighbors(motion):
            key = self._find_key(touches)
            if key not in self._tried:
                self._tried.add(key)
                changed = origin.changed(change, motion.touches)
                proposals.append(Proposal(changed, partial(self._bounce, touches, motion)))
        if proposals:
            super().close(proposals)

    def _bounce(self, touches: TouchSequence, guess: ShootingResult) -> Closed:
        return 0, self.task.bounce(touches, guess, self._aim.most)

    def _find_neighbors(self, motion: BouncingResult) -> Iterator[tuple[ChangeName, TouchSequence]]:
        """Yields sequences with one touch fewer, two swapped, one more, and in another mode."""
        touches = motion.touches
        for place in range(len(touches)):
            yield "dropped", drop(touches, place)
        for other in swapped(touches, _NEAR * self.task.scenario.duration):
            yield "swapped", other
        for place, added in self._find_additions(motion):
            yield "added", (*touches[:place], added, *touches[place:])
        law = self.task.rigid_law
        for other in chain(list_mode_changes(law, touches), list_hold_changes(law, touches)):
            yield "mode", other

    def _find_additions(self, motion: BouncingResult) -> Iterator[tuple[int, Touch]]:
        """Yields touches of each contact in each phase: at its smallest distance and half-way."""
        world, times, law = self.task.world, motion.times, self.task.rigid_law
        n = world.num_positions
        distances = world.calc_signed_distance(motion.states[:, : world.num_positions])
        ends = [0, *motion.knots.tolist(), len(times) - 1]
        lasting, closed = self.task.lasting, is_closed(world, *np.split(motion.states[0], [n]))
        starts = [touch.start for touch in motion.touches]
        for (first, last), held in zip(pairwise(ends), motion.held, strict=True):
            place = int(np.searchsorted(starts, times[first], side="right"))
            for contact in np.flatnonzero(~held).tolist() if last - first > 1 else []:
                if first == 0 and closed[contact]:
                    yield 0, Touch(0.0, float(times[last]), contact)
                nearest = first + 1 + int(np.argmin(distances[first + 1 : last, contact]))
                state = motion.states[nearest]
                mode = read_mode(world, law, contact, state[:n], state[n:])
                for time in (times[nearest], (times[first] + times[last]) / 2):
                    end = time if lasting[contact] else (time + times[last]) / 2
                    yield place, Touch(float(time), float(end), contact, mode)

    def _find_key(self, touches: TouchSequence) -> _Key:
        near = _NEAR * self.task.scenario.duration
        return tuple(
            (
                touch.contact,
                touch.mode,
                round(touch.start / near),
                round((touch.end - touch.start) / near),
            )
            for touch in touches
        )


def _read(motion: KeptMotion) -> BouncingResult:
    """Returns a motion of this search, which is in phases."""
    assert isinstance(motion.result, BouncingResult)
    return motion.result
