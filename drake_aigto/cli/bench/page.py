"""``drake-aigto bench page``."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from drake_aigto.cli.flags import add_command
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.status import FINE

_EXAMPLES = """\
drake-aigto bench page planner.json rivals.json --out results.md
"""


def add_page(commands: Any, run: Callable[[argparse.Namespace], int] | None = None) -> None:
    """Adds the command, which `run` does; this module's own if None."""
    text = "make the results page of saved results"
    command = add_command(commands, "page", run or _page, text, _EXAMPLES)
    text = "what benchmarks wrote with --json"
    command.add_argument("results", nargs="+", metavar="RESULTS.json", help=text)
    text = "the page; pictures go into a folder images beside it (default: %(default)s)"
    command.add_argument("--out", metavar="PAGE.md", default="docs/results.md", help=text)


def _page(options: argparse.Namespace) -> int:
    from drake_aigto.show.results_page import write_results_page  # Matplotlib takes its time.

    with show_progress(options, "drawing"):
        write_results_page(options.results, options.out)
    print(f"wrote {options.out}")
    return FINE
