"""``python -m benchmarks``: the studies that the results page shows, and the page."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.ablations.ablations import (
    VARIANTS,
    AblationQuestion,
    AblationStudy,
    format_ablations,
)
from benchmarks.baselines import BASELINES
from benchmarks.study.flags import add_question, add_running, read_question, run_asked
from benchmarks.study.scenario_question import PLANNER, ScenarioQuestion
from benchmarks.study.scenario_study import ScenarioStudy
from benchmarks.study.scenario_tables import format_study
from drake_aigto.cli import FINE, INTERRUPTED, Parser, add_command, add_common, run, show_progress
from drake_aigto.show import WIDTH

_ALL = "all"
_SCENARIOS = """\
python -m benchmarks scenarios --count 20                        # a first impression
python -m benchmarks scenarios --count 500 --json planner.json
python -m benchmarks scenarios --count 500 --json planner.json --resume
python -m benchmarks scenarios --count 60 \\
    --methods aigto snopt cma-es --budgets 1 10 100 --workers 8 --json rivals.json
"""
_NOTES = """\
The first scenarios of a seed are the same for any count. The results file is written every few
seconds, so that Ctrl-C or a crash loses little: --resume goes on from it, also with a larger count
or more methods. Exit status: 0 fine, 2 bad input.
"""
_ABLATIONS = """\
python -m benchmarks ablations --count 20                         # a first impression
python -m benchmarks ablations --json ablations.json
python -m benchmarks ablations --json ablations.json --resume
"""
_PAGE = """\
python -m benchmarks page planner.json rivals.json --out results.md
"""


def main(
    arguments: Sequence[str] | None = None, make: Callable[[Sequence[str]], Parser] | None = None
) -> int:
    """Runs a command and returns its exit status, as `drake-aigto` does.

    Args:
        arguments: what was typed; None takes it from `sys.argv`.
        make: returns the parser; that of this module if None.
    """
    try:
        return run(arguments, make or make_parser)
    except KeyboardInterrupt:
        print("benchmarks: interrupted", file=sys.stderr)
        return INTERRUPTED


def make_parser(_: Sequence[str] = ()) -> Parser:
    """Returns the parser of all commands."""
    parser = Parser(prog="python -m benchmarks", description="Measures the planner, part by part.")
    add_common(parser)
    commands = parser.add_commands("COMMAND")
    _add_scenarios(commands)
    _add_ablations(commands)
    _add_page(commands)
    return parser


def _add_scenarios(commands: Any) -> None:
    text = "how often methods find the optimum of random scenarios, and how fast"
    command = add_command(commands, "scenarios", _scenarios, text, _SCENARIOS, _NOTES)
    usual = ScenarioQuestion()
    add_question(command, usual)
    names = ", ".join(f"'{name}'" if " " in name else name for name in BASELINES)
    text = f"{PLANNER}, the planner (default); {names}; or {_ALL}"
    command.add_argument("--methods", nargs="+", metavar="NAME", default=[PLANNER], help=text)
    budgets, text = list(usual.budgets), "units of time at which the others are judged"
    text += f" (default: {' '.join(f'{budget:g}' for budget in budgets)})"
    look: dict[str, Any] = {"type": float, "nargs": "+", "metavar": "B", "default": budgets}
    command.add_argument("--budgets", help=text, **look)
    text = f"of one core (default: what {PLANNER} takes on the same scenario)"
    command.add_argument("--seconds-per-unit", type=float, metavar="S", help=text)
    text = "also report what boxes alone say, before any polish"
    command.add_argument("--read-boxes", action="store_true", help=text)
    add_running(command)


def _scenarios(options: argparse.Namespace) -> int:
    methods = [PLANNER, *BASELINES] if options.methods == [_ALL] else options.methods
    question = ScenarioQuestion(
        methods=tuple(methods),
        budgets=tuple(options.budgets),
        seconds_per_unit=options.seconds_per_unit,
        reads_boxes=options.read_boxes,
        **read_question(options),
    )
    print(format_study(run_asked(options, ScenarioStudy(question))), flush=True)
    return FINE


def _add_ablations(commands: Any) -> None:
    text = "what finds the bounce: the planner with one part changed at a time"
    notes = textwrap.fill(f"Variants: {'; '.join(VARIANTS)}.", WIDTH)
    command = add_command(commands, "ablations", _ablations, text, _ABLATIONS, notes)
    add_question(command, AblationQuestion())
    text, usual = "by name, see below (default: all)", list(VARIANTS)
    command.add_argument("--variants", nargs="+", metavar="NAME", default=usual, help=text)
    add_running(command)


def _ablations(options: argparse.Namespace) -> int:
    question = AblationQuestion(methods=tuple(options.variants), **read_question(options))
    print(format_ablations(run_asked(options, AblationStudy(question))), flush=True)
    return FINE


def _add_page(commands: Any) -> None:
    text = "make the results page of saved results"
    command = add_command(commands, "page", _page, text, _PAGE)
    text = "what benchmarks wrote with --json"
    command.add_argument("results", nargs="+", metavar="RESULTS.json", help=text)
    text = "the page; pictures go into a folder images beside it (default: %(default)s)"
    command.add_argument("--out", metavar="PAGE.md", default="docs/results.md", help=text)


def _page(options: argparse.Namespace) -> int:
    # Matplotlib takes its time.
    from benchmarks.ablations.page import ABLATIONS
    from benchmarks.study.page import write_results_page
    from benchmarks.study.scenario_page import SCENARIOS

    sections = {ScenarioQuestion.kind: SCENARIOS, AblationQuestion.kind: ABLATIONS}
    with show_progress(options, "drawing"):
        write_results_page(options.results, options.out, sections)
    print(f"wrote {options.out}")
    return FINE


if __name__ == "__main__":
    sys.exit(main())
