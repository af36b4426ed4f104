"""How commands are parsed, what several of them take, and exit statuses.

Flags that set the fields of a dataclass, such as a scenario's, are made of the class.
"""

from __future__ import annotations

import argparse
import dataclasses
import difflib
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any, Literal, NoReturn, get_args, get_origin, get_type_hints

import yaml

from drake_aigto import world  # Loaded when first used: the first line waits for no Drake.
from drake_aigto.errors import OptionsError

# Exit statuses.
FINE, NOTHING_HOLDS, BAD_INPUT, INTERRUPTED, UNREAD = 0, 1, 2, 130, 141
# Titles of groups of flags that the usual help does not explain.
FIELDS, NUMERICS = "change the scenario's fields", "numerics"
UNKNOWN = "disturbances unknown to the controller"
RARE = (FIELDS, NUMERICS, UNKNOWN)
_HELP_WIDTH = 96
FAULT = 70  # EX_SOFTWARE in BSD's sysexits.h; an uncaught exception's 1 means NOTHING_HOLDS here.


class Parser(argparse.ArgumentParser):
    """Refuses what it does not understand in one line, and shows examples as they are written.

    Attributes:
        tells_all: whether its help explains flags of rare groups, too.
        commands: those that it has.
    """

    tells_all = False
    commands: Any = None

    def __init__(self, **settings: Any) -> None:
        """Takes what argparse does."""
        super().__init__(formatter_class=argparse.RawDescriptionHelpFormatter, **settings)
        self.add_argument("--help-all", action=_HelpAll, help="explain every flag")
        # As of Python 3.14: -1e-3, -3:0.5, and here -inf as well, are no flags.
        self._negative_number_matcher = re.compile(r"-(\.?\d|inf)")

    def error(self, message: str) -> NoReturn:
        """Exits with what was probably meant, what is wrong, and where help is."""
        known = [*self.flags(), *(self.commands.choices if self.commands else ())]
        words = re.findall(r"--[\w-]+|(?<=choice: ')[\w-]+", message)
        unknown = [word for word in words if word not in known]
        close = [name for word in unknown for name in difflib.get_close_matches(word, known, 1)]
        hint = f"Did you mean {' and '.join(close)}? " if close else ""
        names = " drake-aigto list has the shipped ones." if "SCENARIO" in message else ""
        self.exit(BAD_INPUT, f"{self.prog}: {hint}{message}.{names} Try {self.prog} --help.\n")

    def flags(self) -> Iterator[str]:
        """Yields all flags, those of commands included."""
        yield from self._option_string_actions
        for command in self.commands.choices.values() if self.commands else ():
            yield from command.flags()

    def format_help(self) -> str:
        """Returns the help, with flags of rare groups by their names only."""
        for group in self._action_groups if not self.tells_all else ():
            if group.title in RARE and group._group_actions:
                flags = (action.option_strings[0] for action in group._group_actions)
                group.description = f"{', '.join(flags)} (--help-all explains each)"
                lines = textwrap.wrap(group.description, _HELP_WIDTH, break_on_hyphens=False)
                group.description = "\n".join(lines)
                for action in group._group_actions:
                    action.help = argparse.SUPPRESS
                places = (str(action.metavar) for action in self._get_positional_actions())
                self.usage = " ".join([self.prog, "[flags]", *places])
        return super().format_help()

    def add_commands(self, metavar: str) -> Any:
        """Returns where commands are added; without one of them, the help is shown."""
        self.set_defaults(run=partial(_show_help, self))
        self.commands = self.add_subparsers(metavar=metavar)
        return self.commands


class _HelpAll(argparse.Action):
    """The help with every flag."""

    def __init__(self, option_strings: Sequence[str], dest: str, help: str) -> None:
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, help=help)

    def __call__(self, parser: Any, *_: Any) -> None:
        """Prints it, and exits."""
        parser.tells_all = True
        parser.print_help()
        parser.exit()


def _show_help(parser: Parser, _: argparse.Namespace) -> int:
    parser.print_help(sys.stderr)
    return BAD_INPUT


