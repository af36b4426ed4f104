"""Accelerations of a tree whose bodies touch, in compiled code; and its tables, from a world."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact.laws import CompliantLaw
from drake_aigto.contact.tables import TreeMechanics, TreeMechanicsMemory
from drake_aigto.contact.touching import TouchTable, push
from drake_aigto.dynamics import move_tree, push_tree
from drake_aigto.kernels import borrowing
from drake_aigto.world import SpaceWorld

# Part of the width of contacts that counts where bodies are moved by no actuator; and the force of
# springs from afar, in weights of what they move.
_RESTING, _WEIGHTS = 0.03, 3.0


def make_touch_table(world: SpaceWorld, law: CompliantLaw) -> TouchTable:
    """Returns the pairs of a world under a law."""
    tree, signs = world.tree, world.signs
    moving = [np.flatnonzero(row) for row in signs]
    n, before = world.num_velocities, np.zeros((world.num_velocities,) * 2, dtype=np.bool_)
    for i in range(n):
        j = int(tree.up[i])
        while j >= 0:
            before[j, i], j = tree.links[j] != tree.links[i], int(tree.up[j])
    numbers = (
        law.stiffness,
        law.dissipation,
        law.friction,
        np.full(len(signs), world.stiction_speed),
        *_find_widths(world, law),
    )
    return TouchTable(
        shapes=world.geometry.shapes,
        pairs=world.geometry.pairs,
        law=np.column_stack(numbers).reshape(-1, 6),
        starts=np.cumsum([0, *map(len, moving)]),
        chain=np.concatenate([np.zeros(0, dtype=np.int64), *moving]).astype(np.int64),
        signs=np.concatenate([np.zeros(0), *(s[i] for s, i in zip(signs, moving, strict=True))]),
        carries=before,
    )


def _find_widths(world: SpaceWorld, law: CompliantLaw) -> tuple[Floats, Floats]:
    """Returns the part of ε that counts for each pair, and how far its spring gives [m].

    What no actuator moves is not uncertain: bodies rest on others as they do. And of what is, a
    spring from afar pushes no harder than some times the weight of the mass that it moves there.
    """
    driven = np.any(world.actuation[world.tree.velocities], axis=1)
    share = np.where(np.any((world.signs != 0) & driven, axis=1), 1.0, _RESTING)
    q, g = world.plant.GetDefaultPositions(), world.plant.gravity_field().gravity_vector()
    J = world.calc_contact_jacobian(q)
    mobility = np.einsum("ij,ji->i", J, np.linalg.solve(world.calc_mass_matrix(q), J.T))
    weight = float(np.linalg.norm(g)) / np.maximum(mobility * law.stiffness, 1e-300)
    return share, _WEIGHTS * weight if np.any(g) else np.full(len(share), np.inf)


@borrowing
def accelerate_bodies(
    mechanics: TreeMechanics,
    q: Floats,
    v: Floats,
    u: Floats,
    eps: float,
    has_slopes: bool,
    memory: TreeMechanicsMemory,
) -> None:
    """Computes v̇, and in the tree's `slopes` ∂v̇/∂(δ, v, u) if asked, by degrees of freedom."""
    tree, touch, room = mechanics.tree, mechanics.touch, memory.tree
    push_tree(tree, q, v, u, eps, has_slopes, room)
    if touch.pairs.shape[0] > 0:
        push(touch, room.poses, room.motions, room.v, eps, mechanics.pace, has_slopes,
             memory.touch, room.force, room.slopes)  # fmt: skip
    move_tree(tree, has_slopes, room)
    for s in range(tree.up.size):
        memory.acceleration[0, tree.velocities[s]] = room.force[s]
