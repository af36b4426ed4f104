"""The multi-phase problem of a contact sequence, motions of it, and what is known without one."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats
from drake_aigto.planning.balls.timeline import (
    Phase,
    check_sequence,
    make_guess,
    make_timeline,
    straight_path,
)
from drake_aigto.planning.options import PlanOptions
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import (
    AT_ONCE,
    NO_ADDITIONS,
    NONPENETRATION,
    RESTITUTION,
    Additions,
    Facing,
    RigidTranscription,
    Touch,
    TouchSequence,
    calc_cost,
    find_facings,
    rigid_defects,
    touches_at_once,
)
from drake_aigto.world import Scales, Scenario, World

# The least parts of the duration. Flights: times of a trajectory have to increase, and a bounce may
# come right after the start, or sooner still (`touches_at_once`). Sustained contacts: shorter ones
# are bounces, and without a bound the solver would chase vanishing contacts.
_SHORTEST_FLIGHT, _SHORTEST_CONTACT = 1e-7, 1e-3
# Contacts slower than this part of the velocity scale come to rest without hops.
_SLOW = 1e-6
# AIGO's boxes distinguish a bounce from the start's own impulse if this many steps lead to the
# wall; and the factor by which they may have more steps for that, unless the scenario has more.
_STEPS_TO_WALL, _MOST_FINER = 3, 4
# Parts of the duration: the least distance of first touches to an instant; and the distance at
# which a polished touch is blocked by it.
_APART, _HELD = 1e-3, 1e-5

# Times (K,) [s] and positions (K, nq) [m].
Path = tuple[Floats, Floats]


class PhaseProblem:
    """Multi-phase problem of a contact sequence, which `Arcs` closes.

    Phases meet where a contact is touched or left. Knots are spread evenly over each phase, whose
    duration is free, so time steps h_k are unknowns. From the velocity v⁺_k after knot k, with
    means over the step marked by a bar:

        q_{k+1} = q_k + h_k v̄_k                                                            "flight"
        M (v_{k+1} − v⁺_k) = h_k (B u_k − h(q̄_k, v̄_k) + Jᵀ λ_k)                          "dynamics"
        v⁺_k = v_k, but where contacts C are touched
        φ_i(q_k) = 0,  J_i v_k ≤ 0,  J_C v⁺_k = −E J_C v_k                 "contact", "restitution"
        while contact i lasts: φ_i(q_{k+1}) = 0, λ_ik ≥ 0; and it starts with J_i v⁺_k = 0
        elsewhere: λ_ik = 0 and φ_i(q_k) ≥ 0                                       "nonpenetration"
        h_{k+1} = h_k within a phase,  Σ h_k = T                                             "clock"

    C are all contacts that are touched at that knot, and those that were resting until then: they
    are struck at once (`JointImpact`), and no impulse pulls. A sustained contact holds its normal
    only, so that the body slides along the frictionless wall. At elastic walls, contacts are
    sustained only without approach speed; at others of e > 0 they include the hops that come first.
    These are of e, e², … of the speed of the touch, without control, and last until the wall's
    force has the impulse 2 e/(1 − e) m J v, exact for constant λ: Σ h λ + 2 e/(1 − e) m J v ≥ 0,
    with the effective mass m = (J M⁻¹ Jᵀ)⁻¹ of the contact. Of a box with several faces only the
    one in force (`Facing`) counts; while it is touched, φ ≤ 0 for the others.

    Held controls make flight exact for a constant h; with springs and dampers this is the implicit
    midpoint rule. Forces are unknowns here, for the mode is known.

    Args:
        world: the plant, read; its signed distances have to be affine.
        scenario: the task; its time step only sets the number of knots.
        sequence: the contacts in the order of time; () is a free flight.
        facings: which faces of boxes keep the motion out; if None, those of a straight guess.
        additions: of users to a transcription with other knots. Phases meet at their times, too,
            and controls that they read are held as long as there.

    Attributes:
        sequence: as given.
        facings: as given, or found.
        timeline: of its knots.
        inertia: M and J.
        impacts: knot → impact of the contacts struck there.
        restitutions: e of each contact, shape (m,).

    Raises:
        ScenarioError, ModelError: see `World.check_plain`.
        OptionsError: times out of order or outside of the duration, unknown contacts, more phases
            than steps, or facings that leave out a box or a touched face.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        sequence: Sequence[Touch] = (),
        facings: Sequence[Facing] | None = None,
        additions: Additions = NO_ADDITIONS,
    ) -> None:
        """Spreads the knots by the sequence's times."""
        world.check_plain(scenario)
        self.world, self.scenario, self.additions = world, scenario, additions
        self.sequence: TouchSequence = tuple(sequence)
        check_sequence(world, self.sequence, scenario.duration)
        if facings is None:
            facings = find_facings(world, *straight_path(world, scenario, sequence), sequence)
        self.facings = tuple(facings)
        args = world, scenario, self.sequence, self.facings, additions.instants
        self.timeline = make_timeline(*args)
        self.inertia, self.restitutions = world.constant_inertia, world.restitutions(scenario)
        # Where contacts land, they stay.
        self._returned = np.where(self.timeline.marks.lands, 0.0, self.restitutions)
        marks = self.timeline.marks
        self.impacts = {
            k: marks.calc_impact(k, self.inertia, self.restitutions)
            for k in np.flatnonzero(marks.struck.any(axis=1)).tolist()
        }

    @cached_property
    def scales(self) -> Scales:
        """The task's own units."""
        return Scales.of(self.world, self.scenario)

    @property
    def num_steps(self) -> int:
        """Number of steps, N."""
        return self.scenario.num_steps

    @property
    def has_long_arcs(self) -> bool:
        """Whether the cheapest controls of many steps are affine, so that one arc has them all."""
        return self.world.has_constant_dynamics and not self.additions.are_everywhere

    @property
    def _at_once(self) -> TouchSequence:
        return self.scenario.derive(self.world, touches_at_once)

    def least_step(self, phase: Phase) -> float:
        """Returns the lower bound of a phase's steps [s]."""
        least = _SHORTEST_CONTACT if phase.rests else _SHORTEST_FLIGHT
        shortest = least * self.scenario.duration
        if self.timeline.phases.index(phase) < len(self._at_once):
            shortest = min(shortest, self._at_once[0].start / 2)
        return shortest / (phase.last - phase.first)

    def knot_of(self, k: int) -> int:
        """Returns the knot at the time of knot k of the transcription that users added to."""
        times = self.additions.times
        ends = {0: 0, len(times) - 1: self.num_steps}
        return ends[k] if k in ends else self.timeline.instants[float(times[k])]

    def guess(self, through: ArrayLike | None = None) -> Trajectory:
        """Returns a motion from stop to stop of the `straight_path` (`make_guess`)."""
        stops = straight_path(self.world, self.scenario, self.sequence, through)
        return make_guess(self.world, self.scenario, self.timeline, *stops)

    def calc_impulses(self, velocities: Floats) -> Floats:
        """Returns P v_k (`JointImpact`) where contacts are touched, shape (N+1, m) [N s].

        Velocities are those before impacts, shape (N+1, nv) [m/s].
        """
        impulses = np.zeros(self.timeline.marks.struck.shape)
        for k, impact in self.impacts.items():
            impulses[k, self.timeline.marks.struck[k]] = impact.impulses @ velocities[k]
        return impulses

    def find_settlings(self, motion: Trajectory) -> list[tuple[float, float]]:
        """Returns, of each sustained contact at a wall of 0 < e < 1, its approach and its rest.

        That is J v as it is touched [m/s], and the speed that the wall's impulse could still
        change after the hops, (Σ h λ)/m + 2 e/(1 − e) J v; if negative, they do not end in time
        [m/s].
        """
        found, steps, inertia = [], np.diff(motion.times), self.inertia
        for touch, (first, last) in zip(self.sequence, self.timeline.spans, strict=True):
            i = touch.contact
            e = self.restitutions[i]
            if touch.lasts and 0 < e < 1:
                pushed = float(steps[first:last] @ motion.forces[first:last, i])
                closing = float(inertia.jacobian[i] @ motion.velocities[first])
                left = pushed / inertia.masses[i] + 2 * e / (1 - e) * closing
                found.append((closing, left))
        return found

    def calc_defects(self, motion: Trajectory) -> dict[str, float]:
        """Returns a motion's largest violation of each kind of row, in its unit (m, m/s).

        Sustained contacts that end before their hops count as restitution.
        """
        found = rigid_defects(self.world, self._returned, motion)
        left = (-left for _, left in self.find_settlings(motion))
        depth = self.world.calc_clearance(motion.positions[1:])
        return {
            **found,
            RESTITUTION: max(found[RESTITUTION], *left, 0.0),
            NONPENETRATION: max(0.0, -float(np.min(depth))),
        }


