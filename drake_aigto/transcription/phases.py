"""The multi-phase problem of a contact sequence: exact flight, impacts, free durations."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import LinearEqualityConstraint
from pydrake.symbolic import Expression, MakeVectorVariable, Variable

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact import JointImpact
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription.additions import NO_ADDITIONS, Additions
from drake_aigto.transcription.rows import (
    CONTACT,
    DYNAMICS,
    FLIGHT,
    NONPENETRATION,
    RESTITUTION,
    SharedEvaluator,
    as_expression,
    shared_constraint,
)
from drake_aigto.transcription.timeline import (
    Phase,
    check_sequence,
    find_settlings,
    make_guess,
    make_timeline,
    straight_path,
)
from drake_aigto.transcription.touches import (
    Facing,
    Touch,
    TouchSequence,
    find_facings,
    touches_at_once,
)
from drake_aigto.transcription.transcription import ImpactTranscription, rigid_defects
from drake_aigto.world import Scenario, World

# The least parts of the duration. Flights: times of a trajectory have to increase, and a bounce may
# come right after the start, or sooner still (`touches_at_once`). Sustained contacts: shorter ones
# are bounces, and without a bound the solver would chase vanishing contacts.
_SHORTEST_FLIGHT, _SHORTEST_CONTACT = 1e-7, 1e-3
# Contacts slower than this part of the velocity scale come to rest without hops.
_SLOW = 1e-6


class PhaseTranscription(ImpactTranscription):
    """Multi-phase problem of a contact sequence.

    Phases meet where a contact is touched or left. Knots are spread evenly over each phase, whose
    duration is free, so time steps h_k are decision variables. From the velocity v⁺_k after knot k,
    with means over the step marked by a bar:

        q_{k+1} = q_k + h_k v̄_k                                                            "flight"
        M (v_{k+1} − v⁺_k) = h_k (B u_k − h(q̄_k, v̄_k) + Jᵀ λ_k)                          "dynamics"
        v⁺_k = v_k, but where contacts C are touched
        φ_i(q_k) = 0,  J_i v_k ≤ 0,  J_C v⁺_k = −E J_C v_k                 "contact", "restitution"
        while contact i lasts: φ_i(q_{k+1}) = 0, λ_ik ≥ 0; and it starts with J_i v⁺_k = 0
        elsewhere: λ_ik = 0 and φ_i(q_k) ≥ 0                                       "nonpenetration"
        h_{k+1} = h_k within a phase,  Σ h_k = T                                             "clock"

    C are all contacts that are touched at that knot, and those that were resting until then: they
    are struck at once (`JointImpact`), and no impulse pulls. A sustained contact holds its normal
    only, so that the body slides along the frictionless wall. It includes the hops that come first
    (`Settling`); at elastic walls, contacts are sustained only without approach speed. Of a box
    with several faces only the one in force (`Facing`) counts; while it is touched, φ ≤ 0 for the
    others.

    Held controls make flight exact for a constant h; with springs and dampers this is the implicit
    midpoint rule. Forces are variables here, for the mode is known.

    Decision variables are q, v, u, clearances (`Transcription`), and, with contacts, time steps h
    and times t, the closing speeds J_i v_k of the touches, impulses of coupled contacts, and the
    λ_ik of contacts that last.

    Args:
        world: the plant, read; its signed distances have to be affine.
        scenario: the task; its time step only sets the number of knots.
        sequence: the contacts in the order of time; () is a free flight.
        facings: which faces of boxes keep the motion out; if None, those of a straight guess.
        additions: of users to a transcription with other knots. Phases meet at their times, too,
            and controls that they read are held as long as there.

    Attributes:
        sequence: as given.
        timeline: of its knots.
        impacts: knot → impact of the contacts struck there.
        restitutions: e of each contact, shape (m,).

    Raises:
        OptionsError: times out of order or outside of the duration, unknown contacts, more phases
            than steps, or facings that leave out a box or a touched face.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        sequence: Sequence[Touch] = (),
        facings: Sequence[Facing] | None = None,
        additions: Additions | None = None,
    ) -> None:
        """Spreads the knots by the sequence's times, and makes the program."""
        self.sequence: TouchSequence = tuple(sequence)
        check_sequence(world, self.sequence, scenario.duration)
        if facings is None:
            facings = find_facings(world, *straight_path(world, scenario, sequence), sequence)
        added = NO_ADDITIONS if additions is None else additions
        instants = added.times[list(added.instants)] if added else ()
        self.timeline = make_timeline(world, scenario, self.sequence, facings, instants)
        self._facing_contacts = tuple(facing.contact for facing in facings)
        self.restitutions = world.restitutions(scenario)
        self._at_once = touches_at_once(world, scenario)
        super().__init__(world, scenario)
        self._take(added)

    def _is_bounded(self) -> Bools:
        line = self.timeline
        return np.any((line.apart | line.beside | line.held)[1:], axis=0)

    def _lay_out(self) -> None:
        super()._lay_out()
        N, line = self.scenario.num_steps, self.timeline
        new, scatter = self._layout.new, self._layout.scatter
        self._steps, self._times = np.empty((2, 0), dtype=np.int64)
        if self._has_clock:
            self._steps, self._times = new("h", N), new("t", N + 1)
        knots = np.flatnonzero(line.struck.any(axis=1)).tolist()
        self.impacts = {k: self._impact(k) for k in knots}
        self._is_coupled = np.zeros_like(line.struck)
        for k, impact in self.impacts.items():
            self._is_coupled[k, line.struck[k]] = impact.coupled
        self._closing = scatter("closing", line.starts)
        self._push = scatter("push", self._is_coupled)
        self._forces = scatter("f", line.rests)
        self._settlings = find_settlings(line, self.sequence, self.restitutions, self._inertia)
        self._settles = np.zeros_like(line.held)
        for each in self._settlings:
            self._settles[each.first : each.last + 1, each.contact] = True
        self._unsettled = scatter("unsettled", self._settles)

    @cached_property
    def _step(self) -> NDArray[Any]:
        return MakeVectorVariable(2, "h")  # of this stage and the next

    @cached_property
    def _clock(self) -> NDArray[Any]:
        return MakeVectorVariable(2, "t")

    @cached_property
    def _momentum(self) -> NDArray[Any]:
        return MakeVectorVariable(2 * self.world.num_contacts, "p")  # at this knot and the next

    @cached_property
    def _force(self) -> NDArray[Any]:
        return MakeVectorVariable(self.world.num_contacts, "f")

    @property
    def _duration(self) -> Expression:
        return Expression(self._step[0]) if self._has_clock else super()._duration

    @property
    def _has_clock(self) -> bool:
        return len(self.timeline.phases) > 1

    def _impact(self, k: int) -> JointImpact:
        contacts = np.flatnonzero(self.timeline.struck[k])
        restitutions = self._returned[k, contacts]
        return JointImpact.of(self._inertia, tuple(contacts.tolist()), tuple(restitutions.tolist()))

    @property
    def _returned(self) -> Floats:
        """Restitution of touches at knots, shape (N+1, m)."""
        return np.where(self.timeline.lands, 0.0, self.restitutions)

    def _add_rows(self) -> None:
        if self._has_clock:
            self._add_clock()
        line = self.timeline
        self._bound_distances(line.apart)
        self._bound_distances(line.beside, lower=-np.inf, upper=0.0)
        self._bound_distances(line.held, CONTACT, upper=0.0)
        self._add_touches()
        self._add_settlings()
        self._hold_controls()
        rows: dict[bytes, list[SharedEvaluator]] = {}
        for k in range(len(self._u)):
            kind = line.struck[k].tobytes() + line.rests[k].tobytes()
            if kind not in rows:
                rows[kind] = self._motion_rows(k)
            for row in rows[kind]:
                self._bind(row, k)

    def _add_clock(self) -> None:
        """Adds equal steps within each phase, and their sum."""
        T = self.scenario.duration
        same = shared_constraint(self._step[1] - self._step[0], "clock")
        add = shared_constraint(self._clock[1] - self._clock[0] - self._step[0], "clock")
        for phase in self.timeline.phases:
            steps = self._variables_at(self._steps[phase.first : phase.last])
            self._bound(steps, self.least_step(phase), T)
            self._bind_each(same, range(phase.first, phase.last - 1))
        self._bind_stages(add)
        known = [0, *self.timeline.instants.values(), len(self._u)]
        times = [0.0, *self.timeline.instants, T]
        self._bound(self._variables_at(self._times[known]), times, times, "duration")

    def least_step(self, phase: Phase) -> float:
        """Returns the lower bound of a phase's steps [s]."""
        least = _SHORTEST_CONTACT if phase.rests else _SHORTEST_FLIGHT
        shortest = least * self.scenario.duration
        if self.timeline.phases.index(phase) < len(self._at_once):
            shortest = min(shortest, self._at_once[0].start / 2)
        return shortest / (phase.last - phase.first)

    def _add_touches(self) -> None:
        """Adds approach speeds at walls, and that no wall pulls."""
        line = self.timeline
        for k, i in np.argwhere(line.starts).tolist():
            closing = self._variables_at(self._closing[k, i])
            self._add_speed(closing, self._inertia.jacobian[i], k)
            stays = line.lands[k, i] and self.restitutions[i] == 1
            self._bound(closing, 0.0 if stays else -np.inf, 0.0)
        for k, impact in self.impacts.items():
            pushes = self._variables_at(self._push[k, self._is_coupled[k]])
            for push, row in zip(pushes, impact.impulses[impact.coupled], strict=True):
                self._add_speed(push, row, k)
        for unilateral in (self._push[self._is_coupled], self._forces[line.rests]):
            if unilateral.size:
                self._bound(self._variables_at(unilateral), 0.0, np.inf)

    def _add_settlings(self) -> None:
        """Adds that contacts last until their hops are over."""
        for each in self._settlings:
            closing = self._closing[each.first, each.contact]
            momenta = self._unsettled[each.first : each.last + 1, each.contact]
            begin = LinearEqualityConstraint(np.array([[each.factor, -1.0]]), [0.0])
            begin.set_description(RESTITUTION)
            self._attach(begin, self._variables_at(np.append(closing, momenta[0])))
            self._bound(self._variables_at(momenta[-1:]), 0.0, np.inf)

    def _hold_controls(self) -> None:
        """Adds that controls read by additions are held as long as in their transcription."""
        same = LinearEqualityConstraint(np.array([[1.0, -1.0]]), [0.0])
        same.set_description("held")
        for k in self._additions.held:
            first, last = self._knot(k), self._knot(k + 1)
            for j in range(first, last - 1):
                for pair in self._u[j : j + 2].T:
                    self._attach(same, self._variables_at(pair))

    def _knot(self, k: int) -> int:
        added = self._additions
        ends = {0: 0, len(added.times) - 1: len(self._u)}
        return ends[k] if k in ends else self.timeline.instants[float(added.times[k])]

    def _add_speed(self, variable: Variable, row: Floats, k: int) -> None:
        """Adds the variable's definition, row · v_k."""
        variables = np.append(variable, self._variables_at(self._v[k]))
        constraint = LinearEqualityConstraint(np.append(-1.0, row)[np.newaxis], [0.0])
        constraint.set_description(RESTITUTION)
        self._attach(constraint, variables)

    def _motion_rows(self, k: int) -> list[SharedEvaluator]:
        """Returns the flight and dynamics rows of stages like the k-th."""
        world, h = self.world, self._duration
        start = world.velocities
        if k in self.impacts:
            start = self.impacts[k].velocities @ start
        mean = (start + self._next_v) / 2
        force = world.actuation @ world.controls - world.express_bias(
            (world.positions + self._next_q) / 2, mean
        )
        rests, now, later = self.timeline.rests[k], *np.split(self._momentum, 2)
        for i in np.flatnonzero(rests):
            force = force + self._inertia.jacobian[i] * self._force[i]
        settling = rests & self._settles[k]
        flight = self._next_q - world.positions - h * mean
        dynamics = world.mass_matrix @ (self._next_v - start) - h * force
        return [
            *(shared_constraint(as_expression(row), FLIGHT) for row in flight),
            *(shared_constraint(as_expression(row), DYNAMICS) for row in dynamics),
            *(
                shared_constraint(later[i] - now[i] - h * self._force[i], RESTITUTION)
                for i in np.flatnonzero(settling)
            ),
        ]

    def _stage(self, k: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        pairs = super()._stage(k)
        if k < len(self._steps):
            steps = self._steps[[k, min(k + 1, len(self._steps) - 1)]]
            pairs += [
                (self._step, self._variables_at(steps)),
                (self._clock, self._variables_at(self._times[k : k + 2])),
            ]
        if k < len(self._u):
            rests = self.timeline.rests[k]
            settling = rests & self._settles[k]
            momenta = self._unsettled[k : k + 2, settling].ravel()
            pairs.append((self._force[rests], self._variables_at(self._forces[k, rests])))
            pairs.append((self._momentum[np.tile(settling, 2)], self._variables_at(momenta)))
        return pairs

    def _stage_indices(self, k: int) -> Ints:
        line = self.timeline
        of_knot = [
            self._closing[k, line.starts[k]],
            self._push[k, self._is_coupled[k]],
            self._times[k : k + 1],
            self._steps[k : k + 1],
            self._unsettled[k, self._settles[k]],
        ]
        of_step = [self._forces[k, line.rests[k]]] if k < len(self._u) else []
        return np.concatenate([super()._stage_indices(k), *of_knot, *of_step])

    def sample_times(self, x: Floats) -> Floats:
        """Returns the knots' times at x, shape (N+1,) [s]; they increase at any x within bounds."""
        known, trajectory = self._last
        if x is known and trajectory is not None:
            return trajectory.times
        if not self._has_clock:
            return self.GetSampleTimes()
        elapsed = np.cumsum(x[self._steps])
        return np.append(0.0, self.scenario.duration * (elapsed / elapsed[-1]))

    def contact_sequence(self, x: Floats) -> TouchSequence:
        """Returns the sequence with its times at x."""
        t = self.sample_times(x)
        return tuple(
            Touch(float(t[first]), float(t[last]), touch.contact)
            for touch, (first, last) in zip(self.sequence, self.timeline.spans, strict=True)
        )

    def facings(self, x: Floats) -> tuple[Facing, ...]:
        """Returns the faces of boxes that keep the motion out, with their times at x."""
        t = self.sample_times(x)
        return tuple(
            Facing(float(t[k]), contact)
            for contact, k in zip(self._facing_contacts, self.timeline.turns, strict=True)
        )

    def impulses(self, x: Floats) -> Floats:
        """Returns P v_k (`JointImpact`) where contacts are touched, shape (N+1, m) [N s]."""
        velocities = self.split(x)[1]
        impulses = np.zeros(self.timeline.struck.shape)
        for k, impact in self.impacts.items():
            impulses[k, self.timeline.struck[k]] = impact.impulses @ velocities[k]
        return impulses

    def forces(self, x: Floats) -> Floats:
        """Returns λ_k, shape (N, m) [N]."""
        forces, rests = super().forces(x), self.timeline.rests
        forces[rests] = x[self._forces[rests]]
        return forces

    def hops(self, x: Floats) -> bool:
        """Returns whether a sustained contact begins with hops: it is touched at a speed."""
        closing = [x[self._closing[each.first, each.contact]] for each in self._settlings]
        return bool(closing) and min(closing) < -_SLOW * self.scales.velocity

    def defects(self, x: Floats) -> dict[str, float]:
        """Returns the same, with sustained contacts that end before their hops as restitution."""
        motion, jacobian = self.trajectory(x), self._inertia.jacobian
        found = rigid_defects(self.world, self._returned, motion)
        left = [-each.momenta(motion, jacobian)[-1] / each.mass for each in self._settlings]
        return {
            **found,
            RESTITUTION: max(found[RESTITUTION], *left, 0.0),
            NONPENETRATION: self._depth(x),
        }

    def vector(self, trajectory: Trajectory) -> Floats:
        """Returns all decision variables of a trajectory at these knots; undoes `trajectory`."""
        x = self.vector_of(trajectory.positions, trajectory.velocities, trajectory.controls)
        line, v = self.timeline, trajectory.velocities
        x[self._closing[line.starts]] = (v @ self._inertia.jacobian.T)[line.starts]
        for k, impact in self.impacts.items():
            x[self._push[k, self._is_coupled[k]]] = impact.impulses[impact.coupled] @ v[k]
        x[self._forces[line.rests]] = trajectory.forces[line.rests]
        for each in self._settlings:
            places = self._unsettled[each.first : each.last + 1, each.contact]
            x[places] = each.momenta(trajectory, self._inertia.jacobian)
        if self._has_clock:
            x[self._steps], x[self._times] = np.diff(trajectory.times), trajectory.times
        return x

    def guess(self, through: ArrayLike | None = None) -> Trajectory:
        """Returns a motion from stop to stop of the `straight_path` (`make_guess`)."""
        stops = straight_path(self.world, self.scenario, self.sequence, through)
        return make_guess(self.world, self.scenario, self.timeline, *stops)
