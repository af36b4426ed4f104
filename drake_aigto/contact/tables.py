"""Tables of mechanisms and of friction for compiled code, and room for their evaluation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact.laws import CompliantLaw, ContactLaw, calc_mobilities, calc_tangents
from drake_aigto.contact.touch_tables import TouchRoom, TouchTable, make_touch_room
from drake_aigto.dynamics import Tree, TreeMemory, make_tree_memory
from drake_aigto.kernels import chosen
from drake_aigto.world import World

_Function = TypeVar("_Function", bound=Callable[..., Any])

# In `FrictionTerm.numbers` and `Mechanics.frictions`.
# Radius and spins are those of `CompliantLaw`, n of them.
SOURCE, COEFFICIENT, STICTION, BRAKE, PACE, RADIUS, SPIN = range(7)
# In `Mechanics.contacts`.
GIVE = 4
# How many times as hard as a task takes smoothed springs push at most, r. Of 5 questions about
# discs, blocks and spinners, 4 of them drawn, the best closings cost 1 to 7 % less than without it
# in the mean of 3 seeds, one 0.3 % more; at 10, one costs 20 % more. Where an arm strikes a puck
# through 1e4 N/m, those of 3 questions cost a fourth to a ninth.
_HARDEST = 30.0


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
    # Stiffness k [N/m], dissipation d [s/m], restitution e, reach R [m] (see `CompliantLaw`) and
    # give g [m] (`calc_gives`) of each contact, shape (m, 5).
    contacts: Floats
    solids: Ints  # where the contacts of each solid start, shape (S + 1,)
    frictions: Floats  # shape (R, 6 + n), see `FrictionTerm`


class MechanicsMemory(NamedTuple):
    """Room for one evaluation; w = m + R rows of contacts that are held (`hold_contacts`)."""

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


# Expressions of q, shape (n,).
Row: TypeAlias = NDArray[Any]


class FrictionTerm(NamedTuple):
    """Friction of a joint or contact, −Tᵀ c N σ(s / w), with s = T(q) v (`calc_friction_share`).

    Of compliant contacts s is (T − δ W) v R/l (see `CompliantLaw`).

    Its stiction speed w is that of the world, smoothed over a length ε as contact forces are, and
    no slower than its change of s in one Runge-Kutta step h, lest steps oscillate about rest: w² =
    max(v_s, a h)² + (ε/T)², with T the duration.
    """

    row: Row  # T(q)
    # The contact of the force N, or −1 for N = 1; c; v_s [m/s, rad/s]; deceleration a of s [m/s²,
    # rad/s²], for contacts per speed of approach [1/s]; 1/T [1/s], which a program sets
    # (`fit_to_steps`); radius r; and W, n numbers.
    numbers: tuple[float, ...]


def list_friction(world: World, law: ContactLaw, brakes: bool = True) -> list[FrictionTerm]:
    """Returns the friction of a world's joints and walls; that of rigid walls is for impacts.

    Where nothing asks how it brakes, as a law that no steps soften, decelerations are 0.
    """
    n, speed, q = world.num_velocities, world.stiction_speed, world.plant.GetDefaultPositions()
    frictions = list[FrictionTerm]()
    if (dry := world.dry_friction) is not None:
        along, mobility = np.vectorize(Expression)(np.eye(n)), np.zeros(n)
        if brakes:
            mobility = np.diag(np.linalg.inv(world.calc_mass_matrix(q)))
        for i in np.flatnonzero(dry > 0).tolist():
            numbers = -1.0, dry[i], speed, dry[i] * mobility[i], *[0.0] * (2 + n)
            frictions.append(FrictionTerm(along[i], numbers))
    rates, radii, spins = np.zeros(world.num_contacts), np.zeros(world.num_contacts), None
    if isinstance(law, CompliantLaw) and law.has_friction:
        radii, spins = law.radii, world.rubbing.spins
        if brakes:  # Per speed of approach.
            M = world.calc_mass_matrix(q)
            rows = calc_tangents(world, law, q)[0], world.calc_contact_jacobian(q)
            along, across = (calc_mobilities(M, A) for A in rows)
            rates = law.friction * np.sqrt(law.stiffness) * along
            rates /= np.sqrt(np.maximum(across, along))
    for i in np.flatnonzero(law.friction).tolist():
        spin = np.zeros(n) if spins is None else spins[i]
        numbers = float(i), law.friction[i], speed, rates[i], 0.0, radii[i], *spin
        frictions.append(FrictionTerm(world.rubbing.tangents[i], numbers))
    return frictions


def fit_to_steps(frictions: Floats, step: float, duration: float, speed: float) -> Floats:
    """Returns the numbers of frictions, shape (R, 6 + n), for Runge-Kutta steps of a length [s].

    Contacts are approached at about the speed [m/s].
    """
    fitted, is_dry = frictions.copy(), frictions[:, SOURCE] < 0
    brakes = frictions[:, BRAKE] * np.where(is_dry, 1.0, speed)
    fitted[:, STICTION] = np.maximum(frictions[:, STICTION], brakes * step)
    fitted[:, PACE] = 1 / duration
    return fitted


class Load(NamedTuple):
    """Forces that a task takes.

    Attributes:
        q: the start, shape (n,).
        force: that moves it by the task's scales, against brakes and gravity, shape (n,) [N, N m].
    """

    q: Floats
    force: Floats


def calc_gives(stiffness: Floats, kicks: Floats, mobility: Floats, force: Floats) -> Floats:
    """Returns how far springs of contacts give, g, shape (m,) [m].

    Springs that are smoothed over a width ε above g are softer, k g/ε. So from afar they push no
    harder than r times as hard as a task takes: at φ = 0 with k g/2 = r |F| |M⁻¹ Jᵀ| / (J M⁻¹ Jᵀ),
    F being the force of a `Load`. With k, light bodies would be thrown far off.
    """
    most = 2 * _HARDEST * (force @ np.abs(kicks)) / mobility
    return np.divide(most, stiffness, out=np.full(len(most), np.inf), where=stiffness > 0)
