"""States that are measured with noise, made out with the model: a filter before a controller."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import (
    BasicVector,
    Context,
    EventStatus,
    LeafSystem,
    State,
    ValueProducer,
)
from scipy.linalg import cho_factor, cho_solve

from drake_aigto.arrays import Floats
from drake_aigto.control.model import Model
from drake_aigto.control.ports import check_seconds, may_be_unsampled
from drake_aigto.errors import ControlError
from drake_aigto.simulation import HeldControl, tangent_scales
from drake_aigto.world import Scales, Scenario, World

# What the model leaves out changes a velocity by this share of the task's, in the task's time.
_UNKNOWN = 0.05
# Standard deviations of an error's squared norm above its mean up to which the model is believed.
_BELIEVED = 3.0
# Samples are of the model's own motion until they are likelier of another one, by this log; to this
# part of the task's scales, the model knows where that is.
_ODDS, _EXACT = np.log(1e3), 1e-3
# The covariance is doubled so often at one sample, at most: to a thousand times the deviations.
_DOUBLINGS = 20
# Samples are a period apart within this part of it.
_SAME = 1e-6


class _Estimate(NamedTuple):
    """Estimates at a time.

    Attributes:
        time: t [s].
        x: the filter's, [q, v].
        covariance: of that, (2 nv, 2 nv).
        sampled: the last sample's time [s].
        undisturbed: where the model leads from the scenario's start, [q, v].
        odds: log of how much likelier samples are of that than of x, as far as it counts.
    """

    time: float
    x: Floats
    covariance: Floats
    sampled: float
    undisturbed: Floats
    odds: float = -np.inf

    @property
    def likelier(self) -> Floats:
        """The likelier one of both."""
        return self.undisturbed if self.odds > 0 else self.x


class StateFilter(LeafSystem):
    """A system that takes noise out of a measured state, by what the model makes of the last one.

    A filter with sigma points (the cubature rule: Arasaratnam and Haykin, IEEE TAC 2009). With
    N = 2 nv and the covariance P = L Lᵀ of the last estimate x̂, the model leads x̂ and the 2N states
    x̂ ± √N L_i on to the next sample, by its own law of contact. Where x̂ ends is x̂⁻, and about that
    the others' ends have the covariance P⁻, with what the model leaves out. (Their mean would be
    no state at all where some have bounced, and others have not.) The sample z of covariance R
    gives

        x̂ ← x̂⁻ + P⁻ S⁻¹ (z − x̂⁻),    P ← P⁻ − P⁻ S⁻¹ P⁻,    S = P⁻ + R.

    What the model leaves out is white noise of forces, under which a velocity is 5 % of the task's
    off after the task's time. Where ‖z − x̂⁻‖² in the norm of S⁻¹ is above N + 3 √(2N), as after a
    kick, P⁻ is doubled until it is not. Where the model finds no motion, z is the estimate. A
    sample that is not finite goes through as it is, so that a controller sees it.

    A plant that nothing disturbs moves as the model does from the scenario's start, x⁰, and noise
    wants no answer. So x⁰ is the estimate until w, from log 1000 on and never above, is negative:
    w ← w + log N(z; x⁰, R) − log N(z; x̂⁻, S), a cumulative sum (Page, Biometrika 1954).

    Input ports: `measured_state`, q and v; and `control`, u as it acts on the plant. Output port:
    `estimated_state`, q and v of now; between samples, as the model leads the last estimate on. Of
    a `TrackingController` behind it leave `contact_results` unconnected: the plant feels a bounce a
    moment before or after the filter has it, and only what the tracker sees in its estimates fits.

        quiet = builder.AddSystem(StateFilter(world, scenario, noise, period=0.01))
        builder.Connect(plant.get_state_output_port(), quiet.GetInputPort("measured_state"))
        builder.Connect(controller.get_output_port_control(), quiet.GetInputPort("control"))
        builder.Connect(quiet.get_output_port(), controller.get_input_port_estimated_state())

    Attributes:
        period: between samples of the measured state [s].
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        noise: Floats,
        period: float,
        control_period: float | None = None,
    ) -> None:
        """Declares the ports.

        Args:
            world: the model.
            scenario: its task.
            noise: standard deviations of q and v as they are measured, anew at each sample, shape
                (nq + nv,) [m, rad, 1/s].
            period: between samples [s].
            control_period: between changes of u, if it changes more often [s].

        Raises:
            ControlError: noise of the wrong length, below zero or nowhere above it, or a period
                that is not above zero.
        """
        super().__init__()
        self._world, self._scenario, self._model = world, scenario, Model(world, scenario)
        nx = world.num_positions + world.num_velocities
        self._noise = np.array(noise, dtype=float)
        is_some = np.any(self._noise > 0) and np.all((self._noise >= 0) & np.isfinite(self._noise))
        if self._noise.shape != (nx,) or not is_some:
            expected = f"standard deviations of q and v, {nx} numbers, some above zero"
            raise ControlError("noise", got=self._noise.tolist(), expected=expected)
        self.period = check_seconds("period", period, is_positive=True)
        often = check_seconds(
            "control_period", period if control_period is None else control_period, is_positive=True
        )
        scales = tangent_scales(world, scenario)
        self._exact = np.diag((_EXACT * scales) ** 2)
        _, speeds = np.split(scales, 2)
        self._unknown = _UNKNOWN**2 * speeds**2 / Scales.of(world, scenario).time
        self._measured = self.DeclareVectorInputPort("measured_state", nx)
        self._control = self.DeclareVectorInputPort("control", world.num_actuators)
        none, start = np.zeros(nx), scenario.initial_state
        nothing = AbstractValue.Make(_Estimate(-np.inf, none, np.empty((0, 0)), -np.inf, start))
        self._last = self.DeclareAbstractState(nothing)
        make = ValueProducer(nothing.Clone, lambda at, kept: kept.set_value(self._estimate(at)))
        self._now = self.DeclareCacheEntry("estimate", make, {self.all_sources_ticket()})
        self.DeclareInitializationUnrestrictedUpdateEvent(self._keep)
        self.DeclarePeriodicUnrestrictedUpdateEvent(often, 0.0, self._keep)
        self.DeclareVectorOutputPort("estimated_state", nx, self._write)

    def read_covariance(self, context: Context) -> Floats:
        """Returns the filter's last covariance along changes of q and v, shape (2 nv, 2 nv)."""
        return np.array(self._read(context).covariance)

    def _read(self, context: Context) -> _Estimate:
        last: _Estimate = context.get_abstract_state(int(self._last)).get_value()
        return last

    def _read_held(self, context: Context) -> HeldControl:
        """Returns the control that has acted since the last estimate."""
        times = np.array([self._read(context).time, context.get_time()])
        return HeldControl(times, np.array(self._control.Eval(context))[np.newaxis])

    def _is_due(self, context: Context) -> bool:
        """Returns whether there is a sample that was not seen yet."""
        elapsed = context.get_time() - self._read(context).sampled
        return bool(elapsed < 0 or elapsed >= (1 - _SAME) * self.period)

    def _write(self, context: Context, output: BasicVector) -> None:
        last, z = self._read(context), self._measured.Eval(context)
        if self._is_due(context) or not np.all(np.isfinite(z)):
            found: _Estimate = self._now.Eval(context)
            output.SetFromVector(found.likelier)
        elif context.get_time() > last.time:
            led = self._model.find_end(last.likelier, self._read_held(context))
            output.SetFromVector(z if led is None else led)
        else:
            output.SetFromVector(last.likelier)

    def _keep(self, context: Context, state: State) -> EventStatus:
        found: _Estimate = self._now.Eval(context)
        if not np.all(np.isfinite(found.x)):
            return EventStatus.DidNothing()
        start = self._scenario.initial_state
        if np.isinf(self._read(context).time) and may_be_unsampled(found.x, start):
            return EventStatus.DidNothing()
        state.get_mutable_abstract_state(int(self._last)).set_value(found)
        return EventStatus.Succeeded()

    def _estimate(self, context: Context) -> _Estimate:
        """Returns the estimate of now: the last one led on, and corrected where a sample is due."""
        last, now, z = self._read(context), context.get_time(), self._measured.Eval(context)
        if not np.all(np.isfinite(z)):
            return last._replace(x=np.array(z), odds=-np.inf)
        q, v = self._world.split(z)
        z = np.concatenate([self._world.normalized(q), v])
        R = self._spread(z)
        led: _Estimate | None = last if now == last.time else None
        if now > last.time > -np.inf:
            led = self._lead_on(last, self._read_held(context))
        if led is None:
            off = self._world.calc_error(z, last.undisturbed)
            is_near = off @ np.linalg.solve(R + self._exact, off) <= _most(off)
            is_start = np.isinf(last.time) and is_near
            return _Estimate(now, z, R, now, last.undisturbed, _ODDS if is_start else -np.inf)
        if not self._is_due(context):
            return led
        found = self._correct(led, z, R)
        if found.odds < 0 < led.odds and self._bounces_about(last, self._read_held(context)):
            return found._replace(odds=led.odds)
        return found

    def _bounces_about(self, last: _Estimate, held: HeldControl) -> bool:
        """Returns whether what nothing disturbs bounces now: the plant may, a moment off that."""
        times = held.times + np.array([0.0, held.times[-1] - held.times[0]])
        ahead = self._model.predict(last.undisturbed, HeldControl(times, held.controls))
        return bool(ahead and ahead[1])

    def _spread(self, z: Floats) -> Floats:
        """Returns R along changes of q and v, shape (2 nv, 2 nv)."""
        world, (q, v) = self._world, self._world.split(z)
        sq, sv = world.split(self._noise)
        off = world.subtract(world.normalized(q + np.diag(sq)), q)
        size = len(v)
        R = np.zeros((2 * size, 2 * size))
        R[:size, :size], R[size:, size:] = off.T @ off, np.diag(sv**2)
        return R

    def _lead_on(self, last: _Estimate, held: HeldControl) -> _Estimate | None:
        """Returns what the model makes of an estimate; None: it finds no motion."""
        world, model = self._world, self._model
        variances, axes = np.linalg.eigh(last.covariance)
        steps = np.sqrt(len(axes) * np.maximum(variances, 0.0)) * axes
        points = [last.x, *(self._add(last.x, step) for step in (*steps.T, *-steps.T))]
        ends = [end for x in points if (end := model.find_end(x, held)) is not None]
        if len(ends) < len(points):
            return None
        errors = np.array([world.calc_error(end, ends[0]) for end in ends[1:]])
        elapsed = held.times[-1] - held.times[0]
        unknown, covariance = self._unknown * elapsed, errors.T @ errors / len(errors)
        covariance += np.diag(np.concatenate([unknown * elapsed**2 / 3, unknown]))
        ahead = model.find_end(last.undisturbed, held) if last.odds > 0 else None
        known = (last.undisturbed,) if ahead is None else (ahead, last.odds)
        return _Estimate(float(held.times[-1]), ends[0], covariance, last.sampled, *known)

    def _correct(self, led: _Estimate, z: Floats, R: Floats) -> _Estimate:
        """Returns an estimate after a sample z of covariance R."""
        error, before = self._world.calc_error(z, led.x), led.covariance
        most, S = _most(error), cho_factor(before + R)
        off = self._world.calc_error(z, led.undisturbed)
        gained = _log_density(off, cho_factor(R + self._exact)) - _log_density(error, S)
        for _ in range(_DOUBLINGS):
            if error @ cho_solve(S, error) <= most:
                break
            before = 2.0 * before
            S = cho_factor(before + R)
        gain = cho_solve(S, before).T
        rest = np.eye(len(error)) - gain  # Joseph's form: P has no negative part.
        covariance = rest @ before @ rest.T + gain @ R @ gain.T
        return led._replace(
            x=self._add(led.x, gain @ error),
            covariance=covariance,
            sampled=led.time,
            odds=min(led.odds + gained, _ODDS),
        )

    def _add(self, x: Floats, step: Floats) -> Floats:
        """Returns [q ⊕ δq, v + δv]."""
        (q, v), (dq, dv) = self._world.split(x), np.split(step, 2)
        return np.concatenate([self._world.add(q, dq), v + dv])


def _most(error: Floats) -> float:
    """Returns up to which squared norm an error is believed."""
    return len(error) + _BELIEVED * float(np.sqrt(2.0 * len(error)))


def _log_density(error: Floats, S: tuple[Floats, bool]) -> float:
    """Returns log N(error; 0, S) from a factor of S, but for what is the same for all S."""
    return float(-error @ cho_solve(S, error) / 2.0 - np.sum(np.log(np.diag(S[0]))))
