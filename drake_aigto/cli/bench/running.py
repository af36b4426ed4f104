"""How benchmarks are run that take long: in processes, into a file, and on from it."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any, TypeVar

from drake_aigto.cli.flags import add_json, add_workers, read_workers
from drake_aigto.cli.progress import show_progress

_Study = TypeVar("_Study")


def add_running(command: Any) -> None:
    """Adds how it is run, and where its results go."""
    add_workers(command)
    add_json(command, "write the results, again and again")
    command.add_argument(
        "--resume", action="store_true", help="go on from the results that are there"
    )


def run_study(options: argparse.Namespace, run: Callable[..., _Study], question: object) -> _Study:
    """Runs a study as the flags of `add_running` ask, and shows how far it is.

    After Ctrl-C it says how to go on, if results were kept.

    Args:
        options: the parsed ones.
        run: `run_scenario_study`, or another that takes the same.
        question: what to run.
    """
    try:
        with show_progress(options) as say:
            executor = read_workers(options)
            return run(
                question, options.json, resume=options.resume, executor=executor, progress=say
            )
    except KeyboardInterrupt:
        if options.json:
            print(f"drake-aigto: --resume goes on from {options.json}", file=sys.stderr)
        raise
