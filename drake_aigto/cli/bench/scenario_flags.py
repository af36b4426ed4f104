"""The question of benchmarks on random scenarios, as flags."""

from __future__ import annotations

import argparse
from typing import Any

from drake_aigto.errors import OptionsError
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.study.spread import Spread

_SPREADS = {
    "start": "distance from the wall at first [m]",
    "velocity": "at first, negative towards the wall [m/s]",
    "goal": "where to end [m]",
    "restitution": "speed after / before a bounce",
    "mass": "[kg]",
    "duration": "[s]",
}


def add_question(command: Any, usual: ScenarioQuestion) -> None:
    """Adds how many scenarios, which ones, and their spreads.

    Args:
        command: to add flags to.
        usual: has the defaults.
    """
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
