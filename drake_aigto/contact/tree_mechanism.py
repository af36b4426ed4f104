"""Dynamics of a tree of joints whose bodies touch, as shooting takes it, and in compiled code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact.laws import CompliantLaw, ContactLaw
from drake_aigto.contact.mechanism import Mechanism
from drake_aigto.contact.tables import Load, TreeMechanics, TreeMechanicsMemory
from drake_aigto.contact.touch_tables import SLOWING, TouchTable
from drake_aigto.contact.touching import place_pairs, push, push_at_once
from drake_aigto.dynamics import (
    ALL_SLOPES,
    BY_SPEED,
    NO_SLOPES,
    Tree,
    begin_tree,
    move_tree,
    place,
    push_tree,
)
from drake_aigto.geometry import Shapes, place_shapes
from drake_aigto.kernels import borrowing
from drake_aigto.world import SpaceWorld, World

# Part of the width of contacts that counts where bodies are moved by no actuator; and the force of
# springs from afar, in weights of what they move.
_RESTING, _WEIGHTS = 0.03, 3.0


def make_touch_table(world: SpaceWorld, law: CompliantLaw) -> TouchTable:
    """Returns the pairs of a world under a law, to be fitted to steps (`TreeMechanism.fit`)."""
    tree = world.tree
    signs, couples = np.unique(world.signs, axis=0, return_inverse=True)
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
        np.full(len(couples), world.stiction_speed),
        *_measure_pairs(world, law),
    )
    return TouchTable(
        shapes=world.geometry.shapes,
        pairs=world.geometry.pairs,
        law=np.column_stack(numbers).reshape(-1, 7),
        couples=couples.reshape(-1).astype(np.int64),
        starts=np.cumsum([0, *map(len, moving)]),
        chain=np.concatenate([np.zeros(0, dtype=np.int64), *moving]).astype(np.int64),
        signs=np.concatenate([np.zeros(0), *(s[i] for s, i in zip(signs, moving, strict=True))]),
        carries=before,
    )


def _measure_pairs(world: SpaceWorld, law: CompliantLaw) -> tuple[Floats, Floats, Floats]:
    """Returns each pair's part of ε, how far its spring gives [m], and its slowing [m/s²/N].

    What no actuator moves is not uncertain: bodies rest on others as they do. And of what is, a
    spring from afar pushes no harder than some times the weight of the mass that it moves there.
    Friction slows a slip by μ times the mobility along it, at most, per force that presses.
    """
    driven = np.any(world.actuation[world.tree.velocities], axis=1)
    share = np.where(np.any((world.signs != 0) & driven, axis=1), 1.0, _RESTING)
    q, g = world.plant.GetDefaultPositions(), world.plant.gravity_field().gravity_vector()
    _, n, J = world.relate(q)
    mobility = J @ np.linalg.solve(world.calc_mass_matrix(q), np.swapaxes(J, 1, 2))
    across = np.einsum("mi,mij,mj->m", n, mobility, n)
    sideways = np.eye(3) - n[:, :, np.newaxis] * n[:, np.newaxis]
    along = np.linalg.eigvalsh(sideways @ mobility @ sideways)[:, -1]
    weight = float(np.linalg.norm(g)) / np.maximum(across * law.stiffness, 1e-300)
    give = _WEIGHTS * weight if np.any(g) else np.full(len(share), np.inf)
    return share, give, law.friction * along


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
    asked = ALL_SLOPES if has_slopes else NO_SLOPES
    begin_tree(tree, q, room)
    push_tree(tree, q, v, u, eps, asked, room)
    if touch.pairs.shape[0] > 0:
        push(touch, room.poses, room.motions, room.v, eps, mechanics.pace, has_slopes,
             memory.touch, room.force, room.slopes)  # fmt: skip
    move_tree(tree, asked, room)
    _order(tree, memory)


@borrowing
def begin_bodies(
    mechanics: TreeMechanics, q: Floats, eps: float, memory: TreeMechanicsMemory
) -> None:
    """Computes all that q decides alone, for `accelerate_at_once` at any v."""
    begin_tree(mechanics.tree, q, memory.tree)
    place_pairs(mechanics.touch, memory.tree.poses, eps, memory.touch)


@borrowing
def accelerate_at_once(
    mechanics: TreeMechanics,
    q: Floats,
    v: Floats,
    u: Floats,
    eps: float,
    memory: TreeMechanicsMemory,
) -> None:
    """Computes v̇, and in the tree's `slopes` ∂v̇/∂v, by degrees of freedom."""
    tree, touch, room = mechanics.tree, mechanics.touch, memory.tree
    push_tree(tree, q, v, u, eps, BY_SPEED, room)
    if touch.pairs.shape[0] > 0:
        push_at_once(touch, room.motions, room.v, eps, mechanics.pace,
                     memory.touch, room.force, room.slopes)  # fmt: skip
    move_tree(tree, BY_SPEED, room)
    _order(tree, memory)


@borrowing
def _order(tree: Tree, memory: TreeMechanicsMemory) -> None:
    """Copies v̇ as the plant orders it."""
    for s in range(tree.up.size):
        memory.acceleration[0, tree.velocities[s]] = memory.tree.force[s]


@borrowing
def place_bodies(mechanics: TreeMechanics, q: Floats, memory: TreeMechanicsMemory) -> None:
    """Computes where links and shapes are at q, which may be the beginning of a state."""
    tree, room = mechanics.tree, memory.touch
    for i in range(tree.parents.size):
        place(tree, i, q, memory.tree)
    place_shapes(mechanics.touch.shapes, memory.tree.poses, room.rotations, room.places)


