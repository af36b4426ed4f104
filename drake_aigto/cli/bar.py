"""A line at the bottom of the terminal that shows how long work has taken, and how far it is."""

from __future__ import annotations

from rich.console import Console
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column

from drake_aigto.count import Count

_BAR_WIDTH = 20


class _Console(Console):
    """Standard error with its cursor left alone: a process that is killed could not show it."""

    def show_cursor(self, show: bool = True) -> bool:
        return False


class Bar:
    """Time, a bar if the total is known, and a line cut to the terminal's width.

    Leaves nothing behind on the terminal.
    """

    def __init__(self, line: str) -> None:
        """Shows nothing yet; `line` is what will be shown first."""
        elapsed = TimeElapsedColumn(Column(no_wrap=True))
        # It alone is cut where the terminal is narrow.
        cut = Column(ratio=1, no_wrap=True, overflow="ellipsis")
        text = TextColumn("{task.description}", markup=False, table_column=cut)
        remaining = TimeRemainingColumn(table_column=Column(no_wrap=True))
        bar, left = BarColumn(_BAR_WIDTH), TextColumn("left;")
        self._with_total: tuple[ProgressColumn, ...] = (elapsed, bar, remaining, left, text)
        self._progress = Progress(
            SpinnerColumn("line"),
            elapsed,
            text,
            console=_Console(stderr=True),
            expand=True,
            transient=True,
            redirect_stdout=False,  # What is printed there is the answer, perhaps to a file.
        )
        self._task = self._progress.add_task(line, total=None)

    def show(self, line: str) -> None:
        """Shows a line in place of the one before."""
        self._progress.update(self._task, description=line)
        if isinstance(line, Count):
            self._progress.columns = self._with_total
            self._progress.update(self._task, completed=line.done, total=line.total)

    def start(self) -> None:
        """Begins to show."""
        self._progress.start()

    def stop(self) -> None:
        """Clears the line, if there is one."""
        self._progress.stop()
