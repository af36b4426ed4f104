"""Independent jobs on several cores, each in a process of one thread, until time is up."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any

from drake_aigto.study.workers import Workers


def add_options(parser: argparse.ArgumentParser, workers: int = 1) -> None:
    """Adds what all scripts with jobs take."""
    parser.add_argument("--workers", type=int, default=workers, help="jobs at once, one core each")
    parser.add_argument(
        "--minutes", type=float, default=math.inf, help="then what runs is ended, the rest reported"
    )


def run_jobs(
    work: Callable[[Any], Any], jobs: Sequence[Any], workers: int, minutes: float = math.inf
) -> Iterator[tuple[int, Future[Any]]]:
    """Starts jobs in this order and yields each one's number as it ends, with result or exception.

    Jobs that have not ended when time is up are not yielded: nobody knows what would have come of
    them.
    """
    deadline = time.monotonic() + 60.0 * minutes
    with Workers(workers) as pool:
        numbers = {pool.submit(work, job): number for number, job in enumerate(jobs)}
        pending = set(numbers)
        while pending:
            left = None if math.isinf(deadline) else max(0.0, deadline - time.monotonic())
            done, pending = wait(pending, left, FIRST_COMPLETED)
            if not done:
                running = sum(future.running() for future in pending)
                idle = len(pending) - running
                print(f"TIME IS UP: {idle} jobs not begun, {running} ended", flush=True)
                pool.kill()
                return
            for future in done:
                yield numbers[future], future