@dataclass(frozen=True, eq=False)
class PhaseMotion:
    """A motion of a multi-phase problem, at its knots.

    Attributes:
        phases: the problem.
        trajectory: the motion.
        is_of_arcs: whether it is the optimum in arcs of many steps, with any number of knots.
    """

    phases: PhaseProblem
    trajectory: Trajectory
    is_of_arcs: bool = False

    @property
    def path(self) -> Path:
        """Its times and positions."""
        return self.trajectory.times, self.trajectory.positions

    @cached_property
    def distances(self) -> Floats:
        """φ at the knots, shape (N+1, m) [m]."""
        return self.phases.world.calc_signed_distance(self.trajectory.positions)

    @cached_property
    def sequence(self) -> TouchSequence:
        """The contact sequence, with its times."""
        t, spans = self.trajectory.times.tolist(), self.phases.timeline.spans
        return tuple(
            Touch(t[first], t[last], touch.contact)
            for touch, (first, last) in zip(self.phases.sequence, spans, strict=True)
        )

    @property
    def facings(self) -> tuple[Facing, ...]:
        """The faces of boxes that keep the motion out, with their times."""
        t, turns = self.trajectory.times.tolist(), self.phases.timeline.turns
        return tuple(
            Facing(t[k], facing.contact)
            for facing, k in zip(self.phases.facings, turns, strict=True)
        )

    @property
    def cost(self) -> float:
        """J, without costs of users."""
        return calc_cost(self.phases.scenario, *self.path, self.trajectory.controls)

    @property
    def defects(self) -> dict[str, float]:
        """The largest violation of each kind of row, in its unit (m, m/s)."""
        return self.phases.calc_defects(self.trajectory)

    @property
    def hops(self) -> bool:
        """Whether a sustained contact begins with hops: it is touched at a speed."""
        closing = [speed for speed, _ in self.phases.find_settlings(self.trajectory)]
        return bool(closing) and min(closing) < -_SLOW * self.phases.scales.velocity


