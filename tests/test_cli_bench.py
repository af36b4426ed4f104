"""`python -m benchmarks scenarios`: what it prints, keeps, and refuses.

`python -m benchmarks robustness`: what it prints, keeps, and refuses.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from refusals import check_refused
from scenario_studies import TOYS, Inline, make_result

from benchmarks import __main__ as command
from benchmarks.__main__ import main
from benchmarks.baselines import registry
from benchmarks.robustness import study as robustness
from benchmarks.robustness.page import format_robustness
from benchmarks.robustness.question import RobustnessQuestion
from benchmarks.robustness.study import RobustnessStudy
from benchmarks.study import scenario_question
from benchmarks.study.scenario_question import Spread
from benchmarks.study.scenario_study import ScenarioStudy
from drake_aigto import jobs
from drake_aigto.cli import BAD_INPUT, FINE, INTERRUPTED, NOTHING_HOLDS
from drake_aigto.errors import PlanFileError
from drake_aigto.planning import Planner
from drake_aigto.show import WIDTH

SCENARIOS = ["scenarios", "--quiet", "--steps", "20"]
COASTING = ["--start", "1", "--velocity", "0.2", "--goal", "1.2", "0.5", "--count", "4"]
TOY_METHODS = ["--methods", "coast", "crash", "--seconds-per-unit", "0.5"]


@pytest.fixture(autouse=True)
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "BASELINES", TOYS)
    monkeypatch.setattr(jobs, "open_workers", Inline)
    scenario_question._warm_up.cache_clear()


def test_every_methods_success_is_printed_for_each_restitution(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = [*SCENARIOS, *COASTING, *TOY_METHODS, "--restitution", "1", "0.5"]
    assert main(arguments) == FINE
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= WIDTH
    assert "e = 1: 2 scenarios" in printed
    assert "e = 0.5: 2 scenarios" in printed
    rows = [line.split() for line in printed.splitlines()]
    # Restitutions and goals in all combinations: half of each coast to their goals.
    assert [row[1:4] for row in rows if row[:1] == ["coast"]] == [["50.0", "%", "50.0"]] * 2
    assert [row[7:9] for row in rows if row[:2] == ["crash", "0.0"]] == [["none", "none"]] * 2
    assert "crash failed: ZeroDivisionError: no way at all\n" in printed
    assert "× is one unit of time: 0.5 s\n" in printed


def test_a_plan_that_misses_is_named_and_fails_what_was_required(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(planner: Planner) -> None:
        raise PlanFileError("no plan today")

    arguments = [*SCENARIOS, *COASTING, "--count", "2", "--restitution", "0.8"]
    monkeypatch.setattr(Planner, "plan", fail)
    assert main(arguments) == FINE
    assert main([*arguments, "--require", "0.5"]) == NOTHING_HOLDS
    printed = capsys.readouterr().out
    missed = "aigto missed scenario 1: q(0) = 1 m, v(0) = 0.2 m/s, goal 0.5 m, e = 0.8; cost / J* "
    assert f"{missed}none\n" in printed
    assert "aigto failed: PlanFileError: no plan today.\n" in printed


def test_what_boxes_say_is_printed_if_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [*SCENARIOS, *COASTING, "--count", "1", "--read-boxes", "--require", "1"]
    assert main(arguments) == FINE
    printed = capsys.readouterr().out
    assert "have the optimum's number of contacts in 1 of 1:\nby rung " in printed


def test_results_are_kept_and_gone_on_from(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "study.json"
    arguments = [*SCENARIOS, *COASTING, *TOY_METHODS, "--json", str(path)]
    assert main(arguments) == FINE
    first = capsys.readouterr().out
    assert main(arguments) == BAD_INPUT
    assert "study.json: got one that exists. Go on from it (--resume)" in capsys.readouterr().err
    assert main([*arguments, "--resume"]) == FINE
    assert capsys.readouterr().out == first


def test_ctrl_c_says_how_to_go_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(scenario_question, "run_job", interrupt)
    path = tmp_path / "study.json"
    told = f"drake-aigto: --resume goes on from {path}\nbenchmarks: interrupted\n"
    assert main([*SCENARIOS, *COASTING, *TOY_METHODS, "--json", str(path)]) == INTERRUPTED
    assert capsys.readouterr().err == told


def test_spreads_are_read_as_help_says(tmp_path: Path) -> None:
    path = tmp_path / "study.json"
    spreads = ["--velocity", "-3:0", "--mass", "0.5:2", "--restitution", "1", "0.8", "--goal", "1"]
    assert main([*SCENARIOS, *TOY_METHODS, *spreads, "--count", "2", "--json", str(path)]) == FINE
    question = ScenarioStudy.load(path).question
    assert question.velocity == Spread((-3.0, 0.0), is_range=True)
    assert question.mass == Spread((0.5, 2.0), is_range=True)
    assert question.restitution == Spread((1.0, 0.8))
    assert question.goal == Spread((1.0,))
    assert main([*SCENARIOS, *TOY_METHODS, "--velocity", "-1", "-0.5", "--count", "1"]) == FINE


def test_all_stands_for_every_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "BASELINES", {"coast": TOYS["coast"]})
    path = tmp_path / "study.json"
    assert main([*SCENARIOS, "--methods", "all", "--count", "1", "--json", str(path)]) == FINE
    assert ScenarioStudy.load(path).question.methods == ("aigto", "coast")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("scenarios --count 0", "count: got 0, expected a whole number, 1 or more"),
        ("scenarios --velocity -3:x", "--velocity: got -3:x, expected a number, several (1 0.8"),
        ("scenarios --velocity 0:-3", "--velocity: got 0.0:-3.0, expected low:high"),
        ("scenarios --methods aigto cost", "unknown baseline 'cost': expected aigto, the planner,"),
        ("scenarios --json no/folder/x.json", "no/folder/x.json can't be written"),
        ("robustness --percent 0", "drake-aigto: percent: got 0.0, expected a number above 0."),
        ("robustness --percent 60", "percent, for table1/1, e = 1: got 60, by which initial_pos"),
        ("robustness --json no/such/f", "no/such/f can't be written: got no folder no/such."),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    words: str,
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(scenario_question, "run_job", None)  # Before any work.
    check_refused(words.split(), message, capsys, main)


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


def test_unknown_rows_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["robustness", "--rows", "5"])
    assert ended.value.code == BAD_INPUT
    assert "invalid choice: 5 (choose from" in capsys.readouterr().err
