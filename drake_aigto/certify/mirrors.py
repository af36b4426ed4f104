"""Elastic walls as mirrors, whatever they couple: walls askew, and like masses that touch.

Let all masses be alike, so that a touch without loss mirrors the motion at its plane n·q + d = 0:
that of a wall, or q_j − q_i = 0. Where all planes are parallel or meet at angles π/k, they cut
space into copies of the room, each a mirror image of the next (Coxeter 1934, Ann. Math. 35:588): a
kaleidoscope. A motion unfolds to a flight without walls to one of the goal's images; and of all
images of two places of the room, these places themselves are nearest to each other (Humphreys 1990,
"Reflection Groups and Coxeter Groups", 1.12). So the nearest image of the goal is as far from where
the motion coasts to as the goal is from that place, folded into the room.
"""

from __future__ import annotations

import math

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.world import ConstantDynamics

_MOST_FOLDS = 10_000
_ANGLE = 1e-9  # [rad], which moves no image by more than what bounds give way by
_LEAST_ANGLE = 12  # π over this


def fold(point: Floats, normals: Floats, offsets: Floats) -> Floats | None:
    """Returns the image of a point within a room, or None if it is too many mirrors away.

    Args:
        point: shape (n,).
        normals: of the mirrors, into the room (m, n).
        offsets: n·q + offset is 0 at each mirror, more in the room (m,).
    """
    folded = np.array(point, dtype=float)
    squares = np.sum(normals**2, axis=1)
    for _ in range(_MOST_FOLDS):
        heights = normals @ folded + offsets
        lowest = int(np.argmin(heights / np.sqrt(squares))) if heights.size else -1
        if lowest < 0 or heights[lowest] >= 0.0:
            return folded
        folded -= 2.0 * heights[lowest] / squares[lowest] * normals[lowest]
    return None


def obstacle_to_mirrors(dynamics: ConstantDynamics, restitutions: Floats) -> str:
    """Returns why touches are no mirrors of a kaleidoscope, or an empty string.

    Args:
        dynamics: of the world.
        restitutions: of its contacts (m,).
    """
    if np.any(restitutions != 1.0):
        return "touches take energy away"
    if np.any(dynamics.drift):
        return "a force bends what flies"
    worth = dynamics.gain @ dynamics.gain.T
    if not (_is_alike(dynamics.inverse_mass) and _is_alike(worth)):
        return "masses or what drives them are not alike"
    unit = dynamics.jacobian / np.linalg.norm(dynamics.jacobian, axis=1, keepdims=True)
    cosines = np.clip(-(unit @ unit.T)[np.triu_indices(len(unit), 1)], -1.0, 1.0)
    angles = [0.0, *(math.pi / k for k in range(2, _LEAST_ANGLE + 1))]
    if any(min(abs(angle - own) for own in angles) > _ANGLE for angle in np.arccos(cosines)):
        return "they meet at an angle that is no whole part of 180°"
    return ""


def _is_alike(matrix: Floats) -> bool:
    """Returns whether a matrix is a number times the identity, and more than 0."""
    return bool(matrix[0, 0] > 0.0 and np.all(matrix == matrix[0, 0] * np.eye(len(matrix))))
