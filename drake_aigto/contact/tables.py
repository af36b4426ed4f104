"""Tables of mechanisms for compiled code, and room for their evaluation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact.touching import TouchRoom, TouchTable, make_touch_room
from drake_aigto.dynamics import Tree, TreeMemory, make_tree_memory
from drake_aigto.kernels import chosen

_Function = TypeVar("_Function", bound=Callable[..., Any])

# In `FrictionTerm.numbers` and `Mechanics.frictions`.
# Radius and spins are those of `CompliantLaw`, n of them.
SOURCE, COEFFICIENT, STICTION, BRAKE, PACE, RADIUS, SPIN = range(7)


class Mechanics(NamedTuple):
    """Tables of a mechanism for compiled code.

    The tape is of M (upper triangle, by rows), h, φ, J, and T, the rows of friction; then of ∂M/∂q,
    ∂h/∂(q, v), ∂J/∂q (upper triangle) and ∂T/∂q; and where walls are rigid of vᵀ (∂²J/∂q²) v, by
    contacts, and of vᵀ ∂(∂T/∂q)/∂q v.
    """

    code: Ints  # of the tape
    numbers: Floats  # of the same
    constants: Floats  # of the same
    actuation: Floats  # B, shape (n, nu)
    # Stiffness k [N/m], dissipation d [s/m], restitution e and reach R [m] (see `CompliantLaw`) of
    # each contact, shape (m, 4).
    contacts: Floats
    solids: Ints  # where the contacts of each solid start, shape (S + 1,)
    frictions: Floats  # shape (R, 6 + n), see `FrictionTerm`


class MechanicsMemory(NamedTuple):
    """Room for one evaluation; w = m + R rows of contacts that are held (`hold`)."""

    values: Floats  # of the tape
    sums: Floats  # of the tape
    factor: Floats  # Cholesky's L of M, shape (n, n)
    # Force of each contact, its derivatives by φ and φ̇, ∂l/∂φ (see `CompliantLaw`) and its
    # derivative by φ, shape (m, 5).
    force: Floats
    # Each friction force, its derivatives by s and N, δ (see `CompliantLaw`) and its derivative by
    # φ, shape (R, 5).
    drag: Floats
    acceleration: Floats  # v̇, shape (1, n)
    slopes: Floats  # ∂v̇/∂(q, v, u), transposed, shape (2n + nu, n)
    # M⁻¹ D_kᵀ, M⁻¹ Dᵀ λ, and its derivative by q at constant λ, transposed, shape (w + 1 + n, n).
    support: Floats
    grip: Floats  # the factors of C M⁻¹ Dᵀ, and the forces λ below, shape (w + 1, w)
    by_force: Floats  # the derivative of λ by (q, v, u), transposed, shape (2n + nu, w)


class TreeMechanics(NamedTuple):
    """Tables of a tree whose shapes may touch, for compiled code."""

    tree: Tree
    touch: TouchTable
    pace: float  # 1/T: contact is smoothed over a speed ε/T [1/s]
    places: Ints  # of velocities: where their positions are, −1 of links that turn, shape (n,)
    num_positions: int  # nq


class TreeMechanicsMemory(NamedTuple):
    """Room for one evaluation, with results as `MechanicsMemory` has them."""

    tree: TreeMemory
    touch: TouchRoom
    position: Floats  # q, shape (nq,)
    reference: Floats  # another state, shape (nq + n,)
    acceleration: Floats  # v̇, shape (1, n)
    slopes: Floats  # ∂v̇/∂(δ, v, u), transposed, shape (2n + nu, n)
    turning: Floats  # D of a link that turns, by rows, shape (9,)
    by_delta: Floats  # derivatives of D⁻¹ v, shape (9,)
    by_turn: Floats  # the same, shape (9,)
    errors: Floats  # of links that turn, derivatives of errors by δ, by rows, shape (L, 9)


def of_tree(other: Callable[..., Any]) -> Callable[[_Function], _Function]:
    """Returns a decorator: compiled code calls the other function where the tables are a tree's.

    Both have the same parameters, of which the first one is the tables.
    """
    return lambda function: chosen(
        lambda mechanics, *_: other if _is_of(TreeMechanics, mechanics) else function
    )(function)


def only_of(kind: type) -> Callable[[_Function], _Function]:
    """Returns a decorator: where the tables are of another kind, compiled code does nothing.

    The function's first parameter is the tables. What would be a number is 0 then.
    """
    return lambda function: chosen(
        lambda mechanics, *_: function if _is_of(kind, mechanics) else _do_nothing
    )(function)


def _is_of(kind: type, mechanics: Any) -> bool:
    """Returns whether Numba's type of tables is of a kind."""
    return getattr(mechanics, "instance_class", None) is kind


def _do_nothing(*_: Any) -> float:
    return 0.0


def copy_writable(table: Any) -> Any:
    """Returns a copy whose arrays are all writable.

    Read-only arrays have another type, for which code would be compiled once more.
    """
    if isinstance(table, tuple):
        return type(table)(*map(copy_writable, table))
    return np.array(table, order="C") if isinstance(table, np.ndarray) else table


def make_mechanics_memory(mechanics: Mechanics | TreeMechanics) -> Any:
    """Returns room for evaluations: `MechanicsMemory`, or `TreeMechanicsMemory`."""
    if isinstance(mechanics, TreeMechanics):
        return _make_tree_memory(mechanics)
    (n, nu), code, m = mechanics.actuation.shape, mechanics.code, len(mechanics.contacts)
    w = m + len(mechanics.frictions)
    return MechanicsMemory(
        values=np.zeros(1 + 2 * n + 2 * code[0] + code[1]),
        sums=mechanics.constants.copy(),
        factor=np.zeros((n, n)),
        force=np.zeros((m, 5)),
        drag=np.zeros((len(mechanics.frictions), 5)),
        acceleration=np.zeros((1, n)),
        slopes=np.zeros((2 * n + nu, n)),
        support=np.zeros((w + 1 + n, n)),
        grip=np.zeros((w + 1, w)),
        by_force=np.zeros((2 * n + nu, w)),
    )


def _make_tree_memory(mechanics: TreeMechanics) -> TreeMechanicsMemory:
    """Returns room for evaluations of a tree."""
    (n, nu), nq = mechanics.tree.actuation.shape, mechanics.num_positions
    return TreeMechanicsMemory(
        tree=make_tree_memory(mechanics.tree),
        touch=make_touch_room(mechanics.touch),
        position=np.zeros(nq),
        reference=np.zeros(nq + n),
        acceleration=np.zeros((1, n)),
        slopes=np.zeros((2 * n + nu, n)),
        turning=np.zeros(9),
        by_delta=np.zeros(9),
        by_turn=np.zeros(9),
        errors=np.zeros((len(mechanics.tree.parents), 9)),
    )
