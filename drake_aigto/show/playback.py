"""Playback in Drake's Meshcat: motions of one world side by side, at real speed."""

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
from drake_aigto.planning import Plan
from drake_aigto.show.board import Board
from drake_aigto.show.coordinates import moves_straight
from drake_aigto.show.effects import Effects, Film
from drake_aigto.show.linkage_playback import publish_linkage
from drake_aigto.show.motion import (
    DOT_SECONDS,
    Motion,
    color_of,
    find_dots,
    find_legs,
    motions_of_plan,
    time_span,
)
from drake_aigto.show.page import Page
from drake_aigto.show.scene import (
    FRAMES_PER_SECOND,
    HOLD,
    ROOT,
    clear,
    face_board,
    folder_of,
    look,
)
from drake_aigto.show.stage import GRAY, Stage
from drake_aigto.show.text import wall_names
from drake_aigto.show.track import Track
from drake_aigto.world import Scenario, World
from drake_aigto.world.files import write_text

_LANE_WIDTH = 4.0  # in radii of what moves
_LEAST_LENGTH = 5.5  # of the track, in widths of a lane, so that labels fit

_FIELD_OF_VIEW = 30.0  # vertical [deg]
_CAMERA_TILT = np.deg2rad(48.0)  # above the track
_CAMERA_DISTANCE = 1.9  # as a part of the track's length
_LIFT = 0.1  # of a board from the ground, in radii of what moves
_CAMERA_SLACK = 1.05  # How much farther back than all lanes need.

_PORTS = 1024, 65535  # That any user may listen at.


def open_meshcat(port: int | None = None) -> Meshcat:
    """Returns a Meshcat that browsers of this machine can open (`Meshcat.web_url`).

    Args:
        port: where it listens: any free one if 0, the first free one from 7000 to 7999 if None.

    Raises:
        OptionsError: the port is in use, or no user may listen there.
    """
    # Drake ends the process below, and takes the port's last 16 bits above.
    if port and not _PORTS[0] <= port <= _PORTS[1]:
        raise _refuse_port(f"{port}")
    try:
        return Meshcat(port=port)
    except RuntimeError as error:
        got = "none of 7000 to 7999 that is free" if port is None else f"{port}, in use"
        raise _refuse_port(got) from error


def _refuse_port(got: str) -> OptionsError:
    return OptionsError(
        "Meshcat's port",
        got=got,
        expected=f"a free one, {_PORTS[0]} to {_PORTS[1]}",
        remedy="Name another port, or 0 for any that is free.",
    )


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

    Each motion has a place of its own, so that none hides another. Along a level line that is a
    lane, the first at the back, beside walls that are shown once, where they are; in a plane, a
    copy of the world, the first at the left, with the motion's planned contacts on a board. Dots
    are where bodies were every so often, an arrow is the control, a flash an impact. Start and goal
    are marked, and the camera sees all of it. What was shown below `ROOT` before is gone.

    A mechanism, or what rubs, has its own links and walls in each copy, transparent ghosts of its
    start (gray) and goal (green), an arrow or an arc at each joint that is driven, and an arrow for
    the force of a contact while it lasts. What no weight asks for has no goal. Friction is shown by
    its cones, filled while it sticks and open while it slips, with the forces and, for a moment,
    the impulses that keep to them, in a folder "friction" of each motion, which Meshcat's controls
    can hide.
    """
    if not moves_straight(world) or np.any(world.friction_coefficients(scenario) > 0):
        return publish_linkage(motions, meshcat, world, scenario)
    ends = np.array([scenario.initial_position, scenario.goal_position])
    stage = Stage(world, np.vstack([ends, *(motion.positions for motion in motions)]))
    begin, end = time_span(motions)
    film = Film(meshcat, begin, end + HOLD, FRAMES_PER_SECOND)
    effects = Effects(stage, world, motions, film)
    ground: Track | Board
    if stage.is_line:
        ground = _lay_track(stage, motions, scenario, _explain(effects))
    else:
        ground = _lay_board(stage, motions, scenario, wall_names(world), _explain(effects))
    clear(meshcat)
    offsets = [ground.offset(i) for i in range(len(motions))]
    places = [RigidTransform(stage.X_WT.rotation() @ offset) for offset in offsets]
    copies = {"world": RigidTransform()}
    if not stage.is_line:
        copies = {f"worlds/{i}": each for i, each in enumerate(places, 1)}
    for name, aside in copies.items():
        for actor in stage.actors:
            if not actor.moves:
                path = f"{ROOT}/{name}/{actor.name}"
                meshcat.SetObject(path, actor.shape, actor.color or GRAY)
                meshcat.SetTransform(path, aside.multiply(stage.pose(actor, ends[0])))
    meshcat.SetObject(f"{ROOT}/track", ground.mesh())
    # Above ground that the model may have where the balls roll.
    lift = 0.0 if stage.is_line else _LIFT * stage.radius
    meshcat.SetTransform(f"{ROOT}/track", stage.X_WT.multiply(RigidTransform([0.0, 0.0, lift])))
    for index, (motion, aside) in enumerate(zip(motions, places, strict=True)):
        _animate(stage, motion, index, aside, film)
        effects.add(motion, aside, folder_of(index))
    film.play()
    if isinstance(ground, Track):
        _aim_camera(stage, ground, meshcat)
    else:
        face_board(stage, ground, meshcat)


def save_html(meshcat: Meshcat, path: str | os.PathLike[str]) -> None:
    """Writes what Meshcat shows to one self-contained page with a slider, whole or not at all.

    Raises:
        OutputFileError: it can't be written; its folder must exist.
    """
    page = Page("A plan and simulations of its control")
    page.scenes({"Recording": meshcat.StaticHtml()})
    write_text(path, page.to_html())


def _explain(effects: Effects) -> list[str]:
    """Returns what has to be said of what is shown."""
    notes = [f"dots: every {DOT_SECONDS:g} s"]
    if effects.largest_force > 0:
        notes.append(f"arrow: control, up to {effects.largest_force:.2g} N")
    if effects.flashes:
        notes.append("yellow flash: impact")
    return notes


def _lay_track(
    stage: Stage, motions: Sequence[Motion], scenario: Scenario, notes: Sequence[str]
) -> Track:
    """Returns the track that the motions need."""
    lane_width = _LANE_WIDTH * stage.radius
    walls = stage.walls()
    start = min([stage.lowest, *(x for x, side in walls if side > 0)]) - stage.radius
    highest = max([stage.highest, *(x for x, side in walls if side < 0)])
    end = max(highest + 2 * stage.radius, start + _LEAST_LENGTH * lane_width)
    legs = [
        [[stage.places(mover, q)[:, 0] for q in find_legs(motion)] for mover in stage.movers]
        for motion in motions
    ]
    labels = [motion.label for motion in motions]
    return Track(labels, start, end, lane_width, _mark_ends(stage, scenario), legs, notes)


def _mark_ends(stage: Stage, scenario: Scenario) -> dict[str, float]:
    """Returns where each body's start and goal are along the track, by name."""
    ends = {"start": scenario.initial_position, "goal": scenario.goal_position}
    return {
        f"{body}{end}": float(stage.places(mover, q[np.newaxis])[0, 0])
        for end, q in ends.items()
        for body, mover in zip(_name_bodies(stage), stage.movers, strict=True)
    }


