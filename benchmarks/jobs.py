"""Independent jobs on several cores, each in a process of one thread.

Each worker is a pool of its own, so that one that dies takes no other job with it, and tells which
job it was.
"""

from __future__ import annotations

import argparse
import faulthandler
import math
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import active_children, get_context
from typing import Any

# Read by libraries when they are loaded: workers inherit it.
ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP", "NUMBA", "VECLIB")
}


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
    os.environ.update(ONE_THREAD)
    deadline = time.monotonic() + 60.0 * minutes
    waiting = deque(range(len(jobs)))
    idle = [_start_worker() for _ in range(min(workers, len(jobs)))]
    running: dict[Future[Any], tuple[int, ProcessPoolExecutor]] = {}
    while waiting or running:
        while waiting and idle:
            number, worker = waiting.popleft(), idle.pop()
            running[worker.submit(work, jobs[number])] = number, worker
        left = None if math.isinf(deadline) else max(0.0, deadline - time.monotonic())
        done, _ = wait(running, left, FIRST_COMPLETED)
        if not done:
            print(f"TIME IS UP: {len(waiting)} jobs not begun, {len(running)} ended", flush=True)
            for process in active_children():
                process.kill()
            idle += [worker for _, worker in running.values()]
            break
        for future in done:
            number, worker = running.pop(future)
            if isinstance(future.exception(), BrokenProcessPool):
                worker.shutdown()
                worker = _start_worker()
            idle.append(worker)
            yield number, future
    for worker in idle:
        worker.shutdown()


def _start_worker() -> ProcessPoolExecutor:
    """One process, which starts with its first job; a crash in C++ prints the Python stack."""
    return ProcessPoolExecutor(1, get_context("spawn"), faulthandler.enable)
