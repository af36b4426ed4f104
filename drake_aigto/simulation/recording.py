"""Controllers that simulations ask; recordings of motions, and whether these reach their goals."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.polynomial import legendre

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import TrajectoryError
from drake_aigto.simulation.flights import CONTACT, PUSH, SPEED, STATE, TIME
from drake_aigto.world import Scenario, TaskCost, World

# Of a quadrature between rows: the square of a cubic has degree 6, so that it is exact.
_NODES, _WEIGHTS = legendre.leggauss(4)

# A list that grows, or an array of what is known at once.
Rows: TypeAlias = Any


class Held(NamedTuple):
    """A control that is held for a while."""

    control: Floats  # u, shape (nu,) [N]
    until: float  # when the controller is asked again, at the latest [s]
    feedback: float | None = None  # the size of what is not of a plan in it [N, N m]


class Controller(ABC):
    """A digital controller: it samples the state and holds its control until the next sample.

    Attributes:
        start: of its time [s].
        end: of its time [s].
        feels_contact: whether it is asked again as soon as a contact has ended, and not while one
            goes on.
    """

    start: float
    end: float
    feels_contact: bool = False

    @abstractmethod
    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns the control from now on, in [start, end) [s].

        Args:
            time: now [s].
            x: (q, v), shape (nq + nv,).
            bounces: the contact of each bounce so far.
        """

    def since(self, time: float, bounces: Sequence[int]) -> Controller:
        """Returns the rest of it from a time on [s], before which such contacts have bounced."""
        return _Later(self, time, bounces)


class _Later(Controller):
    """A controller from some time on."""

    def __init__(self, controller: Controller, start: float, bounces: Sequence[int]) -> None:
        self._controller, self._bounces = controller, [*bounces]
        self.start, self.end = start, controller.end
        self.feels_contact = controller.feels_contact

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        return self._controller.sample(time, x, [*self._bounces, *bounces])


