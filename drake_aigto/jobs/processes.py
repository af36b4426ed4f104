"""Processes of this machine as an executor."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, resource_tracker
from typing import Any, ParamSpec, TypeVar

_P = ParamSpec("_P")
_T = TypeVar("_T")


@contextlib.contextmanager
def without_ctrl_c() -> Iterator[None]:
    """Has threads that are started in this block, and processes of theirs, never see Ctrl-C."""
    resource_tracker.ensure_running()  # Else whatever needs it first would be seeing it again.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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
        with without_ctrl_c():
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
        number = process.submit(os.getpid).result()
        self._numbers[process] = number
        if self._is_closed:
            kill(number)
        return process

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes at once, whatever they do; jobs that have not begun are canceled."""
        self._is_closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        processes = dict(self._numbers)
        for number in processes.values():
            kill(number)
        self._threads.shutdown()
        for process in processes:
            process.shutdown()


def kill(number: int) -> None:
    """Ends a process, if there is one of this number."""
    with contextlib.suppress(ProcessLookupError):
        os.kill(number, signal.SIGKILL)
