"""Playback of mechanisms: a copy of the links for each motion, before a board that explains it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform

from drake_aigto.arrays import Bools, Floats
from drake_aigto.show.board import Board
from drake_aigto.show.coordinates import find_goal, has_goal
from drake_aigto.show.effects import Film
from drake_aigto.show.linkage import Linkage
from drake_aigto.show.linkage_effects import LinkageEffects
from drake_aigto.show.motion import DOT_SECONDS, Motion, color_of, find_dots, find_row, time_span
from drake_aigto.show.scene import (
    ASPECT_RATIO,
    FRAMES_PER_SECOND,
    HOLD,
    ROOT,
    clear,
    face_board,
    folder_of,
)
from drake_aigto.show.stage import GRAY, Actor
from drake_aigto.world import Scenario, World

# Ghosts of the links where they start, and where they should end.
_GHOSTS = {"start": Rgba(0.3, 0.3, 0.3, 0.25), "goal": Rgba(0.0, 0.62, 0.35, 0.3)}
_MOST_NAMES = 6  # of contacts on a board: more would cover each other


def publish_linkage(
    motions: Sequence[Motion], meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    """Publishes one recording of several motions of a mechanism, for `playback.publish`.

    Each has a copy of the links and walls, in their own colors, with transparent ghosts where they
    start (gray) and where they should end (green): a coordinate whose goal has no weight is there
    as it ends, and links that no weighted one moves have no ghost.
    """
    has = has_goal(world, scenario)
    goals = [find_goal(world, scenario, motion.positions[-1]) for motion in motions]
    ends = np.vstack([scenario.initial_position, *goals])
    linkage = Linkage(world, np.vstack([ends, *(motion.positions for motion in motions)]))
    begin, end = time_span(motions)
    film = Film(meshcat, begin, end + HOLD, FRAMES_PER_SECOND)
    effects = LinkageEffects(linkage, world, scenario, motions, film)
    board = _lay_board(linkage, motions, world, scenario, effects.notes)
    clear(meshcat)
    meshcat.SetObject(f"{ROOT}/track", board.mesh())
    meshcat.SetTransform(f"{ROOT}/track", linkage.X_WT)
    for index, (motion, goal) in enumerate(zip(motions, goals, strict=True)):
        aside = RigidTransform(linkage.X_WT.rotation() @ board.offset(index))
        _show_still(linkage, f"{ROOT}/worlds/{index + 1}", aside, meshcat, motion.positions[0])
        ghosts = scenario.initial_position, goal
        _show_ghosts(linkage, ghosts, has, f"{ROOT}/ghosts/{index + 1}", aside, meshcat)
        _animate(linkage, motion, index, aside, film)
        effects.add(index, aside, folder_of(index))
    film.play()
    face_board(linkage, board, meshcat)


def _lay_board(
    linkage: Linkage,
    motions: Sequence[Motion],
    world: World,
    scenario: Scenario,
    notes: Sequence[str],
) -> Board:
    """Returns the board that the motions need, with as many panels in a row as are seen best."""
    has = has_goal(world, scenario)
    end = find_goal(world, scenario, motions[0].positions[-1])
    start, goal = linkage.trace(np.array([scenario.initial_position, end]))
    # A place that a coordinate without weight moves is not asked for.
    is_free = [np.any(linkage.movers_of(body) & ~has) for body, _ in linkage.tracers]
    goal[is_free] = np.nan
    touches = [motion.touches[:_MOST_NAMES] for motion in motions]
    rows = [
        [find_row(motion, touch.start) for touch in each]
        for motion, each in zip(motions, touches, strict=True)
    ]
    board = Board(
        labels=[motion.label for motion in motions],
        low=linkage.low,
        high=linkage.high,
        depth=linkage.depth,
        radius=linkage.radius,
        starts=start[:, :2],
        goals=goal[:, :2],
        ways=[list(_trace(linkage, motion.positions)) for motion in motions],
        dots=[np.vstack(list(_trace(linkage, find_dots(motion)))) for motion in motions],
        touches=[
            _place_touches(linkage, motion.positions[each], [touch.contact for touch in named])
            for motion, each, named in zip(motions, rows, touches, strict=True)
        ],
        touch_names=[[f"{touch.start:.2f} s" for touch in each] for each in touches],
        notes=[f"dots: every {DOT_SECONDS:g} s", *notes],
    )
    columns = range(1, len(motions) + 1)
    return max((replace(board, columns=count) for count in columns), key=_how_large)


def _how_large(board: Board) -> float:
    """Returns how large a meter is on a board that fills a window, in the window's heights."""
    low, high = board.corners
    width, height = high - low
    return float(min(ASPECT_RATIO / width, 1 / height))


def _trace(linkage: Linkage, positions: Floats) -> Floats:
    """Returns where in the board's plane the tracers are, shape (tracers, K, 2)."""
    return linkage.trace(positions)[..., :2].transpose(1, 0, 2)


def _place_touches(linkage: Linkage, positions: Floats, contacts: Sequence[int]) -> Floats:
    """Returns where in the board's plane contacts are, each at positions of its own, (t, 2)."""
    X_TW = linkage.X_WT.inverse()
    touches = zip(contacts, positions, strict=True)
    places = [X_TW.multiply(linkage.touch(contact, q)[0])[:2] for contact, q in touches]
    return np.array(places).reshape(-1, 2)


def _show_still(
    linkage: Linkage, folder: str, aside: RigidTransform, meshcat: Meshcat, q: Floats
) -> None:
    """Shows what does not move."""
    for actor in linkage.actors:
        if not actor.moves:
            _show(linkage, actor, f"{folder}/{actor.name}", aside, meshcat, q, actor.color or GRAY)


def _show_ghosts(
    linkage: Linkage,
    ends: tuple[Floats, Floats],
    asked_for: Bools,
    folder: str,
    aside: RigidTransform,
    meshcat: Meshcat,
) -> None:
    """Shows the links where they start and should end."""
    bodies = {actor.body: actor.index for actor in linkage.actors if actor.moves}
    asked = {name for name, each in bodies.items() if np.any(linkage.movers_of(each) & asked_for)}
    for name, q in zip(_GHOSTS, ends, strict=True):
        for actor in linkage.actors:
            if actor.moves and (name == "start" or actor.body in asked):
                path = f"{folder}/{name}/{actor.name}"
                _show(linkage, actor, path, aside, meshcat, q, _GHOSTS[name])


def _show(
    linkage: Linkage,
    actor: Actor,
    path: str,
    aside: RigidTransform,
    meshcat: Meshcat,
    q: Floats,
    color: Rgba,
) -> None:
    meshcat.SetObject(path, actor.shape, color)
    meshcat.SetTransform(path, aside @ linkage.pose(actor, q))


def _animate(
    linkage: Linkage, motion: Motion, index: int, aside: RigidTransform, film: Film
) -> None:
    """Adds a motion's links to a film, moved aside in the world."""
    # Of several rows in one frame the last one counts.
    rows = dict(zip(map(film.frame, motion.times), motion.positions, strict=True))
    rows[film.last_frame] = motion.positions[-1]
    own = Rgba(*to_rgb(color_of(index)))
    for actor in filter(lambda actor: actor.moves, linkage.actors):
        path = f"{folder_of(index)}/{actor.name}"
        film.meshcat.SetObject(path, actor.shape, actor.color or own)
        for frame, q in rows.items():
            film.move(frame, path, aside @ linkage.pose(actor, q))
