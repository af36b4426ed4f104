"""Playback in Drake's Meshcat: one scene, a plan solid and others as ghosts, at real speed."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.colors import to_hex, to_rgb
from pydrake.geometry import Meshcat, Rgba, Sphere

from drake_aigto.arrays import Bools, Floats
from drake_aigto.planning import Plan
from drake_aigto.show.film import (
    LONGEST,
    ROOT,
    Film,
    look_at,
    on_white,
    put_behind,
    put_in_front,
    shape_arc,
    shape_arrow,
    shape_cone,
)
from drake_aigto.show.motion import (
    Friction,
    Motion,
    calc_approach_speed,
    calc_friction,
    color_of,
    find_held,
    find_row,
    motions_of_plan,
    time_span,
)
from drake_aigto.show.page import Playback, list_events, list_numbers, stand_side_by_side
from drake_aigto.show.shapes import Actor, find_goal, has_goal, moving_joints
from drake_aigto.show.stage import Stage
from drake_aigto.show.words import plan_name
from drake_aigto.world import Scenario, World, uncolored

# Frames are keyed where a motion has rows; between two of them the browser moves straight on.
_FRAMES_PER_SECOND = 1000
# Seen from afar, as walls hide less then; and from aside by this [rad].
_VIEW, _TILT = np.deg2rad(12.0), np.deg2rad(12.0)

_GHOST = 0.35  # how much a ghost covers
_GRAY = Rgba(0.6, 0.6, 0.6)  # of what has no color of its own
# Ghosts of the links where they start, and where they should end.
_GHOSTS = {"start": Rgba(0.3, 0.3, 0.3, 0.25), "goal": Rgba(0.0, 0.62, 0.35, 0.3)}

_INK, _YELLOW = Rgba(0.13, 0.13, 0.13), Rgba(1.0, 0.78, 0.0)
_MAGENTA, _VIOLET = Rgba(0.75, 0.0, 0.45), Rgba(0.36, 0.1, 0.75)
_FLASH = 0.045  # radius of the largest flash, in sizes of the window
_LASTING = 0.3  # that the impulse of an impact is seen [s]
_LEAST_FLASH = 0.4  # Of the largest flash's radius: that of an impact without speed.
_BEHIND = 2e-3  # from the way of one motion to that of the next, in sizes of the window
# What ghosts lack until they stand side by side with the first motion.
GHOSTS_WITHOUT = (
    *("worlds/{}", "ghosts/{}", "motions/{}/control", "motions/{}/contacts"),
    "motions/{}/friction",
)
_LINE = 2.0  # width of ways [px]
_FLASH_TIME = 0.15  # from an impact until its flash is gone [s]


def play(
    plan: Plan, meshcat: Meshcat, world: World | None = None, beside: Sequence[Motion] = ()
) -> Playback:
    """Shows a plan, labeled as no simulation, and what simulations made of its control.

    Motions of the same world to compare with, such as `gradient_motions` returns, are shown with
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
    return publish(motions, meshcat, world, plan.scenario)


def publish(
    motions: Sequence[Motion],
    meshcat: Meshcat,
    world: World,
    scenario: Scenario,
    events: Mapping[float, str] | None = None,
) -> Playback:
    """Publishes one recording, with a time slider, of several motions of the same world.

    The first motion is solid, its links in their own colors (balls in that of their motion); the
    others are translucent ghosts in the same place, each in its color. A page's player stands them
    side by side at the press of a button, each in a world of its own (`Playback`). Lines are the
    ways of bodies. Fainter still are the start (gray) and the goal (green): a coordinate whose goal
    has no weight is there as it ends, and links that no weighted one moves have no ghost. What
    moves is there from the first time of its motion on. Arrows, arcs and flashes are control,
    contact and impacts:

    - Black arrows are forces of the control on links, and black arcs its torques at joints.
    - Magenta arrows are forces of contacts while they last, friction included; yellow flashes are
      impacts, larger where they are faster, and violet ones are events, on the first motion.
    - Where something slides with friction, violet arrows are impulses of rigid impacts, seen for a
      moment, and both kinds of arrows keep to cones of friction, |f_t| ≤ μ f, of one size: filled
      ones while it sticks, open ones of ribs while it slips. Cones and impulses are in a folder
      "friction" of each motion, which Meshcat's controls can hide.

    Ghosts have arrows and flashes only side by side. The camera sees all of it. What was shown
    below `ROOT` before is gone.

    Args:
        motions: to show.
        meshcat: where.
        world: of the motions.
        scenario: has start and goal.
        events: times of kicks and the like [s], and what they are.
    """
    goals = (find_goal(world, scenario, motion.positions[-1]) for motion in motions)
    rows = [scenario.initial_position, *goals, *(motion.positions for motion in motions)]
    stage = Stage(world, np.vstack(rows))
    film = Film(meshcat, *time_span(motions), _FRAMES_PER_SECOND)
    scene = _Scene(stage, world, scenario, motions, film)
    for index in range(len(motions)):
        scene.add(index)
    scene.add_events(list(events or ()))
    film.play()
    # From a little below a level plane, or above an upright one.
    tilt = -_TILT if abs(stage.X_WT.rotation().matrix()[2, 2]) > 0.5 else _TILT
    low, high = scene.find_corners()
    unit = look_at(meshcat, stage.X_WT, (low, high), (_VIEW, tilt, 0.0))
    places = stand_side_by_side(high - low, len(motions))
    both = high - low, high - low + np.ptp(places, axis=0)
    lean = np.array([0.0, stage.depth * abs(np.sin(tilt))])
    rotation = stage.X_WT.rotation().matrix()
    return Playback(
        meshcat,
        {
            "title": plan_name(scenario, world),
            "motions": [[color_of(i), motion.label] for i, motion in enumerate(motions)],
            "notes": scene.notes,
            "events": list_events(motions[0], world, events or {}),
            "numbers": list_numbers(motions[0], world, scenario),
            "reach": [((size + lean) / 2 / unit).tolist() for size in both],
            "aside": (places @ rotation[:, :2].T).tolist(),
            "without": GHOSTS_WITHOUT,
        },
    )


