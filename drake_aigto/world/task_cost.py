"""Cost of a motion: the one place where the task's formula is; and the units that a task has."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import ArrayRecord, Bools, Floats, LockedArrays, interpolate
from drake_aigto.dynamics import EquationsOfMotion
from drake_aigto.errors import ScenarioError
from drake_aigto.world.fields import check_size
from drake_aigto.world.frames import FrameGoals
from drake_aigto.world.places import RESTS
from drake_aigto.world.scenario import Scenario

_TURN = 2.0 * np.pi
# When a reference is looked at, over the duration.
_LOOKS = 21


@dataclass(frozen=True, eq=False)
class TaskCost(LockedArrays, ArrayRecord):
    """The cost of a scenario in its world, with every weight an array.

        J = ∫₀ᵀ [ uᵀ R u + e_qᵀ Q e_q + e_vᵀ Qv e_v ] dt + e_q(T)ᵀ QT e_q(T) + e_v(T)ᵀ QTv e_v(T)
            + costs of frames at T (`FrameGoals`)

    with e_q = q − q_ref(t) and e_v = v − v_ref(t) under the integral, and q − goal and
    v − goal_velocity at T. Of a hinge that `is_modulo`, e is taken to the nearest of e + 2πk; of
    one that `is_chordal`, 2 sin(e/2) counts in place of e, so that its square is 2 − 2 cos e.

    Shapes: n coordinates, nu actuators, K times of the reference. All arrays are read-only.

    Attributes:
        R: weight of the control, the diagonal, (nu,).
        Q: running weight of the position, the diagonal, (n,).
        Qv: running weight of the velocity, the diagonal, (n,).
        QT: weight of the final position, (n, n); zero where the goal is hard.
        QTv: weight of the final velocity, (n, n).
        goal: where q(T) should be, (n,).
        goal_velocity: what v(T) should be, (n,).
        is_modulo: whether turns of a coordinate do not count, (n,).
        is_chordal: whether the error of a coordinate is a chord, (n,).
        times: of the reference, (K,) [s]; before the first and after the last it stands still.
        positions: q_ref at these times, (K, n), piecewise linear between; the goal's if none.
        velocities: v_ref, (K, n); the goal's.
        subtract: of positions, the difference, (…, n).
        measure: the same, whose squares are weighed: of turns in space 2 sin(θ/2) about their axis.
        frames: goals of frames; None: there are none.
    """

    R: Floats
    Q: Floats
    Qv: Floats
    QT: Floats
    QTv: Floats
    goal: Floats
    goal_velocity: Floats
    is_modulo: Bools
    is_chordal: Bools
    times: Floats
    positions: Floats
    velocities: Floats
    subtract: Callable[[Any, Any], Floats] = np.subtract
    measure: Callable[[Any, Any], Floats] = np.subtract
    frames: FrameGoals | None = None

    @classmethod
    def of(cls, world: EquationsOfMotion, scenario: Scenario) -> TaskCost:
        """Returns the cost of a scenario.

        Raises:
            ScenarioError: a weight or a reference does not fit the model's coordinates, one weight
                is given for coordinates of different units, or angles can't be compared as asked.
        """
        n, is_hinge = world.num_velocities, world.turns
        pushes = np.any(world.actuation[~is_hinge] != 0, axis=0)  # Of u: a force, no torque.
        given = ("goal_velocity", "reference_positions", "reference_velocities")
        for name in (name for name in given if getattr(scenario, name) is not None):
            size = world.num_positions if name == "reference_positions" else n
            check_size(name, getattr(scenario, name), size)
        # Where none is given, the goal's velocity is zero, and the reference the goal.
        times = np.zeros(1) if scenario.reference_times is None else scenario.reference_times
        goal, speed = scenario.goal_position, scenario.goal_velocity
        speed = np.zeros(n) if speed is None else speed
        about = np.zeros(n) if scenario.periodic is not None else speed
        places, speeds = scenario.reference_positions, scenario.reference_velocities
        final = np.zeros((n, n))
        if not scenario.hard_goal:
            final = _weigh(scenario, "goal_weight", is_hinge)
        elif scenario.frame_goals:
            got = f"a hard goal, and goals of {', '.join(scenario.frame_goals)}"
            raise ScenarioError("frame_goals", got, "no hard_goal, as these are costs")
        if scenario.angles != "exact":
            _check_angles(scenario.angles, final, is_hinge)
        return cls(
            R=_weigh(scenario, "control_weight", ~pushes).diagonal(),
            Q=_weigh(scenario, "position_weight", is_hinge).diagonal(),
            Qv=_weigh(scenario, "velocity_weight", is_hinge).diagonal(),
            QT=final,
            QTv=_weigh(scenario, "goal_velocity_weight", is_hinge),
            goal=goal,
            goal_velocity=speed,
            is_modulo=is_hinge & (scenario.angles == "modulo"),
            is_chordal=is_hinge & (scenario.angles == "chordal"),
            times=times,
            positions=np.tile(goal, (len(times), 1)) if places is None else places,
            velocities=np.tile(about, (len(times), 1)) if speeds is None else speeds,
            subtract=world.subtract if world.num_positions != n else np.subtract,
            measure=world.measure if world.num_positions != n else np.subtract,
            frames=world.find_frames(scenario.frame_goals),
        )

    def running(self, t: ArrayLike, q: ArrayLike, v: ArrayLike, u: ArrayLike) -> Floats:
        """Returns what is integrated, of times (…), states (…, n) each, and controls (…, nu)."""
        about_q, about_v = self.reference(t)
        e_q, e_v = self.position_error(q, about_q), np.asarray(v) - about_v
        return np.asarray(u) ** 2 @ self.R + e_q**2 @ self.Q + e_v**2 @ self.Qv

    def effort(self, times: Floats, controls: Floats) -> float:
        """Returns ∫ uᵀ R u dt of controls (N, nu) that are held between times (N+1,)."""
        return float(np.diff(times) @ (controls**2 @ self.R))

    def final(self, q: ArrayLike, v: ArrayLike) -> Floats:
        """Returns what the end costs, of states (…, n)."""
        e_q, e_v = self.position_error(q, self.goal), np.asarray(v) - self.goal_velocity
        of_frames = 0.0 if self.frames is None else self.frames.cost(np.asarray(q))
        return _square(e_q, self.QT) + _square(e_v, self.QTv) + of_frames

    def reference(self, t: ArrayLike) -> tuple[Floats, Floats]:
        """Returns q_ref and v_ref at times (…), (…, n) each."""
        tables = self.positions, self.velocities
        positions, velocities = (interpolate(t, self.times, table) for table in tables)
        return positions, velocities

    def position_error(self, q: ArrayLike, about: ArrayLike) -> Floats:
        """Returns e_q, whose square is weighed, of positions about others, (…, n)."""
        error = take_nearest_turn(self.measure(q, about), self.is_modulo)
        return np.where(self.is_chordal, 2.0 * np.sin(error / 2.0), error)

    def hard_goal(self, scenario: Scenario) -> Floats:
        """Returns q and v that a scenario prescribes at T, one after the other; NaN where free."""
        is_hard = scenario.hard_goal, scenario.hard_goal and scenario.goal_velocity is not None
        ends = zip(is_hard, (self.goal, self.goal_velocity), strict=True)
        return np.concatenate([np.where(hard, end, np.nan) for hard, end in ends])

    def goal_errors(self, q: ArrayLike) -> Floats:
        """Returns how far positions are from the goal, signed, (…, n) [m, rad].

        Turns count where the scenario's angles are exact; chords are measured along the arc.
        """
        return take_nearest_turn(self.subtract(q, self.goal), self.is_modulo | self.is_chordal)

    @property
    def is_asked(self) -> Bools:
        """Of which coordinates it matters where they end, shape (n,).

        Those that the goal weighs; all if it weighs none and no frame, as a hard goal does.
        """
        is_weighed = np.any(self.QT, axis=0)
        return np.asarray(is_weighed | (not is_weighed.any() and self.frames is None))

    def goal_error(self, q: ArrayLike) -> Floats:
        """Returns the norm of `goal_errors`, of coordinates and frames whose end matters, (…)."""
        errors = self.goal_errors(q)[..., self.is_asked]
        of_frames = () if self.frames is None else self.frames.asked(np.asarray(q))
        return np.linalg.norm(np.concatenate([errors, *of_frames], axis=-1), axis=-1)


def take_nearest_turn(error: Floats, does_turn: Bools) -> Floats:
    """Returns errors, those that turn to the nearest to zero of e + 2πk."""
    return np.where(does_turn, error - _TURN * np.round(error / _TURN), error)


def _square(error: Floats, weights: Floats) -> Floats:
    """Returns eᵀ W e, (…)."""
    return np.einsum("...i,ij,...j", error, weights, error)


def _weigh(scenario: Scenario, name: str, is_angle: Bools) -> Floats:
    """Returns a weight as a matrix, of coordinates some of which are angles."""
    weight, n = getattr(scenario, name), len(is_angle)
    if isinstance(weight, float):
        if weight > 0 and len(set(is_angle.tolist())) > 1:
            raise ScenarioError(
                name,
                got=f"one number, {weight:g}, for sliders and hinges alike",
                expected=f"{n} numbers, as their units differ",
                remedy=f"Or weigh by names: {name}: {{a_joint: 1}}." if name in RESTS else None,
            )
        return weight * np.eye(n)
    check_size(name, weight, n)
    return np.diag(weight) if weight.ndim == 1 else weight


def _check_angles(angles: str, final: Floats, is_hinge: Bools) -> None:
    """Refuses angles that are compared in a way that has no meaning here."""
    if not np.any(is_hinge):
        raise ScenarioError(
            "angles",
            got=repr(angles),
            expected="'exact', as no coordinate of the model is an angle",
        )
    coupling = final - np.diag(final.diagonal())
    if angles == "chordal" and np.any(coupling[is_hinge]):
        raise ScenarioError(
            "goal_weight",
            got=f"{final.tolist()} with angles: chordal",
            expected="nothing off the diagonal for angles",
            remedy="A chord changes its sign with each turn: drop these, or take angles: modulo.",
        )


@dataclass(frozen=True)
class Scales:
    """Units in which tolerances are given, so that a verdict is the same at every size.

    Angles count as lengths, at 1 m from the hinge.

    Attributes:
        length: L, the longest of the ways to the goal and, from both ends, to the walls; 1 m if
            there is no way to go [m].
        time: T, the duration [s].
        cost: w_f L², what it costs to end L off the goal, and of a task with other terms, what it
            costs to stay at the start. If that is nothing, w_u T (m L/T²)², with m the `inertia`.
    """

    length: float
    time: float
    cost: float

    @classmethod
    def of(cls, world: EquationsOfMotion, scenario: Scenario) -> Scales:
        """Returns the scales of a scenario in its world."""
        return scenario.derive(world, cls._measure)

    @classmethod
    def _measure(cls, world: EquationsOfMotion, scenario: Scenario) -> Scales:
        q0, goal, T = scenario.initial_position, scenario.goal_position, scenario.duration
        # A slider askew to the wall has to go farther than φ; of a hinge no such factor is the same
        # all the way.
        jacobian = world.calc_contact_jacobian(q0)
        steepness = 1.0 if world.is_hinge.any() else np.linalg.norm(jacobian, axis=1)
        ways = world.calc_signed_distance(np.array([q0, goal])) / steepness
        way = world.subtract(goal, q0)
        length = float(max(np.max(np.abs(way)), np.max(ways, initial=0.0))) or 1.0
        push = calc_inertia(world, q0) * length / T**2
        effort = float(np.max(scenario.control_weight)) * T * push**2
        if scenario.is_plain:
            return cls(length, T, scenario.goal_weight * length**2 or effort)
        cost = TaskCost.of(world, scenario)
        state = scenario.initial_position, scenario.initial_velocity
        times, no_control = np.linspace(0.0, T, _LOOKS), np.zeros(world.num_actuators)
        staying = T * np.mean(cost.running(times, *state, no_control)) + cost.final(*state)
        return cls(length, T, float(staying) or effort)

    @property
    def velocity(self) -> float:
        """L/T [m/s]."""
        return self.length / self.time


def calc_inertia(world: EquationsOfMotion, q: Floats) -> float:
    """Returns the largest entry of B⁺ M(q): control per acceleration [kg]."""
    return float(np.abs(world.inverse_actuation @ world.calc_mass_matrix(q)).max())
