"""A shooting problem as tables for compiled code: its cost, its stages, and all bounds at knots."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact import COEFFICIENT, SOURCE, AnyMechanism, TreeMechanism, copy_writable
from drake_aigto.dynamics import NO_FRAMES
from drake_aigto.errors import OptionsError
from drake_aigto.shooting.optimal_control import OptimalControlProblem, StageLayout
from drake_aigto.shooting.tables import CHORDAL, EXACT, FLOW, MODULO, Bounds, CostTable, Program
from drake_aigto.world import TaskCost

# Steps that are implicit in velocities (`step_implicitly`): of order 1, and of order 2, in two
# stages.
IMPLICIT, TWO_STAGES = 1, -2
# Time of each evaluation of a Runge-Kutta step, as a part of the step, and its weight. Its state is
# ahead of the start by that part of the slope before it; before the first one only positions move.
# So order 2 is the leapfrog method for forces without velocities, which suits stiff springs. Of
# implicit steps it is the time at which the cost's rate is taken, and γ.
_METHODS = {
    IMPLICIT: np.array([[1.0, 1.0]]),
    TWO_STAGES: np.array([[0.5, 1 - np.sqrt(0.5)]]),
    2: np.array([[0.5, 0.0], [0.5, 1.0]]),
    4: np.array([[0.0, 1 / 6], [0.5, 1 / 3], [0.5, 1 / 3], [1.0, 1 / 6]]),
}
# A control's curvature counts as small below this share of the cost's scale per its own, squared.
_FLOOR = 1e-6
# No phase is shorter than this share of the longest total.
_SHORTEST = 1e-3


def is_implicit(order: int) -> bool:
    """Returns whether steps are implicit in velocities."""
    return order in (IMPLICIT, TWO_STAGES)


def make_program(
    problem: OptimalControlProblem, substeps: int, order: int, other: Program | None = None
) -> Program:
    """Returns the tables of a problem, its multipliers zero.

    Args:
        problem: the task.
        substeps: Runge-Kutta steps of a stage.
        order: of their error, 4 or 2; `IMPLICIT` or `TWO_STAGES`.
        other: of the same problem in other steps, which shares all that does not depend on them.

    Raises:
        OptionsError: implicit steps of what is no tree of joints.
    """
    if is_implicit(order) and not isinstance(problem.mechanism, TreeMechanism):
        raise OptionsError("order", "implicit steps in the plane", "an order of 2 or 4")
    mechanics, method = problem.fit_mechanism(substeps, is_implicit(order)), _METHODS[order]
    if other is not None:
        mechanics = copy_writable(mechanics)
        return other._replace(mechanics=mechanics, substeps=substeps, method=method)
    layout = problem.layout
    closed, leans, restitutions = _find_closed(layout, problem.mechanism)
    times = problem.times if problem.phases is None else None
    added, limits = problem.added.lay_out(
        layout.kinds, layout.shares, times, problem.least_distances
    )
    program = Program(
        mechanics=mechanics,
        task=_make_task(problem.cost),
        bounds=_make_bounds(problem, layout, limits),
        added=added,
        kinds=layout.kinds,
        held=layout.held,
        modes=layout.modes,
        closed=closed,
        leans=leans,
        restitutions=restitutions,
        steps=layout.shares,
        times=problem.times if problem.phases is None else np.zeros(len(layout.kinds) + 1),
        substeps=substeps,
        method=method,
    )
    return copy_writable(program)


def _find_closed(layout: StageLayout, mechanism: AnyMechanism) -> tuple[Bools, Floats, Floats]:
    """Returns which rows vanish in each stage, (K, m + R), how contacts lean, (K, m), and e, (K,).

    Contacts are held during flights, and struck at impacts.
    """
    hits, e = np.flatnonzero(layout.kinds >= 0), np.zeros(len(layout.kinds))
    contacts, frictions = layout.kinds[hits], mechanism.frictions
    touching = layout.held & ((layout.kinds == FLOW) | (layout.kinds >= 0))[:, np.newaxis]
    touching[hits, contacts] = True
    e[hits] = np.where(layout.held[hits, contacts], 0.0, mechanism.contacts[contacts, 2])
    sticks, leans = np.zeros((len(touching), len(frictions)), dtype=bool), np.zeros(touching.shape)
    for r in np.flatnonzero(frictions[:, SOURCE] >= 0).tolist():
        contact, friction = int(frictions[r, SOURCE]), frictions[r, COEFFICIENT]
        modes = layout.modes[:, contact]
        sticks[:, r] = touching[:, contact] & (modes == 0)
        leans[:, contact] = np.where(touching[:, contact], -friction * modes, 0.0)
    return np.hstack([touching, sticks]), leans, e


def _make_task(cost: TaskCost) -> CostTable:
    n = len(cost.Q)
    final = np.zeros((2 * n, 2 * n))
    final[:n, :n], final[n:, n:] = cost.QT, cost.QTv
    errors = np.where(cost.is_modulo, MODULO, np.where(cost.is_chordal, CHORDAL, EXACT))
    running = np.concatenate([cost.Q, cost.Qv])
    return CostTable(
        control=cost.R,
        running=running,
        final=(final + final.T) / 2,
        errors=np.concatenate([errors, np.full(n, EXACT)]),
        goal=np.concatenate([cost.goal, cost.goal_velocity]),
        times=cost.times,
        reference=np.hstack([cost.positions, cost.velocities]),
        frames=NO_FRAMES if cost.frames is None else cost.frames.table,
    )


def _make_bounds(problem: OptimalControlProblem, layout: StageLayout, of_users: Floats) -> Bounds:
    """Returns bounds at knots after the first, the hard goal among them."""
    lower, upper = _bound_states(problem, len(layout.kinds))
    low, high = _bound_distances(problem, layout)
    low_control, high_control = _bound_controls(problem, layout)
    T, nx, nz, m = np.ptp(problem.times), len(problem.scales), lower.shape[1], low.shape[1]
    scales = np.concatenate([problem.scales, np.full(2, T), problem.scales])[:nz]
    sizes = np.concatenate([problem.scales, problem.control_scales])
    units = problem.added.measure_units(sizes, problem.length)
    weights = np.concatenate([scales**-2, np.full(m, float(problem.length) ** -2), units**-2])
    start = problem.start[: problem.mechanism.num_positions]
    # A hard goal of a hinge is modulo 2π.
    n, does_turn = nx // 2, np.zeros(nz, dtype=bool)
    turns = problem.cost.is_modulo | problem.cost.is_chordal
    does_turn[:n] = turns & np.isfinite(problem.hard_goal[:n])
    nu = len(problem.control_scales)
    floors = np.tile(problem.control_scales**-2.0, (len(layout.kinds), 1))
    floors[layout.starts] = T**-2.0
    if problem.free_start is not None:  # Where all starts cost the same, it stays as it is.
        floors[: layout.num_choices] = layout.spread(problem.scales**-2.0, nu) / _FLOOR
    finite = [np.isfinite(a) | np.isfinite(b) for a, b in ((lower, upper), (low, high), of_users)]
    is_bounded = np.stack([each.any(axis=1) for each in finite], axis=1)
    is_bounded[: 1 + layout.num_choices, :2] = False
    return Bounds(
        lower=np.hstack([lower, low, of_users[0]]),
        upper=np.hstack([upper, high, of_users[1]]),
        weights=weights,
        does_turn=does_turn,
        is_bounded=is_bounded,
        multipliers=np.zeros((1 + len(layout.kinds), len(weights) + 1 + 3 * m)),
        slowest=float(problem.slowest),
        approach_weight=float(T / problem.length) ** 2,
        force_weight=float(T * np.max(problem.cost.R)) / problem.cost_scale,
        mobilities=problem.mechanism.calc_mobilities(start),
        lower_control=low_control,
        upper_control=high_control,
        norm=float(problem.control_norm),
        floors=_FLOOR * problem.cost_scale * floors,
    )


def _bound_states(problem: OptimalControlProblem, num_stages: int) -> Floats:
    """Returns lower and upper bounds of z at knots, shape (2, K + 1, nz); with total duration."""
    bounds = np.repeat(problem.state_bounds[:, np.newaxis], num_stages + 1, axis=1)
    is_hard = np.isfinite(problem.hard_goal)
    bounds[:, -1, is_hard] = problem.hard_goal[is_hard]
    if problem.phases is None:
        return bounds
    free = np.full((num_stages + 1, 2), np.inf)
    times = np.stack([-free, free])
    if len(problem.phases.durations) > 1:
        times[:, -1, 1] = problem.phases.total
    if problem.free_start is None:
        return np.concatenate([bounds, times], axis=2)
    chosen = np.full((num_stages + 1, len(problem.scales)), np.inf)
    return np.concatenate([bounds, times, np.stack([-chosen, chosen])], axis=2)


def _bound_distances(problem: OptimalControlProblem, layout: StageLayout) -> Floats:
    """Returns lower and upper bounds of φ at knots, shape (2, K + 1, m)."""
    m, num_stages = problem.mechanism.num_contacts, len(layout.kinds)
    free = np.full((num_stages + 1, m), np.inf)
    bounds = np.stack([-free, free])
    if problem.phases is not None:
        is_rigid = problem.mechanism.contacts[:, 0] == 0
        bounds[0][:, is_rigid] = 0.0
        if problem.clearances is not None:
            knots = np.concatenate([[0], np.cumsum(layout.kinds == FLOW)])
            bounds[0][:, is_rigid] = problem.clearances[knots][:, is_rigid]
        touching, hit = np.zeros(free.shape, dtype=bool), np.flatnonzero(layout.kinds >= 0)
        touching[:-1] = layout.held
        touching[hit, layout.kinds[hit]] = True
        edges = np.where(touching[..., np.newaxis], problem.mechanism.edges, np.inf)
        most = np.min(edges, axis=1, initial=np.inf)
        beside = np.isfinite(most) & ~touching
        bounds[0, :-1][layout.held] = -np.inf
        bounds[0][_find_ends(layout)] = -np.inf  # Held contacts drift by the error of steps.
        bounds[0][beside], bounds[1][beside] = -np.inf, most[beside]
        bounds[:, hit, layout.kinds[hit]] = 0.0
    if problem.least_distances is not None and m:
        bounds[0] = np.maximum(bounds[0], problem.least_distances)
    return bounds


def _find_ends(layout: StageLayout) -> Bools:
    """Returns which contacts were held until a knot, shape (K + 1, m)."""
    ends = np.zeros((len(layout.kinds) + 1, layout.held.shape[1]), dtype=np.bool_)
    for k, kind in enumerate(layout.kinds):
        ends[k + 1] = layout.held[k] if kind == FLOW else ends[k]
    return ends


def _bound_controls(problem: OptimalControlProblem, layout: StageLayout) -> Floats:
    """Returns lower and upper bounds of controls of stages, shape (2, K, nu)."""
    bounds = np.array(problem.control_bounds)
    if bounds.shape[1] == 1:
        norm = problem.control_norm
        bounds = np.clip(bounds, -norm, norm)
    tiled = np.repeat(bounds[:, np.newaxis], len(layout.kinds), axis=1)
    if problem.phases is not None:
        least, most = problem.phases.total
        ends = np.array([_SHORTEST * most if len(problem.phases.durations) > 1 else least, most])
        tiled[:, layout.starts] = ends[:, np.newaxis, np.newaxis]
    if problem.free_start is not None:
        limits = problem.free_start.limits
        tiled[:, : layout.num_choices] = [layout.spread(each, tiled.shape[2]) for each in limits]
    return tiled
