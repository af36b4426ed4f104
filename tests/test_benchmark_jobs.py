"""A job that fails takes no other with it, and one that time ends has not failed."""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path
from typing import Any

import pytest
from scenario_studies import Inline

from benchmarks import growth
from benchmarks.script import plan_all, read_flags, run_all, run_as, run_jobs
from drake_aigto import OptionsError, PlanOptions, Scenario, jobs
from drake_aigto.cli import BAD_INPUT
from drake_aigto.jobs import ProcessDiedError


def parse(*flags: str, **others: Any) -> argparse.Namespace:
    return read_flags("A script. More.", flags, **others)


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


def test_flags_are_of_the_types_of_their_defaults() -> None:
    flags: dict[str, Any] = {
        "count": (3, ""),
        "only": ("", ""),
        "sizes": ((1, 2), ""),
        "masses": ([1.0], "", {"nargs": "+"}),
        "is_short": (False, ""),
    }
    usual = parse(**flags)
    assert (usual.count, usual.sizes, usual.masses, usual.is_short) == (3, (1, 2), [1.0], False)
    words = ("--count", "5", "--sizes", "7", "--masses", "2", "3", "--is-short", "--workers", "2")
    asked = parse(*words, **flags)
    assert (asked.count, asked.sizes, asked.masses, asked.is_short) == (5, [7], [2.0, 3.0], True)
    assert asked.workers == 2 and asked.minutes == math.inf


def test_what_is_kept_is_gone_on_from_and_only_with_the_same_flags(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []

    def note(job: str) -> str:
        done.append(job)
        return work(job)

    keep = ("--keep", str(tmp_path / "jobs"))
    assert run_all(note, ["a", "raises"], parse(*keep)) == ["a"]
    with (tmp_path / "jobs").open("ab") as file:
        file.write(b"\x80\x04cut sho")
    assert run_all(note, ["b", "raises", "a"], parse(*keep, "--workers", "2")) == ["b", "a"]
    assert done == ["a", "raises", "b", "raises"]
    with pytest.raises(OptionsError, match="--keep"):
        run_all(note, ["c"], parse(*keep, seed=(1, "")))


def test_plans_of_a_script_are_those_of_plan_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drake_aigto.jobs.many.open_workers", Some)
    scenario = dataclasses.replace(Scenario.named("table1/3"), time_step=0.05)
    options, keep = PlanOptions(confirm=False, threads=1), str(tmp_path / "jobs")
    found = plan_all({"a": scenario}, options, parse("--keep", keep))
    assert found["a"].plan is not None and found["a"].holds
    assert plan_all({"a": scenario}, options, parse("--keep", keep)) == found


def test_a_script_without_its_scheduler_ends_with_one_clear_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    monkeypatch.setattr("drake_aigto.jobs.workers.find_spec", lambda name: None)
    monkeypatch.setattr("sys.argv", ["random_programs", "--count", "1", "--scheduler", "tcp://a:1"])
    with pytest.raises(SystemExit) as ended:
        run_as("benchmarks.random_programs")
    assert ended.value.code == BAD_INPUT
    told = "benchmarks.random_programs: scheduler tcp://a:1: got no module 'distributed', expected"
    assert capsys.readouterr().err.startswith(told)


@pytest.mark.slow
def test_a_benchmark_that_measures_in_a_process_of_its_own_gets_an_answer() -> None:
    assert growth.start(50, turn=3).turn == 3
