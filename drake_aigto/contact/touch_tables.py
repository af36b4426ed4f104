"""Tables of pairs of shapes that may touch, for compiled code, and room for their evaluation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.geometry import Closest, Shapes, make_closest

# Columns of `TouchTable.law`.
STIFFNESS, DISSIPATION, FRICTION, STICTION, SHARE, GIVE, SLOWING = range(7)


class TouchTable(NamedTuple):
    """Pairs of shapes that may touch, P of them, on the bodies of a tree with n velocities.

    Couples are two bodies, A and B, that have pairs; there are W of them.
    """

    shapes: Shapes
    pairs: Ints  # shapes A and B of each, A's kind the lower number, shape (P, 2)
    law: Floats  # k [N/m], d [s/m], μ, v_s [m/s], share, g [m], and a of each pair, shape (P, 7)
    couples: Ints  # that of each pair, shape (P,)
    # Degrees of freedom that move A or B but not both; of couple i from starts[i] to starts[i + 1].
    starts: Ints  # shape (W + 1,)
    chain: Ints
    signs: Floats  # 1 for A, −1 for B
    carries: Bools  # whether degree of freedom j moves the axis of i, [j, i], shape (n, n)


class TouchRoom(NamedTuple):
    """Room for an evaluation of all pairs."""

    rotations: Floats  # of shapes in the world, shape (G, 3, 3)
    places: Floats  # of the same, shape (G, 3) [m]
    closest: Closest  # of one pair
    speeds: Floats  # velocities of A relative to B, shape (W, 6)
    wrenches: Floats  # F of couples, shape (W, 6)
    by_move: Floats  # K, transposed, shape (W, 6, 6)
    by_speed: Floats  # G, transposed, shape (W, 6, 6)
    vectors: Floats  # v, f, ∂f/∂f_n, and others, shape (8, 3)
    by_vectors: Floats  # ∂f/∂v and ∂f/∂n of one pair, shape (2, 3, 3)
    moves: Floats  # δF of one pair by six moves, shape (6, 6)
    motions: Floats  # of one degree of freedom, shape (5, 6)
    # φ, ∞ of pairs that are too far apart to push; f_n, 0 of those that do not; C and n of each
    # pair, shape (P, 8).
    found: Floats


def make_touch_room(table: TouchTable) -> TouchRoom:
    """Returns room for an evaluation."""
    G, W = len(table.shapes.kinds), len(table.starts) - 1
    sizes = (W, 6), (W, 6), (W, 6, 6), (W, 6, 6), (8, 3), (2, 3, 3), (6, 6), (5, 6)
    rooms = [np.zeros(size) for size in (*sizes, (len(table.pairs), 8))]
    return TouchRoom(np.tile(np.eye(3), (G, 1, 1)), np.zeros((G, 3)), make_closest(), *rooms)