def transcribe(world: World, scenario: Scenario, options: PlanOptions) -> RigidTranscription:
    """Returns the scenario, transcribed with the time steps of `coarsen`."""
    world.check_plain(scenario)
    return RigidTranscription(world, coarsen(world, scenario, options), options.relaxation)


def coarsen(world: World, scenario: Scenario, options: PlanOptions) -> Scenario:
    """Returns the scenario with the time steps of AIGO's boxes (`PlanOptions.aigo_steps`).

    There are more of them if a wall would be touched in less than three: up to the scenario's, or
    four times as many if those are few.
    """
    most = max(scenario.num_steps, _MOST_FINER * options.aigo_steps)
    distances = world.calc_signed_distance(scenario.initial_position)
    jacobian = world.calc_contact_jacobian(scenario.initial_position)
    speeds, T = -jacobian @ scenario.initial_velocity, scenario.duration
    counts = T * speeds[distances > 0] / distances[distances > 0]
    # Walls that are touched at once do not count: they are known without boxes.
    steps = math.ceil(_STEPS_TO_WALL * np.max(counts[counts < 1 / AT_ONCE], initial=0.0))
    return scenario.in_steps(max(options.aigo_steps, min(steps, most)))


def least_flight_cost(world: World, scenario: Scenario) -> float:
    """Returns a lower bound of the cost of motions without contact.

    Without walls, and with a control that may change at any time, which then is affine in t:

        d = goal − q₀ − T v₀ − ½ T² a₀,   J ≥ dᵀ C⁻¹ d
    """
    if scenario.goal_weight == 0:
        return 0.0
    T = scenario.duration
    way = scenario.goal_position - scenario.initial_position
    way = way - T * scenario.initial_velocity - T**2 / 2 * world.constant_dynamics.drift
    return float(way @ np.linalg.solve(calc_compliance(world, scenario), way))


