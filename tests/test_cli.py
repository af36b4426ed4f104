"""The command line: exit status, what it prints, and one clear error for each bad input."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from drake_aigto.cli import BAD_INPUT, FINE, INTERRUPTED, NOTHING_HOLDS, main
from drake_aigto.planning import Plan, Planner

# A short flight away from the wall: quick to plan, and true on a rigid wall.
FLIGHT = [
    *("table1/1", "--initial-position", "1.2", "--initial-velocity", "0", "--goal-position", "1.3"),
    *("--epsilon", "1e-6", "--time-step", "0.01", "--quiet"),
]


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plans") / "plan.json"
    assert main(["plan", *FLIGHT, "--json", str(path)]) == FINE
    return path


def test_plan_writes_what_it_prints(plan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan = Plan.load(plan_file)
    assert plan.scenario.initial_position[0] == 1.2
    assert plan.holds
    assert main(["replay", str(plan_file)]) == FINE
    printed = capsys.readouterr().out
    assert f"cost {plan.cost:.3e}" in printed
    assert f"cost {plan.replay.event_driven.cost:.3e}" in printed
    assert "verdict     holds" in printed


def test_a_plan_that_fails_on_a_rigid_wall_exits_with_1(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["plan", "table1/2", "--no-nonpenetration", "--no-confirm", "--time-step", "0.02"]
    assert main([*arguments, "--transcription", "literal"]) == NOTHING_HOLDS
    printed = capsys.readouterr().out
    assert "verdict     fails: in simulation the control alone misses" in printed
    assert "Drake" not in printed


def test_replay_writes_its_own_verdict(plan_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "replayed.json"
    assert main(["replay", str(plan_file), "--json", str(out)]) == FINE
    again, first = Plan.load(out), Plan.load(plan_file)
    assert again.replay.event_driven == first.replay.event_driven


def test_play_writes_a_page(
    plan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "plan.html"
    assert main(["play", str(plan_file), "--html", str(page)]) == FINE
    assert "<html>" in page.read_text(encoding="utf-8")[:2000].lower()
    assert str(page) in capsys.readouterr().out


def test_table1_prints_every_method_with_its_replays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "table.json"
    arguments = ["table1", "--rows", "4", "--guesses", "1", "--quiet", "--json", str(out)]
    assert main(arguments) == FINE
    printed = capsys.readouterr().out
    assert max(map(len, printed.splitlines())) <= 100
    assert "AIGTO 3.67e-07" in printed
    for label in ("SNOPT, from zero", "IPOPT, from zero", ": median of 1", "AIGTO, annealing"):
        assert printed.count(label) == 2  # φ free, and φ ≥ 0
    cells = json.loads(out.read_text(encoding="utf-8"))["cells"]
    assert [cell["nonpenetration"] for cell in cells] == [False, True]
    for cell in cells:
        best = {m["name"]: m["entries"][-1]["candidate"]["cost"] for m in cell["methods"]}
        gradient = min(cost for name, cost in best.items() if not name.startswith("AIGTO"))
        aigto = min(best["AIGTO, Algorithm 1"], best["AIGTO, annealing"])
        assert aigto <= gradient * (1 + 1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["plan", "table1/9"], "unknown scenario 'table1/9': expected one of table1/1, table1/2"),
        (["plan", "nowhere.yaml"], "scenario file nowhere.yaml can't be read"),
        (["plan", "table1/1", "--initial-position", "-1"], "initial_position is inside, behind"),
        (
            ["plan", "table1/1", "--goal-position", "0"],
            "goal_position is inside, behind or against",
        ),
        (["plan", "table1/1", "--initial-position", "nan"], "initial_position: got nan, expected"),
        (["plan", "table1/1", "--initial-position", "1", "2"], "initial_position: got 2 values"),
        (["plan", "table1/1", "--duration", "0"], "duration: got 0"),
        (["plan", "table1/1", "--time-step", "-1"], "time_step: got -1"),
        (["plan", "table1/1", "--time-step", "0.3"], "expected a whole number of time steps"),
        (["plan", "table1/1", "--epsilon", "0"], "epsilon: got 0"),
        (["plan", "table1/1", "--delta", "-1"], "delta: got -1"),
        (["plan", "table1/1", "--restitution", "1.5"], "restitution: got 1.5"),
        (["plan", "table1/1", "--model", "nowhere.sdf"], "model nowhere.sdf: got no file"),
        (["plan", "table1/1", "--json", "no/folder/x.json"], "no/folder/x.json can't be written"),
        (["table1", "--json", "no/folder/x.json"], "no/folder/x.json can't be written"),
        (["replay", "nowhere.json"], "plan file nowhere.json can't be read"),
        (["play", "nowhere.json"], "plan file nowhere.json can't be read"),
    ],
)
def test_bad_input_is_one_line_and_status_2(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Before any work: planning would raise something else.
    monkeypatch.setattr(Planner, "plan", None)
    assert main(arguments) == BAD_INPUT
    captured = capsys.readouterr()
    assert captured.err.startswith("drake-aigto: ")
    assert message in captured.err
    assert captured.err.count("\n") == 1
    assert not captured.out


@pytest.mark.parametrize(
    "arguments", [[], ["sing"], ["plan"], ["plan", "table1/1", "--transcription", "x"]]
)
def test_bad_words_are_a_usage_error(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as error:
        main(arguments)
    assert error.value.code == BAD_INPUT
    assert "usage: drake-aigto" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["table1", "plan", "replay", "play"])
def test_every_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as error:
        main([command, "--help"])
    assert error.value.code == FINE
    assert f"usage: drake-aigto {command}" in capsys.readouterr().out


def test_ctrl_c_ends_quietly(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(*arguments: Any, **keywords: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Planner, "plan", interrupt)
    assert main(["plan", "table1/1"]) == INTERRUPTED
    assert "Traceback" not in capsys.readouterr().err
