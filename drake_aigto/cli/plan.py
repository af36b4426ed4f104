"""``drake-aigto plan``, ``replay``, ``plan-many`` and ``table1``."""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

from drake_aigto.cli import flags
from drake_aigto.cli.command_line import KEEPING, hear_ctrl_c, paint, show_progress
from drake_aigto.errors import OptionsError
from drake_aigto.paper import ROWS, LiteralOptions, plan_literal, run_table1
from drake_aigto.plain import check_writable, to_plain, write_text
from drake_aigto.planning import Plan, Planner, PlanningError, PlanOptions
from drake_aigto.show import cost_text, format_plan, format_replays, to_csv
from drake_aigto.world import Scenario, World

# Options that are no flags: lists, and what has a flag of its own.
_NO_FLAGS = ("ladder", "knot_steps", "branches", "confirm")

_PLAN_EXAMPLES = """\
drake-aigto plan table1/1 --json plan.json --html plan.html         # a page, to mail
drake-aigto plan table1/1 --initial-velocity -3 --restitution 0.8   # another question
drake-aigto plan room/bank_shot -v                                  # step by step
drake-aigto plan my_scenario.yaml --no-confirm
drake-aigto plan table1/1 --transcription literal                   # as the paper has it
"""
_REPLAY_EXAMPLES = """\
drake-aigto replay plan.json
drake-aigto replay plan.json --no-confirm   # without Drake's plant
"""
_MANY_EXAMPLES = """\
drake-aigto plan-many table1/1 table1/2 corridor/lossy --into plans
drake-aigto plan-many tasks/*.yaml --into plans --workers 4
drake-aigto plan-many tasks/*.yaml --into plans --resume             # go on after Ctrl-C
drake-aigto plan-many tasks/*.yaml --scheduler tcp://10.0.0.1:8786   # on Dask's workers
"""
_MANY_NOTES = """\
Plans are written as they come: --into plans writes plans/table1/1.json for `play` and `report`, and
plans/answers.jsonl about all of them. If there is no plan for a scenario, or its process dies, the
others continue. Exit status: 0 all plans hold, 1 some do not, 2 bad input, 130 interrupted.
"""
_ENDED = "plans that are done are kept, others dropped"
_TABLE_EXAMPLES = """\
drake-aigto table1                            # all four rows
drake-aigto table1 --rows 4 --guesses 2       # a first impression
drake-aigto table1 --json table1.json > table1.txt
drake-aigto table1 --html table1.html         # a page, to mail
"""


def add_plan(commands: Any) -> None:
    """Adds the command that plans."""
    plan = flags.add_command(commands, "plan", _plan, "plan for a scenario", _PLAN_EXAMPLES)
    flags.add_scenario(plan)
    group = plan.add_argument_group(flags.NUMERICS)
    text = "literal: plan as the paper does; default: as the world requires"
    group.add_argument("--transcription", metavar="literal", help=text)
    flags.add_fields(group, PlanOptions, *_NO_FLAGS)
    shared = (field.name for field in fields(PlanOptions))
    flags.add_fields(group, LiteralOptions, *_NO_FLAGS, *shared, note="literal: ")
    flags.add_confirm(plan)
    flags.add_json(plan, "write the plan, for `replay` and `play`")
    plan.add_argument("--csv", metavar="FILE", help="write its trajectory, one row per knot")
    flags.add_html(plan)


def add_replay(commands: Any) -> None:
    """Adds the command that simulates a plan again."""
    text = "simulate a plan's control again"
    replay = flags.add_command(commands, "replay", _replay, text, _REPLAY_EXAMPLES)
    replay.add_argument("plan", metavar="PLAN.json", help="a plan file")
    flags.add_confirm(replay)
    flags.add_json(replay, "write the plan with its new replays")


def _read_options(options: argparse.Namespace) -> PlanOptions | LiteralOptions:
    """Returns the numerics that were given.

    Raises:
        OptionsError: some are of the other kind of plan, or there is no such transcription.
    """
    if options.transcription not in (None, "literal"):
        raise OptionsError(
            "--transcription",
            got=options.transcription,
            expected="literal",
            remedy="Leave it out: the world decides between plans for balls and for mechanisms.",
        )
    literal = "--transcription literal"
    kinds: list[type[PlanOptions | LiteralOptions]] = [PlanOptions, LiteralOptions]
    got, expected = f"no {literal}", f"{literal}, whose option it is"
    if options.transcription:
        kinds.reverse()
        got, expected = literal, "another plan, whose option it is"
    kind, other = kinds
    given = flags.read_fields(options, kind)
    for option in flags.read_fields(options, other):
        if option not in given:
            raise OptionsError(flags.name_flag(option), got=got, expected=expected)
    return kind(**given)


