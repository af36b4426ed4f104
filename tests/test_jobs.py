"""Jobs under way: whose process dies is told apart from what only waited beside it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from typing import Any

import pytest
from scenario_studies import Inline

from drake_aigto.errors import StudyError
from drake_aigto.jobs import ProcessDiedError, open_jobs


class Blaming(Inline):
    """Loses the first two jobs together, as Dask does with what is at a worker that dies."""

    def __init__(self) -> None:
        super().__init__()
        self.futures: list[Future[Any]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        if len(self.futures) < 2:
            future: Future[Any] = Future()
        else:  # Now each must be alone.
            assert all(future.done() for future in self.futures)
            future = super().submit(fn, *args, **kwargs)
        self.futures.append(future)
        if len(self.futures) == 2:
            for each in self.futures:
                each.set_exception(BrokenExecutor("killed"))
        return future


def die() -> None:
    raise BrokenExecutor("killed")


def test_a_job_that_was_blamed_with_another_runs_again_alone() -> None:
    with open_jobs(Blaming()) as jobs:
        jobs.start("innocent", math.sqrt, 4.0)
        jobs.start("killer", die)
        ended = dict(jobs.ended())
    assert ended["innocent"].result() == 2.0
    with pytest.raises(ProcessDiedError, match=r"^killer: got two processes that died of it"):
        ended["killer"].result()


def test_jobs_may_be_started_as_others_end() -> None:
    with open_jobs(Inline()) as jobs:
        jobs.start(4.0, math.sqrt, 4.0)
        values = []
        for name, future in jobs.ended():
            values.append(future.result())
            if name > 1.1:
                jobs.start(future.result(), math.sqrt, future.result())
    assert values == [4.0**0.5**k for k in range(1, len(values) + 1)]
    assert values[-1] <= 1.1**0.5


def test_when_time_is_up_waiting_ends_and_what_has_not_begun_never_does() -> None:
    started, future = time.monotonic(), Future[Any]()

    class Never(Inline):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            return future

        def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
            future.cancel()

    with pytest.raises(TimeoutError), open_jobs(Never()) as jobs:
        jobs.start("long", math.sqrt, 4.0)
        next(jobs.ended(0.05))
    assert time.monotonic() - started < 10.0
    assert future.cancelled()


def test_a_worker_of_another_version_is_refused_by_name() -> None:
    class Elsewhere(Inline):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            _, *others = args
            return super().submit(fn, "0.0.9", *others, **kwargs)

    with open_jobs(Elsewhere()) as jobs:
        jobs.start("job", math.sqrt, 4.0)
        ((_, future),) = jobs.ended()
    told = r"^worker on .+: got drake_aigto \d.+, expected 0\.0\.9, as where the study was started"
    with pytest.raises(StudyError, match=told):
        future.result()
