"""Feedback about a plan: one law, by phases in which contacts go on as they do; then a regulator.

The regulator holds the goal once the plan is over.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from drake_aigto.arrays import Floats
from drake_aigto.contact import AnyMechanism, TreeMechanism, contact_law, make_mechanism
from drake_aigto.planning.options import needs_shooting
from drake_aigto.planning.riccati import FeedbackPhase, Sweep
from drake_aigto.planning.stretches import (
    Cut,
    Stretch,
    check_impacts,
    check_sizes,
    is_at_rest_on,
    touches_walls,
)
from drake_aigto.shooting import TWO_STAGES, FeedbackLaws, ShootingProblem
from drake_aigto.simulation import Controller, Growth, Held, calc_growth, tangent_scales
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scales, Scenario, TaskCost, World

# Coordinates and speeds without a weight have this part of the task's cost, at its scales.
_LEAST_WEIGHT = 1e-3
# What no control balances moves what rests by no more than this part of the task's scales. As goals
# are typed as 3.14 where π is meant, an equilibrium this near is the goal's.
_BALANCED, _MEANT, _NEWTON_STEPS = 1e-6, 2e-3, 4
# Parts of the stiffest direction that resist less than this are free.
_FREE = 1e-3
# Steps of central differences, as a part of 1 m, 1 rad, or 1 of their rates.
_DIFFERENCE = 1e-5
# The longest second-order Runge-Kutta step that is stable, in times of the fastest decay.
_LONGEST_DECAY = 1.5
# Errors that grow by less than this part in the duration do so by rounding: four eigenvalues of a
# drone are 0, and those of its derivatives by differences 0.02 /s.
_SLOWLY = 0.2


def count_damper_steps(world: World, q: Floats, time_step: float) -> int:
    """Returns how many Runge-Kutta steps in a time [s] keep the dampers of joints stable at q."""
    each = np.eye(world.num_velocities)
    at = np.tile(q, (len(each), 1))
    D = (world.calc_bias(at, each) - world.calc_bias(at, -each)).T / 2  # Squares of v cancel.
    rates = np.abs(np.linalg.eigvals(np.linalg.solve(world.calc_mass_matrix(q), D)))
    return int(np.ceil(time_step * np.max(rates) / _LONGEST_DECAY))


class Regulator(NamedTuple):
    """Infinite-horizon feedback about an equilibrium, u = u* + K (x − x*).

    K has the least Σ_k h (ũᵀ R ũ + x̃ᵀ W x̃) of controls that are held for h, with W the running
    weights and 1/T of the final ones.
    """

    state: Floats  # x* = (q*, 0), shape (nq + n,)
    control: Floats  # u*, shape (nu,)
    gains: Floats  # K, shape (nu, 2n)
    value: Floats  # V of that sum, x̃ᵀ V x̃, shape (2n, 2n)
    response: Floats  # x̃ a period later by x̃, shape (2n, 2n)

    @classmethod
    def of(cls, world: World, scenario: Scenario, end: Floats, period: float) -> Regulator | None:
        """Returns the regulator about a scenario's goal; None where the goal cannot be held so.

        That is: the goal moves, is at a wall, is no equilibrium within the bounds of the control,
        or cannot be stabilized, or joints have dry friction.

        Args:
            world: the mechanism.
            scenario: the task. Coordinates that it does not weigh at T stay where they end.
            end: q and v at the end of the plan, shape (2n,).
            period: h [s].
        """
        cost, (q, _) = TaskCost.of(world, scenario), world.split(end)
        q = world.add(q, -np.where(cost.is_asked, cost.goal_errors(q), 0.0))
        if (hold := _find_hold(world, scenario, q)) is None:
            return None
        q, u = hold
        # Of a control that is held for a period.
        A, B = _linearize(world, q, u)
        size, nu = B.shape
        F, G = np.split(
            expm(period * np.block([[A, B], [np.zeros((nu, size + nu))]]))[:size], [size], axis=1
        )
        W, R = period * _weigh(world, scenario, cost), period * np.diag(cost.R)
        try:  # Drake's solver ends the process where nothing stabilizes.
            value = solve_discrete_are(F, G, W, R)
        except LinAlgError:
            return None
        K = -np.linalg.solve(R + G.T @ value @ G, G.T @ value @ F)
        is_stable = np.max(np.abs(np.linalg.eigvals(F + G @ K))) < 1.0
        x = np.concatenate([q, np.zeros(world.num_velocities)])
        return cls(x, u, K, value, F + G @ K) if is_stable else None

    def pose(self, world: World, scenario: Scenario) -> Scenario:
        """Returns the task to come to x* from anywhere and stay: what K is the best of, nearby."""
        (q, _), n = world.split(self.state), world.num_velocities
        weights, final = np.diag(_weigh(world, scenario, TaskCost.of(world, scenario))), self.value
        asked: dict[str, Any] = {"position_weight": weights[:n], "velocity_weight": weights[n:]}
        asked |= {"goal_weight": np.diag(final)[:n], "goal_velocity_weight": np.diag(final)[n:]}
        asked |= {f"reference_{each}": None for each in ("times", "positions", "velocities")}
        asked |= {"hard_goal": False, "periodic": None}
        return dataclasses.replace(scenario, goal_position=q, **asked)

    def respond(self, world: World, x: Floats, count: int) -> tuple[Floats, Floats]:
        """Returns states (count + 1, nq + n) and controls (count, nu) from x on, if linear."""
        off = np.empty((count + 1, len(self.response)))
        off[0] = world.calc_error(x, self.state)
        for k in range(count):
            off[k + 1] = self.response @ off[k]
        (q, _), n = world.split(self.state), world.num_velocities
        states = np.hstack([world.add(np.tile(q, (count + 1, 1)), off[:, :n]), off[:, n:]])
        return states, self.control + off[:-1] @ self.gains.T


def calc_divergence(world: World, scenario: Scenario) -> float:
    """Returns how fast errors grow at a goal that is an unstable equilibrium [1/s], else 0.

    That is the largest real part of the eigenvalues of the motion about the goal, under the control
    that holds it there.
    """
    if (hold := _find_hold(world, scenario, scenario.goal_position)) is None:
        return 0.0
    A, _ = _linearize(world, *hold)
    pace = float(np.max(np.linalg.eigvals(A).real))
    return pace if pace * scenario.duration > _SLOWLY else 0.0


def _find_hold(world: World, scenario: Scenario, q: Floats) -> tuple[Floats, Floats] | None:
    """Returns the equilibrium that q is or means, shape (nq,), and the control there, (nu,).

    Newton's method moves q as little as v̇(q, 0, u) = 0 takes, and u as it likes. None: there is no
    equilibrium so near, it is at a wall or out of bounds of the control, or q is passed.
    """
    still = not TaskCost.of(world, scenario).goal_velocity.any()
    if world.dry_friction is not None or not still:
        return None
    n = world.num_velocities
    rest, scales, moved = np.zeros(n), tangent_scales(world, scenario)[:n], np.zeros(n)
    for _ in range(_NEWTON_STEPS):
        u = np.linalg.pinv(world.calc_actuation(q)) @ world.calc_bias(q, rest)
        rate = world.calc_acceleration(q, rest, u)
        if np.max(np.abs(rate) / scales) * scenario.duration**2 <= _BALANCED:
            low, high = world.bounds(scenario).control
            is_free = np.all(world.calc_clearance(q) > 0)
            return (q, u) if is_free and np.all((u >= low) & (u <= high)) else None
        A, G = (each[n:] for each in _linearize(world, q, u))
        unmoved = np.eye(n) - G @ np.linalg.pinv(G)
        step = -np.linalg.pinv(unmoved @ (A[:, :n] * scales), _FREE) @ (unmoved @ rate)
        moved += step
        if not np.max(np.abs(moved)) <= _MEANT:
            return None
        q = world.add(q, scales * step)
    return None


def _weigh(world: World, scenario: Scenario, cost: TaskCost) -> Floats:
    """Returns W, shape (2n, 2n)."""
    scales, n, T = Scales.of(world, scenario), world.num_velocities, scenario.duration
    weights = np.zeros((2 * n, 2 * n))
    weights[:n, :n], weights[n:, n:] = cost.QT / T, cost.QTv / T
    weights += np.diag(np.concatenate([cost.Q, cost.Qv]))
    units = np.repeat([scales.length, scales.velocity], n)
    least = _LEAST_WEIGHT * scales.cost / (T * units**2)
    return weights + np.diag(np.where(np.diag(weights) < least, least, 0.0))


def _linearize(world: World, q: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Returns ∂ẋ/∂x and ∂ẋ/∂u at rest at q, x = (δ, v), shapes (2n, 2n) and (2n, nu)."""
    size, n = 2 * world.num_velocities + len(u), world.num_velocities
    steps = _DIFFERENCE * np.vstack([np.eye(size), -np.eye(size)])
    delta, v, change = np.split(steps, [n, 2 * n], axis=1)
    rates = np.hstack([v, world.calc_acceleration(world.add(q, delta), v, u + change)])
    slopes = ((rates[:size] - rates[size:]) / (2 * _DIFFERENCE)).T
    size = 2 * n
    return slopes[:, :size], slopes[:, size:]


