"""An exactly rigid wall, as a hybrid system in Drake's Simulator."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

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

from drake_aigto.planning.contact_motion import ContactMotion, calc_time_to_wall
from drake_aigto.planning.recording import Impact, Recording

if TYPE_CHECKING:
    import numpy.typing as npt

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
# The n-th impact becomes rest if the hop after it would last less than n times this, which is more
# than _LATEST. No more than √(2 / _HOP) ≈ 1,400 hops fit into T then: no Zeno sequence can hang.
_HOP = 1e-6
# Impact and rest leave this much air, relative to the largest position or 1 m, so that rounding
# does not put the ball inside.
_AIR = 1e-14
# What rises faster than this has turned round [m/s]. Not 0, which velocities do reach on knots.
_RISING = 1.7e-10
# Local error of an integration step.
_ACCURACY = 1e-10


class _Touch(NamedTuple):
    """An impact, traced back from a state soon after it."""

    age: float  # how long ago [s]
    speed: float  # of approach, −φ̇ [m/s]
    push: float  # φ̈ without contact [m/s²]
    acceleration: npt.NDArray[np.float64]  # v̇ without contact [m/s²]


class RigidWall(LeafSystem):
    """A world whose wall is exactly rigid and frictionless.

        flight    q̇ = v,  M v̇ + h(q, v) = B u                     while φ(q) > 0
        impact    v⁺ = v⁻ − (1 + e) M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹ J v⁻      when φ = 0, J v⁻ < 0
        rest      M v̇ + h(q, v) = B u + Jᵀ λ,  φ̈ = 0              while λ ≥ 0

    With e < 1 a constant push makes infinitely many impacts in finite time. So the n-th impact
    becomes rest if the hop after it would last less than τ = 1e-6 n T. Pressed by an acceleration
    a, that drops a speed of at most a τ/2 and a height of a τ²/8. An impact no faster than that
    speed is a touch, and not recorded.

    The state is (q, v); whether the ball rests; how many impacts there were. Control is an input,
    which has to be constant while the Simulator advances. Call ``ExecuteForcedEvents(context)``
    before it changes: an impact that is not detected yet then happens under the control that led
    to it.
    """

    def __init__(
        self,
        world: World,
        restitution: float,
        duration: float,
        longest_step: float,
        recording: Recording,
    ) -> None:
        """Declares states, input and events.

        Args:
            world: its dynamics and its contact.
            restitution: e in [0, 1].
            duration: T, how long will be simulated [s].
            longest_step: the longest that the Simulator will take [s].
            recording: where impacts are noted, with the states before and after.
        """
        super().__init__()
        self._world = world
        self._nq = world.num_positions
        self._contact = ContactMotion(world)
        self._restitution = restitution
        self._duration = duration
        self._longest_step = longest_step
        self._recording = recording
        self.DeclareContinuousState(world.num_positions, world.num_velocities, 0)
        self._rest = self.DeclareDiscreteState(1)
        self._count = self.DeclareDiscreteState(1)
        self._control = self.DeclareVectorInputPort("control", world.num_actuators)
        # They have no event of their own: they end a step, and the next begins with an update.
        self._witnesses = [
            self.MakeWitnessFunction(
                "has touched the wall",
                WitnessFunctionDirection.kPositiveThenNonPositive,
                self._calc_delayed_distance,
            ),
            self.MakeWitnessFunction(
                "may have touched the wall and left it",
                WitnessFunctionDirection.kNegativeThenNonNegative,
                self._calc_departure,
            ),
        ]
        self.DeclarePerStepUnrestrictedUpdateEvent(self._update)
        self.DeclareForcedUnrestrictedUpdateEvent(self._update)

    def DoGetWitnessFunctions(self, context: Context) -> list[WitnessFunction]:
        """Returns what ends a step: in flight the wall, at rest nothing."""
        return [] if self._is_at_rest(context) else self._witnesses

    def DoCalcTimeDerivatives(self, context: Context, derivatives: ContinuousState) -> None:
        """Writes (q̇, v̇)."""
        x = _get_state(context)
        acceleration = self._calc_acceleration(context, x)
        if self._is_at_rest(context):
            push = min(self._contact.calc_push(x, acceleration), 0.0)
            acceleration = acceleration - push * self._contact.calc_lift(x[: self._nq])
        rates = np.concatenate([x[self._nq :], acceleration])
        derivatives.get_mutable_vector().SetFromVector(rates)

    def _calc_acceleration(
        self, context: Context, x: npt.NDArray[np.float64]
    ) -> npt.NDArray[np.float64]:
        """Returns v̇ without contact."""
        u = self._control.Eval(context)
        return self._world.calc_acceleration(x[: self._nq], x[self._nq :], u)

    def _is_at_rest(self, context: Context) -> bool:
        return bool(context.get_discrete_state(self._rest).GetAtIndex(0))

    def _calc_delayed_distance(self, context: Context) -> float:
        """Returns φ a lag ago if falling, φ if rising."""
        distance, rate = self._contact.calc_distance(_get_state(context))
        return distance - _LAG * self._duration * min(rate, 0.0)

    def _calc_departure(self, context: Context) -> float:
        """Returns 1 if the ball rises and may have touched during the last step, else −1.

        While φ̈ ≥ 0, φ was nowhere below what it is now less φ̇ times the step.
        """
        distance, rate = self._contact.calc_distance(_get_state(context))
        return 1.0 if rate > _RISING and distance <= self._longest_step * rate else -1.0

    def predict_impact(self, context: Context, horizon: float) -> float:
        """Returns how long until φ = 0 under the present φ̈ [s]; infinity if never, or at rest.

        Args:
            context: the present state.
            horizon: what is hardly within this is not looked at, and infinity [s].
        """
        x = _get_state(context)
        distance, rate = self._contact.calc_distance(x)
        if self._is_at_rest(context) or not 0 <= distance <= 2 * horizon * abs(rate):
            return math.inf
        push = self._contact.calc_push(x, self._calc_acceleration(context, x))
        return calc_time_to_wall(distance, rate, push)

    def _update(self, context: Context, state: State) -> EventStatus:
        """Lets go of the wall, or bounces off it, when it is time to."""
        x = _get_state(context)
        if self._is_at_rest(context):
            if self._contact.calc_push(x, self._calc_acceleration(context, x)) <= 0:
                return EventStatus.DidNothing()
            state.get_mutable_discrete_state(self._rest).SetAtIndex(0, 0.0)
            return EventStatus.Succeeded()
        if self._contact.calc_distance(x)[0] > 0:
            return EventStatus.DidNothing()
        touch = self._trace_back(x, self._calc_acceleration(context, x))
        if touch.age > _LATEST * self._duration:
            # It starts at the wall and leaves it. Exactly at 0 its return would not be seen.
            self._set_motion(state, x, rise=self._calc_air(x), jump=0.0)
        else:
            self._bounce(context, x, touch, state)
        return EventStatus.Succeeded()

    def _trace_back(
        self, x: npt.NDArray[np.float64], acceleration: npt.NDArray[np.float64]
    ) -> _Touch:
        """Returns when and how fast the ball came in, for a constant φ̈ and φ ≤ 0."""
        distance, rate = self._contact.calc_distance(x)
        push = self._contact.calc_push(x, acceleration)
        speed = math.sqrt(max(rate**2 - 2 * push * distance, 0.0))
        # Back in time, from inside, the wall is ahead: both signs turn.
        came_in = distance < 0 or rate < 0
        age = calc_time_to_wall(-distance, rate, -push) if came_in else math.inf
        return _Touch(age, speed, push, acceleration)

    def _bounce(
        self, context: Context, x: npt.NDArray[np.float64], touch: _Touch, state: State
    ) -> None:
        """Writes the state as it is since an impact, or comes to rest."""
        q, v = np.split(x, 2)
        distance, rate = self._contact.calc_distance(x)
        count = context.get_discrete_state(self._count).GetAtIndex(0) + 1
        shortest_hop = _HOP * self._duration * count
        jump = (1 + self._restitution) * touch.speed
        if 2 * touch.speed > shortest_hop * abs(touch.push):
            self._record(context.get_time(), q, v, touch, jump)
        rests = 2 * self._restitution * touch.speed <= -shortest_hop * touch.push
        if rests:
            jump, rise = -rate, self._calc_air(x) - distance
        else:
            rise = max(jump * touch.age, self._calc_air(x) - distance)
        self._set_motion(state, x, rise, jump)
        state.get_mutable_discrete_state(self._rest).SetAtIndex(0, float(rests))
        state.get_mutable_discrete_state(self._count).SetAtIndex(0, count)

    def _calc_air(self, x: npt.NDArray[np.float64]) -> float:
        """Returns the least distance that is surely positive [m]."""
        return _AIR * max(1.0, float(np.max(np.abs(x[: self._nq]))))

    def _set_motion(
        self, state: State, x: npt.NDArray[np.float64], rise: float, jump: float
    ) -> None:
        """Writes (q, v) with φ more by `rise` and φ̇ more by `jump` than in x."""
        lift = self._contact.calc_lift(x[: self._nq])
        changed = x + np.concatenate([rise * lift, jump * lift])
        state.get_mutable_continuous_state().SetFromVector(changed)

    def _record(
        self,
        time: float,
        q: npt.NDArray[np.float64],
        v: npt.NDArray[np.float64],
        touch: _Touch,
        jump: float,
    ) -> None:
        """Notes an impact, and the states before and after it."""
        before = v - touch.age * touch.acceleration
        after = before + jump * self._contact.calc_lift(q)
        q = q - touch.age * (v + before) / 2
        for velocity in (before, after):
            self._recording.add(time - touch.age, q, velocity)
        energies = (self._contact.calc_kinetic_energy(velocity) for velocity in (before, after))
        self._recording.impacts.append(Impact(time - touch.age, touch.speed, touch.push, *energies))


def simulate_rigid_wall(
    world: World,
    restitution: float,
    state: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]],
    times: npt.NDArray[np.float64],
    controls: npt.NDArray[np.float64],
) -> Recording:
    """Runs a held control against an exactly rigid wall.

    Args:
        world: its dynamics and its contact.
        restitution: e in [0, 1].
        state: the start, (q, v).
        times: of the knots, shape (N+1,) [s].
        controls: held between them, shape (N, nu).

    Returns:
        The states at all knots, and before and after each impact.
    """
    longest_step = float(np.max(np.diff(times)))
    duration = float(times[-1] - times[0])
    recording = Recording()
    wall = RigidWall(world, restitution, duration, longest_step, recording)
    simulator = Simulator(wall)
    config = SimulatorConfig(
        # Third order is exact for constant acceleration; fifth takes fewer steps for any other.
        integration_scheme="runge_kutta3" if _is_constant(world.bias) else "runge_kutta5",
        max_step_size=longest_step,
        accuracy=_ACCURACY,
        use_error_control=True,
    )
    ApplySimulatorConfig(config, simulator)
    context = simulator.get_mutable_context()
    # Drake's isolation window is a hundredth of the context's accuracy, in seconds.
    context.SetAccuracy(100 * _WINDOW * duration)
    context.SetTime(times[0])
    context.SetContinuousState(np.concatenate(state))
    recording.add(float(times[0]), *state)
    for time, control in zip(times[1:].tolist(), controls, strict=True):
        wall.GetInputPort("control").FixValue(context, control)
        while (now := context.get_time()) < time:
            stop = _plan_stop(now, wall.predict_impact(context, time - now), duration)
            simulator.AdvanceTo(min(stop, time))
        wall.ExecuteForcedEvents(context, publish=False)
        recording.add(time, *np.split(_get_state(context), 2))
    distances = [world.calc_signed_distance(q) for q in recording.positions]
    recording.max_penetration = max(0.0, -float(np.min(distances)))
    return recording


def _plan_stop(time: float, wait: float, duration: float) -> float:
    """Returns how far to advance at once: until just before a predicted impact, or else over it.

    Drake isolates an impact by halving the step that it is in. From far it would do so dozens of
    times; from here twice. Where the prediction is wrong it still does, so nothing is missed.
    """
    if wait > _WINDOW * duration:
        return time + wait - _WINDOW * duration / 2
    return time + _LATEST * duration


def _get_state(context: Context) -> npt.NDArray[np.float64]:
    """Returns (q, v)."""
    return context.get_continuous_state_vector().CopyToVector()


def _is_constant(expressions: npt.NDArray[Any]) -> bool:
    return all(expression.GetVariables().empty() for expression in expressions)
