"""Lower bounds of plans between rigid walls, over all controls and all numbers of bounces.

A mass that walls across its axes push along these alone is as many masses on a line. On one, in
unit time, with ∫ ẍ² priced at 1 and the goal at w, a flight with time τ left costs k(τ) D² or more,
k = 3w/(3 + wτ³), with D the distance from the goal to where the uncontrolled motion ends.

- Elastic walls are mirrors: D is the distance to the nearest of the goal's images.
- Beside one other wall it flies, or touches the wall first at time s and speed a, at no less than

      3(2p + (v − a)s)²/s³ + (a + v)²/s + k(1 − s)(g − ea(1 − s))²:

  a cubic up to there and a flight from there on, as touching again is never cheaper ("Why the
  optima are exact" in the documentation). Branch and bound over (s, a) bounds the least.
- Between two walls, and under a constant force, `touches` bounds it.

Let all masses be alike, so that a touch without loss mirrors the motion at its plane n·q + d = 0:
that of a wall, however askew, or q_j − q_i = 0. Where all planes are parallel or meet at angles
π/k, they cut space into copies of the room, each a mirror image of the next (Coxeter 1934, Ann.
Math. 35:588). A motion unfolds to a flight to one of the goal's images; of all images of two places
of the room, these places themselves are nearest to each other (Humphreys 1990, "Reflection Groups
and Coxeter Groups", 1.12). So D is the goal's distance from where the uncontrolled motion ends,
folded into the room.

That no motion meets a hard goal is proven by how far bounded controls bring a mass at all. Along an
axis that walls push along on their own, accelerations are within [a, b], whatever the control.
Without a wall, x(T) is between x + vT + aT²/2 and x + vT + bT²/2. At y above one wall that the mass
always falls towards, P = −a ≥ p = −b > 0, it touches by (v + √(v² + 2py))/p. The touch is no faster
than s, s² = v² + 2Py, or s² = 2P (y + v²/2p) if the mass rises at first; so it comes no higher than
e²s²/2p after it. If e²P ≤ p, the next touch is no faster than s either, and so on. Friction leaves
such an axis alone if its impulses change no speed along it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.solvers import ExpressionCost, MathematicalProgram

from drake_aigto.arrays import Floats
from drake_aigto.certify.certificate import certify
from drake_aigto.certify.flights import Line, Wall, direct_cost, goal_price
from drake_aigto.certify.touches import bound_line
from drake_aigto.dynamics import ConstantDynamics, evaluate, is_constant
from drake_aigto.errors import ModelError
from drake_aigto.simulation import NOTHING
from drake_aigto.world import Scales, Scenario, World

_CELLS = 20_000
_GAP = 1e-4  # of the bound over times and speeds of a touch
# Distances, velocities and prices are rounded: bounds give way by this part, and by this part of
# the scenario's scale, which is what an error of some 10⁻¹³ of its length costs.
_ROUNDING = 1e-9
_NO_COST = 1e-6  # of the scale: below it, a gap is relative to the scale
_MOST_FOLDS = 10_000
_ANGLE = 1e-9  # [rad], which moves no image by more than what bounds give way by
_LEAST_ANGLE = 12  # π over this

Interval = tuple[float, float]


@dataclass(frozen=True)
class PlanBound:
    """Lower bound of the cost of any plan.

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
        """Whether the bound is 0 at the task's scale."""
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
    """Returns why a scenario is not one of lines between walls, or an empty string."""
    if scenario.contact != "rigid":
        return "compliant walls have no images, and their motions no closed form"
    if not scenario.is_plain:
        return f"the task asks for more than effort and goal: {', '.join(scenario.extras)}"
    if world.is_hinge.any():
        return "hinges turn, so that flights are no cubics"
    try:
        world.rubbing.check_none(scenario.friction)
        dynamics = world.constant_dynamics
    except ModelError as error:
        return f"friction, or dynamics that vary: {error}"
    if len(dynamics.solids) != len(world.contacts):
        return "what is no wall but a block can be passed on several sides"
    if _is_coupled(dynamics):
        why = _obstacle_to_mirrors(dynamics, world.restitutions(scenario))
        return f"a wall askew, or two masses that touch, couple the axes; {why}" if why else ""
    worth = dynamics.gain @ dynamics.gain.T
    if np.any(np.abs(worth - np.diag(np.diag(worth))) > 0.0) or np.any(np.diag(worth) <= 0.0):
        return "controls act on several axes at once, or not on all"
    sides = [(int(np.flatnonzero(J)[0]), bool(np.sum(J) > 0.0)) for J in dynamics.jacobian]
    return "two walls are on one side" if len(set(sides)) < len(sides) else ""


def _is_coupled(dynamics: ConstantDynamics) -> bool:
    """Returns whether a touch changes speed along several axes."""
    return bool(np.any(np.count_nonzero(dynamics.jacobian, axis=1) != 1))


