"""AIGO's boxes behind a plan, run again; and in Drake's Meshcat, where they shrink."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from pydrake.geometry import Box, Meshcat, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_aigto.aigo import AigoResult, Annealing, Iterate, SlowMotion
from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError
from drake_aigto.paper import LiteralOptions, make_literal_task
from drake_aigto.planning import Plan, PlanOptions, ProgramTask, Rung, make_ball_task
from drake_aigto.show.board import make_mesh
from drake_aigto.show.effects import Film
from drake_aigto.show.motion import PALETTE, PLAN_LABEL
from drake_aigto.show.scene import ROOT, clear
from drake_aigto.show.shapes import coordinate_names, wall_places
from drake_aigto.transcription import Transcription
from drake_aigto.world import World

TITLE = "AIGO's boxes: the optimization, not a motion"

_FRAMES_PER_SECOND = 60
_ITERATES, _FRAMES_EACH = 40, 12  # The most that are shown, and how long each takes.
_HOLD = 180  # frames that the end is held

# The picture that boxes stand on, in inches of figure, and how many of these are a meter of the
# scene; the height of a panel for each coordinate, and what is beside and between panels.
_INCHES_PER_METER = 6.0
_WIDTH, _PANEL, _LEFT, _RIGHT, _TOP, _BETWEEN, _BOTTOM = 9.0, 4.2, 0.9, 0.3, 1.1, 0.25, 0.7
_TITLE_TOP, _LEGEND_TOP, _TEXT_TOP, _TEXT = 0.1, 0.48, 0.68, 0.4  # rows of texts above the panels
_DPI = 150
# In meters of the scene: the least height of a box, and what of it stands out; in its own height.
_THINNEST, _DEPTH = 0.008, 0.15
_FILLED = 0.85  # of a time step that its box has
_ROOM = 0.03  # beyond the boxes, as a part of their range

_BOX_COLOR = Rgba(*to_rgb(PALETTE[0]), 0.55)
_PLAN_COLOR, _WALL_COLOR = PALETTE[1], "#8a8f98"
_FIELD_OF_VIEW, _SLACK, _TILT, _TURN = 20.0, 1.06, np.deg2rad(14), np.deg2rad(10)


def play_boxes(
    plan: Plan, meshcat: Meshcat, world: World | None = None, run: BoxRun | None = None
) -> None:
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
    graph = _Graph(run or run_boxes(plan, world), plan, world)
    clear(meshcat)
    X_WF = RigidTransform(RotationMatrix.MakeXRotation(np.pi / 2), [0, 0, 0])
    meshcat.SetTransform(f"{ROOT}/boxes", X_WF)
    low, high = graph.corners
    meshcat.SetObject(f"{ROOT}/boxes/graph", make_mesh(graph.paint(), low, high))
    film = Film(meshcat, 0, graph.last_frame / _FRAMES_PER_SECOND, _FRAMES_PER_SECOND)
    graph.add_boxes(film)
    graph.add_texts(film)
    graph.add_plan(film)
    film.play()
    # From the front, a little from above and from the right.
    width, height = high - low
    distance = _SLACK * max(height, width / 1.4) / 2 / np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2)
    back = np.array([np.sin(_TURN) * np.cos(_TILT), -np.cos(_TURN) * np.cos(_TILT), np.sin(_TILT)])
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=_FIELD_OF_VIEW))
    meshcat.SetCameraPose(distance * back, np.zeros(3))


class _Graph:
    """Panels, one above the other, of positions over time, and what stands on them.

    In its frame x is to the right and y up, from the middle; z is towards the viewer.
    """

    def __init__(self, run: BoxRun, plan: Plan, world: World) -> None:
        self._run, self._plan, self._world = run, plan, world
        self._times = run.transcription.GetSampleTimes()
        boxes = [run.positions(iterate) for iterate in run.result.history]
        q = plan.trajectory.positions
        low = np.min([*(np.min(c - w, axis=0) for c, w in boxes), q.min(axis=0)], axis=0)
        high = np.max([*(np.max(c + w, axis=0) for c, w in boxes), q.max(axis=0)], axis=0)
        room = _ROOM * np.maximum(high - low, 1e-6)
        self._limits = np.column_stack([low - room, high + room])
        # Below half a pixel or so nothing is seen to shrink.
        self._shown = run.pick(_ITERATES, smallest=1e-3 * float(np.max(high - low)))
        # When the last box is reached, and when that has been held for a moment.
        self._end_frame = (len(self._shown) - 1) * _FRAMES_EACH
        self.last_frame = self._end_frame + _HOLD
        self._height = _TOP + _BOTTOM + world.num_positions * (_PANEL + _BETWEEN) - _BETWEEN
        self._axes = self._lay_out()[1]

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """Lower left and upper right of the picture, shape (2,) each [m]."""
        half = np.array([_WIDTH, self._height]) / 2 / _INCHES_PER_METER
        return -half, half

    def _lay_out(self) -> tuple[Figure, list[Axes]]:
        """Returns an empty picture with its panels."""
        figure = Figure(figsize=(_WIDTH, self._height), dpi=_DPI, facecolor="none")
        width = (_WIDTH - _LEFT - _RIGHT) / _WIDTH
        panels = []
        for i, limits in enumerate(self._limits):
            bottom = self._height - _TOP - _PANEL - i * (_PANEL + _BETWEEN)
            place = (_LEFT / _WIDTH, bottom / self._height, width, _PANEL / self._height)
            step = self._times[1] - self._times[0]
            xlim = (self._times[0] - step, self._times[-1] + step)
            panels.append(figure.add_axes(place, xlim=xlim, ylim=limits))
        return figure, panels

    def _place(self, panel: int, points: Floats) -> Floats:
        """Returns where points (k, 2) of time and position are in the graph's frame."""
        pixels = self._axes[panel].transData.transform(points)
        inches = pixels / _DPI - np.array([_WIDTH, self._height]) / 2
        placed: Floats = inches / _INCHES_PER_METER
        return placed

    def paint(self) -> Figure:
        """Returns the picture: scales, walls, start and goal."""
        figure, panels = self._lay_out()
        scenario = self._plan.scenario
        names = coordinate_names(self._world)
        for i, axes in enumerate(panels):
            axes.patch.set_color("white")
            for _, place, side in wall_places(self._world, i):
                axes.axhspan(place, place - side * 100, color=_WALL_COLOR, alpha=0.4, linewidth=0)
            axes.plot(0, scenario.initial_position[i], "s", color="black", markersize=9)
            axes.plot(scenario.duration, scenario.goal_position[i], "*", color="black", ms=18)
            label = "position q [m]" if len(names) == 1 else f"{names[i]} position [m]"
            axes.set_ylabel(label, fontsize=16)
            axes.tick_params(labelsize=14, labelbottom=i == len(panels) - 1)
        panels[-1].set_xlabel("time t [s]", fontsize=16)
        legend = "box: center ± half width;  ■ start  ★ goal"
        figure.text(0.02, 1 - _TITLE_TOP / self._height, TITLE, size=18, weight="bold", va="top")
        figure.text(0.02, 1 - _LEGEND_TOP / self._height, legend, size=13, va="top")
        return figure

    def add_boxes(self, film: Film) -> None:
        """Adds the boxes, and how they shrink."""
        step = self._times[1] - self._times[0]
        iterates = [self._run.positions(self._run.result.history[i]) for i in self._shown]
        for panel in range(len(self._limits)):
            unit = np.diff(self._place(panel, np.array([[0.0, 0.0], [step, 1.0]])), axis=0)[0]
            for knot, time in enumerate(self._times):
                path = f"{ROOT}/boxes/{panel}/{knot}"
                film.meshcat.SetObject(path, Box(_FILLED * unit[0], 1.0, 1.0), _BOX_COLOR)
                for number, (center, half_width) in enumerate(iterates):
                    place = self._place(panel, np.array([[time, center[knot, panel]]]))[0]
                    height = max(_THINNEST, 2 * half_width[knot, panel] * unit[1])
                    depth = _DEPTH * height
                    pose = RigidTransform([*place, depth / 2])
                    frame = number * _FRAMES_EACH
                    film.move(frame, path, pose)
                    film.change(frame, path, "scale", [1.0, height, depth])
                film.move(self.last_frame, path, pose)

    def add_texts(self, film: Film) -> None:
        """Adds what is to be said of each iterate, while it is shown."""
        last = len(self._run.result.history) - 1
        low, high = self.corners
        for number, index in enumerate(self._shown):
            iterate = self._run.result.history[index]
            hot = np.isfinite(iterate.temperature)
            text = f"temperature {iterate.temperature:.1e}, " if hot else ""
            widest = float(np.max(self._run.positions(iterate)[1]))
            text = f"iteration {index} of {last}: {text}widest box ±{widest:.2g} m"
            figure = Figure(figsize=(_WIDTH, _TEXT), dpi=_DPI, facecolor="none")
            figure.text(0.02, 0.5, text, size=13, va="center", color=PALETTE[0], weight="bold")
            path = f"{ROOT}/boxes/texts/{number}"
            top = high[1] - _TEXT_TOP / _INCHES_PER_METER
            corners = (low[0], top - _TEXT / _INCHES_PER_METER), (high[0], top)
            film.meshcat.SetObject(path, make_mesh(figure, *corners))
            self._show_between(path, number * _FRAMES_EACH, (number + 1) * _FRAMES_EACH, film)

    def add_plan(self, film: Film) -> None:
        """Adds the plan, which appears at the end."""
        figure, panels = self._lay_out()
        trajectory = self._plan.trajectory
        for i, axes in enumerate(panels):
            axes.set_axis_off()
            axes.plot(trajectory.times, trajectory.positions[:, i], color=_PLAN_COLOR, linewidth=3)
        look: dict[str, Any] = {"size": 13, "weight": "bold", "color": _PLAN_COLOR, "va": "top"}
        row = 1 - _LEGEND_TOP / self._height
        figure.text(0.98, row, f"polished: {PLAN_LABEL}", ha="right", **look)
        path = f"{ROOT}/boxes/plan"
        film.meshcat.SetObject(path, make_mesh(figure, *self.corners))
        film.meshcat.SetTransform(path, RigidTransform([0, 0, 2 * _THINNEST]))
        self._show_between(path, self._end_frame, self.last_frame + 1, film)

    def _show_between(self, path: str, first: int, end: int, film: Film) -> None:
        """Makes an object visible from a frame until another."""
        end = self.last_frame + 1 if end > self._end_frame else end
        for frame in sorted({0, first, end, self.last_frame}):
            if frame <= self.last_frame:
                film.change(frame, path, "visible", first <= frame < end)


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
        raise _refuse("the options of a search by many short boxes, none of a whole motion")
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
        "the plan's boxes can't be had again",
        got=f"a plan that names {what}",
        expected="its options and the rung that it came from, of a program without additions",
    )
