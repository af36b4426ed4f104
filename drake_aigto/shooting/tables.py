"""What compiled code knows of a shooting problem, and the memory that it works in."""

from __future__ import annotations

from typing import NamedTuple

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.shooting.mechanics import Mechanics, MechanicsMemory

# What a stage is, in place of the contact that it is an impact at.
FLOW, START = -1, -2

# How the error of a coordinate is meant.
EXACT, MODULO, CHORDAL = 0, 1, 2


class Task(NamedTuple):
    """The cost, see `ShootingCost`; L times of the reference.

    Attributes:
        control: R, shape (nu,).
        running: of the errors of (q, v), the diagonal, shape (2n,).
        final: of the same at the end, shape (2n, 2n).
        errors: EXACT, MODULO or CHORDAL, shape (2n,).
        goal: shape (2n,).
        times: of the reference, shape (L,) [s].
        reference: shape (L, 2n).
    """

    control: Floats
    running: Floats
    final: Floats
    errors: Ints
    goal: Floats
    times: Floats
    reference: Floats


class Bounds(NamedTuple):
    """Bounds at knots and their multipliers; equal ones are equations. K stages.

    The row s in [a, b], with weight w and multiplier y, adds ρw/2 dist(s + y/ρw, [a, b])².

    Attributes:
        lower: of the state at each knot, shape (K + 1, nz).
        upper: of the same.
        weights: w, shape (nz,).
        does_turn: for which the end may be any whole turn off its bounds, shape (nz,).
        multipliers: y, shape (K + 1, nz).
        is_any: whether there are bounds at knots at all.
        is_bounded: whether any of the above is finite, at each knot, shape (K + 1,).
        lower_distance: of φ, shape (K + 1, m).
        upper_distance: of the same.
        distance_weight: w of φ.
        distance_multipliers: y of φ, shape (K + 1, m).
        is_distance_bounded: as above.
        slowest: −φ̇ at least before an impact [m/s].
        approach_weight: w of that.
        approach_multipliers: y of that, shape (K,).
        force_weight: w of forces of what is held; their unit is the control that costs as much as
            all else.
        mobilities: T M⁻¹ Tᵀ of what rubs at the start, which makes speeds of impulses, (m,) [1/kg].
        mode_multipliers: y of what modes ask for (`cones`), shape (K + 1, m, 3).
        lower_control: shape (K, controls of a stage).
        upper_control: the same.
        norm: of a control, at most.
        floors: curvatures of the cost by the control which count as small, shape as above.
    """

    lower: Floats
    upper: Floats
    weights: Floats
    does_turn: Bools
    multipliers: Floats
    is_any: bool
    is_bounded: Bools
    lower_distance: Floats
    upper_distance: Floats
    distance_weight: float
    distance_multipliers: Floats
    is_distance_bounded: Bools
    slowest: float
    approach_weight: float
    approach_multipliers: Floats
    force_weight: float
    mobilities: Floats
    mode_multipliers: Floats
    lower_control: Floats
    upper_control: Floats
    norm: float
    floors: Floats


class Program(NamedTuple):
    """A shooting problem of K stages, whose state z is (q, v), or (q, v, τ, t) of phases.

    Attributes:
        mechanics: the mechanism.
        task: the cost.
        bounds: the constraints.
        kinds: FLOW, START or a contact, of each stage, shape (K,).
        held: which contacts are held in each stage, from its start, shape (K, m).
        modes: in which mode they are, or are hit, shape (K, m); see `Phases`.
        closed: which rows of contacts vanish in each flight, or are struck at the start of a phase,
            shape (K, m + R); see `hold`.
        leans: the part −μ σ of their forces that acts along these contacts, shape (K, m).
        restitutions: the part −e of speeds that is left as a phase starts, shape (K,).
        steps: how long each stage lasts [s]; of phases, as a share of τ; shape (K,).
        times: when each stage starts, without phases, shape (K + 1,) [s].
        substeps: Runge-Kutta steps of a stage.
        method: when each evaluation of such a step is, a part of it, and its weight, shape (E, 2).
    """

    mechanics: Mechanics
    task: Task
    bounds: Bounds
    kinds: Ints
    held: Bools
    modes: Ints
    closed: Bools
    leans: Floats
    restitutions: Floats
    steps: Floats
    times: Floats
    substeps: int
    method: Floats


class FlowMemory(NamedTuple):
    """Room for one stage; nx = 2n, and nc = nz + nu columns.

    Attributes:
        mechanics: room for accelerations.
        points: x at the start of a Runge-Kutta step, y within it, ẏ, their weighted sum; e, the
            gradient of the cost's rate by it, and how fast the reference moves; shape (7, nx).
        by_column: the derivative of the cost's rate by (z, u), shape (nc,).
        slopes: of the first four by (z, u), shape (4, nx, nc).
    """

    mechanics: MechanicsMemory
    points: Floats
    by_column: Floats
    slopes: Floats


class ModeMemory(NamedTuple):
    """What the modes of contacts ask for at a knot (`cones`).

    Attributes:
        values: at least 0, shape (m, 3).
        slopes: of the same by (q, v, u), shape (m, 3, 2n + nu).
        weights: w of each, 0 where nothing is asked for, shape (m, 3).
        after: v⁺ of an impact in its entries n … 2n − 1, shape (2n,).
    """

    values: Floats
    slopes: Floats
    weights: Floats
    after: Floats


class Expansion(NamedTuple):
    """The problem to second order about a motion.

    Attributes:
        F: ∂z⁺/∂(z, u) of each stage, shape (K, nz, nc).
        l1: the cost's gradient, shape (K + 1, nc).
        l2: its Gauss-Newton Hessian, shape (K + 1, nc, nc).
        gaps: z⁺ − z of the next knot, shape (K, nz).
    """

    F: Floats
    l1: Floats
    l2: Floats
    gaps: Floats


class SweepMemory(NamedTuple):
    """Room for the backward pass, and its result: u + α feedforward + gains (z⁺ − z).

    Attributes:
        feedforward: shape (K, nu).
        gains: shape (K, nu, nz).
        V1: gradient of the cost to go, shape (nz,).
        V2: its Hessian, shape (nz, nz).
        v1: the gradient beyond the gap, shape (nz,).
        VF: shape (nz, nc).
        Q1: shape (nc,).
        Q2: shape (nc, nc).
        H: Hessian by the control, regularized, shape (nu, nu); so is the next one.
        factor: its Cholesky factor on what is free.
        is_free: which controls are not at a bound, shape (nu,).
        room: shape (6, nu).
    """

    feedforward: Floats
    gains: Floats
    V1: Floats
    V2: Floats
    v1: Floats
    VF: Floats
    Q1: Floats
    Q2: Floats
    H: Floats
    factor: Floats
    is_free: Ints
    room: Floats


class Memory(NamedTuple):
    """All of a solver's memory.

    Attributes:
        flow: of one stage.
        modes: of one knot.
        expansion: of all stages.
        sweep: of the backward pass.
        states: of a trial, shape (K + 1, nz).
        controls: of a trial, shape (K, nu).
    """

    flow: FlowMemory
    modes: ModeMemory
    expansion: Expansion
    sweep: SweepMemory
    states: Floats
    controls: Floats
