"""States and rates in compiled code, whatever the dynamics: a tape of sums, or a tree.

Numba chooses by the type of the tables as it compiles, and so one descent serves both, of which
neither contains the other. Each function here is that of tapes, whose states are flat: x = z, with
n positions and as many velocities.
"""

from __future__ import annotations

from drake_aigto.arrays import Floats
from drake_aigto.contact import Mechanics, MechanicsMemory, accelerate, of_tree
from drake_aigto.shooting.tree_stages import (
    accelerate_tree,
    align_tree,
    bend_tree,
    compare_tree,
    enter_tree,
    leave_tree,
    read_tree_coordinate,
    shift_tree,
    subtract_tree,
    turn_end_of_tree,
    turn_rows_of_tree,
)


@of_tree(accelerate_tree)
def accelerate_stage(
    mechanics: Mechanics,
    z: Floats,
    y: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    memory: MechanicsMemory,
) -> None:
    """Computes v̇ at y within a stage that starts at z, and ∂v̇/∂(y, u) if asked."""
    accelerate(mechanics, y, u, eps, has_slopes, memory)


@of_tree(enter_tree)
def enter(mechanics: Mechanics, z: Floats, x: Floats) -> None:
    """Computes y at the start of a stage."""
    for i in range(x.size):
        x[i] = z[i]


@of_tree(leave_tree)
def leave(
    mechanics: Mechanics,
    z: Floats,
    x: Floats,
    has_slopes: bool,
    F: Floats,
    after: Floats,
    memory: MechanicsMemory,
) -> None:
    """Computes the state after a stage from y, and makes derivatives F of y those of the state."""
    for i in range(x.size):
        after[i] = x[i]


@of_tree(bend_tree)
def bend(
    mechanics: Mechanics,
    y: Floats,
    has_slopes: bool,
    slope: Floats,
    Y: Floats,
    K: Floats,
    memory: MechanicsMemory,
) -> None:
    """Makes velocities, and their derivatives K, rates of positions, in place."""


@of_tree(compare_tree)
def compare(
    mechanics: Mechanics,
    row: Floats,
    next_row: Floats,
    share: float,
    z: Floats,
    y: Floats,
    off: Floats,
    memory: MechanicsMemory,
) -> None:
    """Computes how far y is off a state between two."""
    for i in range(off.size):
        off[i] = y[i] - row[i] - share * (next_row[i] - row[i])


@of_tree(turn_rows_of_tree)
def turn_error_rows(mechanics: Mechanics, y: Floats, Y: Floats, memory: MechanicsMemory) -> None:
    """Makes derivatives Y of y those of errors (`compare`), in place."""


@of_tree(turn_end_of_tree)
def turn_end(mechanics: Mechanics, l1: Floats, l2: Floats, memory: MechanicsMemory) -> None:
    """Makes a gradient and a Hessian by errors those by the state, in place."""


@of_tree(subtract_tree)
def subtract(mechanics: Mechanics, z: Floats, before: Floats, off: Floats) -> None:
    """Computes z ⊖ before."""
    for i in range(off.size):
        off[i] = z[i] - before[i]


@of_tree(align_tree)
def align(mechanics: Mechanics, gap: Floats, F: Floats, memory: MechanicsMemory) -> None:
    """Makes derivatives F of the state after a stage those of its gap, in place."""


@of_tree(shift_tree)
def shift(
    mechanics: Mechanics, z: Floats, length: float, off: Floats, memory: MechanicsMemory
) -> None:
    """Moves a state by a part of a tangent vector, in place."""
    for i in range(off.size):
        z[i] += length * off[i]


@of_tree(read_tree_coordinate)
def read_coordinate(
    mechanics: Mechanics, goal: Floats, z: Floats, i: int, memory: MechanicsMemory
) -> float:
    """Returns coordinate i of a state, for its bounds."""
    return float(z[i])
