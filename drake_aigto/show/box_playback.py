"""AIGO's boxes behind a plan, run again; and in Drake's Meshcat, where they shrink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from pydrake.geometry import Box, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_aigto.aigo import AigoResult, Annealing, Iterate, SlowMotion
from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError
from drake_aigto.paper import LiteralOptions, make_literal_task
from drake_aigto.planning import Plan, PlanOptions, ProgramTask, Rung, make_ball_task
from drake_aigto.show.film import ROOT, Film, look_at, make_mesh
from drake_aigto.show.motion import PALETTE, PLAN_LABEL
from drake_aigto.show.page import Playback
from drake_aigto.show.shapes import coordinate_names, wall_places
from drake_aigto.transcription import Transcription
from drake_aigto.world import World

TITLE = "AIGO's boxes: the optimization, not a motion"

_FRAMES_PER_SECOND = 60
_ITERATES, _FRAMES_EACH = 40, 12  # The most that are shown, and how long each takes.
_LAST = 150  # frames that the plan is shown

# The picture that boxes stand on, in inches of figure, and how many of these are a meter of the
# scene; the height of a panel for each coordinate, and of the texts above them.
_INCHES_PER_METER = 6.0
_WIDTH, _PANEL, _TEXTS, _DPI = 9.0, 4.4, 1.2, 150
_LEGEND, _ITERATE = 0.45, 0.72  # From the top to these rows of texts.
# In meters of the scene: the least height of a box, and what of it stands out; in its own height.
_THINNEST, _DEPTH = 0.008, 0.15
_FILLED = 0.85  # of a time step that its box has

_BOX_COLOR = Rgba(*to_rgb(PALETTE[0]), 0.55)
_PLAN_COLOR, _WALL_COLOR = PALETTE[1], "#8a8f98"
_VIEW, _TILT, _TURN = np.deg2rad([20.0, 14.0, 10.0])


def play_boxes(
    plan: Plan, meshcat: Meshcat, world: World | None = None, run: BoxRun | None = None
) -> Playback:
    """Shows how AIGO's boxes shrank onto a plan, with a slider over iterations.

    For each coordinate, a box for each knot stands on a graph of position over time. Not every
    iteration is shown, but such that boxes shrink evenly; where they have become too small to be
    seen, the plan that was polished from them appears. What was shown below `ROOT` is gone.

    The world has to be given where `Plan.find_world` asks for it; the boxes are run again
    (`run_boxes`) if they are not given.

    Raises:
        ModelError: from `Plan.find_world`.
    """
    world = plan.find_world(world)
    run = run or run_boxes(plan, world)
    q = plan.trajectory.positions
    boxes = [run.positions(iterate) for iterate in run.result.history]
    low = np.min([q.min(axis=0), *((c - w).min(axis=0) for c, w in boxes)], axis=0)
    high = np.max([q.max(axis=0), *((c + w).max(axis=0) for c, w in boxes)], axis=0)
    figure = _paint(run, plan, world, low, high)
    # Below half a pixel or so nothing is seen to shrink.
    shown = run.pick(_ITERATES, smallest=1e-3 * float(np.max(high - low)))
    end = (len(shown) - 1) * _FRAMES_EACH
    film = Film(meshcat, 0, (end + _LAST) / _FRAMES_PER_SECOND, _FRAMES_PER_SECOND)
    turned = RotationMatrix.MakeXRotation(np.pi / 2)
    meshcat.SetTransform(f"{ROOT}/boxes", RigidTransform(turned, np.zeros(3)))
    corner = np.array(figure.get_size_inches()) / 2 / _INCHES_PER_METER
    meshcat.SetObject(f"{ROOT}/boxes/graph", make_mesh(figure, -corner, corner))
    _add_boxes(film, figure, run, shown)
    _add_texts(film, run, shown, corner)
    # The plan appears at the end, on the same axes.
    figure = _paint(run, plan, world, low, high)
    figure.texts.clear()
    for i, axes in enumerate(figure.axes):
        limits = axes.get_xlim(), axes.get_ylim()
        axes.clear()
        axes.set_axis_off()
        axes.plot(plan.trajectory.times, q[:, i], color=_PLAN_COLOR, linewidth=3)
        axes.set(xlim=limits[0], ylim=limits[1])
    look: dict[str, Any] = {"size": 13, "weight": "bold", "color": _PLAN_COLOR, "va": "top"}
    height = 1 - _LEGEND / figure.get_figheight()
    figure.text(0.98, height, f"polished: {PLAN_LABEL}", ha="right", **look)
    meshcat.SetObject(f"{ROOT}/boxes/plan", make_mesh(figure, -corner, corner))
    meshcat.SetTransform(f"{ROOT}/boxes/plan", RigidTransform([0, 0, 2 * _THINNEST]))
    film.show_between(f"{ROOT}/boxes/plan", end, film.last_frame + 1)
    film.play()
    # From the front, a little from above and from the right.
    frame = RigidTransform(turned, np.zeros(3))
    unit = look_at(meshcat, frame, (-corner, corner), (_VIEW, _TILT, _TURN))
    return Playback(meshcat, {"reach": [(corner / unit).tolist()]})


def _paint(run: BoxRun, plan: Plan, world: World, low: Floats, high: Floats) -> Figure:
    """Returns the picture: scales from low to high positions, walls, start and goal."""
    times, names, scenario = (
        run.transcription.GetSampleTimes(),
        coordinate_names(world),
        plan.scenario,
    )
    height = _TEXTS + _PANEL * world.num_positions
    figure = Figure(figsize=(_WIDTH, height), dpi=_DPI, facecolor="none")
    edges = {"top": 1 - _TEXTS / height, "bottom": 0.7 / height}
    figure.subplots_adjust(left=0.1, right=0.97, hspace=0.06, **edges)
    room = 0.03 * np.maximum(high - low, 1e-6)
    for i, axes in enumerate(figure.subplots(world.num_positions, 1, squeeze=False)[:, 0]):
        axes.patch.set_color("white")
        for _, place, side in wall_places(world, i):
            axes.axhspan(place, place - side * 100, color=_WALL_COLOR, alpha=0.4, linewidth=0)
        axes.plot(0, scenario.initial_position[i], "s", color="black", markersize=9)
        axes.plot(scenario.duration, scenario.goal_position[i], "*", color="black", ms=18)
        label = "position q [m]" if len(names) == 1 else f"{names[i]} position [m]"
        axes.set_ylabel(label, fontsize=16)
        axes.tick_params(labelsize=14, labelbottom=i == len(names) - 1)
        axes.set(xlim=(2 * times[0] - times[1], 2 * times[-1] - times[-2]))
        axes.set(ylim=(low[i] - room[i], high[i] + room[i]))
    axes.set_xlabel("time t [s]", fontsize=16)
    legend = "box: center ± half width;  ■ start  ★ goal"
    figure.text(0.02, 1 - 0.1 / height, TITLE, size=18, weight="bold", va="top")
    figure.text(0.02, 1 - _LEGEND / height, legend, size=13, va="top")
    return figure


def _add_boxes(film: Film, figure: Figure, run: BoxRun, shown: list[int]) -> None:
    """Adds the boxes on the axes of a figure, and how they shrink."""
    times, middle = run.transcription.GetSampleTimes(), np.array(figure.bbox.size) / 2
    iterates = [run.positions(run.result.history[i]) for i in shown]
    for panel, axes in enumerate(figure.axes):

        def place(points: Any, axes: Any = axes) -> Floats:
            """Returns where points (k, 2) of time and position are, in the graph's frame."""
            pixels = axes.transData.transform(points) - middle
            return np.asarray(pixels / _DPI / _INCHES_PER_METER)

        unit = np.diff(place([[0.0, 0.0], [times[1] - times[0], 1.0]]), axis=0)[0]
        for knot, time in enumerate(times):
            path = f"{ROOT}/boxes/{panel}/{knot}"
            film.meshcat.SetObject(path, Box(_FILLED * unit[0], 1.0, 1.0), _BOX_COLOR)
            for number, (center, half_width) in enumerate(iterates):
                height = max(_THINNEST, 2 * half_width[knot, panel] * unit[1])
                depth = _DEPTH * height
                pose = RigidTransform([*place([[time, center[knot, panel]]])[0], depth / 2])
                film.move(number * _FRAMES_EACH, path, pose)
                film.change(number * _FRAMES_EACH, path, "scale", [1.0, height, depth])
            film.move(film.last_frame, path, pose)


