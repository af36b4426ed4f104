"""The search for the best known: many tries of a method on every question, apart from any plan."""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import islice

from benchmarks.robots.known import Known, find_known, keep, load_known
from benchmarks.robots.methods import METHODS
from benchmarks.robots.worlds import Question

_BATCH = 50  # tries between two writings of the file


def search(
    questions: list[Question], method: str, tries: int, seconds: float, tell: Callable[[str], None]
) -> None:
    """Gives each question so many tries of a method, those of earlier searches included.

    All questions have some tries before any has more, so that the search may end at any time.

    Args:
        questions: of which the best is searched.
        method: of `METHODS`.
        tries: for each question.
        seconds: after which no more are made.
        tell: called with a line where something better was found.
    """
    end = time.perf_counter() + seconds
    for most in range(_BATCH, tries + _BATCH, _BATCH):
        for question in questions:
            if time.perf_counter() > end:
                return
            before = find_known(load_known(), question)
            if before.tries.get(method, 0) < min(most, tries):
                known = _try(question, before, method, min(most, tries))
                keep(question, known)
                if known.cost < before.cost:
                    name = f"{question.section} {question.number}"
                    tell(f"{name}: {before.cost:.4f} → {known.cost:.4f}")


def _try(question: Question, known: Known, method: str, most: int) -> Known:
    """Returns what is known after so many tries."""
    done = known.tries.get(method, 0)
    for attempt in islice(METHODS[method].run(question, done), most - done):
        # What is promised is a little off: what would be far worse isn't judged.
        if attempt.promised < 1.05 * known.cost:
            known = known.offered(question, method, attempt.control)
    return known.tried(method, most)
