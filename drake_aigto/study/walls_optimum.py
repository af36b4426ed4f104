"""The exact optimum of point masses between walls, axis by axis: corridor, floor and room."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_aigto.errors import ModelError
from drake_aigto.study.line_optimum import Line, LineMotion, Wall
from drake_aigto.world import Scenario, World

Floats = NDArray[np.float64]


@dataclass(frozen=True, order=True)
class KnownTouch:
    """One contact of the optimum.

    Attributes:
        start: when it begins [s].
        end: when it is left [s]; equal to `start` for a bounce.
        contact: which of the world's contacts.
        impact_speed: −φ̇⁻ ≥ 0 [m/s]; 0 where it comes to rest.
    """

    start: float
    end: float
    contact: int
    impact_speed: float

    @property
    def lasts(self) -> bool:
        """Whether it is more than a bounce."""
        return self.end > self.start


@dataclass(frozen=True)
class ContactOptimum:
    """The least cost of a scenario, and the contacts that it takes.

    Attributes:
        cost: control_weight ∫₀ᵀ ‖u(t)‖² dt + goal_weight ‖q(T) − goal‖².
        touches: in the order of time. Where the mass settles by bounces of less and less height,
            the first of them, and the rest.
    """

    cost: float
    touches: tuple[KnownTouch, ...]

    @property
    def contacts(self) -> tuple[int, ...]:
        """Which contact each touch is."""
        return tuple(touch.contact for touch in self.touches)


def walls_optimum(world: World, scenario: Scenario, most_touches: int = 6) -> ContactOptimum:
    """Returns the optimum over all controls u(t), whatever the contacts.

        minimise   control_weight ∫₀ᵀ ‖u‖² dt + goal_weight ‖q(T) − goal‖²
        subject to m_i q̈_i + h_i = B_i u  while φ > 0,   φ ≥ 0,
                   φ̇⁺ = −e φ̇⁻  when φ = 0, φ̇⁻ ≤ 0;   q(0), v(0) given, v(T) free

    *Axes.* A frictionless wall across an axis pushes along that axis only. If moreover M and B Bᵀ
    are diagonal and h is constant, then dynamics, contacts and cost of one coordinate know nothing
    of the others: the optimum of a room is the sum of the optima of two corridors.

    *One axis.* In unit time, between touches the cheapest flight is a cubic, whose effort is a
    rational function of the times and speeds of the touches (`Flights`). So each contact sequence
    is a small smooth problem: Newton's method, from dozens of starts, on times and speeds together.
    Sequences are listed:

    - *Without gravity* a touch has a speed > 0, and rest never pays: the cost is a parabola in the
      speed y of a touch, with its bottom y > 0 unless the flight to it, or the one after, meets the
      wall before; and after a rest the cheapest way is straight to the goal, for at the other wall
      one would have come past it; so one leaves at once, and touches at y = 0. Touches alternate
      between walls: with one wall, that is proven at `rigid_optimum`; with two, checked against
      all sequences of four touches, and for e = 1 exact (below). Longer sequences are tried until
      the way from wall to wall alone costs more than the best.
    - *Under gravity* all sequences up to `most_touches`, and those of up to three touches with a
      rest. A mass settles by itself, at no cost, in 2ey/(g(1 − e)); two rests would be one.

    *Elastic walls are mirrors.* For e = 1 and without gravity the cost is that of the flight
    without walls to an image of the goal, and the nearest one is in the same image of the corridor
    as where the mass would coast to: so the optimum is k (fold(p + vT) − goal)², and touches what
    coasting touches, as often. The tests hold this against the enumeration.

    Args:
        world: constant bias, diagonal M and B Bᵀ; each contact a wall across one axis, at most one
            on each side.
        scenario: start, goal, duration, weights and restitution; it has to fit the world.
        most_touches: of one axis under gravity.

    Raises:
        ModelError: another kind of world.
        ScenarioError: the scenario does not fit the world (`World.check`).
    """
    world.check(scenario)
    _check_world(world)
    walls = _find_walls(world, scenario)
    cost, touches = 0.0, []
    for axis, found in enumerate(walls):
        line, price = _make_line(world, scenario, axis, [wall for _, wall in found])
        motion = line.optimum(most_touches)
        cost += price * motion.cost
        touches += _make_touches(motion, [contact for contact, _ in found], world, scenario)
    return ContactOptimum(cost, tuple(sorted(touches)))


def _find_walls(world: World, scenario: Scenario) -> list[list[tuple[int, Wall]]]:
    """Returns the contacts of each axis and where they are, the lower wall first."""
    q = scenario.initial_position
    distances, jacobian = world.calc_signed_distance(q), world.calc_contact_jacobian(q)
    restitutions = world.restitutions(scenario)
    walls: list[list[tuple[int, Wall]]] = [[] for _ in q]
    for contact, J in enumerate(jacobian):
        axis = int(np.argmax(np.abs(J)))
        side = 1 if J[axis] > 0 else -1
        place = q[axis] - distances[contact] / J[axis]
        walls[axis].append((contact, Wall(float(place), side, float(restitutions[contact]))))
    for found in walls:
        found.sort(key=lambda each: -each[1].side)
        sides = [wall.side for _, wall in found]
        if len(set(sides)) < len(sides):
            names = " and ".join(world.contacts[contact].name for contact, _ in found)
            raise _refuse(f"{names} on one side", "one wall on each side at most")
    return walls


def _make_line(
    world: World, scenario: Scenario, axis: int, walls: list[Wall]
) -> tuple[Line, float]:
    """Returns one axis in unit time, and what its unit of cost is worth.

    The least ‖u‖² for a force f is f² / ‖B_i‖².
    """
    T, m = scenario.duration, float(world.mass_matrix_values[axis, axis])
    effort = m**2 / float(np.sum(world.actuation[axis] ** 2))
    price = scenario.control_weight * effort / T**3
    start, zeros = scenario.initial_position, np.zeros(world.num_actuators)
    fall = -world.calc_acceleration(start, scenario.initial_velocity, zeros)[axis]
    line = Line(
        position=float(start[axis]),
        velocity=float(scenario.initial_velocity[axis] * T),
        goal=float(scenario.goal_position[axis]),
        weight=float(scenario.goal_weight / price),
        gravity=float(fall * T**2),
        walls=tuple(walls),
    )
    return line, price


def _make_touches(
    motion: LineMotion, contacts: list[int], world: World, scenario: Scenario
) -> list[KnownTouch]:
    """Returns the touches of one axis, in the scenario's units."""
    T = scenario.duration
    slopes = np.sum(np.abs(world.calc_contact_jacobian(scenario.initial_position)), axis=1)
    touches = []
    for time, wall, speed in motion.bounces:
        contact = contacts[wall]
        touches.append(KnownTouch(time * T, time * T, contact, float(slopes[contact]) * speed / T))
    if motion.rest is not None:
        start, end, wall = motion.rest
        touches.append(KnownTouch(start * T, end * T, contacts[wall], 0.0))
    return touches