def _add_texts(film: Film, run: BoxRun, shown: list[int], corner: Floats) -> None:
    """Adds what is to be said of each iterate, while it is shown; of the last one, to the end."""
    top, size = corner[1] - _ITERATE / _INCHES_PER_METER, (_WIDTH, 0.4)
    for number, index in enumerate(shown):
        iterate = run.result.history[index]
        hot = np.isfinite(iterate.temperature)
        text = f"temperature {iterate.temperature:.1e}, " if hot else ""
        widest = float(np.max(run.positions(iterate)[1]))
        text = f"iteration {index} of {shown[-1]}: {text}widest box ±{widest:.2g} m"
        figure = Figure(figsize=size, dpi=_DPI, facecolor="none")
        figure.text(0.02, 0.5, text, size=13, va="center", color=PALETTE[0], weight="bold")
        path, low = f"{ROOT}/boxes/texts/{number}", (-corner[0], top - size[1] / _INCHES_PER_METER)
        film.meshcat.SetObject(path, make_mesh(figure, low, (corner[0], top)))
        is_last = number == len(shown) - 1
        end = film.last_frame if is_last else (number + 1) * _FRAMES_EACH
        film.show_between(path, number * _FRAMES_EACH, end + is_last)


@dataclass(frozen=True, eq=False)
class BoxRun:
    """One run of AIGO on a scenario.

    Attributes:
        problem: that was solved.
        rung: of the ladder.
        transcription: knows which of the boxes' variables are which.
        result: with all boxes, the first and the last included; of an annealing, those after
            every Newton step.
    """

    problem: ProgramTask
    rung: Rung
    transcription: Transcription
    result: AigoResult

    def positions(self, iterate: Iterate) -> tuple[Floats, Floats]:
        """Returns centers and half widths of the boxes around q, shape (N+1, nq) each [m]."""
        box = iterate.box
        return self.transcription.split(box.center)[0], self.transcription.split(box.half_width)[0]

    def pick(self, count: int, smallest: float = 0.0) -> list[int]:
        """Returns which iterates show best how the boxes shrink: evenly, by the logarithm of size.

        They are places in `result.history`, increasing, at most `count`, the first and the last one
        included. Where the widest box around q is narrower than twice the smallest [m], iterates
        count as equal.
        """
        widths = [np.max(self.positions(each)[1]) for each in self.result.history]
        sizes = np.log(np.maximum(widths, max(smallest, np.finfo(float).tiny)))
        levels = np.linspace(sizes[0], sizes.min(), count - 1)
        found = [int(np.argmax(sizes <= level + 1e-9)) for level in levels]
        return sorted({*found, len(sizes) - 1})