def _obstacle_to_mirrors(dynamics: ConstantDynamics, restitutions: Floats) -> str:
    """Returns why touches are no mirrors of a kaleidoscope, or an empty string."""
    if np.any(restitutions != 1.0):
        return "touches take energy away"
    if np.any(dynamics.drift):
        return "a force bends what flies"
    worth = dynamics.gain @ dynamics.gain.T
    if not (_is_alike(dynamics.inverse_mass) and _is_alike(worth)):
        return "masses or what drives them are not alike"
    unit = dynamics.jacobian / np.linalg.norm(dynamics.jacobian, axis=1, keepdims=True)
    cosines = np.clip(-(unit @ unit.T)[np.triu_indices(len(unit), 1)], -1.0, 1.0)
    angles = [0.0, *(math.pi / k for k in range(2, _LEAST_ANGLE + 1))]
    if any(min(abs(angle - own) for own in angles) > _ANGLE for angle in np.arccos(cosines)):
        return "they meet at an angle that is no whole part of 180°"
    return ""


def _is_alike(matrix: Floats) -> bool:
    """Returns whether a matrix is a number times the identity, and more than 0."""
    return bool(matrix[0, 0] > 0.0 and np.all(matrix == matrix[0, 0] * np.eye(len(matrix))))


def fold(point: Floats, normals: Floats, offsets: Floats) -> Floats | None:
    """Returns the image of a point within a room, or None if it is too many mirrors away.

    Args:
        point: shape (n,).
        normals: of the mirrors, into the room (m, n).
        offsets: n·q + offset is 0 at each mirror, more in the room (m,).
    """
    folded = np.array(point, dtype=float)
    squares = np.sum(normals**2, axis=1)
    for _ in range(_MOST_FOLDS):
        heights = normals @ folded + offsets
        lowest = int(np.argmin(heights / np.sqrt(squares))) if heights.size else -1
        if lowest < 0 or heights[lowest] >= 0.0:
            return folded
        folded -= 2.0 * heights[lowest] / squares[lowest] * normals[lowest]
    return None


def _mirrored(world: World, scenario: Scenario) -> float:
    """Returns the cost of a flight to the nearest image of the goal."""
    dynamics, T = world.constant_dynamics, scenario.duration
    end = scenario.initial_position + T * scenario.initial_velocity
    folded = fold(end, dynamics.jacobian, dynamics.offset)
    if folded is None:
        return 0.0
    worth = float((dynamics.gain @ dynamics.gain.T)[0, 0])
    price = float(scenario.control_weight / (T**3 * worth))
    miss = float(np.sum((scenario.goal_position - folded) ** 2))
    return price * goal_price(float(scenario.goal_weight / price)) * miss


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
    is_lossy = any(wall.restitution < 1.0 for wall in line.walls)
    if (line.drift and line.walls) or (is_lossy and len(line.walls) > 1):
        return bound_line(line, most)
    if not is_lossy:
        sides = np.array([[float(wall.side)] for wall in line.walls]).reshape(-1, 1)
        offsets = np.array([-wall.side * wall.position for wall in line.walls])
        folded = fold(np.array([line.goal - line.miss]), sides, offsets)
        miss = 0.0 if folded is None else line.goal - float(folded[0])
        return goal_price(line.weight) * miss**2
    return min(most, direct_cost(line), _touch_bound(line, line.walls[0], most))


def _touch_bound(line: Line, wall: Wall, most: float) -> float:
    """Returns a bound of motions that touch the only wall."""
    p = wall.side * (line.position - wall.position)
    v, goal = wall.side * line.velocity, wall.side * (line.goal - wall.position)
    # Faster touches cost more than the most by the change of speed alone.
    fastest = math.sqrt(most) * (1.0 + 1e-9) - v
    if fastest < 0.0 or most <= 0.0:
        return most
    prog = MathematicalProgram()
    s, a = prog.NewContinuousVariables(1, "time")[0], prog.NewContinuousVariables(1, "speed")[0]
    prog.AddBoundingBoxConstraint([0.0, 0.0], [1.0, fastest], [s, a])
    left, after = 1.0 - s, wall.restitution * a * (1.0 - s)
    way = 2.0 * p + (v - a) * s
    before = 3.0 * way**2 / s**3 + (a + v) ** 2 / s
    rest = 3.0 * line.weight / (3.0 + line.weight * left**3) * (goal - after) ** 2
    cost = ExpressionCost((before + rest) / most)
    prog.AddCost(cost, vars=cost.vars())
    return most * certify(prog, gap=_GAP, cells=_CELLS).lower_bound


