"""The command line: parse, load, call, print."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drake_aigto.errors import AigtoError
from drake_aigto.planning import Plan, Planner, PlanningError, PlanOptions
from drake_aigto.planning.material import contact_delay
from drake_aigto.planning.options import CHOICES
from drake_aigto.show.plans import format_plan, format_replays
from drake_aigto.show.tables import format_table1
from drake_aigto.study import ROWS, run_table1
from drake_aigto.world import Scenario, World, scenario_names
from drake_aigto.world.files import check_writable, write_text

FINE, NOTHING_HOLDS, BAD_INPUT, INTERRUPTED, UNREAD = 0, 1, 2, 130, 141

_VECTORS = ("initial_position", "initial_velocity", "goal_position")
# Numeric plan option → its type, and what it is.
_NUMBERS: dict[str, tuple[Callable[[str], float], str]] = {
    "relaxation": (float, "rigid: how much walls push from afar while boxes shrink"),
    "aigo_steps": (int, "rigid: the most time steps that boxes have"),
    "finalists": (int, "how many of the best candidates are improved"),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit status.

    0: fine. 1: no plan was found that holds on rigid walls. 2: bad input. 130: interrupted.
    141: nobody read on.
    """
    options = _parser().parse_args(arguments)
    try:
        status: int = options.run(options)
        return status
    except PlanningError as error:
        print(f"drake-aigto: {error}", file=sys.stderr)
        return NOTHING_HOLDS
    except AigtoError as error:
        print(f"drake-aigto: {error}", file=sys.stderr)
        return BAD_INPUT
    except BrokenPipeError:
        # Who reads has seen enough, `head` for one. Python would flush once more as it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return UNREAD
    except KeyboardInterrupt:
        print("drake-aigto: interrupted", file=sys.stderr)
        return INTERRUPTED


def _table1(options: argparse.Namespace) -> int:
    check_writable(options.json)
    with _progress(options) as progress:
        table = run_table1(
            rows=options.rows,
            num_guesses=options.guesses,
            seed=options.seed,
            confirm=options.confirm,
            progress=progress,
        )
    if options.json:
        write_text(options.json, json.dumps(table.to_dict()) + "\n")
    print(format_table1(table), flush=True)
    return FINE


def _plan(options: argparse.Namespace) -> int:
    check_writable(options.json)
    scenario = _load_scenario(options)
    names = (*CHOICES, *_NUMBERS, "nonpenetration", "confirm")
    planner = Planner(scenario, PlanOptions(**{name: getattr(options, name) for name in names}))
    try:
        with _progress(options) as progress:
            plan = planner.plan(progress=progress)
    except PlanningError as error:
        if error.plan is not None:
            _answer_plan(options, error.plan, planner)
        raise
    return _answer_plan(options, plan, planner)


def _answer_plan(options: argparse.Namespace, plan: Plan, planner: Planner) -> int:
    delay = _delay(plan, planner)
    return _answer(options, plan, format_plan(plan, planner.world, planner.options, delay))


def _replay(options: argparse.Namespace) -> int:
    check_writable(options.json)
    plan = Plan.load(options.plan)
    planner = Planner(plan.scenario, PlanOptions(confirm=options.confirm))
    replayed = dataclasses.replace(plan, replay=planner.simulate(plan.trajectory))
    delay = _delay(replayed, planner)
    return _answer(options, replayed, format_replays(replayed, planner.world, delay))


def _play(options: argparse.Namespace) -> int:
    from pydrake.geometry import StartMeshcat

    from drake_aigto.show.playback import play, save_html

    check_writable(options.html)
    plan = Plan.load(options.plan)
    world = World.from_scenario(plan.scenario)
    meshcat = StartMeshcat()
    play(plan, meshcat, world)
    if options.html:
        save_html(meshcat, options.html)
        print(f"wrote {options.html}")
        return FINE
    print(f"Meshcat plays at {meshcat.web_url()}; press Enter to stop.")
    sys.stdin.readline()
    return FINE


def _load_scenario(options: argparse.Namespace) -> Scenario:
    """Returns the named or loaded scenario with the fields that flags change."""
    name = options.scenario
    is_file = Path(name).suffix in (".yaml", ".yml")
    scenario = Scenario.load(name) if is_file else Scenario.named(name)
    fields = [field.name for field in dataclasses.fields(Scenario)]
    changes = {f: getattr(options, f) for f in fields if getattr(options, f) is not None}
    return dataclasses.replace(scenario, **changes) if changes else scenario


