"""The command line's commands and flags: what --help says of them, and where they stand.

`drake-aigto play`: what it shows, and one clear error for each bad input. `drake-aigto report` and
`table1 --html`: one page, whole or not at all. `drake-aigto control`: what it writes and shows, and
one clear error for each bad input.
"""

from __future__ import annotations

import argparse
import dataclasses
import io
import json
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from marks import slow
from refusals import check_refused, refuse_work
from scenario_fields import ALL_FIELDS

from drake_aigto import Scenario
from drake_aigto.cli import BAD_INPUT, FINE, INTERRUPTED, load_scenario, main, make_parser
from drake_aigto.paper import Table1


def commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yields a parser and those of all commands below it."""
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


@pytest.mark.parametrize("port", ["-1", "80", "65536"])
def test_a_port_that_nobody_may_listen_at_is_told(
    port: str, plan_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["play", str(plan_file), "--port", port]) == BAD_INPUT
    assert f"Meshcat's port: got {port}, expected a free one" in capsys.readouterr().err


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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["table1/1", "--kick-time", "0.2"], "--kick-time: got no --kick"),
        (["table1/1", "--kick", "0.3"], "--kick: got no --kick-time above 0, expected --kick-time"),
        (["table1/1", "--kick", "0.3", "--kick-time", "0"], "--kick: got no --kick-time above 0"),
        (["table1/1", "--delay", "9"], "delay: got 9 s, expected less than the run's 1 s"),
        (["table1/1", "--noise-seed", "2"], "--noise-seed: got no --noise"),
        (["table1/1", "--filter"], "--filter: got no --noise"),
        (["table1/1", "--renewals", "4"], "renewals: got 4 for balls between rigid walls"),
        (["table1/1", "--port", "0"], "--port: got no --live"),
        (["table1/1", "--method", "tracking", "--search-every", "3"], "--search-every: got"),
        (["table1/1", "--kick", "1", "2", "--kick-time", "0.1"], "kick: got 2 numbers, expected 1"),
    ],
)
def test_what_can_not_be_done_is_refused_by_name(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.json"
    check_refused(["control", *words, "--json", str(log)], message, capsys)
    assert not log.exists()
