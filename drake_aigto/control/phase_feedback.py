"""Feedback about a plan of a mechanism that bounces off rigid walls."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import Floats
from drake_aigto.control.feedback import Feedback
from drake_aigto.control.flights import check_bounces
from drake_aigto.simulation.controller import Held
from drake_aigto.simulation.coulomb import calc_velocity_after
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scales, Scenario, TaskCost, World

# Runge-Kutta steps between knots.
_SUBSTEPS = 4
# Differences are over this part of 1 m, 1 rad, or 1 of their rates: what is left of fourth order
# and of rounding is 1e-9 of what is differentiated.
_DIFFERENCE = 1e-5
# Flights go on before and after their bounces by this part of the plan's duration.
_BEYOND = 0.1
# A hard goal weighs as if so many of the task's costs were to be paid for missing it by its length.
_HARD = 1e2
# A control that is this near to its bound, as a part of the bounds' range, answers nothing.
_AT_BOUND = 1e-6


@dataclass(frozen=True, eq=False)
class Phase:
    """A part of a plan between bounces, with what comes before and after it without a wall.

    Attributes:
        times: of K + 1 knots, shape (K + 1,) [s].
        positions: q(t), shape (n, 1).
        velocities: v(t), shape (n, 1).
        controls: held between knots, shape (K, nu).
        gains: K_k, shape (K, nu, 2n).
    """

    times: Floats
    positions: PiecewisePolynomial
    velocities: PiecewisePolynomial
    controls: Floats
    gains: Floats

    def calc_state(self, time: float) -> Floats:
        """Returns q and v, shape (2n,); before and after all knots, those of the nearest."""
        t = float(np.clip(time, self.times[0], self.times[-1]))
        return np.concatenate([self.positions.value(t)[:, 0], self.velocities.value(t)[:, 0]])


class PhaseFeedback(Feedback):
    """Tracks a plan of a mechanism, whose M, h and J depend on q, through its bounces.

    On phase i, from one bounce of the plan to the next, a control that is held from t_k on is

        u = u_k + K_k (x − x_i(t)),    cut to the bounds of the control,

    the best answer to a deviation x̃ from the phase to second order (Riccati's discrete equation):

        V_k(x̃) = min over ũ   h_k (ũᵀ R ũ + x̃ᵀ diag(Q, Q_v) x̃) + V_{k+1}(F_k x̃ + G_k ũ)

    with the scenario's weights, those of angles as at their goal, and F_k, G_k the derivatives of
    the motion under a held control. Past a bounce V is that of the next phase, of Ξ x̃: by the
    saltation matrix a deviation before the bounce becomes one after it, as that comes sooner or
    later, and elsewhere,

        Ξ = D + (f⁺ − D f⁻) ∇φᵀ / (∇φᵀ f⁻),    D = ∂(q, v⁺)/∂(q, v⁻),    f = (q̇, v̇),

    friction of the impact included.

    The next phase begins when the mechanism bounces, as for balls (`FlightFeedback`): each goes on
    for a tenth of the plan's duration before and after its own bounces, as if there were no wall.
    """

    feels_contact = True

    def __init__(self, world: World, scenario: Scenario, trajectory: Trajectory) -> None:
        """Computes the gains.

        Raises:
            TrajectoryError: it does not fit the world; or it has contacts that last, several at
                once, at the start, or that only graze a wall: no feedback is known there.
        """
        check_bounces(world, trajectory)
        times = trajectory.times
        self.start, self.end = float(times[0]), float(times[-1])
        self.longest_hold = float(np.max(np.diff(times)))
        self._bounds = world.bounds(scenario).control
        self._norm = scenario.control_norm or np.inf
        joints = np.flatnonzero(trajectory.impulses[:-1].any(axis=1))
        self._contacts = [int(np.argmax(trajectory.impulses[k])) for k in joints]
        self._phases = Sweep(world, scenario, trajectory).run(joints.tolist())

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns u_k + K_k (x − x_i(t)), within bounds."""
        phase = self._phases[self._find_phase(bounces)]
        last = len(phase.controls) - 1
        k = int(np.clip(np.searchsorted(phase.times, time, side="right") - 1, 0, last))
        u = phase.controls[k] + phase.gains[k] @ (x - phase.calc_state(time))
        size = float(np.linalg.norm(u := np.clip(u, *self._bounds)))
        return Held(u * min(1.0, self._norm / size) if size else u, float(phase.times[k + 1]))

    def find_state(self, time: float, bounces: Sequence[int]) -> Floats:
        """Returns where the phase is, or would be without the wall, that the mechanism is in."""
        return self._phases[self._find_phase(bounces)].calc_state(time)

    def _find_phase(self, bounces: Sequence[int]) -> int:
        """Returns in which phase it is: all bounces before it have happened."""
        left = list(bounces)
        for i, contact in enumerate(self._contacts):
            if contact not in left:
                return i
            left.remove(contact)
        return len(self._contacts)


class Sweep:
    """Riccati's equation from the end of a plan to its start."""

    def __init__(self, world: World, scenario: Scenario, trajectory: Trajectory) -> None:
        """Takes a plan whose contacts are bounces one by one (`check_bounces`)."""
        self._world, self._scenario, self._plan = world, scenario, trajectory
        self._cost = TaskCost.of(world, scenario)
        low, high = world.bounds(scenario).control
        margin = _AT_BOUND * np.where(np.isfinite(high - low), high - low, 1.0)
        self._inside = low + margin, high - margin

    def run(self, joints: list[int]) -> list[Phase]:
        """Returns the phases that meet at these knots."""
        ends = [0, *joints, len(self._plan.times) - 1]
        value, phases = self._find_final(), []
        for first, last in reversed(list(itertools.pairwise(ends))):
            phase, value = self._sweep(first, last, value)
            phases.append(phase)
            if first > 0:
                jump = self.calc_saltation(first)
                value = jump.T @ value @ jump
        return phases[::-1]

    def _find_final(self) -> Floats:
        """Returns V at the end, shape (2n, 2n)."""
        cost, n = self._cost, self._world.num_positions
        value = np.zeros((2 * n, 2 * n))
        value[:n, :n], value[n:, n:] = cost.QT, cost.QTv
        if self._scenario.hard_goal:
            scales = Scales.of(self._world, self._scenario)
            value[:n, :n] += _HARD * scales.cost / scales.length**2 * np.eye(n)
        return value

    def _sweep(self, first: int, last: int, value: Floats) -> tuple[Phase, Floats]:
        """Returns the phase between two knots, and V where it begins."""
        times, states, controls = self._continue(first, last)
        begin, end = np.searchsorted(times, self._plan.times[[first, last]])
        gains = np.zeros((len(controls), controls.shape[1], states.shape[1]))
        values = {end: value}
        for k in reversed(range(end)):
            gains[k], values[k] = self._step(
                states[k], controls[k], times[k + 1] - times[k], values[k + 1]
            )
        gains[end:] = gains[end - 1]
        q, v = np.split(states.T, 2)
        positions = PiecewisePolynomial.CubicHermite(times, q, v)
        return Phase(times, positions, positions.derivative(), controls, gains), values[begin]

    def _step(self, x: Floats, u: Floats, h: float, value: Floats) -> tuple[Floats, Floats]:
        """Returns K_k and V_k, from V_{k+1}."""
        cost, size = self._cost, len(x)

        def go(z: Floats) -> Floats:
            return _flow(self._world, z[..., :size], z[..., size:], h)

        slopes = _differentiate(go, np.concatenate([x, u]))
        F, G = slopes[:, :size], slopes[:, size:]
        stage = h * np.diag(np.concatenate([cost.Q, cost.Qv]))
        curvature, cross = h * np.diag(cost.R) + G.T @ value @ G, G.T @ value @ F
        gain = np.zeros((len(u), size))
        free = (u > self._inside[0]) & (u < self._inside[1])
        gain[free] = -np.linalg.solve(curvature[np.ix_(free, free)], cross[free])
        value = stage + F.T @ value @ F + gain.T @ curvature @ gain
        value += gain.T @ cross + cross.T @ gain
        return gain, (value + value.T) / 2

    def _continue(self, first: int, last: int) -> tuple[Floats, Floats, Floats]:
        """Returns knots, states and controls of a phase, and of what is before and after it."""
        plan, world = self._plan, self._world
        times, controls = plan.times[first : last + 1], plan.controls[first:last]
        states = np.hstack([plan.positions, plan.velocities])[first : last + 1]
        if first > 0:
            states[0] = self._hit(int(np.argmax(plan.impulses[first])), states[0])
        span, step = _BEYOND * float(plan.times[-1] - plan.times[0]), float(np.mean(np.diff(times)))
        if first > 0:
            early, ahead = _coast(world, states[0], controls[0], -step, span)
            times = np.concatenate([times[0] + early[::-1], times])
            states = np.vstack([ahead[::-1], states])
            controls = np.vstack([*[controls[:1]] * len(early), controls])
        if last < len(plan.controls):
            late, behind = _coast(world, states[-1], controls[-1], step, span)
            times = np.concatenate([times, times[-1] + late])
            states = np.vstack([states, behind])
            controls = np.vstack([controls, *[controls[-1:]] * len(late)])
        return times, states, controls

    def calc_saltation(self, k: int) -> Floats:
        """Returns Ξ of the bounce at a knot, shape (2n, 2n)."""
        world, plan, n = self._world, self._plan, self._world.num_positions
        contact = int(np.argmax(plan.impulses[k]))

        def hit(states: Floats) -> Floats:
            return np.apply_along_axis(lambda x: self._hit(contact, x), -1, states)

        x = np.concatenate([plan.positions[k], plan.velocities[k]])
        D, after = _differentiate(hit, x), hit(x)
        before, later = (
            _calc_rates(world, state, u)
            for state, u in ((x, plan.controls[k - 1]), (after, plan.controls[k]))
        )
        normal = np.zeros(2 * n)
        normal[:n] = world.calc_contact_jacobian(plan.positions[k])[contact]
        return D + np.outer(later - D @ before, normal) / float(normal @ before)

    def _hit(self, contact: int, x: Floats) -> Floats:
        """Returns the state after an impact, with friction, shape (2n,)."""
        world, (q, v) = self._world, np.split(x, 2)
        e = float(world.restitutions(self._scenario)[contact])
        friction = float(world.friction_coefficients(self._scenario)[contact])
        M, J = world.calc_mass_matrix(q), world.calc_contact_jacobian(q)[contact]
        T = world.rubbing.calc_tangent_jacobian(q)[contact] if friction else np.zeros_like(J)
        return np.concatenate([q, calc_velocity_after(M, (J, T), v, e, friction)])


def _calc_rates(world: World, x: Floats, u: Floats) -> Floats:
    """Returns (q̇, v̇) of states (…, 2n) without contact."""
    q, v = np.split(x, 2, axis=-1)
    return np.concatenate([v, world.calc_acceleration(q, v, u)], axis=-1)


def _flow(world: World, x: Floats, u: Floats, duration: float) -> Floats:
    """Returns where states (…, 2n) are led to by held controls (…, nu), back in time if < 0."""
    h = duration / _SUBSTEPS
    for _ in range(_SUBSTEPS):
        k1 = _calc_rates(world, x, u)
        k2 = _calc_rates(world, x + h / 2 * k1, u)
        k3 = _calc_rates(world, x + h / 2 * k2, u)
        k4 = _calc_rates(world, x + h * k3, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def _coast(world: World, x: Floats, u: Floats, step: float, span: float) -> tuple[Floats, Floats]:
    """Returns times after a state, and states then, shapes (c,) and (c, 2n); back if step < 0."""
    count = int(np.ceil(span / abs(step)))
    states = list(
        itertools.accumulate(range(count), lambda x, _: _flow(world, x, u, step), initial=x)
    )
    return np.array([step * (i + 1) for i in range(count)]), np.array(states[1:])


def _differentiate(function: Callable[[Floats], Floats], x: Floats) -> Floats:
    """Returns the derivatives of a function (…, n) → (…, m) at x, shape (m, n)."""
    steps = _DIFFERENCE * np.eye(len(x))
    ends = [function(x + part * steps) for part in (1.0, -1.0, 2.0, -2.0)]
    return ((8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * _DIFFERENCE)).T
