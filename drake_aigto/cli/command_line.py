"""The command `drake-aigto`: what it takes, its exit status, its progress, and the log of -v."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import logging
import os
import re
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from drake_aigto import __version__
from drake_aigto.cli import flags
from drake_aigto.errors import AigtoError
from drake_aigto.progress import Count, Notice

# Command → the module that adds it, by `add_` and its name. `--help` lists them in this order.
_COMMANDS = {
    "table1": "drake_aigto.cli.plan",
    "list": "drake_aigto.cli.look",
    "look": "drake_aigto.cli.look",
    "plan": "drake_aigto.cli.plan",
    "plan-many": "drake_aigto.cli.plan",
    "replay": "drake_aigto.cli.plan",
    "play": "drake_aigto.cli.play",
    "report": "drake_aigto.cli.play",
    "compare": "drake_aigto.cli.play",
    "live": "drake_aigto.cli.play",
    "control": "drake_aigto.cli.play",
    "completion": "drake_aigto.cli.look",
}
# Command that is gone → where it is now.
_MOVED = {"bench": "python -m benchmarks, in a checkout of drake_aigto"}
_EXAMPLES = """\
drake-aigto list                             # what is shipped
drake-aigto look robot.urdf                  # how a model is understood
drake-aigto plan table1/1 --json plan.json   # plan, and save the plan
drake-aigto play plan.json                   # watch it
drake-aigto plan-many tasks/*.yaml --into plans   # one plan each, in parallel
drake-aigto report plan.json --html p.html   # a page about it, to mail
drake-aigto live table1/1                    # drag its goal, and watch the plan follow
drake-aigto control cart_pole/soft_06 --kick 0.3 1.5 --kick-time 0.5   # plan again as it moves
drake-aigto -v plan table1/3                 # see each step of the planner
drake-aigto table1                           # the paper's Table I, and the exact optimum
drake-aigto plan --help                      # all flags of a command
"""
_STATUSES = """
exit status: 0 success, 1 no plan passed simulation, 2 bad input, 130 interrupted
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command, that of `sys.argv` if None, and returns its exit status.

    0: success. 1: no plan passed simulation. 2: bad input. 70: a fault of this program.
    130: interrupted. 141: the reader of its output has ended.
    """
    try:
        return run(arguments)
    except KeyboardInterrupt:
        print("drake-aigto: interrupted", file=sys.stderr)
        return flags.INTERRUPTED


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


@contextmanager
def _tell_loading(words: Sequence[str]) -> Iterator[None]:
    """Says what it waits for, on a terminal: a line that goes again."""
    is_seen = sys.stderr.isatty() and not {"-q", "--quiet", "--version"} & set(words)
    if is_seen:
        print("loading Drake …", end="\r", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        if is_seen:
            print("\033[2K", end="\r", file=sys.stderr, flush=True)


def run(
    arguments: Sequence[str] | None, make: Callable[[Sequence[str]], flags.Parser] | None = None
) -> int:
    """Runs a command and returns its exit status; Ctrl-C is left to the caller.

    Arguments are what was typed after the program's name, None those of `sys.argv`; `make` returns
    the parser for these words.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    unset = argparse.Namespace(quiet=False, verbose=False)
    with _die_of_ctrl_c(), _tell_loading(words):
        parser = (make or make_parser)(words)
    options = parser.parse_args(words, unset)
    try:
        with show_log(options):
            status = int(options.run(options))
        sys.stdout.flush()  # What is left in its buffer would fail as Python exits.
        return status
    except BrokenPipeError:  # The reader has seen enough, `head` for one.
        _forget_output()
        return flags.UNREAD
    except Exception as error:
        return _tell(error, options.verbose)


def _tell(error: Exception, verbose: bool) -> int:
    """Says what went wrong, and returns the exit status."""
    from drake_aigto.planning import PlanningError

    if verbose:
        traceback.print_exception(error)
    if isinstance(error, AigtoError):
        text, status = str(error), flags.BAD_INPUT
        if isinstance(error, PlanningError):
            status = flags.NOTHING_HOLDS
    elif isinstance(error, OSError | MemoryError):
        text, status = f"{error}.", flags.BAD_INPUT  # A full disk, or a billion time steps.
        if isinstance(error, OSError):
            _forget_output()
    else:
        what = f"{type(error).__name__}: {error}".rstrip(".")
        text = f"{what}. This is a fault of drake-aigto: "
        text, status = f"{text}please report it with the output of -v.", flags.FAULT
    print(f"drake-aigto: {text}", file=sys.stderr)
    return status


def _forget_output() -> None:
    """Drops what could not be printed: Python would try once more as it exits."""
    with contextlib.suppress(io.UnsupportedOperation):  # A notebook's output is no file.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def make_parser(words: Sequence[str] = ()) -> flags.Parser:
    """Returns the parser of the whole command line, or of what is needed for these words.

    Each command loads its own modules, so that none waits for those of others.
    """
    parser = flags.Parser(
        prog="drake-aigto",
        description="Global trajectory optimization through contact, on Drake.",
        epilog=f"{flags.format_examples(_EXAMPLES)}{_STATUSES}",
    )
    parser.add_argument("--version", action="version", version=f"drake-aigto {__version__}")
    flags.add_common(parser)
    commands = parser.add_commands("COMMAND")
    asked = [word for word in words if not word.startswith("-")][:1]
    if asked and (now := _MOVED.get(asked[0])):
        parser.error(f"{asked[0]} has moved to {now}")
    for name in asked if asked and asked[0] in _COMMANDS else _COMMANDS:
        getattr(importlib.import_module(_COMMANDS[name]), f"add_{name.replace('-', '_')}")(commands)
    return parser


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
