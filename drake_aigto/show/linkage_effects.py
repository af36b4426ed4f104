"""What rides on a mechanism in Meshcat: its control, forces of contacts, and flashes of impacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from pydrake.geometry import Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import Joint

from drake_aigto.arrays import Floats, Ints
from drake_aigto.show.effects import GONE, INK, YELLOW, Film, flash_keys
from drake_aigto.show.friction import Friction, calc_friction
from drake_aigto.show.linkage import Linkage, moving_joints
from drake_aigto.show.linkage_shapes import (
    shape_arc,
    shape_filled_cone,
    shape_longest_arrow,
    shape_open_cone,
)
from drake_aigto.show.motion import Motion, calc_approach_speed, find_held, find_row
from drake_aigto.world import Scenario, World

_MAGENTA, _VIOLET = Rgba(0.75, 0.0, 0.45), Rgba(0.36, 0.1, 0.75)
_FLASH = 0.045  # The largest flash, in sizes of the mechanism.
_LASTING = 0.3  # that the impulse of an impact is seen [s]
_SHAPES = {"arrow": shape_longest_arrow, "arc": shape_arc}

_Shape = Callable[[str, float, Meshcat, Rgba], None]
_Key = tuple[int, int, bool]  # a frame, the row of the motion in it, and whether that is seen


class _Push(NamedTuple):
    """What one contact of a motion pushes with: forces [N] or impulses [N s]."""

    motion: Motion
    friction: Friction
    contact: int
    largest: float  # of all contacts and motions
    color: Rgba


class LinkageEffects:
    """Arrows, arcs and flashes of several motions of one mechanism, all to one scale.

    Black arrows are forces of the control, and black arcs its torques, where their joints are.
    Magenta arrows are what contacts push with while they last, friction included; flashes are
    impacts, larger where they are faster. Where something rubs, violet arrows are impulses of rigid
    impacts, seen for a moment, and both kinds of arrows keep to cones of friction, |f_t| ≤ μ f, of
    one size: filled ones while it sticks, open ones of ribs while it slips. Cones and impulses of
    each motion are in its folder "friction". Links of a flat mechanism do not hide any of it: it is
    drawn in front.

    Attributes:
        largest: of all forces of the control on one joint [N], of all its torques [N m], of all
            forces of contacts [N], and of all impulses that rub [N s]; 0 without any.
        flashes: whether there is an impact.
    """

    def __init__(
        self,
        linkage: Linkage,
        world: World,
        scenario: Scenario,
        motions: Sequence[Motion],
        film: Film,
    ) -> None:
        """Finds the scales."""
        self._linkage, self._world, self._film = linkage, world, film
        self._joints = [joint for joint in moving_joints(world) if _is_actuated(joint, world)]
        self._motions = list(motions)
        self._loads = [self._calc_loads(motion) for motion in motions]
        self._friction = [calc_friction(motion, world, scenario) for motion in motions]
        self._coefficients = world.friction_coefficients(scenario)
        sizes = np.max([np.max(_sizes(load), axis=(0, 1)) for load in self._loads], axis=0)
        forces, impulses = zip(*self._friction, strict=True)
        self.largest = (*sizes.tolist(), max(map(_largest, forces)), max(map(_largest, impulses)))
        self._rubs = any(np.any(each.largest > 0) for both in self._friction for each in both)
        is_rigid = scenario.contact == "rigid"
        self.flashes = is_rigid and any(motion.impacts for motion in motions)
        speeds = (self._speed(motion, *impact) for motion in motions for impact in _impacts(motion))
        self._largest_speed = max(speeds, default=0.0) or 1.0

    @property
    def notes(self) -> list[str]:
        """What has to be said of what is shown."""
        force, torque, push, impulse = self.largest
        found = [
            f"black arrow: control, up to {force:.3g} N" if force > 0 else "",
            f"black arc: control, up to {torque:.3g} N m" if torque > 0 else "",
            f"magenta arrow: contact force, up to {push:.3g} N" if push > 0 else "",
            "yellow flash: impact" if self.flashes else "",
            f"violet arrow: impulse, up to {impulse:.3g} N s" if impulse > 0 else "",
            "cone of friction: filled sticks, ribs slip" if self._rubs else "",
        ]
        return [note for note in found if note]

    def add(self, index: int, aside: RigidTransform, folder: str) -> None:
        """Adds to the film what rides on the motion of this number, moved aside in the world."""
        X_WT = self._linkage.X_WT
        lift = X_WT.rotation() @ np.array([0.0, 0.0, self._linkage.depth])
        aside = RigidTransform(aside.translation() + (lift if self._linkage.is_flat else 0.0))
        frames = list(map(self._film.frame, self._motions[index].times))
        for joint, loads in zip(
            self._joints, self._loads[index].transpose(1, 2, 0, 3), strict=True
        ):
            places, *vectors = loads
            for (kind, shape), vector, largest in zip(
                _SHAPES.items(), vectors, self.largest, strict=False
            ):
                if np.any(vector):
                    path = f"{folder}/control/{joint.name()}/{kind}"
                    self._ride(path, shape, frames, aside.multiply(places.T).T, vector / largest)
        self._add_contacts(index, aside, folder)

    def _calc_loads(self, motion: Motion) -> Floats:
        """Returns place, force and torque in the world of the control on each of the joints.

        At each row of the motion, shape (K, joints, 3, 3) [m], [N], [N m].
        """
        shape = len(motion.times), len(self._joints)
        if motion.controls is None:
            return np.zeros((*shape, 3, 3))
        generalized = (motion.controls @ self._world.actuation.T)[find_held(motion)]
        return np.array(
            [
                [self._linkage.load(joint, q, force) for joint in self._joints]
                for q, force in zip(motion.positions, generalized, strict=True)
            ]
        ).reshape(*shape, 3, 3)

    def _ride(
        self,
        path: str,
        shape: _Shape,
        frames: Sequence[int],
        places: Floats,
        vectors: Floats,
        color: Rgba = INK,
    ) -> None:
        """Adds a shape, at places and along vectors of length 1 at most, (K, 3) each.

        It is as large as they are long. Where they are zero for long no frames are keyed.
        """
        film = self._film
        shape(path, self._linkage.size, film.meshcat, color)
        direction = np.array([0.0, 0.0, 1.0])
        sizes = np.linalg.norm(vectors, axis=1)
        seen = np.convolve(sizes > GONE, np.ones(3))[1:-1] > 0  # the rows beside those, too
        seen[0] = True
        for row in np.flatnonzero(seen).tolist():
            direction = vectors[row] / sizes[row] if sizes[row] > GONE else direction
            turned = RotationMatrix.MakeFromOneVector(direction, 2)
            film.move(frames[row], path, RigidTransform(turned, places[row]))
            film.change(frames[row], path, "scale", [max(sizes[row], GONE)] * 3)
        for frame in (frames[-1] + 1, film.last_frame):
            film.change(frame, path, "scale", [GONE] * 3)

    def _add_contacts(self, index: int, aside: RigidTransform, folder: str) -> None:
        """Adds what contacts push with and rub by, and what flashes where one is touched."""
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
        """Adds the arrow of what a contact pushes with, and if it rubs its cones."""
        motion, friction, contact, largest, color = push
        frames, rows, shown = (list(each) for each in zip(*keys, strict=True))
        touches = [self._linkage.touch(contact, q) for q in motion.positions[rows]]
        places = np.array([aside.multiply(place) for place, _ in touches])
        normals = np.array([normal for _, normal in touches]) * np.array(shown)[:, np.newaxis]
        vectors = normals * friction.normals[rows, contact, np.newaxis]
        rubs = (friction.largest[rows, contact] > 0) & shown
        for row in np.flatnonzero(rubs).tolist():
            along = self._linkage.find_tangent(contact, motion.positions[rows[row]])
            vectors[row] += friction.tangents[rows[row], contact] * along
        self._ride(arrow, shape_longest_arrow, frames, places, vectors / largest, color)
        sticks, mu = friction.sticks[rows, contact], float(self._coefficients[contact])
        for name, shape, at in (
            ("stick", shape_filled_cone, rubs & sticks),
            ("slip", shape_open_cone, rubs & ~sticks),
        ):
            if at.any():
                cone = partial(shape, friction=mu)
                axes = normals * at[:, np.newaxis]
                self._ride(f"{cones}/{name}", cone, frames, places, axes, color)

    def _add_flashes(self, motion: Motion, contact: int, aside: RigidTransform, path: str) -> None:
        """Adds what flashes where one contact is touched."""
        film = self._film
        film.meshcat.SetObject(path, Sphere(_FLASH * self._linkage.size), YELLOW)
        times = [time for time, each in _impacts(motion) if each == contact]
        for time in times:
            place, _ = self._linkage.touch(contact, motion.positions[find_row(motion, time)])
            film.move(max(film.frame(time) - 1, 0), path, RigidTransform(aside.multiply(place)))
        shares = ((t, self._speed(motion, t, contact) / self._largest_speed) for t in times)
        for frame, scale in flash_keys(film, shares).items():
            film.change(frame, path, "scale", [scale] * 3)

    def _speed(self, motion: Motion, time: float, contact: int) -> float:
        return calc_approach_speed(self._world, motion, time, contact)


def _impacts(motion: Motion) -> list[tuple[float, int]]:
    """Returns the times and contacts of a motion's impacts."""
    return [(touch.start, touch.contact) for touch in motion.impacts]


def _largest(friction: Friction) -> float:
    """Returns the largest of all forces or impulses."""
    return float(np.max(np.hypot(friction.normals, friction.tangents), initial=0.0))


def _hold(film: Film, motion: Motion, rows: Ints) -> list[_Key]:
    """Returns the keys of impacts at rows of a motion: each is seen for a moment."""
    keys: dict[int, tuple[int, bool]] = {}
    for row in rows.tolist():
        frame = film.frame(motion.times[row])
        # What is left of an earlier one ends here.
        keys = {f: each for f, each in keys.items() if f < frame - 1}
        end = frame + round(_LASTING * film.rate)
        keys |= {max(frame - 1, 0): (row, False), frame: (row, True)}
        keys |= {end: (row, True), end + 1: (row, False)}
    return [(frame, *keys[frame]) for frame in sorted(keys)]


def _is_actuated(joint: Joint, world: World) -> bool:
    start = joint.velocity_start()
    return bool(np.any(world.actuation[start : start + joint.num_velocities()]))


def _sizes(loads: Floats) -> Floats:
    """Returns the sizes of forces and torques, shape (K, joints, 2), at least one of each."""
    sizes: Floats = np.linalg.norm(loads[:, :, 1:], axis=-1)
    return sizes
