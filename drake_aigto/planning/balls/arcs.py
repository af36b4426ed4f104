"""The multi-phase problem in a few unknowns: many steps of a phase at once, as one arc."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, Ints
from drake_aigto.local import LocalResult, PolynomialNlp
from drake_aigto.planning.balls.arc_program import ArcPrograms, calc_root
from drake_aigto.planning.balls.phases import PhaseProblem
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import calc_inertia

# How often arcs are cut, at most, before the general solver is tried instead.
_MOST_ROUNDS = 6
# A knot deeper in a wall than this part of the length scale gets a row of its own.
_DEPTH = 1e-12
# Multipliers of λ ≥ 0 count above this, in units of the cost: walls would pull.
_PULL = 1e-6


def solve_in_arcs(
    phases: PhaseProblem,
    guess: Trajectory,
    solve: Callable[[PolynomialNlp, Floats], LocalResult | None],
    programs: ArcPrograms | None = None,
    joints: Collection[int] = (),
) -> Trajectory | None:
    """Returns a local optimum of a multi-phase problem that `has_long_arcs`, None if none is found.

    Knots inside of walls become ends of arcs, so that they get rows, until there are none; these
    joints are from the start. Programs are those of the same world that were built so far.
    """
    motion, cuts = guess, frozenset(joints)
    for _ in range(_MOST_ROUNDS):
        arcs = Arcs(phases, cuts, programs)
        result = solve(arcs.nlp, arcs.vector(motion))
        if result is None or not result.is_success or arcs.would_pull(result):
            return None
        motion = arcs.trajectory(result.x)
        deep = _deepest_knots(phases, motion.positions)
        if not deep:
            return motion
        cuts |= deep
    return None


def _deepest_knots(phases: PhaseProblem, positions: Floats) -> set[int]:
    """Returns the first, the last and the deepest knot of each run of knots inside of a wall."""
    distances, apart = phases.world.calc_signed_distance(positions), phases.timeline.marks.apart
    is_inside = apart & (distances < -_DEPTH * phases.scales.length)
    found: set[int] = set()
    for contact in np.flatnonzero(np.any(is_inside[1:], axis=0)).tolist():
        knots, distance = np.flatnonzero(is_inside[1:, contact]) + 1, distances[:, contact]
        for run in np.split(knots, np.flatnonzero(np.diff(knots) > 1) + 1):
            found |= {int(run[0]), int(run[-1]), int(run[np.argmin(distance[run])])}
    return found


class Arcs:
    """A multi-phase problem (`PhaseProblem`) without its inner knots: the same optimum.

    If M and h are constant, the cheapest controls held over n steps of H/n each between two states
    are affine in k, like the costates. With the steps counted by
    σ_k = (2k + 1 − n)/n, which add up to 0, and ρ_n = Σ σ_k²/n = (n² − 1)/(3n²),

        u_k = a + σ_k b/√ρ_n

    so that an arc of n steps, from q and velocity w on, needs as few unknowns as one step:

        v' = w + H M⁻¹ (B a − h + Jᵀ f)
        q' = q + H (w + v')/2 − H² √ρ_n/2 M⁻¹ (B b + Jᵀ g),        Σ h ‖u_k‖² = H (‖a‖² + ‖b‖²)

    and likewise λ_k = f + σ_k g/√ρ_n of sustained contacts, with φ' = 0 and J v' = 0. It is exact:
    the phases' own knots and their φ ≥ 0 are left out between the ends of arcs, where they hold by
    themselves, or else become ends; and λ_k ≥ 0 holds at both ends of an arc, which is exact if
    these bounds are not active.

    Letters: J arcs between J + 1 joints.

    Attributes:
        nlp: the problem.
    """

    def __init__(
        self, phases: PhaseProblem, cuts: Collection[int] = (), programs: ArcPrograms | None = None
    ) -> None:
        """Takes arcs from joint to joint of the phases and these knots.

        Args:
            phases: the problem.
            cuts: more joints; all knots if the phases have no long arcs.
            programs: those of the same world that were built so far.
        """
        self._phases, line = phases, phases.timeline
        cuts = cuts if phases.has_long_arcs else range(phases.num_steps)
        self._knots = np.array(sorted({0, *(phase.last for phase in line.phases), *cuts}))
        self._counts = np.diff(self._knots)
        self._roots = calc_root(self._counts)
        self._inertia = phases.inertia
        # Without long arcs, no knot is inside of one.
        self._drift = getattr(self._inertia, "drift", 0.0)
        self._program = (programs or ArcPrograms()).of(phases, self._knots)
        self._impacts = [
            (rows, phases.impacts[int(self._knots[j])].velocities[changed])
            for j, (changed, rows) in self._program.impacts.items()
        ]
        self.nlp = self._program.nlp.with_bounds(*self._bounds())

    def _bounds(self) -> tuple[Floats, Floats]:
        """Returns the program's bounds with this problem's numbers."""
        p, phases, scenario = self._program, self._phases, self._phases.scenario
        lower, upper = p.nlp.lower.copy(), p.nlp.upper.copy()
        instants = phases.timeline.instants
        times, knots = list(instants), np.array(list(instants.values()), dtype=int)
        given: list[tuple[Ints, ArrayLike]] = [
            (p.q[0], scenario.initial_position),
            (p.v[0], scenario.initial_velocity),
            (p.t[[0, -1]], [0.0, scenario.duration]),
            (p.t[np.searchsorted(self._knots, knots)], times),
            (p.half_root, self._roots / 2),
            (p.goal, scenario.goal_position),
            (p.offset, self._inertia.offset),
            *self._impacts,
        ]
        for held, value in given:
            lower[held] = upper[held] = value
        p.walls.bound(lower, upper, self._inertia.offset)
        least = [phases.least_step(phase) for phase in phases.timeline.phases]
        lower[p.h] = self._counts * np.array(least)[p.phases]
        upper[p.h] = scenario.duration
        return lower, upper

    def would_pull(self, result: LocalResult) -> bool:
        """Returns whether λ ≥ 0 costs anything: λ_k of the optimum may not be affine in k then."""
        ends, phases = self._program.end_forces, self._phases
        if not ends.size:
            return False
        inertia = calc_inertia(phases.world, phases.scenario.initial_position)
        force = inertia * phases.scales.length / phases.scenario.duration**2
        price = force * result.lower_multipliers[ends]
        return bool(np.any(price > _PULL * result.cost))

    def vector(self, motion: Trajectory) -> Floats:
        """Returns the unknowns of arcs through a motion's joints, with its mean control."""
        p, K, s = self._program, self._knots, self._sigma[:, np.newaxis]
        x = np.zeros(p.nlp.num_variables)
        x[p.q], x[p.v] = motion.positions[K], motion.velocities[K]
        x[p.t], x[p.h] = motion.times[K], np.diff(motion.times[K])
        n = self._counts[:, np.newaxis]
        scale = n * np.where(n == 1, 1.0, self._roots[:, np.newaxis])
        for mean, tilt, held in ((p.a, p.b, motion.controls), (p.f, p.g, motion.forces)):
            x[mean] = np.add.reduceat(held, K[:-1]) / n
            x[tilt] = np.add.reduceat(s * held, K[:-1]) / scale
        x[p.offset] = self._inertia.offset
        for rows, values in self._impacts:
            x[rows] = values
        return p.complete(x)

    @cached_property
    def _arc(self) -> Ints:
        """The arc that each step is part of, shape (N,)."""
        return np.repeat(np.arange(self._counts.size), self._counts)

    @cached_property
    def _sigma(self) -> Floats:
        """σ of each step, shape (N,)."""
        n = self._counts[self._arc]
        return (2 * (np.arange(n.size) - self._knots[self._arc]) + 1 - n) / n

    def trajectory(self, x: Floats) -> Trajectory:
        """Returns the motion at all knots of the phases."""
        p, K, arc = self._program, self._knots, self._arc
        n = self._counts[arc][:, np.newaxis]
        k = np.arange(arc.size)[:, np.newaxis] - K[arc][:, np.newaxis]
        roots = np.where(self._counts == 1, np.inf, self._roots)[:, np.newaxis]
        mean, tilt = x[p.a], x[p.b] / roots
        mean_force, tilt_force = x[p.f], x[p.g] / roots
        h = (x[p.h] / self._counts)[arc][:, np.newaxis]
        mean_rate = (self._drift + mean @ self._inertia.gain.T + mean_force @ self._inertia.kicks)[
            arc
        ]
        tilt_rate = (tilt @ self._inertia.gain.T + tilt_force @ self._inertia.kicks)[arc]
        w, s = x[p.w][arc], self._sigma[:, np.newaxis]
        v = w + h * k * (mean_rate + (k - n) / n * tilt_rate)
        bend = k / 2 * mean_rate + (2 * k**2 + 1 - 3 * n * k) / (6 * n) * tilt_rate
        q = x[p.q][arc] + h * k * (w + h * bend)
        sizes = [phase.last - phase.first for phase in self._phases.timeline.phases]
        elapsed = np.cumsum(np.repeat(np.bincount(p.phases, x[p.h]) / sizes, sizes))
        velocities = self._at_knots(v, x[p.v])
        return Trajectory(
            # They increase at any x within bounds.
            times=np.append(0.0, self._phases.scenario.duration * (elapsed / elapsed[-1])),
            positions=self._at_knots(q, x[p.q]),
            velocities=velocities,
            controls=mean[arc] + s * tilt[arc],
            impulses=self._phases.calc_impulses(velocities),
            forces=np.maximum(mean_force[arc] + s * tilt_force[arc], 0.0),
        )

    def _at_knots(self, of_steps: Floats, at_joints: Floats) -> Floats:
        """Returns values at the steps' starts, and at the last knot, with the joints' own."""
        values = np.append(of_steps, of_steps[-1:], axis=0)
        values[self._knots] = at_joints
        return values
