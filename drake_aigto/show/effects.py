"""Recordings in Meshcat, and what rides on motions: control, forces of contact, flashes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatAnimation, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix

from drake_aigto.arrays import Floats
from drake_aigto.show.motion import (
    Friction,
    Motion,
    calc_approach_speed,
    calc_friction,
    find_held,
    find_row,
)
from drake_aigto.show.shapes import moving_joints
from drake_aigto.show.stage import Stage
from drake_aigto.world import Scenario, World

_INK, _YELLOW = Rgba(0.13, 0.13, 0.13), Rgba(1.0, 0.78, 0.0)
_MAGENTA, _VIOLET = Rgba(0.75, 0.0, 0.45), Rgba(0.36, 0.1, 0.75)
_FLASH = 0.045  # radius of the largest flash, in sizes of the window
_LASTING = 0.3  # that the impulse of an impact is seen [s]
_LEAST_FLASH = 0.4  # Of the largest flash's radius: that of an impact without speed.
_FLASH_TIME = 0.15  # from an impact until its flash is gone [s]
# As parts of the window's size: the longest arrow, the radius of the largest arc, from a cone's tip
# to its rim.
_LONGEST, _ARC, _CONE = 0.22, 0.085, 0.14
# Of the longest arrow: its head, its head's and its shaft's radius.
_POINT, _POINT_RADIUS, _SHAFT_RADIUS = 0.32, 0.1, 0.04
# Of an arc with radius 1: half the thickness of its ring, the radius and the length of its head.
_RING, _HEAD, _HEAD_LENGTH = 0.07, 0.22, 0.55
_TURN = np.deg2rad(250.0)  # that an arc takes
_SECTIONS, _SIDES = 36, 8  # of the ring that an arc is made of
_RIBS = 4  # of an open cone
_RIB, _WIDEST = 0.018, 0.12  # Half their thickness, of its length; of its radius at most.
_FILLED = 0.4  # how much a filled cone covers of what is behind it

# Scale of what is not to be seen: at 0 a transform has no inverse, of which browsers complain.
_GONE = 1e-3
_REPETITIONS = 10_000

_Shape = Callable[[str, float, Meshcat, Rgba], None]
_Key = tuple[int, int, bool]  # a frame, the row of the motion in it, and whether that is seen


class Film:
    """A recording in the making, whose parts all have one length, so that they repeat together.

    How something looks when it is first keyed is also how it looks before the film is played.

    Attributes:
        meshcat: where it is shown.
        rate: frames per second.
        last_frame: that all parts end with.
    """

    def __init__(self, meshcat: Meshcat, begin: float, end: float, rate: int) -> None:
        """Begins with a frame at one time, and ends with one at another [s]."""
        self.meshcat, self.rate, self._begin = meshcat, rate, begin
        self.last_frame = self.frame(end)
        self._animation, self._keyed = MeshcatAnimation(rate), set[tuple[str, ...]]()

    def frame(self, time: float) -> int:
        """Returns the frame of a time [s]."""
        return round((time - self._begin) * self.rate)

    def move(self, frame: int, path: str, pose: RigidTransform) -> None:
        """Puts an object somewhere at a frame."""
        if self._is_first(path, ""):
            self.meshcat.SetTransform(path, pose)
        self._animation.SetTransform(frame, path, pose)

    def change(self, frame: int, path: str, name: str, value: bool | list[float]) -> None:
        """Gives a property of an object a value at a frame."""
        if self._is_first(path, name):
            self.meshcat.SetProperty(path, name, value)
        self._animation.SetProperty(frame, path, name, value)

    def _is_first(self, *key: str) -> bool:
        is_first = key not in self._keyed
        self._keyed.add(key)
        return is_first

    def hide(self, path: str, frames: Iterable[int]) -> None:
        """Makes an object invisible at frames."""
        for frame in frames:
            self.change(frame, path, "scale", [_GONE] * 3)

    def moments(
        self, times: Iterable[float], shown: Mapping[int, bool]
    ) -> list[tuple[int, int, bool]]:
        """Returns frames, the number of a moment [s], and whether it is seen there.

        Each is seen or not a number of frames after it, until the next one begins.
        """
        keys: dict[int, tuple[int, bool]] = {}
        for number, time in enumerate(times):
            frame = self.frame(time)
            keys = {f: key for f, key in keys.items() if f < frame - 1}
            keys |= {max(frame + after, 0): (number, seen) for after, seen in shown.items()}
        return [(frame, *keys[frame]) for frame in sorted(keys)]

    def play(self) -> None:
        """Plays it again and again."""
        self._animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
        self._animation.set_repetitions(_REPETITIONS)
        self.meshcat.SetAnimation(self._animation)


class _Load(NamedTuple):
    """Forces or torques of the control at each row of a motion of K rows."""

    name: str  # of the link or the joint that it drives
    places: Floats  # shape (K, 3) [m]
    vectors: Floats  # in the world: forces [N] or torques [N m], shape (K, 3)


class _PushArrow(NamedTuple):
    """Forces [N] or impulses [N s] of one contact of a motion."""

    motion: Motion
    friction: Friction
    contact: int
    largest: float  # of all contacts and motions
    color: Rgba


class Effects:
    """Arrows, arcs and flashes of several motions on one stage, all to one scale.

    Black arrows are forces of the control on links, and black arcs its torques at joints. Magenta
    arrows are forces of contacts while they last, friction included; flashes are impacts, larger
    where they are faster. Where something slides with friction, violet arrows are impulses of rigid
    impacts, seen for a moment, and both kinds of arrows keep to cones of friction, |f_t| ≤ μ f, of
    one size: filled ones while it sticks, open ones of ribs while it slips. Cones and impulses of
    each motion are in its folder "friction". Links that move in a plane do not hide any of it: it
    is drawn in front.

    Attributes:
        largest: of all forces of the control on one link [N], of all its torques [N m], of all
            forces of contacts [N], and of all impulses with friction [N s]; 0 without any.
        flashes: whether there is an impact.
    """

    def __init__(
        self,
        stage: Stage,
        world: World,
        scenario: Scenario,
        motions: Sequence[Motion],
        film: Film,
    ) -> None:
        """Finds the scales."""
        self._stage, self._world, self._film = stage, world, film
        self._motions = list(motions)
        self._loads = [self._calc_loads(motion) for motion in motions]
        self._friction = [calc_friction(motion, world, scenario) for motion in motions]
        self._coefficients = world.friction_coefficients(scenario)
        control = [
            [load.vectors for each in some for load in each]
            for some in zip(*self._loads, strict=True)
        ]
        contacts = [
            [np.dstack(each[:2]) for each in some] for some in zip(*self._friction, strict=True)
        ]
        self.largest = [
            max((np.max(np.linalg.norm(v, axis=-1), initial=0.0) for v in some), default=0.0)
            for some in (*control, *contacts)
        ]
        self._slides = any(np.any(each.largest > 0) for both in self._friction for each in both)
        is_rigid = scenario.contact == "rigid"
        self.flashes = is_rigid and any(motion.impacts for motion in motions)
        speeds = (
            calc_approach_speed(world, motion, touch.start, touch.contact)
            for motion in motions
            for touch in motion.impacts
        )
        self._largest_speed = max(speeds, default=0.0) or 1.0

    @property
    def notes(self) -> list[str]:
        """Explanations of what is shown."""
        force, torque, push, impulse = self.largest
        found = [
            f"black arrow: control, up to {force:.3g} N" if force > 0 else "",
            f"black arc: control, up to {torque:.3g} N m" if torque > 0 else "",
            f"magenta arrow: contact force, up to {push:.3g} N" if push > 0 else "",
            "yellow flash: impact" if self.flashes else "",
            f"violet arrow: impulse, up to {impulse:.3g} N s" if impulse > 0 else "",
            "cone of friction: filled sticks, ribs slip" if self._slides else "",
        ]
        return [note for note in found if note]

    def add(self, index: int, aside: RigidTransform, folder: str) -> None:
        """Adds to the film what rides on the motion of this number, moved aside in the world."""
        lift = self._stage.X_WT.rotation() @ np.array([0.0, 0.0, self._stage.depth])
        if self._stage.is_flat:
            aside = RigidTransform(aside.translation() + lift)
        frames = list(map(self._film.frame, self._motions[index].times))
        shapes: dict[str, _Shape] = {"arrow": _shape_arrow, "arc": _shape_arc}
        kinds = zip(shapes.items(), self._loads[index], self.largest, strict=False)
        for (kind, shape), loads, largest in kinds:
            for name, places, vectors in loads:
                if np.any(vectors):
                    path, places = f"{folder}/control/{name}/{kind}", aside.multiply(places.T).T
                    self._ride(path, shape, frames, places, vectors / largest)
        self._add_contacts(index, aside, folder)

    def _calc_loads(self, motion: Motion) -> tuple[list[_Load], list[_Load]]:
        """Returns forces of the control on links, and its torques at joints."""
        forces: dict[str, _Load] = {}
        torques: list[_Load] = []
        if motion.controls is None:
            return [], []
        generalized = (motion.controls @ self._world.actuation.T)[find_held(motion)]
        for joint in moving_joints(self._world):
            start = joint.velocity_start()
            if not np.any(self._world.actuation[start : start + joint.num_velocities()]):
                continue
            rows = zip(motion.positions, generalized, strict=True)
            found = [self._stage.load(joint, q, force) for q, force in rows]
            places, pushes, moments = np.array(found).transpose(1, 0, 2)
            torques.append(_Load(joint.name(), places, moments))
            if np.any(pushes):
                driven = self._stage.find_driven(joint)
                name = driven.body if driven else joint.name()
                # Forces of several joints that drive one link, such as two sliders, add up.
                before = forces[name].vectors if name in forces else 0.0
                forces[name] = _Load(name, places, pushes + before)
        return list(forces.values()), torques

    def _ride(
        self,
        path: str,
        shape: _Shape,
        frames: Sequence[int],
        places: Floats,
        vectors: Floats,
        color: Rgba = _INK,
    ) -> None:
        """Adds a shape, at places and along vectors of length 1 at most, (K, 3) each.

        It is as large as they are long. Where they are zero for long no frames are keyed.
        """
        film = self._film
        shape(path, self._stage.size, film.meshcat, color)
        direction = np.array([0.0, 0.0, 1.0])
        sizes = np.linalg.norm(vectors, axis=1)
        seen = np.convolve(sizes > _GONE, np.ones(3))[1:-1] > 0  # the rows beside those, too
        seen[0] = True
        for row in np.flatnonzero(seen).tolist():
            direction = vectors[row] / sizes[row] if sizes[row] > _GONE else direction
            turned = RotationMatrix.MakeFromOneVector(direction, 2)
            film.move(frames[row], path, RigidTransform(turned, places[row]))
            film.change(frames[row], path, "scale", [max(sizes[row], _GONE)] * 3)
        film.hide(path, (frames[-1] + 1, film.last_frame))

    def _add_contacts(self, index: int, aside: RigidTransform, folder: str) -> None:
        """Adds forces, impulses and cones of friction of contacts, and flashes of impacts."""
        motion, (forces, impulses) = self._motions[index], self._friction[index]
        keys = [(self._film.frame(time), row, True) for row, time in enumerate(motion.times)]
        for contact in np.flatnonzero(np.any(forces.normals > 0, axis=0)).tolist():
            push = _PushArrow(motion, forces, contact, self.largest[2], _MAGENTA)
            cones = f"{folder}/friction/{contact}/force"
            self._add_push(push, keys, aside, f"{folder}/contacts/{contact}/force", cones)
        end = round(_LASTING * self._film.rate)
        lasting = {-1: False, 0: True, end: True, end + 1: False}
        for contact in np.flatnonzero(np.any(impulses.largest > 0, axis=0)).tolist():
            push = _PushArrow(motion, impulses, contact, self.largest[3], _VIOLET)
            rows = np.flatnonzero(impulses.largest[:, contact] > 0)
            moments = self._film.moments(motion.times[rows], lasting)
            keys = [(frame, int(rows[number]), seen) for frame, number, seen in moments]
            cones = f"{folder}/friction/{contact}/impulse"
            self._add_push(push, keys, aside, f"{cones}/arrow", cones)
        if self.flashes:
            for contact in sorted({touch.contact for touch in motion.impacts}):
                self._add_flashes(motion, contact, aside, f"{folder}/contacts/{contact}/impacts")

    def _add_push(
        self, push: _PushArrow, keys: Sequence[_Key], aside: RigidTransform, arrow: str, cones: str
    ) -> None:
        """Adds the arrow of a contact's force or impulse, and its cones if there is friction."""
        motion, friction, contact, largest, color = push
        frames, rows, shown = (list(each) for each in zip(*keys, strict=True))
        touches = [self._stage.touch(contact, q) for q in motion.positions[rows]]
        places = np.array([aside.multiply(place) for place, _ in touches])
        normals = np.array([normal for _, normal in touches]) * np.array(shown)[:, np.newaxis]
        vectors = normals * friction.normals[rows, contact, np.newaxis]
        slides = (friction.largest[rows, contact] > 0) & shown
        for row in np.flatnonzero(slides).tolist():
            along = self._stage.find_tangent(contact, motion.positions[rows[row]])
            vectors[row] += friction.tangents[rows[row], contact] * along
        self._ride(arrow, _shape_arrow, frames, places, vectors / largest, color)
        sticks, mu = friction.sticks[rows, contact], float(self._coefficients[contact])
        for name, at in (("stick", slides & sticks), ("slip", slides & ~sticks)):
            if at.any():
                cone = partial(_shape_cone, friction=mu, sticks=name == "stick")
                axes = normals * at[:, np.newaxis]
                self._ride(f"{cones}/{name}", cone, frames, places, axes, color)

    def _add_flashes(self, motion: Motion, contact: int, aside: RigidTransform, path: str) -> None:
        """Adds flashes where one contact is touched."""
        film, fades = self._film, round(_FLASH_TIME * self._film.rate)
        film.meshcat.SetObject(path, Sphere(_FLASH * self._stage.size), _YELLOW)
        times, sizes = [touch.start for touch in motion.impacts if touch.contact == contact], []
        for time in times:
            place, _ = self._stage.touch(contact, motion.positions[find_row(motion, time)])
            film.move(max(film.frame(time) - 1, 0), path, RigidTransform(aside.multiply(place)))
            speed = calc_approach_speed(self._world, motion, time, contact)
            sizes.append(_LEAST_FLASH + (1 - _LEAST_FLASH) * (speed / self._largest_speed))
        moments = film.moments(times, {-1: False, 0: True, fades: False})
        if moments[0][0] > 0:
            film.hide(path, [0])
        for frame, number, seen in moments:
            if frame < film.last_frame:
                film.change(frame, path, "scale", [sizes[number] if seen else _GONE] * 3)
        film.hide(path, [film.last_frame])


