"""A shooting problem as the tables that compiled code reads."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.shooting.loads import calc_mobilities
from drake_aigto.shooting.mechanics import copy_writable
from drake_aigto.shooting.options import ShootingOptions
from drake_aigto.shooting.phases import Layout
from drake_aigto.shooting.question import ShootingQuestion
from drake_aigto.shooting.rubbing import COEFFICIENT, SOURCE, STICTION, fit_to_steps
from drake_aigto.shooting.tables import CHORDAL, EXACT, FLOW, MODULO, Bounds, Program, Task
from drake_aigto.world import TaskCost

# When each evaluation of a Runge-Kutta step is, as a part of the step, and its weight. It is ahead
# of the start by that part of the slope before it; before the first one only positions move. So
# order 2 is the leapfrog method where forces know no velocity, which stiff springs ask for.
_METHODS = {
    2: np.array([[0.5, 0.0], [0.5, 1.0]]),
    4: np.array([[0.0, 1 / 6], [0.5, 1 / 3], [0.5, 1 / 3], [1.0, 1 / 6]]),
}
# A control's curvature counts as small below this share of the cost's scale per its own squared.
_FLOOR = 1e-6
# No phase is shorter than this share of the longest total.
_SHORTEST = 1e-3


def make_program(problem: ShootingQuestion, layout: Layout, options: ShootingOptions) -> Program:
    """Returns the tables of a problem of these stages, its multipliers zero."""
    mechanics, step = problem.mechanism.mechanics, np.max(np.diff(problem.times))
    T = _find_duration(problem)
    rubs = fit_to_steps(mechanics.rubs, step / options.substeps, T, problem.length / T)
    struck, restitutions = _find_struck(layout, mechanics.contacts[:, 2])
    closed, leans = _find_closed(layout, struck, mechanics.rubs)
    program = Program(
        mechanics=mechanics._replace(rubs=rubs),
        task=_make_task(problem.cost),
        bounds=_make_bounds(problem, layout),
        kinds=layout.kinds,
        held=layout.held,
        modes=layout.modes,
        closed=closed,
        leans=leans,
        restitutions=restitutions,
        steps=layout.shares,
        times=problem.times if problem.phases is None else np.zeros(len(layout.kinds) + 1),
        substeps=options.substeps,
        method=_METHODS[options.order],
    )
    return copy_writable(program)


def copy_multipliers(program: Program) -> Program:
    """Returns the same tables, whose multipliers are copies: all that a solve writes to."""
    of = program.bounds
    own = {name: getattr(of, name).copy() for name in of._fields if name.endswith("multipliers")}
    return program._replace(bounds=of._replace(**own))


def count_substeps(problem: ShootingQuestion) -> int:
    """Returns in how many substeps friction keeps its stiction speeds; see `fit_to_steps`."""
    rubs, step = problem.mechanism.mechanics.rubs, np.max(np.diff(problem.times))
    fitted = fit_to_steps(rubs, step, 1.0, problem.length / _find_duration(problem))
    return int(np.ceil(np.max(fitted[:, STICTION] / rubs[:, STICTION], initial=1.0)))


def _find_duration(problem: ShootingQuestion) -> float:
    """Returns how long the task is that the knots are of [s]."""
    return problem.duration or float(np.ptp(problem.times))


def _find_struck(layout: Layout, restitutions: Floats) -> tuple[Bools, Floats]:
    """Returns what is struck as each stage starts, (K, m), and what e is there, (K,)."""
    struck, e = np.zeros_like(layout.held), np.zeros(len(layout.kinds))
    hits = np.flatnonzero(layout.kinds >= 0)
    contacts = layout.kinds[hits]
    struck[hits] = layout.held[hits]
    struck[hits, contacts] = True
    e[hits] = np.where(layout.held[hits, contacts], 0.0, restitutions[contacts])
    return struck, e


def _find_closed(layout: Layout, struck: Bools, rubs: Floats) -> tuple[Bools, Floats]:
    """Returns which rows vanish in each stage, shape (K, m + R), and how contacts lean, (K, m)."""
    touching = np.where((layout.kinds == FLOW)[:, np.newaxis], layout.held, struck)
    sticks, leans = np.zeros((len(touching), len(rubs)), dtype=bool), np.zeros(touching.shape)
    for r in np.flatnonzero(rubs[:, SOURCE] >= 0).tolist():
        contact, friction = int(rubs[r, SOURCE]), rubs[r, COEFFICIENT]
        modes = layout.modes[:, contact]
        sticks[:, r] = touching[:, contact] & (modes == 0)
        leans[:, contact] = np.where(touching[:, contact], -friction * modes, 0.0)
    return np.hstack([touching, sticks]), leans


def _make_task(cost: TaskCost) -> Task:
    n = len(cost.goal)
    final = np.zeros((2 * n, 2 * n))
    final[:n, :n], final[n:, n:] = cost.QT, cost.QTv
    errors = np.where(cost.is_modulo, MODULO, np.where(cost.is_chordal, CHORDAL, EXACT))
    running = np.concatenate([cost.Q, cost.Qv])
    return Task(
        control=cost.R,
        running=running,
        final=(final + final.T) / 2,
        errors=np.concatenate([errors, np.full(n, EXACT)]),
        goal=np.concatenate([cost.goal, cost.goal_velocity]),
        times=cost.times,
        reference=np.hstack([cost.positions, cost.velocities]),
    )


def _make_bounds(problem: ShootingQuestion, layout: Layout) -> Bounds:
    """Returns bounds at knots after the first, the hard goal among them."""
    lower, upper = _bound_states(problem, len(layout.kinds))
    low, high = _bound_distances(problem, layout)
    low_control, high_control = _bound_controls(problem, layout)
    T, nx = np.ptp(problem.times), len(problem.start)
    scales = np.concatenate([problem.scales, np.full(lower.shape[1] - nx, T)])
    floors = np.tile(problem.control_scales**-2.0, (len(layout.kinds), 1))
    floors[layout.starts] = T**-2.0
    is_bounded, is_distance_bounded = (
        np.any(np.isfinite(a) | np.isfinite(b), axis=1) for a, b in ((lower, upper), (low, high))
    )
    is_bounded[0] = is_distance_bounded[0] = False
    return Bounds(
        lower=lower,
        upper=upper,
        weights=scales**-2,
        does_turn=_find_turns(problem, lower.shape[1]),
        multipliers=np.zeros_like(lower),
        is_any=bool(np.any(is_bounded | is_distance_bounded)),
        is_bounded=is_bounded,
        lower_distance=low,
        upper_distance=high,
        distance_weight=float(problem.length) ** -2,
        distance_multipliers=np.zeros_like(low),
        is_distance_bounded=is_distance_bounded,
        slowest=float(problem.slowest),
        approach_weight=float(T / problem.length) ** 2,
        approach_multipliers=np.zeros(len(layout.kinds)),
        force_weight=float(T * np.max(problem.cost.R)) / problem.cost_scale,
        mobilities=calc_mobilities(problem.mechanism, problem.start[: nx // 2]),
        mode_multipliers=np.zeros((1 + len(layout.kinds), layout.held.shape[1], 3)),
        lower_control=low_control,
        upper_control=high_control,
        norm=float(problem.control_norm),
        floors=_FLOOR * problem.cost_scale * floors,
    )


def _bound_states(problem: ShootingQuestion, num_stages: int) -> Floats:
    """Returns lower and upper bounds of z at knots, shape (2, K + 1, nz); of phases the end's."""
    bounds = np.repeat(problem.state_bounds[:, np.newaxis], num_stages + 1, axis=1)
    is_hard = np.isfinite(problem.hard_goal)
    bounds[:, -1, is_hard] = problem.hard_goal[is_hard]
    if problem.phases is None:
        return bounds
    free = np.full((num_stages + 1, 2), np.inf)
    times = np.stack([-free, free])
    if problem.phases.is_many:
        times[:, -1, 1] = problem.phases.total
    return np.concatenate([bounds, times], axis=2)