def _answer(options: argparse.Namespace, plan: Plan, text: str) -> int:
    """Writes and prints a plan, and returns the exit status that its verdict asks for."""
    if options.json:
        plan.save(options.json)
    print(text, flush=True)
    return FINE if plan.holds else NOTHING_HOLDS


def _delay(plan: Plan, planner: Planner) -> float | None:
    """Returns by how much walls in Drake are late at most [s], if the plan was replayed there."""
    return None if plan.replay.drake is None else contact_delay(planner.world)


@contextmanager
def _progress(options: argparse.Namespace) -> Iterator[Callable[[str], None] | None]:
    """Yields what shows a line of progress on a terminal, each over the one before."""
    if options.quiet or not sys.stderr.isatty():
        yield None
        return

    def show(line: str) -> None:
        # A line that wraps could not be written over.
        shown = line[: shutil.get_terminal_size().columns - 1]
        print(f"\r\033[K{shown}", end="", file=sys.stderr, flush=True)

    try:
        yield show
    finally:
        show("")  # What is printed next begins on an empty line.


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="drake-aigto",
        description="Global trajectory optimization through contact, on Drake.",
        epilog="Exit status: 0 fine, 1 nothing found that holds on rigid walls, 2 bad input.",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_table1(commands)
    _add_plan(commands)
    replay = _add_command(commands, "replay", _replay, "simulate a plan's control again")
    replay.add_argument("plan", metavar="PLAN.json", help="a plan file")
    _add_confirm(replay)
    _add_json(replay, "write the plan with its new replays")
    play = _add_command(commands, "play", _play, "watch a plan and its simulations in Meshcat")
    play.add_argument("plan", metavar="PLAN.json", help="a plan file")
    play.add_argument("--html", metavar="FILE", help="write one self-contained page instead")
    return parser


def _add_table1(commands: Any) -> None:
    table1 = _add_command(
        commands, "table1", _table1, "the paper's Table I, and what each plan does on a rigid wall"
    )
    table1.add_argument(
        "--rows",
        type=int,
        nargs="+",
        choices=ROWS,
        default=ROWS,
        help="which rows (default: all)",
    )
    table1.add_argument(
        "--guesses",
        type=_positive,
        default=10,
        help="random guesses of the gradient solver (default: %(default)s)",
    )
    table1.add_argument("--seed", type=int, default=0, help="of the guesses (default: %(default)s)")
    _add_confirm(table1)
    _add_json(table1, "write all plans and figures")


def _add_plan(commands: Any) -> None:
    plan = _add_command(commands, "plan", _plan, "plan for a scenario")
    plan.add_argument(
        "scenario",
        metavar="SCENARIO",
        help=f"a YAML file, or one of {', '.join(scenario_names())}",
    )
    fields = plan.add_argument_group("change the scenario's fields")
    for field in dataclasses.fields(Scenario):
        flag = f"--{field.name.replace('_', '-')}"
        if field.name == "model":
            fields.add_argument(flag, metavar="URI")
        elif field.name in _VECTORS:
            fields.add_argument(flag, type=float, nargs="+", metavar="X")
        else:
            fields.add_argument(flag, type=float, metavar="X")
    numerics = plan.add_argument_group("numerics")
    defaults = PlanOptions()
    for name, choices in CHOICES.items():
        numerics.add_argument(
            f"--{name.replace('_', '-')}",
            choices=choices,
            default=getattr(defaults, name),
            help="(default: %(default)s)",
        )
    for name, (kind, text) in _NUMBERS.items():
        numerics.add_argument(
            f"--{name.replace('_', '-')}",
            type=kind,
            default=getattr(defaults, name),
            metavar="N" if kind is int else "X",
            help=f"{text} (default: %(default)s)",
        )
    numerics.add_argument(
        "--nonpenetration",
        action=argparse.BooleanOptionalAction,
        default=defaults.nonpenetration,
        help="literal: ask for φ(q) ≥ 0 at the knots (default: %(default)s)",
    )
    _add_confirm(plan)
    _add_json(plan, "write the plan, for `replay` and `play`")


def _add_command(commands: Any, name: str, run: Callable[..., int], text: str) -> Any:
    command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
    command.add_argument("--quiet", action="store_true", help="show no progress")
    command.set_defaults(run=run)
    return command


def _add_confirm(command: Any) -> None:
    command.add_argument(
        "--no-confirm",
        dest="confirm",
        action="store_false",
        help="leave out the replay on Drake's plant",
    )


def _add_json(command: Any, text: str) -> None:
    command.add_argument("--json", metavar="FILE", help=text)


def _positive(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"got {value}, expected 1 or more")
    return value