def _shape_arrow(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the longest arrow along z, for a window of a size [m]."""
    length = _LONGEST * size
    shaft, head = (1 - _POINT) * length, _POINT * length
    meshcat.SetObject(f"{path}/shaft", Cylinder(_SHAFT_RADIUS * length, shaft), color)
    meshcat.SetTransform(f"{path}/shaft", RigidTransform([0, 0, shaft / 2]))
    # Meshcat's cones stand on their tips.
    meshcat.SetObject(f"{path}/head", MeshcatCone(head, *[_POINT_RADIUS * length] * 2), color)
    tip = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, length])
    meshcat.SetTransform(f"{path}/head", tip)


def _shape_arc(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the largest arc around z, its head the way that a right hand's fingers curl."""
    r = _ARC * size
    _shape_ring(f"{path}/ring", r, _RING * r, _TURN, meshcat, color)
    # Meshcat's cones stand on their tips.
    meshcat.SetObject(f"{path}/head", MeshcatCone(_HEAD_LENGTH * r, *[_HEAD * r] * 2), color)
    end, ahead = (np.array([np.cos(a), np.sin(a), 0.0]) for a in (_TURN, _TURN + np.pi / 2))
    turned = RotationMatrix.MakeFromOneVector(-ahead, 2)
    tip = RigidTransform(turned, r * (end + 0.9 * _HEAD_LENGTH * ahead))
    meshcat.SetTransform(f"{path}/head", tip)


def _shape_cone(
    path: str, size: float, meshcat: Meshcat, color: Rgba, friction: float, sticks: bool
) -> None:
    """Puts a cone of forces |f_t| ≤ μ f around z, its tip where they act.

    It is translucent and closed where contacts stick, else its ribs and its rim.
    """
    height = _CONE * size / float(np.hypot(1.0, friction))
    radius, length = friction * height, _CONE * size
    if sticks:
        pale = Rgba(color.r(), color.g(), color.b(), _FILLED)
        meshcat.SetObject(path, MeshcatCone(height, radius, radius), pale)
        return
    thin = min(_RIB * length, _WIDEST * radius)
    for number, angle in enumerate(_around(_RIBS)):
        along = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        meshcat.SetObject(f"{path}/rib_{number}", Cylinder(thin, length), color)
        turned = RotationMatrix.MakeFromOneVector(along / length, 2)
        meshcat.SetTransform(f"{path}/rib_{number}", RigidTransform(turned, along / 2))
    _shape_ring(f"{path}/rim", radius, thin, 2 * np.pi, meshcat, color)
    meshcat.SetTransform(f"{path}/rim", RigidTransform([0.0, 0.0, height]))


def _shape_ring(
    path: str, radius: float, thickness: float, turn: float, meshcat: Meshcat, color: Rgba
) -> None:
    """Puts a bent rod around z, half as thick as that all around [m], over a turn [rad]."""
    # Rings of points around the rod, joined by two triangles for each side of each section.
    angles, side = np.linspace(0, turn, _SECTIONS + 1)[:, np.newaxis], _around(_SIDES)
    out, up = radius + thickness * np.cos(side), thickness * np.sin(side)
    rings = [out * np.cos(angles), out * np.sin(angles), np.tile(up, (len(angles), 1))]
    first = np.arange(_SECTIONS * _SIDES)
    beside = first - first % _SIDES + (first + 1) % _SIDES
    triangles = np.hstack(
        [(first, beside, first + _SIDES), (beside, beside + _SIDES, first + _SIDES)]
    )
    vertices = np.array([each.ravel() for each in rings])
    meshcat.SetTriangleMesh(path, vertices, triangles.astype(np.int32), color)


def _around(count: int) -> Floats:
    """Returns the angles of `count` points around a circle [rad]."""
    return 2 * np.pi * np.arange(count) / count
