"""A job that fails takes no other with it, and one that time ends has not failed."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from typing import Any

import pytest
from scenario_studies import Inline

from benchmarks import growth, wide_bands
from benchmarks.jobs import add_options, run_as, run_jobs
from drake_aigto import jobs
from drake_aigto.cli import BAD_INPUT
from drake_aigto.jobs import ProcessDiedError, workers


def parse(*flags: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return parser.parse_args(flags)


class Some(Inline):
    """Never ends the job "long", and loses the process of "dies"."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        return Future() if ("long",) in args else super().submit(fn, *args, **kwargs)


@pytest.fixture(autouse=True)
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "open_workers", Some)


def work(job: str) -> str:
    if job == "dies":
        raise BrokenExecutor
    if job == "raises":
        raise ValueError(job)
    return job


def test_a_job_that_dies_or_raises_is_named_and_the_others_end() -> None:
    names = ["a", "dies", "b", "raises", "c"]
    ended = dict(run_jobs(work, names, parse()))
    failures = {names[k]: type(future.exception()) for k, future in ended.items()}
    nothing = type(None)
    assert failures == {
        **dict.fromkeys("abc", nothing),
        "dies": ProcessDiedError,
        "raises": ValueError,
    }


def test_when_time_is_up_what_is_done_was_yielded_and_the_rest_is_no_outcome(
    capsys: pytest.CaptureFixture[str],
) -> None:
    ended = dict(run_jobs(work, ["a", "long"], parse("--minutes", "0.01")))
    assert {number: future.result() for number, future in ended.items()} == {0: "a"}
    assert "TIME IS UP: 1 jobs not done" in capsys.readouterr().out


def test_a_script_without_its_scheduler_ends_with_one_clear_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    monkeypatch.setattr(workers, "find_spec", lambda name: None)
    monkeypatch.setattr("sys.argv", ["random_programs", "--count", "1", "--scheduler", "tcp://a:1"])
    with pytest.raises(SystemExit) as ended:
        run_as("benchmarks.random_programs")
    assert ended.value.code == BAD_INPUT
    told = "benchmarks.random_programs: scheduler tcp://a:1: got no module 'distributed', expected"
    assert capsys.readouterr().err.startswith(told)


@pytest.mark.slow
def test_benchmarks_that_measure_in_processes_of_their_own_get_answers() -> None:
    assert growth.start(50, turn=3).turn == 3
    run = wide_bands.start(wide_bands.ARROW, wide_bands.BOXES, 100, True)
    assert run.variables == 100
    assert run.iterations > 0
