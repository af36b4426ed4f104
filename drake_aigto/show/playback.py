"""Playback in Drake's Meshcat: motions of one world side by side, at real speed."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, MeshcatAnimation, Rgba
from pydrake.math import RigidTransform

from drake_aigto.show.motion import Motion, color_of, motions_of_plan, time_span
from drake_aigto.show.stage import Stage
from drake_aigto.show.track import Track
from drake_aigto.world.files import write_text

if TYPE_CHECKING:
    from drake_aigto.planning import Plan
    from drake_aigto.world import Scenario, World

# All that is drawn lies below this path.
ROOT = "/drake_aigto"

# Frames are keyed where a motion has rows; between two of them the browser moves straight on.
FRAMES_PER_SECOND = 1000
# The end is held for a moment [s], then all motions start again, together: one length for all.
_HOLD = 0.5
_REPETITIONS = 10_000

_LANE_WIDTH = 4.0  # in radii of what moves
_LEAST_LENGTH = 5.5  # of the track, in widths of a lane, so that labels fit

_FIELD_OF_VIEW = 30.0  # vertical [deg]
_CAMERA_TILT = np.deg2rad(48.0)  # above the track
# As parts of the track's length, level and upright: a window is wider than it is high.
_CAMERA_DISTANCES = (1.9, 2.5)
_CAMERA_SLACK = 1.05  # How much farther back than all lanes need.


def play(plan: Plan, meshcat: Meshcat, world: World) -> None:
    """Shows a plan and what simulations made of its control, in lanes side by side.

    Args:
        plan: the plan; its trajectory is labelled as no simulation.
        meshcat: where to show it.
        world: that of the plan's scenario.
    """
    publish(motions_of_plan(plan, world), meshcat, world, plan.scenario)


def publish(motions: Sequence[Motion], meshcat: Meshcat, world: World, scenario: Scenario) -> None:
    """Publishes one recording, with a time slider, of several motions of the same world.

    Each motion has a lane of its own, moved sideways, so that none hides another. What does not
    move is shown once, where it is. Start and goal are marked, and the camera sees all of it.

    Args:
        motions: at least one; the first gets the lane farthest from the camera.
        meshcat: where to show them, instead of what this function showed before.
        world: has the shapes.
        scenario: has start and goal.
    """
    ends = np.array([scenario.initial_position, scenario.goal_position])
    stage = Stage(world, np.vstack([ends, *(motion.positions for motion in motions)]))
    track = _lay_track(stage, motions, scenario)
    meshcat.Delete(ROOT)
    for path in ("/Background", "/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)
    for actor in stage.actors:
        if not actor.moves:
            path = f"{ROOT}/world/{actor.name}"
            meshcat.SetObject(path, actor.shape, actor.color)
            meshcat.SetTransform(path, stage.pose(actor, ends[0]))
    meshcat.SetObject(f"{ROOT}/track", track.mesh())
    meshcat.SetTransform(f"{ROOT}/track", stage.X_WT)
    meshcat.SetAnimation(_animate(stage, track, motions, meshcat))
    _aim_camera(stage, track, meshcat)


def save_html(meshcat: Meshcat, path: str | os.PathLike[str]) -> None:
    """Writes what Meshcat shows to one self-contained page, whole or not at all.

    Raises:
        OutputFileError: it can't be written; its folder must exist.
    """
    write_text(path, meshcat.StaticHtml())


def _lay_track(stage: Stage, motions: Sequence[Motion], scenario: Scenario) -> Track:
    """Returns the track that the motions need."""
    lane_width = _LANE_WIDTH * stage.radius
    start = stage.lowest - stage.radius
    end = max(stage.highest + 2 * stage.radius, start + _LEAST_LENGTH * lane_width)
    ends = {"start": scenario.initial_position, "goal": scenario.goal_position}
    marks = {name: stage.along(q) for name, q in ends.items()}
    return Track([motion.label for motion in motions], start, end, lane_width, marks)


def _animate(
    stage: Stage, track: Track, motions: Sequence[Motion], meshcat: Meshcat
) -> MeshcatAnimation:
    """Puts the moving shapes into their lanes, and returns how they move there."""
    begin, end = time_span(motions)
    last_frame = round((end + _HOLD - begin) * FRAMES_PER_SECOND)
    animation = MeshcatAnimation(FRAMES_PER_SECOND)
    animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
    animation.set_repetitions(_REPETITIONS)
    for lane, motion in enumerate(motions):
        aside = RigidTransform(track.lane_center(lane) * stage.X_WT.rotation().matrix()[:, 1])
        # Of several rows in one frame the last one counts.
        frames = np.rint((motion.times - begin) * FRAMES_PER_SECOND).astype(int).tolist()
        rows = {
            **dict(zip(frames, motion.positions, strict=True)),
            last_frame: motion.positions[-1],
        }
        for actor in stage.actors:
            if not actor.moves:
                continue
            path = f"{ROOT}/motions/{lane + 1}/{actor.name}"
            meshcat.SetObject(path, actor.shape, Rgba(*to_rgb(color_of(lane))))
            meshcat.SetTransform(path, aside.multiply(stage.pose(actor, motion.positions[0])))
            for frame, q in rows.items():
                animation.SetTransform(frame, path, aside.multiply(stage.pose(actor, q)))
    return animation


def _aim_camera(stage: Stage, track: Track, meshcat: Meshcat) -> None:
    """Looks at the middle of the track from its near side, and from above."""
    # A little before the middle, as the wall stands there.
    middle = np.array([0.54 * track.start + 0.46 * track.end, 0.0, 0.0])
    steepness = abs(stage.X_WT.rotation().matrix()[2, 0])
    # From here the track's near side is at the window's lower edge.
    side = track.half_width + track.margin
    clear = np.sin(_CAMERA_TILT) / np.tan(np.deg2rad(_FIELD_OF_VIEW) / 2) + np.cos(_CAMERA_TILT)
    distance = max(
        np.interp(steepness, [0, 1], _CAMERA_DISTANCES) * track.length, _CAMERA_SLACK * clear * side
    )
    back = np.array([0.0, -np.cos(_CAMERA_TILT), np.sin(_CAMERA_TILT)])
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=_FIELD_OF_VIEW))
    meshcat.SetCameraPose(
        stage.X_WT.multiply(middle + distance * back), stage.X_WT.multiply(middle)
    )
