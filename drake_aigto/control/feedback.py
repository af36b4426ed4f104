"""Feedback about a plan: by flights between bounces, or by knots where walls yield."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.controllers import (
    FiniteHorizonLinearQuadraticRegulator,
    FiniteHorizonLinearQuadraticRegulatorOptions,
)
from pydrake.systems.primitives import SymbolicVectorSystem
from pydrake.trajectories import Trajectory as DrakeTrajectory

from drake_aigto.arrays import Floats
from drake_aigto.control.flights import Bounce, Flight, split_flights
from drake_aigto.errors import TrajectoryError
from drake_aigto.planning import MechanismTask, PlanOptions
from drake_aigto.simulation import DRAKE, EVENT_DRIVEN, Controller, Held, Judge, Replay, summarize
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

# Of the Riccati equation: gains are right to 5e-6 of the largest.
_ACCURACY = 1e-7
# The least eigenvalue of a final cost, as a part of the largest.
_LEAST = 1e-13
# Samples that come sooner than this part of the duration after one are left out.
_SHORTEST_HOLD = 1e-6
# Runge-Kutta steps between knots, and how far from walls gains know of them, in parts of the task's
# length: what is a little off its plan may meet a wall where the plan does not.
_SUBSTEPS, _SMOOTHING = 8, 1e-3
# Who refuses tasks of other costs, as errors name it.
_READER = "Feedback"


class Feedback(Controller):
    """Feedback about a plan, that knows which state is planned."""

    @abstractmethod
    def find_state(self, time: float, bounces: Sequence[int]) -> Floats:
        """Returns the state that is planned for a time after such bounces, (q, v), shape (2n,)."""


class FlightFeedback(Feedback):
    """Tracks a plan on each of its flights, and goes on to the next when the bounce happens.

    On flight i, from one bounce of the plan to the next at τ_i, the deviation x̃ = x − x_i(t) from
    the plan is steered by the least of the scenario's own cost, to second order:

        ũ = −K_i(t) x̃,    S_i(τ_i) = Ξ_iᵀ S_{i+1}(τ_i) Ξ_i,    S_n(T) = goal_weight diag(I, 0)

    where S_i solves the Riccati equation with Q = 0 and R = control_weight I (Drake's
    FiniteHorizonLinearQuadraticRegulator), and Ξ_i is the saltation matrix: how a deviation before
    a bounce becomes one after it, as that comes sooner or later (`Bounce.saltation`).

    The next flight begins when the ball bounces, not when the plan's clock says so. For that every
    flight of the plan goes on beyond its ends under its first and its last control, behind the wall
    too: a ball that bounces early meets what the next flight was before its beginning, and one that
    is late goes on with the last one, with its last gain. Which flight it is, is told by the number
    of bounces at each wall: bounces that the plan lacks change nothing.

    The control is held between samples: at the plan's knots, and as soon as a bounce is over.

    Attributes:
        flights: those of the plan.
        bounces: of the plan, one fewer.
    """

    feels_contact = True

    def __init__(self, world: World, scenario: Scenario, trajectory: Trajectory) -> None:
        """Solves the Riccati equations.

        Raises:
            ScenarioError: the task asks for more than AIGTO's (`Scenario.is_plain`).
            TrajectoryError: it does not fit the world; or it has contacts that last, several at
                once, at the start, or that only graze the wall: no feedback is known there.
        """
        scenario.check_plain(_READER)
        self.flights, self.bounces = split_flights(world, scenario, trajectory)
        self.start, self.end = float(trajectory.times[0]), float(trajectory.times[-1])
        self.longest_hold = float(np.max(np.diff(trajectory.times)))
        self._gains = _calc_gains(world, scenario, self.flights, self.bounces)

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns u_i(t) − K_i(t) (x − x_i(t)) − k_i(t)."""
        i = self._find_flight(bounces)
        flight, gain = self.flights[i], self._gains[i]
        feedback = gain.feedback.value(min(time, flight.end)) @ (x - flight.calc_state(time))
        offset = gain.offset.value(min(time, flight.end))[:, 0]
        until = flight.find_next_sample(time + _SHORTEST_HOLD * (self.end - self.start))
        return Held(flight.calc_control(time) - feedback - offset, until)

    def find_state(self, time: float, bounces: Sequence[int]) -> Floats:
        """Returns where the flight is, or would be without the wall, that the ball is on."""
        return self.flights[self._find_flight(bounces)].calc_state(time)

    def _find_flight(self, bounces: Sequence[int]) -> int:
        """Returns on which flight of the plan the ball is: all bounces before it have happened."""
        left = list(bounces)
        for i, planned in enumerate(self.bounces):
            if planned.contact not in left:
                return i
            left.remove(planned.contact)
        return len(self.bounces)


