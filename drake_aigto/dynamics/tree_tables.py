"""Tables of a tree of joints and bodies for compiled code, and its memory."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints

# Kinds of links, by how they move in their joint's frame. All of a link's coordinates move it
# along or about axes that are fixed in its parent.
REVOLUTE, PRISMATIC, SCREW, TRANSLATION, QUATERNION, RPY = range(6)

# Derivatives that are computed: none, those by velocities alone, or all.
NO_SLOPES, BY_SPEED, ALL_SLOPES = range(3)

# Numbers of positions and velocities of each kind.
NUM_POSITIONS = np.array([1, 1, 1, 3, 4, 3])
NUM_VELOCITIES = np.array([1, 1, 1, 3, 3, 3])


class TreeTables(NamedTuple):
    """Tables of a tree of joints and bodies, see `Tree`.

        M(q) v̇ + h(q, v) = B(q) u,    q̇ = N(q) v

    Bodies that are welded together are one link. Drake's planar, universal and floating joints are
    chains of links, all but the last one without mass: a floating body translates, then turns. A
    link's frame is that of its joint on the child (Drake's M), which moves in the one on the parent
    (F). Letters: L links, n = nv degrees of freedom, nu controls, of which the
    last T are thrusters', B bodies of the plant.

    q and v are ordered as the plant has them. Degrees of freedom are numbered from the world
    outward, each link's in a row; the plant has those of a floating body in another order, see
    `velocities`. Tangent vectors δ, q ⊕ δ, are like v: turns about axes that are fixed in F.
    """

    parents: Ints  # of links, each before its children; −1: the world; shape (L,)
    kinds: Ints  # REVOLUTE, …, shape (L,)
    positions: Ints  # where the positions of each link start in q, shape (L,)
    dofs: Ints  # where its degrees of freedom start, and n; shape (L + 1,)
    velocities: Ints  # place of each degree of freedom in v, shape (n,)
    links: Ints  # of degrees of freedom, shape (n,)
    up: Ints  # degree of freedom before each on its path to the world, or −1; shape (n,)
    axes: Floats  # of REVOLUTE, PRISMATIC and SCREW, in F, of unit length; shape (L, 3)
    pitches: Floats  # translation along them per turn by 1 rad, shape (L,) [m/rad]
    rotations: Floats  # of F in the parent, by rows, shape (L, 9)
    offsets: Floats  # position of F in the parent, shape (L, 3) [m]
    masses: Floats  # shape (L,) [kg]
    centers: Floats  # of mass, in the link's frame, shape (L, 3) [m]
    # Moments of inertia about them, in the link's axes: xx, xy, yy, xz, yz, zz; shape (L, 6).
    inertias: Floats
    gravity: Floats  # on the tree that each link belongs to, shape (L, 3) [m/s²]
    stiffnesses: Floats  # k of springs, −k (q − rest), shape (L,)
    rests: Floats  # shape (L,)
    damping: Floats  # d of −d v, shape (n,)
    armature: Floats  # reflected inertia of rotors, shape (n,)
    friction: Floats  # F of dry friction, −F σ(v / w), w² = stiction² + (ε pace)²; shape (n,)
    stiction: Floats  # speed below which joints stick, shape (n,)
    pace: Floats  # shape (n,) [1/s]
    actuation: Floats  # B, of degrees of freedom, shape (n, nu); 0 of thrusters
    thruster_links: Ints  # that they push, shape (T,)
    thrusts: Floats  # moment about its frame's origin, and force, for u = 1, in it; shape (T, 6)
    body_links: Ints  # of each body, −1: fixed to the world; shape (B,)
    body_rotations: Floats  # of bodies in their links, by rows, shape (B, 9)
    body_offsets: Floats  # their origins in the links' frames, shape (B, 3) [m]


class FrameTable(NamedTuple):
    """Frames and their goals for compiled code, F of them."""

    links: Ints  # that they are fixed to, shape (F,)
    rotations: Floats  # in the link, by rows, shape (F, 9)
    offsets: Floats  # their origins in the link, shape (F, 3) [m]
    goal_rotations: Floats  # in the world, by rows, shape (F, 9)
    goals: Floats  # p*, shape (F, 3) [m]
    weights: Floats  # of p − p* along the world's axes, and of the turn, shape (F, 4)


NO_FRAMES = FrameTable(
    np.zeros(0, dtype=np.int64), *(np.zeros((0, size)) for size in (9, 3, 9, 3, 4))
)


class TreeMemory(NamedTuple):
    """Room for one state. Vectors of six are angular, then linear, about the world's origin.

    The velocity of a point p that is fixed to a link is ṗ = w + ω × p, with (ω, w) the link's.
    The derivative of p by its degree of freedom i is that of (ω, w) = S_i; that of ṗ by v_i is the
    same, and that of ṗ by δ_i, at constant v, is ω_i × ṗ + (point p of T_i).
    """

    frames: Floats  # F's rotation in the world, by rows, shape (L, 9)
    poses: Floats  # of links in the world: R by rows, and p; shape (L, 12)
    velocities: Floats  # of links, shape (L, 6)
    v: Floats  # of degrees of freedom, shape (n,)
    motions: Floats  # S_i, by which the degree of freedom i moves its link and all beyond, (n, 6)
    rates: Floats  # Ṡ_i, shape (n, 6)
    turns: Floats  # T_i = V × S_i, with V the velocity of the link of i; shape (n, 6)
    bends: Floats  # A × S_i + V × T_i, with A its acceleration less gravity; shape (n, 6)
    biases: Floats  # of links: accelerations at v̇ = 0, less gravity; shape (L, 6)
    accelerations: Floats  # of links, less gravity; shape (L, 6)
    forces: Floats  # of links and all beyond, which their motion needs; shape (L, 6)
    # Mass, first moments (3), and inertia (6) about the world's origin, of links; shape (L, 10).
    inertias: Floats
    # The same of links and all beyond them; then T (9) and momentum (3), see `tree_slopes`; (L, 22)
    composites: Floats
    momenta: Floats  # S_i times the composite inertia, shape (n, 6)
    # Generalized forces; then v̇. `force` and `slopes` may be added to before `move_tree`.
    force: Floats  # shape (n,)
    mass: Floats  # M; then its factor, lower triangle; shape (n, n)
    slopes: Floats  # of forces less M v̇, then of v̇, by (δ, v, u), shape (n, 2n + nu)
    room: Floats  # for the moment, shape (4, 9)


def make_tree_memory(tree: TreeTables) -> TreeMemory:
    """Returns room for a tree."""
    L, (n, nu) = len(tree.parents), tree.actuation.shape
    sizes = {
        "frames": (L, 9),
        "poses": (L, 12),
        "velocities": (L, 6),
        "v": (n,),
        **dict.fromkeys(("motions", "rates", "turns", "bends", "momenta"), (n, 6)),
        **dict.fromkeys(("biases", "accelerations", "forces"), (L, 6)),
        "inertias": (L, 10),
        "composites": (L, 22),
        "force": (n,),
        "mass": (n, n),
        "slopes": (n, 2 * n + nu),
        "room": (4, 9),
    }
    return TreeMemory(**{name: np.zeros(shape) for name, shape in sizes.items()})
