"""Questions, choices and memory of the ticks of a controller that plans again."""

from __future__ import annotations

import weakref
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.horizon import Horizon
from drake_aigto.control.ports import Sample, TickStatus
from drake_aigto.control.touches import PlannedMotion, SeenBounces
from drake_aigto.planning import Cut, Feedback

# A wall that is planned to be hit within this number of periods, and left, has been hit.
_NEAR = 2.0
# A state that is off its plan by no more than this part of the scales is on it.
_ON_PLAN = 0.02
# A plan that costs more than the one before met no surprise if that is less than this part of the
# task's scale.
_NOTHING = 1e-3


class PendingSearch(NamedTuple):
    """A search that goes on in its thread."""

    due: int  # the tick that waits for it
    found: Future[PlannedMotion | None]


class TickChoice(NamedTuple):
    """Decision of a tick."""

    motion: PlannedMotion
    reason: str
    has_switched: bool = False
    pending: PendingSearch | None = None


class TickQuestion(NamedTuple):
    """The state that a tick plans from.

    Attributes:
        now: when its command acts, in the task's time [s].
        x: the state then, led on from the sample.
        seen: what is known of walls.
        horizon: knows that, and the goal.
        sampled: the sample itself, and the context's time of it [s].
        sample: whether it is of use.
        deviation: how far it is off the plan.
    """

    now: float
    x: Floats
    seen: SeenBounces
    horizon: Horizon
    sampled: tuple[float, Floats]
    sample: Sample = "valid"
    deviation: float = 0.0

    def price(self, motion: PlannedMotion | None, last: PlannedMotion) -> float:
        """Returns the cost of a motion; where there is none, of the last plan if x is on it."""
        if motion is None:
            return last.cost if self.deviation <= _ON_PLAN else np.inf
        return motion.cost

    def find_obstacle(self) -> str | None:
        """Returns why nothing can be planned from here; None: something can."""
        if self.sample != "valid":
            return f"the estimated state is {self.sample}"
        if self.horizon.is_over(self.now):
            return "the horizon ends"
        return "a wall is touched" if self.horizon.is_inside(self.x) else None


@dataclass(frozen=True, eq=False)
class TickMemory:
    """Memory from one tick to the next; contexts share it, as it never changes.

    Attributes:
        choice: what the tick decided.
        commands: the last ones, rows (t, u).
        status: what the output port says.
        tick: how many there were before.
        usable: the last question from which something could be planned.
        seen: what is known of walls.
        feedback: about the plan, where there is some.
    """

    choice: TickChoice
    commands: Floats
    status: TickStatus
    tick: int
    usable: TickQuestion
    seen: SeenBounces
    feedback: Feedback | None = None

    def find_hits(self, question: TickQuestion, period: float) -> list[int]:
        """Returns the contact that the plan is to hit about now, if it is left already."""
        stretches = self.feedback.stretches if self.feedback else []
        if not stretches or stretches[0].cut != Cut.HIT:
            return []
        contact, world = stretches[0].contact, question.horizon.world
        is_near = abs(stretches[0].end - question.now) <= _NEAR * period
        rate = world.calc_contact_rate(*world.split(question.x))[contact]
        return [contact] if is_near and rate > 0 else []

    def __deepcopy__(self, memo: object) -> TickMemory:
        """Returns itself."""
        return self


class Searches:
    """Searches for other contact sequences: when they begin, and in their tick or in a thread."""

    def __init__(
        self, period: float, every: int | None, surprise: float, ticks: int | None, waits: bool
    ) -> None:
        """Takes what `ModelPredictiveController` is given."""
        self._period, self._every, self._surprise = period, every, surprise
        self._ticks, self._waits = ticks, waits
        if ticks is not None:
            self._thread = ThreadPoolExecutor(1, "search")
            # What is under way when nobody can take it any more is not followed by another one.
            weakref.finalize(self, self._thread.shutdown, wait=False, cancel_futures=True)

    def find(
        self,
        before: TickMemory,
        question: TickQuestion,
        motion: PlannedMotion | None,
        aside: Horizon,
    ) -> tuple[bool, PlannedMotion | None, PendingSearch | None]:
        """Returns whether a search is done, what it found, and one that goes on.

        Args:
            before: the last tick.
            question: of this one.
            motion: what a descent from the last plan led to.
            aside: the horizon of the thread, with the goal of now.
        """
        last, pending, tick = before.choice.motion.cost, before.choice.pending, before.tick + 1
        now, x, horizon = question.now, question.x, question.horizon
        if pending is not None:
            if tick < pending.due or not (self._waits or pending.found.done()):
                return False, None, pending
            found = pending.found.result()
            return True, found and horizon.advance(found, now, x), None
        is_due = self._every is not None and tick % self._every == 0
        cost = question.price(motion, before.choice.motion)
        if not is_due and cost - last <= self._calc_surprise(last, horizon.cost_scale):
            return False, None, None
        if self._ticks is None:
            return True, horizon.search(now, x), None
        ahead = now + self._ticks * self._period
        x = motion.calc_state(ahead) if motion else np.array(x)
        if horizon.is_over(ahead) or horizon.is_inside(x):
            return False, None, None
        begun = self._thread.submit(aside.knowing(question.seen).search, ahead, x)
        return False, None, PendingSearch(tick + self._ticks, begun)

    def _calc_surprise(self, cost: float, scale: float) -> float:
        """Returns by how much a plan costs more than the one before, if it met a surprise."""
        if np.isinf(self._surprise):  # What costs nothing any more, too.
            return np.inf
        return self._surprise * cost + _NOTHING * scale