def _refuse(got: object, expected: str) -> ModelError:
    remedy = "For other worlds no exact optimum is known here; judge a plan by its replays."
    return ModelError("the exact optimum", str(got), expected, remedy)


def _check_world(world: World) -> None:
    """Refuses what does not fall apart into axes, and walls that are not across one."""
    for h in world.bias:
        if not h.GetVariables().empty():
            raise _refuse(f"a bias h(q, v) = {h}", "a constant")
    squares = world.actuation @ world.actuation.T
    for name, matrix in (("M", world.mass_matrix_values), ("B Bᵀ", squares)):
        if np.any(matrix != np.diag(np.diag(matrix))):
            raise _refuse(f"{name} = {matrix.tolist()}", "a diagonal matrix")
    if not np.all(np.diag(squares)):
        raise _refuse("a coordinate without an actuator", "one for each")
    for contact in world.contacts:
        _check_wall(contact.name, contact.jacobian)
    solids = [contact.solid for contact in world.contacts]
    if len(set(solids)) < len(solids):
        raise _refuse("a box with several faces", "walls")


def _check_wall(name: str, jacobian: NDArray[Any]) -> None:
    """Refuses a contact whose distance does not change with one coordinate alone, evenly."""
    if any(not slope.GetVariables().empty() for slope in jacobian):
        raise _refuse(f"∂φ/∂q = {list(map(str, jacobian))} of {name}", "a constant")
    if sum(not slope.EqualTo(0.0) for slope in jacobian) != 1:
        raise _refuse(f"∂φ/∂q = {list(map(str, jacobian))} of {name}", "a wall across one axis")
