"""``python -m benchmarks``: the studies of the planner that the results page shows."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from benchmarks.ablations.ablations import AblationQuestion
from benchmarks.ablations.command import add_ablations
from benchmarks.robustness import results as robustness_results
from benchmarks.robustness.command import add_robustness
from drake_aigto.cli.bench import add_page
from drake_aigto.cli.command_line import run
from drake_aigto.cli.flags import add_common
from drake_aigto.cli.parser import Parser
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.status import FINE, INTERRUPTED


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit status, as `drake-aigto` does."""
    try:
        return run(arguments, make_parser)
    except KeyboardInterrupt:
        print("benchmarks: interrupted", file=sys.stderr)
        return INTERRUPTED


def make_parser(_: Sequence[str] = ()) -> Parser:
    """Returns the parser of all commands."""
    parser = Parser(prog="python -m benchmarks", description="Measures the planner, part by part.")
    add_common(parser)
    commands = parser.add_commands("COMMAND")
    add_ablations(commands)
    add_robustness(commands)
    add_page(commands, _write_page)
    return parser


def _write_page(options: argparse.Namespace) -> int:
    # Matplotlib takes its time.
    from benchmarks.ablations.page import ABLATIONS
    from benchmarks.robustness.page import ROBUSTNESS
    from drake_aigto.show.results_page import SECTIONS, write_results_page

    sections = {
        **SECTIONS,
        AblationQuestion.kind: ABLATIONS,
        robustness_results.KIND: ROBUSTNESS,
    }
    with show_progress(options, "drawing"):
        write_results_page(options.results, options.out, sections, "python -m benchmarks page")
    print(f"wrote {options.out}")
    return FINE


if __name__ == "__main__":
    sys.exit(main())
