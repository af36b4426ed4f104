"""Replay: a plan's control alone, run from the start by a judge; and contacts of a plan itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import ArrayRecord, Floats, Ints, LockedArrays
from drake_aigto.errors import TrajectoryError
from drake_aigto.plain import called
from drake_aigto.simulation.drake_judge import DrakeJudge
from drake_aigto.simulation.event_driven import EventDriven
from drake_aigto.simulation.recording import ContactPhase, Controller, HeldControl, Recording
from drake_aigto.simulation.verdict import NOTHING, calc_cost, calc_violations, explain_cost
from drake_aigto.trajectory import Trajectory, check_control
from drake_aigto.world import Scales, Scenario, World

# A row is at a knot but for this part of the duration: rounding.
_AT_KNOT = 1e-9


@dataclass(frozen=True, eq=False)
class Replay(LockedArrays, ArrayRecord):
    """Motion of a world under a control, whatever its plan promised.

    Attributes:
        simulator: "event-driven" (exactly rigid walls), "integrated" (the world's equations with
            the springs of compliant contact), or "drake" (the continuous plant).
        cost: the task's (`TaskCost`): control_weight Σ dt_k ‖u_k‖² + goal_weight ‖q(T) − goal‖² if
            it is plain. What runs is integrated by quadrature, with a relative error of 1e-8 on
            walls of our own, along cubics between the ends of steps in Drake.
        goal_error: ‖q(T) − goal‖ of the coordinates that the goal weighs, all if none; of angles
            as the task compares them [m, rad].
        max_penetration: the deepest −φ, at least 0 [m].
        bounce_times: when walls were touched, B of them [s].
        bounce_contacts: which of the world's contacts each touch was at.
        energies_before: kinetic energy ½ vᵀ M v at each touch, B [J].
        energies_after: kinetic energy as each contact ends, B [J]. A contact that lasts to T is
            compared with T.
        compliance_error: "drake" and rigid contact only: how far the end should be, at most, from
            where rigid walls lead [m]. A contact lasts τ = π √(m/k), which delays what follows and
            loses what the control adds meanwhile: of one elastic impact, τ times the last speed.
            All of it is in `calc_lateness`, with what contacts creep that should stick.
        compliance_cost: what of the cost this explains at most.
        matched_speeds: "drake" only, restitution < 1 only: the speeds, in the order of time, for
            which the dissipation was set to give each impact its restitution [m/s]. Impacts below a
            twentieth of the fastest count as that, and return more.
        added_costs: what of the cost users added, by name (`Planner.transcription`).
        violations: by how much the motion misses bounds and a hard goal (`calc_violations`), and
            each constraint that users added (`Additions.violations`), by name, in parts of the
            task's scales and apart from what compliance explains.
        contact_phases: "event-driven" only: when contacts with friction stick and slip.
        feedback: the largest that the plan's own feedback added to its control, as a norm [N, N m];
            None: the control alone was replayed.
        touch_error: "drake" and space only: how far its touches of capsules and meshes are off the
            exact ones, at most [m] (`find_touch_error`).
        offset_cost: of a start that is off, what of the cost that explains to first order.
        offset_error: what of the goal's error, likewise [m, rad].
        times: shape (K,): the knots, and where contacts begin and end [s]. Never decreasing; a
            rigid impact has two rows of equal time.
        positions: shape (K, nq) [m, rad].
        velocities: shape (K, nv) [m/s, rad/s].
    """

    simulator: str
    cost: float
    goal_error: float
    max_penetration: float
    bounce_times: tuple[float, ...]
    bounce_contacts: tuple[int, ...]
    energies_before: tuple[float, ...]
    energies_after: tuple[float, ...]
    compliance_error: float
    compliance_cost: float
    matched_speeds: tuple[float, ...]
    times: Floats
    positions: Floats
    velocities: Floats
    added_costs: Mapping[str, float] = field(default_factory=dict)
    violations: Mapping[str, float] = field(default_factory=dict)
    contact_phases: tuple[ContactPhase, ...] = ()
    feedback: float | None = None
    touch_error: float = 0.0
    offset_cost: float = 0.0
    offset_error: float = 0.0

    @property
    def broken(self) -> tuple[str, ...]:
        """The constraints that it misses by more than simulations may, by name."""
        return tuple(n for n, by in self.violations.items() if not by <= NOTHING)

    def states_at(self, knots: Floats) -> tuple[Floats, Floats]:
        """Returns q and v at knots of the control (K+1,) [s], at an impact those before it."""
        rows = np.searchsorted(self.times, knots - _AT_KNOT * knots[-1])
        return self.positions[rows], self.velocities[rows]

    @property
    def energy_ratios(self) -> tuple[float, ...]:
        """Kinetic energy after / before each contact."""
        pairs = zip(self.energies_before, self.energies_after, strict=True)
        return tuple(after / before for before, after in pairs)

    @property
    def energy_ratio(self) -> float | None:
        """The one number for tables, Σ after / Σ before over all contacts that begin in motion.

        None if there are none: from rest, it would divide what the control adds by next to nothing.

        Contacts count by their energy, so that the last tremor before rest does not hide the
        bounce. On rigid walls it is restitution² if the ball moves straight at them, and never more
        than 1: more is energy from nowhere.
        """
        pairs = list(zip(self.energies_before, self.energies_after, strict=True))
        least = _AT_REST**2 * max(map(max, pairs), default=0.0)
        moving = [each for each in pairs if each[0] > least]
        before, after = map(sum, zip(*moving, strict=True)) if moving else (0.0, 0.0)
        return after / before if moving else None


class Judge(Protocol):
    """Simulates what a controller does to a world; knows nothing of plans.

    A file with another one is all that it takes: replays and verdicts take any.
    """

    def simulate(self, world: World, scenario: Scenario, controller: Controller) -> Recording:
        """Runs a controller from the scenario's start to its end.

        The recording says how far its end should be at most from where the scenario's law of
        contact leads (`Recording.error`).
        """


EVENT_DRIVEN, DRAKE = EventDriven(), DrakeJudge()


def replay_event_driven(
    world: World, scenario: Scenario, times: ArrayLike, controls: ArrayLike
) -> Replay:
    """Replays a held control on walls of our own, rigid or compliant as the scenario says.

    The judge of plans, for any restitution in [0, 1] (`EventDriven`). On compliant walls the
    replay's simulator is "integrated".

    Args:
        world: its dynamics and its contacts.
        scenario: start, goal, weights and restitution; it has to fit the world (`World.check`).
        times: of the knots, shape (N+1,), not necessarily even [s].
        controls: held over each interval, shape (N, nu) [N].

    Raises:
        TrajectoryError: shapes that do not fit, times that do not increase, NaN or infinity.
        FrictionError: friction leaves no way to go on, or several (`SlidingMotion`).
    """
    return replay_with(EVENT_DRIVEN, world, scenario, hold(world, scenario, times, controls))


def replay_drake(world: World, scenario: Scenario, times: ArrayLike, controls: ArrayLike) -> Replay:
    """Replays a held control on the world's own continuous plant in Drake, for its actuation.

    Its walls are compliant (`DrakeJudge`): `make_simulator` has the same plant for diagrams of your
    own. Arguments are those of `replay_event_driven`.

    Raises:
        ModelError: a shape of the contact has no stiffness.
        TrajectoryError: shapes that do not fit, times that do not increase, NaN or infinity.
    """
    return replay_with(DRAKE, world, scenario, hold(world, scenario, times, controls))


def replay_with(judge: Judge, world: World, scenario: Scenario, controller: Controller) -> Replay:
    """Returns what a controller does, as a judge simulates it."""
    scenario = world.place(scenario)
    recording = judge.simulate(world, scenario, controller)
    return summarize(world, scenario, recording, controller.end)


def confirms(
    cost: float,
    replay: Replay,
    scales: Scales,
    goal_error: float | None = None,
    *,
    relative_cost: float = 0.05,
    nothing: float = NOTHING,
) -> bool:
    """Returns whether a plan holds: its replay is nearly as cheap, and ends nearly as close.

        replay.cost − compliance_cost − offset_cost ≤ cost + relative_cost · |cost| + nothing² J₀
        replay.goal_error − compliance_error − offset_error ≤ goal_error + nothing · L
        each of replay.violations ≤ nothing

    with the task's scales L and J₀, in which 1 rad counts as 1 m. A replay that does better than
    its plan confirms it. The parts that do not grow with the cost are for plans that promise next
    to nothing: a motion that ends 2 mm off the goal in a task of a meter, where the plan claims 0,
    is still there, and J₀ is what missing the goal by L costs. The defaults let pass what the
    compliant wall of the shipped models takes from the optimal plans of Table I's problems (0.1 ms
    late, so 0.2 mm off, at 0.5 % more cost at most), and stop a plan whose bounce no rigid wall
    returns. NaN never holds.

    Args:
        cost: that the plan promises.
        replay: of the plan's control.
        scales: of the task (`Scales.of`).
        goal_error: that the plan promises, as `Replay.goal_error` [m, rad]; None leaves out the
            second rule.
        relative_cost: how much more the replay may cost, as a part of the plan's cost.
        nothing: what counts as nothing, as a part of the scales.
    """
    replayed_cost = replay.cost - replay.compliance_cost - replay.offset_cost
    replayed_error = replay.goal_error - replay.compliance_error - replay.offset_error
    is_cheap = replayed_cost <= cost + relative_cost * abs(cost) + nothing**2 * scales.cost
    is_near = goal_error is None or replayed_error <= goal_error + nothing * scales.length
    return is_cheap and is_near and all(by <= nothing for by in replay.violations.values())


def hold(world: World, scenario: Scenario, times: ArrayLike, controls: ArrayLike) -> HeldControl:
    """Returns a held control that fits the world, with knots where a reference has its own.

    Costs have kinks there. Arguments are those of `replay_event_driven`.

    Raises:
        TrajectoryError: shapes that do not fit, times that do not increase, NaN or infinity.
    """
    t, u = check_control(times, controls)
    if u.shape[1] != world.num_actuators:
        expected = f"{world.num_actuators} columns, one for each actuator"
        raise TrajectoryError("controls", got=f"shape {u.shape}", expected=expected)
    if has_knots(scenario, t):
        return HeldControl(t, u)
    knots = np.union1d(t, _find_kinks(scenario, t))
    return HeldControl(knots, u[np.searchsorted(t, knots[:-1], side="right") - 1])


def has_knots(scenario: Scenario, times: Floats) -> bool:
    """Returns whether there is a knot wherever a reference has its own, so that costs have kinks.

    Args:
        scenario: the task.
        times: of the knots, shape (N+1,) [s].
    """
    kinks = _find_kinks(scenario, times)
    return not kinks.size or bool(np.isin(kinks, times).all())


def _find_kinks(scenario: Scenario, times: Floats) -> Floats:
    """Returns the knots of a reference within times [s]."""
    if scenario.reference_times is None:
        return np.empty(0)
    inside = (scenario.reference_times > times[0]) & (scenario.reference_times < times[-1])
    return scenario.reference_times[inside]


def summarize(world: World, scenario: Scenario, recording: Recording, end: float) -> Replay:
    """Returns the replay that a recording of held controls until an end [s] shows."""
    times = np.append(recording.control_times, end)
    controls = np.array(recording.controls)
    cost, goal_error = calc_cost(world, scenario, times, controls, recording)
    compliance_cost = recording.cost_error
    if compliance_cost is None:
        compliance_cost = explain_cost(world, scenario, recording.positions[-1], recording.error)
    return Replay(
        simulator=recording.simulator,
        cost=cost,
        goal_error=goal_error,
        max_penetration=recording.max_penetration,
        bounce_times=tuple(float(impact.time) for impact in recording.impacts),
        bounce_contacts=tuple(impact.contact for impact in recording.impacts),
        energies_before=tuple(impact.energy_before for impact in recording.impacts),
        energies_after=tuple(impact.energy_after for impact in recording.impacts),
        compliance_error=recording.error,
        compliance_cost=compliance_cost,
        matched_speeds=tuple(recording.matched_speeds),
        times=np.array(recording.times),
        positions=np.array(recording.positions),
        velocities=np.array(recording.velocities),
        violations=calc_violations(world, scenario, recording.positions, recording.velocities),
        contact_phases=tuple(recording.phases),
        feedback=recording.feedback,
        touch_error=recording.touch_error,
    )


# An impulse is a contact if it changes the velocity by this part of the largest one on the way. A
# literal plan has some force at every distance; this tells the blow from the breeze.
_SHARE = 0.05
# Impulses that follow each other sooner than this part of the duration are one contact.
_GAP = 0.1
# An impulse below this part of the largest velocity is a solver's rounding.
_ROUNDING = 1e-9
# A velocity below this part of the largest one is none: a contact that lasts may begin and end so.
_STILL = 1e-5
# A contact that lasts and begins with less than this part of the largest velocity begins at rest:
# what the control adds meanwhile would be divided by next to nothing. A blow that does adds energy.
_AT_REST = 1e-2


@dataclass(frozen=True)
class PlannedContact:
    """One contact of a plan.

    Attributes:
        time: of its first knot [s].
        last_time: of its last knot [s].
        velocity_change: ‖Σ M⁻¹ J_iᵀ (p_ik + λ_ik τ_k)‖ [m/s].
        energy_ratio: kinetic energy after / before, with all that happens at its knots; None where
            it lasts from rest on, and 1 where it ends at rest, too.
        index: i, which of the world's contacts.
    """

    time: float
    last_time: float
    velocity_change: float
    energy_ratio: float | None
    index: int = field(default=0, metadata=called("contact"))

    def __post_init__(self) -> None:
        """Reads plans of earlier versions: contact that lasts from rest on has a ratio of ∞."""
        if self.energy_ratio == np.inf and self.last_time > self.time:
            object.__setattr__(self, "energy_ratio", None)


def find_contacts(world: World, trajectory: Trajectory) -> tuple[PlannedContact, ...]:
    """Returns the contacts of a trajectory in the order of time: its contact sequence.

    Where a wall pushes at every knot, large impulses are contacts, and those that follow each
    other soon are one. Where it does not, every impulse and every held force is one.
    """
    q, v = trajectory.positions, trajectory.velocities
    after = v + world.calc_velocity_change(q, trajectory.impulses)
    energies = np.array([world.calc_kinetic_energy(q, each) for each in (v, after)])
    found = [
        contact
        for i in range(world.num_contacts)
        for contact in _find_contacts(world, trajectory, energies, i)
    ]
    return tuple(sorted(found, key=lambda contact: (contact.time, contact.index)))


def _find_contacts(
    world: World, trajectory: Trajectory, energies: Floats, index: int
) -> list[PlannedContact]:
    """Returns those of one contact; with the energies before and after each knot, (2, N+1) [J]."""
    impulses, forces = trajectory.impulses[:, index], trajectory.forces[:, index]
    held = forces * np.diff(trajectory.times)
    if not (np.any(impulses) or np.any(held)):
        return []
    alone = np.zeros(trajectory.impulses.shape)
    alone[:, index] = impulses + np.append(held, 0.0)
    changes = world.calc_velocity_change(trajectory.positions, alone)
    runs = _find_runs(trajectory, impulses, held, np.linalg.norm(changes, axis=1))
    still = _STILL**2 * np.max(energies[0])  # Rounding of the largest on the way is none.
    energies = np.where(energies > still, energies, 0.0)
    return [
        PlannedContact(
            time=float(trajectory.times[run[0]]),
            last_time=float(trajectory.times[run[-1]]),
            velocity_change=float(np.linalg.norm(changes[run[0] : run[-1] + 1].sum(axis=0))),
            energy_ratio=_divide(energies, run, bool(np.any(held[run[:-1]]))),
            index=index,
        )
        for run in runs
    ]


def _find_runs(trajectory: Trajectory, impulses: Floats, held: Floats, sizes: Floats) -> list[Ints]:
    """Returns the knots of each contact, given how much velocities change there (N+1,) [m/s]."""
    largest = np.max(np.linalg.norm(trajectory.velocities, axis=1))
    if np.all(impulses[:-1]):
        hit = np.flatnonzero(sizes > _SHARE * largest)
        apart = np.diff(trajectory.times[hit]) >= _GAP * np.ptp(trajectory.times)
    else:
        # Forces of rounding before a touch are none of its own.
        pressed = np.abs(held) > _ROUNDING * max(np.max(np.abs(held)), np.max(np.abs(impulses)))
        touching = np.append(pressed, False) | np.append(False, pressed)
        hit = np.flatnonzero((sizes > _ROUNDING * largest) | touching)
        apart = ~pressed[hit[:-1]]
    return np.split(hit, np.flatnonzero(apart) + 1) if hit.size else []


def max_penetration(world: World, trajectory: Trajectory) -> float:
    """Returns how deep the ball is inside a wall at most, over the knots, at least 0 [m]."""
    return -float(np.min(world.calc_clearance(trajectory.positions), initial=0.0))


def _divide(energies: Floats, run: Ints, lasts: bool) -> float | None:
    """Returns kinetic energy after / before; 1 if neither is any, None if it lasts from rest on."""
    before, after = float(energies[0, run[0]]), float(energies[1, run[-1]])
    if lasts and after and before < _AT_REST**2 * np.max(energies[0]):
        return None
    return after / before if before else np.inf if after else 1.0