def _plan(options: argparse.Namespace) -> int:
    check_writable(options.json, options.csv, options.html)
    scenario = flags.load_scenario(options)
    world = World.from_scenario(scenario)
    chosen = _read_options(options)
    try:
        with show_progress(options, "transcribing") as progress, hear_ctrl_c():
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
    status = _answer(options, plan, format_plan(plan))
    if options.html:
        from drake_aigto.show import report_plan  # Matplotlib takes its time.

        with show_progress(options, "making the page") as progress:
            page = report_plan(plan, progress=progress)
        write_text(options.html, page)
        print(f"wrote {options.html}", flush=True)
    return flags.INTERRUPTED if plan.is_interrupted else status


def _replay(options: argparse.Namespace) -> int:
    check_writable(options.json)
    plan = Plan.load(options.plan)
    with show_progress(options, "simulating"):
        replayed = plan.replayed(confirm=options.confirm)
    return _answer(options, replayed, format_replays(replayed))


def _answer(options: argparse.Namespace, plan: Plan, text: str) -> int:
    """Writes and prints a plan, and returns the exit status that its verdict asks for."""
    if options.json:
        plan.save(options.json)
    if getattr(options, "csv", None):
        write_text(options.csv, to_csv(plan))
    print(paint(text), flush=True)
    return flags.FINE if plan.holds else flags.NOTHING_HOLDS


def add_plan_many(commands: Any) -> None:
    """Adds the command."""
    text = "plan for many scenarios, in parallel"
    command = flags.add_command(
        commands, "plan-many", _plan_many, text, _MANY_EXAMPLES, _MANY_NOTES
    )
    text = "shipped scenarios by name, or YAML files"
    command.add_argument("scenarios", nargs="+", metavar="SCENARIO", help=text)
    command.add_argument("--into", metavar="FOLDER", help="keep plans there, as they come")
    text = "continue from the folder; scenarios whose process died are tried again"
    command.add_argument("--resume", action="store_true", help=text)
    flags.add_workers(command)


def _plan_many(options: argparse.Namespace) -> int:
    from drake_aigto.jobs import plan_many

    questions = _read_questions(options.scenarios)
    if options.resume and options.into is None:
        raise OptionsError("--resume", got="no folder", expected="--into FOLDER")
    where = {"workers": options.workers, "scheduler": options.scheduler}
    width, status = max(map(len, questions)), flags.FINE
    try:
        with show_progress(options, "checking the questions") as progress, hear_ctrl_c(_ENDED):
            kept = {"folder": options.into, "resume": options.resume}
            for answer in plan_many(questions, **where, **kept, progress=progress):
                text = f"failed  {' '.join((answer.error or '').split())}"
                if (plan := answer.plan) and answer.holds:
                    cost = cost_text(plan.cost, 3, plan.best.scales.cost)
                    touches = plan.best.describe_contacts()
                    text = f"holds  cost {cost:>9}  {answer.seconds:7.2f} s  {touches}"
                    text += plan.idleness and f"; {plan.idleness}"
                print(f"{answer.name:{width}}  {text}", flush=True)
                status = status if answer.holds else flags.NOTHING_HOLDS
    except KeyboardInterrupt:
        if options.into:
            print(f"drake-aigto: --resume goes on from {options.into}", file=sys.stderr)
        raise
    return status


def _read_questions(names: list[str]) -> dict[str, Scenario]:
    """Returns scenarios by name; those of files by the files' names.

    Raises:
        OptionsError: the same name twice.
        ScenarioError: one can't be read.
    """
    questions: dict[str, Scenario] = {}
    for name in names:
        short = Path(name).stem if flags.is_file(name) else name
        if short in questions:
            raise OptionsError(f"SCENARIO {name}", got="the same name twice", expected="each once")
        questions[short] = flags.read_scenario(name)
    return questions


def add_table1(commands: Any) -> None:
    """Adds the command."""
    text = "the paper's Table I, and what each plan does on a rigid wall"
    table1 = flags.add_command(commands, "table1", _table1, text, _TABLE_EXAMPLES)
    add = table1.add_argument
    add("--rows", type=int, nargs="+", choices=ROWS, default=ROWS, help="which rows (default: all)")
    text = "random guesses of the gradient solver (default: %(default)s)"
    add("--guesses", type=flags.positive, default=10, help=text)
    add("--seed", type=flags.natural, default=0, help="of the guesses (default: %(default)s)")
    flags.add_confirm(table1)
    flags.add_workers(table1)
    flags.add_json(table1, "write all plans and figures")
    flags.add_html(table1)


def _table1(options: argparse.Namespace) -> int:
    check_writable(options.json, options.html)
    with show_progress(options, "working on the first cells") as progress, hear_ctrl_c(KEEPING):
        table = run_table1(
            rows=options.rows,
            num_guesses=options.guesses,
            seed=options.seed,
            confirm=options.confirm,
            executor=flags.read_workers(options),
            progress=progress,
        )
    if options.json:
        write_text(options.json, json.dumps(to_plain(table)) + "\n")
    from drake_aigto.show import format_table1, report_table1  # Matplotlib takes its time.

    if options.html:
        with show_progress(options, "making the page"):
            page = report_table1(table)
        write_text(options.html, page)
    print(format_table1(table), flush=True)
    return flags.INTERRUPTED if table.num_missing else flags.FINE
