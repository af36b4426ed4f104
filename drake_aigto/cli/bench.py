"""``drake-aigto bench``: measurements, a file for each."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from drake_aigto.baselines import BASELINES
from drake_aigto.cli.flags import add_command, add_common, format_examples, share
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.status import FINE, NOTHING_HOLDS
from drake_aigto.cli.studies import add_question, add_running, read_question, run_study
from drake_aigto.show.scenario_tables import format_study
from drake_aigto.study.method_run import PLANNER
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.study.scenario_study import run_scenario_study

_EXAMPLES = """\
drake-aigto bench scenarios --count 50 --json scenarios.json   # how often, and how fast
drake-aigto bench page scenarios.json --out results.md         # with figures
drake-aigto bench scenarios --help                             # all that a benchmark takes
"""
_ALL = "all"
_SCENARIOS_EXAMPLES = """\
drake-aigto bench scenarios --count 20                        # a first impression
drake-aigto bench scenarios --count 500 --restitution 1 0.8 0.5 --json planner.json
drake-aigto bench scenarios --count 500 --restitution 1 0.8 0.5 --json planner.json --resume
drake-aigto bench scenarios --count 60 --restitution 0.5:1 --mass 0.5:2 --velocity -3:0 \\
    --methods aigto snopt cma-es --budgets 1 10 100 --workers 8 --json rivals.json
"""
_NOTES = """\
A spread X is a number, several numbers, which scenarios take in turn (in all combinations, if there
are several such lists), or one range low:high, which they are drawn from evenly.

The first scenarios of a seed are the same for any count. The results file is written every few
seconds, so that Ctrl-C or a crash loses little: --resume goes on from it, also with a larger count
or more methods. Exit status: 0 fine, 1 aigto succeeds less often than --require asks, 2 bad input.
"""
_PAGE_EXAMPLES = """\
drake-aigto bench page planner.json rivals.json --out results.md
"""


def add_bench(commands: Any) -> None:
    """Adds the command and all that it measures."""
    text = "measure: how often, how fast, against what else"
    bench = commands.add_parser(
        "bench", help=text, description=f"{text.capitalize()}.", epilog=format_examples(_EXAMPLES)
    )
    add_common(bench)
    benchmarks = bench.add_commands("BENCHMARK")
    add_scenarios(benchmarks)
    add_page(benchmarks)


def add_scenarios(commands: Any) -> None:
    """Adds the command that runs random scenarios."""
    text = "how often methods find the optimum of random scenarios, and how fast"
    command = add_command(commands, "scenarios", _scenarios, text, _SCENARIOS_EXAMPLES, _NOTES)
    usual = ScenarioQuestion()
    add_question(command, usual)
    _add_rivals(command, usual)
    text = "also tell what boxes alone say, before any polish"
    command.add_argument("--read-boxes", action="store_true", help=text)
    text = f"of scenarios whose optimum {PLANNER} is to find, else exit with 1"
    command.add_argument("--require", type=share, metavar="SHARE", default=0.0, help=text)
    add_running(command)


def _add_rivals(command: Any, usual: ScenarioQuestion) -> None:
    names = ", ".join(f"'{name}'" if " " in name else name for name in BASELINES)
    text = f"{PLANNER}, the planner (default); {names}; or {_ALL}"
    command.add_argument("--methods", nargs="+", metavar="NAME", default=[PLANNER], help=text)
    budgets, text = list(usual.budgets), "units of time at which the others are judged"
    text += f" (default: {' '.join(f'{budget:g}' for budget in budgets)})"
    look = {"type": float, "nargs": "+", "metavar": "B", "default": budgets}
    command.add_argument("--budgets", help=text, **look)
    text = f"of one core (default: what {PLANNER} takes on the same scenario)"
    command.add_argument("--seconds-per-unit", type=float, metavar="S", help=text)


def _scenarios(options: argparse.Namespace) -> int:
    question = _make_question(options)
    study = run_study(options, run_scenario_study, question)
    print(format_study(study), flush=True)
    if PLANNER not in question.methods:
        return FINE
    solved = sum(study.succeeds(result, PLANNER, 1.0) for result in study.of_method(PLANNER))
    return FINE if solved >= options.require * question.count else NOTHING_HOLDS


def _make_question(options: argparse.Namespace) -> ScenarioQuestion:
    methods = [PLANNER, *BASELINES] if options.methods == [_ALL] else options.methods
    return ScenarioQuestion(
        methods=tuple(methods),
        budgets=tuple(options.budgets),
        seconds_per_unit=options.seconds_per_unit,
        reads_boxes=options.read_boxes,
        **read_question(options),
    )


def add_page(commands: Any, run: Callable[[argparse.Namespace], int] | None = None) -> None:
    """Adds the command that makes the page, which `run` does; this module's own if None."""
    text = "make the results page of saved results"
    command = add_command(commands, "page", run or _page, text, _PAGE_EXAMPLES)
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
