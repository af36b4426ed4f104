"""Threads in which proposals are closed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any

from drake_aigto.kernels import uncollected

# Python answers a Ctrl-C that comes just before a wait begins only when the wait ends [s].
_PATIENCE = 0.1


@contextmanager
def start_threads(count: int) -> Iterator[ThreadPoolExecutor]:
    """Yields threads; until they end, Python's collector of garbage rests.

    It runs in any thread, and Drake ends the process where another one than the main thread frees
    a Meshcat. Diagrams hold one that draws them, and are cycles, which nothing else frees.
    """
    with uncollected(), ThreadPoolExecutor(count) as pool:
        yield pool


def wait_for(runs: Sequence[Future[Any]]) -> None:
    """Waits for all runs; a Ctrl-C, whenever it comes, is answered within `_PATIENCE`."""
    while wait(runs, _PATIENCE).not_done:
        pass