def _find_turns(problem: ShootingQuestion, nz: int) -> Bools:
    """Returns for which of z turns do not count, shape (nz,): hinges whose goal is hard."""
    n, does_turn = len(problem.cost.goal), np.zeros(nz, dtype=bool)
    turns = problem.cost.is_modulo | problem.cost.is_chordal
    does_turn[:n] = turns & np.isfinite(problem.hard_goal[:n])
    return does_turn


def _bound_distances(problem: ShootingQuestion, layout: Layout) -> Floats:
    """Returns lower and upper bounds of φ at knots, shape (2, K + 1, m)."""
    m, num_stages = problem.mechanism.num_contacts, len(layout.kinds)
    free = np.full((num_stages + 1, m), np.inf)
    bounds = np.stack([-free, free])
    if problem.phases is not None:
        is_rigid = problem.mechanism.mechanics.contacts[:, 0] == 0
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
        bounds[0][beside], bounds[1][beside] = -np.inf, most[beside]
        bounds[:, hit, layout.kinds[hit]] = 0.0
    return bounds


def _bound_controls(problem: ShootingQuestion, layout: Layout) -> Floats:
    """Returns lower and upper bounds of what stages choose, shape (2, K, nu)."""
    bounds = np.array(problem.control_bounds)
    if bounds.shape[1] == 1:
        norm = problem.control_norm
        bounds = np.clip(bounds, -norm, norm)
    tiled = np.repeat(bounds[:, np.newaxis], len(layout.kinds), axis=1)
    if problem.phases is not None:
        least, most = problem.phases.total
        ends = np.array([_SHORTEST * most if problem.phases.is_many else least, most])
        tiled[:, layout.starts] = ends[:, np.newaxis, np.newaxis]
    return tiled
