"""The exact optimum of point masses between walls, axis by axis: corridor, floor and room."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.optima.line_optimum import Line, LineMotion, Wall
from drake_aigto.dynamics import ConstantDynamics
from drake_aigto.paper import calc_efforts, refuse_world
from drake_aigto.world import Scenario, World


@dataclass(frozen=True, order=True)
class KnownTouch:
    """One contact of the optimum."""

    start: float  # when it begins [s]
    end: float  # when it is left [s]; equal to `start` for a bounce
    contact: int  # which of the world's contacts
    impact_speed: float  # −φ̇⁻ ≥ 0 [m/s]; 0 where it comes to rest

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

        minimize   control_weight ∫₀ᵀ ‖u‖² dt + goal_weight ‖q(T) − goal‖²
        subject to m_i q̈_i + h_i = B_i u  while φ > 0,   φ ≥ 0,
                   φ̇⁺ = −e φ̇⁻  when φ = 0, φ̇⁻ ≤ 0;   q(0), v(0) given, v(T) free

    The axes know nothing of each other, so that the optimum is the sum of theirs. On one, in unit
    time, the cheapest flight between touches is a cubic (`Flights`), so that each contact sequence
    is a small smooth problem: Newton's method, from dozens of starts, on times and speeds together.
    Sequences are listed. Without gravity rest never pays, touches alternate between walls, and
    longer ones are tried until the way from wall to wall alone costs more than the best. Under
    gravity, those of up to `most_touches`, and of up to three with a rest. The documentation, "Why
    the optima are exact", has the proofs, and says what was checked instead.

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
    world.check_plain(scenario)
    dynamics = world.constant_dynamics
    efforts, walls = calc_efforts(dynamics), _find_walls(world, scenario)
    cost, touches = 0.0, []
    for axis, found in enumerate(walls):
        price = scenario.control_weight * efforts[axis] / scenario.duration**3
        line = _make_line(dynamics, scenario, axis, [wall for _, wall in found], price)
        motion = line.optimum(most_touches)
        cost += price * motion.cost
        contacts = [contact for contact, _ in found]
        touches += _make_touches(motion, contacts, dynamics, scenario.duration)
    return ContactOptimum(cost, tuple(sorted(touches)))


def _find_walls(world: World, scenario: Scenario) -> list[list[tuple[int, Wall]]]:
    """Returns the contacts of each axis and where they are, the lower wall first."""
    dynamics, restitutions = world.constant_dynamics, world.restitutions(scenario).tolist()
    if world.num_solids < world.num_contacts:
        raise refuse_world("a box with several faces", "walls")
    walls: list[list[tuple[int, Wall]]] = [[] for _ in dynamics.mass_matrix]
    for i, (J, offset) in enumerate(zip(dynamics.jacobian, dynamics.offset, strict=True)):
        if np.count_nonzero(J) != 1:
            got = f"∂φ/∂q = {J.tolist()} of {world.contacts[i].name}"
            raise refuse_world(got, "a wall across one axis")
        axis = int(np.argmax(np.abs(J)))
        wall = Wall(float(-offset / J[axis]), 1 if J[axis] > 0 else -1, restitutions[i])
        walls[axis].append((i, wall))
    for found in walls:
        found.sort(key=lambda each: -each[1].side)
        sides = [wall.side for _, wall in found]
        if len(set(sides)) < len(sides):
            names = " and ".join(world.contacts[contact].name for contact, _ in found)
            raise refuse_world(f"{names} on one side", "one wall on each side at most")
    return walls


def _make_line(
    dynamics: ConstantDynamics, scenario: Scenario, axis: int, walls: list[Wall], price: float
) -> Line:
    """Returns one axis in unit time, where a unit of cost is worth the price."""
    T = scenario.duration
    return Line(
        position=float(scenario.initial_position[axis]),
        velocity=float(scenario.initial_velocity[axis] * T),
        goal=float(scenario.goal_position[axis]),
        weight=float(scenario.goal_weight / price),
        gravity=float(-dynamics.drift[axis] * T**2),
        walls=tuple(walls),
    )


def _make_touches(
    motion: LineMotion, contacts: list[int], dynamics: ConstantDynamics, duration: float
) -> list[KnownTouch]:
    """Returns the touches of one axis, in the scenario's units."""
    T, slopes = duration, np.sum(np.abs(dynamics.jacobian), axis=1)
    touches = []
    for time, wall, speed in motion.bounces:
        contact = contacts[wall]
        touches.append(KnownTouch(time * T, time * T, contact, float(slopes[contact]) * speed / T))
    if motion.rest is not None:
        start, end, wall = motion.rest
        touches.append(KnownTouch(start * T, end * T, contacts[wall], 0.0))
    return touches
