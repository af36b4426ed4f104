"""Studies on Dask's workers: nothing is lost, and what can't be run on is refused by name."""

from __future__ import annotations

import dataclasses
import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import active_children
from pathlib import Path

import pytest
from distributed import LocalCluster
from distributed.versions import get_package_info
from scenario_studies import Inline

from benchmarks.study import ScenarioQuestion
from benchmarks.study.scenario_question import Spread
from benchmarks.study.scenario_study import ScenarioStudy
from drake_aigto.errors import StudyError
from drake_aigto.jobs import open_workers

PLANS = ScenarioQuestion(
    count=8, seed=1, num_steps=20, restitution=Spread((0.8,)), methods=("aigto",)
)


@contextmanager
def scheduler(workers: int = 1, threads: int = 1) -> Iterator[LocalCluster]:
    """Yields a scheduler whose workers are threads of this process: they begin in no time."""
    with LocalCluster(
        n_workers=workers,
        threads_per_worker=threads,
        processes=False,
        protocol="tcp://",
        dashboard_address=":0",
    ) as local:
        yield local


def plans(study: ScenarioStudy) -> list[tuple[object, ...]]:
    """Returns all of a study's results but seconds."""
    return [
        (each.goal, each.optimum, run.cost, run.evaluations, run.error)
        for each in study.results
        for run in each.runs.values()
    ]


@pytest.mark.slow
def test_a_worker_killed_in_the_middle_changes_no_plan(tmp_path: Path) -> None:
    before: set[int | None] = set()

    def kill_one(line: str) -> None:
        if line.startswith("3 of"):
            before.update(child.pid for child in active_children())
            victim = active_children()[0].pid
            assert victim is not None
            os.kill(victim, signal.SIGKILL)

    path = tmp_path / "study.json"
    study = ScenarioStudy(PLANS).run(path, executor=open_workers(2), progress=kill_one)
    assert len(before) == 2
    assert plans(study) == plans(ScenarioStudy(PLANS).run(executor=Inline()))
    assert ScenarioStudy.load(path) == study
    assert study.is_complete
    assert not active_children()


def test_a_study_runs_on_the_workers_of_a_scheduler_with_the_same_plans() -> None:
    question = dataclasses.replace(PLANS, count=2)
    with scheduler() as local:
        executor = open_workers(scheduler=local.scheduler_address)
        there = ScenarioStudy(question).run(executor=executor)
    assert plans(there) == plans(ScenarioStudy(question).run(executor=Inline()))


def test_a_scheduler_that_is_lost_ends_the_study_and_what_was_done_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "study.json"
    with scheduler() as local:

        def lose(line: str) -> None:
            local.close()

        executor = open_workers(scheduler=local.scheduler_address)
        told = r"workers broke: got jobs that were dropped, as by a scheduler .*\(--resume\)"
        with pytest.raises(StudyError, match=told):
            ScenarioStudy(PLANS).run(path, executor=executor, progress=lose)
    assert 1 <= len(ScenarioStudy.load(path).results) < PLANS.count
    assert ScenarioStudy(PLANS).run(path, resume=True, executor=Inline()).is_complete


@pytest.fixture
def silent() -> Iterator[str]:
    """The address of one who takes calls and says nothing."""
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
