"""How commands are parsed, what several of them take, and exit statuses."""

from __future__ import annotations

import argparse
import re
import sys
import textwrap
from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, NoReturn

# Exit statuses.
FINE, NOTHING_HOLDS, BAD_INPUT, INTERRUPTED, UNREAD = 0, 1, 2, 130, 141
FAULT = 70  # EX_SOFTWARE in BSD's sysexits.h; an uncaught exception's 1 means NOTHING_HOLDS here.


class Parser(argparse.ArgumentParser):
    """Refuses what it does not understand in one line, and shows examples as they are written."""

    def __init__(self, **settings: Any) -> None:
        """Takes what argparse does."""
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **settings)
        # As of Python 3.14: -1e-3, -3:0.5, and here -inf as well, are no flags.
        self._negative_number_matcher = re.compile(r"-(\.?\d|inf)")

    def error(self, message: str) -> NoReturn:
        """Exits with what is wrong, and where help is."""
        self.exit(BAD_INPUT, f"{self.prog}: {message}. Try {self.prog} --help.\n")

    def add_commands(self, metavar: str) -> Any:
        """Returns where commands are added; without one of them, the help is shown."""
        self.set_defaults(run=partial(_show_help, self))
        return self.add_subparsers(metavar=metavar)


def _show_help(parser: Parser, _: argparse.Namespace) -> int:
    parser.print_help(sys.stderr)
    return BAD_INPUT


def add_command(
    commands: Any, name: str, run: Callable[..., int], text: str, examples: str, notes: str = ""
) -> Any:
    """Adds a command to those of a parser (`Parser.add_commands`), and returns its own.

    Its text is without capital and full stop; examples are command lines, as they are typed; notes
    are what else there is to know, in lines of at most 100 columns. `run` takes the parsed options
    and returns the exit status.
    """
    sentence = f"{text[0].upper()}{text[1:]}."
    epilog = "\n".join(filter(None, [format_examples(examples), notes]))
    command = commands.add_parser(name, help=text, description=sentence, epilog=epilog)
    add_common(command)
    command.set_defaults(run=run)
    return command


def format_examples(examples: str) -> str:
    """Returns command lines as help shows them."""
    return f"examples:\n{textwrap.indent(examples, '  ')}"


def add_common(parser: Any) -> None:
    """Adds what may be given before a command, or after it."""
    # A command's own default would undo what was given before it.
    look = {"action": "store_true", "default": argparse.SUPPRESS}
    parser.add_argument("-q", "--quiet", help="show no progress", **look)
    text = "tell each step, and where an error came from"
    parser.add_argument("-v", "--verbose", help=text, **look)


def add_confirm(command: Any) -> None:
    """Adds --no-confirm."""
    text = "leave out the replay on Drake's plant"
    command.add_argument("--no-confirm", dest="confirm", action="store_false", help=text)


def add_json(command: Any, text: str) -> None:
    """Adds --json FILE; the text says what it has."""
    command.add_argument("--json", metavar="FILE", help=text)


def add_port(command: Any) -> None:
    """Adds --port N."""
    text = "where Meshcat listens (0: anywhere)"
    command.add_argument("--port", type=int, metavar="N", help=text)


def add_workers(command: Any, count: int | None = None) -> None:
    """Adds where jobs run: as many processes if nothing is said, or one a core for None."""
    where = command.add_mutually_exclusive_group()
    text = f"processes of this machine (default: {'one a core' if count is None else count})"
    where.add_argument("--workers", type=positive, metavar="N", default=count, help=text)
    text = (
        "of Dask: run on its workers, on any machines, which need the same version of drake_aigto "
        "and of Drake, and one thread each: dask worker ADDRESS --nthreads 1"
    )
    where.add_argument("--scheduler", metavar="ADDRESS", help=text)


def read_workers(options: argparse.Namespace) -> AbstractContextManager[Executor]:
    """Returns where jobs run, as the flags of `add_workers` ask; nothing starts yet."""
    from drake_aigto.jobs import open_workers  # Most commands need no processes.

    count = None if options.scheduler is not None else options.workers
    return open_workers(count, options.scheduler)


def positive(text: str) -> int:
    """Returns a whole number, 1 or more."""
    return int(_within(int(text), 1))


def natural(text: str) -> int:
    """Returns a whole number, 0 or more."""
    return int(_within(int(text), 0))


def seconds(text: str) -> float:
    """Returns a finite number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {value:g}, expected seconds above zero")
    return value


def share(text: str) -> float:
    """Returns a number from 0 to 1."""
    return _within(float(text), 0, 1)


def _within(value: float, least: int, most: int | None = None) -> float:
    if value < least or (most is not None and not value <= most):
        expected = f"{least} or more" if most is None else f"{least} to {most}"
        raise argparse.ArgumentTypeError(f"got {value:g}, expected {expected}")
    return value
