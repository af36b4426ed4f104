"""Lower bounds of plans between rigid walls, over all controls and all numbers of bounces.

A mass that walls across its axes push along these alone is as many masses on a line. On one, in
unit time, with ∫ ẍ² priced at 1, the goal at w, and k(τ) = 3w/(3 + wτ³):

- Without walls, the cost is k(1) D² at least, D how far from the goal it coasts to.
- Elastic walls are mirrors: any motion is a flight without walls to one of the goal's images, so
  that D is the distance to the nearest image (`mirrors`, where touches couple the axes, too).
- Else it touches nothing, which is a flight; or it touches a wall first, at time s and speed a. Up
  to there, a cubic is the cheapest motion:

      3(2p + (v − a)s)²/s³ + (a + v)²/s

  and with τ = 1 − s left it never comes to another wall, L away, at no less than a flight,
  k(τ)(g − eaτ)², as touching the same wall again is never cheaper ("Why the optima are exact" in
  the documentation); or it does. Touches take speed away, so that the way asks for L ≤ eaτ +
  ∫(τ − t)|ẍ|, and for 3 max(0, L − eaτ)²/τ³. Branch and bound over (s, a) bounds the least.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pydrake.symbolic as sym
from pydrake.solvers import ExpressionCost, MathematicalProgram

from drake_aigto.certify.certificate import Certifier
from drake_aigto.certify.lines import Line, Wall
from drake_aigto.certify.mirrors import fold, obstacle_to_mirrors
from drake_aigto.certify.touches import bound_line
from drake_aigto.errors import ModelError
from drake_aigto.world import ConstantDynamics, Scales, Scenario, World

_CELLS = 20_000
_GAP = 1e-4  # of the bound over times and speeds of a touch
# Distances, velocities and prices are rounded: bounds give way by this part, and by this part of
# the scenario's scale, which is what an error of some 10⁻¹³ of its length costs.
_ROUNDING = 1e-9
# A flight that passes through a wall by this part of the length is none.
_INSIDE = 1e-9
_NO_COST = 1e-6  # of the scale: below it, a gap is relative to the scale


@dataclass(frozen=True)
class PlanBound:
    """What any plan costs at least.

    Attributes:
        lower_bound: over all controls, held between knots or not; None if none was found.
        reason: why there is none, or an empty string.
        scale: of the scenario's cost.
    """

    lower_bound: float | None
    reason: str
    scale: float

    def gap(self, cost: float) -> float | None:
        """Returns (cost − bound) / cost, or relative to the scale where the bound is 0."""
        if self.lower_bound is None:
            return None
        size = self.scale if self.is_nothing else cost
        return max(0.0, cost - self.lower_bound) / size

    @property
    def is_nothing(self) -> bool:
        """Whether the bound is 0, but for what does not count at the task's scale."""
        return self.lower_bound is not None and self.lower_bound <= _NO_COST * self.scale


def bound_plans(world: World, scenario: Scenario, cost: float) -> PlanBound:
    """Returns a lower bound of the cost of all plans of a scenario.

    Args:
        world: the scenario's.
        scenario: the question.
        cost: of a plan that is known.
    """
    scale = Scales.of(world, scenario).cost
    reason = _obstacle(world, scenario)
    if reason:
        return PlanBound(None, reason, scale)
    if _is_coupled(world.constant_dynamics):
        total = _mirrored(world, scenario)
    else:
        lines = _make_lines(world, scenario)
        total = sum(line.price * _bound(line, cost / line.price) for line in lines)
    least = max(0.0, total * (1.0 - _ROUNDING) - _ROUNDING * 1e-3 * scale)
    return PlanBound(min(least, cost), "", scale)


def _obstacle(world: World, scenario: Scenario) -> str:
    """Returns why a scenario is none of lines between walls, or an empty string."""
    if scenario.contact != "rigid":
        return "walls that give way have no images, and their motions no closed form"
    if not scenario.is_plain:
        return f"the task asks for more than effort and goal: {', '.join(scenario.extras)}"
    if world.is_hinge.any():
        return "hinges turn, so that flights are no cubics"
    try:
        world.check_frictionless(scenario)
        dynamics = world.constant_dynamics
    except ModelError as error:
        return f"friction, or dynamics that vary: {error}"
    if len(dynamics.solids) != len(world.contacts):
        return "what is no wall but a block can be passed on several sides"
    if _is_coupled(dynamics):
        why = obstacle_to_mirrors(dynamics, world.restitutions(scenario))
        return f"a wall askew, or two masses that touch, couple the axes; {why}" if why else ""
    worth = dynamics.gain @ dynamics.gain.T
    if np.any(np.abs(worth - np.diag(np.diag(worth))) > 0.0) or np.any(np.diag(worth) <= 0.0):
        return "controls act on several axes at once, or not on all"
    return _odd_walls(dynamics)


def _is_coupled(dynamics: ConstantDynamics) -> bool:
    """Returns whether a touch changes speed along several axes."""
    return bool(np.any(np.count_nonzero(dynamics.jacobian, axis=1) != 1))


