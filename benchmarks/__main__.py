"""Studies of random scenarios before a wall, and the page that shows them.

    python -m benchmarks scenarios --count 20                          # a first impression
    python -m benchmarks scenarios --count 500 --json planner.json
    python -m benchmarks scenarios --count 60 --methods aigto snopt cma-es --budgets 1 10 100
        --workers 8 --keep parts --json rivals.json
    python -m benchmarks ablations --json ablations.json
    python -m benchmarks page planner.json rivals.json ablations.json --out results.md

`scenarios`: how often methods find the optimum, and how fast. `ablations`: what finds the bounce,
the planner with one part changed at a time. `page`: the results page of saved results. The first
scenarios of a seed are the same for any count.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from benchmarks.ablations.ablations import (
    VARIANTS,
    AblationQuestion,
    AblationStudy,
    format_ablations,
)
from benchmarks.baselines import BASELINES
from benchmarks.script import read_flags, run_all, run_as
from benchmarks.study.scenario_question import PLANNER, ScenarioQuestion
from benchmarks.study.scenario_study import ScenarioStudy, answer
from benchmarks.study.scenario_tables import format_study
from drake_aigto.cli import BAD_INPUT, FINE
from drake_aigto.plain import check_writable

_Study = TypeVar("_Study", bound=ScenarioStudy)
_ALL = "all"


def _scenarios(words: Sequence[str]) -> None:
    usual, names = ScenarioQuestion(), ", ".join(map(repr, BASELINES))
    options = _read(
        words,
        usual,
        methods=((PLANNER,), f"{PLANNER}, the planner; {names}; or {_ALL}", {"nargs": "+"}),
        budgets=(usual.budgets, "units of time at which the others are judged", {"nargs": "+"}),
        seconds_per_unit=(
            None,
            f"of one core (default: what {PLANNER} takes on the same scenario)",
            {"type": float},
        ),
        read_boxes=(False, "also report what boxes alone say, before any polish"),
    )
    methods = [PLANNER, *BASELINES] if options.methods == [_ALL] else options.methods
    question = ScenarioQuestion(
        methods=tuple(methods),
        budgets=tuple(options.budgets),
        seconds_per_unit=options.seconds_per_unit,
        reads_boxes=options.read_boxes,
        **_fields(options),
    )
    print(format_study(_ask(ScenarioStudy(question), options)), flush=True)


def _ablations(words: Sequence[str]) -> None:
    text = f"of {', '.join(map(repr, VARIANTS))} (default: all)"
    usual = AblationQuestion()
    options = _read(words, usual, variants=(tuple(VARIANTS), text, {"nargs": "+"}))
    question = AblationQuestion(methods=tuple(options.variants), **_fields(options))
    print(format_ablations(_ask(AblationStudy(question), options)), flush=True)


def _read(words: Sequence[str], usual: ScenarioQuestion, **flags: Any) -> argparse.Namespace:
    """Returns the flags of a study, whose question has these defaults."""
    return read_flags(
        __doc__,
        words,
        count=(usual.count, "scenarios"),
        seed=(usual.seed, "of all chance"),
        steps=(usual.num_steps, "time steps of a scenario"),
        json=("", "file of results, which `page` reads"),
        **flags,
    )


def _fields(options: argparse.Namespace) -> dict[str, Any]:
    return {"count": options.count, "seed": options.seed, "num_steps": options.steps}


def _ask(study: _Study, options: argparse.Namespace) -> _Study:
    """Returns the study with its answers, which are written if asked for."""
    question = study.question
    question.check()
    check_writable(options.json or None)
    results = run_all(answer, [(question, number) for number in range(question.count)], options)
    study = type(study)(question, tuple(results))
    if options.json:
        study.save(options.json)
    return study


def _page(words: Sequence[str]) -> None:
    # Matplotlib takes its time.
    from benchmarks.ablations.page import describe_ablations
    from benchmarks.study.page import write_results_page
    from benchmarks.study.scenario_page import describe_scenarios

    options = read_flags(
        __doc__,
        words,
        workers=None,
        place=("results", {"nargs": "+", "metavar": "RESULTS.json"}),
        out=("docs/results.md", "the page; pictures go into a folder images beside it"),
    )
    sections = {
        ScenarioQuestion.kind: describe_scenarios,
        AblationQuestion.kind: describe_ablations,
    }
    write_results_page(options.results, options.out, sections)
    print(f"wrote {options.out}")


COMMANDS: Mapping[str, Callable[[Sequence[str]], None]] = {
    "scenarios": _scenarios,
    "ablations": _ablations,
    "page": _page,
}


def main(words: Sequence[str] | None = None) -> int:
    """Runs a command, and returns the exit status."""
    words = sys.argv[1:] if words is None else words
    if not words or words[0] not in COMMANDS:
        print(f"{__doc__}\nexpected one of {', '.join(COMMANDS)}", file=sys.stderr)
        return BAD_INPUT
    COMMANDS[words[0]](words[1:])
    return FINE


if __name__ == "__main__":
    run_as("benchmarks.__main__")
