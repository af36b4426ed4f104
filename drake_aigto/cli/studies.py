"""What benchmarks take: the random scenarios of a question, and how a long run goes on."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any, TypeVar

from drake_aigto.cli.flags import add_json, add_workers, read_workers
from drake_aigto.cli.progress import show_progress
from drake_aigto.errors import OptionsError
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.study.spread import Spread

_Study = TypeVar("_Study")
_SPREADS = {
    "start": "distance from the wall at first [m]",
    "velocity": "at first, negative towards the wall [m/s]",
    "goal": "where to end [m]",
    "restitution": "speed after / before a bounce",
    "mass": "[kg]",
    "duration": "[s]",
}


def add_running(command: Any) -> None:
    """Adds how it is run, and where its results go."""
    add_workers(command)
    add_json(command, "write the results, again and again")
    text = "go on from the results that are there"
    command.add_argument("--resume", action="store_true", help=text)


def run_study(options: argparse.Namespace, run: Callable[..., _Study], question: object) -> _Study:
    """Runs a study as the flags of `add_running` ask, and shows how far it is.

    After Ctrl-C it says how to go on, if results were kept. `run` is `run_scenario_study`, or
    another that takes the same.
    """
    try:
        with show_progress(options) as say:
            how = {"resume": options.resume, "executor": read_workers(options), "progress": say}
            return run(question, options.json, **how)
    except KeyboardInterrupt:
        if options.json:
            print(f"drake-aigto: --resume goes on from {options.json}", file=sys.stderr)
        raise


def add_question(command: Any, usual: ScenarioQuestion) -> None:
    """Adds how many scenarios, which ones, and their spreads; `usual` has the defaults."""
    counts = {
        "--count": ("COUNT", usual.count, "of scenarios"),
        "--seed": ("SEED", usual.seed, "of all chance"),
        "--steps": ("N", usual.num_steps, "time steps of a scenario"),
    }
    for flag, (metavar, default, meaning) in counts.items():
        text = f"{meaning} (default: {default})"
        command.add_argument(flag, type=int, metavar=metavar, default=default, help=text)
    spreads = command.add_argument_group("spreads of the scenarios")
    for name, meaning in _SPREADS.items():
        usual_spread = str(getattr(usual, name))
        text, words = f"{meaning} (default: {usual_spread})", usual_spread.split()
        spreads.add_argument(f"--{name}", nargs="+", metavar="X", default=words, help=text)


def read_question(options: argparse.Namespace) -> dict[str, Any]:
    """Returns the fields of a question that `add_question` has flags for.

    Raises:
        OptionsError: a spread that is none.
    """
    fields = {"count": options.count, "seed": options.seed, "num_steps": options.steps}
    return fields | {name: _parse_spread(name, getattr(options, name)) for name in _SPREADS}


def _parse_spread(name: str, words: list[str]) -> Spread:
    try:
        return Spread.parse(words)
    except OptionsError as error:
        raise OptionsError(f"--{name}", error.got, error.expected, error.remedy) from error
