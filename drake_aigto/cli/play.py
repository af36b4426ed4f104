"""``drake-aigto play`` and ``drake-aigto report``."""

from __future__ import annotations

import argparse
import sys
import threading
from typing import TYPE_CHECKING, Any

from drake_aigto.cli.flags import FINE, add_command, add_port
from drake_aigto.cli.progress import show_progress
from drake_aigto.control import ClosedLoopRun, is_run
from drake_aigto.errors import OptionsError, PlanFileError
from drake_aigto.output import check_writable, write_text
from drake_aigto.plain import read_json
from drake_aigto.planning import Plan

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from drake_aigto.world import World

_ANY_PORT = 0
_FILE = "a plan file, or the log of a run in the loop (`drake-aigto control --json`)"

_PLAY_EXAMPLES = """\
drake-aigto play plan.json                          # in a browser, until Enter is pressed
drake-aigto play plan.json --port 7001
drake-aigto play plan.json --html plan.html         # one page, to mail
drake-aigto play plan.json --beside gradient        # what a gradient solver does
drake-aigto play plan.json --optimization           # boxes that shrink
drake-aigto play run.json                           # the log of `drake-aigto control`
"""
_REPORT_EXAMPLES = """\
drake-aigto report plan.json --html plan.html
drake-aigto report run.json --html run.html         # the log of `drake-aigto control`
"""


def add_play(commands: Any) -> None:
    """Adds the command that plays."""
    text = "watch a plan and its simulations, or a run in the loop, in Meshcat"
    play = add_command(commands, "play", _play, text, _PLAY_EXAMPLES)
    play.add_argument("plan", metavar="FILE.json", help=_FILE)
    play.add_argument("--html", metavar="FILE", help="write one self-contained page instead")
    add_port(play)
    what = play.add_mutually_exclusive_group()
    text = "show what a gradient solver makes of the same scenario beside the plan"
    what.add_argument("--beside", choices=["gradient"], help=text)
    text = "show how AIGO's boxes shrink onto the plan instead"
    what.add_argument("--optimization", action="store_true", help=text)


def _play(options: argparse.Namespace) -> int:
    from drake_aigto.show import open_meshcat, save_html, show_run

    check_writable(options.html)
    shown = _load(options.plan)
    if isinstance(shown, ClosedLoopRun):
        only_plans = {"--beside": options.beside, "--optimization": options.optimization}
        for flag in (flag for flag, is_given in only_plans.items() if is_given):
            raise OptionsError(flag, got="the log of a run in the loop", expected="a plan file")
    # A page needs Meshcat, too, but nobody looks for it at a port.
    meshcat = open_meshcat(_ANY_PORT if options.html and options.port is None else options.port)
    if isinstance(shown, Plan):
        _publish(options, shown, meshcat, shown.find_world())
    else:
        show_run(shown, meshcat)
    if options.html:
        save_html(meshcat, options.html)
        print(f"wrote {options.html}")
    else:
        wait_at(meshcat)
    return FINE


def _load(path: str) -> Plan | ClosedLoopRun:
    """Returns what is in a file, which says itself what that is."""
    is_log = is_run(read_json(path, "plan file", PlanFileError))
    return (ClosedLoopRun if is_log else Plan).load(path)


def _publish(options: argparse.Namespace, plan: Plan, meshcat: Meshcat, world: World) -> None:
    from drake_aigto.show import gradient_motions, play, play_boxes

    if options.optimization:
        with show_progress(options, "running AIGO again"):
            play_boxes(plan, meshcat, world)
    elif options.beside:
        with show_progress(options, "running the gradient solver"):
            play(plan, meshcat, world, gradient_motions(world, plan.scenario))
        if plan.additions:
            print(f"SNOPT plans without what was added: {', '.join(plan.additions)}")
    else:
        with show_progress(options, "simulating"):
            play(plan, meshcat, world)


def wait_at(meshcat: Meshcat) -> None:
    """Says where Meshcat plays, and waits for Enter; where nobody can press it, for a signal."""
    key = "Enter" if sys.stdin and sys.stdin.isatty() else "Ctrl-C"
    print(f"Meshcat plays at {meshcat.web_url()}; press {key} to stop.", flush=True)
    if not (sys.stdin and sys.stdin.readline()):
        threading.Event().wait()


def add_report(commands: Any) -> None:
    """Adds the command that writes a page."""
    text = "write one self-contained page about a plan or a run in the loop, to be mailed"
    report = add_command(commands, "report", _report, text, _REPORT_EXAMPLES)
    report.add_argument("plan", metavar="FILE.json", help=_FILE)
    report.add_argument("--html", metavar="FILE", required=True, help="the page")


def _report(options: argparse.Namespace) -> int:
    from drake_aigto.show import report_plan, report_run

    check_writable(options.html)
    shown = _load(options.plan)
    with show_progress(options) as say:
        page = (
            report_plan(shown, progress=say) if isinstance(shown, Plan) else report_run(shown, say)
        )
    write_text(options.html, page)
    print(f"wrote {options.html}, {len(page.encode()) / 1e6:.1f} MB")
    return FINE
