"""Tables of a shooting problem for compiled code, and its memory."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import TreeMechanics, make_mechanics_memory
from drake_aigto.dynamics import FrameTable

# Kinds of stages; others are impacts, given by their contact.
FLOW, START, CHOOSE = -1, -2, -3

# Kinds of errors of coordinates.
EXACT, MODULO, CHORDAL = 0, 1, 2


class CostTable(NamedTuple):
    """The cost, see `TaskCost`; L times of the reference."""

    control: Floats  # R, shape (nu,)
    running: Floats  # weights of the errors of (q, v), shape (2n,)
    final: Floats  # the same at the end, shape (2n, 2n)
    errors: Ints  # EXACT, MODULO or CHORDAL, shape (2n,)
    goal: Floats  # shape (2n,)
    times: Floats  # of the reference, shape (L,) [s]
    reference: Floats  # shape (L, 2n)
    frames: FrameTable  # that have goals


class Bounds(NamedTuple):
    """Bounds at knots and their multipliers; equal ones are equations. K stages.

    The row s in [a, b], with weight w and multiplier y, adds ρw/2 dist(s + y/ρw, [a, b])². Rows are
    z, φ, R functions of users, −φ̇ before an impact, and inequalities of modes (`measure_modes`).
    """

    lower: Floats  # of z, φ and users' functions at each knot, shape (K + 1, nz + m + R)
    upper: Floats  # of the same
    weights: Floats  # w of the same, shape (nz + m + R,)
    does_turn: Bools  # for which the end may be any whole turn off its bounds, shape (nz,)
    is_bounded: Bools  # whether any bound of z is finite, of φ, and of users, shape (K + 1, 3)
    multipliers: Floats  # y of all rows, shape (K + 1, nz + m + R + 1 + 3m)
    slowest: float  # −φ̇ at least before an impact [m/s]
    approach_weight: float  # w of that
    force_weight: float  # w of forces of held contacts; unit: the control that costs as much as all
    mobilities: Floats  # T M⁻¹ Tᵀ at the start, which makes speeds of impulses, shape (m,) [1/kg]
    lower_control: Floats  # shape (K, nu); of starts, of the duration
    upper_control: Floats  # the same
    norm: float  # of a control, at most
    floors: Floats  # curvatures of the cost by the control which count as small, shape (K, nu)


class Added(NamedTuple):
    """Costs and constraints of users at knots: R functions f(q, v, u), by C numbers (δ, v, u)."""

    code: Ints  # of a `Tape` of all f, of slopes (C each), and of upper triangles of curvatures
    numbers: Floats  # of the same
    constants: Floats  # of the same
    is_running: Bools  # whether the length of the stage is a factor, shape (R,)
    factors: Floats  # of costs at each knot, of phases without τ, shape (K + 1, R)
    pairs: Ints  # of shapes whose distances are the last f, shape (P,)


class Program(NamedTuple):
    """A shooting problem of K stages, whose state z is (q, v), or (q, v, τ, t) of phases.

    Where the start is free, it is (q, v, τ, t, s), with s by how much the start is moved.
    """

    mechanics: Any  # Mechanics or TreeMechanics, for each of which the kernels are compiled
    task: CostTable
    bounds: Bounds
    added: Added
    kinds: Ints  # FLOW, START, CHOOSE or a contact, of each stage, shape (K,)
    held: Bools  # which contacts are held in each stage, from its start, shape (K, m)
    modes: Ints  # in which mode they are, or are hit, shape (K, m); see `Phases`
    closed: Bools  # rows of contacts that vanish (`hold_contacts`), or are struck, (K, m + R)
    leans: Floats  # −μ σ, the part of their forces that acts along these contacts, shape (K, m)
    restitutions: Floats  # −e, the part of speeds that is left as a phase starts, shape (K,)
    steps: Floats  # lengths of stages [s]; with phases, as shares of τ; shape (K,)
    times: Floats  # starts of stages, without phases, shape (K + 1,) [s]
    substeps: int  # Runge-Kutta steps of a stage
    # Time of each evaluation, as a part of a step, and its weight, shape (E, 2); a single row is of
    # implicit steps, with their γ (`implicit`).
    method: Floats


class FlowMemory(NamedTuple):
    """Room for one stage; nx = 2n, and nc = nz + nu columns."""

    mechanics: Any  # MechanicsMemory or TreeMechanicsMemory
    # x at the start of a Runge-Kutta step, y within it, ẏ, their weighted sum; e, the gradient of
    # the cost's rate by it, and velocities of the reference; shape (7, nx).
    points: Floats
    by_column: Floats  # the derivative of the cost's rate by (z, u), shape (nc,)
    slopes: Floats  # of the first four points by (z, u), shape (4, nx, nc)
    newton: Floats  # factors of the matrix of a Newton step for velocities, shape (n, n)
    pivots: Ints  # the rows that its rows are exchanged with, shape (n,)
    off: Floats  # the step, shape (n,)
    # By how much velocities change in each implicit step of K stages, of the motion and of a trial,
    # from which Newton's method starts the next time; shape (2, K, S, n), S 0 if none is implicit.
    changes: Floats


class ModeMemory(NamedTuple):
    """Inequalities of contact modes at a knot (`measure_modes`)."""

    values: Floats  # at least 0, shape (m, 3)
    slopes: Floats  # of the same by (q, v, u), shape (m, 3, 2n + nu)
    weights: Floats  # w of each, 0 without an inequality, shape (m, 3)
    after: Floats  # v⁺ of an impact in its entries n … 2n − 1, shape (2n,)


class AddedMemory(NamedTuple):
    """Room for functions of users at a knot, C = 2n + nu."""

    x: Floats  # (q, v, u)
    values: Floats  # of the tape
    sums: Floats  # of the tape
    gradient: Floats  # of costs by x, and in phases by τ, shape (C,) or (C + 1,)
    hessian: Floats  # the same, the lower triangle


class Expansion(NamedTuple):
    """The problem to second order about a motion."""

    F: Floats  # ∂z⁺/∂(z, u) of each stage, shape (K, nz, nc)
    l1: Floats  # the cost's gradient, shape (K + 1, nc)
    l2: Floats  # its Gauss-Newton Hessian, the upper triangle, shape (K + 1, nc, nc)
    gaps: Floats  # z⁺ − z of the next knot, shape (K, nz)


class SweepMemory(NamedTuple):
    """Room for the backward pass, and its result: u + α feedforward + gains (z⁺ − z)."""

    is_free: Ints  # which controls are not at a bound, shape (nu,)
    feedforward: Floats  # shape (K, nu)
    gains: Floats  # shape (K, nu, nz)
    V1: Floats  # gradient of the cost to go, shape (nz,)
    V2: Floats  # its Hessian, shape (nz, nz)
    v1: Floats  # the gradient beyond the gap, shape (nz,)
    VF: Floats  # shape (nz, nc)
    Q1: Floats  # shape (nc,)
    Q2: Floats  # shape (nc, nc)
    H: Floats  # Hessian by the control, regularized, shape (nu, nu)
    factor: Floats  # its Cholesky factor on free controls, shape (nu, nu)
    room: Floats  # shape (6, nu)


class Memory(NamedTuple):
    """All of a solver's memory."""

    flow: FlowMemory  # of one stage
    modes: ModeMemory  # of one knot
    added: AddedMemory  # of one knot
    expansion: Expansion  # of all stages
    sweep: SweepMemory  # of the backward pass
    states: Floats  # of a trial, shape (K + 1, nz)
    controls: Floats  # of a trial, shape (K, nu)


