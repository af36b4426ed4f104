"""Coordinates of states as bounds at knots read them, and a hard goal that moves with the start.

A motion that repeats ends at the goal ⊕ s, s being by how much its start is moved: its coordinates
count less s there, and turns in space as rotation vectors from that place.
"""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Mechanics,
    MechanicsMemory,
    TreeMechanics,
    TreeMechanicsMemory,
    of_tree,
)
from drake_aigto.dynamics import QUATERNION, add_tangent, find_turning, subtract_positions


def read_tree_coordinate(
    mechanics: TreeMechanics,
    goal: Floats,
    z: Floats,
    i: int,
    moved: bool,
    memory: TreeMechanicsMemory,
) -> float:
    """Returns coordinate i of a state, in the order of (v, v); of turns, of that off the goal."""
    n, first, tree, about = mechanics.tree.up.size, mechanics.num_positions, mechanics.tree, goal
    change = z[z.size - 2 * n :]
    if i >= n or mechanics.places[i] >= 0:
        place = first - n + i if i >= n else mechanics.places[i]
        return z[place] - (change[i] if moved else 0.0)
    if moved:
        about = memory.position
        add_tangent(tree, goal, change, about)
    subtract_positions(tree, z, about, memory.reference)
    return memory.reference[i]


def push_tree_start(
    mechanics: TreeMechanics,
    z: Floats,
    i: int,
    push: float,
    stiffness: float,
    l1: Floats,
    l2: Floats,
    memory: TreeMechanicsMemory,
) -> None:
    """Adds derivatives of a penalty on coordinate i less that of the start, by the start's."""
    tree, n, D = mechanics.tree, mechanics.tree.up.size, memory.turning
    row, columns = i, 1
    D[0] = 1.0
    for k in range(tree.parents.size if i < n and mechanics.places[i] < 0 else 0):
        at = tree.velocities[tree.dofs[k]]
        if tree.kinds[k] >= QUATERNION and at <= i < at + 3:
            change = z[z.size - 2 * n + at :]
            find_turning(change[0], change[1], change[2], D)
            row, columns = at, 3
    first, slope = 2 * n + 2 + row, D[3 * (i - row) :]
    for c in range(columns):
        l1[first + c] -= push * slope[c]
        l2[i, first + c] -= stiffness * slope[c]
        for d in range(c, columns):
            l2[first + c, first + d] += stiffness * slope[c] * slope[d]


@of_tree(read_tree_coordinate)
def read_coordinate(
    mechanics: Mechanics, goal: Floats, z: Floats, i: int, moved: bool, memory: MechanicsMemory
) -> float:
    """Returns coordinate i of a state, for its bounds; if the goal moves, less s of the start."""
    return float(z[i] - z[z.size // 2 + 1 + i]) if moved else float(z[i])


@of_tree(push_tree_start)
def push_start(
    mechanics: Mechanics,
    z: Floats,
    i: int,
    push: float,
    stiffness: float,
    l1: Floats,
    l2: Floats,
    memory: MechanicsMemory,
) -> None:
    """Adds derivatives of a penalty on coordinate i less s of the start, by s."""
    s = z.size // 2 + 1 + i  # z is (x, τ, t, s).
    l1[s] -= push
    l2[i, s] -= stiffness
    l2[s, s] += stiffness
