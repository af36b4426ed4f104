"""Where the command `drake-aigto` begins."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from drake_aigto.cli.status import INTERRUPTED


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command, that of `sys.argv` if None, and returns its exit status.

    0: fine. 1: no plan was found that holds on rigid walls. 2: bad input. 70: a fault of this
    program. 130: interrupted. 141: nobody read on.
    """
    try:
        with _die_of_ctrl_c():
            from drake_aigto.cli.command_line import run
        return run(arguments)
    except KeyboardInterrupt:
        print("drake-aigto: interrupted", file=sys.stderr)
        return INTERRUPTED


@contextmanager
def _die_of_ctrl_c() -> Iterator[None]:
    """Has Ctrl-C end the process at once, as the shell knows it.

    Loading Drake takes a second or more, and an exception in the middle becomes errors of its own.
    """
    is_usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    if not is_usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