class KnotFeedback(Feedback):
    """Tracks a plan of a mechanism between walls that yield, or of one that touches nothing.

    Between knots t_k and t_{k+1} it holds

        u = u_k + K_k (x − x(t)),

    cut to the bounds of the control, with the gains K_k of the descent that found the plan
    (`ShootingProblem.calc_gains`): the best answer of held controls to a deviation, to second
    order, contact with the law of the model included. Beyond the plan's end u_{N−1}, K_{N−1} and
    x(T) stay.

    Attributes:
        trajectory: the plan.
    """

    feels_contact = False

    def __init__(self, world: World, scenario: Scenario, trajectory: Trajectory) -> None:
        """Computes the gains.

        Raises:
            TrajectoryError: it touches rigid walls, whose impacts `PhaseFeedback` knows; or it does
                not fit the world.
        """
        _check_knots(world, scenario, trajectory)
        self.trajectory = trajectory
        self.start, self.end = float(trajectory.times[0]), float(trajectory.times[-1])
        self.longest_hold = float(np.max(np.diff(trajectory.times)))
        self._states, _ = trajectory.to_piecewise()
        self._bounds = world.bounds(scenario).control
        self._norm = scenario.control_norm or np.inf
        self._gains = _calc_knot_gains(world, scenario, trajectory)

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns u_k + K_k (x − x(t)), within bounds."""
        times = self.trajectory.times
        k = int(np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(self._gains) - 1))
        u = self.trajectory.controls[k] + self._gains[k] @ (x - self.find_state(time, bounces))
        size = float(np.linalg.norm(u := np.clip(u, *self._bounds)))
        return Held(u * min(1.0, self._norm / size) if size else u, float(times[k + 1]))

    def find_state(self, time: float, bounces: Sequence[int]) -> Floats:
        """Returns x(t), at the end after it."""
        return self._states.value(min(time, self.end))[:, 0]


def _calc_knot_gains(world: World, scenario: Scenario, trajectory: Trajectory) -> Floats:
    """Returns K_k, shape (N, nu, 2n)."""
    times = trajectory.times
    task = MechanismTask(world, scenario, PlanOptions()).shooting(len(times) - 1)
    problem = replace(task, times=times, phases=None)
    return problem.calc_gains(trajectory.controls, _SUBSTEPS, _SMOOTHING)


def _check_knots(world: World, scenario: Scenario, trajectory: Trajectory) -> None:
    """Refuses what gains at knots do not know."""
    got = trajectory.positions.shape[1], trajectory.controls.shape[1]
    if got != (sizes := (world.num_positions, world.num_actuators)):
        raise TrajectoryError(
            "the trajectory",
            got="{} positions, {} controls".format(*got),
            expected="the world's, {} and {}".format(*sizes),
        )
    touches = np.flatnonzero(trajectory.impulses.any(axis=1))
    if scenario.contact == "rigid" and touches.size:
        raise TrajectoryError(
            "contacts of a plan to track",
            got=f"a mechanism that hits a rigid wall at {trajectory.times[touches[0]]:.3f} s",
            expected="walls that yield, or no touch",
            remedy="Take PhaseFeedback.",
        )


class _Gain(NamedTuple):
    """ũ = −K x̃ − k over a flight and all of the time before it."""

    feedback: DrakeTrajectory  # K(t), shape (nu, nx)
    offset: DrakeTrajectory  # k(t), shape (nu, 1) [N]; zero but for the plan's integration error


def _calc_gains(
    world: World, scenario: Scenario, flights: Sequence[Flight], bounces: Sequence[Bounce]
) -> list[_Gain]:
    """Returns the gain of each flight, computed from the last to the first."""
    n = world.num_positions
    system = _make_flight_system(world)
    context = system.CreateDefaultContext()
    R = scenario.control_weight * np.eye(world.num_actuators)
    options = FiniteHorizonLinearQuadraticRegulatorOptions()
    options.simulator_config.accuracy = _ACCURACY
    S = scenario.goal_weight * np.diag(np.repeat([1.0, 0.0], n))
    gains: list[_Gain] = []
    for flight, bounce in zip(reversed(flights), [None, *reversed(bounces)], strict=True):
        if bounce is not None:
            S = bounce.saltation.T @ S @ bounce.saltation
        options.Qf = _make_positive(S)
        options.x0, options.u0 = flight.state, flight.control
        Q = np.zeros((2 * n, 2 * n))
        result = FiniteHorizonLinearQuadraticRegulator(
            system, context, flights[0].start, flight.end, Q, R, options
        )
        gains.append(_Gain(result.K, result.k0))
        S = result.S.value(flight.start)
    return gains[::-1]


def _make_positive(S: Floats) -> Floats:
    """Returns the nearest final cost that Drake takes: integration may leave eigenvalues below 0.

    A cost of nothing but the goal is singular, and stays so on its way back in time.
    """
    values, vectors = np.linalg.eigh((S + S.T) / 2)
    positive = vectors * np.maximum(values, _LEAST * values[-1]) @ vectors.T
    return (positive + positive.T) / 2


def _make_flight_system(world: World) -> Any:
    """Returns q̇ = v, M v̇ = B u − h(q, v) as a system of Drake's."""
    # NumPy takes Drake's boxed constants for invalid numbers, and warns.
    with np.errstate(invalid="ignore"):
        force = world.actuation @ world.controls - world.bias
        acceleration = world.constant_inertia.inverse_mass @ force
    return SymbolicVectorSystem(
        state=np.concatenate([world.positions, world.velocities]),
        input=world.controls,
        dynamics=np.concatenate([world.velocities, acceleration]),
        output=world.positions,
    )


