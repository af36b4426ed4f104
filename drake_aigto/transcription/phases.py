"""The multi-phase problem of a contact sequence: exact flight, impacts, free durations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_aigto.errors import OptionsError
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription.rigid_contact import (
    CONTACT,
    DYNAMICS,
    FLIGHT,
    RESTITUTION,
    ImpactTranscription,
    bias_at,
)
from drake_aigto.transcription.shared import SharedEvaluator, as_expression, shared_constraint
from drake_aigto.transcription.touch import Touch, TouchSequence
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    import numpy.typing as npt

# The least parts of the duration. Flights: times of a trajectory have to increase, and a bounce may
# come right after the start. Contacts that last: what is shorter is a bounce, and without a bound
# the solver would chase a contact that wants to vanish.
_SHORTEST_FLIGHT, _SHORTEST_CONTACT = 1e-7, 1e-3


@dataclass(frozen=True)
class _Phase:
    """Steps first … last − 1 of one kind, all of one length."""

    first: int
    last: int
    rests: bool


class PhaseTranscription(ImpactTranscription):
    """What is left to optimise once the contact sequence is known: a multi-phase problem.

    Knots are spread evenly over each phase, whose duration is free, so time steps h_k are decision
    variables. From the velocity v⁺_k after knot k, with means over the step marked by a bar:

        q_{k+1} = q_k + h_k v̄_k                                                            "flight"
        M (v_{k+1} − v⁺_k) = h_k (B u_k − h(q̄_k, v̄_k) + Jᵀ λ_k)                          "dynamics"
        v⁺_k = v_k, but where the wall is touched
        φ(q_k) = 0,  J v_k ≤ 0,  J v⁺_k = −e J v_k                         "contact", "restitution"
        while contact lasts: φ(q_{k+1}) = 0, λ_k ≥ 0; and it starts with J v⁺_k = 0
        elsewhere: λ_k = 0 and φ(q_k) ≥ 0                                          "nonpenetration"
        h_{k+1} = h_k within a phase,  Σ h_k = T                                             "clock"

    Held controls make flight exact for a constant h; with springs and dampers this is the implicit
    midpoint rule. Forces are variables here, for the mode is known.

    Decision variables are q, v, u, clearances (`Transcription`), and, with contacts, time steps h
    and times t, the closing speeds J v_k of the touches, and the λ_k of contacts that last.

    Args:
        world: the plant, read; its signed distance has to be affine.
        scenario: the task; its time step only says how many knots there are.
        sequence: the contacts in the order of time; () is a free flight.

    Raises:
        OptionsError: times out of order or outside of the duration, or more phases than steps.
    """

    def __init__(self, world: World, scenario: Scenario, sequence: Sequence[Touch] = ()) -> None:
        """Spreads the knots by the sequence's times, and makes the program."""
        self.sequence: TouchSequence = tuple(sequence)
        self._phases = _make_phases(self.sequence, scenario)
        joints = [phase.first for phase in self._phases[1:]]
        rests = [phase.rests for phase in self._phases]
        # A touch is a joint that a flight leads to.
        self._touches = [k for k, before in zip(joints, rests, strict=False) if not before]
        self._resting = [k for p in self._phases if p.rests for k in range(p.first, p.last)]
        super().__init__(world, scenario)

    def _make_variables(self) -> None:
        super()._make_variables()
        N = self.scenario.num_steps
        new = self._prog.NewContinuousVariables
        self._steps, self._times = np.empty(0, dtype=object), np.empty(0, dtype=object)
        self._step = MakeVectorVariable(2, "h")  # of this stage and the next
        self._clock = MakeVectorVariable(2, "t")
        if self.sequence:
            self._steps, self._times = new(N, "h"), new(N + 1, "t")
            self._duration = Expression(self._step[0])
        self._closing = new(len(self._touches), "closing")
        self._force = MakeVectorVariable(1, "f")
        self._forces = new(len(self._resting), "f")

    def _add_rows(self) -> None:
        if self.sequence:
            self._add_clock()
        held = {*self._touches, *(k + 1 for k in self._resting)}
        self._add_nonpenetration([k for k in range(1, self.num_samples()) if k not in held])
        self._add_contacts(held)
        rows: dict[tuple[bool, bool], list[SharedEvaluator]] = {}
        for k in range(len(self._u)):
            kind = k in self._touches, k in self._resting
            if kind not in rows:
                rows[kind] = self._motion_rows(*kind)
            for row in rows[kind]:
                self._bind(row, k)

    def _add_clock(self) -> None:
        """Adds equal steps within each phase, and their sum."""
        T = self.scenario.duration
        same = shared_constraint(self._step[1] - self._step[0], "clock")
        add = shared_constraint(self._clock[1] - self._clock[0] - self._step[0], "clock")
        for phase in self._phases:
            least = T * (_SHORTEST_CONTACT if phase.rests else _SHORTEST_FLIGHT)
            steps = self._steps[phase.first : phase.last]
            self._prog.AddBoundingBoxConstraint(least / len(steps), T, steps)
            self._bind_each(same, range(phase.first, phase.last - 1))
        self._bind_stages(add)
        ends = self._times[[0, -1]]
        self._prog.AddBoundingBoxConstraint([0, T], [0, T], ends).evaluator().set_description(
            "duration"
        )

    def _add_contacts(self, held: set[int]) -> None:
        """Adds where the ball is at the wall, and how it comes there."""
        distance = (
            Expression(self._clearance[0])
            if self._clearance.size
            else self.world.contacts[0].signed_distance
        )
        self._bind_each(shared_constraint(distance, CONTACT), sorted(held))
        e, rests = self.scenario.restitution, {phase.first for phase in self._phases if phase.rests}
        for closing, k in zip(self._closing, self._touches, strict=True):
            self._prog.AddLinearConstraint(
                closing - self._contact.jacobian @ self._v[k] == 0
            ).evaluator().set_description(RESTITUTION)
            # Only a ball that does not rebound can stay.
            lower = 0.0 if e > 0 and k in rests else -np.inf
            self._prog.AddBoundingBoxConstraint(lower, 0.0, closing)
        if self._forces.size:
            self._prog.AddBoundingBoxConstraint(0.0, np.inf, self._forces)

    def _motion_rows(self, touches: bool, rests: bool) -> list[SharedEvaluator]:
        """Returns the flight and dynamics rows of a stage."""
        world, contact, h = self.world, self._contact, self._duration
        start = world.velocities
        if touches:
            start = contact.impact_map(self.scenario.restitution) @ start
        mean = (start + self._next_v) / 2
        force = world.actuation @ world.controls - bias_at(
            world, (world.positions + self._next_q) / 2, mean
        )
        if rests:
            force = force + contact.jacobian * self._force[0]
        flight = self._next_q - world.positions - h * mean
        dynamics = world.mass_matrix @ (self._next_v - start) - h * force
        return [
            *(shared_constraint(as_expression(row), FLIGHT) for row in flight),
            *(shared_constraint(as_expression(row), DYNAMICS) for row in dynamics),
        ]

    def _stage(self, k: int) -> list[tuple[npt.NDArray[Any], npt.NDArray[Any]]]:
        pairs = super()._stage(k)
        if k < len(self._steps):
            next_step = self._steps[min(k + 1, len(self._steps) - 1)]
            pairs += [
                (self._step, np.array([self._steps[k], next_step])),
                (self._clock, self._times[k : k + 2]),
            ]
        if k in self._resting:
            pairs.append((self._force, self._forces[[self._resting.index(k)]]))
        return pairs

    def _stage_variables(self, k: int) -> npt.NDArray[Any]:
        of_touch = self._closing[[k == touch for touch in self._touches]]
        of_rest = self._forces[[k == rest for rest in self._resting]]
        clock = [self._times[k : k + 1], self._steps[k : k + 1]]
        return np.concatenate([super()._stage_variables(k), of_touch, *clock, of_rest])

    def sample_times(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns the knots' times at x, shape (N+1,) [s]; they increase at any x within bounds."""
        if not self.sequence:
            return self.GetSampleTimes()
        elapsed = np.cumsum(self._values(x, self._steps))
        return np.append(0.0, self.scenario.duration * elapsed / elapsed[-1])

    def contact_sequence(self, x: npt.NDArray[np.float64]) -> TouchSequence:
        """Returns the sequence with its times at x."""
        t = self.sample_times(x)
        ends = {phase.first: phase.last for phase in self._phases if phase.rests}
        return tuple(Touch(float(t[k]), float(t[ends.get(k, k)])) for k in self._touches)

    def impulses(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns −(1 + e) m J v_k where the wall is touched, shape (N+1, 1) [N s]."""
        contact, touches = self._contact, self._touches
        impulses = np.zeros((self.num_samples(), 1))
        rates = self.split(x)[1][touches] @ contact.jacobian
        impulses[touches, 0] = -(1 + self.scenario.restitution) * contact.mass * rates
        return impulses

    def forces(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns λ_k, shape (N, 1) [N]."""
        forces = super().forces(x)
        forces[self._resting, 0] = self._values(x, self._forces)
        return forces

    def vector(self, trajectory: Trajectory) -> npt.NDArray[np.float64]:
        """Returns all decision variables of a trajectory at these knots; undoes `trajectory`."""
        x = self.vector_of(trajectory.positions, trajectory.velocities, trajectory.controls)
        groups: list[tuple[npt.NDArray[Any], npt.NDArray[np.float64]]] = [
            (self._closing, trajectory.velocities[self._touches] @ self._contact.jacobian),
            (self._forces, trajectory.forces[self._resting, 0]),
        ]
        if self.sequence:
            groups += [(self._steps, np.diff(trajectory.times)), (self._times, trajectory.times)]
        for variables, values in groups:
            x[self._prog.FindDecisionVariableIndices(variables)] = values
        return x

    def guess(self, through: npt.ArrayLike = ()) -> Trajectory:
        """Returns a guess that flies straight from stop to stop without control.

        Args:
            through: where the wall is touched, a row of nq for each of the touches' joints [m].
        """
        scenario = self.scenario
        knots = [0, *(phase.last for phase in self._phases)]
        times = [0.0, *(t for touch in self.sequence for t in touch.joints), scenario.duration]
        inner = np.reshape(through, (len(times) - 2, self.world.num_positions))
        stops = np.vstack([scenario.initial_position, inner, scenario.goal_position])
        q = np.column_stack([np.interp(range(knots[-1] + 1), knots, stop) for stop in stops.T])
        t = np.interp(range(knots[-1] + 1), knots, times)
        v = np.vstack([scenario.initial_velocity, np.diff(q, axis=0) / np.diff(t)[:, np.newaxis]])
        zeros = np.zeros((self.num_samples(), 1))
        return Trajectory(t, q, v, np.zeros(self._u.shape), zeros, zeros[1:])


def _make_phases(sequence: Sequence[Touch], scenario: Scenario) -> list[_Phase]:
    """Returns the phases, with steps spread by their durations."""
    times = np.array([0.0, *(t for touch in sequence for t in touch.joints), scenario.duration])
    durations = np.diff(times)
    if np.any(durations <= 0):
        raise OptionsError(
            "sequence",
            got=f"contacts at {times[1:-1].tolist()} s",
            expected=f"increasing times between 0 and {scenario.duration:g} s",
        )
    if len(durations) > scenario.num_steps:
        raise OptionsError(
            "sequence",
            got=f"{len(durations)} phases",
            expected=f"at most the {scenario.num_steps} steps of the scenario",
        )
    rests = [False]
    for touch in sequence:
        rests += [True, False] if touch.lasts else [False]
    counts = _spread(durations, scenario.num_steps)
    ends = np.cumsum(counts)
    return [
        _Phase(int(last - count), int(last), rest)
        for count, last, rest in zip(counts, ends, rests, strict=True)
    ]


def _spread(durations: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.int64]:
    """Returns how many of the steps each phase gets: by duration, and an equal share of half."""
    even = np.full(len(durations), 1 / len(durations))
    shares = np.cumsum(durations / durations.sum() + even) / 2
    spare = count - len(durations)  # Each gets one first.
    ends = np.round(spare * shares).astype(int)
    return 1 + np.diff(ends, prepend=0)
