"""``python -m benchmarks ablations``."""

from __future__ import annotations

import argparse
import textwrap
from typing import Any

from benchmarks.ablations.ablations import VARIANTS, AblationQuestion
from benchmarks.ablations.tables import format_ablations
from drake_aigto.cli.flags import add_command
from drake_aigto.cli.status import FINE
from drake_aigto.cli.studies import add_question, add_running, read_question, run_study
from drake_aigto.show.text import WIDTH
from drake_aigto.study.scenario_study import run_scenario_study

_EXAMPLES = """\
python -m benchmarks ablations --count 20                         # a first impression
python -m benchmarks ablations --restitution 1 0.5 --json ablations.json
python -m benchmarks ablations --restitution 1 0.5 --json ablations.json --resume
"""
_NOTES = textwrap.fill(f"Variants: {'; '.join(VARIANTS)}.", WIDTH)


def add_ablations(commands: Any) -> None:
    """Adds the command."""
    text = "what finds the bounce: the planner with one part changed at a time"
    command = add_command(commands, "ablations", _ablations, text, _EXAMPLES, _NOTES)
    add_question(command, AblationQuestion())
    command.add_argument(
        "--variants",
        nargs="+",
        metavar="NAME",
        default=list(VARIANTS),
        help="by name, see below (default: all)",
    )
    add_running(command)


def _ablations(options: argparse.Namespace) -> int:
    question = AblationQuestion(methods=tuple(options.variants), **read_question(options))
    study = run_study(options, run_scenario_study, question)
    print(format_ablations(study), flush=True)
    return FINE