class HeldControl(Controller):
    """A control that was decided before: open loop.

    Attributes:
        times: of the knots, shape (N+1,) [s].
        controls: that are held between them, shape (N, nu) [N].
    """

    def __init__(self, times: Floats, controls: Floats) -> None:
        """Keeps controls (N, nu) [N] that are held between knots (N+1,) [s]."""
        self.times, self.controls = times, controls
        self.start, self.end = float(times[0]), float(times[-1])

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns the control of this interval."""
        k = int(np.searchsorted(self.times, time, side="right"))
        return Held(self.controls[k - 1], float(self.times[k]))

    def since(self, time: float, bounces: Sequence[int]) -> Controller:
        """Returns the rest of it from a time on [s]."""
        k = int(np.searchsorted(self.times, time, side="right"))
        return HeldControl(np.append(time, self.times[k:]), self.controls[k - 1 :])


class MotionSamples(NamedTuple):
    """A motion at nodes of a quadrature, ∫ f dt ≈ Σ_k weights_k f(times_k, states_k)."""

    times: Floats  # shape (K,) [s]
    weights: Floats  # shape (K,) [s]
    states: Floats  # (q, v), shape (K, 2 nv)


class Impact(NamedTuple):
    """A contact that throws the ball back."""

    time: float  # when the wall was touched [s]
    contact: int  # which of the world's contacts
    speed: float  # of approach, −φ̇ > 0 [m/s]
    push: float  # φ̈ without contact; negative is into the wall [m/s²]
    energy_before: float  # kinetic, ½ vᵀ M v, when the wall was touched [J]
    energy_after: float  # kinetic, when it was left [J]


@dataclass(frozen=True)
class ContactPhase:
    """A stretch of time in which a contact with friction lasts in one mode."""

    contact: int  # which of the world's contacts
    # "stick", which is rolling where something turns; or "forward" or "backward", slip with s = T v
    # above or below 0.
    mode: str
    start: float  # when it began [s]
    end: float  # when it ended [s]


@dataclass
class Recording:
    """Filled while a simulation runs; the last row is its end.

    Attributes:
        simulator: what simulated (`Replay.simulator`).
        error: how far the end should be at most from where the scenario's own law of contact leads
            [m, rad].
        cost_error: what of the cost this explains at most; None: what such an end may cost.
        times: never decreasing; equal before and after an impact that takes no time [s].
        positions: q for each time, shape (nq,) [m].
        velocities: v for each time, shape (nv,) [m/s].
        impacts: in order of time.
        max_penetration: the deepest −φ, at least 0 [m].
        matched_speeds: for which dissipation was set, on compliant walls [m/s].
        creep: how far contacts with friction that stick would move q, if they slipped at
            1 m/s meanwhile, on rigid walls [m, rad].
        phases: of contacts with friction that last, on rigid walls, in order of their starts.
        control_times: from when each control was held [s].
        controls: u of each of them, shape (nu,) [N].
        feedback: the largest that was added to a plan's control, if it is tracked [N, N m].
        touch_error: how far touches that Drake finds are off the exact ones, at most [m].
        samples: of the motion between rows, where it is integrated, and the control meanwhile.
    """

    simulator: str = ""
    error: float = 0.0
    cost_error: float | None = None
    times: Rows = field(default_factory=list)
    positions: Rows = field(default_factory=list)
    velocities: Rows = field(default_factory=list)
    impacts: list[Impact] = field(default_factory=list)
    max_penetration: float = 0.0
    matched_speeds: list[float] = field(default_factory=list)
    creep: float = 0.0
    phases: list[ContactPhase] = field(default_factory=list)
    control_times: Rows = field(default_factory=list)
    controls: Rows = field(default_factory=list)
    feedback: float | None = None
    touch_error: float = 0.0
    samples: list[tuple[MotionSamples, Floats]] = field(default_factory=list)

    @property
    def bounces(self) -> list[int]:
        """The contact of each impact so far."""
        return [impact.contact for impact in self.impacts]

    def add(self, time: float, q: Floats, v: Floats) -> None:
        """Appends a state."""
        self.times.append(time)
        self.positions.append(q)
        self.velocities.append(v)

    def add_phase(self, contact: int, mode: str, start: float, end: float) -> None:
        """Appends a stretch in which a contact lasts, or lengthens the one that it goes on with."""
        for k, last in enumerate(self.phases):
            if (last.contact, last.mode, last.end) == (contact, mode, start):
                self.phases[k] = replace(last, end=end)
                return
        self.phases.append(ContactPhase(contact, mode, start, end))

    def hold(self, time: float, held: Held) -> None:
        """Appends a control."""
        self.control_times.append(time)
        self.controls.append(held.control)
        if held.feedback is not None:
            self.feedback = max(self.feedback or 0.0, held.feedback)

    def add_impacts(self, log: Floats, mass_matrix: Floats) -> None:
        """Appends the impacts of a log (`make_log`), and the states before and after each."""
        self.impacts += list_impacts(log, mass_matrix)
        for row in log:
            q, before, after = row[STATE:].reshape(3, -1).copy()
            self.add(float(row[TIME]), q, before)
            self.add(float(row[TIME]), q, after)


def list_impacts(log: Floats, mass_matrix: Floats) -> list[Impact]:
    """Returns the impacts of a log (`flights.make_log`), by a mass matrix M (nv, nv) [kg]."""
    if not len(log):
        return []
    velocities = log[:, STATE:].reshape(len(log), 3, -1)[:, 1:].transpose(1, 0, 2)
    energies = [np.einsum("bi,ij,bj->b", v, mass_matrix, v) / 2 for v in velocities]
    rows = np.column_stack([log[:, TIME], log[:, SPEED : PUSH + 1], *energies]).tolist()
    contacts = log[:, CONTACT].astype(int).tolist()
    return [Impact(row[0], i, *row[1:]) for i, row in zip(contacts, rows, strict=True)]


def find_impacts(times: Floats, velocities: Floats, count: int) -> Ints:
    """Returns the rows of a motion just before its impacts, shape (count,).

    Rows of equal time are before and after an impact, or at a knot where one was; there, velocities
    differ by rounding only. Those are taken which differ most.
    """
    at_once = np.flatnonzero(np.diff(times) == 0)
    jumps = np.linalg.norm(np.diff(velocities, axis=0)[at_once], axis=1)
    return np.sort(at_once[np.argsort(-jumps, kind="stable")[:count]])


def sample_steps(
    world: World, times: Floats, states: Floats, controls: Floats
) -> tuple[MotionSamples, Floats]:
    """Returns samples between the ends of steps, and the control at each.

    Args:
        world: of the motion.
        times: of the ends, shape (K,) [s].
        states: (q, v) there, shape (K, nx).
        controls: that led there, shape (K, nu) [N, N m].
    """
    if world.num_positions == world.num_velocities:
        held = controls[1:][np.diff(times) > 0]
        return sample_cubics(times, states), np.repeat(held, len(_NODES), axis=0)
    lasts = np.append(True, np.diff(times) > 0)
    (q, v), times = world.split(states[lasts]), times[lasts]
    rates = np.hstack([world.calc_position_rate(q, v), np.gradient(v, times, axis=0)])
    return sample_rates(times, states[lasts], rates, controls[lasts][1:])


def sample_rates(
    times: Floats, states: Floats, rates: Floats, controls: Floats
) -> tuple[MotionSamples, Floats]:
    """Returns samples along cubics of states, and the control at each.

    Args:
        times: of K states [s].
        states: (q, v), shape (K, nx).
        rates: of the same, shape (K, nx).
        controls: from each to the next, shape (K − 1, nu).
    """
    samples = sample_cubics(times, np.hstack([states, rates]))
    held = np.repeat(controls[np.diff(times) > 0], len(_NODES), axis=0)
    return samples._replace(states=samples.states[:, : states.shape[1]]), held


def sample_cubics(times: Floats, states: Floats) -> MotionSamples:
    """Returns samples along the cubics between rows of states (q, v), shape (K, 2 nv)."""
    lasts = np.flatnonzero(np.diff(times) > 0)
    steps = np.diff(times)[lasts, np.newaxis]
    s = ((_NODES + 1) / 2)[:, np.newaxis, np.newaxis]
    (q0, v0), (q1, v1) = (np.split(states[rows], 2, axis=1) for rows in (lasts, lasts + 1))
    chord = (q1 - q0) / steps
    bend, twist = 3 * chord - 2 * v0 - v1, v0 + v1 - 2 * chord
    q = q0 + s * steps * (v0 + s * (bend + s * twist))
    v = v0 + s * (2 * bend + 3 * s * twist)
    at = times[lasts, np.newaxis] + s[..., 0].T * steps
    weights = steps / 2 * _WEIGHTS
    rows = np.concatenate([q, v], axis=-1).transpose(1, 0, 2)
    return MotionSamples(at.ravel(), weights.ravel(), rows.reshape(-1, states.shape[1]))


def refuse_course(time: float, edges: Sequence[str] = ()) -> TrajectoryError:
    """Returns the error of a motion that can't be integrated beyond a time [s].

    Pairs that touch at the lowest point of an edge alone may be why.
    """
    why = (
        f" Of {', '.join(edges)}, only the lowest point touches, which jumps where a flat face "
        "lies on the ground: put spheres at its edge."
    )
    return TrajectoryError(
        "the motion under this control",
        got=f"one that runs away, or goes ever faster, at {time:g} s",
        expected="one that can be integrated until the end",
        remedy="Check the control's size." + why * bool(edges),
    )


# A goal is reached within this part of the longest way of its kind, and of 1 rad (2.9°): weights
# trade nearness for effort, so that plans end a little off. Where its velocity is weighed, the
# error of that is within this part of the largest speed: the motion has nearly stopped.
_NEAR, _SLOW = 0.05, 0.25


@dataclass(frozen=True)
class Arrival:
    """How near its goal a motion ends, in coordinates and velocities that the task weighs.

    Each is the norm of several; None where the task weighs none of the kind.

    Attributes:
        is_reached: whether positions are off by at most 5 % of the longest way of their kind, to
            go or gone, angles by at most 0.05 rad, and velocities by a quarter of the largest.
        distance: of lengths [m].
        angle: of angles [rad].
        speed: off the goal's velocity [m/s].
        turn_rate: likewise, of angles [rad/s].
        active_bounds: of a goal that is not reached: bounds of the model and the scenario that the
            motion touches, in words. If there are none, the weights hold it back.
    """

    is_reached: bool
    distance: float | None
    angle: float | None
    speed: float | None
    turn_rate: float | None
    active_bounds: tuple[str, ...]

    @classmethod
    def of(
        cls, world: World, scenario: Scenario, q: Floats, v: Floats, u: Floats | None = None
    ) -> Arrival:
        """Returns where a motion ends.

        Args:
            world: of the motion.
            scenario: has the goal.
            q: positions, the end the last, shape (K, nq).
            v: velocities, shape (K, nv).
            u: controls, shape (N, nu); None leaves out which bounds are active.
        """
        cost = TaskCost.of(world, scenario)
        weighs_end = np.any(cost.QTv, axis=0)
        if scenario.hard_goal and scenario.goal_velocity is not None:
            weighs_end = np.ones_like(weighs_end)
        errors = np.concatenate([cost.goal_errors(q[-1]), v[-1] - cost.goal_velocity])
        asked = np.concatenate([cost.is_asked, weighs_end])
        ways = np.abs(cost.subtract(q, q[-1:])).max(axis=0)
        ways = np.maximum(ways, np.abs(cost.subtract(q[0], cost.goal)))
        sizes = np.concatenate([_NEAR * ways, _SLOW * np.abs(v).max(axis=0)])
        n = world.num_velocities
        first, turns = np.arange(2 * n) < n, np.tile(world.turns, 2)
        kinds = (first & ~turns, first & turns, ~first & ~turns, ~first & turns)
        most = [float(np.max(sizes[kind], initial=0.0)) for kind in kinds]
        missed = [errors[kind & asked] for kind in kinds]
        for i, off in enumerate(() if cost.frames is None else cost.frames.asked(q)):
            way = np.maximum(np.abs(off - off[-1]).max(axis=0), np.abs(off[0]))
            most[i] = max(most[i], _NEAR * float(np.max(way, initial=0.0)))
            missed[i] = np.concatenate([missed[i], off[-1]])
        most[1] = min(most[1], _NEAR)
        is_reached = all(
            np.all(np.abs(off) <= size) for off, size in zip(missed, most, strict=True)
        )
        active: tuple[str, ...] = ()
        if u is not None and not is_reached and world.bounds(scenario).are_any:
            active = tuple(world.limits.active_items(world.plant, scenario, q, v, u))
        distance, angle, speed, turn_rate = (
            float(np.linalg.norm(off)) if off.size else None for off in missed
        )
        return cls(is_reached, distance, angle, speed, turn_rate, active)
