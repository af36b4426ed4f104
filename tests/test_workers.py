"""Processes that work side by side, with Dask and without: what one does is no other's business."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drake_aigto.errors import MissingExtraError, OptionsError
from drake_aigto.jobs import ProcessDiedError, open_jobs, open_workers


@pytest.fixture(params=["with Dask", "without Dask"])
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param == "without Dask":
        monkeypatch.setattr("drake_aigto.jobs.workers.find_spec", lambda name: None)


def die_unless(path: Path) -> int:
    """Is killed, as if memory ran out, unless the path is there; returns the process's id."""
    if not path.exists():
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def die_at_first(path: Path) -> int:
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return os.getpid()


def fail() -> None:
    raise ValueError("a job's own failure")


def test_a_script_without_a_guard_is_told_what_it_lacks(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text("from drake_aigto.jobs import open_jobs\nwith open_jobs(): pass\n")
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    last = ended.stderr.splitlines()[-1]
    assert ended.returncode == 1
    assert 'start them below `if __name__ == "__main__":`' in last
    assert ended.stderr.count("errors.StudyError") == 1  # The workers themselves say nothing.
    assert "bootstrapping" not in ended.stderr


@pytest.mark.slow
@pytest.mark.usefixtures("kind")
def test_a_killed_worker_is_replaced_and_only_a_job_that_kills_again_fails(tmp_path: Path) -> None:
    with open_jobs(open_workers(1)) as jobs:
        jobs.start("once", die_at_first, tmp_path / "been")
        jobs.start("always", die_unless, tmp_path / "never")
        jobs.start("well", os.getpid)
        ended = dict(jobs.ended())
    assert os.getpid() not in (ended["once"].result(), ended["well"].result())
    with pytest.raises(ProcessDiedError, match=r"^always: got two processes that died of it"):
        ended["always"].result()


@pytest.mark.slow
@pytest.mark.usefixtures("kind")
def test_workers_have_one_thread_outlive_failures_and_see_no_ctrl_c(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("NUMBA_NUM_THREADS", raising=False)
    with open_workers(1) as executor:
        before, failed = executor.submit(os.getpid), executor.submit(fail)
        threads = [
            executor.submit(os.getenv, f"{name}_NUM_THREADS").result() for name in ("OMP", "NUMBA")
        ]
        assert threads == ["1", "1"]
        assert isinstance(failed.exception(), ValueError)
        number, long = before.result(), executor.submit(time.sleep, 0.5)
        os.kill(number, signal.SIGINT)
        assert long.exception() is None
        assert executor.submit(os.getpid).result() == number
    assert os.getenv("OMP_NUM_THREADS") == "7"
    assert os.getenv("NUMBA_NUM_THREADS") is None


@pytest.mark.slow
@pytest.mark.usefixtures("kind")
def test_ctrl_c_ends_all_at_once() -> None:
    with pytest.raises(KeyboardInterrupt), open_workers(1) as executor:
        number = executor.submit(os.getpid).result()
        for _ in range(2):
            executor.submit(time.sleep, 600.0)
        started = time.monotonic()
        raise KeyboardInterrupt
    assert time.monotonic() - started < 10.0
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


@pytest.mark.parametrize(
    ("count", "scheduler", "message"),
    [
        (0, None, r"^workers: got 0, expected 1 or more"),
        (2, "tcp://10.0.0.1:8786", r"^workers: got 2 beside a scheduler, expected 1 or more, or"),
    ],
)
def test_where_jobs_can_not_run_is_refused(count: int, scheduler: str | None, message: str) -> None:
    with pytest.raises(OptionsError, match=message), open_workers(count, scheduler):
        pass


def test_a_scheduler_needs_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drake_aigto.jobs.workers.find_spec", lambda name: None)
    told = (
        r"^scheduler tcp://a:1: got no module 'distributed'.*pip install 'drake_aigto\[cluster\]'"
    )
    with pytest.raises(MissingExtraError, match=told), open_workers(None, "tcp://a:1"):
        pass


@pytest.mark.slow
def test_two_clusters_on_one_machine_share_no_port() -> None:
    with open_workers(1) as one, open_workers(1) as other:
        assert one.submit(int, "3").result() + other.submit(int, "4").result() == 7
