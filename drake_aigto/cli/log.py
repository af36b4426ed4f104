"""What -v tells: the package's log, on standard error."""

from __future__ import annotations

import argparse
import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

_OURS, _DRAKE = logging.getLogger("drake_aigto"), logging.getLogger("drake")


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
