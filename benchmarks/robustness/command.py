"""``python -m benchmarks robustness``."""

from __future__ import annotations

import argparse
from typing import Any

from benchmarks.robustness.figures import format_robustness
from benchmarks.robustness.question import RobustnessQuestion
from benchmarks.robustness.study import run_robustness
from drake_aigto.cli.flags import add_command, add_confirm
from drake_aigto.cli.status import FINE
from drake_aigto.cli.studies import add_running, run_study
from drake_aigto.paper import ROWS

_EXAMPLES = """\
python -m benchmarks robustness --rows 1 --restitutions 1 0.8 --scenarios 0   # minutes
python -m benchmarks robustness --percent 2 --json robustness.json
python -m benchmarks robustness --percent 2 --json robustness.json --resume   # go on after Ctrl-C
"""


def add_robustness(benchmarks: Any) -> None:
    """Adds the command."""
    text = "how much plans suffer under perturbations, open loop and with feedback"
    command = add_command(benchmarks, "robustness", _robustness, text, _EXAMPLES)
    defaults = RobustnessQuestion()
    command.add_argument(
        "--rows",
        type=int,
        nargs="*",
        choices=ROWS,
        default=ROWS,
        help="of Table I (default: all)",
    )
    command.add_argument(
        "--restitutions",
        type=float,
        nargs="+",
        default=defaults.restitutions,
        metavar="E",
        help="of the wall, each with every row (default: 1 0.8 0.5)",
    )
    command.add_argument(
        "--scenarios",
        type=int,
        default=defaults.scenarios,
        metavar="N",
        help="random scenarios besides (default: %(default)s)",
    )
    command.add_argument(
        "--percent",
        type=float,
        default=defaults.percent,
        metavar="X",
        help="how much start, velocity, wall, mass and restitution are other at most "
        "(default: %(default)s)",
    )
    command.add_argument(
        "--samples",
        type=int,
        default=defaults.samples,
        metavar="N",
        help="perturbations of everything at once (default: %(default)s)",
    )
    command.add_argument(
        "--seed",
        type=int,
        default=defaults.seed,
        help="of all that is random (default: %(default)s)",
    )
    add_confirm(command)
    add_running(command)


def _robustness(options: argparse.Namespace) -> int:
    question = RobustnessQuestion(
        rows=tuple(options.rows),
        restitutions=tuple(options.restitutions),
        scenarios=options.scenarios,
        percent=options.percent,
        samples=options.samples,
        seed=options.seed,
        confirm=options.confirm,
    )
    study = run_study(options, run_robustness, question)
    print(format_robustness(study), flush=True)
    return FINE
