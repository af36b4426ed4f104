"""A plan's own views: figures, animations, tables, and several plans on one page."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot
from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.figure import Figure

from drake_aigto.errors import ModelError, OptionsError
from drake_aigto.plain import check_writable
from drake_aigto.planning import VIEWS, Plan
from drake_aigto.show import words
from drake_aigto.show.facts import verdict_facts
from drake_aigto.show.figures import plot_plan, plot_positions
from drake_aigto.show.film import open_meshcat
from drake_aigto.show.motion import Motion, color_of, motions_of_plan, positions_at, to_dataframe
from drake_aigto.show.page import Page
from drake_aigto.show.plan_figures import draw_goal, draw_moving, draw_still, plot_strobe
from drake_aigto.show.scene import publish
from drake_aigto.show.shapes import coordinate_names, find_goal
from drake_aigto.show.stage import Stage
from drake_aigto.world import World

_INCH, _DPI = 8.0, 100  # width of figures, and their dots per inch
_WIDTH, _TITLE = 6.0, 0.4  # of an animation, and the height of its title [in]
_LEAST_SHAPE, _MOST_SHAPE = 0.2, 0.83  # its height to its width
_GHOST = 0.35  # how much a ghost covers
_HOLD = 0.5  # that the end stands [s]
_VIDEO = (".mp4", ".m4v", ".mov")
_ANY_PORT = 0


def plot(plan: Plan, world: World | None = None) -> Figure:
    """Returns a figure: the motion in its plane, and positions, velocities and controls.

    Raises:
        ModelError: the world has to be given (`Plan.find_world`).
    """
    world = plan.find_world(world)
    columns = world.num_velocities
    figure = pyplot.figure(figsize=(max(_INCH, 3.2 * columns), 11), layout="constrained")
    above, below = np.array(figure.subfigures(2, 1, height_ratios=[1, 2])).tolist()
    plot_strobe(above.subplots(), motions_of_plan(plan, world)[0], world, plan.scenario)
    plot_plan(below.subplots(3, columns, sharex=True, squeeze=False), plan, world)
    figure.suptitle(words.plan_name(plan.scenario, world))
    pyplot.close(figure)  # A notebook shows what a cell returns, once.
    return figure


def animate(
    plan: Plan,
    path: str | Path,
    world: World | None = None,
    rate: int = 25,
    speed: float = 1.0,
    width: float = _WIDTH,
    has_title: bool = True,
) -> Path:
    """Writes the plan's motion, solid, and its first simulation, a ghost; returns the path.

    Args:
        plan: to show.
        path: .gif, .webp or .apng, or a video: .mp4, .m4v or .mov.
        world: see `Plan.find_world`.
        rate: frames per second.
        speed: of the motion; 0.5 is slow motion.
        width: of the picture, in hundreds of pixels.
        has_title: whether time and labels stand above.

    Raises:
        ModelError: the world has to be given.
        OptionsError: there is no ffmpeg for a video, or nothing that writes such a file; or a
            number is not positive.
        OutputFileError: the file can't be written.
    """
    for name, value in {"rate": rate, "speed": speed, "width": width}.items():
        if not value > 0:
            raise OptionsError(f"`{name}` of an animation", got=value, expected="more than 0")
    path, world = Path(path), plan.find_world(world)
    writer = _find_writer(path, rate)
    check_writable(path)
    planned, *simulated = motions_of_plan(plan, world)
    motions = [planned, *simulated[:1]]
    goal = find_goal(world, plan.scenario, planned.positions[-1])
    stage = Stage(world, np.vstack([goal, *(motion.positions for motion in motions)]))
    across, up = (stage.high - stage.low).tolist()
    shape = np.clip(up / across, _LEAST_SHAPE, _MOST_SHAPE)
    size = width, float(width * shape) + _TITLE * has_title
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    draw_still(axes, stage, planned.positions[0])
    draw_goal(axes, stage, world, plan.scenario, goal)
    for index, motion in enumerate(motions):
        for way in stage.trace(motion.positions):
            look: dict[str, Any] = {"color": color_of(index), "zorder": 1.5 - index / 10}
            axes.plot(*way[:, :2].T, linewidth=1.2, alpha=0.7, **look)
    (left, bottom), (right, top) = stage.low, stage.high
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    axes.set_axis_off()
    ghost = f"; ghost: {simulated[0].label}" if simulated else ""
    end = float(planned.times[-1])
    times = np.arange(0.0, end / speed + _HOLD, 1 / rate) * speed
    with writer.saving(figure, str(path), _DPI):
        for time in np.minimum(times, end):
            patches = []
            for index, motion in reversed(list(enumerate(motions))):
                (q,) = positions_at(motion, np.array([time]))
                patches += draw_moving(axes, stage, q, index, _GHOST if index else 1.0)
            if has_title:
                title = f"{time:.2f} s   solid: {planned.label}{ghost}"
                axes.set_title(title, fontsize="small")
            writer.grab_frame()
            for patch in patches:
                patch.remove()
    return path


def _find_writer(path: Path, rate: int) -> AbstractMovieWriter:
    """Returns what writes files of this kind."""
    if path.suffix in (".gif", ".webp", ".apng"):
        return PillowWriter(fps=rate)
    if path.suffix not in _VIDEO:
        kinds = ".gif, .webp, .apng or .mp4"
        raise OptionsError("the animation's file", got=path.name, expected=f"one of {kinds}")
    program = shutil.which("ffmpeg")
    if program is None:
        try:
            from imageio_ffmpeg import get_ffmpeg_exe
        except ImportError:
            raise OptionsError(
                f"a video, {path.name}",
                got="no ffmpeg",
                expected="one on the path, or the extra `video`",
                remedy="pip install 'drake_aigto[video]', or write a .gif or .webp.",
            ) from None
        program = str(get_ffmpeg_exe())
    mpl.rcParams["animation.ffmpeg_path"] = program
    return FFMpegWriter(fps=rate)


def to_html(plan: Plan, world: World | None = None) -> str:
    """Returns both verdicts, the numbers behind them, and a picture, for a notebook."""
    world = plan.find_world(world)
    page = Page("")
    add_verdict(page, plan, world)
    figure = Figure(figsize=(_INCH, 4), layout="constrained")
    motion = motions_of_plan(plan, world)[0]
    plot_strobe(figure.subplots(), motion, world, plan.scenario)
    page.figure(figure, "Links at evenly spaced times, the early ones pale; the goal is dashed.")
    return page.to_fragment()


def add_verdict(page: Page, plan: Plan, world: World) -> None:
    """Adds whether simulations confirm a plan, and what a reader has to know beside that."""
    (_, verdict), (_, goal), *others = verdict_facts(plan, world)
    page.verdict(verdict, plan.holds)
    page.verdict(f"goal {goal}", plan.find_arrival(world).is_reached)
    page.facts(others)


def compare(plans: Mapping[str, Plan], world: World | None = None) -> Page:
    """Returns a page about several plans in one world: in one scene, and side by side.

    A notebook shows it in a frame; `Page.to_html` is a file's content.

    Raises:
        ModelError: the world has to be given, or a plan is of another world.
    """
    if not plans:
        raise OptionsError("plans", got="none", expected="at least one")
    first, *_ = plans.values()
    world = first.find_world(world)
    for name, plan in plans.items():
        try:
            plan.find_world(world)
        except ModelError as error:
            expected = f"plans for the world of {next(iter(plans))}"
            raise ModelError(
                "plans on one page", got=f"{name}: {error}", expected=expected
            ) from error
    asked = dict.fromkeys(words.plan_name(plan.scenario, world) for plan in plans.values())
    page = Page(f"Plans for {words.join_words([*asked])}: {', '.join(plans)}")
    numbers = ("cost J", "dynamics defect", "deepest penetration", "energy ratio", "J simulated")
    header = ("", "holds", "goal", *numbers, "off the goal", "touches")
    rows = []
    for name, plan in plans.items():
        reached = "reached" if plan.find_arrival(world).is_reached else "not reached"
        simulated = words.cost_text(plan.replay.event_driven.cost, 3, plan.best.scales.cost)
        worth = (*words.run_texts(plan.best, 3), simulated)
        miss = words.miss_text(plan.best, plan.scenario, world)
        verdict = "holds" if plan.holds else "fails"
        rows.append((name, verdict, reached, *worth, miss, words.sequence_text(plan.best, world)))
    page.table(header, rows)
    motions = [
        Motion.from_trajectory(plan.trajectory, world, f"{name}: plan (not a simulation)")
        for name, plan in plans.items()
    ]
    recording = publish(motions, open_meshcat(_ANY_PORT), world, first.scenario)
    page.scenes({"Plans": recording.scene})
    for i, name in enumerate(coordinate_names(world)):
        figure = Figure(figsize=(_INCH + 1, 3.2), layout="constrained")
        plot_positions(figure.subplots(), motions, world, first.scenario, i)
        page.figure(figure, f"Position of {name}.")
    return page


def fill_views() -> None:
    """Gives plans their views (`planning.VIEWS`): they can't import this room."""
    VIEWS.update(plot=plot, animate=animate, to_dataframe=to_dataframe, to_html=to_html)
