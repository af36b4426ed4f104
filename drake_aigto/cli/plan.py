"""``drake-aigto plan`` and ``drake-aigto replay``."""

from __future__ import annotations

import argparse
from dataclasses import fields
from typing import Any, get_args

from drake_aigto.cli.flags import add_command, add_confirm, add_json
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.scenario_flags import add_scenario, load_scenario
from drake_aigto.cli.status import FINE, INTERRUPTED, NOTHING_HOLDS
from drake_aigto.errors import OptionsError
from drake_aigto.paper import LiteralOptions, plan_literal
from drake_aigto.paper.options import AlgorithmName
from drake_aigto.planning import (
    MechanismOptions,
    Plan,
    Planner,
    PlanningError,
    PlanOptions,
    needs_shooting,
)
from drake_aigto.planning.options import LocalSolverName
from drake_aigto.show.plans import format_plan, format_replays, told_delay
from drake_aigto.world import World
from drake_aigto.world.files import check_writable

# Option → what it is, of rigid plans, of literal ones, or of both.
_NUMERICS = {
    "local_solver": "what polishes AIGO's results",
    "finalists": "how many of the best candidates are improved",
    "threads": "how many starts of AIGO run at once (default: more than one where it pays)",
    "relaxation": "rigid: how much walls push from afar while boxes shrink",
    "aigo_steps": "rigid: the most time steps that boxes have",
    "certify": "rigid, shooting: say how far at most the plan is above any other",
    "exhaustive": "rigid: also run starts, and polish flights, that can hardly win",
    "renewals": "shooting: how many times at most motions are opened to boxes again, or begun anew",
    "patience": "shooting: after how many of these that find nothing better the search ends",
    "search_steps": "shooting: the most time steps that motions are searched with",
    "seed": "shooting: of what is drawn",
    "nonpenetration": "literal: ask for φ(q) ≥ 0 at the knots",
    "algorithm": "literal: how boxes shrink",
}
_CHOICES = {"local_solver": get_args(LocalSolverName), "algorithm": get_args(AlgorithmName)}
_OPTIONS = {"rigid": PlanOptions, "shooting": MechanismOptions, "literal": LiteralOptions}

_PLAN_EXAMPLES = """\
drake-aigto plan table1/1 --json plan.json
drake-aigto plan table1/1 --initial-velocity -3 --restitution 0.8   # another question
drake-aigto plan room/bank_shot -v                                  # step by step
drake-aigto plan my_scenario.yaml --no-confirm
drake-aigto plan table1/1 --transcription literal                   # as the paper has it
"""
_REPLAY_EXAMPLES = """\
drake-aigto replay plan.json
drake-aigto replay plan.json --no-confirm   # without Drake's plant
"""


def add_plan(commands: Any) -> None:
    """Adds the command that plans."""
    plan = add_command(commands, "plan", _plan, "plan for a scenario", _PLAN_EXAMPLES)
    add_scenario(plan)
    _add_numerics(plan.add_argument_group("numerics"))
    add_confirm(plan)
    add_json(plan, "write the plan, for `replay` and `play`")


def add_replay(commands: Any) -> None:
    """Adds the command that simulates a plan again."""
    text = "simulate a plan's control again"
    replay = add_command(commands, "replay", _replay, text, _REPLAY_EXAMPLES)
    replay.add_argument("plan", metavar="PLAN.json", help="a plan file")
    add_confirm(replay)
    add_json(replay, "write the plan with its new replays")


def _add_numerics(group: Any) -> None:
    text = (
        "rigid: for balls between rigid walls, and their default; shooting: for any other task, "
        "and its default; literal: the paper's"
    )
    group.add_argument("--transcription", choices=_OPTIONS, help=text)
    kinds = LiteralOptions(), MechanismOptions(), PlanOptions()
    defaults = {name: value for each in kinds for name, value in vars(each).items()}
    for name, text in _NUMERICS.items():
        flag, default = f"--{name.replace('_', '-')}", defaults[name]
        known = "" if default is None else f" (default: {default})"
        # Left out, it is not given, so that what is given to the other transcription is refused.
        more: dict[str, Any] = {"default": argparse.SUPPRESS, "help": text + known}
        if isinstance(default, bool):
            more["action"] = argparse.BooleanOptionalAction
        elif name in _CHOICES:
            more["choices"] = _CHOICES[name]
        else:
            kind = float if isinstance(default, float) else int
            more |= {"type": kind, "metavar": "X" if kind is float else "N"}
        group.add_argument(flag, **more)


def _read_options(
    options: argparse.Namespace, name: str
) -> PlanOptions | MechanismOptions | LiteralOptions:
    """Returns the numerics that were given, for a transcription.

    Raises:
        OptionsError: some are of another transcription.
    """
    known = {each: {field.name for field in fields(kind)} for each, kind in _OPTIONS.items()}
    given = {name: value for name, value in vars(options).items() if name in _NUMERICS}
    for option in given:
        if option not in known[name]:
            takers = (other for other, names in known.items() if option in names)
            raise OptionsError(
                f"--{option.replace('_', '-')}",
                got=f"--transcription {name}",
                expected=f"--transcription {' or '.join(takers)}, whose option it is",
            )
    return _OPTIONS[name](confirm=options.confirm, **given)


def _plan(options: argparse.Namespace) -> int:
    check_writable(options.json)
    scenario = load_scenario(options)
    world = World.from_scenario(scenario)
    default = "shooting" if needs_shooting(world, scenario) else "rigid"
    chosen = _read_options(options, options.transcription or default)
    try:
        with show_progress(options, "transcribing") as progress:
            if isinstance(chosen, LiteralOptions):
                plan = plan_literal(scenario, chosen, world=world, progress=progress)
            else:
                plan = Planner(scenario, chosen, world).plan(progress=progress)
    except PlanningError as error:
        if error.plan is not None:
            _answer_plan(options, error.plan)
        raise
    return _answer_plan(options, plan)


def _answer_plan(options: argparse.Namespace, plan: Plan) -> int:
    status = _answer(
        options, plan, format_plan(plan, contact_delay=told_delay(plan, plan.find_world()))
    )
    return INTERRUPTED if plan.is_interrupted else status


def _replay(options: argparse.Namespace) -> int:
    check_writable(options.json)
    plan = Plan.load(options.plan)
    with show_progress(options, "simulating"):
        replayed = plan.replayed(confirm=options.confirm)
    delay = told_delay(replayed, replayed.find_world())
    return _answer(options, replayed, format_replays(replayed, contact_delay=delay))


def _answer(options: argparse.Namespace, plan: Plan, text: str) -> int:
    """Writes and prints a plan, and returns the exit status that its verdict asks for."""
    if options.json:
        plan.save(options.json)
    print(text, flush=True)
    return FINE if plan.holds else NOTHING_HOLDS
