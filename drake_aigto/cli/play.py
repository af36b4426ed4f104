"""``drake-aigto play``, ``report``, ``compare``, ``live`` and ``control``."""

from __future__ import annotations

import argparse
import sys
import threading
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drake_aigto import show
from drake_aigto.cli import flags
from drake_aigto.cli.command_line import KEEPING, hear_ctrl_c, paint, show_progress
from drake_aigto.control import (
    ClosedLoopRun,
    Disturbance,
    ModelPredictiveController,
    TrackingController,
    is_run,
    run_in_loop,
)
from drake_aigto.errors import ControlError, OptionsError, PlanFileError
from drake_aigto.plain import check_writable, read_json, write_text
from drake_aigto.planning import Plan, Planner, PlanOptions
from drake_aigto.world import World

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

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

_LIVE_EXAMPLES = """\
drake-aigto live table1/1             # drag the goal towards the wall: bouncing becomes braking
drake-aigto live cart_pole/soft_06    # about a second from drag to plan
"""
_COMPARE_EXAMPLES = """\
drake-aigto compare a.json b.json --html both.html
"""
_LIVE = "visualizer"  # where Drake's own visualizer draws what moves

_CONTROL_EXAMPLES = """\
drake-aigto control cart_pole/soft_06                                 # plan again as it moves
drake-aigto control cart_pole/soft_06 --kick 0.3 1.5 --kick-time 0.5 --html run.html
drake-aigto control cart_pole/soft_06 --method tracking --mass-factor 1.1 --json run.json
drake-aigto control table1/1 --wall-shift 0.01 --live                 # in Meshcat
"""
_DEFAULT_PERIOD = 0.01  # [s]


def add_play(commands: Any) -> None:
    """Adds the command that plays."""
    text = "watch a plan and its simulations, or a run in the loop, in Meshcat"
    play = flags.add_command(commands, "play", _play, text, _PLAY_EXAMPLES)
    play.add_argument("plan", metavar="FILE.json", help=_FILE)
    flags.add_html(play)
    flags.add_port(play)
    what = play.add_mutually_exclusive_group()
    text = "show a gradient solver's plan for the same scenario beside the plan"
    what.add_argument("--beside", choices=["gradient"], help=text)
    text = "show how AIGO's boxes shrink onto the plan instead"
    what.add_argument("--optimization", action="store_true", help=text)


def _play(options: argparse.Namespace) -> int:
    check_writable(options.html)
    shown = _load(options.plan)
    if isinstance(shown, ClosedLoopRun):
        only_plans = {"--beside": options.beside, "--optimization": options.optimization}
        for flag in (flag for flag, is_given in only_plans.items() if is_given):
            raise OptionsError(flag, got="the log of a run in the loop", expected="a plan file")
    # A page needs Meshcat, too, but nobody looks for it at a port.
    meshcat = show.open_meshcat(
        _ANY_PORT if options.html and options.port is None else options.port
    )
    if isinstance(shown, Plan):
        recording = _publish(options, shown, meshcat, shown.find_world())
    else:
        recording = show.show_run(shown, meshcat)
    if options.html:
        recording.save(options.html)
        print(f"wrote {options.html}")
    else:
        print(recording)
        wait_at(meshcat)
    return flags.FINE


def _load(path: str) -> Plan | ClosedLoopRun:
    """Returns what is in a file, which says itself what that is."""
    is_log = is_run(read_json(path, "plan file", PlanFileError))
    return (ClosedLoopRun if is_log else Plan).load(path)


def _publish(
    options: argparse.Namespace, plan: Plan, meshcat: Meshcat, world: World
) -> show.Playback:
    if options.optimization:
        with show_progress(options, "running AIGO again"):
            return show.play_boxes(plan, meshcat, world)
    beside = []
    with show_progress(options, "simulating") as say:
        if options.beside:
            if say:
                say("running the gradient solver")
            beside = show.gradient_motions(world, plan.scenario)
        recording = show.play(plan, meshcat, world, beside)
    if beside and plan.additions:
        print(f"SNOPT plans without what was added: {', '.join(plan.additions)}")
    return recording


