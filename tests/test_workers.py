"""Processes that work side by side: what one does is no other's business."""

from __future__ import annotations

import gc
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import active_children, connection
from pathlib import Path

import dask
import pytest
from distributed import LocalCluster
from distributed.versions import get_package_info

from drake_aigto import PlanOptions, Scenario, plan
from drake_aigto.errors import MissingExtraError, OptionsError, StudyError
from drake_aigto.jobs import (
    Answer,
    ProcessDiedError,
    load_answers,
    open_jobs,
    open_workers,
    plan_many,
)


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


def die_answering() -> bytes:
    """Is killed when half of the answer is written."""

    def send_half(own: connection.Connection, data: bytes) -> None:
        os.write(own.fileno(), data[: len(data) // 2])
        os.kill(os.getpid(), signal.SIGKILL)

    connection.Connection._send = send_half  # type: ignore[attr-defined]
    return bytes(100)


def fail() -> None:
    raise ValueError("a job's own failure")


def test_a_script_without_a_guard_is_told_what_it_lacks(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    lines = (
        "from drake_aigto.jobs import open_jobs",
        "with open_jobs() as jobs:",
        "    jobs.start('one', abs, 1)",
        "    for _, future in jobs.ended(): future.result()",
    )
    script.write_text("\n".join(lines))
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    last = ended.stderr.splitlines()[-1]
    assert ended.returncode == 1
    assert 'start them below `if __name__ == "__main__":`' in last
    assert ended.stderr.count("errors.StudyError") == 1  # The workers themselves say nothing.
    assert "bootstrapping" not in ended.stderr


@pytest.mark.slow
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
def test_a_worker_that_is_killed_as_it_answers_is_not_waited_for() -> None:
    with open_workers(1) as executor:
        dead = executor.submit(die_answering)
        assert isinstance(dead.exception(timeout=60.0), BrokenProcessPool)
        assert executor.submit(abs, -1).result(timeout=60.0) == 1


@pytest.mark.slow
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
    monkeypatch.setattr("drake_aigto.jobs.jobs.find_spec", lambda name: None)
    told = (
        r"^scheduler tcp://a:1: got no module 'distributed'.*pip install 'drake_aigto\[cluster\]'"
    )
    with pytest.raises(MissingExtraError, match=told), open_workers(None, "tcp://a:1"):
        pass


FAST = PlanOptions(confirm=False, threads=1)
QUESTIONS = {
    f"{row}/{k}": replace(Scenario.named(f"table1/{row}"), goal_position=0.5 + 0.1 * k)
    for row in (1, 3)
    for k in range(4)
}


@contextmanager
def scheduler(workers: int = 1, threads: int = 1) -> Iterator[LocalCluster]:
    """Yields a scheduler whose workers are threads of this process: they begin in no time.

    Dask's profiler is off: it walks the frames of running threads, which may crash Python 3.11. And
    what earlier tests left is collected here: Drake ends the process where another thread than the
    main one frees a Meshcat, and its diagrams, which hold one, are cycles.
    """
    gc.collect()
    profiler = dask.config.set({"distributed.worker.profile.enabled": False})
    with (
        profiler,
        LocalCluster(
            n_workers=workers,
            threads_per_worker=threads,
            processes=False,
            protocol="tcp://",
            dashboard_address=":0",
        ) as local,
    ):
        yield local


def costs(answers: Iterable[Answer]) -> dict[str, float]:
    return {each.name: each.plan.cost for each in answers if each.plan is not None}


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_changes_no_plan() -> None:
    answers = plan_many(QUESTIONS, FAST, workers=2)
    first = next(answers)
    before = {child.pid for child in active_children()}
    assert len(before) == 2
    os.kill(before.pop() or 0, signal.SIGKILL)
    assert costs([first, *answers]) == costs(plan_many(QUESTIONS, FAST, workers=1))
    assert not active_children()


def test_plans_on_the_workers_of_a_scheduler_are_the_same() -> None:
    two = {name: QUESTIONS[name] for name in list(QUESTIONS)[:2]}
    with scheduler() as local:
        there = costs(plan_many(two, FAST, scheduler=local.scheduler_address))
    assert there == {name: plan(scenario, FAST).cost for name, scenario in two.items()}


@pytest.mark.slow
def test_a_scheduler_that_is_lost_ends_the_work_and_what_was_done_is_kept(tmp_path: Path) -> None:
    with scheduler() as local:
        address = local.scheduler_address
        answers = plan_many(QUESTIONS, FAST, scheduler=address, folder=tmp_path)
        first = next(answers)
        local.close()
        told = r"workers broke: got jobs that were dropped, as by a scheduler .*\(--resume\)"
        with pytest.raises(StudyError, match=told):
            list(answers)
    kept = load_answers(tmp_path)
    assert first in kept and len(kept) < len(QUESTIONS)


@pytest.fixture
def silent() -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


@pytest.mark.slow
def test_a_scheduler_that_does_not_answer_is_told_within_seconds(
    silent: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drake_aigto.jobs.cluster._PATIENCE", 1.0)
    started = time.monotonic()
    for address, why in (
        (silent, r"nothing within 1 s\. Start one \(dask scheduler\)"),
        ("tcp://127.0.0.1:1", "nothing within 1 s"),
        ("nonsense", "missing port number"),
    ):
        told = rf"^Dask scheduler {address} does not answer: got {why}"
        with pytest.raises(StudyError, match=told), open_workers(scheduler=address):
            pass
    assert time.monotonic() - started < 10.0


@pytest.mark.parametrize(
    ("workers", "threads", "drake", "message"),
    [
        (0, 1, None, r"^Dask scheduler tcp://.*: got no workers, expected some\. Start workers so"),
        (1, 3, None, r"^Dask worker tcp://.*: got 3 threads, expected one, .* --nthreads 1\.$"),
        (1, 1, "0.9", r"^Dask worker tcp://.*: got drake \d.*, expected 0\.9, as here\. Install"),
    ],
)
def test_workers_that_are_not_fit_are_refused_by_name(
    workers: int, threads: int, drake: str | None, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if drake is not None:
        here = get_package_info(("drake_aigto",)) | {"drake": drake}
        monkeypatch.setattr("drake_aigto.jobs.cluster.get_package_info", lambda names: here)
    with scheduler(workers, threads) as local:
        refused = open_workers(scheduler=local.scheduler_address)
        with pytest.raises(StudyError, match=message), refused:
            pass
