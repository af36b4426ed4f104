"""Jobs under way: each ends, even if the process that runs it dies."""

from __future__ import annotations

import math
import platform
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import AbstractContextManager, contextmanager
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple

from drake_aigto import __version__
from drake_aigto.errors import StudyError
from drake_aigto.jobs.workers import open_workers


class ProcessDiedError(StudyError):
    """A job during which process after process died."""


class _Call(NamedTuple):
    name: Any
    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    is_alone: bool = False


@contextmanager
def open_jobs(executor: AbstractContextManager[Executor] | None = None) -> Iterator[Jobs]:
    """Yields `Jobs` on an executor, which is entered here; `open_workers` if None.

    Jobs that have not begun when the block is left never do.

    Raises:
        StudyError: from `open_workers`; or the executor broke as a whole.
    """
    with executor or open_workers() as running:
        jobs = Jobs(running)
        try:
            yield jobs
        except BrokenExecutor as error:
            raise StudyError(
                "the pool of workers broke",
                got=error,
                remedy="If there is a results file, go on from what was done (--resume).",
            ) from error
        finally:
            running.shutdown(wait=False, cancel_futures=True)


class Jobs:
    """Jobs under way on an executor, and their results.

    A job whose process dies runs again when no other job is under way, as Dask blames a worker's
    death on all jobs that waited there: only if it dies again was it this job.
    """

    def __init__(self, executor: Executor) -> None:
        """Starts nothing yet."""
        self._executor = executor
        self._under_way: dict[Future[Any], _Call] = {}
        self._blamed: list[_Call] = []
        self._ended: SimpleQueue[Future[Any]] = SimpleQueue()

    def start(self, name: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Starts a call of a module's function with picklable arguments; `ended` yields its name.

        Raises:
            BrokenExecutor: the executor takes no more.
        """
        self._submit(_Call(name, function, arguments))

    def _submit(self, call: _Call) -> None:
        future = self._executor.submit(_run, __version__, call.function, call.arguments)
        self._under_way[future] = call
        future.add_done_callback(self._ended.put)

    def ended(self, seconds: float = math.inf) -> Iterator[tuple[Any, Future[Any]]]:
        """Yields each job's name and its future as it ends; more may be started meanwhile.

        The future of a job whose processes died raises ProcessDiedError.

        Raises:
            TimeoutError: these seconds are over, in total.
            BrokenExecutor: the executor broke as a whole.
        """
        deadline = time.monotonic() + seconds
        while self._under_way:
            future = self._wait(deadline)
            call = self._under_way.pop(future)
            if future.cancelled():
                raise BrokenExecutor("jobs that were dropped, as by a scheduler that is gone")
            dask = sys.modules.get("distributed")  # Without it, nothing of it was raised.
            died = BrokenExecutor if dask is None else (BrokenExecutor, dask.KilledWorker)
            if not isinstance(future.exception(), died):
                yield call.name, future
            elif call.is_alone:
                yield call.name, _died(call.name)
            else:
                self._blamed.append(call._replace(is_alone=True))
            if self._blamed and not self._under_way:
                self._submit(self._blamed.pop(0))

    def _wait(self, deadline: float) -> Future[Any]:
        left = max(0.0, deadline - time.monotonic())
        try:
            return self._ended.get(timeout=None if math.isinf(left) else left)
        except Empty:
            raise TimeoutError from None


def _run(version: str, function: Callable[..., Any], arguments: tuple[Any, ...]) -> Any:
    """Runs a job in a process of the same version; a worker may have come late."""
    if version != __version__:
        raise StudyError(
            f"worker on {platform.node()}",
            got=f"drake_aigto {__version__}",
            expected=f"{version}, as where the study was started",
            remedy="Install the same there.",
        )
    return function(*arguments)


def _died(name: object) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_exception(
        ProcessDiedError(f"{name}", got="two processes that died of it", expected="a result")
    )
    return future
