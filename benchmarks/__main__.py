"""``python -m benchmarks``: the studies that the results page shows, and the page."""

from __future__ import annotations

import argparse
import sys
import textwrap
from collections.abc import Sequence
from typing import Any, TypeVar

from benchmarks.ablations.ablations import (
    VARIANTS,
    AblationQuestion,
    AblationStudy,
    format_ablations,
)
from benchmarks.baselines import BASELINES
from benchmarks.study.scenario_question import PLANNER, ScenarioQuestion
from benchmarks.study.scenario_study import ScenarioStudy
from benchmarks.study.scenario_tables import format_study
from drake_aigto.cli import (
    FINE,
    INTERRUPTED,
    Parser,
    add_command,
    add_common,
    add_json,
    add_workers,
    read_workers,
    run,
    show_progress,
)
from drake_aigto.show import WIDTH

_Study = TypeVar("_Study", bound=ScenarioStudy)

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


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit status, as `drake-aigto` does.

    Args:
        arguments: what was typed; None takes it from `sys.argv`.
    """
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
    _add_scenarios(commands)
    _add_ablations(commands)
    _add_page(commands)
    return parser


def _add_scenarios(commands: Any) -> None:
    text = "how often methods find the optimum of random scenarios, and how fast"
    command = add_command(commands, "scenarios", _scenarios, text, _SCENARIOS, _NOTES)
    usual = ScenarioQuestion()
    _add_question(command, usual)
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


def _scenarios(options: argparse.Namespace) -> int:
    methods = [PLANNER, *BASELINES] if options.methods == [_ALL] else options.methods
    question = ScenarioQuestion(
        methods=tuple(methods),
        budgets=tuple(options.budgets),
        seconds_per_unit=options.seconds_per_unit,
        reads_boxes=options.read_boxes,
        **_read_question(options),
    )
    print(format_study(_run_asked(options, ScenarioStudy(question))), flush=True)
    return FINE


def _add_ablations(commands: Any) -> None:
    text = "what finds the bounce: the planner with one part changed at a time"
    notes = textwrap.fill(f"Variants: {'; '.join(VARIANTS)}.", WIDTH)
    command = add_command(commands, "ablations", _ablations, text, _ABLATIONS, notes)
    _add_question(command, AblationQuestion())
    text, usual = "by name, see below (default: all)", list(VARIANTS)
    command.add_argument("--variants", nargs="+", metavar="NAME", default=usual, help=text)


def _ablations(options: argparse.Namespace) -> int:
    question = AblationQuestion(methods=tuple(options.variants), **_read_question(options))
    print(format_ablations(_run_asked(options, AblationStudy(question))), flush=True)
    return FINE


def _add_question(command: Any, usual: ScenarioQuestion) -> None:
    """Adds which scenarios, how they are run, and where results go; `usual` has the defaults."""
    for name, meaning in (("count", "of scenarios"), ("seed", "of all chance")):
        default = getattr(usual, name)
        look: dict[str, Any] = {"type": int, "metavar": name[0].upper(), "default": default}
        command.add_argument(f"--{name}", help=f"{meaning} (default: {default})", **look)
    text = f"time steps of a scenario (default: {usual.num_steps})"
    command.add_argument("--steps", type=int, metavar="N", default=usual.num_steps, help=text)
    add_workers(command)
    add_json(command, "write the results, again and again")
    text = "go on from the results that are there"
    command.add_argument("--resume", action="store_true", help=text)


def _read_question(options: argparse.Namespace) -> dict[str, Any]:
    """Returns the fields of a question that `_add_question` has flags for."""
    return {"count": options.count, "seed": options.seed, "num_steps": options.steps}


def _run_asked(options: argparse.Namespace, study: _Study) -> _Study:
    """Runs a study and shows how far it is; after Ctrl-C it says how to go on from what is kept."""
    try:
        with show_progress(options) as say:
            workers = read_workers(options)
            return study.run(options.json, resume=options.resume, executor=workers, progress=say)
    except KeyboardInterrupt:
        if options.json:
            print(f"drake-aigto: --resume goes on from {options.json}", file=sys.stderr)
        raise


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
