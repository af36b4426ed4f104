"""Executors of jobs: processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from importlib.util import find_spec

from drake_aigto.errors import MissingExtraError, OptionsError
from drake_aigto.jobs.processes import Processes

# Read by libraries when they are loaded: processes inherit it.
_ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP", "NUMBA", "VECLIB")
}


@contextlib.contextmanager
def open_workers(count: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """Yields an executor with one thread per process, and ends the processes afterwards.

    Nothing starts before the block is entered. Jobs that still run when it is left are cancelled; a
    job that has begun elsewhere runs to its end. Ctrl-C does not reach the processes of this
    machine: the caller has to handle it.

    Args:
        count: of processes on this machine, which are a Dask cluster if the extra "cluster" is
            installed; None: one per core.
        scheduler: address of a Dask scheduler whose workers are to run the jobs instead, such as
            "tcp://10.0.0.1:8786".

    Raises:
        OptionsError: less than one process, or a count beside a scheduler.
        MissingExtraError: a scheduler, without the extra "cluster".
        StudyError: the scheduler does not answer or has no workers, or one of those has another
            version of this package or several threads.
    """
    if count is not None and (count < 1 or scheduler is not None):
        got = f"{count} beside a scheduler" if scheduler is not None else count
        raise OptionsError("workers", got=got, expected="1 or more, or a scheduler")
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        # A worker that imports a script without a guard. Whoever started it says so, once.
        sys.exit(1)
    has_dask = find_spec("distributed") is not None
    if scheduler is not None and not has_dask:
        raise MissingExtraError(f"scheduler {scheduler}", "distributed", "cluster")
    with _one_thread_each(), _choose(count or os.cpu_count() or 1, scheduler, has_dask) as executor:
        yield executor


def _choose(
    count: int, scheduler: str | None, has_dask: bool
) -> contextlib.AbstractContextManager[Executor]:
    if not has_dask:
        return Processes(count)
    from drake_aigto.jobs import cluster  # Dask takes its time.

    return cluster.start_cluster(count) if scheduler is None else cluster.connect(scheduler)


@contextlib.contextmanager
def _one_thread_each() -> Iterator[None]:
    """Has processes that are started in this block load their libraries with one thread."""
    before = {name: os.environ.get(name) for name in _ONE_THREAD}
    os.environ.update(_ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
