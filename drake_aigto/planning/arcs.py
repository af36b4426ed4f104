"""The multi-phase problem in a few unknowns: many steps of a phase at once, as one arc."""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drake_aigto.arrays import Floats, Ints
from drake_aigto.local import LocalResult, Monomial, NlpBuilder, PolynomialNlp
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import NONPENETRATION
from drake_aigto.transcription.rows import CONTACT, DYNAMICS, FLIGHT, RESTITUTION

if TYPE_CHECKING:
    from drake_aigto.transcription import PhaseTranscription


# Times that arcs are cut before the general way is tried instead.
_MOST_ROUNDS = 6
# Deeper in a wall than this part of the length scale a knot gets a row of its own.
_DEPTH = 1e-12
# Walls that would rather pull: by how much, in units of the cost, forces would pay off.
_PULL = 1e-6


def solve_in_arcs(
    phases: PhaseTranscription,
    guess: Trajectory,
    solve: Callable[[PolynomialNlp, Floats], LocalResult],
) -> Floats | None:
    """Returns a local optimum of a multi-phase problem where the world's h is constant.

    Knots inside of walls become ends of arcs, so that they get rows, until there are none.

    Args:
        phases: the problem, as made: what users added would not count.
        guess: a motion at its knots.
        solve: the local solver.

    Returns:
        All decision variables of the phases; None where the solver does not get there.
    """
    motion, cuts = guess, frozenset[int]()
    for _ in range(_MOST_ROUNDS):
        arcs = Arcs(phases, cuts)
        result = solve(arcs.nlp, arcs.vector(motion))
        if not result.is_success or arcs.would_pull(result):
            return None
        motion = arcs.trajectory(result.x)
        x = phases.vector(motion)
        deep = _deepest_knots(phases, x)
        if not deep:
            return x
        cuts |= deep
    return None


def _deepest_knots(phases: PhaseTranscription, x: Floats) -> set[int]:
    """Returns the first, the last and the deepest knot of each run of knots inside of a wall."""
    distances = phases.signed_distances(x)
    if not np.any(phases.timeline.apart & (distances < 0)):
        return set()
    is_inside = phases.timeline.apart & (distances < -_DEPTH * phases.length_scale())
    found: set[int] = set()
    for inside, distance in zip(is_inside[1:].T, distances[1:].T, strict=True):
        knots = np.flatnonzero(inside) + 1
        for run in np.split(knots, np.flatnonzero(np.diff(knots) > 1) + 1):
            if run.size:
                found |= {int(run[0]), int(run[-1]), int(run[np.argmin(distance[run - 1])])}
    return found


