"""The command `drake-aigto`: what it takes, and what its exit status means."""

from __future__ import annotations

import argparse
import contextlib
import importlib
import io
import os
import sys
import traceback
from collections.abc import Callable, Sequence

from drake_aigto import __version__
from drake_aigto.cli.flags import add_common, format_examples
from drake_aigto.cli.log import show_log
from drake_aigto.cli.parser import Parser
from drake_aigto.cli.status import BAD_INPUT, FAULT, NOTHING_HOLDS, UNREAD
from drake_aigto.errors import AigtoError
from drake_aigto.planning import PlanningError

# Command → the module that adds it, by `add_` and its name. `--help` lists them in this order.
_COMMANDS = {
    "table1": "drake_aigto.cli.table1",
    "plan": "drake_aigto.cli.plan",
    "replay": "drake_aigto.cli.plan",
    "play": "drake_aigto.cli.play",
    "report": "drake_aigto.cli.play",
    "control": "drake_aigto.cli.control",
    "bench": "drake_aigto.cli.bench",
}
_EXAMPLES = """\
drake-aigto plan table1/1 --json plan.json   # plan, and keep the plan
drake-aigto play plan.json                   # watch it
drake-aigto report plan.json --html p.html   # a page about it, to mail
drake-aigto control cart_pole/soft_06 --kick 0.3 1.5 --kick-time 0.5   # plan again as it moves
drake-aigto -v plan table1/3                 # see what the planner does, step by step
drake-aigto table1                           # the paper's Table I, and the truth beside it
drake-aigto plan --help                      # all that a command takes
"""
_STATUSES = """
exit status: 0 fine, 1 nothing found that holds on rigid walls, 2 bad input, 130 interrupted
"""


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
    options = (make or make_parser)(words).parse_args(words, unset)
    try:
        with show_log(options):
            return int(options.run(options))
    except BrokenPipeError:  # Who reads has seen enough, `head` for one.
        _forget_output()
        return UNREAD
    except Exception as error:
        return _tell(error, options.verbose)


def _tell(error: Exception, verbose: bool) -> int:
    """Says what went wrong, and returns the exit status."""
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
        text = f"{what}. This is a fault of drake-aigto, not yours: "
        text, status = f"{text}please report it with what -v tells.", FAULT
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
    for name in asked if asked and asked[0] in _COMMANDS else _COMMANDS:
        getattr(importlib.import_module(_COMMANDS[name]), f"add_{name}")(commands)
    return parser
