"""Progress of long work, a line at the bottom of the terminal; and the log, which -v shows."""

from __future__ import annotations

import argparse
import logging
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from drake_aigto.progress import Count, Notice

if TYPE_CHECKING:
    from rich.progress import Progress

# Answers to Ctrl-C, after "stopping: ".
POLISHING = "polishing the best so far; again to drop it"
KEEPING = "showing what happened so far; again to drop it"
_BAR_WIDTH = 20
# ANSI colors: green, red, yellow.
_COLORS = {
    "1;32": r"^(verdict     holds|goal        reached)",
    "1;31": r"^verdict     fails",
    "1;33": r"^(goal        not reached|vetoed)",
}
_OURS, _DRAKE = logging.getLogger("drake_aigto"), logging.getLogger("drake")


@contextmanager
def show_progress(
    options: argparse.Namespace, line: str = "getting ready"
) -> Iterator[Callable[[str], None] | None]:
    """Yields what shows a line of progress in place of the one before; None if nobody would see.

    Before the line is the time, and a bar where the total is known (`Count`). Nothing is left on
    the terminal but what stays (`Notice`), which a file gets, too. If the options are verbose, that
    is in the log.
    """
    if options.quiet:
        yield None
        return

    def keep(line: str) -> None:
        """Writes a line that stays; a bar moves aside for that."""
        if isinstance(line, Notice) and not options.verbose:
            print(f"drake-aigto: {line}", file=sys.stderr, flush=True)

    if not sys.stderr.isatty():
        yield keep
        return
    progress = _make_progress()
    task = progress.add_task(line, total=None)
    spinner, elapsed, *counted, text = progress.columns
    progress.columns = (spinner, elapsed, text)

    def show(line: str) -> None:
        if isinstance(line, Notice):
            keep(line)
            return
        progress.update(task, description=line)
        if isinstance(line, Count):
            progress.columns = (elapsed, *counted, text)
            progress.update(task, completed=line.done, total=line.total)

    try:
        progress.start()  # In here, as Ctrl-C may come once it has begun.
        yield show
    finally:
        progress.stop()


@contextmanager
def hear_ctrl_c(text: str = POLISHING) -> Iterator[None]:
    """Answers the first Ctrl-C at once; it ends what runs as usual, and so does the next one.

    A thread answers: Python's own handler waits until compiled code returns.
    """
    is_usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not is_usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    ours, theirs = os.pipe()
    os.set_blocking(theirs, False)

    def answer() -> None:
        while heard := os.read(ours, 1):
            if heard[0] == signal.SIGINT:
                print(f"drake-aigto: stopping: {text}", file=sys.stderr, flush=True)
                return

    thread, before = threading.Thread(target=answer, daemon=True), signal.set_wakeup_fd(theirs)
    thread.start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(theirs)  # Which ends the thread.
        thread.join()
        os.close(ours)


def paint(text: str) -> str:
    """Returns a text whose verdicts have colors, if it goes to a terminal that has any."""
    if not sys.stdout.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return text
    for color, verdict in _COLORS.items():
        text = re.sub(verdict, rf"\033[{color}m\g<0>\033[0m", text, flags=re.MULTILINE)
    return text


def _make_progress() -> Progress:
    """Returns all columns; the last is cut to what the terminal has left."""
    from rich import progress as rich  # It takes its time.
    from rich.console import Console
    from rich.table import Column

    class StandardError(Console):
        """Its cursor is left alone: a process that is killed could not show it again."""

        def show_cursor(self, show: bool = True) -> bool:
            return False

    return rich.Progress(
        rich.SpinnerColumn("line"),
        rich.TimeElapsedColumn(Column(no_wrap=True)),
        rich.BarColumn(_BAR_WIDTH),
        rich.TimeRemainingColumn(table_column=Column(no_wrap=True)),
        rich.TextColumn("left;"),
        rich.TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(ratio=1, no_wrap=True, overflow="ellipsis"),
        ),
        console=StandardError(stderr=True),
        expand=True,
        transient=True,
        redirect_stdout=False,  # What is printed there is the answer, perhaps to a file.
    )


class _ToStandardError(logging.Handler):
    """Writes to what standard error is by then: a progress bar moves aside for that."""

    def __init__(self) -> None:
        super().__init__()
        self._start = time.monotonic()

    def emit(self, record: logging.LogRecord) -> None:
        seconds = time.monotonic() - self._start
        try:
            print(f"{seconds:8.2f} s  {self.format(record)}", file=sys.stderr, flush=True)
        except Exception:
            self.handleError(record)


@contextmanager
def show_log(options: argparse.Namespace) -> Iterator[None]:
    """Writes what the package logs, each line with its time, if the options are verbose.

    If not, of what Drake logs only the warnings are left.
    """
    logger = _OURS if options.verbose else _DRAKE
    handler, level = _ToStandardError(), logger.level
    if options.verbose:
        logger.addHandler(handler)
        logger.propagate = False  # Drake gives the root a handler of its own when it first warns.
    logger.setLevel(logging.INFO if options.verbose else logging.WARNING)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.propagate = True
        logger.setLevel(level)
