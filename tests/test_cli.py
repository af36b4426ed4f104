"""The command line: exit status, what it prints, and one clear error for each bad input."""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from marks import slow
from refusals import check_refused, refuse_work
from scenario_fields import ALL_FIELDS

from drake_aigto import Scenario
from drake_aigto.cli import (
    BAD_INPUT,
    FINE,
    INTERRUPTED,
    NOTHING_HOLDS,
    UNREAD,
    load_scenario,
    main,
    make_parser,
)
from drake_aigto.paper import LiteralOptions, Table1
from drake_aigto.planning import (
    BALL_LADDER,
    Plan,
    Planner,
    PlanningError,
    PlanOptions,
    Replays,
    SearchOptions,
)
from drake_aigto.world import find_model

# A short flight away from the wall: quick to plan, and true on a rigid wall.
FLIGHT = [
    *("table1/1", "--initial-position", "1.2", "--initial-velocity", "0", "--goal-position", "1.3"),
    *("--epsilon", "1e-6", "--time-step", "0.01", "--quiet"),
]


def test_plan_writes_what_it_prints_and_replay_its_own_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, out = tmp_path / "plan.json", tmp_path / "replayed.json"
    assert main(["plan", *FLIGHT, "--json", str(path)]) == FINE
    plan, planned = Plan.load(path), capsys.readouterr().out
    assert plan.scenario.initial_position[0] == 1.2
    assert plan.holds
    assert main(["replay", str(path), "--json", str(out)]) == FINE
    assert Plan.load(out).replay.event_driven == plan.replay.event_driven
    for printed in (planned, capsys.readouterr().out):
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


CONTROL = ("control", "table1/1", "--json", "run.json")


def failing(plan: Plan) -> Plan:
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
        (["plan", "table1/9"], "unknown scenario 'table1/9': expected one of a1/"),
        (["plan", "table1/11"], "Did you mean 'table1/1'? unknown scenario 'table1/11'"),
        (["plan", "nowhere.yaml"], "scenario file nowhere.yaml can't be read"),
        (["look", "PLAN"], "expected that of a scenario (.yaml) or, to look at, of a model (.sdf,"),
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
        (["play", "PLAN", "--port", "-1"], "Meshcat's port: got -1, expected a free one"),
        (["play", "PLAN", "--port", "80"], "Meshcat's port: got 80, expected a free one"),
        (["play", "PLAN", "--port", "65536"], "Meshcat's port: got 65536, expected a free one"),
        ([*CONTROL, "--kick-time", "0.2"], "--kick-time: got no --kick"),
        ([*CONTROL, "--kick", "0.3"], "--kick: got no --kick-time above 0, expected --kick-time"),
        ([*CONTROL, "--kick", "0.3", "--kick-time", "0"], "--kick: got no --kick-time above 0"),
        ([*CONTROL, "--delay", "9"], "delay: got 9 s, expected less than the run's 1 s"),
        ([*CONTROL, "--noise-seed", "2"], "--noise-seed: got no --noise"),
        ([*CONTROL, "--filter"], "--filter: got no --noise"),
        ([*CONTROL, "--renewals", "4"], "renewals: got 4 for balls between rigid walls"),
        ([*CONTROL, "--port", "0"], "--port: got no --live"),
        ([*CONTROL, "--method", "tracking", "--search-every", "3"], "--search-every: got"),
        ([*CONTROL, "--kick", "1", "2", "--kick-time", "0.1"], "kick: got 2 numbers, expected 1"),
        (["plan-many", "table1/1", "table1/1"], "SCENARIO table1/1: got the same name twice, exp"),
        (["plan-many", "table1/1", "nowhere"], "unknown scenario 'nowhere'"),
        (["plan-many", "no.yaml"], "no.yaml"),
        (["plan-many", "table1/1", "--resume"], "--resume: got no folder, expected --into FOLDER"),
    ],
)
def test_bad_input_is_one_line_and_status_2_and_writes_nothing(
    arguments: list[str],
    message: str,
    plan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Before any work: planning would raise something else.
    monkeypatch.setattr(Planner, "plan", None)
    monkeypatch.chdir(tmp_path)
    check_refused(
        [str(plan_file) if each == "PLAN" else each for each in arguments], message, capsys
    )
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["sing"], "invalid choice: 'sing'"),
        (["plan"], "required: SCENARIO. drake-aigto list has the shipped ones."),
        (["plan", "table1/1", "--html"], "argument --html: expected one argument."),
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