def wait_at(meshcat: Meshcat) -> None:
    """Says where Meshcat plays, and waits for Enter; where nobody can press it, for a signal."""
    key = "Enter" if sys.stdin and sys.stdin.isatty() else "Ctrl-C"
    print(f"Meshcat plays at {meshcat.web_url()}; press {key} to stop.", flush=True)
    if not (sys.stdin and sys.stdin.readline()):
        threading.Event().wait()


def add_report(commands: Any) -> None:
    """Adds the command that writes a page."""
    text = "write one self-contained page about a plan or a run in the loop"
    report = flags.add_command(commands, "report", _report, text, _REPORT_EXAMPLES)
    report.add_argument("plan", metavar="FILE.json", help=_FILE)
    flags.add_html(report, is_required=True)


def _report(options: argparse.Namespace) -> int:
    check_writable(options.html)
    shown = _load(options.plan)
    with show_progress(options) as say:
        if isinstance(shown, Plan):
            page = show.report_plan(shown, progress=say)
        else:
            page = show.report_run(shown, say)
    write_text(options.html, page)
    print(f"wrote {options.html}, {len(page.encode()) / 1e6:.1f} MB")
    return flags.FINE


def add_live(commands: Any) -> None:
    """Adds the command whose plan follows sliders."""
    text = "drag start, velocity, goal, walls and weights in Meshcat, and the plan follows"
    live = flags.add_command(commands, "live", _live, text, _LIVE_EXAMPLES)
    flags.add_scenario(live)
    flags.add_port(live)


def _live(options: argparse.Namespace) -> int:
    tell = partial(print, flush=True)
    live = show.Live(flags.load_scenario(options), tell, options.port)
    with hear_ctrl_c("the scene is closed"):
        live.run()
    return flags.FINE


def add_compare(commands: Any) -> None:
    """Adds the command that puts plans on one page."""
    text = "write one page about several plans for the same world"
    compare = flags.add_command(commands, "compare", _compare, text, _COMPARE_EXAMPLES)
    compare.add_argument("plans", metavar="FILE.json", nargs="+", help="plan files")
    flags.add_html(compare, is_required=True)


def _compare(options: argparse.Namespace) -> int:
    check_writable(options.html)
    plans = {Path(path).stem: Plan.load(path) for path in options.plans}
    write_text(options.html, show.compare(plans).to_html())
    print(f"wrote {options.html}")
    return flags.FINE


def add_control(commands: Any) -> None:
    """Adds the command that closes the loop."""
    text = "simulate a plant under a controller that plans again, or tracks a plan, in Drake"
    control = flags.add_command(commands, "control", _control, text, _CONTROL_EXAMPLES)
    flags.add_scenario(control)
    _add_controller(control.add_argument_group("controller"))
    unknown = control.add_argument_group(flags.UNKNOWN)
    flags.add_fields(unknown, Disturbance, "seed")
    text = "of the noise (default: 0)"
    unknown.add_argument("--noise-seed", type=flags.natural, metavar="N", dest="seed", help=text)
    flags.add_json(control, "write the log: motion, controls, ticks, plans at switches")
    flags.add_html(control)
    text = "show the plant in Meshcat as it moves, in real time, and wait"
    control.add_argument("--live", action="store_true", help=text)
    flags.add_port(control)


def _add_controller(group: Any) -> None:
    text = "plan again at every tick, or track one plan (default: plan again if possible)"
    group.add_argument("--method", choices=["replanning", "tracking"], help=text)
    text = "how long to simulate (default: the scenario's duration) [s]"
    group.add_argument("--seconds", type=flags.seconds, metavar="X", help=text)
    text = f"between ticks [s] (default: {_DEFAULT_PERIOD:g}; of tracking, a fifth of a time step)"
    group.add_argument("--period", type=flags.seconds, metavar="X", help=text)
    text = "replanning: ticks from one search to the next (default: only if the cost rises)"
    group.add_argument("--search-every", type=flags.positive, metavar="N", help=text)
    text = (
        "replanning: the horizon ends with the scenario, or recedes at its full length "
        "(default: receding if --seconds is longer than the scenario)"
    )
    group.add_argument("--horizon", choices=["shrinking", "receding"], help=text)
    text = "filter the noise by the model, before the controller"
    group.add_argument("--filter", action="store_true", help=text)
    text = "the most renewals of a search (default: the planner's)"
    group.add_argument("--renewals", type=flags.natural, metavar="N", help=text)


