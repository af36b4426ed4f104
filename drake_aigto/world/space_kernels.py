"""Distances of a world in space, in compiled code."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.dynamics import Tree, TreeMemory, place
from drake_aigto.geometry import Closest, Shapes, cross, dot, find_closest, place_shapes
from drake_aigto.kernels import borrow, kernel


@kernel
def measure_pairs(
    tree: Tree, shapes: Shapes, pairs: Ints, signs: Floats, q: Floats, memory: TreeMemory,
    closest: Closest, J: Floats,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Returns φ (K, P) of pairs (P, 2), then normals and points of contact (K, P, 6), at q (K, nq).

    The normal is from the second shape to the first, and the point midway between both. J becomes
    ∂φ/∂q of as many of the first states as it has room for. Signs (P, nv) say whether degrees of
    freedom move the first shape, 1, or the second, −1.
    """
    tree, shapes, memory, closest = borrow(tree), borrow(shapes), borrow(memory), borrow(closest)
    distances = np.zeros((q.shape[0], pairs.shape[0]))
    points = np.zeros((q.shape[0], pairs.shape[0], 6))
    rotations, places = shapes.rotations.copy(), shapes.places.copy()
    for k in range(q.shape[0]):
        for i in range(tree.parents.size):
            place(tree, i, q[k], memory)
        place_shapes(shapes, memory.poses, rotations, places)
        for c in range(pairs.shape[0]):
            a, b = pairs[c]
            find_closest(shapes, a, b, rotations, places, closest)
            distances[k, c] = closest.distance[0]
            for i in range(3):
                points[k, c, i] = closest.n[i]
                points[k, c, 3 + i] = closest.foot[i] + distances[k, c] / 2 * closest.n[i]
            if k < J.shape[0]:
                n, moment = closest.n, closest.by_place[0]
                cross(points[k, c, 3:], n, moment)
                for s in range(tree.up.size):
                    S = memory.motions[s]
                    rate = dot(S, moment) + dot(S[3:], n)
                    J[k, c, tree.velocities[s]] = signs[c, s] * rate
    return distances, points