def out_of_reach(world: World, scenario: Scenario) -> str:
    """Returns why no motion meets the hard goal of a scenario; empty if that is not proven.

    Args:
        world: the scenario's.
        scenario: the question.
    """
    if not scenario.hard_goal or scenario.contact != "rigid" or world.is_hinge.any():
        return ""
    try:
        world.rubbing.check_none(scenario.friction, first=world.num_contacts)
        rough = np.flatnonzero(world.friction_coefficients(scenario))
        slips = world.rubbing.tangents[rough] if rough.size else np.zeros((0, world.num_velocities))
        dynamics = world.constant_dynamics
    except ModelError:
        return ""
    if not is_constant(slips):
        return ""
    low, high = _accelerations(world, scenario, dynamics)
    # Searches with friction keep what ends this near, in simulation.
    near = NOTHING * Scales.of(world, scenario).length if rough.size else 0.0
    is_rubbed = np.any(evaluate(slips) @ dynamics.inverse_mass.T, axis=0)
    for axis in np.flatnonzero(~is_rubbed).tolist():
        walls = np.flatnonzero(dynamics.kicks[:, axis])
        start = float(scenario.initial_position[axis]), float(scenario.initial_velocity[axis])
        goal, forces = float(scenario.goal_position[axis]), (float(low[axis]), float(high[axis]))
        reach, after = _free_reach(start, forces, scenario), ""
        if walls.size == 1:
            found = _reach_above(int(walls[0]), axis, world, scenario, forces)
            reach, after = found if found is not None else ((-math.inf, math.inf), "")
        elif walls.size:
            continue
        if not reach[0] - near <= goal <= reach[1] + near:
            name, unit = world.plant.GetPositionNames()[axis], world.position_unit
            low_end, high_end = (f"{round(end, 6) + 0.0:.4g}" for end in reach)
            span = f"from {low_end} to {high_end}" if low_end != high_end else f"to {low_end}"
            return (
                f"{name} has to come to {goal:g} {unit}, and {after}no control brings it anywhere "
                f"but {span} {unit}"
            )
    return ""


def _accelerations(
    world: World, scenario: Scenario, dynamics: ConstantDynamics
) -> tuple[Floats, Floats]:
    """Returns the least and the largest acceleration of each coordinate without contact (nv,)."""
    gain, control = dynamics.gain, world.limits.narrowed(scenario).control
    with np.errstate(invalid="ignore"):
        ends = np.where(gain == 0.0, 0.0, gain * control[:, None, :])
    low, high = np.min(ends, axis=0).sum(axis=1), np.max(ends, axis=0).sum(axis=1)
    if scenario.control_norm is not None:
        most = scenario.control_norm * np.linalg.norm(gain, axis=1)
        low, high = np.maximum(low, -most), np.minimum(high, most)
    return dynamics.drift + low, dynamics.drift + high


def _free_reach(start: Interval, forces: Interval, scenario: Scenario) -> Interval:
    """Returns the range of a coordinate at the end, without contact along it."""
    x, v = start
    first, last = scenario.duration_range or (scenario.duration, scenario.duration)
    ends = []
    for force, pick in zip(forces, (min, max), strict=True):
        turn = min(max(-v / force, first), last) if force else first
        ends.append(pick(x + v * T + 0.5 * force * T**2 for T in (first, turn, last)))
    slack = _ROUNDING * (abs(x) + abs(v) * last + max(map(abs, ends)))
    return ends[0] - slack, ends[1] + slack


def _reach_above(
    wall: int, axis: int, world: World, scenario: Scenario, forces: Interval
) -> tuple[Interval, str] | None:
    """Returns the range of a coordinate at the end above a wall that it falls towards, and why.

    None if walls of several faces, or several coordinates, or forces away from it are in play.
    """
    dynamics = world.constant_dynamics
    slope = float(dynamics.jacobian[wall, axis])
    if np.count_nonzero(dynamics.jacobian[wall]) != 1 or (wall,) not in dynamics.solids:
        return None
    y = float(slope * scenario.initial_position[axis] + dynamics.offset[wall])
    v = float(slope * scenario.initial_velocity[axis])
    least, most = sorted(-slope * force for force in forces)
    e = float(world.restitutions(scenario)[wall])
    if least <= 0.0 or not math.isfinite(most) or e**2 * most > least:
        return None
    square = 2.0 * most * (y + v**2 / (2.0 * least)) if v > 0.0 else v**2 + 2.0 * most * y
    highest = e**2 * square / (2.0 * least)
    touch = (v + math.sqrt(v**2 + 2.0 * least * y)) / least
    first = scenario.duration if scenario.duration_range is None else scenario.duration_range[0]
    after = f"after the touch that comes by {touch:.4g} s, " if touch else ""
    if first <= touch * (1.0 + _ROUNDING):
        free = _free_reach((y, v), (-most, -least), scenario)
        highest, after = max(highest, free[1]), ""
    highest += _ROUNDING * (abs(y) + highest)
    offset = float(dynamics.offset[wall])
    ends = sorted(((-_ROUNDING * (abs(y) + highest) - offset) / slope, (highest - offset) / slope))
    return (ends[0], ends[1]), after
