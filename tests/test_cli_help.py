"""The command line's commands and flags: what --help says of them, and where they stand."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterator

import pytest

from drake_aigto.cli import BAD_INPUT, FINE, main
from drake_aigto.cli.command_line import make_parser


def commands(parser: argparse.ArgumentParser) -> Iterator[argparse.ArgumentParser]:
    """Yields a parser and those of all commands below it."""
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                yield from commands(command)


COMMANDS = {command.prog: command for command in commands(make_parser())}


def test_the_commands_are_all_there() -> None:
    names = ("table1", "plan", "replay", "play", "report", "bench", "bench scenarios")
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


@pytest.mark.parametrize("name", [[], ["bench"], ["--quiet"]])
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
        ["-v", "bench", "scenarios"],
        ["bench", "-v", "scenarios"],
        ["bench", "scenarios", "--verbose"],
        ["-qv", "bench", "-q", "scenarios", "-v"],
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
