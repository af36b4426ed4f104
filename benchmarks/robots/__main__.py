"""How good are plans for robots, against peers on the same questions with the same seconds?

    python -m benchmarks.robots compare --json robots.json          # hours; --resume goes on
    python -m benchmarks.robots compare --count 12 --minutes 15 --workers 2
    python -m benchmarks.robots compare cart_pole/soft_06 --count 5 --methods IPOPT --seconds 2
    python -m benchmarks.robots search shooting --tries 300         # for the best known

The questions are random ones about each robot that is shipped, for the cart-pole after SPOT's ten
(`worlds`). What a method finds is replayed by a judge with equations of its own (`judge`,
`mechanics`); J is the judge's. The best known costs are in `known.json`; `search` and `compare
--refresh` put better ones there.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence

from benchmarks.__main__ import main
from benchmarks.robots.compare import Comparison, RobotStudy
from benchmarks.robots.known import search
from benchmarks.robots.methods import METHODS
from benchmarks.robots.table import find_figures, format_results
from benchmarks.robots.worlds import WORLDS
from benchmarks.script import is_met
from benchmarks.study.flags import add_running, run_asked
from drake_aigto.cli import FINE, Parser, add_command, add_common, positive

_COMPARE = """\
python -m benchmarks.robots compare --json robots.json --workers 2
python -m benchmarks.robots compare cart_pole/soft_06 --count 5 --methods IPOPT shooting --seconds 1
"""
_SEARCH = "python -m benchmarks.robots search IPOPT --tries 20 --minutes 20\n"


def make_parser(_: Sequence[str] = ()) -> Parser:
    """Returns the parser of all commands."""
    parser = Parser(prog="python -m benchmarks.robots", description="Plans for robots, and peers.")
    add_common(parser)
    commands = parser.add_commands("COMMAND")
    _add_compare(commands)
    _add_search(commands)
    return parser


def _add_questions(command: argparse.ArgumentParser) -> None:
    text = f"some of {', '.join(WORLDS)} (default: all)"
    command.add_argument("worlds", nargs="*", metavar="WORLD", default=[], help=text)
    text = "of each world's questions, the first ones (default: all)"
    command.add_argument("--count", type=positive, metavar="N", help=text)
    text = "questions to tune on, and not those that are reported"
    command.add_argument("--tuning", action="store_true", help=text)


def _add_compare(commands: argparse._SubParsersAction[Parser]) -> None:
    text = "run methods on the same questions and print the table"
    command = add_command(commands, "compare", _compare, text, _COMPARE)
    _add_questions(command)
    text = f"some of {', '.join(METHODS)} (default: those that apply)"
    command.add_argument("--methods", nargs="+", metavar="M", default=list(METHODS), help=text)
    text = "of CPU time that a peer has for a question (default: the first plan's, at least 1)"
    command.add_argument("--seconds", type=float, metavar="S", help=text)
    text = "let what is better take the place of the best known"
    command.add_argument("--refresh", action="store_true", help=text)
    add_running(command)


def _add_search(commands: argparse._SubParsersAction[Parser]) -> None:
    text = "search for better than the best known"
    command = add_command(commands, "search", _search, text, _SEARCH)
    command.add_argument("method", choices=METHODS)
    _add_questions(command)
    text = "of each question, those of earlier searches included (default: %(default)s)"
    command.add_argument("--tries", type=positive, default=300, metavar="N", help=text)
    text = "after which it ends (default: when all tries are made)"
    command.add_argument("--minutes", type=float, default=math.inf, metavar="M", help=text)


def _compare(options: argparse.Namespace) -> int:
    question = Comparison(
        worlds=tuple(options.worlds or WORLDS),
        count=options.count,
        methods=tuple(options.methods),
        seconds=options.seconds,
        is_tuning=options.tuning,
    )
    results = run_asked(options, RobotStudy(question, refresh=options.refresh))
    print(format_results(results), end="\n\n")
    return int(not all([is_met(*each) for each in find_figures(results)]))


def _search(options: argparse.Namespace) -> int:
    worlds = tuple(options.worlds or filter(METHODS[options.method].applies, WORLDS))
    asked = Comparison(worlds, options.count, (options.method,), 1.0, options.tuning)
    search(asked.questions(), options.method, options.tries, 60.0 * options.minutes, print)
    return FINE


if __name__ == "__main__":
    sys.exit(main(make=make_parser))
