"""Shapes that ride on a mechanism in Meshcat: arrows, arcs, and cones of friction."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Cylinder, Meshcat, MeshcatCone, Rgba
from pydrake.math import RigidTransform, RotationMatrix

from drake_aigto.arrays import Floats
from drake_aigto.show.effects import ARROW, shape_arrow

# In sizes of the mechanism: the longest arrow, the radius of the largest arc, from a cone's tip to
# its rim.
_LONGEST, _ARC, _CONE = 0.22, 0.085, 0.14
# Of an arc with radius 1: half the thickness of its ring, the radius and the length of its head.
_RING, _HEAD, _HEAD_LENGTH = 0.07, 0.22, 0.55
_TURN = np.deg2rad(250.0)  # that an arc takes
_SECTIONS, _SIDES = 36, 8  # of the ring that an arc is made of
_RIBS = 4  # of an open cone
_RIB, _WIDEST = 0.018, 0.12  # Half their thickness, of its length; of its radius at most.
_FILLED = 0.4  # how much a filled cone covers of what is behind it


def shape_longest_arrow(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the longest arrow along z, for a mechanism of a size [m]."""
    shape_arrow(path, _LONGEST * size / ARROW, meshcat, color)


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
    """Returns angles of so many points around a circle [rad]."""
    return 2 * np.pi * np.arange(count) / count