def add_command(
    commands: Any, name: str, run: Callable[..., int], text: str, examples: str, notes: str = ""
) -> Any:
    """Adds a command to those of a parser (`Parser.add_commands`), and returns its own.

    Its text is without capital and full stop; examples are command lines, as they are typed; notes
    are what else there is to know, in lines of at most 100 columns. `run` takes the parsed options
    and returns the exit status.
    """
    sentence = f"{text[0].upper()}{text[1:]}."
    epilog = "\n".join(filter(None, [format_examples(examples), notes]))
    command = commands.add_parser(name, help=text, description=sentence, epilog=epilog)
    add_common(command)
    command.set_defaults(run=run)
    return command


def format_examples(examples: str) -> str:
    """Returns command lines as help shows them."""
    return f"examples:\n{textwrap.indent(examples, '  ')}"


def add_common(parser: Any) -> None:
    """Adds what may be given before a command, or after it."""
    # A command's own default would undo what was given before it.
    look = {"action": "store_true", "default": argparse.SUPPRESS}
    parser.add_argument("-q", "--quiet", help="show no progress", **look)
    text = "log each step, and show where an error comes from"
    parser.add_argument("-v", "--verbose", help=text, **look)


def add_confirm(command: Any) -> None:
    """Adds --no-confirm."""
    text = "leave out the replay on Drake's plant"
    command.add_argument("--no-confirm", dest="confirm", action="store_false", help=text)


def add_scenario(command: Any) -> None:
    """Adds the scenario to a command, and flags that change its fields."""
    text = "a YAML file, or the name of a shipped one (drake-aigto list)"
    command.add_argument("scenario", metavar="SCENARIO", help=text)
    notes = "A row of a matrix or a table is 1,2,3."
    add_fields(command.add_argument_group(FIELDS, notes), world.Scenario)


def load_scenario(
    options: argparse.Namespace, scenario: world.Scenario | None = None
) -> world.Scenario:
    """Returns the named or loaded scenario, or one in its place, with what flags change."""
    changes = read_fields(options, world.Scenario)
    for name, value in changes.items():  # All and none are no names.
        if value in (["all"], ["none"]):
            changes[name] = value[0]
    return dataclasses.replace(scenario or read_scenario(options.scenario), **changes)


def is_file(name: str) -> bool:
    """Returns whether a scenario is named by its file, not as one that is shipped."""
    return Path(name).suffix in (".yaml", ".yml")


def read_scenario(name: str) -> world.Scenario:
    """Returns the scenario of a YAML file, or a shipped one."""
    if is_file(name):
        return world.Scenario.load(name)
    if Path(name).exists() and name not in world.scenario_names():
        expected = "that of a scenario (.yaml) or, to look at, of a model (.sdf, .urdf, .xml)"
        raise OptionsError("SCENARIO", got=f"the path {name}", expected=expected)
    return world.Scenario.named(name)


def add_fields(group: Any, kind: type[Any], *skipped: str, note: str = "") -> None:
    """Adds a flag for each field of a dataclass but those that are skipped.

    Its help is the first sentence of the field's description, after a note; its kind is that of its
    annotation. Flags that are left out are not in the options (`read_fields`).
    """
    about, hints = dict[str, str](), get_type_hints(kind)
    for each in kind.__mro__[:-1]:
        about |= _read_attributes(each)
    for field in dataclasses.fields(kind):
        if field.name not in skipped:
            text, look = about.get(field.name, ""), _look(hints[field.name])
            if isinstance(field.default, int | float | str) and kind is not world.Scenario:
                text = f"{text} (default: {field.default})"
            look |= {"help": f"{note}{text}", "default": argparse.SUPPRESS}
            group.add_argument(name_flag(field.name), **look)


def read_fields(options: argparse.Namespace, kind: type[Any]) -> dict[str, Any]:
    """Returns the fields of a dataclass that were given as flags."""
    given = vars(options)
    return {f.name: given[f.name] for f in dataclasses.fields(kind) if f.name in given}


def name_flag(name: str) -> str:
    """Returns the flag of a field."""
    return f"--{name.replace('_', '-')}"


