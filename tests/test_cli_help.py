"""The command line's commands and flags: what --help says of them, and where they stand."""

from __future__ import annotations

import argparse
import dataclasses
import shlex
from collections.abc import Iterator
from typing import Any

import pytest

from drake_aigto import Scenario
from drake_aigto.cli import BAD_INPUT, FINE, load_scenario, main, make_parser


def commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yields a parser and those of all commands below it."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from commands(command)


COMMANDS = {command.prog: command for command in commands(make_parser())}


def test_the_commands_are_all_there() -> None:
    names = ("table1", "plan", "replay", "play", "report", "control")
    assert {f"drake-aigto {name}" for name in names} < COMMANDS.keys()


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
            make_parser().parse_args(words[1:])


@pytest.mark.parametrize("name", [[], ["--quiet"]])
def test_without_a_command_help_is_shown(
    name: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(name) == BAD_INPUT
    shown = capsys.readouterr()
    assert not shown.out
    assert shown.err.startswith("usage: drake-aigto") and "\nexamples:\n" in shown.err


def test_every_flag_of_a_command_says_what_it_is() -> None:
    for name, command in COMMANDS.items():
        for action in command._actions:
            assert action.help or isinstance(action, argparse._SubParsersAction), (name, action)


@pytest.mark.parametrize(
    "words",
    [
        ["-v", "table1"],
        ["table1", "--verbose"],
        ["-qv", "table1", "-q", "-v"],
    ],
)
def test_what_all_commands_take_stands_before_or_after_them(words: list[str]) -> None:
    unset = argparse.Namespace(quiet=False, verbose=False)
    options = make_parser().parse_args(words, unset)
    assert options.verbose
    assert options.quiet == any("q" in word for word in words)


def test_small_negative_numbers_are_no_flags() -> None:
    options = make_parser().parse_args(["plan", "table1/1", "--initial-velocity", "-1e-3", "-.5"])
    assert options.initial_velocity == [-1e-3, -0.5]


def test_every_field_of_a_scenario_has_a_flag_that_changes_it() -> None:
    given: dict[str, Any] = {
        "model": "other.sdf",
        "initial_position": [1.0, 2.0],
        "initial_velocity": [0.0, -3.0],
        "goal_position": [0.5, 0.0],
        "goal_velocity": [0.0, 1.0],
        "hard_goal": True,
        "angles": "modulo",
        "duration": 2.0,
        "time_step": 0.1,
        "duration_range": [1.0, 3.0],
        "control_weight": [0.1, 0.2],
        "goal_weight": [[2.0, -1.0], [-1.0, 2.0]],
        "goal_velocity_weight": [1.0, 0.0],
        "position_weight": [3.0, 4.0],
        "velocity_weight": 5.0,
        "reference_times": [0.0, 1.0],
        "reference_positions": [[0.0, 1.0], [1.0, 0.0]],
        "reference_velocities": [[1.0, 1.0], [2.0, 2.0]],
        "position_lower": [float("-inf"), -1.0],
        "position_upper": 9.0,
        "velocity_lower": -8.0,
        "velocity_upper": [8.0, float("inf")],
        "control_lower": [-7.0, -6.0],
        "control_upper": 7.0,
        "control_norm": 9.0,
        "contact": "compliant",
        "epsilon": 0.2,
        "delta": 0.3,
        "restitution": 1.0,
        "mass": 3.0,
        "friction": 0.0,
        "dry_friction": [0.5, 0.6],
        "stiction_speed": 0.02,
        "ignored_shapes": ["foot", "3"],
    }
    scenario = Scenario(**given)
    assert list(given) == [field.name for field in dataclasses.fields(Scenario)]
    words = ["plan", "table1/1"]
    for name, value in given.items():
        words += [f"--{name.replace('_', '-')}", *_as_words(value)]
    assert load_scenario(make_parser(words).parse_args(words)) == scenario


def _as_words(value: Any) -> list[str]:
    if value is True:
        return []
    items = value if isinstance(value, list) else [value]
    return [",".join(map(str, item)) if isinstance(item, list) else str(item) for item in items]