def _mirrored(world: World, scenario: Scenario) -> float:
    """Returns the cost of a flight to the nearest image of the goal."""
    dynamics, T = world.constant_dynamics, scenario.duration
    coast = scenario.initial_position + T * scenario.initial_velocity
    folded = fold(coast, dynamics.jacobian, dynamics.offset)
    if folded is None:
        return 0.0
    worth = float((dynamics.gain @ dynamics.gain.T)[0, 0])
    price = float(scenario.control_weight / (T**3 * worth))
    miss = float(np.sum((scenario.goal_position - folded) ** 2))
    return price * _goal_price(float(scenario.goal_weight / price)) * miss


def _odd_walls(dynamics: ConstantDynamics) -> str:
    sides = [(int(np.flatnonzero(J)[0]), bool(np.sum(J) > 0.0)) for J in dynamics.jacobian]
    return "two walls are on one side" if len(set(sides)) < len(sides) else ""


def _make_lines(world: World, scenario: Scenario) -> Iterator[Line]:
    dynamics, T = world.constant_dynamics, scenario.duration
    worth = np.diag(dynamics.gain @ dynamics.gain.T)
    restitutions = world.restitutions(scenario)
    for axis in range(world.num_positions):
        walls = [
            Wall(float(-offset / J[axis]), 1 if J[axis] > 0.0 else -1, float(e))
            for J, offset, e in zip(dynamics.jacobian, dynamics.offset, restitutions, strict=True)
            if J[axis]
        ]
        price = float(scenario.control_weight / (T**3 * worth[axis]))
        yield Line(
            position=float(scenario.initial_position[axis]),
            velocity=float(scenario.initial_velocity[axis] * T),
            goal=float(scenario.goal_position[axis]),
            weight=float(scenario.goal_weight / price),
            price=price,
            walls=tuple(walls),
            drift=float(dynamics.drift[axis] * T**2),
        )


def _bound(line: Line, most: float) -> float:
    """Returns a bound of the cost on a line, if it is no more than the most that is of interest."""
    if line.drift and line.walls:
        return bound_line(line, most)
    if all(wall.restitution == 1.0 for wall in line.walls):
        sides = np.array([[float(wall.side)] for wall in line.walls]).reshape(-1, 1)
        offsets = np.array([-wall.side * wall.position for wall in line.walls])
        folded = fold(np.array([line.goal - line.miss]), sides, offsets)
        miss = 0.0 if folded is None else line.goal - float(folded[0])
        return _goal_price(line.weight) * miss**2
    found = [_touch_bound(line, wall, most) for wall in line.walls]
    if not _passes_wall(line):
        found.append(_goal_price(line.weight) * line.miss**2)
    return min(most, *found)


def _goal_price(weight: float) -> float:
    return 3.0 * weight / (3.0 + weight)


def _passes_wall(line: Line) -> bool:
    """Returns whether the cheapest flight goes through a wall, so that it is none.

    The cheapest motion that touches nothing then touches a wall, and is bounded as one that does.
    """
    lift = line.weight / (3.0 + line.weight) * line.miss
    path = np.polynomial.Polynomial([line.position, line.velocity, 1.5 * lift, -0.5 * lift])
    turns = [root.real for root in np.atleast_1d(path.deriv().roots()) if abs(root.imag) < 1e-9]
    times = np.array([1.0, *(time for time in turns if 0.0 < time < 1.0)])
    length = abs(line.goal - line.position) + abs(line.velocity)
    return any(
        np.min(wall.side * (path(times) - wall.position)) < -_INSIDE * length for wall in line.walls
    )


def _touch_bound(line: Line, wall: Wall, most: float) -> float:
    """Returns a bound of motions whose first touch is of a wall."""
    p = wall.side * (line.position - wall.position)
    v, goal = wall.side * line.velocity, wall.side * (line.goal - wall.position)
    # Faster touches cost more than the most by the change of speed alone.
    fastest = math.sqrt(most) * (1.0 + 1e-9) - v
    if fastest < 0.0:
        return most
    prog = MathematicalProgram()
    s, a = prog.NewContinuousVariables(1, "time")[0], prog.NewContinuousVariables(1, "speed")[0]
    prog.AddBoundingBoxConstraint([0.0, 0.0], [1.0, fastest], [s, a])
    left, after = 1.0 - s, wall.restitution * a * (1.0 - s)
    way = 2.0 * p + (v - a) * s
    before = 3.0 * way**2 / s**3 + (a + v) ** 2 / s
    rest = 3.0 * line.weight / (3.0 + line.weight * left**3) * (goal - after) ** 2
    for other in line.walls:
        if other is not wall:
            distance = abs(other.position - wall.position)
            rest = sym.min(rest, 3.0 * sym.max(0.0, distance - after) ** 2 / left**3)
    cost = ExpressionCost(before + rest)
    prog.AddCost(cost, vars=cost.vars())
    found = Certifier(prog, gap=_GAP).run(_CELLS, lambda _: None)
    return found.lower_bound
