"""Control, forces of contact and flashes of impacts that ride on motions in Meshcat."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import Joint

from drake_aigto.arrays import Floats, Ints
from drake_aigto.show.film import (
    GONE,
    Film,
    shape_arc,
    shape_arrow,
    shape_filled_cone,
    shape_open_cone,
)
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

_Shape = Callable[[str, float, Meshcat, Rgba], None]
_Key = tuple[int, int, bool]  # a frame, the row of the motion in it, and whether that is seen


class _Load(NamedTuple):
    """Forces or torques of the control at each row of a motion of K rows."""

    name: str  # of the link or the joint that it drives
    places: Floats  # shape (K, 3) [m]
    vectors: Floats  # in the world: forces [N] or torques [N m], shape (K, 3)


class _Push(NamedTuple):
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
        shapes: dict[str, _Shape] = {"arrow": shape_arrow, "arc": shape_arc}
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
            if not _is_actuated(joint, self._world):
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
        seen = np.convolve(sizes > GONE, np.ones(3))[1:-1] > 0  # the rows beside those, too
        seen[0] = True
        for row in np.flatnonzero(seen).tolist():
            direction = vectors[row] / sizes[row] if sizes[row] > GONE else direction
            turned = RotationMatrix.MakeFromOneVector(direction, 2)
            film.move(frames[row], path, RigidTransform(turned, places[row]))
            film.change(frames[row], path, "scale", [max(sizes[row], GONE)] * 3)
        film.hide(path, (frames[-1] + 1, film.last_frame))

    def _add_contacts(self, index: int, aside: RigidTransform, folder: str) -> None:
        """Adds forces, impulses and cones of friction of contacts, and flashes of impacts."""
        motion, (forces, impulses) = self._motions[index], self._friction[index]
        keys = [(self._film.frame(time), row, True) for row, time in enumerate(motion.times)]
        for contact in np.flatnonzero(np.any(forces.normals > 0, axis=0)).tolist():
            push = _Push(motion, forces, contact, self.largest[2], _MAGENTA)
            cones = f"{folder}/friction/{contact}/force"
            self._add_push(push, keys, aside, f"{folder}/contacts/{contact}/force", cones)
        for contact in np.flatnonzero(np.any(impulses.largest > 0, axis=0)).tolist():
            push = _Push(motion, impulses, contact, self.largest[3], _VIOLET)
            keys = _hold(self._film, motion, np.flatnonzero(impulses.largest[:, contact] > 0))
            cones = f"{folder}/friction/{contact}/impulse"
            self._add_push(push, keys, aside, f"{cones}/arrow", cones)
        if self.flashes:
            for contact in sorted({touch.contact for touch in motion.impacts}):
                self._add_flashes(motion, contact, aside, f"{folder}/contacts/{contact}/impacts")

    def _add_push(
        self, push: _Push, keys: Sequence[_Key], aside: RigidTransform, arrow: str, cones: str
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
        self._ride(arrow, shape_arrow, frames, places, vectors / largest, color)
        sticks, mu = friction.sticks[rows, contact], float(self._coefficients[contact])
        for name, shape, at in (
            ("stick", shape_filled_cone, slides & sticks),
            ("slip", shape_open_cone, slides & ~sticks),
        ):
            if at.any():
                cone = partial(shape, friction=mu)
                axes = normals * at[:, np.newaxis]
                self._ride(f"{cones}/{name}", cone, frames, places, axes, color)

    def _add_flashes(self, motion: Motion, contact: int, aside: RigidTransform, path: str) -> None:
        """Adds flashes where one contact is touched."""
        film, shares = self._film, []
        film.meshcat.SetObject(path, Sphere(_FLASH * self._stage.size), _YELLOW)
        for time in (touch.start for touch in motion.impacts if touch.contact == contact):
            place, _ = self._stage.touch(contact, motion.positions[find_row(motion, time)])
            film.move(max(film.frame(time) - 1, 0), path, RigidTransform(aside.multiply(place)))
            speed = calc_approach_speed(self._world, motion, time, contact)
            shares.append((time, speed / self._largest_speed))
        film.flash(path, shares)


def _hold(film: Film, motion: Motion, rows: Ints) -> list[_Key]:
    """Returns the keys of impacts at rows of a motion: each is seen for a moment."""
    keys: dict[int, tuple[int, bool]] = {}
    for row in rows.tolist():
        frame = film.frame(motion.times[row])
        # An earlier one ends here.
        keys = {f: each for f, each in keys.items() if f < frame - 1}
        end = frame + round(_LASTING * film.rate)
        keys |= {max(frame - 1, 0): (row, False), frame: (row, True)}
        keys |= {end: (row, True), end + 1: (row, False)}
    return [(frame, *keys[frame]) for frame in sorted(keys)]


def _is_actuated(joint: Joint, world: World) -> bool:
    start = joint.velocity_start()
    return bool(np.any(world.actuation[start : start + joint.num_velocities()]))
