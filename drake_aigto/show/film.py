"""Recordings in the making, and shapes that ride on what moves: arrows, arcs, cones of friction."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatAnimation, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_aigto.arrays import Floats

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

# Of the largest flash's radius: that of an impact without speed.
_LEAST_FLASH = 0.4
_FLASH_TIME = 0.15  # from an impact until its flash is gone [s]
# Scale of what is not to be seen: at 0 a transform has no inverse, of which browsers complain.
GONE = 1e-3
_REPETITIONS = 10_000


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
            self.change(frame, path, "scale", [GONE] * 3)

    def flash(self, path: str, impacts: Iterable[tuple[float, float]]) -> None:
        """Shows an object in an impact's size at once, and no more a moment later.

        Impacts are times [s], in order, and their speeds as parts of the largest one.
        """
        keys: dict[int, float] = {0: GONE}
        for time, share in impacts:
            frame = self.frame(time)
            # An earlier flash ends here.
            keys = {f: scale for f, scale in keys.items() if f < frame - 1}
            keys[max(frame - 1, 0)] = GONE
            keys[frame] = _LEAST_FLASH + (1 - _LEAST_FLASH) * share
            keys[frame + round(_FLASH_TIME * self.rate)] = GONE
        for frame, scale in keys.items():
            if frame < self.last_frame:
                self.change(frame, path, "scale", [scale] * 3)
        self.hide(path, [self.last_frame])

    def play(self) -> None:
        """Plays it again and again."""
        self._animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
        self._animation.set_repetitions(_REPETITIONS)
        self.meshcat.SetAnimation(self._animation)


def shape_arrow(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the longest arrow along z, for a window of a size [m]."""
    length = _LONGEST * size
    shaft, head = (1 - _POINT) * length, _POINT * length
    meshcat.SetObject(f"{path}/shaft", Cylinder(_SHAFT_RADIUS * length, shaft), color)
    meshcat.SetTransform(f"{path}/shaft", RigidTransform([0, 0, shaft / 2]))
    # Meshcat's cones stand on their tips.
    meshcat.SetObject(f"{path}/head", MeshcatCone(head, *[_POINT_RADIUS * length] * 2), color)
    tip = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, length])
    meshcat.SetTransform(f"{path}/head", tip)


def shape_arc(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the largest arc around z, its head the way that a right hand's fingers curl."""
    r = _ARC * size
    _shape_ring(f"{path}/ring", r, _RING * r, _TURN, meshcat, color)
    # Meshcat's cones stand on their tips.
    meshcat.SetObject(f"{path}/head", MeshcatCone(_HEAD_LENGTH * r, *[_HEAD * r] * 2), color)
    end, ahead = (np.array([np.cos(a), np.sin(a), 0.0]) for a in (_TURN, _TURN + np.pi / 2))
    turned = RotationMatrix.MakeFromOneVector(-ahead, 2)
    tip = RigidTransform(turned, r * (end + 0.9 * _HEAD_LENGTH * ahead))
    meshcat.SetTransform(f"{path}/head", tip)


def shape_filled_cone(
    path: str, size: float, meshcat: Meshcat, color: Rgba, friction: float
) -> None:
    """Puts a cone of forces |f_t| ≤ μ f around z, its tip where they act: translucent, closed."""
    height, radius = _measure_cone(size, friction)
    pale = Rgba(color.r(), color.g(), color.b(), _FILLED)
    meshcat.SetObject(path, MeshcatCone(height, radius, radius), pale)


def shape_open_cone(path: str, size: float, meshcat: Meshcat, color: Rgba, friction: float) -> None:
    """Puts the same cone as its ribs and its rim."""
    height, radius = _measure_cone(size, friction)
    length = _CONE * size
    thin = min(_RIB * length, _WIDEST * radius)
    for number, angle in enumerate(_around(_RIBS)):
        along = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        meshcat.SetObject(f"{path}/rib_{number}", Cylinder(thin, length), color)
        turned = RotationMatrix.MakeFromOneVector(along / length, 2)
        meshcat.SetTransform(f"{path}/rib_{number}", RigidTransform(turned, along / 2))
    _shape_ring(f"{path}/rim", radius, thin, 2 * np.pi, meshcat, color)
    meshcat.SetTransform(f"{path}/rim", RigidTransform([0.0, 0.0, height]))


def _measure_cone(size: float, friction: float) -> tuple[float, float]:
    """Returns the height and the radius of a cone of friction [m]."""
    height = _CONE * size / float(np.hypot(1.0, friction))
    return height, friction * height


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
