"""The regulator that holds a plan's goal once the plan is over."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, expm, solve_discrete_are

from drake_aigto.arrays import Floats
from drake_aigto.world import Scales, Scenario, TaskCost, World

# Coordinates and speeds without a weight have this part of the task's cost, at its scales.
_LEAST_WEIGHT = 1e-3
# A force that no actuator gives is none below this part of the largest force at the goal.
_BALANCED = 1e-6
# Steps of central differences, as a part of 1 m, 1 rad, or 1 of their rates.
_DIFFERENCE = 1e-5
# Errors that grow by less than this part in the duration do so by rounding.
_SLOWLY = 1e-2


class Regulator(NamedTuple):
    """Infinite-horizon feedback about an equilibrium, u = u* + K (x − x*).

    K has the least Σ_k h (ũᵀ R ũ + x̃ᵀ W x̃) of controls that are held for h, with W the running
    weights and 1/T of the final ones.
    """

    state: Floats  # x* = (q*, 0), shape (nq + n,)
    control: Floats  # u*, shape (nu,)
    gains: Floats  # K, shape (nu, 2n)

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
        u = _find_hold(world, scenario, q)
        if u is None:
            return None
        F, G = _discretize(*_linearize(world, q, u), period)
        W, R = period * _weigh(world, scenario, cost), period * np.diag(cost.R)
        try:  # Drake's solver ends the process where nothing stabilizes.
            value = solve_discrete_are(F, G, W, R)
        except LinAlgError:
            return None
        K = -np.linalg.solve(R + G.T @ value @ G, G.T @ value @ F)
        is_stable = np.max(np.abs(np.linalg.eigvals(F + G @ K))) < 1.0
        still = np.zeros(world.num_velocities)
        return cls(np.concatenate([q, still]), u, K) if is_stable else None


def calc_divergence(world: World, scenario: Scenario) -> float:
    """Returns how fast errors grow at a goal that is an unstable equilibrium [1/s], else 0.

    That is the largest real part of the eigenvalues of the motion about the goal, under the control
    that holds it there.
    """
    goal = scenario.goal_position
    u = _find_hold(world, scenario, goal)
    if u is None:
        return 0.0
    A, _ = _linearize(world, goal, u)
    pace = float(np.max(np.linalg.eigvals(A).real))
    return pace if pace * scenario.duration > _SLOWLY else 0.0


def _find_hold(world: World, scenario: Scenario, q: Floats) -> Floats | None:
    """Returns the control that holds positions q, shape (nu,); None: none does, or q is passed."""
    still = not TaskCost.of(world, scenario).goal_velocity.any()
    if world.dry_friction is not None or not still or np.any(world.calc_clearance(q) <= 0):
        return None
    load, B = world.calc_bias(q, np.zeros(world.num_velocities)), world.actuation
    u = world.inverse_actuation @ load
    low, high = world.bounds(scenario).control
    is_balanced = np.max(np.abs(B @ u - load)) <= _BALANCED * np.max(np.abs(load), initial=1.0)
    return u if is_balanced and np.all((u >= low) & (u <= high)) else None


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


def _discretize(A: Floats, B: Floats, period: float) -> tuple[Floats, Floats]:
    """Returns F and G of a control that is held for a period."""
    size, nu = B.shape
    whole = expm(period * np.block([[A, B], [np.zeros((nu, size + nu))]]))
    return whole[:size, :size], whole[:size, size:]
