"""How all commands are parsed, and what they say if there is nothing to parse."""

from __future__ import annotations

import argparse
import re
import sys
from functools import partial
from typing import Any, NoReturn

from drake_aigto.cli.status import BAD_INPUT


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
