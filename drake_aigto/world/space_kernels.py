"""Distances and differences of a world in space, in compiled code."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.dynamics import Tree, TreeMemory, place, subtract_positions
from drake_aigto.geometry import Closest, Shapes, find_closest, place_shapes
from drake_aigto.kernels import kernel


@kernel
def measure_pairs(
    tree: Tree, shapes: Shapes, pairs: Ints, q: Floats, memory: TreeMemory, closest: Closest
) -> tuple[Floats, Floats]:
    """Returns φ of pairs, then their normals and points of contact, of states q (K, nq).

    The normal is from the second shape to the first, and the point midway between both.

    Returns:
        φ, shape (K, P) [m]; n and C, shape (K, P, 6).
    """
    distances = np.zeros((q.shape[0], pairs.shape[0]))
    points = np.zeros((q.shape[0], pairs.shape[0], 6))
    rotations, places = shapes.rotations.copy(), shapes.places.copy()
    for k in range(q.shape[0]):
        for i in range(tree.parents.size):
            place(tree, i, q[k], memory)
        place_shapes(shapes, memory.poses, rotations, places)
        for c in range(pairs.shape[0]):
            a, b = pairs[c]
            find_closest(
                shapes.kinds[a], rotations[a], places[a], shapes.sizes[a],
                shapes.kinds[b], rotations[b], places[b], shapes.sizes[b], closest,
            )  # fmt: skip
            distances[k, c] = closest.numbers[0]
            for i in range(3):
                points[k, c, i] = closest.numbers[1] * closest.n[i]
                points[k, c, 3 + i] = closest.foot[i] + distances[k, c] / 2 * closest.n[i]
    return distances, points


@kernel
def subtract_rows(tree: Tree, after: Floats, before: Floats) -> Floats:
    """Returns the shortest δ with before ⊕ δ = after of rows (K, nq) each, shape (K, nv)."""
    found = np.zeros((after.shape[0], tree.up.size))
    for k in range(after.shape[0]):
        subtract_positions(tree, after[k], before[k], found[k])
    return found