def _name_bodies(stage: Stage) -> list[str]:
    """Returns what tells several bodies apart, without the last word where it is that of all."""
    names = [mover.body.split("/")[-1].split("_") for mover in stage.movers]
    if len(names) == 1:
        return [""]
    share = len({name[-1] for name in names}) == 1 and all(len(name) > 1 for name in names)
    return [" ".join([*(name[:-1] if share else name), ""]) for name in names]


def _lay_board(
    stage: Stage,
    motions: Sequence[Motion],
    scenario: Scenario,
    walls: Sequence[str],
    notes: Sequence[str],
) -> Board:
    """Returns the board that the motions need; walls have names."""
    ends = np.array([scenario.initial_position, scenario.goal_position])
    bodies = len(stage.movers)
    marks = np.array([stage.places(mover, ends)[:, :2] for mover in stage.movers])
    seen = np.vstack([ends, *(motion.positions for motion in motions)])
    low, high = stage.extent(stage.actors, seen)
    ways = [
        [stage.places(mover, motion.positions)[:, :2] for mover in stage.movers]
        for motion in motions
    ]
    return Board(
        labels=[motion.label for motion in motions],
        low=low[:2],
        high=high[:2],
        depth=high[2],
        radius=stage.radius,
        starts=marks[:, 0],
        goals=marks[:, 1],
        ways=ways,
        dots=[
            np.vstack([stage.places(m, find_dots(motion))[:, :2] for m in stage.movers])
            for motion in motions
        ],
        touches=[_find_touches(motion, each) for motion, each in zip(motions, ways, strict=True)],
        touch_names=[
            [f"{walls[touch.contact]}, {touch.start:.2f} s" for touch in motion.touches] * bodies
            for motion in motions
        ],
        notes=notes,
    )


def _find_touches(motion: Motion, ways: Sequence[Floats]) -> Floats:
    """Returns where on the ways of its bodies a motion plans to touch something, shape (t, 2)."""
    rows = np.searchsorted(motion.times, [touch.start for touch in motion.touches])
    return np.vstack([way[rows] for way in ways])


def _animate(stage: Stage, motion: Motion, index: int, aside: RigidTransform, film: Film) -> None:
    """Adds a motion's bodies to a film, moved aside in the world."""
    # Of several rows in one frame the last one counts.
    rows = dict(zip(map(film.frame, motion.times), motion.positions, strict=True))
    rows[film.last_frame] = motion.positions[-1]
    for actor in filter(lambda actor: actor.moves, stage.actors):
        path = f"{folder_of(index)}/{actor.name}"
        film.meshcat.SetObject(path, actor.shape, Rgba(*to_rgb(color_of(index))))
        for frame, q in rows.items():
            film.move(frame, path, aside.multiply(stage.pose(actor, q)))


def _aim_camera(stage: Stage, track: Track, meshcat: Meshcat) -> None:
    """Looks at the middle of the track from its near side, and from above."""
    # A little before the middle, as the wall stands there.
    middle = np.array([0.54 * track.start + 0.46 * track.end, 0.0, 0.0])
    # From here the track's near side is at the window's lower edge.
    side = track.half_width + track.margin
    clear = np.sin(_CAMERA_TILT) / np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2) + np.cos(_CAMERA_TILT)
    distance = max(_CAMERA_DISTANCE * track.length, _CAMERA_SLACK * clear * side)
    back = distance * np.array([0.0, -np.cos(_CAMERA_TILT), np.sin(_CAMERA_TILT)])
    look(stage, meshcat, middle, back, _FIELD_OF_VIEW)
