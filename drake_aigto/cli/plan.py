"""``drake-aigto plan`` and ``drake-aigto replay``."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any, get_args

from drake_aigto.cli.flags import add_command, add_confirm, add_json
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.scenario_flags import add_scenario, load_scenario
from drake_aigto.cli.status import FINE, INTERRUPTED, NOTHING_HOLDS
from drake_aigto.errors import OptionsError
from drake_aigto.paper import LiteralOptions, plan_literal
from drake_aigto.paper.options import AlgorithmName
from drake_aigto.planning import Plan, Planner, PlanningError, PlanOptions
from drake_aigto.planning.options import LocalSolverName
from drake_aigto.show.plans import format_plan, format_replays
from drake_aigto.simulation.material import contact_delay
from drake_aigto.world.files import check_writable

# Option → what it is, of rigid plans, of literal ones, or of both.
_NUMERICS = {
    "local_solver": "what polishes AIGO's results",
    "finalists": "how many of the best candidates are improved",
    "threads": "how many starts of AIGO run at once (default: more than one for large boxes)",
    "relaxation": "rigid: how much walls push from afar while boxes shrink",
    "aigo_steps": "rigid: the most time steps that boxes have",
    "exhaustive": "rigid: also run starts, and polish flights, that can hardly win",
    "nonpenetration": "literal: ask for φ(q) ≥ 0 at the knots",
    "algorithm": "literal: how boxes shrink",
}
_CHOICES = {"local_solver": get_args(LocalSolverName), "algorithm": get_args(AlgorithmName)}
_OPTIONS = {"rigid": PlanOptions, "literal": LiteralOptions}

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
    text = "rigid: plans that hold on rigid walls; literal: the paper's (default: %(default)s)"
    group.add_argument("--transcription", choices=_OPTIONS, default="rigid", help=text)
    defaults = {**vars(LiteralOptions()), **vars(PlanOptions())}
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


def _read_options(options: argparse.Namespace) -> PlanOptions | LiteralOptions:
    """Returns the numerics that were given.

    Raises:
        OptionsError: some are of the other transcription.
    """
    kind = _OPTIONS[options.transcription]
    given = {name: value for name, value in vars(options).items() if name in _NUMERICS}
    known = [field.name for field in dataclasses.fields(kind)]
    for name in given:
        if name not in known:
            flag = f"--{name.replace('_', '-')}"
            (other,) = _OPTIONS.keys() - {options.transcription}
            raise OptionsError(
                flag,
                got=f"--transcription {options.transcription}",
                expected=f"--transcription {other}, whose option it is",
            )
    return kind(confirm=options.confirm, **given)


def _plan(options: argparse.Namespace) -> int:
    check_writable(options.json)
    scenario, chosen = load_scenario(options), _read_options(options)
    try:
        with show_progress(options, "transcribing") as progress:
            if isinstance(chosen, LiteralOptions):
                plan = plan_literal(scenario, chosen, progress=progress)
            else:
                plan = Planner(scenario, chosen).plan(progress=progress)
    except PlanningError as error:
        if error.plan is not None:
            _answer_plan(options, error.plan)
        raise
    return _answer_plan(options, plan)


def _answer_plan(options: argparse.Namespace, plan: Plan) -> int:
    status = _answer(options, plan, format_plan(plan, contact_delay=_delay(plan)))
    return INTERRUPTED if plan.is_interrupted else status


def _replay(options: argparse.Namespace) -> int:
    check_writable(options.json)
    plan = Plan.load(options.plan)
    with show_progress(options, "simulating"):
        replayed = plan.replayed(confirm=options.confirm)
    return _answer(options, replayed, format_replays(replayed, contact_delay=_delay(replayed)))


def _answer(options: argparse.Namespace, plan: Plan, text: str) -> int:
    """Writes and prints a plan, and returns the exit status that its verdict asks for."""
    if options.json:
        plan.save(options.json)
    print(text, flush=True)
    return FINE if plan.holds else NOTHING_HOLDS


def _delay(plan: Plan) -> float | None:
    """Returns by how much walls in Drake are late at most [s], if the plan was replayed there."""
    return None if plan.replay.drake is None else contact_delay(plan.find_world())
