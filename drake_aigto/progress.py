"""Lines of progress: how much of long work is done, and what to know once; lists cut short."""

from __future__ import annotations

from collections.abc import Iterable

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


def list_some(texts: Iterable[str], unit: str = "") -> str:
    """Returns the first of some texts with their unit, and how many more there are."""
    found = list(texts)
    more = len(found) - _MOST_LISTED
    return ", ".join(found[:_MOST_LISTED]) + unit * bool(found) + f" and {more} more" * (more > 0)