def calc_compliance(world: World, scenario: Scenario) -> Floats:
    """Returns C = I/w_f + T³/(3 w_u) G Gᵀ with G = M⁻¹ B, shape (nv, nv).

    A flight that ends d off the goal without control costs dᵀ C⁻¹ d with the best one. w_f > 0.
    """
    w_u, w_f, T = scenario.control_weight, scenario.goal_weight, scenario.duration
    gain = world.constant_dynamics.gain
    return np.eye(len(gain)) / w_f + T**3 / (3 * w_u) * gain @ gain.T


def unfolds(world: World, scenario: Scenario) -> bool:
    """Returns whether the contacts and their order are expected to determine a plan.

    Mirrored at each wall that it bounces off, a motion under controls alone is a free flight to the
    goal's image. The cost of that is convex, if accelerations cost the same in the image. But a
    block can be passed on two sides; under gravity a ball bounces high and late or low and early;
    and of two masses the lighter one costs less.
    """
    dynamics = world.constant_dynamics
    return bool(
        world.num_solids == world.num_contacts
        and np.all(world.restitutions(scenario) > 0)
        and not np.any(dynamics.drift)
        and dynamics.mirrors_keep_costs
    )


def keep_apart(sequence: TouchSequence, instants: Floats, duration: float) -> TouchSequence:
    """Returns a sequence off the instants, shape (I,), I > 0 [s]; touches at one come later."""
    gap = min([_APART * duration, *(np.diff(instants) / 4)])

    def move(time: float) -> float:
        nearest = float(instants[np.argmin(np.abs(instants - time))])
        is_near = abs(time - nearest) < gap
        return nearest + (gap if time >= nearest else -gap) if is_near else time

    return _by_start([_with_joints(touch, *map(move, touch.joints)) for touch in sequence])


def moved_past(motion: PhaseMotion) -> Iterator[TouchSequence]:
    """Yields the sequence with each touch that an instant blocks on its other side."""
    sequence, T = motion.sequence, motion.phases.scenario.duration
    for place, touch in enumerate(sequence):
        for joint, time in enumerate(touch.joints):
            for instant in motion.phases.timeline.instants:
                if abs(time - instant) <= _HELD * T:
                    joints = [*touch.joints]
                    joints[joint] = instant - np.copysign(_APART * T, time - instant)
                    moved = _with_joints(touch, *joints)
                    yield _by_start([*sequence[:place], moved, *sequence[place + 1 :]])


def _with_joints(touch: Touch, *joints: float) -> Touch:
    return dataclasses.replace(touch, start=float(joints[0]), end=float(joints[-1]))


def _by_start(touches: list[Touch]) -> TouchSequence:
    return tuple(sorted(touches, key=lambda touch: touch.start))
