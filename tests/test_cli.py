"""The command line: exit status, what it prints, and one clear error for each bad input."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from refusals import check_refused

from drake_aigto.cli import BAD_INPUT, FINE, NOTHING_HOLDS, UNREAD, main
from drake_aigto.paper import LiteralOptions
from drake_aigto.planning import (
    BALL_LADDER,
    Plan,
    Planner,
    PlanningError,
    PlanOptions,
    Replays,
    SearchOptions,
)
from drake_aigto.world import Scenario, find_model

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


def test_plan_writes_what_it_prints_and_replay_its_own_verdict(
    plan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = Plan.load(plan_file)
    assert plan.scenario.initial_position[0] == 1.2
    assert plan.holds
    out = tmp_path / "replayed.json"
    assert main(["replay", str(plan_file), "--json", str(out)]) == FINE
    assert Plan.load(out).replay.event_driven == plan.replay.event_driven
    printed = capsys.readouterr().out
    assert f"cost {plan.cost:.3e}" in printed
    assert f"cost {plan.replay.event_driven.cost:.3e}" in printed
    assert "verdict     holds" in printed


@pytest.mark.slow
def test_a_literal_plan_that_fails_on_a_rigid_wall_exits_with_1(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["plan", "table1/2", "--no-nonpenetration", "--no-confirm", "--time-step", "0.02"]
    assert main([*arguments, "--transcription", "literal"]) == NOTHING_HOLDS
    printed = capsys.readouterr().out
    assert printed.startswith("verdict     fails: ")
    assert " misses the plan's promise on a rigid wall\n" in printed
    assert max(map(len, printed.splitlines())) <= 100
    assert "literal transcription, ε = 0.1 J, δ = 0.001 m, " in printed
    assert "relaxation" not in printed
    assert "Drake" not in printed


def failing(plan: Plan) -> Plan:
    """Returns a plan whose simulation in Drake says otherwise."""
    assert plan.replay.drake is not None
    missed = dataclasses.replace(plan.replay.drake, cost=1.0)
    return dataclasses.replace(plan, replay=Replays(plan.replay.event_driven, missed))


def test_what_holds_nowhere_is_shown_and_written_and_exits_with_1(
    plan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    error = PlanningError("nothing holds", got="3 candidates from 3 rungs")
    error.plan = failing(Plan.load(plan_file))

    def fail(*arguments: Any, **keywords: Any) -> None:
        raise error

    monkeypatch.setattr(Planner, "plan", fail)
    out = tmp_path / "failed.json"
    assert main(["plan", *FLIGHT, "--json", str(out)]) == NOTHING_HOLDS
    printed = capsys.readouterr()
    assert printed.out.startswith("verdict     fails: ")
    assert " misses the plan's promise on Drake's plant\n" in printed.out
    assert printed.err == "drake-aigto: nothing holds: got 3 candidates from 3 rungs.\n"
    assert not Plan.load(out).holds

    error.plan = None
    assert main(["plan", *FLIGHT]) == NOTHING_HOLDS
    printed = capsys.readouterr()
    assert not printed.out
    assert printed.err == "drake-aigto: nothing holds: got 3 candidates from 3 rungs.\n"


def test_plan_options_are_flags(
    plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[SearchOptions] = []

    def remember(planner: Planner, **keywords: Any) -> Plan:
        seen.append(planner.options)
        return Plan.load(plan_file)

    def remember_literal(scenario: Scenario, options: LiteralOptions, **others: Any) -> Plan:
        seen.append(options)
        return Plan.load(plan_file)

    monkeypatch.setattr(Planner, "plan", remember)
    monkeypatch.setattr("drake_aigto.cli.plan.plan_literal", remember_literal)
    main(["plan", *FLIGHT])
    assert seen.pop() == PlanOptions(ladder=BALL_LADDER)
    both = ["--finalists", "3", "--threads", "2", "--local-solver", "snopt", "--no-confirm"]
    of_both: dict[str, Any] = {"finalists": 3, "threads": 2, "local_solver": "snopt"}
    rigid = ["--relaxation", "0.5", "--aigo-steps", "7", "--exhaustive"]
    main(["plan", *FLIGHT, *both, *rigid])
    assert seen.pop() == PlanOptions(
        ladder=BALL_LADDER, relaxation=0.5, aigo_steps=7, exhaustive=True, confirm=False, **of_both
    )
    literal = ["--algorithm", "full gradient", "--no-nonpenetration"]
    main(["plan", *FLIGHT, "--transcription", "literal", *both, *literal])
    assert seen.pop() == LiteralOptions(
        algorithm="full gradient", nonpenetration=False, confirm=False, **of_both
    )


def test_a_wall_without_stiffness_needs_no_drake(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shipped = find_model(Scenario.named("table1/1").model)
    text = re.sub(
        r"<drake:point_contact_stiffness>.*?</drake:point_contact_stiffness>",
        "",
        shipped.read_text(encoding="utf-8"),
    )
    model = tmp_path / "soft.sdf"
    model.write_text(text, encoding="utf-8")
    assert main(["plan", *FLIGHT, "--model", str(model), "--no-confirm"]) == FINE
    assert "verdict     holds" in capsys.readouterr().out


@pytest.mark.slow
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
    written = json.loads(out.read_text(encoding="utf-8"))
    cells = written["literal"]
    assert [cell["nonpenetration"] for cell in cells] == [False, True]
    for cell in cells:
        best = {m["name"]: m["entries"][-1]["candidate"]["cost"] for m in cell["methods"]}
        gradient = min(cost for name, cost in best.items() if not name.startswith("AIGTO"))
        aigto = min(best["AIGTO, Algorithm 1"], best["AIGTO, annealing"])
        assert aigto <= gradient * (1 + 1e-6)
    assert "rigid wall, e = 1; exact optimum 0, bounce at 0.500 s; Drake's wall 0.10 ms" in printed
    assert re.search(r"\n  AIGTO, rigid .* holds .*\n  above the optimum .*e-\d\d\n", printed)
    assert "Rigid transcription: 1 of 1 plans hold there." in printed
    (rigid,) = written["rigid"]
    assert rigid["optimum"]["cost"] == pytest.approx(0, abs=1e-12)
    assert rigid["optimum"]["bounce_times"] == pytest.approx([0.5])
    (entry,) = rigid["methods"][0]["entries"]
    assert entry["holds"]
    assert entry["candidate"]["replay"]["cost"] < 1e-6
    assert entry["drake"]["cost"] < 1e-5


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["plan", "table1/9"], "unknown scenario 'table1/9': expected one of acrobot/"),
        (["plan", "nowhere.yaml"], "scenario file nowhere.yaml can't be read"),
        (["plan", "table1/1", "--initial-position", "-1"], "initial_position is inside or behind"),
        (["plan", "table1/1", "--goal-position", "-0.1"], "goal_position is inside or behind"),
        (["plan", "table1/1", "--initial-position", "nan"], "initial_position: got nan, expected"),
        (["plan", "table1/1", "--initial-position", "1", "2"], "initial_position: got 2 values"),
        (["plan", "table1/1", "--time-step", "0.3"], "expected a whole number of time steps"),
        (["plan", "table1/1", "--relaxation", "-1"], "relaxation: got -1.0, expected a number, 0"),
        (["plan", "table1/1", "--aigo-steps", "0"], "aigo_steps: got 0, expected 1 or more"),
        (
            ["plan", "table1/1", "--algorithm", "annealing"],
            "--algorithm: got no --transcription literal, expected --transcription literal, whose",
        ),
        (
            ["plan", "table1/1", "--transcription", "rigid"],
            "--transcription: got rigid, expected literal. Leave it out: the world decides",
        ),
        (["plan", "table1/1", "--renewals", "9"], "renewals: got 9 for balls between rigid walls"),
        (
            ["plan", "table1/1", "--transcription", "literal", "--exhaustive"],
            "--exhaustive: got --transcription literal, expected another plan, whose",
        ),
        (["plan", "table1/1", "--model", "nowhere.sdf"], "model nowhere.sdf: got no file"),
        (["plan", "table1/1", "--initial-velocity", "-1e400"], "initial_velocity: got -inf"),
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
    check_refused(arguments, message, capsys)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sing"], "invalid choice: 'sing'"),
        (["plan"], "the following arguments are required: SCENARIO"),
        (["plan", "table1/1", "--aigo-steps", "1.5"], "--aigo-steps: invalid int value: '1.5'"),
        (
            ["plan", "table1/1", "--initial-position", "{ball: 1}"],
            "--initial-position: got '{ball: 1}', expected numbers; positions by name",
        ),
        (["plan", "table1/1", "--relaxation", "some"], "--relaxation: invalid float value: 'some'"),
        (["table1", "--guesses", "0"], "--guesses: got 0, expected 1 or more"),
        (["table1", "--rows", "5"], "--rows: invalid choice: 5"),
        (["table1", "--seed", "-1"], "--seed: got -1, expected 0 or more"),
        (["bench", "scenarios"], "bench has moved to python -m benchmarks, in a checkout of"),
    ],
)
def test_bad_words_are_one_line_and_say_where_help_is(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as error:
        main(arguments)
    assert error.value.code == BAD_INPUT
    told = capsys.readouterr().err
    assert message in told and told.count("\n") == 1
    command, _, remedy = told.partition(": ")
    assert remedy.endswith(f" Try {command} --help.\n")


def test_who_reads_only_the_head_sees_no_traceback() -> None:
    command = [sys.executable, "-m", "drake_aigto", "list"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == UNREAD