def make_no_touch(num_velocities: int) -> TouchTable:
    """Returns the table of a tree without contact."""
    none, (counts, starts) = np.zeros((0, 3)), (np.zeros(n, dtype=np.int64) for n in (0, 1))
    turns, faces = np.zeros((0, 3, 3)), np.zeros((0, 4, 3))
    shapes = Shapes(counts, counts, turns, none, none.copy(), np.zeros(0), starts, faces)
    carries = np.zeros((num_velocities, num_velocities), dtype=np.bool_)
    pairs = np.zeros((0, 2), dtype=np.int64)
    return TouchTable(shapes, pairs, np.zeros((0, 7)), counts, starts, counts, np.zeros(0), carries)


@dataclass(frozen=True, eq=False)
class TreeMechanism:
    """Dynamics of any tree of joints, whose shapes may touch (`contact.push`).

        M(q) v̇ + h(q, v) = B u + Σ J(q)ᵀ f,    q̇ = N(q) v

    It is for `ShootingProblem` what `Mechanism` is for sums of products. Contact is compliant, so
    no phases with impacts; states have unit quaternions, derivatives by them are those along q ⊕ δ.

    Attributes:
        tree: the equations of motion.
        touch: pairs of shapes.
    """

    tree: Tree
    touch: TouchTable

    # Nothing is rigid: no contact is held or hit, or is bounded by its distance or beside edges.
    num_contacts = 0
    frictions, contacts, edges = (np.zeros(shape) for shape in ((0, 1), (0, 5), (0, 0)))

    @classmethod
    def of(cls, tree: Tree, touch: TouchTable | None = None) -> TreeMechanism:
        """Returns the dynamics of a tree; without pairs, nothing touches."""
        return cls(tree, make_no_touch(tree.num_velocities) if touch is None else touch)

    @property
    def num_positions(self) -> int:
        """The number of positions, nq."""
        return self.tree.num_positions

    @property
    def num_velocities(self) -> int:
        """The number of velocities, n."""
        return self.tree.num_velocities

    @property
    def num_controls(self) -> int:
        """The number of controls, nu."""
        return self.tree.actuation.shape[1]

    @property
    def actuation(self) -> Floats:
        """B where no link is turned, shape (n, nu)."""
        return self.tree.calc_actuation(self.tree.unturned)

    @property
    def damping(self) -> Floats:
        """The dampers d of joints, whose force is −d v, shape (n,) [N s/m, N m s/rad]."""
        found = np.zeros(self.num_velocities)
        found[self.tree.velocities] = self.tree.damping
        return found

    @property
    def has_friction(self) -> bool:
        """Whether there is friction, of joints or where shapes touch."""
        return bool(np.any(self.touch.law[:, 2] > 0) or np.any(self.tree.friction > 0))

    @property
    def is_smoothed(self) -> bool:
        """Whether a smoothing ε changes anything."""
        return bool(len(self.touch.pairs) or np.any(self.tree.friction > 0))

    def fit(
        self, step: float, duration: float, speed: float, load: Load | None = None
    ) -> TreeMechanics:
        """Returns the tables for Runge-Kutta steps of a length [s], see `fit_to_steps`.

        Args:
            step: of time [s].
            duration: of the whole task, T [s].
            speed: of contacts [m/s], which those of a tree do not need.
            load: not needed either, as weights limit what pushes from afar.
        """
        tree = self.tree
        masses = tree.calc_mass_matrix(self.tree.unturned)
        mobility = np.diag(np.linalg.inv(masses))[tree.velocities]
        slow = np.maximum(tree.stiction, tree.friction * mobility * step)
        fitted = tree._replace(stiction=slow, pace=np.full(len(slow), 1 / duration))
        law = self.touch.law.copy()
        law[:, SLOWING] *= step
        touch = self.touch._replace(law=law)
        return TreeMechanics(fitted, touch, 1 / duration, tree.places, self.num_positions)

    def calc_inertia(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns M(q), shape (n, n), and h(q, 0), shape (n,)."""
        rest = np.zeros(self.num_velocities)
        return self.tree.calc_mass_matrix(q), self.tree.calc_bias(q, rest)

    def calc_mobilities(self, q: Floats) -> Floats:
        """Returns mobilities along held contacts: none."""
        return np.zeros(0)

    def calc_drag(self, q: Floats) -> Floats:
        """Returns the friction of rigid contacts, which there are none of, shape (n,)."""
        return np.zeros(self.num_velocities)

    def subtract(self, state: Floats, before: Floats) -> Floats:
        """Returns the tangent vector from one state to another, shape (2n,)."""
        nq = self.num_positions
        moved = self.tree.subtract(state[:nq], before[:nq])
        return np.concatenate([moved, state[nq:] - before[nq:]])


AnyMechanism: TypeAlias = Mechanism | TreeMechanism


def make_mechanism(world: World, law: ContactLaw, brakes: bool = True) -> AnyMechanism:
    """Returns the dynamics of a world with a contact law, by sums or, in space, by recursion.

    Sums need not know how friction brakes where steps do not soften it (`list_friction`).

    Raises:
        UnsupportedTermError: an equation is no sum of products of powers, sin and cos.
    """
    if not isinstance(world, SpaceWorld):
        return Mechanism.of(world, law, brakes)
    assert isinstance(law, CompliantLaw), "else the world refuses the scenario"
    return TreeMechanism.of(world.tree, make_touch_table(world, law))
