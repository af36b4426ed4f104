"""Lines of progress: how much is done, and what to know once; logs and lists, cut short."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

_MOST_LISTED = 6


class Count(str):
    """A line of progress, such as "3 of 8 tasks done"; of its numbers, a bar may be drawn.

    Attributes:
        done: how many.
        total: of how many.
    """

    done: int
    total: int

    def __new__(cls, done: int, total: int, text: str) -> Count:
        """Writes the numbers before the text."""
        line = super().__new__(cls, f"{done} of {total} {text}")
        line.done, line.total = done, total
        return line


class Notice(str):
    """A line of progress that stays when the next one comes."""


@contextmanager
def log_from(level: int, name: str) -> Iterator[None]:
    """Has the logger of a name drop what is below a level, whoever shows the rest."""
    logger = logging.getLogger(name)
    before = logger.level
    logger.setLevel(level)
    try:
        yield
    finally:
        logger.setLevel(before)


def list_some(texts: Iterable[str], unit: str = "") -> str:
    """Returns the first of some texts with their unit, and how many more there are."""
    found = list(texts)
    more = len(found) - _MOST_LISTED
    return ", ".join(found[:_MOST_LISTED]) + unit * bool(found) + f" and {more} more" * (more > 0)
