"""`python -m benchmarks robustness`: what it prints, keeps, and refuses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from refusals import check_refused
from robustness_studies import make_result
from scenario_studies import Inline

from benchmarks.__main__ import main
from benchmarks.robustness import study as robustness
from benchmarks.robustness.page import format_robustness
from benchmarks.robustness.question import RobustnessQuestion
from benchmarks.robustness.study import RobustnessStudy
from drake_aigto import jobs
from drake_aigto.cli import BAD_INPUT, FINE


def test_the_command_prints_the_table_and_writes_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[RobustnessQuestion] = []

    def run(study: RobustnessStudy, *args: Any, **named: Any) -> Any:
        seen.append(study.question)
        return well(study, *args, **named)

    def open_inline(count: int, scheduler: None) -> Inline:
        assert count == 1
        return Inline()

    well = RobustnessStudy.run
    monkeypatch.setattr(RobustnessStudy, "run", run)
    monkeypatch.setattr(jobs, "open_workers", open_inline)
    monkeypatch.setattr(robustness, "run_task", lambda task, _: make_result(task.name))
    path = tmp_path / "results.json"
    flags = "--rows 1 --restitutions 1 0.5 --percent 2 --samples 3 --seed 4 --no-confirm"
    command = ["robustness", *flags.split(), "--workers", "1", "--json", str(path)]
    assert main(command) == FINE
    assert seen == [
        RobustnessQuestion(
            rows=(1,), restitutions=(1.0, 0.5), percent=2.0, samples=3, seed=4, confirm=False
        )
    ]
    study = RobustnessStudy.load(path)
    assert capsys.readouterr().out == f"{format_robustness(study)}\n"


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("--percent 0", "drake-aigto: percent: got 0.0, expected a number above 0."),
        ("--percent 60", "percent, for table1/1, e = 1: got 60, by which initial_position"),
        ("--json no/such/folder", "no/such/folder can't be written: got no folder no/such."),
    ],
)
def test_bad_input_is_one_clear_error(
    flags: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    check_refused(["robustness", *flags.split()], message, capsys, main)


def test_unknown_rows_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["robustness", "--rows", "5"])
    assert ended.value.code == BAD_INPUT
    assert "invalid choice: 5 (choose from" in capsys.readouterr().err
