"""What a tracker learns of its plant on the way: by which model its laws are judged."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.estimation import ModelEstimate
from drake_aigto.control.family import Unknown
from drake_aigto.errors import ControlError
from drake_aigto.planning import Feedback
from drake_aigto.simulation import HeldControl
from drake_aigto.world import Scenario, World

# In parts of the interval between samples: by how much one may come early, and after how long a
# break a sample is not compared with the one before.
_EARLY, _LONGEST = 1e-6, 2.0


class LearnedModel:
    """A `ModelEstimate` as numbers, by which the laws of a `Feedback` are judged.

    The numbers are the time of the last sample and q and v then, the values, those about which
    models were built, and the sums: all that a context has to remember. The models follow from
    them, and the last ones are kept.

    Attributes:
        nothing: the numbers before the first sample.
        names: of what is estimated.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        feedback: Feedback,
        unknown: Sequence[Unknown],
        interval: float,
    ) -> None:
        """Builds the models: the model alone where nothing is unknown.

        Args:
            world: the model.
            scenario: its task.
            feedback: whose laws are judged.
            unknown: see `ModelEstimate.of`.
            interval: between the samples that are learned from, at least [s].

        Raises:
            ControlError: from `ModelEstimate.of`; or the feedback has no laws to choose from.
        """
        self._known = self._given = ModelEstimate.of(world, scenario, unknown)
        self.names, self._interval, state = self._given.names, interval, scenario.initial_state
        if self.names and feedback.laws is None:
            expected = "a plan of a mechanism in the plane between compliant walls"
            raise ControlError("estimate", got="a plan with one law at a time", expected=expected)
        self._judged: tuple[Any, Feedback] = self._given.models, feedback
        self._parts = np.cumsum([1, len(state), *map(np.size, self._list_numbers(self._given))])
        self.nothing = self._pack(-np.inf, state, self._given)

    @staticmethod
    def _list_numbers(known: ModelEstimate) -> tuple[Any, ...]:
        return known.values, known.about, *known.sums

    def _pack(self, time: float, x: Floats, known: ModelEstimate) -> Floats:
        return np.concatenate([[time], x, *map(np.ravel, self._list_numbers(known))])

    def _unpack(self, numbers: Floats) -> tuple[float, Floats, ModelEstimate]:
        (time,), x, values, about, *sums, _ = np.split(numbers, self._parts)
        information, slopes, squares, count = sums
        totals = information.reshape(2 * slopes.shape), slopes, float(squares[0]), float(count[0])
        if not np.array_equal(about, self._known.about):
            self._known = dataclasses.replace(self._given, values=about).build()
        known = dataclasses.replace(self._known, values=values, sums=totals)
        return float(time), x, known

    def read(self, numbers: Floats) -> tuple[float, ...]:
        """Returns the values."""
        return tuple(np.split(numbers, self._parts)[2].tolist())

    def watch(
        self,
        numbers: Floats,
        time: float,
        x: Floats,
        find_held: Callable[[float, float], HeldControl],
    ) -> Floats:
        """Returns the numbers after another sample.

        Args:
            numbers: those before.
            time: of the sample [s].
            x: q and v.
            find_held: the commands that act on the plant between two times.
        """
        if not self.names:
            return numbers
        last, before, known = self._unpack(numbers)
        if time - last < (1 - _EARLY) * self._interval:
            return numbers
        if time - last <= _LONGEST * self._interval:
            known = self._known = known.watch((before, x), find_held(last, time))
        return self._pack(time, x, known)

    def judge(self, numbers: Floats, feedback: Feedback) -> Feedback:
        """Returns feedback whose laws are judged by the model of these numbers."""
        if not self.names or (models := self._unpack(numbers)[-1].models) is self._given.models:
            return feedback
        if self._judged[0] is not models:
            self._judged = models, feedback.judged_by(models[0].world, models[0].scenario)
        return self._judged[1]
