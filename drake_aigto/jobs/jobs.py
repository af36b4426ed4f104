"""Jobs under way: each ends, even if the process that runs it dies; and executors of jobs.

These are processes of this machine, or the workers of a Dask scheduler.
"""

from __future__ import annotations

import contextlib
import faulthandler
import math
import multiprocessing
import os
import platform
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from importlib.util import find_spec
from multiprocessing import get_context, resource_tracker
from queue import Empty, SimpleQueue
from typing import Any, NamedTuple, ParamSpec, TypeVar

from drake_aigto import __version__
from drake_aigto.errors import MissingExtraError, OptionsError, StudyError

_P = ParamSpec("_P")
_T = TypeVar("_T")

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
        count: of processes on this machine; None: one per core.
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
    with _one_thread_each(), _choose(count or os.cpu_count() or 1, scheduler) as executor:
        yield executor


def _choose(count: int, scheduler: str | None) -> contextlib.AbstractContextManager[Executor]:
    if scheduler is None:
        return Processes(count)
    if find_spec("distributed") is None:
        raise MissingExtraError(f"scheduler {scheduler}", "distributed", "cluster")
    from drake_aigto.jobs.cluster import connect  # Dask takes its time.

    return connect(scheduler)


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


class Processes(Executor):
    """Runs jobs in processes of this machine; if one dies, only its own job fails.

    That job's future raises BrokenProcessPool, and the next job gets a new process. The processes
    are spawned, as forking with threads in libraries is not safe, and stay for further jobs, which
    can use caches of earlier ones.
    """

    def __init__(self, count: int) -> None:
        """Starts nothing yet."""
        self._numbers: dict[ProcessPoolExecutor, int] = {}  # each of one process, and its id
        self._is_closed = False
        self._own = threading.local()
        # Each thread waits for one process at a time.
        self._threads = ThreadPoolExecutor(count)

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Has a call made by the next process that is free, in the order of submission."""
        with _without_ctrl_c():
            return self._threads.submit(self._call, fn, args, kwargs)

    def _call(self, fn: Callable[..., _T], args: Any, kwargs: Any) -> _T:
        if not hasattr(self._own, "process"):
            self._own.process = self._start()
        process = self._own.process
        try:
            return process.submit(fn, *args, **kwargs).result()
        except BrokenProcessPool:
            del self._own.process, self._numbers[process]
            raise

    def _start(self) -> ProcessPoolExecutor:
        # A crash in C++ prints the Python stack.
        process = ProcessPoolExecutor(1, get_context("spawn"), faulthandler.enable)
        try:
            number = process.submit(os.getpid).result()
        except BrokenProcessPool as error:
            raise StudyError(
                "workers",
                got="processes that ended as they started",
                expected="processes that wait for jobs",
                remedy='Each imports the script: start them below `if __name__ == "__main__":`.',
            ) from error
        # While this end of its pipe is open, a process that is killed as it writes an answer is
        # waited for without end. The executor has no public way to close it.
        queue: Any = process._result_queue
        queue._writer.close()
        self._numbers[process] = number
        if self._is_closed:
            _kill(number)
        return process

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes at once, whatever they do; jobs that have not begun are canceled."""
        self._is_closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        processes = dict(self._numbers)
        for number in processes.values():
            _kill(number)
        self._threads.shutdown()
        for process in processes:
            process.shutdown()


@contextlib.contextmanager
def _without_ctrl_c() -> Iterator[None]:
    """Has threads that are started in this block, and processes of theirs, never see Ctrl-C."""
    resource_tracker.ensure_running()  # Else whatever needs it first would be seeing it again.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _kill(number: int) -> None:
    """Ends a process, if there is one of this number."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(number, signal.SIGKILL)


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
            left = max(0.0, deadline - time.monotonic())
            try:
                future = self._ended.get(timeout=None if math.isinf(left) else left)
            except Empty:
                raise TimeoutError from None
            call = self._under_way.pop(future)
            if future.cancelled():
                raise BrokenExecutor("jobs that were dropped, as by a scheduler that is gone")
            dask = sys.modules.get("distributed")  # Without it, nothing of it was raised.
            died = BrokenExecutor if dask is None else (BrokenExecutor, dask.KilledWorker)
            if not isinstance(future.exception(), died):
                yield call.name, future
            elif call.is_alone:
                future = Future()
                got = "two processes that died of it"
                future.set_exception(ProcessDiedError(f"{call.name}", got, "a result"))
                yield call.name, future
            else:
                self._blamed.append(call._replace(is_alone=True))
            if self._blamed and not self._under_way:
                self._submit(self._blamed.pop(0))


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
