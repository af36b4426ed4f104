"""``drake-aigto control``."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from drake_aigto.cli.flags import (
    FINE,
    INTERRUPTED,
    add_command,
    add_json,
    add_port,
    natural,
    positive,
    seconds,
)
from drake_aigto.cli.play import wait_at
from drake_aigto.cli.progress import show_progress
from drake_aigto.cli.scenario_flags import add_scenario, load_scenario
from drake_aigto.control import (
    ClosedLoopRun,
    Disturbance,
    ModelPredictiveController,
    TrackingController,
    run_in_loop,
)
from drake_aigto.errors import ControlError, OptionsError
from drake_aigto.output import check_writable, write_text
from drake_aigto.planning import Planner, PlanOptions
from drake_aigto.show import INTERRUPTED as CUT_SHORT
from drake_aigto.world import World

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

_LIVE = "visualizer"  # where Drake's own visualizer draws what moves

_EXAMPLES = """\
drake-aigto control cart_pole/soft_06                                 # plan again as it moves
drake-aigto control cart_pole/soft_06 --kick 0.3 1.5 --kick-time 0.5 --html run.html
drake-aigto control cart_pole/soft_06 --method tracking --mass-factor 1.1 --json run.json
drake-aigto control table1/1 --wall-shift 0.01 --live                 # in Meshcat
"""
# Field of `Disturbance` → what it is. Those of several numbers take one a coordinate.
_DISTURBANCES = {
    "start_offset": "added to q(0), one number a coordinate [m, rad]",
    "mass_factor": "of the masses of all that moves",
    "friction_factor": "of all friction",
    "wall_shift": "how much nearer all walls stand [m]",
    "restitution_factor": "of the scenario's restitution",
    "kick": "by how much v jumps, one number a coordinate [m/s, rad/s]",
    "kick_time": "when it does [s]",
    "noise": "standard deviations of what the controller is told of q, then of v",
    "noise_seed": "of the noise (default: 0)",
}
_ROWS = ("start_offset", "kick", "noise")
_DEFAULT_PERIOD = 0.01  # [s]


def add_control(commands: Any) -> None:
    """Adds the command that closes the loop."""
    text = "simulate a plant under a controller that plans again, or tracks a plan, in Drake"
    control = add_command(commands, "control", _control, text, _EXAMPLES)
    add_scenario(control)
    _add_controller(control.add_argument_group("controller"))
    unknown = control.add_argument_group("what the controller does not know")
    for name, text in _DISTURBANCES.items():
        look: dict[str, Any] = {"type": float, "metavar": "X"}
        if name in _ROWS:
            look["nargs"] = "+"
        elif name == "noise_seed":
            look = {"type": natural, "metavar": "N"}
        unknown.add_argument(f"--{name.replace('_', '-')}", help=text, **look)
    add_json(control, "write the log: motion, controls, ticks, plans at switches")
    control.add_argument("--html", metavar="FILE", help="write one self-contained page")
    text = "show the plant in Meshcat as it moves, in real time, and wait"
    control.add_argument("--live", action="store_true", help=text)
    add_port(control)


def _add_controller(group: Any) -> None:
    text = "plan again at every tick, or track one plan (default: the first where it can be done)"
    group.add_argument("--method", choices=["replanning", "tracking"], help=text)
    text = "how long to simulate (default: the scenario's duration) [s]"
    group.add_argument("--seconds", type=seconds, metavar="X", help=text)
    text = (
        f"between ticks [s] (default: {_DEFAULT_PERIOD:g}; of tracking, the scenario's time step)"
    )
    group.add_argument("--period", type=seconds, metavar="X", help=text)
    text = "replanning: ticks from one search to the next (default: only where costs rise)"
    group.add_argument("--search-every", type=positive, metavar="N", help=text)
    text = (
        "replanning: ends with the scenario, or always lasts as long "
        "(default: receding, if it is simulated for longer)"
    )
    group.add_argument("--horizon", choices=["shrinking", "receding"], help=text)
    text = "how many renewals a search has at most (default: the planner's)"
    group.add_argument("--renewals", type=natural, metavar="N", help=text)


def _control(options: argparse.Namespace) -> int:
    check_writable(options.json)
    check_writable(options.html)
    scenario = load_scenario(options)
    given = {name: getattr(options, name) for name in _DISTURBANCES}
    given = {name: value for name, value in given.items() if value is not None}
    if "noise_seed" in given:
        given["seed"] = given.pop("noise_seed")
    disturbance = Disturbance(**given)
    _check_flags(options, disturbance)
    world = World.from_scenario(scenario)
    disturbance.apply(world, scenario)  # Refused before long work.
    numerics = None if options.renewals is None else PlanOptions(renewals=options.renewals)
    planner = Planner(scenario, numerics, world)
    meshcat = None
    if options.live:  # A browser may look at it from the start on.
        from drake_aigto.show import open_meshcat

        meshcat = open_meshcat(options.port)
        print(f"Meshcat shows it at {meshcat.web_url()}", flush=True)
    with show_progress(options, "planning") as progress:
        controller = _make_controller(options, planner)
        duration = options.seconds or scenario.duration
        if options.seconds is None and isinstance(controller, TrackingController):
            duration = float(controller.plan.trajectory.times[-1])
        run = run_in_loop(controller, scenario, world, disturbance, duration, meshcat, progress)
    status = _answer(options, run, meshcat)
    if isinstance(controller, TrackingController) and controller.plan.is_interrupted:
        print(f"of the plan: {CUT_SHORT}", flush=True)
        return INTERRUPTED
    return status


def _check_flags(options: argparse.Namespace, disturbance: Disturbance) -> None:
    """Refuses flags that nothing would come of."""
    needs = {
        "--kick-time": (options.kick_time is None or disturbance.kick.any(), "--kick"),
        "--noise-seed": (options.noise_seed is None or disturbance.noise.any(), "--noise"),
        "--port": (options.port is None or options.live, "--live"),
    }
    for flag, (is_fine, other) in needs.items():
        if not is_fine:
            raise OptionsError(flag, got=f"no {other}", expected=f"{other} with it")
    if options.method == "tracking":
        for name in ("search_every", "horizon"):
            if getattr(options, name) is not None:
                flag = f"--{name.replace('_', '-')}"
                expected = "--method replanning, whose flag it is"
                raise OptionsError(flag, got="--method tracking", expected=expected)


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


def _answer(options: argparse.Namespace, run: ClosedLoopRun, meshcat: Meshcat | None) -> int:
    """Writes and prints a run, and returns the exit status."""
    from drake_aigto.show import format_run, report_run, show_run

    if options.json:
        run.save(options.json)
    print(format_run(run), flush=True)
    if options.html:
        with show_progress(options, "making the page") as progress:
            page = report_run(run, progress)
        write_text(options.html, page)
        print(f"wrote {options.html}", flush=True)
    if meshcat is not None:
        meshcat.Delete(_LIVE)
        show_run(run, meshcat)
        wait_at(meshcat)
    return INTERRUPTED if run.is_interrupted else FINE