# Runge-Kutta steps between knots, and how far from walls gains know of them, in parts of the task's
# length: a state a little off its plan may meet a wall where the plan does not. With 1e-3, all
# four unstable finalists of a T that a disc pushes were lost from starts that are off, none with
# this; a walker and cart-poles hold with either.
_SOFT_SUBSTEPS, _SMOOTHING = 8, 1e-4
# In the loop plants are other ones than the plan's: gains know walls from each of these, controls
# cost such a share, and a model tells the best. With (1e-2, 1) alone cart_pole/soft_06 cost 100.2
# where all is off, now 85.6; without the last two spinner/two_radians, heavier, 6.84, now 4.56.
_ON_PLANTS = *((each, 1.0) for each in (0.0, 1e-3, 1e-2, 3e-2, 1e-1)), (0.0, 0.1), (1e-3, 0.1)
# Periods within this part of a knot's interval are as long.
_SAME = 1e-6
# A slip has ended at this part of its largest value in the plan.
_STOPPED = 1e-2


class Feedback(Controller):
    """Tracks a plan through its contacts.

    On phase i, in which the same contacts last in the same modes or none does, a control that is
    held from t_k on is

        u = u_k + K_k (x − x_i(t)),    cut to the bounds of the control,

    the best answer of held controls to a deviation from the phase, to second order (`Sweep`).

    The next phase begins when a wall is hit, or a slip stops, not when the plan's clock says so.
    For that each phase goes on before and after its own part of the plan, as if its contacts were
    all there is: a bounce that comes early is followed by what the next phase was before its
    beginning, and one that is late by the last phase, with its last gain. Impacts are counted at
    each wall: those that the plan lacks change nothing. What a control ends, as when it lets go of
    a wall, ends by the clock.

    A plan of a mechanism between compliant walls, or one that touches nothing, is one phase. Its
    gains are those of the descent that found the plan (`ShootingProblem.linearize`), the law of
    compliant contact included. In the loop they are of holds that are as long as periods, and there
    are several, which know of walls from near or far, and keep near the plan or less so: those act
    that lead to the least cost, if the model follows them from the state (`FeedbackLaws`).

    After its end the goal is held by a `Regulator` where there is one, else the last state by the
    last gains.

    Attributes:
        laws: of which a model tells the best; None: there is one at a time.
    """

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        trajectory: Trajectory,
        phases: Sequence[FeedbackPhase] = (),
        mechanism: AnyMechanism | None = None,
        period: float | None = None,
    ) -> None:
        """Computes the gains, or takes those that are given.

        Args:
            world: of the plan.
            scenario: its task.
            trajectory: the plan.
            phases: of such a plan that has them already.
            mechanism: of this world and the scenario's contact, if it is compiled already.
            period: between samples [s]; None: as its knots are. Phases have gains of knots.

        Raises:
            TrajectoryError: the plan does not fit the world; or it has several impacts at once, one
                at the start, or one that only grazes a wall: no feedback is known there.
        """
        check_sizes(world, trajectory)
        self._world, times = world, trajectory.times
        self.start, self.end = float(times[0]), float(times[-1])
        self._longest_hold = float(np.max(np.diff(times)))
        last = np.concatenate([trajectory.positions[-1], trajectory.velocities[-1]])
        self._goal = world, scenario, last, period or self._longest_hold
        self._bounds = world.bounds(scenario).control
        self._norm = scenario.control_norm or np.inf
        touches = scenario.contact == "rigid" and touches_walls(world, trajectory)
        self.feels_contact = touches or not needs_shooting(world, scenario)
        self._sweep: Sweep | None = None
        self.laws: FeedbackLaws | None = None
        if phases:
            self.phases = list(phases)
        if self.feels_contact:
            check_impacts(world, trajectory)
            self._sweep = Sweep(world, scenario, trajectory)
        elif not phases:
            mechanism = mechanism or make_mechanism(world, contact_law(world, scenario))
            is_stiff = isinstance(mechanism, TreeMechanism) and mechanism.has_friction
            parts, whole, order = 1, _SOFT_SUBSTEPS, TWO_STAGES if is_stiff else 4
            if in_loop := period is not None and not is_stiff:
                parts = int(np.ceil(self._longest_hold / self._goal[-1] - _SAME))
            if not is_stiff:
                least = count_damper_steps(world, trajectory.positions[0], self._longest_hold)
                whole = max(whole, least)
            times, states, u = _refine(world, trajectory, parts)
            problem = ShootingProblem.of(world, scenario, mechanism, times)
            fewest = -(-whole // parts)
            is_exact = is_stiff or (period is not None and mechanism.has_friction)
            exact, steps = problem.resolve(u, fewest, states, order, is_exact)
            self._transitions = exact.transitions
            on_plants = _ON_PLANTS if in_loop and mechanism.is_smoothed else ((_SMOOTHING, 1.0),)
            self._gains = list[Floats]()
            for from_far, share in on_plants:
                cost = dataclasses.replace(problem.cost, R=share * problem.cost.R)
                weighed = dataclasses.replace(problem, cost=cost)
                self._gains.append(weighed.linearize(u, steps, from_far, states, order).gains)
            self.phases = [FeedbackPhase(times, states, u, self._gains[0])]
            if len(on_plants) > 1:
                self.laws = FeedbackLaws(problem, states, u, self._gains, fewest, 2)

    @property
    def stretches(self) -> list[Stretch]:
        """Stretches of the plan, which the phases are of; none of a plan that is one phase."""
        return self._sweep.stretches if self._sweep else []

    def judged_by(self, world: World, scenario: Scenario) -> Feedback:
        """Returns the same, where a model that has been learned tells which law is best."""
        assert self.laws
        other, law = copy.copy(self), contact_law(world, scenario)
        other.laws = self.laws.judged_by(make_mechanism(world, law))
        return other

    @cached_property
    def phases(self) -> list[FeedbackPhase]:
        """Phases of the plan, in order."""
        assert self._sweep
        return self._sweep.run()

    @cached_property
    def regulator(self) -> Regulator | None:
        """The regulator of the goal; None: there is none."""
        return Regulator.of(*self._goal)

    @cached_property
    def growth(self) -> Growth:
        """Growth of errors along the plan without feedback, where the gains are not given."""
        transitions = self._sweep.calc_transitions() if self._sweep else self._transitions
        return calc_growth(transitions, tangent_scales(*self._goal[:2]))

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns u_k + K_k (x − x_i(t)), within bounds; after the end that of the regulator."""
        if time >= self.end and self.regulator:
            about, planned, gains, *_ = self.regulator
            return Held(self._limit(planned + gains @ self._world.calc_error(x, about)), np.inf)
        phase = self.phases[self.find_phase(time, x, bounces)]
        last = len(phase.controls) - 1
        # A sample at a knot is one of that knot, however its time was added up.
        at = time + _SAME * self._longest_hold
        k = int(np.clip(np.searchsorted(phase.times, at, side="right") - 1, 0, last))
        error = self._world.calc_error(x, phase.calc_state(time))
        until, planned, gains = float(phase.times[k + 1]), phase.controls[k], phase.gains[k]
        if self.laws and time >= self.start:
            gains = self._gains[self.laws.find_best(k, self._move(phase.states[k], error))][k]
        control = self._limit(planned + gains @ error)
        added = float(np.linalg.norm(control - planned))
        # A phase that should have ended in a bounce goes on beyond the end.
        return Held(control, min(until, self.end) if until > time else self.end, added)

    def _move(self, x: Floats, error: Floats) -> Floats:
        """Returns the state that is off another one by an error (2n,)."""
        (q, v), (moved, change) = self._world.split(x), np.split(error, 2)
        return np.concatenate([self._world.add(q, moved), v + change])

    def _limit(self, u: Floats) -> Floats:
        """Returns a control within its bounds."""
        size = float(np.linalg.norm(u := np.clip(u, *self._bounds)))
        return u * min(1.0, self._norm / size) if size else u

    def find_state(self, time: float, bounces: Sequence[int]) -> Floats:
        """Returns the state that is planned for a time after such bounces, (q, v).

        After the end that is the regulator's, if there is one.
        Where the phase has ended, it is where that would lead. Whether a contact lasts, or has
        stopped to slip, no bounce tells: that is as planned.
        """
        if time > self.end and self.regulator:
            return self.regulator.state
        return self.phases[self.find_phase(time, None, bounces)].calc_state(time)

    def find_phase(self, time: float, x: Floats | None, bounces: Sequence[int]) -> int:
        """Returns in which phase it is: all that ends those before it has happened."""
        left = list(bounces)
        for i, stretch in enumerate(self.stretches[:-1]):
            if stretch.cut == Cut.HIT and stretch.contact in left:
                left.remove(stretch.contact)
            elif not self._is_over(stretch, time, x):
                return i
        return len(self.phases) - 1

    def _is_over(self, stretch: Stretch, time: float, x: Floats | None) -> bool:
        """Returns whether a phase has ended other than by an impact that was counted."""
        if stretch.cut == Cut.CLOCK or (x is None and stretch.is_shown_by_state):
            return time >= stretch.end
        is_early = time < (stretch.begin + stretch.end) / 2
        if x is None or is_early or not stretch.is_shown_by_state:
            return False
        contact, (q, v) = stretch.contact, self._world.split(x)
        if stretch.cut == Cut.HIT:
            return bool(is_at_rest_on(self._world, q, v, stretch.speed / 2)[contact])
        slip = float(self._world.rubbing.calc_slips(q, v)[contact])
        return slip * stretch.find_mode(contact) <= _STOPPED * stretch.speed


def _refine(world: World, trajectory: Trajectory, parts: int) -> tuple[Floats, Floats, Floats]:
    """Returns times, states and controls at this number of knots for each of a trajectory's."""
    t, shares = trajectory.times, np.arange(parts) / parts
    times = np.append((t[:-1, np.newaxis] + np.outer(np.diff(t), shares)).ravel(), t[-1])
    q, v = world.split(trajectory.to_piecewise()[0].vector_values(times).T)
    states = np.hstack([world.normalized(q), v])
    return times, states, np.repeat(trajectory.controls, parts, axis=0)
