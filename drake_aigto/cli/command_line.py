"""The command `drake-aigto`: what it takes, and what its exit status means."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

from drake_aigto import __version__
from drake_aigto.cli.flags import (
    BAD_INPUT,
    FAULT,
    INTERRUPTED,
    NOTHING_HOLDS,
    UNREAD,
    Parser,
    add_common,
    format_examples,
)
from drake_aigto.cli.progress import show_log
from drake_aigto.errors import AigtoError

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
    arguments: Sequence[str] | None, make: Callable[[Sequence[str]], Parser] | None = None
) -> int:
    """Runs a command and returns its exit status; Ctrl-C is left to the caller.

    Args:
        arguments: what was typed after the program's name; None takes it from `sys.argv`.
        make: returns the parser for these words.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    unset = argparse.Namespace(quiet=False, verbose=False)
    with _die_of_ctrl_c(), _tell_loading(words):
        parser = (make or make_parser)(words)
    options = parser.parse_args(words, unset)
    try:
        with show_log(options):
            return int(options.run(options))
    except BrokenPipeError:  # The reader has seen enough, `head` for one.
        _forget_output()
        return UNREAD
    except Exception as error:
        return _tell(error, options.verbose)


def _tell(error: Exception, verbose: bool) -> int:
    """Says what went wrong, and returns the exit status."""
    from drake_aigto.planning import PlanningError

    if verbose:
        traceback.print_exception(error)
    if isinstance(error, AigtoError):
        text, status = str(error), BAD_INPUT
        if isinstance(error, PlanningError):
            status = NOTHING_HOLDS
    elif isinstance(error, OSError | MemoryError):
        text, status = f"{error}.", BAD_INPUT  # A full disk, or a billion time steps.
        if isinstance(error, OSError):
            _forget_output()
    else:
        what = f"{type(error).__name__}: {error}".rstrip(".")
        text = f"{what}. This is a fault of drake-aigto: "
        text, status = f"{text}please report it with the output of -v.", FAULT
    print(f"drake-aigto: {text}", file=sys.stderr)
    return status


def _forget_output() -> None:
    """Drops what could not be printed: Python would try once more as it exits."""
    with contextlib.suppress(io.UnsupportedOperation):  # A notebook's output is no file.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def make_parser(words: Sequence[str] = ()) -> Parser:
    """Returns the parser of the whole command line, or of what is needed for these words.

    Each command loads its own modules, so that none waits for those of others.
    """
    parser = Parser(
        prog="drake-aigto",
        description="Global trajectory optimization through contact, on Drake.",
        epilog=f"{format_examples(_EXAMPLES)}{_STATUSES}",
    )
    parser.add_argument("--version", action="version", version=f"drake-aigto {__version__}")
    add_common(parser)
    commands = parser.add_commands("COMMAND")
    asked = [word for word in words if not word.startswith("-")][:1]
    if asked and (now := _MOVED.get(asked[0])):
        parser.error(f"{asked[0]} has moved to {now}")
    for name in asked if asked and asked[0] in _COMMANDS else _COMMANDS:
        getattr(importlib.import_module(_COMMANDS[name]), f"add_{name.replace('-', '_')}")(commands)
    return parser
