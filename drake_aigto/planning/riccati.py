"""Riccati's equation along a plan, through contacts, and the phases of feedback that it gives."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from drake_aigto.arrays import ArrayRecord, Floats, LockedArrays
from drake_aigto.contact import calc_saltation, calc_velocity_after
from drake_aigto.planning.stretches import Cut, Stretch, read_stretches
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scales, Scenario, TaskCost, World

# Runge-Kutta steps between knots.
_SUBSTEPS = 4
# Differences are over this part of 1 m, 1 rad, or 1 of their rates: what is left of fourth order
# and of rounding is 1e-9 of what is differentiated.
_DIFFERENCE = 1e-5
# Phases go on before and after their own part of the plan by this part of its duration; where they
# are parabolas, by all of it.
_BEYOND = 0.1
# A hard goal weighs as if missing it by the task's length cost this number of the task's costs.
# A block on a floor whose friction and mass were up to 10 % off ended 38 mm off with a hundred of
# these costs, 12 with a thousand, and 3 with this number.
_HARD = 1e4
# What comes to its end more slowly than this, as a part of the rates there, may come at any time.
_SLOWLY = 1e-6


@dataclass(frozen=True, eq=False)
class FeedbackPhase(LockedArrays, ArrayRecord):
    """A stretch of a plan, with what comes before and after it if contacts go on as they do in it.

    Attributes:
        times: of K + 1 knots, shape (K + 1,) [s].
        states: q and v there, shape (K + 1, nq + n).
        controls: held between knots, shape (K, nu).
        gains: K_k, shape (K, nu, 2n).
    """

    times: Floats
    states: Floats
    controls: Floats
    gains: Floats

    @cached_property
    def _trajectory(self) -> Trajectory:
        n = self.gains.shape[2] // 2
        q, v = self.states[:, :-n], self.states[:, -n:]
        none = np.zeros((len(self.times), 0))
        return Trajectory(self.times, q, v, self.controls, none, none[1:])

    def calc_state(self, time: float) -> Floats:
        """Returns q and v, shape (nq + n,); before and after all knots, those of the nearest."""
        return self._trajectory.calc_state(time)


class Sweep:
    """Riccati's equation from the end of a plan to its start.

    A control that is held from t_k on answers a deviation x̃ from the plan by K_k x̃, the best
    answer to second order:

        V_k(x̃) = min over ũ   h_k (ũᵀ R ũ + x̃ᵀ diag(Q, Q_v) x̃) + V_{k+1}(F_k x̃ + G_k ũ)

    as if controls had no bounds, with the scenario's weights, those of angles as at their goal, and
    F_k, G_k the derivatives of the motion under a held control, with the forces of contacts that
    last: what sticks stays, what slides is braked by μ λ_n. Of a deviation from there, only that
    counts which walls leave (`Stretch.calc_projection`). Past an impact V is that of the next
    phase, of Ξ x̃: by the saltation matrix a deviation before it becomes one after it, as it comes
    sooner or later, and elsewhere,

        Ξ = D + (f⁺ − D f⁻) ∇gᵀ / (∇gᵀ f⁻),    D = ∂(q, v⁺)/∂(q, v⁻),    f = (q̇, v̇),    g = φ,

    friction of the impact included. Where a slip ends, g = s and D = 1; where a control lets go of
    a wall, or of stick, forces are those before and Ξ = 1.

    Attributes:
        stretches: of the plan.
    """

    def __init__(self, world: World, scenario: Scenario, trajectory: Trajectory) -> None:
        """Takes a plan whose impacts come one by one (`check_impacts`)."""
        self._world, self._scenario, self._plan = world, scenario, trajectory
        self._cost = TaskCost.of(world, scenario)
        self._friction = world.friction_coefficients(scenario)
        self.stretches = read_stretches(world, self._friction, trajectory)

    def run(self) -> list[FeedbackPhase]:
        """Returns the phases of all stretches."""
        cost, n, phases = self._cost, self._world.num_positions, list[FeedbackPhase]()
        value = np.zeros((2 * n, 2 * n))  # V at the end.
        value[:n, :n], value[n:, n:] = cost.QT, cost.QTv
        if self._scenario.hard_goal:
            scales = Scales.of(self._world, self._scenario)
            value[:n, :n] += _HARD * scales.cost / scales.length**2 * np.eye(n)
            if self._scenario.goal_velocity is not None:
                value[n:, n:] += _HARD * scales.cost / scales.velocity**2 * np.eye(n)
        for stretch in reversed(self.stretches):
            phase, value = self._sweep(stretch, value)
            phases.append(phase)
            if stretch.first > 0:
                jump = self.calc_saltation(stretch.first)
                value = jump.T @ value @ jump
        return phases[::-1]

    def calc_transitions(self) -> Floats:
        """Returns F, of what walls leave of a deviation, and Ξ of all stretches in order."""
        found = list[Floats]()
        for stretch in self.stretches:
            if stretch.first > 0:
                found.append(self.calc_saltation(stretch.first))
            times, states, controls = self._take(stretch)
            F, _ = self.calc_slopes(stretch, states[:-1], controls, np.diff(times))
            found += [F @ stretch.calc_projection(x) for F, x in zip(F, states, strict=False)]
        return np.array(found)

    def _sweep(self, stretch: Stretch, value: Floats) -> tuple[FeedbackPhase, Floats]:
        """Returns the phase of a stretch, and V where it begins."""
        times, states, controls = self._continue(stretch)
        begin, end = np.searchsorted(times, self._plan.times[[stretch.first, stretch.last]])
        gains, steps = np.zeros((len(controls), controls.shape[1], states.shape[1])), np.diff(times)
        F, G = self.calc_slopes(stretch, states[:end], controls[:end], steps[:end])
        values = {end: value}
        for k in reversed(range(end)):
            gain, value = self._step(F[k], G[k], steps[k], values[k + 1])
            left = stretch.calc_projection(states[k])
            gains[k], values[k] = gain @ left, left.T @ value @ left
        gains[end:] = gains[end - 1]
        return FeedbackPhase(times, states, controls, gains), values[begin]

    def _step(self, F: Floats, G: Floats, h: float, value: Floats) -> tuple[Floats, Floats]:
        """Returns K_k and V_k, from V_{k+1}, of any deviation."""
        cost = self._cost
        stage = h * np.diag(np.concatenate([cost.Q, cost.Qv]))
        curvature, cross = h * np.diag(cost.R) + G.T @ value @ G, G.T @ value @ F
        gain = np.asarray(-np.linalg.solve(curvature, cross), dtype=np.float64)
        value = stage + F.T @ value @ F + gain.T @ cross
        return gain, (value + value.T) / 2

    def calc_slopes(
        self, stretch: Stretch, x: Floats, u: Floats, h: Floats
    ) -> tuple[Floats, Floats]:
        """Returns F and G of K controls that are held for h [s], (K, 2n, 2n) and (K, 2n, nu)."""
        size, world = x.shape[1], self._world
        if self._is_parabola(stretch):
            lift, h = world.constant_inertia.inverse_mass @ world.actuation, h[:, None, None]
            F = np.eye(size) + h * np.eye(size, k=size // 2)
            return F, np.concatenate([h**2 / 2 * lift, h * lift], axis=1)

        def go(z: Floats) -> Floats:
            return _flow(stretch, z[..., :size], z[..., size:], h[:, None, None, None])

        slopes = _differentiate(go, np.hstack([x, u]))
        return slopes[..., :size], slopes[..., size:]

    def _is_parabola(self, stretch: Stretch) -> bool:
        """Returns whether accelerations are constant under a held control."""
        return self._world.has_constant_dynamics and not len(stretch.closed.contacts)

    def _take(self, stretch: Stretch) -> tuple[Floats, Floats, Floats]:
        """Returns knots, states and controls of a phase."""
        plan, first, last = self._plan, stretch.first, stretch.last
        states = plan.states[first : last + 1]
        if plan.impulses[first].any():
            states[0] = self._hit(int(np.argmax(plan.impulses[first])), stretch, states[0])
        return plan.times[first : last + 1], states, plan.controls[first:last]

    def _continue(self, stretch: Stretch) -> tuple[Floats, Floats, Floats]:
        """Returns knots, states and controls of a phase, and of what is before and after it."""
        plan, first, last = self._plan, stretch.first, stretch.last
        times, states, controls = self._take(stretch)
        duration, step = float(plan.times[-1] - plan.times[0]), float(np.mean(np.diff(times)))
        coast, span = _coast, _BEYOND * duration
        if self._is_parabola(stretch):
            coast, span, step = _fly, duration, max(step, duration / len(plan.controls))
        if first > 0:
            early, ahead = coast(stretch, states[0], controls[0], -step, span)
            times = np.concatenate([times[0] + early[::-1], times])
            states = np.vstack([ahead[::-1], states])
            controls = np.vstack([*[controls[:1]] * len(early), controls])
        if last < len(plan.controls):
            late, behind = coast(stretch, states[-1], controls[-1], step, span)
            times = np.concatenate([times, times[-1] + late])
            states = np.vstack([states, behind])
            controls = np.vstack([controls, *[controls[-1:]] * len(late)])
        return times, states, controls

    def calc_saltation(self, k: int) -> Floats:
        """Returns Ξ at a knot where a stretch begins, shape (2n, 2n)."""
        world, plan, n = self._world, self._plan, self._world.num_positions
        place = [stretch.first for stretch in self.stretches].index(k)
        before, after = self.stretches[place - 1 : place + 1]
        contact, x = before.contact, np.concatenate([plan.positions[k], plan.velocities[k]])
        D, end, normal = np.eye(2 * n), x, np.zeros(2 * n)
        if before.cut == Cut.CLOCK:
            return D
        if before.cut == Cut.HIT:

            def hit(states: Floats) -> Floats:
                return np.apply_along_axis(lambda each: self._hit(contact, after, each), -1, states)

            D, end = _differentiate(hit, x), hit(x)
            normal[:n] = world.calc_contact_jacobian(plan.positions[k])[contact]
        else:

            def slip(states: Floats) -> Floats:
                q, v = np.split(states, 2, axis=-1)
                return np.asarray(world.rubbing.calc_slips(q, v)[..., [contact]])

            normal = _differentiate(slip, x)[0]
        rates = _calc_rates(before, x, plan.controls[k - 1])
        later = _calc_rates(after, end, plan.controls[k])
        return calc_saltation(D, rates, later, normal, _SLOWLY)

    def _hit(self, contact: int, after: Stretch, x: Floats) -> Floats:
        """Returns the state after an impact, with friction, shape (2n,).

        What is held from then on returns nothing, and what others then hold is theirs.
        """
        world, (q, v) = self._world, np.split(x, 2)
        e = float(world.restitutions(self._scenario)[contact])
        e = 0.0 if contact in after.closed.contacts else e
        friction = float(self._friction[contact])
        M, J = world.calc_mass_matrix(q), world.calc_contact_jacobian(q)[contact]
        T = world.rubbing.calc_tangent_jacobian(q)[contact] if friction else np.zeros_like(J)
        return np.concatenate(
            [q, after.closed.stop(q, calc_velocity_after(M, (J, T), v, e, friction))]
        )


def _calc_rates(stretch: Stretch, x: Floats, u: Floats) -> Floats:
    """Returns (q̇, v̇) of states (…, 2n) with the forces of what a stretch holds."""
    v = x[..., x.shape[-1] // 2 :]
    return np.concatenate([v, stretch.closed.calc_push(x, u).acceleration], axis=-1)


def _flow(stretch: Stretch, x: Floats, u: Floats, duration: float | Floats) -> Floats:
    """Returns where states (…, 2n) are led to by held controls (…, nu), back in time if < 0."""
    h = duration / _SUBSTEPS
    for _ in range(_SUBSTEPS):
        k1 = _calc_rates(stretch, x, u)
        k2 = _calc_rates(stretch, x + h / 2 * k1, u)
        k3 = _calc_rates(stretch, x + h / 2 * k2, u)
        k4 = _calc_rates(stretch, x + h * k3, u)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def _coast(
    stretch: Stretch, x: Floats, u: Floats, step: float, span: float
) -> tuple[Floats, Floats]:
    """Returns times after a state, and states then, shapes (c,) and (c, 2n); back if step < 0."""
    count = int(np.ceil(span / abs(step)))
    states = list(
        itertools.accumulate(range(count), lambda x, _: _flow(stretch, x, u, step), initial=x)
    )
    return step * np.arange(1, count + 1, dtype=np.float64), np.array(states[1:])


def _fly(stretch: Stretch, x: Floats, u: Floats, step: float, span: float) -> tuple[Floats, Floats]:
    """Returns the same as `_coast` on a parabola, in closed form."""
    count = int(np.ceil(span / abs(step)))
    elapsed = step * np.arange(1, count + 1, dtype=np.float64)
    (v, a), t = np.split(_calc_rates(stretch, x, u), 2), elapsed[:, np.newaxis]
    q, _ = np.split(x, 2)
    return elapsed, np.hstack([q + t * (v + t / 2 * a), v + t * a])


def _differentiate(function: Callable[[Floats], Floats], x: Floats) -> Floats:
    """Returns the derivatives of a function (…, n) → (…, m) at x (…, n), shape (…, m, n)."""
    steps = _DIFFERENCE * np.multiply.outer([1.0, -1.0, 2.0, -2.0], np.eye(x.shape[-1]))
    ends = np.moveaxis(function(x[..., None, None, :] + steps), -3, 0)
    slopes = (8 * (ends[0] - ends[1]) - (ends[2] - ends[3])) / (12 * _DIFFERENCE)
    return np.swapaxes(slopes, -1, -2)
