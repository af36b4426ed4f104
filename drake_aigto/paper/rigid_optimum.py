"""The exact optimum of a point mass before a rigid wall, by algebra, to judge plans.

It is independent of the planner: no knots, no boxes, no solver, no guesses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import ConstantDynamics
from drake_aigto.errors import ModelError
from drake_aigto.world import Scenario, World


@dataclass(frozen=True)
class RigidOptimum:
    """The least cost of a scenario on a rigid wall, and its motion.

    Attributes:
        cost: control_weight ∫₀ᵀ ‖u(t)‖² dt + goal_weight (q(T) − goal)².
        bounce_times: of touches, at most one [s].
        impact_velocities: φ̇⁻ < 0 of each touch [m/s].
        flight_cost: of the best motion without contact; infinite if the best one without the wall
            meets it.
    """

    cost: float
    bounce_times: tuple[float, ...]
    impact_velocities: tuple[float, ...]
    flight_cost: float


def rigid_optimum(world: World, scenario: Scenario) -> RigidOptimum:
    """Returns the optimum over all controls u(t), whatever the number of impacts.

        minimize   control_weight ∫₀ᵀ ‖u‖² dt + goal_weight (q(T) − goal)²
        subject to m q̈ = B u  while φ(q) > 0,   φ ≥ 0,
                   φ̇⁺ = −e φ̇⁻  when φ = 0, φ̇⁻ ≤ 0;   q(0), v(0) given, v(T) free

    One touch is enough, and rest saves nothing. Up to a touch at time s, and after it, the cheapest
    motion is a cubic; at the best velocity there, the cost is a rational function of s whose slope
    has the sign of a polynomial of degree 8: its roots, and the flight without contact, are
    all candidates. The documentation, "Why the optima are exact", has the proof.

    Args:
        world: one coordinate, no bias, φ affine in q.
        scenario: start, goal, duration, weights and restitution; it has to fit the world.

    Raises:
        ModelError: another kind of world.
        ScenarioError: the scenario does not fit the world (`World.check`).
    """
    world.check(scenario)
    world.check_plain(scenario)
    task, price = _make_task(world, scenario)
    flight_cost = price * task.calc_flight_cost() if task.flight_is_clear() else math.inf
    best = min(task.find_bounces(), default=None)
    if best is None or flight_cost <= price * best.cost:
        return RigidOptimum(flight_cost, (), (), flight_cost)
    T = scenario.duration
    return RigidOptimum(price * best.cost, (best.time * T,), (best.velocity / T,), flight_cost)


def bounce_costs(world: World, scenario: Scenario, times: ArrayLike, speeds: ArrayLike) -> Floats:
    """Returns the least cost of motions that touch a rigid wall once, at a time and a speed.

    In unit time, with x = φ from p at v₀, the cubic to the touch (s, V), and the best flight to the
    goal g after it, where k(τ) = 3w/(3 + wτ³):

        3(p + v₀s)²/s³ + 4(V + (3p + v₀s)/(2s))²/s + k(1 − s) (g + e (1 − s) V)²

    Args:
        world: one coordinate, no bias, φ affine in q.
        scenario: start, goal, duration, weights and restitution; it has to fit the world.
        times: of the touch, in (0, T) [s]; shapes of times and speeds broadcast.
        speeds: −φ̇ > 0 before it [m/s].

    Returns:
        J, of that shape; NaN where the cubic would go through the wall before.

    Raises:
        ModelError: another kind of world.
        ScenarioError: the scenario does not fit the world (`World.check`).
    """
    world.check(scenario)
    world.check_plain(scenario)
    task, price = _make_task(world, scenario)
    s, speed = np.broadcast_arrays(np.asarray(times) / scenario.duration, speeds)
    impact = -speed * scenario.duration
    costs = price * task.calc_bounce_cost(s, impact)
    return np.where(task.way_is_clear(s, impact), costs, np.nan)


class _TouchOnce(NamedTuple):
    """A motion that touches once; all in units of `_UnitTask`."""

    cost: float
    time: float
    velocity: float  # before the touch, at most 0


@dataclass(frozen=True)
class _UnitTask:
    """The problem in unit time: minimize ∫₀¹ ẍ² ds + weight (x(1) − goal)², x ≥ 0."""

    position: float  # p = x(0) > 0 [m]
    velocity: float  # v₀ = ẋ(0) [m]
    goal: float  # g > 0 [m]
    weight: float  # w ≥ 0
    restitution: float  # e

    def calc_flight_cost(self) -> float:
        """Returns the least cost without a wall."""
        return _calc_goal_price(self.weight, 1.0) * self._calc_miss() ** 2

    def flight_is_clear(self) -> bool:
        """Returns whether the motion of that cost stays off the wall."""
        p, v = self.position, self.velocity
        lift = self.weight / (3 + self.weight) * self._calc_miss()
        path = Polynomial([p, v, 1.5 * lift, -0.5 * lift])
        # The path ends above 0 or below it; on the way it has one minimum at most.
        if v >= 0 or lift <= 0 or 3 * lift + 2 * v <= 0:
            return bool(path(1.0) > 0)
        return bool(path(1 - math.sqrt(1 + 2 * v / (3 * lift))) > 0)

    def _calc_miss(self) -> float:
        """Returns the distance of its uncontrolled end to the goal."""
        return self.goal - self.position - self.velocity

    def find_bounces(self) -> Iterator[_TouchOnce]:
        """Yields the stationary motions that touch once; the best touching motion is among them."""
        # In 1/s: early touches, whose delay costs much, are most exact.
        roots = np.roots(self._make_slope().coef)
        # A double root may become a complex pair. The motion of any real part is admissible, so
        # that no cost is too low. The end, 1, is for a ball that reaches the wall at T without
        # control.
        for r in [1.0, *roots.real.tolist()]:
            if r >= max(1.0, -self.velocity / (3 * self.position)):
                yield self._make_bounce(1 / r)

    def _make_bounce(self, s: float) -> _TouchOnce:
        """Returns the cheapest motion that touches at time s, at the bottom of the parabola."""
        p, v, g, e = self.position, self.velocity, self.goal, self.restitution
        left = 1 - s
        free = -(3 * p + v * s) / (2 * s)  # velocity at the wall if it costs nothing
        price = _calc_goal_price(self.weight, left)
        impact = (4 * free - price * s * e * left * g) / (4 + price * s * (e * left) ** 2)
        return _TouchOnce(self.calc_bounce_cost(s, impact), s, impact)

    def calc_bounce_cost(self, s: Any, impact: Any) -> Any:
        """Returns the least cost of touching at time s with velocity V; numbers or arrays."""
        p, v, g, e = self.position, self.velocity, self.goal, self.restitution
        left = 1 - s
        free = -(3 * p + v * s) / (2 * s)
        effort = 3 * (p + v * s) ** 2 / s**3 + 4 * (impact - free) ** 2 / s
        return effort + _calc_goal_price(self.weight, left) * (g + e * left * impact) ** 2

    def way_is_clear(self, s: Floats, impact: Floats) -> Any:
        """Returns whether the cubic to the touch stays off the wall.

        With t in units of s it is (1 − t)(p + (p + v₀s) t − (2p + v₀s + V s) t²).
        """
        p, turn = self.position, -(2 * self.position + self.velocity * s + impact * s)
        slope = p + self.velocity * s
        with np.errstate(divide="ignore", invalid="ignore"):
            bottom = -slope / (2 * turn)
            dips = (turn > 0) & (bottom > 0) & (bottom < 1) & (p < slope**2 / (4 * turn))
        return ~dips

    def _make_slope(self) -> Polynomial:
        """Returns the slope of the least cost over s, times something positive.

        The cost of `_make_bounce` is 3(p + v₀s)²/s³ + 12 w N²/(s² Q). To keep the numbers small
        however large the weight is, w and Q are here both divided by 1 + weight.
        """
        p, v, g, e = self.position, self.velocity, self.goal, self.restitution
        s = Polynomial([0.0, 1.0])
        left = 1 - s
        w = self.weight / (1 + self.weight)
        N = g * s - 0.5 * e * left * (3 * p + v * s)
        Q = 12 / (1 + self.weight) + w * left**2 * (4 * left + 3 * e**2 * s)
        after = 4 * w * s * N * (2 * N.deriv() * s * Q - N * (2 * Q + s * Q.deriv()))
        return after - (p + v * s) * (3 * p + v * s) * Q**2


def _calc_goal_price(weight: float, left: Any) -> Any:
    """Returns k in k D²: the least of effort and goal, a ballistic path missing the goal by D."""
    return 3 * weight / (3 + weight * left**3)


def _make_task(world: World, scenario: Scenario) -> tuple[_UnitTask, float]:
    """Returns the problem in unit time, and its unit of cost."""
    dynamics = _read_line(world)
    start, (J,) = scenario.initial_position, dynamics.jacobian[0]
    (effort,) = calc_efforts(dynamics)
    price = scenario.control_weight * effort / scenario.duration**3
    task = _UnitTask(
        position=float(world.calc_signed_distance(start)[0]),
        velocity=float(J * scenario.initial_velocity[0] * scenario.duration),
        goal=float(world.calc_signed_distance(scenario.goal_position)[0]),
        weight=float(scenario.goal_weight / price),
        restitution=scenario.restitution,
    )
    return task, float(price / J**2)


def _read_line(world: World) -> ConstantDynamics:
    """Returns the dynamics of a point mass on a line; refuses others."""
    if world.num_positions != 1:
        raise refuse_world(f"{world.num_positions} coordinates", "one coordinate")
    dynamics = world.constant_dynamics
    if np.any(dynamics.bias):
        raise refuse_world(f"a bias h(q, v) = {world.bias[0]}", "none")
    return dynamics


def refuse_world(got: object, expected: str) -> ModelError:
    """Returns the error of a world without a known optimum."""
    remedy = "For other worlds no exact optimum is known here; judge a plan by its replays."
    return ModelError("the exact optimum", str(got), expected, remedy)


def calc_efforts(dynamics: ConstantDynamics) -> Floats:
    """Returns the least ‖u‖² for an acceleration of 1 along each axis, M_ii² / ‖B_i‖², (nv,).

    Raises:
        ModelError: M or B Bᵀ is not diagonal, so that axes are not on their own; or one of them
            has no actuator.
    """
    squares = dynamics.actuation @ dynamics.actuation.T
    for name, matrix in (("M", dynamics.mass_matrix), ("B Bᵀ", squares)):
        if np.any(matrix != np.diag(np.diag(matrix))):
            raise refuse_world(f"{name} = {matrix.tolist()}", "a diagonal matrix")
    if not np.all(np.diag(squares)):
        raise refuse_world("a coordinate without an actuator", "one for each")
    return np.diag(dynamics.mass_matrix) ** 2 / np.diag(squares)
