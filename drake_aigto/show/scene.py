"""Playback in Drake's Meshcat: a copy of the world for each motion, at real speed."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform

from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError
from drake_aigto.output import write_text
from drake_aigto.planning import Plan
from drake_aigto.show.board import Board, Panel
from drake_aigto.show.effects import Effects, Film
from drake_aigto.show.motion import (
    DOT_SECONDS,
    Motion,
    color_of,
    find_legs,
    motions_of_plan,
    time_span,
)
from drake_aigto.show.page import Page
from drake_aigto.show.shapes import Actor, find_goal, has_goal, moves_straight
from drake_aigto.show.stage import Stage
from drake_aigto.show.text import touch_names
from drake_aigto.world import Scenario, World

# All that is drawn lies below this path.
ROOT = "/drake_aigto"

# Frames are keyed where a motion has rows; between two of them the browser moves straight on.
_FRAMES_PER_SECOND = 1000
# The end is held for a moment [s], then all motions start again, together: one length for all.
_HOLD = 0.5

# Seen from afar, as walls hide less then; from aside by this; in a window of this width to height;
# and this much farther back.
_FIELD_OF_VIEW = 12.0  # vertical [deg]
_TILT = np.deg2rad(12.0)
_ASPECT_RATIO = 1.4
_SLACK = 1.08
_LIFT = 0.1  # of the board from what is farthest back, in radii of what moves

_GRAY = Rgba(0.6, 0.6, 0.6)  # of what has no color of its own
# Ghosts of the links where they start, and where they should end.
_GHOSTS = {"start": Rgba(0.3, 0.3, 0.3, 0.25), "goal": Rgba(0.0, 0.62, 0.35, 0.3)}
_MOST_NAMES = 6  # of contacts on a panel: more would cover each other
# In heights of what moves along a line: the first leg of its way above its middle, from leg to leg
# at most, and all of them.
_FIRST_LEG, _NEXT_LEG, _ALL_LEGS = 0.8, 0.4, 1.0

_PORTS = 1024, 65535  # That any user may listen at.


def open_meshcat(port: int | None = None) -> Meshcat:
    """Returns a Meshcat that browsers of this machine can open (`Meshcat.web_url`).

    Args:
        port: where it listens: any free one if 0, the first free one from 7000 to 7999 if None.

    Raises:
        OptionsError: the port is in use, or no user may listen there.
    """
    got = "none of 7000 to 7999 that is free" if port is None else f"{port}, in use"
    cause: RuntimeError | None = None
    # Drake ends the process below, and takes the port's last 16 bits above.
    if port and not _PORTS[0] <= port <= _PORTS[1]:
        got = f"{port}"
    else:
        try:
            return Meshcat(port=port)
        except RuntimeError as error:
            cause = error
    raise OptionsError(
        "Meshcat's port",
        got=got,
        expected=f"a free one, {_PORTS[0]} to {_PORTS[1]}",
        remedy="Name another port, or 0 for any that is free.",
    ) from cause


def play(
    plan: Plan, meshcat: Meshcat, world: World | None = None, beside: Sequence[Motion] = ()
) -> None:
    """Shows a plan, labeled as no simulation, and what simulations made of its control.

    Motions of the same world to compare with, such as `gradient_motions` returns, are shown beside
    them; of the plan's simulations then only the exactly rigid one.

    Raises:
        ModelError: the world has to be given (`Plan.find_world`).
    """
    world = plan.find_world(world)
    planned, *simulated = motions_of_plan(plan, world)
    control = plan.trajectory.times, plan.trajectory.controls
    motions = [planned, *(motion.under(*control) for motion in simulated)]
    if beside:
        ours = [dataclasses.replace(each, label=f"AIGTO: {each.label}") for each in motions[:2]]
        motions = [*ours, *beside]
    publish(motions, meshcat, world, plan.scenario)


def publish(motions: Sequence[Motion], meshcat: Meshcat, world: World, scenario: Scenario) -> None:
    """Publishes one recording, with a time slider, of several motions of the same world.

    Each motion has a copy of the world, so that none hides another: its links and walls in their
    own colors (balls in that of their motion), before a panel with its planned contacts. Dots are
    where bodies were every 0.05 s. Transparent ghosts are the start (gray) and the goal (green): a
    coordinate whose goal has no weight is there as it ends, and links that no weighted one moves
    have no ghost. Arrows, arcs and flashes are control, contact and impacts (`Effects`). Friction
    is shown by its cones in a folder "friction" of each motion, which Meshcat's controls can hide.
    The camera sees all of it. What was shown below `ROOT` before is gone.
    """
    goals = (find_goal(world, scenario, motion.positions[-1]) for motion in motions)
    rows = [scenario.initial_position, *goals, *(motion.positions for motion in motions)]
    stage = Stage(world, np.vstack(rows))
    begin, end = time_span(motions)
    film = Film(meshcat, begin, end + _HOLD, _FRAMES_PER_SECOND)
    effects = Effects(stage, world, scenario, motions, film)
    board = _lay_board(stage, motions, world, scenario, effects.notes)
    clear(meshcat)
    meshcat.SetObject(f"{ROOT}/board", board.mesh())
    lift = RigidTransform([0.0, 0.0, _LIFT * stage.radius])
    meshcat.SetTransform(f"{ROOT}/board", stage.X_WT @ lift)
    for index, motion in enumerate(motions):
        aside = RigidTransform(stage.X_WT.rotation() @ board.offset(index))
        _add_copy(stage, film, world, scenario, motion, index, aside)
        effects.add(index, aside, f"{ROOT}/motions/{index + 1}")
    film.play()
    # Looks at the board's middle, from a little below a level one or above an upright one.
    low, high = board.corners
    distance = _SLACK * float(np.max((high - low) / [_ASPECT_RATIO, 1.0])) / 2
    distance /= np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2)
    tilt = -_TILT if abs(stage.X_WT.rotation().matrix()[2, 2]) > 0.5 else _TILT
    middle = np.append((low + high) / 2, 0.0)
    eye = middle + distance * np.array([0.0, np.sin(tilt), np.cos(tilt)])
    camera = Meshcat.PerspectiveCamera(fov=_FIELD_OF_VIEW, near=distance / 100, far=2 * distance)
    meshcat.SetCamera(camera)
    meshcat.SetCameraPose(stage.X_WT.multiply(eye), stage.X_WT.multiply(middle))


def save_html(meshcat: Meshcat, path: str | os.PathLike[str]) -> None:
    """Writes what Meshcat shows to one self-contained page with a slider, whole or not at all.

    Raises:
        OutputFileError: it can't be written; its folder must exist.
    """
    page = Page("A plan and simulations of its control")
    page.scenes({"Recording": meshcat.StaticHtml()})
    write_text(path, page.to_html())


def clear(meshcat: Meshcat) -> None:
    """Removes what was shown below `ROOT`, and hides Meshcat's own grid, axes and background."""
    meshcat.Delete(ROOT)
    for path in ("/Background", "/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)


def _lay_board(
    stage: Stage, motions: Sequence[Motion], world: World, scenario: Scenario, notes: Sequence[str]
) -> Board:
    """Returns the board that the motions need, with the columns at which it is seen largest."""
    end = find_goal(world, scenario, motions[0].positions[-1])
    marks = stage.trace(np.array([scenario.initial_position, end]))[..., :2]
    # A place that a coordinate without weight moves is not asked for.
    free = ~has_goal(world, scenario)
    is_free = [np.any(stage.movers_of(body) & free) for body, _ in stage.tracers]
    marks[is_free, 1] = np.nan
    board = Board(
        panels=[_fill_panel(stage, motion, world) for motion in motions],
        low=stage.low,
        high=stage.high,
        depth=stage.depth,
        radius=stage.radius,
        names=stage.tracer_names,
        starts=marks[:, 0],
        goals=marks[:, 1],
        notes=[f"dots: every {DOT_SECONDS:g} s", *notes],
        columns=1,
        has_lanes=stage.is_line,
    )

    def find_scale(board: Board) -> float:
        """Returns how large a meter is on a board that fills a window, in the window's heights."""
        width, height = np.subtract(*board.corners[::-1])
        return float(min(_ASPECT_RATIO / width, 1 / height))

    columns = range(1, len(motions) + 1)
    return max((dataclasses.replace(board, columns=n) for n in columns), key=find_scale)


def _fill_panel(stage: Stage, motion: Motion, world: World) -> Panel:
    """Returns the ways of a motion, of what moves along a line leg beside leg, and its contacts."""
    legs = find_legs(motion, motion.impacts if stage.is_line else ())
    dots = [stage.trace(leg)[..., :2] for leg in legs]
    ways = stage.trace(motion.positions)[..., :2]
    if stage.is_line:
        apart = min(_NEXT_LEG, _ALL_LEGS / len(legs))
        for number, leg in enumerate(dots):
            leg[..., 1] += (_FIRST_LEG - number * apart) * stage.height
        ways = np.concatenate(dots, axis=1)
    touches, names = motion.touches[:_MOST_NAMES], touch_names(world)
    return Panel(
        label=motion.label,
        ways=list(ways),
        dots=np.vstack([places for leg in dots for places in leg]),
        touches=stage.place_touches(motion, touches),
        touch_names=[f"{names[touch.contact]}, {touch.start:.2f} s" for touch in touches],
    )


def _add_copy(
    stage: Stage,
    film: Film,
    world: World,
    scenario: Scenario,
    motion: Motion,
    index: int,
    aside: RigidTransform,
) -> None:
    """Adds a copy of the world, moved aside: what stands still, ghosts, and links as they move.

    Links have their own colors, but balls and what has none that of the motion. Only those have a
    ghost at the goal that a coordinate asked for moves.
    """
    has_own_colors, asked_for = not moves_straight(world), has_goal(world, scenario)
    first, last = motion.positions[[0, -1]]
    goal, color = find_goal(world, scenario, last), Rgba(*to_rgb(color_of(index)))
    # Of several rows in one frame the last one counts.
    rows = {film.frame(time): q for time, q in zip(motion.times, motion.positions, strict=True)}
    rows[film.last_frame] = last

    def add(actor: Actor, folder: str, q: Floats, color: Rgba | None) -> str:
        path = f"{ROOT}/{folder}/{actor.name}"
        film.meshcat.SetObject(path, actor.shape, color or _GRAY)
        film.meshcat.SetTransform(path, aside @ stage.pose(actor, q))
        return path

    for actor in stage.actors:
        if not actor.moves:
            add(actor, f"worlds/{index + 1}", first, actor.color)
            continue
        add(actor, f"ghosts/{index + 1}/start", scenario.initial_position, _GHOSTS["start"])
        if np.any(stage.movers_of(actor.index) & asked_for):
            add(actor, f"ghosts/{index + 1}/goal", goal, _GHOSTS["goal"])
        own = actor.color if has_own_colors else None
        path = add(actor, f"motions/{index + 1}", first, own or color)
        for frame, q in rows.items():
            film.move(frame, path, aside @ stage.pose(actor, q))
