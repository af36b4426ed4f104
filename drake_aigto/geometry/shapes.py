"""Tables of shapes for compiled code, and room for what is closest of two of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints

# Kinds of shapes; of a pair, the first one is the shape with the lower number.
BALL, CAPSULE, BOX, CYLINDER, HULL, HALF_SPACE = range(6)

# Pairs whose distance is known; the lower number comes first.
_PAIRS = {
    *((BALL, each) for each in (BALL, CAPSULE, BOX, CYLINDER, HULL, HALF_SPACE)),
    *((each, HALF_SPACE) for each in (CAPSULE, BOX, CYLINDER, HULL)),
    (CAPSULE, CAPSULE),
    (CAPSULE, BOX),
}


class Shapes(NamedTuple):
    """Shapes on bodies, G of them; a body's frame is B, a shape's own G.

    Faces are triangles of convex hulls; those of shape i go from spans[i] to spans[i + 1].
    """

    bodies: Ints  # of each, shape (G,)
    kinds: Ints  # shape (G,)
    rotations: Floats  # R_BG, shape (G, 3, 3)
    places: Floats  # p_BG, shape (G, 3) [m]
    # Radius of a ball; radius and half length of a capsule and a cylinder, along z; half sizes of a
    # box; shape (G, 3) [m]. A half space fills z < 0.
    sizes: Floats
    bounds: Floats  # radii of spheres about their origins that hold them, shape (G,) [m]
    spans: Ints  # shape (G + 1,)
    faces: Floats  # three corners of each [m], and its unit normal outward, in G, (T, 4, 3)


class Closest(NamedTuple):
    """What is closest of shapes A and B, and how it changes as A moves and B stands still.

    A's body moves by a translation δc of its material at c and a turn ω about c:

        δn = by_place δc + by_turn ω,    δ(foot) = foot_by_place δc + foot_by_turn ω,    δφ = n · δc

    The last holds as what is closest on A is c but for a radius along n. A witness point of A is
    foot + φ n.
    """

    distance: Floats  # φ, shape (1,) [m]
    n: Floats  # unit normal, from B to A, shape (3,)
    foot: Floats  # witness point of B, shape (3,) [m]
    c: Floats  # point of A, shape (3,) [m]
    by_place: Floats  # shape (3, 3) [1/m]
    by_turn: Floats  # shape (3, 3)
    foot_by_place: Floats  # shape (3, 3)
    foot_by_turn: Floats  # shape (3, 3) [m]


def make_closest() -> Closest:
    """Returns room for one pair."""
    return Closest(np.zeros(1), *np.zeros((3, 3)), *np.zeros((4, 3, 3)))


def can_meet(first: int, second: int) -> bool:
    """Returns whether the distance of two kinds of shapes is known."""
    return (min(first, second), max(first, second)) in _PAIRS
