"""The search for a mechanism's plan between rigid walls: other touches near the best motions'."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from collections.abc import Callable
from functools import partial

import numpy as np

from drake_aigto.planning.mechanism_phases import BouncingResult
from drake_aigto.planning.mechanism_search import Closed, MechanismSearch, Motion
from drake_aigto.planning.origin import ChangeName, Origin
from drake_aigto.planning.pool import Stopwatch
from drake_aigto.planning.rigid_mechanism import RigidMechanismProblem
from drake_aigto.planning.touches import swapped
from drake_aigto.shooting import ShootingResult
from drake_aigto.transcription import Touch, TouchSequence

# Neighbors are tried of so many of the best motions.
_MOST_BRANCHED = 3
# Sequences whose touches are this near, as a part of the duration, are one.
_SAME_TIME = 0.05
_BETWEEN = (0.25, 0.75)


class RigidMechanismSearch(MechanismSearch):
    """The search on springs and in phases, and neighbors of the best sequences of touches.

    After each wave of proposals, a touch is dropped, added or swapped with the next in the best
    motions, until none of these leads to a better one.
    """

    problem: RigidMechanismProblem

    def __init__(
        self, problem: RigidMechanismProblem, clock: Stopwatch | None = None
    ) -> None:
        """Starts with no motion."""
        super().__init__(problem, clock)
        self._tried: set[tuple[tuple[int, int], ...]] = set()
        self._branched: set[tuple[tuple[int, int], ...]] = set()

    def _close_all(
        self, origins: Iterable[Origin], closings: Sequence[Callable[[], Closed]]
    ) -> None:
        super()._close_all(origins, closings)
        while (motion := self._find_unbranched()) is not None:
            self._branched.add(self._key(motion.result.touches))
            self._branch(motion)

    def _find_unbranched(self) -> Motion | None:
        best = self.motions[:_MOST_BRANCHED]
        for motion in best:
            if self._key(motion.result.touches) not in self._branched:
                return motion
        return None

    def _branch(self, motion: Motion) -> None:
        """Closes the neighbors of a motion's touches."""
        touches = motion.result.touches
        origins, closings = [], []
        for change, other in self._find_neighbors(motion.result):
            key = self._key(other)
            if key in self._tried:
                continue
            self._tried.add(key)
            origins.append(motion.origin.changed(change, touches))
            closings.append(partial(self._bounce, other, motion.result))
        if closings:
            super()._close_all(origins, closings)

    def _bounce(self, touches: TouchSequence, guess: ShootingResult) -> Closed:
        return 0, self.problem.bounce(touches, guess)

    def _find_neighbors(
        self, motion: BouncingResult
    ) -> Iterator[tuple[ChangeName, TouchSequence]]:
        """Yields sequences with a touch less, two swapped, and one more."""
        touches, T = motion.touches, self.problem.scenario.duration
        for place in range(len(touches)):
            yield "dropped", (*touches[:place], *touches[place + 1 :])
        for other in swapped(touches, _SAME_TIME * T):
            yield "swapped", other
        q = motion.states[:, : self.problem.world.num_positions]
        distances = self.problem.world.calc_signed_distance(q)
        ends = [0, *motion.knots.tolist(), len(motion.times) - 1]
        for place, (first, last) in enumerate(zip(ends[:-1], ends[1:])):
            inside = slice(first + 1, last)
            for contact in range(distances.shape[1]):
                if last - first < 2:
                    continue
                knot = first + 1 + int(np.argmin(distances[inside, contact]))
                for time in (motion.times[knot], (motion.times[first] + motion.times[last]) / 2):
                    added = Touch.bounce(time, contact)
                    yield "added", (*touches[:place], added, *touches[place:])

    def _key(self, touches: TouchSequence) -> tuple[tuple[int, int], ...]:
        near = _SAME_TIME * self.problem.scenario.duration
        return tuple((touch.contact, round(touch.start / near)) for touch in touches)
