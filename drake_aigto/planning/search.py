"""Candidates by contact sequence."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from drake_aigto.aigo import Status
from drake_aigto.planning.options import Rung
from drake_aigto.planning.plan import Candidate
from drake_aigto.planning.problem import PlanningProblem
from drake_aigto.planning.sequence import Knots

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

# In a candidate's origin, before the knots that its contacts were moved to.
_MOVED = "; contacts moved to knots "
# Contacts this many knots apart are one proposal of AIGO's; moving them tells them apart.
_SAME = 2

Clock = Callable[[str], AbstractContextManager[None]]


class Search:
    """Candidates by contact sequence: AIGO proposes, and the best one's contacts are moved.

    Sequences whose knots differ by no more than `_SAME` share a candidate.

    Attributes:
        candidates: so far.
        aigo_steps: inner iterations of AIGO so far.
    """

    def __init__(self, problem: PlanningProblem, clock: Clock) -> None:
        """Starts with no candidate; the clock measures parts by name."""
        self._problem, self._clock = problem, clock
        self._centers: dict[Knots, npt.NDArray[np.float64]] = {}
        self._by_knots: dict[Knots, Candidate] = {}
        self.aigo_steps = 0

    @property
    def candidates(self) -> list[Candidate]:
        """All candidates, in the order that they were found."""
        return list(self._by_knots.values())

    def add_rung(self, rung: Rung) -> None:
        """Adds the candidate of AIGO's sequence under this rung, unless it is there.

        Raises:
            KeyboardInterrupt: AIGO was interrupted; its best so far is a candidate by now.
        """
        with self._clock("aigo"):
            result = self._problem.run_aigo(rung)
            sequences = self._problem.find_sequences(result, rung)
        self.aigo_steps += result.num_inner_steps
        for knots in sequences:
            if not any(_is_same(knots, known) for known in self._by_knots):
                self._add(self._problem.options.describe(rung), knots, result.box.center)
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt

    def move_contacts(self, knots: Knots, steps: Sequence[int]) -> None:
        """Moves each contact of a candidate to and fro by so many knots, while that helps.

        Args:
            knots: the candidate's sequence.
            steps: in turn; each is repeated until it does not help any more.
        """
        for step in steps:
            while (best := min([knots, *self._neighbours(knots, step)], key=self._rank)) != knots:
                knots = best

    def best_contacts(self, count: int) -> list[Knots]:
        """Returns so many sequences with contacts: first those that the polish left in contact."""
        ranked = sorted(
            filter(None, self._by_knots),
            key=lambda knots: (not self._by_knots[knots].contacts, self._rank(knots)),
        )
        return ranked[:count]

    def _neighbours(self, knots: Knots, step: int) -> Iterator[Knots]:
        """Yields the sequences with one contact moved, which are candidates by then."""
        last = self._problem.transcription.num_samples() - 1
        for i, shift in itertools.product(range(len(knots)), (-step, step)):
            moved = tuple(k + shift if j == i else k for j, k in enumerate(knots))
            if not all(a < b for a, b in itertools.pairwise((0, *moved, last))):
                continue
            if moved not in self._by_knots:
                origin = self._by_knots[knots].origin.split(_MOVED)[0]
                self._add(f"{origin}{_MOVED}{moved}", moved, self._centers[knots])
            yield moved

    def _rank(self, knots: Knots) -> tuple[bool, float]:
        """Orders sequences: those that meet the rows first, then by cost."""
        candidate = self._by_knots[knots]
        return not candidate.is_feasible, candidate.cost

    def _add(self, origin: str, knots: Knots, center: npt.NDArray[np.float64]) -> None:
        with self._clock("polish"):
            x = self._problem.polish(center, knots)
        with self._clock("replay"):
            self._by_knots[knots] = self._problem.judge(origin, center, x)
        self._centers[knots] = center


def _is_same(one: Knots, other: Knots) -> bool:
    return len(one) == len(other) and all(
        abs(a - b) <= _SAME for a, b in zip(one, other, strict=True)
    )