def _read_attributes(kind: type[Any]) -> dict[str, str]:
    """Returns the first sentence about each attribute that a class's docstring describes."""
    _, _, section = inspect.cleandoc(kind.__dict__.get("__doc__") or "").partition("Attributes:\n")
    items = re.findall(r"^    (\w+): (.*(?:\n     +.*)*)", section.split("\n\n")[0], re.MULTILINE)
    texts = {name: " ".join(text.split()).replace("`", "") for name, text in items}
    first = {name: re.split(r"\.(?: |$)|; None", text)[0] for name, text in texts.items()}
    return {name: text.replace("%", "%%") for name, text in first.items()}


def _look(hint: Any) -> dict[str, Any]:
    """Returns how argparse reads a field of this type."""
    names = {getattr(each, "__name__", str(each)) for each in _parts(hint)}
    if get_origin(hint) is Literal:
        return {"choices": get_args(hint)}
    if hint is bool:
        return {"action": argparse.BooleanOptionalAction}
    if "Named" in names:
        return {"type": yaml.safe_load, "metavar": "{NAME: …}"}
    if "Thruster" in names:
        return {"type": yaml.safe_load, "metavar": "{body: …}", "nargs": "+"}
    if "str" in names:
        return {"metavar": "NAME", "nargs": "+"} if "tuple" in names else {"metavar": "URI"}
    if names & {"ndarray", "Any"}:
        return {"type": _read_row, "metavar": "X", "nargs": "+"}
    if "int" in names:
        return {"type": int, "metavar": "N"}
    pair: dict[str, Any] = {"nargs": 2} if "tuple" in names else {}
    return {"type": float, "metavar": "X", **pair}


def _parts(hint: Any) -> Iterator[Any]:
    """Yields all types that a type is made of."""
    yield get_origin(hint) or hint
    for each in get_args(hint):
        yield from _parts(each)


def _read_row(text: str) -> float | list[float]:
    """Returns a number, or the numbers between commas."""
    try:
        return [float(item) for item in text.split(",")] if "," in text else float(text)
    except ValueError as error:
        expected = "numbers; positions by name are for a scenario's file"
        raise argparse.ArgumentTypeError(f"got {text!r}, expected {expected}") from error


def add_json(command: Any, text: str) -> None:
    """Adds --json FILE; the text says what it has."""
    command.add_argument("--json", metavar="FILE", help=text)


def add_html(command: Any, is_required: bool = False) -> None:
    """Adds --html FILE."""
    text = "write one self-contained page"
    command.add_argument("--html", metavar="FILE", required=is_required, help=text)


def add_port(command: Any) -> None:
    """Adds --port N."""
    text = "where Meshcat listens (0: anywhere)"
    command.add_argument("--port", type=int, metavar="N", help=text)


def add_workers(command: Any, count: int | None = None) -> None:
    """Adds where jobs run: as many processes if nothing is said, or one per core for None."""
    where = command.add_mutually_exclusive_group()
    text = f"processes of this machine (default: {'one per core' if count is None else count})"
    where.add_argument("--workers", type=positive, metavar="N", default=count, help=text)
    text = (
        "of Dask: run on its workers, on any machines, which need the same version of drake_aigto "
        "and of Drake, and one thread each: dask worker ADDRESS --nthreads 1"
    )
    where.add_argument("--scheduler", metavar="ADDRESS", help=text)


def read_workers(options: argparse.Namespace) -> AbstractContextManager[Executor]:
    """Returns where jobs run, as the flags of `add_workers` ask; nothing starts yet."""
    from drake_aigto.jobs import open_workers  # Most commands need no processes.

    count = None if options.scheduler is not None else options.workers
    return open_workers(count, options.scheduler)


def positive(text: str) -> int:
    """Returns a whole number, 1 or more."""
    return _at_least(1, text)


def natural(text: str) -> int:
    """Returns a whole number, 0 or more."""
    return _at_least(0, text)


def seconds(text: str) -> float:
    """Returns a finite number above 0."""
    value = float(text)
    if not 0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"got {value:g}, expected seconds above zero")
    return value


def _at_least(least: int, text: str) -> int:
    if (value := int(text)) < least:
        raise argparse.ArgumentTypeError(f"got {value}, expected {least} or more")
    return value
