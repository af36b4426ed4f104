"""A job that fails takes no other with it, and one that time ends has not failed."""

from __future__ import annotations

import importlib.util
import os
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest

FILE = Path(__file__).parents[1] / "benchmarks" / "jobs.py"


@pytest.fixture(name="jobs")
def load_jobs() -> Any:
    spec = importlib.util.spec_from_file_location("jobs", FILE)
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def work(job: str) -> str:
    if job == "dies":
        os._exit(3)
    if job == "raises":
        raise ValueError(job)
    if job == "sleeps":
        time.sleep(600.0)
    return job


def test_a_job_that_dies_or_raises_is_named_and_the_others_end(jobs: Any) -> None:
    names = ["a", "dies", "b", "raises", "c"]
    ended = dict(jobs.run_jobs(work, names, workers=2))
    failures = {names[k]: type(future.exception()) for k, future in ended.items()}
    nothing = type(None)
    assert failures == {
        **dict.fromkeys("abc", nothing),
        "dies": BrokenProcessPool,
        "raises": ValueError,
    }


def test_when_time_is_up_what_is_done_was_yielded_and_what_was_ended_is_no_outcome(
    jobs: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = dict(jobs.run_jobs(work, ["a", "sleeps", "b"], workers=1, minutes=4.0 / 60.0))
    assert {number: future.result() for number, future in ended.items()} == {0: "a"}
    assert "1 jobs not begun, 1 ended" in capsys.readouterr().out