class _Scene:
    """Copies of the world for several motions, and what rides on them, all to one scale.

    Attributes:
        film: the recording that copies are added to.
        largest: of all forces of the control on one link [N], of all its torques [N m], of all
            forces of contacts [N], and of all impulses with friction [N s]; 0 without any.
    """

    def __init__(
        self, stage: Stage, world: World, scenario: Scenario, motions: Sequence[Motion], film: Film
    ) -> None:
        """Finds the scales."""
        self._stage, self._world, self._scenario, self.film = stage, world, scenario, film
        self._motions = list(motions)
        self._asked_for = has_goal(world, scenario)
        self._loads = [self._calc_loads(motion) for motion in motions]
        self._friction = [calc_friction(motion, world, scenario) for motion in motions]
        self._coefficients = world.friction_coefficients(scenario)
        vectors: list[list[Floats]] = [
            *(
                [v for each in some for _, v in each.values()]
                for some in zip(*self._loads, strict=True)
            ),
            *([np.dstack(each[:2]) for each in some] for some in zip(*self._friction, strict=True)),
        ]
        self.largest = [
            max((np.max(np.linalg.norm(v, axis=-1), initial=0.0) for v in some), default=0.0)
            for some in vectors
        ]
        is_rigid = scenario.contact == "rigid"
        self._flashes = is_rigid and any(motion.impacts for motion in motions)
        speeds = (
            calc_approach_speed(world, motion, touch.start, touch.contact)
            for motion in motions
            for touch in motion.impacts
        )
        self._largest_speed = max(speeds, default=0.0) or 1.0

    @property
    def notes(self) -> list[tuple[str, str]]:
        """Explanations of what is shown, each with its color."""
        force, torque, push, impulse = self.largest
        slides = any(np.any(each.largest > 0) for both in self._friction for each in both)
        free = self._stage.names_without_contact if self._world.contacts else []
        found: list[tuple[object, str, Any]] = [
            (True, "where it starts", _GHOSTS["start"]),
            (self._asked_for.any(), "goal", _GHOSTS["goal"]),
            (force > 0, f"arrow: control, up to {force:.3g} N", _INK),
            (torque > 0, f"arc: control, up to {torque:.3g} N m", _INK),
            (push > 0, f"arrow: contact force, up to {push:.3g} N", _MAGENTA),
            (self._flashes, "flash: impact", _YELLOW),
            (impulse > 0, f"arrow: impulse, up to {impulse:.3g} N s", _VIOLET),
            (slides, "cone of friction: filled while it sticks, ribs while it slips", _MAGENTA),
            (free, f"touches nothing: {', '.join(free)}", _GRAY),
        ]
        return [(to_hex(on_white(color)), text) for is_so, text, color in found if is_so]

    def find_corners(self) -> tuple[Floats, Floats]:
        """Returns corners in T's x and y of what is to be seen with its arrows, (2,) each [m]."""
        stage, X_TW = self._stage, self._stage.X_WT.inverse()
        low, high, size = stage.low, stage.high, LONGEST * stage.size
        for loads, largest in zip(self._loads[0], self.largest, strict=False):
            for places, vectors in loads.values():
                ends = X_TW.multiply((places + vectors * (size / (largest or 1.0))).T)[:2]
                low, high = np.minimum(low, ends.min(axis=1)), np.maximum(high, ends.max(axis=1))
        return low, high

    def add(self, index: int) -> None:
        """Adds the motion of this number.

        It is what stands still, ghosts of start and goal, links as they move, and what rides on
        them. Links of the first motion have their own colors, but balls and what has none that of
        the motion. Only those have a ghost at the goal that a coordinate asked for moves.
        """
        stage, film, motion = self._stage, self.film, self._motions[index]
        first, last = motion.positions[[0, -1]]
        goal = find_goal(self._world, self._scenario, last)
        color = Rgba(*to_rgb(color_of(index)), _GHOST if index else 1.0)
        # Of several rows in one frame the last one counts.
        rows = {film.frame(time): q for time, q in zip(motion.times, motion.positions, strict=True)}
        rows[film.last_frame] = last

        def put(actor: Actor, folder: str, q: Floats, color: Rgba | None, layer: int = 0) -> str:
            path = f"{ROOT}/{folder}/{actor.name}"
            shape = uncolored(actor.shape) if layer else actor.shape
            film.meshcat.SetObject(path, shape, color or _GRAY)
            film.meshcat.SetTransform(path, stage.pose(actor, q))
            if layer:
                put_behind(path, film.meshcat, layer)
            return path

        folder, start = f"motions/{index + 1}", self._scenario.initial_position
        for actor in stage.actors:
            if not actor.moves:
                put(actor, f"worlds/{index + 1}", first, actor.color)
                continue
            last_layer = len(self._motions) + 1
            put(actor, f"ghosts/{index + 1}/start", start, _GHOSTS["start"], last_layer)
            if np.any(stage.movers_of(actor.index) & self._asked_for):
                put(actor, f"ghosts/{index + 1}/goal", goal, _GHOSTS["goal"], last_layer - 1)
            look = color if index else stage.color(actor, index)
            path = put(actor, folder, first, look, index)
            for frame, q in rows.items():
                film.move(frame, path, stage.pose(actor, q))
        for number, way in enumerate(stage.trace(motion.positions)):
            line = stage.X_WT.multiply((way - [0.0, 0.0, _BEHIND * index * stage.size]).T)
            film.meshcat.SetLine(f"{ROOT}/{folder}/ways/{number}", line, _LINE, color)
        if min(rows) > 0:
            film.show_between(f"{ROOT}/{folder}", min(rows), film.last_frame + 1)
        self._add_control(index, f"{ROOT}/{folder}/control")
        self._add_contacts(index, f"{ROOT}/{folder}")
        for part in GHOSTS_WITHOUT if index else ():
            film.meshcat.SetProperty(f"{ROOT}/{part.format(index + 1)}", "visible", False)

    def add_events(self, times: Sequence[float]) -> None:
        """Adds flashes where the first motion is at times [s]."""
        if not times:
            return
        motion = self._motions[0]
        (way, *_), rows = self._stage.trace(motion.positions), [find_row(motion, t) for t in times]
        places = self._stage.X_WT.multiply(way[rows].T).T
        path = f"{ROOT}/motions/1/events"
        self._flash(path, sorted(times), places, np.full(len(rows), 2.0), _VIOLET)

    def _calc_loads(
        self, motion: Motion
    ) -> tuple[dict[str, tuple[Floats, Floats]], dict[str, tuple[Floats, Floats]]]:
        """Returns forces of the control on links, and its torques at joints, by name.

        Each is places and vectors in the world at each row of a motion, shape (K, 3) [m], [N],
        [N m].
        """
        forces: dict[str, tuple[Floats, Floats]] = {}
        torques: dict[str, tuple[Floats, Floats]] = {}
        if motion.controls is None:
            return forces, torques
        held = motion.controls[find_held(motion)][..., np.newaxis]
        generalized = (self._world.calc_actuation(motion.positions) @ held)[..., 0]
        for joint in moving_joints(self._world):
            start = joint.velocity_start()
            if not np.any(self._world.actuation[start : start + joint.num_velocities()]):
                continue
            rows = zip(motion.positions, generalized, strict=True)
            found = [self._stage.load(joint, q, force) for q, force in rows]
            places, pushes, moments = np.array(found).transpose(1, 0, 2)
            torques[joint.name()] = places, moments
            if np.any(pushes):
                driven = self._stage.find_driven(joint)
                name = driven.body if driven else joint.name()
                # Forces of several joints that drive one link, such as two sliders, add up.
                before = forces[name][1] if name in forces else 0.0
                forces[name] = places, pushes + before
        return forces, torques

    def _add_control(self, index: int, folder: str) -> None:
        """Adds arrows and arcs of the control."""
        frames = list(map(self.film.frame, self._motions[index].times))
        shapes = {"arrow": shape_arrow, "arc": shape_arc}
        kinds = zip(shapes.items(), self._loads[index], self.largest, strict=False)
        for (kind, shape), loads, largest in kinds:
            for name, (places, vectors) in loads.items():
                if np.any(vectors):
                    path = f"{folder}/{name}/{kind}"
                    shape(path, self._stage.size, self.film.meshcat, _INK)
                    self.film.ride(path, frames, places, vectors / largest)

    def _add_contacts(self, index: int, folder: str) -> None:
        """Adds forces, impulses and cones of friction of contacts, and flashes of impacts."""
        motion, (forces, impulses) = self._motions[index], self._friction[index]
        keys = [(self.film.frame(time), row, True) for row, time in enumerate(motion.times)]
        for contact in _find(forces.normals > 0):
            arrow, cones = f"contacts/{contact}/force", f"friction/{contact}/force"
            paths = f"{folder}/{arrow}", f"{folder}/{cones}"
            self._add_push(motion, forces, contact, keys, paths, self.largest[2], _MAGENTA)
        end = round(_LASTING * self.film.rate)
        lasting = {-1: False, 0: True, end: True, end + 1: False}
        for contact in _find(impulses.largest > 0):
            rows = np.flatnonzero(impulses.largest[:, contact] > 0)
            moments = self.film.moments(motion.times[rows], lasting)
            keys = [(frame, int(rows[number]), seen) for frame, number, seen in moments]
            cones = f"{folder}/friction/{contact}/impulse"
            paths = f"{cones}/arrow", cones
            self._add_push(motion, impulses, contact, keys, paths, self.largest[3], _VIOLET)
        for contact in sorted({touch.contact for touch in motion.impacts}) if self._flashes else ():
            times = [touch.start for touch in motion.impacts if touch.contact == contact]
            qs = [motion.positions[find_row(motion, time)] for time in times]
            places = np.array([self._stage.touch(contact, q)[0] for q in qs])
            speeds = [calc_approach_speed(self._world, motion, time, contact) for time in times]
            sizes = _LEAST_FLASH + (1 - _LEAST_FLASH) * (np.array(speeds) / self._largest_speed)
            self._flash(f"{folder}/contacts/{contact}/impacts", times, places, sizes, _YELLOW)

    def _add_push(
        self,
        motion: Motion,
        friction: Friction,
        contact: int,
        keys: Sequence[tuple[int, int, bool]],
        paths: tuple[str, str],
        largest: float,
        color: Rgba,
    ) -> None:
        """Adds the arrow of a contact's force or impulse, and its cones if there is friction.

        Keys are a frame, the row of the motion in it, and whether that is seen.
        """
        frames, rows, shown = (list(each) for each in zip(*keys, strict=True))
        touches = [self._stage.touch(contact, q) for q in motion.positions[rows]]
        places = np.array([place for place, _ in touches])
        normals = np.array([normal for _, normal in touches]) * np.array(shown)[:, np.newaxis]
        vectors = normals * friction.normals[rows, contact, np.newaxis]
        slides = (friction.largest[rows, contact] > 0) & shown
        for row in np.flatnonzero(slides).tolist():
            at = motion.positions[rows[row]], motion.velocities[rows[row]]
            along = self._stage.find_tangent(contact, *at)
            vectors[row] += friction.tangents[rows[row], contact] * along
        arrow, cones = paths
        shape_arrow(arrow, self._stage.size, self.film.meshcat, color)
        self.film.ride(arrow, frames, places, vectors / largest)
        sticks, mu = friction.sticks[rows, contact], float(self._coefficients[contact])
        for name, at in (("stick", slides & sticks), ("slip", slides & ~sticks)):
            if at.any():
                cone = partial(shape_cone, friction=mu, sticks=name == "stick")
                cone(f"{cones}/{name}", self._stage.size, self.film.meshcat, color)
                self.film.ride(f"{cones}/{name}", frames, places, normals * at[:, np.newaxis])

    def _flash(
        self, path: str, times: Sequence[float], places: Floats, sizes: Floats, color: Rgba
    ) -> None:
        """Adds flashes at places (k, 3) at times [s], of relative sizes (k,)."""
        put_in_front(path, Sphere(_FLASH * self._stage.size), self.film.meshcat, color)
        fades = round(_FLASH_TIME * self.film.rate)
        moments = self.film.moments(times, {-1: False, 0: True, fades: False})
        frames, numbers, shown = (list(each) for each in zip(*moments, strict=True))
        vectors = np.outer(sizes[numbers] * shown, [0.0, 0.0, 1.0])
        self.film.ride(path, frames, places[numbers], vectors)


def _find(acts: Bools) -> list[int]:
    """Returns the contacts that act in any row, of shape (K, m)."""
    return list(map(int, np.flatnonzero(acts.any(axis=0))))