@pytest.mark.parametrize("words", [["list"], ["list", "a1"]])
def test_who_reads_only_the_head_sees_no_traceback(words: list[str]) -> None:
    command = [sys.executable, "-m", "drake_aigto", *words]
    buffered = {**os.environ, "PYTHONUNBUFFERED": ""}  # As it is for users.
    pipes: Any = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen(command, **pipes, env=buffered) as process:
        assert process.stdout is not None and process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == UNREAD


def commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from commands(command)


PARSER = make_parser()
COMMANDS = {command.prog: command for command in commands(PARSER)}


@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_and_its_examples_are_understood(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    with pytest.raises(SystemExit) as ended:
        main([*name.split()[1:], "--help"])
    assert ended.value.code == FINE
    shown = capsys.readouterr().out
    assert shown.startswith(f"usage: {name} ")
    assert max(map(len, shown.splitlines())) <= 100
    examples = shown.split("\nexamples:\n")[1].split("\n\n")[0].replace("\\\n", " ")
    assert examples.strip()
    for example in examples.strip().splitlines():
        words = shlex.split(example.split(">")[0], comments=True)
        assert words[0] == "drake-aigto"
        if "--help" not in words:
            PARSER.parse_args(words[1:])


def test_without_a_command_help_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--quiet"]) == BAD_INPUT
    shown = capsys.readouterr()
    assert not shown.out
    assert shown.err.startswith("usage: drake-aigto") and "\nexamples:\n" in shown.err


def test_every_flag_says_what_it_is_and_small_negative_numbers_are_none() -> None:
    for name, command in COMMANDS.items():
        for action in command._actions:
            assert action.help or isinstance(action, argparse._SubParsersAction), (name, action)
    options = PARSER.parse_args(["plan", "table1/1", "--initial-velocity", "-1e-3", "-.5"])
    assert options.initial_velocity == [-1e-3, -0.5]


@pytest.mark.parametrize(
    "words", [["-v", "table1"], ["table1", "--verbose"], ["-qv", "table1", "-q", "-v"]]
)
def test_what_all_commands_take_stands_before_or_after_them(words: list[str]) -> None:
    unset = argparse.Namespace(quiet=False, verbose=False)
    options = PARSER.parse_args(words, unset)
    assert options.verbose
    assert options.quiet == any("q" in word for word in words)


def test_every_field_of_a_scenario_has_a_flag_that_changes_it() -> None:
    scenario = Scenario(**ALL_FIELDS)
    fields = [field.name for field in dataclasses.fields(Scenario)]
    assert list(ALL_FIELDS) == [name for name in fields if name != "periodic"]
    words = ["plan", "table1/1"]
    for name, value in ALL_FIELDS.items():
        words += [f"--{name.replace('_', '-')}", *_as_words(value)]
    assert load_scenario(make_parser(words).parse_args(words)) == scenario


def test_a_flag_changes_how_far_a_motion_that_repeats_advances() -> None:
    words = ["plan", "hopper/gait", "--periodic", "{along: 0.3}"]
    change: dict[str, Any] = {"periodic": {"along": 0.3}}
    scenario = dataclasses.replace(Scenario.named("hopper/gait"), **change)
    assert load_scenario(make_parser(words).parse_args(words)) == scenario


def _as_words(value: Any) -> list[str]:
    if value is True:
        return []
    items = value if isinstance(value, list) else [value]
    return [",".join(map(str, item)) if isinstance(item, list) else str(item) for item in items]


@pytest.mark.parametrize("flags", [[], ["--beside", "gradient"], *slow(["--optimization"])])
def test_play_writes_a_page(
    flags: list[str], plan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "plan.html"
    assert main(["play", str(plan_file), *flags, "--html", str(page)]) == FINE
    assert "<html" in page.read_text(encoding="utf-8")[:2000].lower()
    assert capsys.readouterr().out == f"wrote {page}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["plan.html"]


def test_play_waits_at_a_port(
    plan_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
    assert main(["play", str(plan_file), "--port", "0"]) == FINE
    assert capsys.readouterr().out.startswith("solid: plan (not a simulation); ghosts: ")


@pytest.mark.parametrize("command", ["play", "report"])
def test_a_plan_that_can_not_be_read_leaves_no_page(
    command: str, plan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.json"
    bad.write_text(plan_file.read_text(encoding="utf-8")[:500], encoding="utf-8")
    page = tmp_path / "out" / "page.html"
    page.parent.mkdir()
    check_refused([command, str(bad), "--html", str(page)], "is cut short or no JSON", capsys)
    assert not list(page.parent.iterdir())


@pytest.mark.slow
def test_report_writes_a_page_without_a_display(
    plan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setenv("MPLBACKEND", "TkAgg")
    page = tmp_path / "report.html"
    assert main(["report", str(plan_file), "--html", str(page)]) == FINE
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    printed = capsys.readouterr().out
    assert printed.startswith(f"wrote {page}, 1.") and printed.endswith(" MB\n")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    ("arguments", "begins"),
    [
        (["play", "PLAN"], "drake_aigto.planning.Plan.load"),
        (["report", "PLAN"], "drake_aigto.planning.Plan.load"),
        (["table1"], "drake_aigto.cli.plan.run_table1"),
    ],
)
def test_a_page_that_could_not_be_written_is_refused_before_any_work(
    arguments: list[str],
    begins: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(begins, refuse_work)
    page = tmp_path / "no" / "page.html"
    message = "can't be written: got no folder"
    check_refused([*arguments, "--html", str(page)], message, capsys)


@pytest.mark.parametrize(("rows", "status"), [((), FINE), ((4,), INTERRUPTED)])
def test_table1_writes_a_page_and_tells_an_interruption(
    rows: tuple[int, ...],
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = Table1((), (), rows)  # Of row 4, nothing is done.
    monkeypatch.setattr("drake_aigto.cli.plan.run_table1", lambda **keywords: table)
    monkeypatch.setattr("drake_aigto.show.report_table1", lambda got: f"page {got}")
    page = tmp_path / "table1.html"
    assert main(["table1", "--html", str(page)]) == status
    assert page.read_text(encoding="utf-8") == f"page {table}"
    assert ("Interrupted: 3 of 3 cells" in capsys.readouterr().out) == (status == INTERRUPTED)


@pytest.mark.slow
def test_control_writes_a_log_and_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, page = tmp_path / "run.json", tmp_path / "run.html"
    words = ["control", "table1/1", "--method=tracking", "--period=0.01", "--mass-factor=1.1"]
    assert main([*words, "--json", str(log), "--html", str(page)]) == FINE
    told = capsys.readouterr().out
    assert told.startswith("goal        reached") and "masses times 1.1" in told
    data = json.loads(log.read_text(encoding="utf-8"))
    assert data["format"] == "drake_aigto closed loop" and data["method"] == "tracking"
    html = page.read_text(encoding="utf-8")
    assert "The motion is a simulation" in html and "data:image/svg+xml" in html
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.html", "run.json"]
    assert main(["report", str(log), "--html", str(again := tmp_path / "again.html")]) == FINE
    assert "masses times 1.1" in again.read_text(encoding="utf-8")
    capsys.readouterr()
    check_refused(["play", str(log), "--optimization"], "--optimization: got the log", capsys)


def test_control_plans_again_where_it_can_and_shows_it_live(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
    words = ["cart_pole/soft_06", "--seconds", "0.1", "--renewals", "0", "--live", "--port", "0"]
    assert main(["control", *words]) == FINE
    told = capsys.readouterr().out
    assert told.startswith("Meshcat shows it at http://localhost:")
    assert "ModelPredictiveController" in told and "press" in told


@pytest.mark.slow
def test_control_says_that_it_was_interrupted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def press(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("drake_aigto.control.LoopRecorder.kick", press)
    words = ["control", "table1/1", "--method", "tracking", "--kick", "0.1", "--kick-time", "0.2"]
    assert main(words) == INTERRUPTED
    assert "Ctrl-C ended the simulation" in capsys.readouterr().out