class Pass(NamedTuple):
    """Settings of a pass at one smoothing and penalty."""

    eps: float = 0.0  # ε, the smoothing of contact [m]
    penalty: float = 0.0  # ρ
    iterations: int = 0  # at most
    tolerance: float = 0.0  # of the decrease that the expansion promises, as a share of the cost
    scale: float = 0.0  # a cost below which costs are small
    is_wary: bool = False  # whether steps that close gaps may raise the cost by little only
    most: float = np.inf  # motions that promise to cost more are left unfinished
    updates: bool = False  # whether multipliers are updated in the end
    holds_states: bool = False  # by damping, not controls; and lengths of steps are fitted to costs
    is_patient: bool = False  # whether held steps do not end it, however little they promise
    first: int = -1  # the stage from which gains are followed, and that is all; −1: it descends


class Outcome(NamedTuple):
    """Result of a pass."""

    cost: float  # of the roll-out that it ends with, without penalties
    iterations: int  # in all
    is_converged: bool  # whether it ended in its tolerance
    is_left: bool  # whether it was left unfinished, as it promised to cost too much
    violation: float  # √w dist(s, [a, b]) of bounds at knots, at most


def make_memory(program: Program) -> Memory:
    """Returns room for a problem."""
    K, m, mechanics = len(program.kinds), program.held.shape[1], program.mechanics
    zeros: Any = np.zeros
    width = implicit = 0  # Of states beyond tangents; steps.
    if isinstance(mechanics, TreeMechanics):
        width = mechanics.num_positions - len(mechanics.places)
        implicit = 2 * program.substeps if len(program.method) == 1 else 0  # Of up to two stages.
    nu, nx, nz = program.task.control.size, program.task.running.size, program.bounds.does_turn.size
    nc, C, code = nz + nu, nx + nu, program.added.code
    return Memory(
        FlowMemory(
            make_mechanics_memory(mechanics),
            points=np.zeros((7, nx)),
            by_column=np.zeros(nc),
            slopes=np.zeros((4, nx, nc)),
            newton=np.zeros((nx // 2, nx // 2)),
            pivots=np.zeros(nx // 2, dtype=np.int64),
            off=np.zeros(nx // 2),
            changes=np.zeros((2, K, implicit, nx // 2)),
        ),
        ModeMemory(*map(zeros, ((m, 3), (m, 3, nx + nu), (m, 3), nx))),
        AddedMemory(
            x=np.zeros(C + width),
            values=np.zeros(1 + C + width + 2 * code[0] + code[1]),
            sums=program.added.constants.copy(),
            gradient=np.zeros(C + (nz > nx)),
            hessian=np.zeros((C + (nz > nx), C + (nz > nx))),
        ),
        Expansion(*map(zeros, ((K, nz, nc), (K + 1, nc), (K + 1, nc, nc), (K, nz)))),
        SweepMemory(
            np.zeros(nu, dtype=np.int64),
            *map(zeros, ((K, nu), (K, nu, nz), nz, (nz, nz), nz, (nz, nc), nc, (nc, nc))),
            *map(zeros, ((nu, nu), (nu, nu), (6, nu))),
        ),
        states=np.zeros((K + 1, nz + width)),
        controls=np.zeros((K, nu)),
    )