def run_boxes(plan: Plan, world: World | None = None) -> BoxRun:
    """Runs that rung of AIGO's ladder again which the plan came from: the same boxes.

    Raises:
        OptionsError: the boxes can't be run again; says why.
        ModelError: the world has to be given (`Plan.find_world`).
    """
    world, rung = plan.find_world(world), plan.best.origin.rung
    if plan.options is None:
        raise _refuse("no options")
    if plan.transcription == "shooting":
        raise _refuse("a search by shooting, which has no boxes")
    if not isinstance(rung, Rung):
        raise _refuse("no rung of AIGO's ladder")
    if plan.additions:
        names = ", ".join(plan.additions)
        raise _refuse(f"costs or constraints of one's own, by name only ({names})")
    problem: ProgramTask
    if isinstance(plan.options, LiteralOptions):
        problem = make_literal_task(world, plan.scenario, plan.options)
    else:
        assert isinstance(plan.options, PlanOptions)
        problem = make_ball_task(world, plan.scenario, plan.options)
    algorithm = problem.make_algorithm(rung)
    if isinstance(algorithm, Annealing):
        algorithm = SlowMotion(algorithm)
    result = problem.run_aigo(rung, algorithm)
    return BoxRun(problem, rung, problem.start(rung.start).transcription, result)


def _refuse(what: str) -> OptionsError:
    return OptionsError(
        "the plan's boxes can't be run again",
        got=f"a plan that names {what}",
        expected="its options and the rung that it came from, of a program without additions",
    )