def _control(options: argparse.Namespace) -> int:
    check_writable(options.json, options.html)
    scenario = flags.load_scenario(options)
    given = {
        k: value
        for k, value in flags.read_fields(options, Disturbance).items()
        if value is not None
    }
    disturbance = Disturbance(**given)
    _check_flags(options, disturbance)
    world = World.from_scenario(scenario)
    disturbance.apply(world, scenario)  # Refused before long work.
    if scenario.duration_range is None:
        disturbance.check_times(options.seconds or scenario.duration)
    numerics = None if options.renewals is None else PlanOptions(renewals=options.renewals)
    planner = Planner(scenario, numerics, world)
    meshcat = None
    if options.live:  # A browser may look at it from the start on.
        meshcat = show.open_meshcat(options.port)
        print(f"Meshcat shows it at {meshcat.web_url()}", flush=True)
    with show_progress(options, "planning") as progress:
        with hear_ctrl_c():
            controller = _make_controller(options, planner)
        duration = options.seconds or scenario.duration
        if options.seconds is None and isinstance(controller, TrackingController):
            duration = float(controller.plan.trajectory.times[-1])
        with hear_ctrl_c(KEEPING):
            about = controller, scenario, world, disturbance, duration, meshcat, progress
            run = run_in_loop(*about, filters=options.filter)
    status = _answer_run(options, run, meshcat)
    if isinstance(controller, TrackingController) and controller.plan.is_interrupted:
        print(f"of the plan: {show.INTERRUPTED}", flush=True)
        return flags.INTERRUPTED
    return status


def _check_flags(options: argparse.Namespace, disturbance: Disturbance) -> None:
    """Refuses flags that nothing would come of."""
    needs = {
        "--kick": (not disturbance.kick.any() or disturbance.kick_time > 0, "--kick-time above 0"),
        "--kick-time": ("kick_time" not in options or disturbance.kick.any(), "--kick"),
        "--filter": (not options.filter or disturbance.noise.any(), "--noise"),
        "--noise-seed": (options.seed is None or disturbance.noise.any(), "--noise"),
        "--port": (options.port is None or options.live, "--live"),
    }
    for flag, (is_fine, other) in needs.items():
        if not is_fine:
            raise OptionsError(flag, got=f"no {other}", expected=f"{other} with it")
    if options.method == "tracking":
        for name in ("search_every", "horizon"):
            if getattr(options, name) is not None:
                expected = "--method replanning, whose flag it is"
                raise OptionsError(
                    flags.name_flag(name), got="--method tracking", expected=expected
                )


def _make_controller(
    options: argparse.Namespace, planner: Planner
) -> ModelPredictiveController | TrackingController:
    """Returns what was asked for; without a word, what plans again where that can be done."""
    if options.method != "tracking":
        end = planner.scenario.duration
        is_longer = options.seconds is not None and options.seconds > end
        try:
            return ModelPredictiveController(
                planner,
                period=options.period or _DEFAULT_PERIOD,
                horizon=options.horizon or ("receding" if is_longer else "shrinking"),
                search_every=options.search_every,
            )
        except ControlError:
            if options.method or options.search_every or options.horizon:
                raise
    return TrackingController(planner.plan(), planner.world, options.period)


def _answer_run(options: argparse.Namespace, run: ClosedLoopRun, meshcat: Meshcat | None) -> int:
    """Writes and prints a run, and returns the exit status."""
    if options.json:
        run.save(options.json)
    print(paint(show.format_run(run)), flush=True)
    if options.html:
        with show_progress(options, "making the page") as progress:
            page = show.report_run(run, progress)
        write_text(options.html, page)
        print(f"wrote {options.html}", flush=True)
    if meshcat is not None:
        meshcat.Delete(_LIVE)
        print(show.show_run(run, meshcat))
        wait_at(meshcat)
    return flags.INTERRUPTED if run.is_interrupted else flags.FINE
