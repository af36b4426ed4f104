"""Trees of joints and bodies as arrays: any robot, the same compiled code."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from types import ModuleType

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import MultibodyForces
from pydrake.systems.framework import Context

from drake_aigto.arrays import Floats, Ints
from drake_aigto.dynamics.tree_reader import Thrust, check_force, read_tables
from drake_aigto.dynamics.tree_tables import NUM_POSITIONS, QUATERNION, TreeTables, make_tree_memory

_ROUNDING = 1e-12  # Of the largest thrust on a coordinate.
_NUM_PROBES = 2  # States at which forces are compared to Drake's: one might agree by chance.


class Tree(TreeTables):
    """A tree of joints and bodies, for code that is compiled once for all robots.

        M(q) v̇ + h(q, v) = B(q) u,    q̇ = N(q) v

    q and v are ordered as the plant has them. Tangent vectors δ, q ⊕ δ, are like v: turns about
    axes that are fixed in the parent. A shape's "…" are axes of many states at once.
    """

    __slots__ = ()

    @classmethod
    def of(
        cls,
        plant: MultibodyPlant,
        context: Context | None = None,
        dry_friction: Floats | None = None,
        thrusts: Sequence[Thrust] = (),
    ) -> Tree:
        """Returns the tree of a finalized plant.

        Args:
            plant: with joints of any kind that Drake has, but for curvilinear ones.
            context: of the plant, with its masses; None: the default one.
            dry_friction: F of each velocity, shape (nv,); None: none.
            thrusts: the last controls'.

        Raises:
            ModelError: a joint, a force or a constraint is none that a tree has; says which.
        """
        context = context or plant.CreateDefaultContext()
        if dry_friction is None:
            dry_friction = np.zeros(plant.num_velocities())
        tree = cls(*read_tables(plant, context, dry_friction, thrusts))
        _check_forces(plant, tree, context)
        return tree

    @property
    def num_positions(self) -> int:
        """The number of positions, nq."""
        return int(NUM_POSITIONS[self.kinds].sum())

    @property
    def num_velocities(self) -> int:
        """The number of velocities, nv."""
        return len(self.up)

    @property
    def unturned(self) -> Floats:
        """Positions at which no link is turned, shape (nq,)."""
        q = np.zeros(self.num_positions)
        q[self.positions[self.kinds == QUATERNION]] = 1.0
        return q

    @property
    def places(self) -> Ints:
        """Which position has each velocity as its rate, −1 of turns in space, shape (nv,)."""
        found = np.full(self.num_velocities, -1)
        for i in np.flatnonzero(self.kinds < QUATERNION):
            dofs = self.velocities[self.dofs[i] : self.dofs[i + 1]]
            found[dofs] = self.positions[i] + np.arange(len(dofs))
        return found

    def calc_mass_matrix(self, q: Floats) -> Floats:
        """Returns M(q), shape (…, nv, nv), at q of shape (…, nq)."""
        rows, n = list_rows(q), self.num_velocities
        masses = load_kernels().calc_masses(self, rows, make_tree_memory(self))
        return np.asarray(masses.reshape(*np.shape(q)[:-1], n, n))

    def calc_actuation(self, q: Floats) -> Floats:
        """Returns B(q), shape (nv, nu), at one q; that of joints is constant."""
        B = np.empty_like(self.actuation)
        B[self.velocities] = self.actuation
        if count := len(self.thruster_links):
            n, still = self.num_velocities, np.zeros(sum(self.actuation.shape))
            slopes = self.calc_acceleration_slopes(q, still[:n], still[n:])[:, -count:]
            found = self.calc_mass_matrix(q) @ slopes
            B[:, -count:] = np.where(np.abs(found) > _ROUNDING * np.abs(found).max(), found, 0.0)
        return B

    def calc_bias(self, q: Floats, v: Floats) -> Floats:
        """Returns h(q, v), shape (…, nv): all that B u must balance at v̇ = 0.

        Coriolis and centrifugal terms, gravity, springs, dampers, and dry friction.
        """
        return self.calc_inverse_dynamics(q, v, np.zeros(np.shape(v)))

    def calc_inverse_dynamics(self, q: Floats, v: Floats, acceleration: Floats) -> Floats:
        """Returns M(q) v̇ + h(q, v), shape (…, nv), at q (…, nq) and v, v̇ (…, nv)."""
        rows = map(list_rows, (q, v, acceleration))
        forces = load_kernels().calc_inverse_dynamics(self, *rows, make_tree_memory(self))
        return np.asarray(forces.reshape(np.shape(v)))

    def calc_acceleration(self, q: Floats, v: Floats, u: Floats) -> Floats:
        """Returns v̇ = M⁻¹ (B u − h(q, v)), shape (…, nv), at q (…, nq), v (…, nv), u (…, nu)."""
        rows = map(list_rows, (q, v, u))
        found = load_kernels().calc_accelerations(self, *rows, make_tree_memory(self))
        return np.asarray(found.reshape(np.shape(v)))

    def calc_acceleration_slopes(self, q: Floats, v: Floats, u: Floats) -> Floats:
        """Returns ∂v̇/∂(δ, v, u), shape (nv, 2 nv + nu), at one state; δ moves q to q ⊕ δ."""
        state = (list_rows(each)[0] for each in (q, v, u))
        return np.asarray(load_kernels().calc_slopes(self, *state, make_tree_memory(self)))

    def calc_position_rate(self, q: Floats, v: Floats) -> Floats:
        """Returns q̇ = N(q) v, shape (…, nq), at q (…, nq) and v (…, nv)."""
        rates = np.empty(np.shape(q))
        rows = list_rows(q), list_rows(v), rates.reshape(-1, self.num_positions)
        for row in zip(*rows, strict=True):
            load_kernels().turn_positions(self, *row)
        return rates

    def add(self, q: Floats, delta: Floats) -> Floats:
        """Returns q ⊕ δ, shape (…, nq): links turned by rotation vectors, and moved."""
        q, delta = broadcast_rows(q, delta)
        return np.asarray(load_kernels().add(self, list_rows(q), list_rows(delta))).reshape(q.shape)

    def subtract(self, after: Floats, before: Floats) -> Floats:
        """Returns the shortest δ with before ⊕ δ = after, shape (…, nv); q ⊖ q of Lie groups."""
        after, before = broadcast_rows(after, before)
        found = load_kernels().subtract(self, list_rows(after), list_rows(before))
        return np.asarray(found).reshape(*after.shape[:-1], self.num_velocities)


def list_rows(values: Floats) -> Floats:
    """Returns values as writable, contiguous rows, shape (K, …)."""
    array = np.asarray(values, dtype=float)
    return np.array(array.reshape(math.prod(array.shape[:-1]), array.shape[-1]), order="C")


def broadcast_rows(one: Floats, other: Floats) -> tuple[Floats, Floats]:
    """Returns rows of both at all states of either."""
    if np.shape(one)[:-1] == np.shape(other)[:-1]:
        return np.asarray(one), np.asarray(other)
    shape = np.broadcast_shapes(np.shape(one)[:-1], np.shape(other)[:-1])
    each = (np.broadcast_to(a, (*shape, np.shape(a)[-1])) for a in (one, other))
    first, second = each
    return first, second


def _check_forces(plant: MultibodyPlant, tree: Tree, context: Context) -> None:
    """Refuses forces that are none of a tree's, by the joint that they act on."""
    rng, kept = np.random.default_rng(1), plant.GetPositionsAndVelocities(context)
    n = plant.num_velocities()
    bare = tree._replace(friction=np.zeros(n))
    for _ in range(_NUM_PROBES):
        v, vdot = rng.uniform(-1.0, 1.0, (2, n))
        q = bare.add(plant.GetDefaultPositions(), rng.uniform(-1.0, 1.0, n))
        plant.SetPositions(context, q)
        plant.SetVelocities(context, v)
        forces = MultibodyForces(plant)
        plant.CalcForceElementsContribution(context, forces)
        expected = plant.CalcInverseDynamics(context, vdot, forces)
        check_force(plant, bare.calc_inverse_dynamics(q, v, vdot), expected)
    plant.SetPositionsAndVelocities(context, kept)


@cache
def load_kernels() -> ModuleType:
    """Returns the compiled code when it is needed, as Numba takes a second to load."""
    from drake_aigto.dynamics import tree_kernels

    return tree_kernels
