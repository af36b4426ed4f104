"""Plans in a thread of their own: one at once near the last, better ones while nobody asks."""

from __future__ import annotations

import dataclasses
import queue
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import AigtoError
from drake_aigto.planning import Plan, Planner, PlanningError, PlanOptions
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import World

_REST = 0.3  # that sliders have to rest until the whole search begins [s]
_WAIT = 0.5  # from look to look whether it is over [s]
_STEPS = 12  # no more than a plan's own: there are no boxes to resolve


class LiveQuestion(NamedTuple):
    """A question that sliders ask."""

    changed: Mapping[str, Any]  # what `Planner.plan` takes instead of the scenario's
    walls: Floats  # how much nearer each stands than in the model [m]
    is_kicked: bool  # whether a kick asks it
    asked: float  # when, of `time.monotonic` [s]


class LiveAnswer(NamedTuple):
    """A plan, or the reason why there is none, and the planner."""

    question: LiveQuestion
    plan: Plan | AigtoError
    planner: Planner


class _AskedAgainError(Exception):
    """Another question ends the search."""


class BackgroundPlanner:
    """Answers the newest question first, and then better, in a thread of its own.

    The first answer begins with the last plan: its motion, and few other starts or, of balls, the
    contacts of the uncontrolled motion and none, lead to a plan of the same or of another kind.
    Once nobody has asked for a moment, the whole search follows; its plans are answers, too.
    Another question ends it.

    Attributes:
        answers: so far, to be taken.
    """

    def __init__(self, planner: Planner, walls: Sequence[int]) -> None:
        """Takes a planner of the model, and which of its contacts are walls that move."""
        self._model, self._contacts = planner, walls
        self.answers: queue.Queue[LiveAnswer] = queue.Queue()
        self._is_busy = False
        self._asked, self._is_over = threading.Event(), False
        self._last: Trajectory | None = None
        # Planners of the world as its walls stand now: how much nearer than in the model [m].
        self._brief: Planner | None = None
        self._whole: Planner | None = planner
        self._walls = np.zeros(len(walls))
        self._thread: threading.Thread | None = None

    def ask(self, changed: Mapping[str, Any], walls: Floats, is_kicked: bool = False) -> None:
        """Asks a question, in place of any other that was not answered yet."""
        self._question = LiveQuestion(changed, walls, is_kicked, time.monotonic())
        self._asked.set()
        if self._thread is None:
            self._thread = threading.Thread(target=self._work, daemon=True)
            self._thread.start()

    @property
    def is_searching(self) -> bool:
        """Whether more answers may follow."""
        return self._asked.is_set() or self._is_busy or not self.answers.empty()

    def stop(self) -> None:
        """Ends it, as soon as the step that runs is done."""
        self._is_over = True
        self._asked.set()

    def _work(self) -> None:
        while not self._is_over:
            if self._asked.wait(_WAIT):
                self._is_busy = True
                self._asked.clear()
                for answer in self._answer(self._question):
                    self.answers.put(answer)
                self._is_busy = False

    def _answer(self, question: LiveQuestion) -> Iterator[LiveAnswer]:
        """Yields answers until there is no better one, or another question."""
        planner = self._model
        try:
            model, changed = self._model, question.changed
            if not np.array_equal(question.walls, self._walls):
                self._walls, self._brief = question.walls, None
                self._whole = None if question.walls.any() else model
            scenario = dataclasses.replace(model.scenario, **changed)
            if self._last is not None:
                if self._brief is None:
                    self._brief = Planner(scenario, _hasten(model), self._stand(is_brief=True))
                planner = self._brief
                with suppress(PlanningError):  # The whole search may find a plan.
                    found = planner.plan(initial_guess=self._last, **changed)
                    self._last = found.trajectory
                    yield LiveAnswer(question, found, planner)
                    if self._asked.wait(_REST):
                        return
            if self._whole is None:
                self._whole = Planner(scenario, model.options, self._stand(is_brief=False))
            planner = self._whole
            for found in planner.plans(self._leave_if_asked, self._last, **changed):
                self._last = found.trajectory
                yield LiveAnswer(question, found, planner)
        except _AskedAgainError:
            return
        except AigtoError as error:
            yield LiveAnswer(question, error, planner)

    def _leave_if_asked(self, _: str) -> None:
        if self._asked.is_set():
            raise _AskedAgainError

    def _stand(self, is_brief: bool) -> World:
        """Returns the world with its walls as they stand.

        One for a brief search has no diagram of its own: to copy and read that takes as long as a
        plan.
        """
        world = self._model.world
        if is_brief:
            moved = {
                world.shapes[c][1]: d for c, d in zip(self._contacts, self._walls, strict=True)
            }
            return world.with_walls_nearer(np.array([moved.get(w, 0.0) for _, w in world.shapes]))
        walls = np.flatnonzero(self._walls).tolist()
        return world.with_walls_moved({self._contacts[i]: self._walls[i] for i in walls})


def _hasten(planner: Planner) -> PlanOptions:
    """Returns options for a plan near a guess: few starts beside it, and one finalist.

    Of balls, no boxes: compiling their program for each place of a wall takes longer than all else,
    and the contacts of the guess, of the uncontrolled motion and of a flight are the best more
    often than those that few boxes show.
    """
    few: dict[str, Any] = {"starts": 1, "renewals": 0}
    if planner.is_of_balls:
        few = {"ladder": (), "branches": 0, "aigo_steps": _STEPS}
    return dataclasses.replace(planner.options, finalists=1, **few)
