"""What commands that run studies take, and how they run them."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, TypeVar

from benchmarks.study.scenario_question import ScenarioQuestion, Spread
from benchmarks.study.study import Study
from drake_aigto.cli import add_json, add_workers, read_workers, show_progress
from drake_aigto.errors import OptionsError

_Study = TypeVar("_Study", bound=Study[Any, Any])
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
    text = "after which what is not done is left out (default: never)"
    command.add_argument("--minutes", type=float, default=math.inf, metavar="M", help=text)


def run_asked(options: argparse.Namespace, study: _Study) -> _Study:
    """Runs a study as the flags of `add_running` ask, and shows how far it is.

    After Ctrl-C it says how to go on, if results were kept.
    """
    try:
        with show_progress(options) as say:
            return study.run(
                options.json,
                resume=options.resume,
                executor=read_workers(options),
                progress=say,
                minutes=options.minutes,
            )
    except KeyboardInterrupt:
        if options.json:
            print(f"drake-aigto: --resume goes on from {options.json}", file=sys.stderr)
        raise


def add_numbers(command: Any, defaults: object, **meanings: str) -> None:
    """Adds a flag for each of a question's numbers, whose default tells its type."""
    for name, meaning in meanings.items():
        usual = getattr(defaults, name)
        look: dict[str, Any] = {"type": type(usual), "metavar": name[0].upper(), "default": usual}
        text = f"{meaning} (default: {usual})"
        command.add_argument(f"--{name.replace('_', '-')}", help=text, **look)


def add_question(command: Any, usual: ScenarioQuestion) -> None:
    """Adds how many scenarios, which ones, and their spreads; `usual` has the defaults."""
    add_numbers(command, usual, count="of scenarios", seed="of all chance")
    text = f"time steps of a scenario (default: {usual.num_steps})"
    command.add_argument("--steps", type=int, metavar="N", default=usual.num_steps, help=text)
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
        raise OptionsError(f"--{name}", *error.args[1:]) from error
