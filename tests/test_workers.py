"""Processes that work side by side: what one does to itself is no other's business."""

from __future__ import annotations

import os
import signal
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from drake_aigto.errors import OptionsError
from drake_aigto.study.workers import Workers


def die_at_first(path: Path) -> int:
    """Is killed, as if memory ran out, unless the path is there; returns the process's id."""
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def fail() -> None:
    raise ValueError("a job's own failure")


def test_a_killed_worker_is_replaced_and_names_its_job(tmp_path: Path) -> None:
    with Workers(1) as workers:
        first, second = (workers.submit(die_at_first, tmp_path / "been") for _ in range(2))
        assert isinstance(first.exception(), BrokenProcessPool)
        assert second.result() != os.getpid()


def test_a_worker_stays_though_its_job_raises() -> None:
    with Workers(1) as workers:
        before, failed, after = map(workers.submit, (os.getpid, fail, os.getpid))
        assert isinstance(failed.exception(), ValueError)
        assert before.result() == after.result()


def test_workers_have_one_thread_and_leave_the_environment_as_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with Workers(1) as workers:
        threads = workers.submit(os.getenv, "OMP_NUM_THREADS").result()
    assert threads == "1"
    assert os.getenv("OMP_NUM_THREADS") == "7"
    assert os.getenv("MKL_NUM_THREADS") is None


def test_ctrl_c_reaches_no_worker_and_ends_all() -> None:
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt), Workers(1) as workers:
        number = workers.submit(os.getpid).result()
        long, waiting = workers.submit(time.sleep, 600.0), workers.submit(os.getpid)
        os.kill(number, signal.SIGINT)
        time.sleep(0.2)
        assert not long.done()
        raise KeyboardInterrupt
    assert isinstance(long.exception(), BrokenProcessPool)
    assert waiting.cancelled()
    assert time.monotonic() - started < 60.0


def test_no_workers_are_refused() -> None:
    with pytest.raises(OptionsError, match=r"workers: got 0, expected 1 or more"):
        Workers(0)
