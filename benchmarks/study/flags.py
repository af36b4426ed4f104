"""What commands that run studies take, and how they run them."""

from __future__ import annotations

import argparse
import math
import sys
from typing import Any, TypeVar

from benchmarks.study.scenario_question import ScenarioQuestion
from benchmarks.study.study import Study
from drake_aigto.cli import add_json, add_workers, read_workers, show_progress

_Study = TypeVar("_Study", bound=Study[Any, Any])


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
    """Adds how many scenarios, and which ones; `usual` has the defaults."""
    add_numbers(command, usual, count="of scenarios", seed="of all chance")
    text = f"time steps of a scenario (default: {usual.num_steps})"
    command.add_argument("--steps", type=int, metavar="N", default=usual.num_steps, help=text)


def read_question(options: argparse.Namespace) -> dict[str, Any]:
    """Returns the fields of a question that `add_question` has flags for."""
    return {"count": options.count, "seed": options.seed, "num_steps": options.steps}
