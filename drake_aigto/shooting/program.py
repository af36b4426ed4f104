"""Phases of a motion, its stages, and the tables that compiled code reads of a problem."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.arrays import ArrayRecord, Bools, Floats, Ints, read_only
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.friction import calc_mobilities
from drake_aigto.shooting.tables import (
    CHORDAL,
    COEFFICIENT,
    EXACT,
    FLOW,
    MODULO,
    SOURCE,
    START,
    Bounds,
    Mechanics,
    Program,
    Task,
    copy_writable,
)
from drake_aigto.world import TaskCost

if TYPE_CHECKING:
    from drake_aigto.shooting.problem import ShootingProblem
    from drake_aigto.shooting.solve import ShootingOptions

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
_FIELDS = {
    "contacts": np.int64,
    "knots": np.int64,
    "durations": float,
    "held": np.bool_,
    "modes": np.int64,
}


@dataclass(frozen=True, eq=False)
class Phases(ArrayRecord):
    """Which contact is hit at which knot, with free durations between; P phases, m contacts.

        φ_i(q) = 0,   v⁺ = v⁻ − M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ (1 + e) J v⁻     where contact i is hit
        J v̇ + J̇ v = 0,   M v̇ + h = B u + Jᵀ λ,   λ ≥ 0               while contacts are held

    J has the rows of what is held from then on, too. What is held has been hit before, and e is 0
    then, whatever the contact's is: so ends what bounces ever faster, or does not bounce at all. Or
    it has been held from the start on. What rubs does so in a mode, as it is hit and while it is
    held, and of these the last is λ_t, for impulses likewise:

        T v̇ + Ṫ v = 0,   |λ_t| ≤ μ λ_n                                stick, mode 0
        λ_t = −σ μ λ_n,   σ T v ≥ 0                                   slip, mode σ = ±1

    Attributes:
        contacts: what ends each phase but the last, −1 if nothing is hit; shape (P − 1,).
        knots: where it does, rising, inside of 0 … N, shape (P − 1,).
        durations: of the phases, to start from, shape (P,) [s].
        total: the least and the most of their sum [s].
        held: which contacts are held in each phase, shape (P, m); empty: never any.
        modes: of contacts that rub, in which they are held in each phase, and hit where it starts:
            0 if they stick, else the sign of the slip, shape (P, m); empty: all stick.
    """

    contacts: Ints
    knots: Ints
    durations: Floats
    total: tuple[float, float]
    held: Bools = field(default_factory=lambda: np.zeros((0, 0), dtype=np.bool_))
    modes: Ints = field(default_factory=lambda: np.zeros((0, 0), dtype=np.int64))

    def __post_init__(self) -> None:
        """Makes arrays read-only.

        Raises:
            ProgramError: numbers do not fit together.
        """
        count = len(self.contacts) + 1
        for name, dtype in _FIELDS.items():
            array = read_only(getattr(self, name), dtype)
            if name in ("held", "modes") and not len(array):
                array = read_only(np.zeros((count, 0)), dtype)
            object.__setattr__(self, name, array)
        rows = f"{count} rows"
        checks = (
            ("held", rows, len(self.held) == count and self.held.ndim == 2),
            ("modes", rows, len(self.modes) == count and self.modes.ndim == 2),
            ("modes", "−1, 0 or 1", bool(np.all(np.abs(self.modes) <= 1))),
            ("knots", f"{count - 1}, rising", len(self.knots) == count - 1),
            ("knots", "rising numbers", bool(np.all(np.diff(self.knots) > 0))),
            ("durations", f"{count} numbers", len(self.durations) == count),
            ("durations", "numbers above 0", bool(np.all(self.durations > 0))),
            ("total", "0 < least ≤ most", 0 < self.total[0] <= self.total[1] < np.inf),
        )
        for name, expected, holds in checks:
            if not holds:
                raise ProgramError(f"phases: {name}", got=getattr(self, name), expected=expected)

    @classmethod
    def free(cls, duration: float, total: tuple[float, float]) -> Phases:
        """Returns one phase, which ends where nothing is hit, of free duration [s]."""
        none = np.zeros(0, dtype=np.int64)
        return cls(none, none, np.array([duration]), total)


@dataclass(frozen=True, eq=False)
class Layout:
    """The stages of a problem: flights between knots and, of phases, what starts each."""

    kinds: Ints  # FLOW, START or a contact, of each of K stages, shape (K,)
    held: Bools  # which contacts are held in each, shape (K, m)
    modes: Ints  # in which mode each contact is held in each, or hit, shape (K, m)
    flights: Ints  # which stages are flights, shape (N,)
    shares: Floats  # how long each lasts [s]; of phases, as a share of its phase; shape (K,)

    @classmethod
    def of(cls, times: Floats, phases: Phases | None, num_contacts: int) -> Layout:
        """Returns the stages of knots at these times, shape (N + 1,)."""
        steps = np.diff(times)
        if phases is None:
            never = np.zeros((len(steps), num_contacts), dtype=np.bool_)
            none = never.astype(np.int64)
            return cls(np.full(len(steps), FLOW), never, none, np.arange(len(steps)), steps)
        kinds: list[int] = []
        shares: list[float] = []
        ends = [*phases.knots.tolist(), len(steps)]
        contacts = np.where(phases.contacts < 0, START, phases.contacts).tolist()
        for kind, first, last in zip([START, *contacts], [0, *ends[:-1]], ends, strict=True):
            of_phase = steps[first:last]
            kinds += [kind, *[FLOW] * len(of_phase)]
            shares += [0.0, *(of_phase / of_phase.sum())]
        is_flight = np.equal(kinds, FLOW)
        phase = np.cumsum(~is_flight) - 1
        held = np.zeros((len(kinds), num_contacts), dtype=np.bool_)
        modes = np.zeros(held.shape, dtype=np.int64)
        held[:, : phases.held.shape[1]] = phases.held[phase]
        modes[:, : phases.modes.shape[1]] = phases.modes[phase]
        return cls(np.array(kinds), held, modes, np.flatnonzero(is_flight), np.array(shares))

    def calc_times(self, durations: Floats) -> Floats:
        """Returns when knots are [s], shape (N + 1,), where phases last so long, shape (P,)."""
        of_phase = np.cumsum(self.kinds != FLOW) - 1
        steps = (self.shares * durations[of_phase])[self.flights]
        return np.concatenate([[0.0], np.cumsum(steps)])

    @property
    def starts(self) -> Ints:
        """Which stages start a phase, shape (P,); none without phases."""
        return np.flatnonzero(self.kinds != FLOW)


def make_program(problem: ShootingProblem, layout: Layout, options: ShootingOptions) -> Program:
    """Returns the tables of a problem of these stages, its multipliers zero."""
    mechanics, rubs = problem.mechanism.mechanics, problem.fit_friction(options.substeps)
    closed, leans, restitutions = _find_closed(layout, mechanics)
    added, limits = problem.added.lay_out(layout.kinds, layout.shares, problem)
    program = Program(
        mechanics=mechanics._replace(rubs=rubs),
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
        substeps=options.substeps,
        method=_METHODS[options.order],
    )
    return copy_writable(program)


def _find_closed(layout: Layout, mechanics: Mechanics) -> tuple[Bools, Floats, Floats]:
    """Returns which rows vanish in each stage, (K, m + R), how contacts lean, (K, m), and e, (K,).

    Contacts are held during flights, and struck where something is hit.
    """
    hits, e = np.flatnonzero(layout.kinds >= 0), np.zeros(len(layout.kinds))
    contacts, rubs = layout.kinds[hits], mechanics.rubs
    touching = layout.held & ((layout.kinds == FLOW) | (layout.kinds >= 0))[:, np.newaxis]
    touching[hits, contacts] = True
    e[hits] = np.where(layout.held[hits, contacts], 0.0, mechanics.contacts[contacts, 2])
    sticks, leans = np.zeros((len(touching), len(rubs)), dtype=bool), np.zeros(touching.shape)
    for r in np.flatnonzero(rubs[:, SOURCE] >= 0).tolist():
        contact, friction = int(rubs[r, SOURCE]), rubs[r, COEFFICIENT]
        modes = layout.modes[:, contact]
        sticks[:, r] = touching[:, contact] & (modes == 0)
        leans[:, contact] = np.where(touching[:, contact], -friction * modes, 0.0)
    return np.hstack([touching, sticks]), leans, e


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


def _make_bounds(problem: ShootingProblem, layout: Layout, of_users: Floats) -> Bounds:
    """Returns bounds at knots after the first, the hard goal among them."""
    lower, upper = _bound_states(problem, len(layout.kinds))
    low, high = _bound_distances(problem, layout)
    low_control, high_control = _bound_controls(problem, layout)
    T, nx, nz, m = np.ptp(problem.times), len(problem.start), lower.shape[1], low.shape[1]
    scales = np.concatenate([problem.scales, np.full(nz - nx, T)])
    units = problem.added.measure_units(np.concatenate([problem.scales, problem.control_scales]))
    weights = np.concatenate([scales**-2, np.full(m, float(problem.length) ** -2), units**-2])
    # Turns do not count of hinges whose goal is hard.
    n, does_turn = nx // 2, np.zeros(nz, dtype=bool)
    turns = problem.cost.is_modulo | problem.cost.is_chordal
    does_turn[:n] = turns & np.isfinite(problem.hard_goal[:n])
    floors = np.tile(problem.control_scales**-2.0, (len(layout.kinds), 1))
    floors[layout.starts] = T**-2.0
    finite = [np.isfinite(a) | np.isfinite(b) for a, b in ((lower, upper), (low, high), of_users)]
    is_bounded = np.stack([each.any(axis=1) for each in finite], axis=1)
    is_bounded[0, :2] = False
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
        mobilities=calc_mobilities(problem.mechanism, problem.start[:n]),
        lower_control=low_control,
        upper_control=high_control,
        norm=float(problem.control_norm),
        floors=_FLOOR * problem.cost_scale * floors,
    )


def _bound_states(problem: ShootingProblem, num_stages: int) -> Floats:
    """Returns lower and upper bounds of z at knots, shape (2, K + 1, nz); of phases the end's."""
    bounds = np.repeat(problem.state_bounds[:, np.newaxis], num_stages + 1, axis=1)
    is_hard = np.isfinite(problem.hard_goal)
    bounds[:, -1, is_hard] = problem.hard_goal[is_hard]
    if problem.phases is None:
        return bounds
    free = np.full((num_stages + 1, 2), np.inf)
    times = np.stack([-free, free])
    if len(problem.phases.durations) > 1:
        times[:, -1, 1] = problem.phases.total
    return np.concatenate([bounds, times], axis=2)


def _bound_distances(problem: ShootingProblem, layout: Layout) -> Floats:
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


def _bound_controls(problem: ShootingProblem, layout: Layout) -> Floats:
    """Returns lower and upper bounds of what stages choose, shape (2, K, nu)."""
    bounds = np.array(problem.control_bounds)
    if bounds.shape[1] == 1:
        norm = problem.control_norm
        bounds = np.clip(bounds, -norm, norm)
    tiled = np.repeat(bounds[:, np.newaxis], len(layout.kinds), axis=1)
    if problem.phases is not None:
        least, most = problem.phases.total
        ends = np.array([_SHORTEST * most if len(problem.phases.durations) > 1 else least, most])
        tiled[:, layout.starts] = ends[:, np.newaxis, np.newaxis]
    return tiled
