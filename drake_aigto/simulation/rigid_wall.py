"""Exactly rigid walls, as a hybrid system in Drake's Simulator."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pydrake.systems.analysis import ApplySimulatorConfig, Simulator, SimulatorConfig
from pydrake.systems.framework import (
    Context,
    ContinuousState,
    EventStatus,
    LeafSystem,
    State,
    WitnessFunction,
    WitnessFunctionDirection,
)

from drake_aigto.arrays import Floats
from drake_aigto.simulation import impacts
from drake_aigto.simulation.contact_motion import (
    Clearance,
    ContactMotion,
    Walls,
    calc_depth,
    calc_time_to_wall,
)
from drake_aigto.simulation.controller import Controller
from drake_aigto.simulation.impacts import HybridState, Rules
from drake_aigto.simulation.recording import Recording
from drake_aigto.world import World

# Times are parts of the simulated duration T.

# An impact is detected this long after it, and traced back exactly to the third order of this. Not
# at once, for Drake's Simulator ends the process ("t0 < ti && ti < tf") when a witness function
# crosses zero in the last bit of a step, and bounces do fall on knots. An odd number, so that
# nobody places a bounce just this long before a knot.
_LAG = 2.0347e-7
# Within this Drake isolates where a witness function crosses zero.
_WINDOW = 2e-7
# A ball inside the wall came in no longer ago than this, at whatever speed and push.
_LATEST = 2 * _LAG + 2 * _WINDOW
# What rises faster than this has turned round [m/s]. Not 0, which velocities do reach on knots.
_RISING = 1.7e-10
# Local error of an integration step.
_ACCURACY = 1e-10


class RigidWall(LeafSystem):
    """A world whose walls are exactly rigid and frictionless.

        flight    q̇ = v,  M v̇ + h(q, v) = B u                     while φ(q) > 0
        impact    v⁺ = v⁻ − (1 + e_i) M⁻¹ J_iᵀ (J_i M⁻¹ J_iᵀ)⁻¹ J_i v⁻    when φ_i = 0, J_i v⁻ < 0
        rest      M v̇ + h(q, v) = B u + J_Rᵀ λ,  0 ≤ λ ⊥ J_R v̇ ≥ 0      on the contacts R

    Impacts at the same time happen one after the other until none is approached (`impacts.run`). A
    contact that is rested on is one of them if another impact drives the ball into it.

    With e < 1 a constant push makes infinitely many impacts in finite time. So the n-th impact at
    a contact becomes rest if the hop after it would last less than τ = 1e-6 n T. Pressed by an
    acceleration a, that drops a speed of at most a τ/2 and a height of a τ²/8. An impact no faster
    than that speed is a touch, and not recorded. Bodies that collapse onto each other without a
    push stay together after a thousand impacts within a millionth of T.

    The state is (q, v); which contacts are rested on; how many impacts each had. Control is an
    input, which has to be constant while the Simulator advances. Call
    ``ExecuteForcedEvents(context)`` before it changes: an impact that is not detected yet then
    happens under the control that led to it.
    """

    def __init__(
        self,
        world: World,
        restitutions: Floats,
        duration: float,
        longest_step: float,
        recording: Recording,
    ) -> None:
        """Declares states, input and events.

        Args:
            world: its dynamics and its contacts.
            restitutions: e of each contact, in [0, 1], shape (m,).
            duration: T, how long will be simulated [s].
            longest_step: of the Simulator [s].
            recording: where impacts are noted, with the states before and after.
        """
        super().__init__()
        self._world = world
        self._nq = world.num_positions
        self._inertia = world.constant_inertia
        self._motion = ContactMotion(self._inertia)
        self._rules = Rules(restitutions, duration)
        self._log = impacts.make_log(impacts.MOST_IMPACTS, self._nq)
        self._recording = recording
        self._duration = duration
        self._longest_step = longest_step
        self.DeclareContinuousState(world.num_positions, world.num_velocities, 0)
        # Sets, as the bits of integers.
        self._rest = self.DeclareDiscreteState(1)
        self._rising = self.DeclareDiscreteState(1)
        self._counts = self.DeclareDiscreteState(world.num_contacts)
        self._control = self.DeclareVectorInputPort("control", world.num_actuators)
        # They have no event of their own: they end a step, and the next begins with an update.
        self._touched = self.MakeWitnessFunction(
            "has touched a wall",
            WitnessFunctionDirection.kPositiveThenNonPositive,
            self._calc_delayed_distance,
        )
        self._left = self._witness_growth(
            "may have touched a wall and left it", self._calc_departure
        )
        self._slid_off = self._witness_growth("has slid over an edge", self._calc_overhang)
        self.DeclarePerStepUnrestrictedUpdateEvent(self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def _witness_growth(self, description: str, calc: Any) -> WitnessFunction:
        direction = WitnessFunctionDirection.kNegativeThenNonNegative
        return self.MakeWitnessFunction(description, direction, calc)

    def DoGetWitnessFunctions(self, context: Context) -> list[WitnessFunction]:
        """Returns what ends a step: solids in flight, and edges of those that are rested on."""
        resting = self._get_resting(context)
        if not resting:
            return [self._touched, self._left]
        held = {self._motion.solid_of[i] for i in resting}
        found = [self._touched, self._left] if len(held) < len(self._motion.solids) else []
        if any(len(self._motion.solids[solid]) > 1 for solid in held):
            found.append(self._slid_off)
        return found

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Writes (q̇, v̇)."""
        x = _get_state(context)
        acceleration = self._calc_acceleration(context, x)
        acceleration = self._motion.calc_supported(acceleration, self._get_resting(context))
        rates = np.concatenate([x[self._nq :], acceleration])
        derivatives.get_mutable_vector().SetFromVector(rates)

    def _calc_acceleration(self, context: Context, x: Floats) -> Floats:
        """Returns v̇ without contact."""
        u = self._control.Eval(context)
        return self._world.calc_acceleration(x[: self._nq], x[self._nq :], u)

    def _get_resting(self, context: Context) -> set[int]:
        bits = self._get_set(context, self._rest)
        return {i for i in range(bits.bit_length()) if bits >> i & 1}

    def _get_set(self, context: Context, index: int) -> int:
        return int(context.get_discrete_state(index).GetAtIndex(0))

    def _calc_delayed_distance(self, context: Context) -> float:
        """Returns φ a lag ago if falling, φ if rising, of the nearest solid in flight."""
        distances, rates = self._motion.calc_distances(_get_state(context))
        lag, resting = _LAG * self._duration, self._get_resting(context)
        return min(
            max(distances[i] - lag * min(rates[i], 0.0) for i in faces)
            for faces in self._motion.solids
            if resting.isdisjoint(faces)
        )

    def _calc_departure(self, context: Context) -> float:
        """Returns 1 if the ball has turned round at a wall since the step began, else −1."""
        rising = self._find_rising(self._motion.calc_clearances(_get_state(context)))
        known = self._get_set(context, self._rising)
        return 1.0 if rising & ~known else -1.0

    def _find_rising(self, clearances: list[Clearance]) -> int:
        """Returns the solids that the ball rises from, and may have touched during a step.

        While φ̈ ≥ 0, φ was nowhere below what it is now less φ̇ times the step.
        """
        step = self._longest_step
        return sum(
            1 << solid
            for solid, near in enumerate(clearances)
            if near.rate > _RISING and near.distance <= step * near.rate
        )

    def _calc_overhang(self, context: Context) -> float:
        """Returns how far beyond an edge the ball, which rests on that solid, was a lag ago."""
        distances, rates = self._motion.calc_distances(_get_state(context))
        lag, resting = _LAG * self._duration, self._get_resting(context)
        return max(
            distances[i] - lag * max(rates[i], 0.0)
            for faces in self._motion.solids
            if len(faces) > 1 and not resting.isdisjoint(faces)
            for i in faces
            if i not in resting
        )

    def predict_impact(self, context: Context, horizon: float) -> float:
        """Returns how long until the next φ = 0 under the present φ̈ [s]; infinity if never.

        What is hardly within the horizon [s] is not looked at, and infinity.
        """
        x, resting = _get_state(context), self._get_resting(context)
        if not any(
            0 <= near.distance <= 2 * horizon * abs(near.rate)
            for near in self._motion.calc_clearances(x)
            if near.contact not in resting
        ):
            return math.inf
        free = self._calc_acceleration(context, x)
        phase = self._read(context, x, resting)
        acceleration = self._motion.calc_supported(free, resting)
        still = impacts.STILL * max(1.0, float(np.max(np.abs(phase.v))))
        return impacts.find_wait(self._motion.walls, phase, acceleration, still, horizon)

    def _read(self, context: Context, x: Floats, resting: set[int]) -> HybridState:
        """Returns the state as compiled code has it."""
        held = np.zeros(self._world.num_contacts, dtype=bool)
        held[list(resting)] = True
        counts = context.get_discrete_state(self._counts).get_value().copy()
        return HybridState(x[: self._nq].copy(), x[self._nq :].copy(), held, counts)

    def _update(self, context: Context, state: State) -> EventStatus:
        """Lets go of walls, or bounces off them, when it is time to."""
        x, resting = _get_state(context), self._get_resting(context)
        clearances = self._motion.calc_clearances(x)
        status = EventStatus.DidNothing()
        if resting or min(near.distance for near in clearances) <= 0:
            phase = self._read(context, x, resting)
            if self._advance(context, x, phase, clearances):
                self._write(state, phase)
                status = EventStatus.Succeeded()
                clearances = self._motion.calc_clearances(np.concatenate([phase.q, phase.v]))
        rising = self._find_rising(clearances)
        if rising != self._get_set(context, self._rising):
            state.get_mutable_discrete_state(self._rising).SetAtIndex(0, rising)
            status = EventStatus.Succeeded()
        return status

    def _advance(
        self, context: Context, x: Floats, phase: HybridState, clearances: list[Clearance]
    ) -> bool:
        """Returns whether something happened, after which the phase is another."""
        acceleration = self._calc_acceleration(context, x)
        before = phase.resting.copy()
        # Over an edge the ball is in front of another face.
        held = {near.contact for near in clearances}
        phase.resting[[i for i in range(len(before)) if i not in held]] = False
        supported = self._motion.calc_supported(acceleration, np.flatnonzero(phase.resting))
        pulled = impacts.PULLED * max(1.0, float(np.max(np.abs(acceleration))))
        phase.resting[np.array(self._motion.calc_pushes(supported)) > pulled] = False
        entered = [
            near
            for near in clearances
            if near.distance <= 0 and not np.any(phase.resting[[*self._beside(near)]])
        ]
        if np.array_equal(phase.resting, before) and not entered:
            return False
        self._bounce(context.get_time(), x, phase, acceleration, entered)
        return True

    def _beside(self, near: Clearance) -> tuple[int, ...]:
        return self._motion.faces_beside(near.contact)

    def _write(self, state: State, phase: HybridState) -> None:
        state.get_mutable_continuous_state().SetFromVector(np.concatenate([phase.q, phase.v]))
        bits = sum(1 << int(i) for i in np.flatnonzero(phase.resting))
        state.get_mutable_discrete_state(self._rest).SetAtIndex(0, bits)
        state.get_mutable_discrete_state(self._counts).SetFromVector(phase.counts)

    def _bounce(
        self,
        time: float,
        x: Floats,
        phase: HybridState,
        acceleration: Floats,
        entered: list[Clearance],
    ) -> None:
        """Replays what happened since the earliest of the touches that are not old."""
        walls = self._motion.walls
        supported = self._motion.calc_supported(acceleration, np.flatnonzero(phase.resting))
        touches = [self._trace_back(x, supported, near) for near in entered]
        # What is older starts at the wall and leaves it. Exactly at 0 its return would not be seen.
        fresh = [touch for touch in touches if touch[0] <= _LATEST * self._duration]
        if not fresh:
            impacts.settle(walls, phase.q, phase.v, phase.resting)
            return
        left, first = max(fresh, key=lambda touch: touch[0])
        rules, log = self._rules, self._log
        count = impacts.run_again(
            walls, rules, phase, supported, acceleration, time, left, first, log
        )
        self._recording.add_impacts(log[:count], self._inertia.mass_matrix)

    def _trace_back(
        self, x: Floats, acceleration: Floats, clearance: Clearance
    ) -> tuple[float, int]:
        """Returns how long ago the ball came in where its clearance is at most 0, and the face.

        It came in through the face that it was in front of last.
        """
        distances, rates = self._motion.calc_distances(x)
        pushes = self._motion.calc_pushes(acceleration)
        touches = []
        for i in self._beside(clearance):
            # Back in time, from inside, the wall is ahead: both signs turn.
            came_in = distances[i] < 0 or rates[i] < 0
            age = calc_time_to_wall(-distances[i], rates[i], -pushes[i]) if came_in else math.inf
            touches.append((age, i))
        return min(touches)


