"""Processes that work side by side, and outlive each other."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import signal
from collections import deque
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from types import TracebackType
from typing import Any, ParamSpec, TypeVar

from drake_aigto.errors import OptionsError

_P = ParamSpec("_P")
_T = TypeVar("_T")

# Read by libraries when they are loaded: processes inherit it.
_ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OPENBLAS", "MKL", "OMP", "NUMBA", "VECLIB")
}


class Workers(Executor):
    """Runs jobs in processes of one thread each; one that dies takes only its own job with it.

    That job's future raises BrokenProcessPool, and the next job gets a new process. The processes
    are spawned, as forking one whose libraries have threads is not safe, and stay for further jobs:
    what a job has cached is there for the next. Ctrl-C does not reach them. An exception that
    leaves the `with` block, KeyboardInterrupt too, kills them.
    """

    def __init__(self, count: int | None = None) -> None:
        """Starts nothing yet.

        Args:
            count: of processes; as many as there are cores if None.

        Raises:
            OptionsError: less than one.
        """
        if count is not None and count < 1:
            raise OptionsError("workers", got=count, expected="1 or more")
        self._before = {name: os.environ.get(name) for name in _ONE_THREAD}
        os.environ.update(_ONE_THREAD)
        self._processes: dict[ProcessPoolExecutor, int] = {}  # each of one process, and its id
        self._idle: deque[ProcessPoolExecutor] = deque()
        self._is_closed = False
        # Each thread waits for one process at a time.
        self._threads = ThreadPoolExecutor(count or os.cpu_count(), initializer=_block_ctrl_c)

    def submit(self, fn: Callable[_P, _T], /, *args: _P.args, **kwargs: _P.kwargs) -> Future[_T]:
        """Has a call made by the next process that is free, in the order of submission."""
        return self._threads.submit(self._call, fn, args, kwargs)

    def _call(self, fn: Callable[..., _T], args: Any, kwargs: Any) -> _T:
        process = self._idle.pop() if self._idle else self._start()
        try:
            result = process.submit(fn, *args, **kwargs).result()
        except BrokenProcessPool:
            self._processes.pop(process, None)
            process.shutdown()
            raise
        except BaseException:
            self._idle.append(process)  # It was the job that failed.
            raise
        self._idle.append(process)
        return result

    def _start(self) -> ProcessPoolExecutor:
        # A crash in C++ prints the Python stack.
        process = ProcessPoolExecutor(1, get_context("spawn"), faulthandler.enable)
        number = process.submit(os.getpid).result()
        self._processes[process] = number
        if self._is_closed:
            _kill(number)
        return process

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Ends the processes, once their jobs are done."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for process in list(self._processes):
            process.shutdown(wait)
        for name, value in self._before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

    def kill(self) -> None:
        """Ends the processes at once; jobs that have not begun are cancelled, others broken off."""
        self._is_closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        for number in list(self._processes.values()):
            _kill(number)
        self.shutdown()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Waits for all jobs; after an exception, for none."""
        if kind is None:
            self.shutdown()
        else:
            self.kill()


def _kill(number: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(number, signal.SIGKILL)


def _block_ctrl_c() -> None:
    """Has this thread's processes never see Ctrl-C: it is for who waits for them to handle."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
