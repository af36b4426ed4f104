"""Independent jobs, each in a process of one thread, until time is up."""

from __future__ import annotations

import argparse
import importlib
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from typing import Any, NoReturn

from drake_aigto.cli.flags import add_workers, read_workers
from drake_aigto.cli.status import BAD_INPUT
from drake_aigto.errors import AigtoError
from drake_aigto.jobs import open_jobs


def add_options(parser: argparse.ArgumentParser, workers: int | None = 1) -> None:
    """Adds what all scripts with jobs take."""
    add_workers(parser, workers)
    parser.add_argument(
        "--minutes", type=float, default=math.inf, help="then what runs is ended, the rest reported"
    )


def run_jobs(
    work: Callable[[Any], Any], jobs: Sequence[Any], options: argparse.Namespace
) -> Iterator[tuple[int, Future[Any]]]:
    """Starts jobs in this order and yields each one's number as it ends, with result or exception.

    Jobs that have not ended when time is up are not yielded: nobody knows what would have come of
    them.

    Args:
        work: a function of a module.
        jobs: what it is called with.
        options: the parsed ones of `add_options`.
    """
    with open_jobs(read_workers(options)) as under_way:
        for number, job in enumerate(jobs):
            under_way.start(number, work, job)
        num_left = len(jobs)
        try:
            for number, future in under_way.ended(60.0 * options.minutes):
                num_left -= 1
                yield number, future
        except TimeoutError:
            print(f"TIME IS UP: {num_left} jobs not done", flush=True)


def run_all(
    work: Callable[[Any], Any], jobs: Sequence[Any], options: argparse.Namespace
) -> list[Any]:
    """Runs jobs, tells which fail, and returns the results of the others in the order of the jobs.

    The arguments are those of `run_jobs`.
    """
    done: dict[int, Any] = {}
    for number, future in run_jobs(work, jobs, options):
        if error := future.exception():
            print(f"FAILED {jobs[number]}: {error!r}", flush=True)
        else:
            done[number] = future.result()
    return [done[number] for number in sorted(done)]


def run_as(name: str) -> NoReturn:
    """Runs `main` of a module under its name, by which workers find its functions, and exits."""
    try:
        sys.exit(importlib.import_module(name).main())
    except AigtoError as error:
        print(f"{name}: {error}", file=sys.stderr)
        sys.exit(BAD_INPUT)
