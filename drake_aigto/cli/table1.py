"""``drake-aigto table1``."""

from __future__ import annotations

import argparse
import json
from typing import Any

from drake_aigto.cli.flags import (
    add_command,
    add_confirm,
    add_json,
    add_workers,
    natural,
    positive,
    read_workers,
)
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.status import FINE, INTERRUPTED
from drake_aigto.paper import ROWS, run_table1
from drake_aigto.plain import to_plain
from drake_aigto.show.tables import format_table1
from drake_aigto.world.files import check_writable, write_text

_EXAMPLES = """\
drake-aigto table1                            # all four rows
drake-aigto table1 --rows 4 --guesses 2       # a first impression
drake-aigto table1 --json table1.json > table1.txt
drake-aigto table1 --html table1.html         # a page, to mail
"""


def add_table1(commands: Any) -> None:
    """Adds the command."""
    text = "the paper's Table I, and what each plan does on a rigid wall"
    table1 = add_command(commands, "table1", _table1, text, _EXAMPLES)
    add = table1.add_argument
    add("--rows", type=int, nargs="+", choices=ROWS, default=ROWS, help="which rows (default: all)")
    text = "random guesses of the gradient solver (default: %(default)s)"
    add("--guesses", type=positive, default=10, help=text)
    add("--seed", type=natural, default=0, help="of the guesses (default: %(default)s)")
    add_confirm(table1)
    add_workers(table1)
    add_json(table1, "write all plans and figures")
    add("--html", metavar="FILE", help="write one self-contained page")


def _table1(options: argparse.Namespace) -> int:
    check_writable(options.json)
    check_writable(options.html)
    with show_progress(options, "working on the first cells") as progress:
        table = run_table1(
            rows=options.rows,
            num_guesses=options.guesses,
            seed=options.seed,
            confirm=options.confirm,
            executor=read_workers(options),
            progress=progress,
        )
    if options.json:
        write_text(options.json, json.dumps(to_plain(table)) + "\n")
    if options.html:
        from drake_aigto.show import report_table1

        with show_progress(options, "making the page"):
            page = report_table1(table)
        write_text(options.html, page)
    print(format_table1(table), flush=True)
    return INTERRUPTED if table.num_missing else FINE
