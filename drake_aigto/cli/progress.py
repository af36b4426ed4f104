"""Progress of long work, on a terminal."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def show_progress(
    options: argparse.Namespace, line: str = "getting ready"
) -> Iterator[Callable[[str], None] | None]:
    """Yields what shows a line of progress in place of the one before; None if nobody would see.

    Args:
        options: the parsed ones; `quiet` asks for none.
        line: what is shown first.
    """
    if options.quiet or not sys.stderr.isatty():
        yield None
        return
    from drake_aigto.cli.bar import Bar  # Rich takes its time.

    bar = Bar(line)
    try:
        bar.start()  # In here, as Ctrl-C may come once it has begun.
        yield bar.show
    finally:
        bar.stop()
