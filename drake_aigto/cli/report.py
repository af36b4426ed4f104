"""``drake-aigto report``."""

from __future__ import annotations

import argparse
from typing import Any

from drake_aigto.cli.flags import add_command
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.status import FINE
from drake_aigto.planning import Plan
from drake_aigto.world.files import check_writable, write_text

_EXAMPLES = """\
drake-aigto report plan.json --html plan.html
"""


def add_report(commands: Any) -> None:
    """Adds the command."""
    text = "write one self-contained page about a plan, to be mailed"
    report = add_command(commands, "report", _report, text, _EXAMPLES)
    report.add_argument("plan", metavar="PLAN.json", help="a plan file")
    report.add_argument("--html", metavar="FILE", required=True, help="the page")


def _report(options: argparse.Namespace) -> int:
    from drake_aigto.show import report_plan

    check_writable(options.html)
    plan = Plan.load(options.plan)
    with show_progress(options) as progress:
        page = report_plan(plan, progress=progress)
    write_text(options.html, page)
    print(f"wrote {options.html}, {len(page.encode()) / 1e6:.1f} MB")
    return FINE
