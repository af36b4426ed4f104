"""What rides on a mechanism in Meshcat: its control, forces of contacts, and flashes of impacts."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.geometry import Meshcat, MeshcatCone, Rgba, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.tree import Joint

from drake_aigto.arrays import Floats
from drake_aigto.show.effects import ARROW, GONE, INK, YELLOW, Film, flash_keys, shape_arrow
from drake_aigto.show.linkage import Linkage, moving_joints
from drake_aigto.show.motion import (
    Motion,
    calc_approach_speed,
    calc_contact_forces,
    find_held,
    find_row,
)
from drake_aigto.world import Scenario, World

_MAGENTA = Rgba(0.75, 0.0, 0.45)
# In sizes of the mechanism: the longest arrow, the radius of the largest arc, the largest flash.
_LONGEST, _ARC, _FLASH = 0.22, 0.085, 0.045
# Of an arc with radius 1: half the thickness of its ring, the radius and the length of its head.
_RING, _HEAD, _HEAD_LENGTH = 0.07, 0.22, 0.55
_TURN = np.deg2rad(250.0)  # that an arc takes
_SECTIONS, _SIDES = 36, 8  # of the ring that an arc is made of


class LinkageEffects:
    """Arrows, arcs and flashes of several motions of one mechanism, all to one scale.

    Black arrows are forces of the control, and black arcs its torques, where their joints are.
    Magenta arrows are what contacts push with while they last; flashes are impacts, larger where
    they are faster. Links of a flat mechanism do not hide them: they are drawn in front.

    Attributes:
        largest: of all forces of the control on one joint [N], of all its torques [N m], and of all
            forces of contacts [N]; 0 without any.
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
        self._forces = [calc_contact_forces(motion, world, scenario) for motion in motions]
        sizes = np.max([np.max(_sizes(load), axis=(0, 1)) for load in self._loads], axis=0)
        pushes = [np.max(force, initial=0.0) for force in self._forces]
        self.largest = (*sizes.tolist(), float(max(pushes)))
        is_rigid = scenario.contact == "rigid"
        self.flashes = is_rigid and any(motion.impacts for motion in motions)
        speeds = (self._speed(motion, *impact) for motion in motions for impact in _impacts(motion))
        self._largest_speed = max(speeds, default=0.0) or 1.0

    @property
    def notes(self) -> list[str]:
        """What has to be said of what is shown."""
        force, torque, push = self.largest
        found = [
            f"black arrow: control, up to {force:.3g} N" if force > 0 else "",
            f"black arc: control, up to {torque:.3g} N m" if torque > 0 else "",
            f"magenta arrow: contact force, up to {push:.3g} N" if push > 0 else "",
            "yellow flash: impact" if self.flashes else "",
        ]
        return [note for note in found if note]

    def add(self, index: int, aside: RigidTransform, folder: str) -> None:
        """Adds to the film what rides on the motion of this number, moved aside in the world."""
        X_WT = self._linkage.X_WT
        lift = X_WT.rotation() @ np.array([0.0, 0.0, self._linkage.depth])
        aside = RigidTransform(aside.translation() + (lift if self._linkage.is_flat else 0.0))
        for joint, loads in zip(
            self._joints, self._loads[index].transpose(1, 2, 0, 3), strict=True
        ):
            places, *vectors = loads
            for kind, vector, largest in zip(_SHAPES, vectors, self.largest, strict=False):
                if np.any(vector):
                    path = f"{folder}/control/{joint.name()}/{kind}"
                    self._ride(index, path, kind, aside.multiply(places.T).T, vector / largest)
        self._add_contacts(index, aside, f"{folder}/contacts")

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
        self, index: int, path: str, kind: str, places: Floats, vectors: Floats, color: Rgba = INK
    ) -> None:
        """Adds an arrow or an arc, at places and along vectors of length 1 at most, (K, 3) each."""
        film = self._film
        _SHAPES[kind](path, self._linkage.size, film.meshcat, color)
        direction = np.array([0.0, 0.0, 1.0])
        frames = list(map(film.frame, self._motions[index].times))
        for frame, place, vector in zip(frames, places, vectors, strict=True):
            size = float(np.linalg.norm(vector))
            direction = vector / size if size > GONE else direction
            turned = RotationMatrix.MakeFromOneVector(direction, 2)
            film.move(frame, path, RigidTransform(turned, place))
            film.change(frame, path, "scale", [max(size, GONE)] * 3)
        for frame in (frames[-1] + 1, film.last_frame):
            film.change(frame, path, "scale", [GONE] * 3)

    def _add_contacts(self, index: int, aside: RigidTransform, folder: str) -> None:
        """Adds the arrows of contacts that push, and what flashes where one is touched."""
        motion, forces = self._motions[index], self._forces[index]
        for contact in np.flatnonzero(np.any(forces > 0, axis=0)).tolist():
            touches = [self._linkage.touch(contact, q) for q in motion.positions]
            places = np.array([aside.multiply(place) for place, _ in touches])
            normals = np.array([normal for _, normal in touches])
            vectors = normals * forces[:, [contact]] / self.largest[2]
            self._ride(index, f"{folder}/{contact}/force", "arrow", places, vectors, _MAGENTA)
        if self.flashes:
            for contact in sorted({touch.contact for touch in motion.impacts}):
                self._add_flashes(motion, contact, aside, f"{folder}/{contact}/impacts")

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


def _is_actuated(joint: Joint, world: World) -> bool:
    start = joint.velocity_start()
    return bool(np.any(world.actuation[start : start + joint.num_velocities()]))


def _sizes(loads: Floats) -> Floats:
    """Returns the sizes of forces and torques, shape (K, joints, 2), at least one of each."""
    sizes: Floats = np.linalg.norm(loads[:, :, 1:], axis=-1)
    return sizes


def _shape_arrow(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the longest arrow along z, for a mechanism of a size [m]."""
    shape_arrow(path, _LONGEST * size / ARROW, meshcat, color)


def _shape_arc(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the largest arc around z, its head the way that a right hand's fingers curl."""
    r = _ARC * size
    # Rings of points around the arc, joined by two triangles for each side of each section.
    turn, side = np.linspace(0, _TURN, _SECTIONS + 1)[:, np.newaxis], _around(_SIDES)
    out = 1 + _RING * np.cos(side)
    rings = [out * np.cos(turn), out * np.sin(turn), np.tile(_RING * np.sin(side), (len(turn), 1))]
    first = np.arange(_SECTIONS * _SIDES)
    beside = first - first % _SIDES + (first + 1) % _SIDES
    triangles = np.hstack(
        [(first, beside, first + _SIDES), (beside, beside + _SIDES, first + _SIDES)]
    )
    vertices = r * np.array([each.ravel() for each in rings])
    meshcat.SetTriangleMesh(f"{path}/ring", vertices, triangles.astype(np.int32), color)
    # Meshcat's cones stand on their tips.
    meshcat.SetObject(f"{path}/head", MeshcatCone(_HEAD_LENGTH * r, *[_HEAD * r] * 2), color)
    end, ahead = (np.array([np.cos(a), np.sin(a), 0.0]) for a in (_TURN, _TURN + np.pi / 2))
    turned = RotationMatrix.MakeFromOneVector(-ahead, 2)
    tip = RigidTransform(turned, r * (end + 0.9 * _HEAD_LENGTH * ahead))
    meshcat.SetTransform(f"{path}/head", tip)


def _around(count: int) -> Floats:
    """Returns angles of so many points around a circle [rad]."""
    return 2 * np.pi * np.arange(count) / count


_SHAPES = {"arrow": _shape_arrow, "arc": _shape_arc}
