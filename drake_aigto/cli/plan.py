"""``drake-aigto plan`` and ``drake-aigto replay``."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from drake_aigto.cli.flags import add_command, add_confirm, add_json
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.status import FINE, NOTHING_HOLDS
from drake_aigto.planning import Plan, Planner, PlanningError, PlanOptions
from drake_aigto.planning.options import CHOICES
from drake_aigto.show.plans import format_plan, format_replays
from drake_aigto.simulation.material import contact_delay
from drake_aigto.world import Scenario, scenario_names
from drake_aigto.world.files import check_writable

_VECTORS = ("initial_position", "initial_velocity", "goal_position")
# Scenario field → what it is.
_FIELDS = {
    "model": "the world: package://… or a path to an SDF or URDF",
    "initial_position": "q(0), one number a coordinate [m]",
    "initial_velocity": "v(0) [m/s]",
    "goal_position": "where q(T) should be [m]",
    "duration": "T [s]",
    "time_step": "dt [s]; T is a whole number of them",
    "control_weight": "of ∫ ‖u‖² dt in the cost [1/(N² s)]",
    "goal_weight": "of ‖q(T) − goal‖² in the cost [1/m²]",
    "epsilon": "literal: ε of the contact force ε/(φ + δ) [J]",
    "delta": "literal: δ of it [m]",
    "restitution": "speed after / before an impact, 0 to 1, where the model has none",
    "mass": "of the body that touches, in place of the model's [kg]",
    "friction": "0 leaves out that of the model, which plans know nothing of",
}
# Plan option → what it is.
_CHOICES = {
    "transcription": "rigid: plans that hold on rigid walls; literal: the paper's",
    "algorithm": "how boxes shrink",
    "local_solver": "what polishes AIGO's results",
}
# Numeric plan option → its type, and what it is.
_NUMBERS: dict[str, tuple[Callable[[str], float], str]] = {
    "relaxation": (float, "rigid: how much walls push from afar while boxes shrink"),
    "aigo_steps": (int, "rigid: the most time steps that boxes have"),
    "finalists": (int, "how many of the best candidates are improved"),
    "threads": (int, "how many starts of AIGO run at once; None: more than one for large boxes"),
}
# Plan option → what it is.
_SWITCHES = {
    "nonpenetration": "literal: ask for φ(q) ≥ 0 at the knots",
    "exhaustive": "rigid: also run starts, and polish flights, that can hardly win",
}

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
    plan.add_argument(
        "scenario",
        metavar="SCENARIO",
        help=f"a YAML file, or one of {', '.join(scenario_names())}",
    )
    _add_fields(plan.add_argument_group("change the scenario's fields"))
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


def _add_fields(group: Any) -> None:
    for field in dataclasses.fields(Scenario):
        flag = f"--{field.name.replace('_', '-')}"
        text = _FIELDS[field.name]
        if field.name == "model":
            group.add_argument(flag, metavar="URI", help=text)
        elif field.name in _VECTORS:
            group.add_argument(flag, type=float, nargs="+", metavar="X", help=text)
        else:
            group.add_argument(flag, type=float, metavar="X", help=text)


def _add_numerics(group: Any) -> None:
    defaults = PlanOptions()
    for name, choices in CHOICES.items():
        group.add_argument(
            f"--{name.replace('_', '-')}",
            choices=choices,
            default=getattr(defaults, name),
            help=f"{_CHOICES[name]} (default: %(default)s)",
        )
    for name, (kind, text) in _NUMBERS.items():
        group.add_argument(
            f"--{name.replace('_', '-')}",
            type=kind,
            default=getattr(defaults, name),
            metavar="N" if kind is int else "X",
            help=f"{text} (default: %(default)s)",
        )
    for name, text in _SWITCHES.items():
        group.add_argument(
            f"--{name}",
            action=argparse.BooleanOptionalAction,
            default=getattr(defaults, name),
            help=f"{text} (default: %(default)s)",
        )


def _plan(options: argparse.Namespace) -> int:
    check_writable(options.json)
    scenario = _load_scenario(options)
    names = (*CHOICES, *_NUMBERS, *_SWITCHES, "confirm")
    chosen = PlanOptions(**{name: getattr(options, name) for name in names})
    try:
        with show_progress(options, "transcribing") as progress:
            planner = Planner(scenario, chosen)
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
    with show_progress(options, "simulating"):
        replayed = dataclasses.replace(plan, replay=planner.simulate(plan.trajectory))
    delay = _delay(replayed, planner)
    return _answer(options, replayed, format_replays(replayed, planner.world, delay))


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