@dataclass(frozen=True)
class Tracked:
    """A motion under feedback.

    Attributes:
        replay: what happened; its cost is that of the control that was applied.
        times: from when each control was held, and the end, shape (K+1,) [s].
        controls: shape (K, nu) [N].
    """

    replay: Replay
    times: Floats
    controls: Floats


def track_event_driven(world: World, scenario: Scenario, controller: Controller) -> Tracked:
    """Runs a controller on exactly rigid walls (`RigidMotion` has their equations).

    World, start, goal, weights and restitution may be others than those of the plan.

    Raises:
        ScenarioError: the task asks for more than AIGTO's (`Scenario.is_plain`).
        ModelError: there is friction.
    """
    return _track(EVENT_DRIVEN, world, scenario, controller)


def track_drake(world: World, scenario: Scenario, controller: Controller) -> Tracked:
    """Runs a controller on the world's own continuous plant in Drake, as `replay_drake` does.

    World, start, goal, weights and restitution may be others than those of the plan.

    Raises:
        ScenarioError: the task asks for more than AIGTO's (`Scenario.is_plain`).
        ModelError: a shape of the contact has no stiffness, or there is friction.
    """
    return _track(DRAKE, world, scenario, controller)


def _track(judge: Judge, world: World, scenario: Scenario, controller: Controller) -> Tracked:
    """Returns the motion that a judge simulates."""
    scenario.check_plain(_READER)
    world.check_frictionless(scenario)
    recording = judge.simulate(world, scenario, controller)
    replay = summarize(world, scenario, recording, controller.end)
    times = np.append(recording.control_times, controller.end)
    return Tracked(replay, times, np.array(recording.controls))