def simulate_rigid_wall(
    world: World, restitutions: Floats, state: tuple[Floats, Floats], controller: Controller
) -> Recording:
    """Runs a controller, of an open or a closed loop, against exactly rigid walls.

    Letters as in `RigidWall`; the start is (q, v).

    Returns:
        The states whenever the controller is asked, at the end, and before and after each impact.
    """
    duration = controller.end - controller.start
    recording = Recording()
    wall = RigidWall(world, restitutions, duration, controller.longest_hold, recording)
    simulator = Simulator(wall)
    varies = not world.has_constant_dynamics
    config = SimulatorConfig(
        # Second order is exact for constant acceleration; fifth takes few steps for any other.
        integration_scheme="runge_kutta5" if varies else "runge_kutta2",
        max_step_size=controller.longest_hold,
        accuracy=_ACCURACY,
        use_error_control=varies,
    )
    ApplySimulatorConfig(config, simulator)
    context = simulator.get_mutable_context()
    # Drake's isolation window is a hundredth of the context's accuracy, in seconds.
    context.SetAccuracy(100 * _WINDOW * duration)
    context.SetTime(controller.start)
    context.SetContinuousState(np.concatenate(state))
    recording.add(controller.start, *state)
    while (now := context.get_time()) < controller.end:
        held = controller.sample(now, _get_state(context), recording.bounces)
        recording.hold(now, held.control)
        wall.GetInputPort("control").FixValue(context, held.control)
        known = len(recording.impacts)
        while (now := context.get_time()) < held.until:
            stop = _plan_stop(now, wall.predict_impact(context, held.until - now), duration)
            simulator.AdvanceTo(min(stop, held.until))
            if controller.feels_contact and len(recording.impacts) > known:
                break
        wall.ExecuteForcedEvents(context, publish=False)
        recording.add(context.get_time(), *np.split(_get_state(context), 2))
    recording.max_penetration = calc_depth(Walls.of(world.constant_inertia), recording.positions)
    return recording


def _plan_stop(time: float, wait: float, duration: float) -> float:
    """Returns how far to advance at once: until just before a predicted impact, or else over it.

    Drake isolates an impact by halving the step that it is in. From far it would do so dozens of
    times; from here twice. Where the prediction is wrong it still does, so nothing is missed.
    """
    if wait > _WINDOW * duration:
        return time + wait - _WINDOW * duration / 2
    return time + _LATEST * duration


def _get_state(context: Context) -> Floats:
    """Returns (q, v)."""
    return context.get_continuous_state_vector().CopyToVector()