class Arcs:
    """A multi-phase problem (`PhaseTranscription`) without its inner knots: the same optimum.

    Where M and h are constant, controls held over n steps of H/n each that cost least between two
    states are affine in k, for so are the costates. With the steps counted by
    σ_k = (2k + 1 − n)/n, which add up to 0, and ρ_n = Σ σ_k²/n = (n² − 1)/(3n²),

        u_k = a + σ_k b/√ρ_n

    so that an arc of n steps, from q and velocity w on, is as short as one step is:

        v' = w + H M⁻¹ (B a − h + Jᵀ f)
        q' = q + H (w + v')/2 − H² √ρ_n/2 M⁻¹ (B b + Jᵀ g),        Σ h ‖u_k‖² = H (‖a‖² + ‖b‖²)

    and likewise λ_k = f + σ_k g/√ρ_n of contacts that last, which φ' = 0 and J v' = 0 hold. It is
    exact: the phases' own knots and their φ ≥ 0 are left out between the ends of arcs, where they
    hold by themselves, or else have to become ends; and λ_k ≥ 0 is asked for at both ends of an
    arc, which is exact where no wall would rather pull.

    Letters: J arcs between J + 1 joints.

    Attributes:
        nlp: the problem.
    """

    def __init__(self, phases: PhaseTranscription, cuts: Collection[int] = ()) -> None:
        """Builds the problem, with arcs from joint to joint of the phases and these knots."""
        self._phases, line = phases, phases.timeline
        self._knots = np.array(sorted({0, *(phase.last for phase in line.phases), *cuts}))
        self._counts = np.diff(self._knots)
        self._roots = np.sqrt((self._counts**2 - 1) / 3) / self._counts  # √ρ
        self._rests = line.rests[self._knots[:-1]]
        self._dynamics = phases.world.constant_dynamics
        self._builder = NlpBuilder()
        self._make_variables()
        for rests in dict.fromkeys(map(tuple, self._rests.tolist())):
            self._add_motion(np.array(rests, dtype=bool))
        self._add_costs()
        self._add_clock()
        self._add_distances()
        self._add_touches()
        self._add_forces()

    @cached_property
    def nlp(self) -> PolynomialNlp:
        """The problem, over joints and arcs."""
        return self._builder.build()

    def _make_variables(self) -> None:
        new, bound, scenario = self._builder.new, self._builder.bound, self._phases.scenario
        J, (nq, nu) = len(self._counts), self._dynamics.gain.shape
        self._q, self._v, self._t = new(J + 1, nq), new(J + 1, nq), new(J + 1)
        self._a, self._b, self._h = new(J, nu), new(J, nu), new(J)
        self._f, self._g = new(*self._rests.shape), new(*self._rests.shape)
        self._half_root = new(J)  # √ρ/2: held variables, so that all arcs are copies of one sum.
        bound(self._q[0], scenario.initial_position, scenario.initial_position)
        bound(self._v[0], scenario.initial_velocity, scenario.initial_velocity)
        bound(self._t[[0, -1]], [0.0, scenario.duration], [0.0, scenario.duration])
        bound(self._half_root, self._roots / 2, self._roots / 2)
        bound(self._f[~self._rests], 0.0, 0.0)
        bound(self._g[~self._rests | (self._counts == 1)[:, np.newaxis]], 0.0, 0.0)
        self._w = self._v[:-1].copy()
        for j, k in enumerate(self._knots[:-1].tolist()):
            if k in self._phases.impacts:
                self._add_impact(j, self._phases.impacts[k].velocities)

    def _add_impact(self, j: int, velocities: Floats) -> None:
        """Adds w = R v at a joint, for the speeds that an impact changes."""
        for i in np.flatnonzero(np.any(velocities != np.eye(len(velocities)), axis=1)):
            self._w[j, i] = self._builder.new_sum(RESTITUTION, velocities[i], self._v[j])

    def _add_motion(self, rests: NDArray[np.bool_]) -> None:
        """Adds flight and dynamics of the arcs during which these contacts last."""
        columns = (
            *(self._q[:-1], self._w, self._q[1:], self._v[1:], self._a, self._b),
            *(self._f[:, rests], self._g[:, rests]),
            *(self._h[:, np.newaxis], self._half_root[:, np.newaxis]),
        )
        copies = np.hstack(columns)[np.all(self._rests == rests, axis=1)]
        ends = np.cumsum([column.shape[1] for column in columns])
        q, w, next_q, next_v, a, b, f, g, (H,), (r,) = (
            places.tolist() for places in np.split(np.arange(ends[-1]), ends[:-1])
        )
        for i, drift in enumerate(self._dynamics.drift):
            pushes = [*self._dynamics.gain[i], *self._dynamics.kicks[rests, i]]
            flight: list[Monomial] = [(1.0, (next_q[i],)), (-1.0, (q[i],))]
            flight += [(-0.5, (H, speed)) for speed in (w[i], next_v[i])]
            flight += [(push, (r, H, H, x)) for push, x in zip(pushes, [*b, *g], strict=True)]
            self._builder.add_row(FLIGHT, flight, copies)
            dynamics: list[Monomial] = [(1.0, (next_v[i],)), (-1.0, (w[i],)), (-drift, (H,))]
            dynamics += [(-push, (H, x)) for push, x in zip(pushes, [*a, *f], strict=True)]
            self._builder.add_row(DYNAMICS, dynamics, copies)

    def _add_costs(self) -> None:
        scenario, nu = self._phases.scenario, self._a.shape[1]
        effort = [(scenario.control_weight, (0, i, i)) for i in range(1, 2 * nu + 1)]
        copies = np.column_stack([self._h, self._a, self._b])
        self._builder.add_cost("control effort", effort, copies)
        w_f, miss = scenario.goal_weight, list[Monomial]()
        for i, goal in enumerate(scenario.goal_position.tolist()):
            miss += [(w_f, (i, i)), (-2 * w_f * goal, (i,)), (w_f * goal**2, ())]
        self._builder.add_cost("goal", miss, self._q[-1])

    def _add_clock(self) -> None:
        """Adds t' = t + H, and equal steps within a phase."""
        add: list[Monomial] = [(1.0, (0,)), (-1.0, (1,)), (-1.0, (2,))]
        copies = np.column_stack([self._t[1:], self._t[:-1], self._h])
        self._builder.add_row("clock", add, copies)
        for phase in self._phases.timeline.phases:
            first, last = np.searchsorted(self._knots, [phase.first, phase.last])
            least = self._phases.least_step(phase) * self._counts[first:last]
            self._builder.bound(self._h[first:last], least, self._phases.scenario.duration)
            for j in range(first, last - 1):
                same = [(1.0, (0,)), (-self._counts[j] / self._counts[j + 1], (1,))]
                self._builder.add_row("clock", same, self._h[j : j + 2])

    def _add_distances(self) -> None:
        line = self._phases.timeline
        for name, mask, lower, upper in (
            (NONPENETRATION, line.apart, 0.0, np.inf),
            (NONPENETRATION, line.beside, -np.inf, 0.0),
            (CONTACT, line.held, 0.0, 0.0),
        ):
            for j, i in np.argwhere(mask[self._knots[1:]]).tolist():
                J, offset = self._dynamics.jacobian[i], self._dynamics.offset[i]
                self._builder.bound_sum(name, J, self._q[j + 1], lower, upper, offset)

    def _add_touches(self) -> None:
        """Adds how the ball comes to walls, and that no wall pulls in an impact."""
        phases = self._phases
        for j, k in enumerate(self._knots.tolist()):
            for i in np.flatnonzero(phases.timeline.starts[k]).tolist():
                least = 0.0 if phases.stays(k, i) else -np.inf
                self._builder.bound_sum(
                    RESTITUTION, self._dynamics.jacobian[i], self._v[j], least, 0.0
                )
            if k in phases.impacts:
                impact = phases.impacts[k]
                for row in impact.impulses[impact.coupled]:
                    self._builder.bound_sum(RESTITUTION, row, self._v[j], 0.0, np.inf)

    def _add_forces(self) -> None:
        """Adds λ ≥ 0 at both ends of arcs, and that contacts stay at rest."""
        builder = self._builder
        ends: list[int] = []
        for j, i in np.argwhere(self._rests).tolist():
            n, both = self._counts[j], np.array([self._f[j, i], self._g[j, i]])
            if n == 1:
                ends.append(int(both[0]))
                continue
            tilt = (n - 1) / n / self._roots[j]
            ends += [
                builder.new_sum(CONTACT, np.array([1.0, side]), both) for side in (-tilt, tilt)
            ]
            builder.bound_sum(CONTACT, self._dynamics.jacobian[i], self._v[j + 1], 0.0, 0.0)
        self._end_forces = np.array(ends, dtype=np.int64)
        builder.bound(self._end_forces, 0.0, np.inf)

    def would_pull(self, result: LocalResult) -> bool:
        """Returns whether λ ≥ 0 costs anything: λ_k of the optimum may not be affine in k then."""
        if not self._end_forces.size:
            return False
        phases = self._phases
        force = phases.inertia() * phases.length_scale() / phases.scenario.duration**2
        price = force * result.lower_multipliers[self._end_forces]
        return bool(np.any(price > _PULL * result.cost))

    def vector(self, motion: Trajectory) -> Floats:
        """Returns the unknowns of arcs through a motion's joints, with its mean control."""
        x = np.zeros(self._half_root[-1] + 1)
        K, s = self._knots, self._sigma[:, np.newaxis]
        x[self._q], x[self._v] = motion.positions[K], motion.velocities[K]
        x[self._t], x[self._h] = motion.times[K], np.diff(motion.times[K])
        n = self._counts[:, np.newaxis]
        scale = n * np.where(n == 1, 1.0, self._roots[:, np.newaxis])
        for mean, tilt, held in (
            (self._a, self._b, motion.controls),
            (self._f, self._g, motion.forces),
        ):
            x[mean] = np.add.reduceat(held, K[:-1]) / n
            x[tilt] = np.add.reduceat(s * held, K[:-1]) / scale
        return self._builder.complete(x)

    @property
    def _arc(self) -> Ints:
        """The arc that each step is part of, shape (N,)."""
        return np.repeat(np.arange(self._counts.size), self._counts)

    @property
    def _sigma(self) -> Floats:
        """σ of each step, shape (N,)."""
        n = self._counts[self._arc]
        return (2 * (np.arange(n.size) - self._knots[self._arc]) + 1 - n) / n

    def trajectory(self, x: Floats) -> Trajectory:
        """Returns the motion at all knots of the phases."""
        K, arc = self._knots, self._arc
        n = self._counts[arc][:, np.newaxis]
        k = np.arange(arc.size)[:, np.newaxis] - K[arc][:, np.newaxis]
        roots = np.where(self._counts == 1, np.inf, self._roots)[:, np.newaxis]
        mean, tilt = x[self._a], x[self._b] / roots
        mean_force, tilt_force = x[self._f], x[self._g] / roots
        h = (x[self._h] / self._counts)[arc][:, np.newaxis]
        mean_rate = (
            self._dynamics.drift + mean @ self._dynamics.gain.T + mean_force @ self._dynamics.kicks
        )[arc]
        tilt_rate = (tilt @ self._dynamics.gain.T + tilt_force @ self._dynamics.kicks)[arc]
        w, s = x[self._w][arc], self._sigma[:, np.newaxis]
        v = w + h * k * (mean_rate + (k - n) / n * tilt_rate)
        bend = k / 2 * mean_rate + (2 * k**2 + 1 - 3 * n * k) / (6 * n) * tilt_rate
        q = x[self._q][arc] + h * k * (w + h * bend)
        forces = np.maximum(mean_force[arc] + s * tilt_force[arc], 0.0)
        return Trajectory(
            times=self._at_knots(x[self._t][arc] + (h * k)[:, 0], x[self._t]),
            positions=self._at_knots(q, x[self._q]),
            velocities=self._at_knots(v, x[self._v]),
            controls=mean[arc] + s * tilt[arc],
            impulses=np.zeros((K[-1] + 1, forces.shape[1])),
            forces=forces,
        )

    def _at_knots(self, of_steps: Floats, at_joints: Floats) -> Floats:
        """Returns values at the steps' starts, and at the last knot, with the joints' own."""
        values = np.append(of_steps, of_steps[-1:], axis=0)
        values[self._knots] = at_joints
        return values
