"""Lines of progress: how much of long work is done, and what to know once."""

from __future__ import annotations


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
