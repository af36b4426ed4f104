"""The optimum of two masses on a line between walls, which also hit each other."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial

from benchmarks.optima.least_effort import Coordinate, Flights, extremes
from benchmarks.optima.walls_optimum import ContactOptimum, KnownTouch
from drake_aigto.arrays import Floats
from drake_aigto.dynamics import ConstantDynamics
from drake_aigto.paper import calc_efforts, refuse_world
from drake_aigto.world import Scenario, World

_TOLERANCE = 1e-9
# Newton's starts of each sequence.
_STARTS = 30
# The signs of ∂φ/∂q of the left wall, of the masses against each other, and of the right wall.
_JACOBIAN = ((1.0, 0.0), (-1.0, 1.0), (0.0, -1.0))
_LEFT, _MEETING, _RIGHT = range(3)


def masses_optimum(world: World, scenario: Scenario, most_meetings: int = 3) -> ContactOptimum:
    """Returns the best motion of two masses on a line that is known.

        minimize   control_weight ∫₀ᵀ ‖u‖² dt + goal_weight ‖q(T) − goal‖²
        subject to m_i q̈_i = B_i u  while apart from walls and each other; Newton restitution

    *Equal masses, e = 1: exact.* They swap velocities where they meet, as two ghosts that fly
    through each other, each between the walls alone. In the order in which they would coast,

        k Σ_i (sorted fold(p + vT)_i − goal_i)²,    k = 3w/(3 + w), w the goal's weight in unit time

    *Otherwise: the best of what was listed*, an upper bound. Sequences of up to `most_meetings` in
    which no contact follows itself, without rest; each by Newton's method from seeded starts on
    times, places and velocities of all contacts.

    Args:
        world: two coordinates, no bias, M and B Bᵀ diagonal; contacts of the first mass with a wall
            on its left, of both masses, and of the second with a wall on its right.
        scenario: start, goal, duration, weights and restitution; it has to fit the world.
        most_meetings: of the masses with each other, in the listed sequences.

    Raises:
        ModelError: another kind of world.
        ScenarioError: the scenario does not fit the world (`World.check`).
    """
    world.check(scenario)
    world.check_plain(scenario)
    pair, contacts, price = _make_pair(world, scenario)
    if pair.swaps:
        cost, found = pair.solve_ghosts()
    else:
        cost, found = pair.solve_listed(most_meetings)
    T = scenario.duration
    touches = [
        KnownTouch(time * T, time * T, contacts[kind], speed / T) for time, kind, speed in found
    ]
    return ContactOptimum(price * cost, tuple(sorted(touches)))


# Time, kind and closing speed of each contact.
Contacts = list[tuple[float, int, float]]


@dataclass(frozen=True)
class _Pair:
    """Two masses that meet where their coordinates are equal, 0 ≤ x₁ ≤ x₂ ≤ length, in unit time.

    Minimize Σ_i efforts_i ∫₀¹ ẍ_i² dt + weight Σ_i (x_i(1) − goals_i)².
    """

    positions: Floats
    velocities: Floats
    goals: Floats
    efforts: Floats
    masses: Floats
    weight: float
    length: float
    restitutions: tuple[float, float, float]

    @property
    def swaps(self) -> bool:
        """Whether the masses are as ghosts to each other."""
        one, other = self.masses
        return bool(
            one == other
            and self.efforts[0] == self.efforts[1]
            and self.restitutions == (1.0, 1.0, 1.0)
        )

    def solve_ghosts(self) -> tuple[float, Contacts]:
        """Returns the exact optimum of equal elastic masses."""
        ends, period = self.positions + self.velocities, 2 * self.length
        folded = np.abs((ends + self.length) % period - self.length)
        misses = np.empty(2)
        misses[np.argsort(folded)] = self.goals - np.sort(folded)
        weight = self.weight / self.efforts[0]
        cost = float(self.efforts[0] * 3 * weight / (3 + weight) * np.sum(misses**2))
        # On the way back, the corridor's image is mirrored.
        signs = np.where((ends + self.length) % period < self.length, -1.0, 1.0)
        lifts = weight / (3 + weight) * signs * misses
        one, other = (
            Polynomial([p, v, 1.5 * lift, -0.5 * lift])
            for p, v, lift in zip(self.positions, self.velocities, lifts, strict=True)
        )
        crossings = [
            *(_cross(path, self.length, (_LEFT, _RIGHT)) for path in (one, other)),
            *(_cross(path, period, (_MEETING,)) for path in (one - other, one + other)),
        ]
        return cost, list(itertools.chain(*crossings))

    def solve_listed(self, most_meetings: int) -> tuple[float, Contacts]:
        """Returns the best of all listed sequences."""
        best: tuple[float, Contacts] = math.inf, []
        for kinds in _list_sequences(most_meetings):
            sequence = _Sequence(self, kinds)
            for cost, z in sequence.flights.minimize(sequence.starts()):
                if cost < best[0] and sequence.is_admissible(z):
                    best = cost, sequence.contacts(z)
        return best


def _cross(path: Polynomial, period: float, kinds: Sequence[int]) -> Contacts:
    """Returns when and how fast a path crosses multiples of a period, whose kinds take turns."""
    least, largest = extremes(path, 1.0)
    return [
        (float(root.real), kinds[i % len(kinds)], abs(float(path.deriv()(root.real))))
        for i in range(math.ceil(least / period), math.floor(largest / period) + 1)
        for root in np.roots((path - period * i).coef[::-1]).tolist()
        if abs(root.imag) < _TOLERANCE and 0 < root.real < 1
    ]


def _list_sequences(most_meetings: int) -> Iterator[tuple[int, ...]]:
    """Yields sequences in which no contact follows itself, with so many meetings at most."""
    ends = ((), (_LEFT,), (_RIGHT,), (_LEFT, _RIGHT))
    yield from ends
    for meetings in range(1, most_meetings + 1):
        between = itertools.product(ends[1:], repeat=meetings - 1)
        for first, inner, last in itertools.product(ends, between, ends):
            parts = [first, *inner, last]
            yield tuple(itertools.chain(*((*part, _MEETING) for part in parts[:-1]), parts[-1]))


class _Sequence:
    """One contact sequence, as flights of both masses.

    Free are the time of each contact; of one with a wall the speed before it; of a meeting the
    place and both velocities before it.
    """

    def __init__(self, pair: _Pair, kinds: Sequence[int]) -> None:
        self.pair, self.kinds = pair, tuple(kinds)
        sizes = [4 if kind == _MEETING else 2 for kind in kinds]
        self.offsets = [0, *itertools.accumulate(sizes)]
        self.flights = flights = Flights(self.offsets[-1])
        states = zip(pair.positions, pair.velocities, pair.efforts.tolist(), strict=True)
        self.masses = [Coordinate(flights, *state) for state in states]
        for offset, kind in zip(self.offsets, self.kinds, strict=False):
            if kind == _MEETING:
                self._meet(*map(flights.variable, range(offset, offset + 4)))
            else:
                self._touch(kind, flights.variable(offset), flights.variable(offset + 1))
        for mass, goal in zip(self.masses, pair.goals, strict=True):
            mass.finish(goal, pair.weight)

    def _touch(self, kind: int, time: Floats, speed: Floats) -> None:
        body, side, place = (0, 1, 0.0) if kind == _LEFT else (1, -1, self.pair.length)
        after = side * self.pair.restitutions[kind] * speed
        self.masses[body].fly(time, self.flights.constant(place), -side * speed, after)
        self.flights.keep_positive(speed)

    def _meet(self, time: Floats, place: Floats, one: Floats, other: Floats) -> None:
        closing, (left, right) = one - other, self.pair.masses
        push = (1 + self.pair.restitutions[_MEETING]) / np.sum(self.pair.masses) * closing
        self.masses[0].fly(time, place, one, one - right * push)
        self.masses[1].fly(time, place, other, other + left * push)
        length = self.flights.constant(self.pair.length)
        self.flights.keep_positive(closing, place, length - place)

    def starts(self) -> Floats:
        """Returns where to start Newton's method, shape (k, n): seeded, by chance."""
        rng = np.random.default_rng(len(self.kinds))
        starts = []
        for _ in range(_STARTS):
            times = np.cumsum(rng.dirichlet(np.full(len(self.kinds) + 1, 2.0)))
            z: list[float] = []
            for kind, time in zip(self.kinds, times, strict=False):
                speed = self.pair.length * rng.uniform(0.5, 4.0)
                z += [time, speed]
                if kind == _MEETING:
                    place = self.pair.length * rng.uniform(0.1, 0.9)
                    mean = self.pair.length * rng.uniform(-2.0, 2.0)
                    z[-1:] = [place, mean + speed / 2, mean - speed / 2]
            starts.append(z)
        return np.array(starts).reshape(_STARTS, self.flights.size)

    def is_admissible(self, z: Floats) -> bool:
        """Returns whether the masses stay between the walls, and in their order."""
        left, right = (mass.paths(z) for mass in self.masses)
        for first, last, path in left:
            if extremes(path, last - first)[0] < -_TOLERANCE:
                return False
        for first, last, path in right:
            if extremes(path, last - first)[1] > self.pair.length + _TOLERANCE:
                return False
        for one, other in itertools.product(left, right):
            first, last = max(one[0], other[0]), min(one[1], other[1])
            if first < last:
                gap = _later(other, first) - _later(one, first)
                if extremes(gap, last - first)[0] < -_TOLERANCE:
                    return False
        return True

    def contacts(self, z: Floats) -> Contacts:
        """Returns time, kind and closing speed of each contact."""
        found = []
        for offset, kind in zip(self.offsets, self.kinds, strict=False):
            speed = z[offset + 2] - z[offset + 3] if kind == _MEETING else z[offset + 1]
            found.append((float(z[offset]), kind, float(speed)))
        return found


def _later(piece: tuple[float, float, Polynomial], time: float) -> Polynomial:
    """Returns a path since a later time."""
    return piece[2](Polynomial([time - piece[0], 1.0]))


def _make_pair(world: World, scenario: Scenario) -> tuple[_Pair, list[int], float]:
    """Returns the problem in unit time, the contact of each kind, and the worth of a unit cost."""
    dynamics = world.constant_dynamics
    contacts = _find_contacts(dynamics)
    start, T = scenario.initial_position, scenario.duration
    gaps = world.calc_signed_distance(start)[contacts]
    # From coordinates to those in which the masses meet where they are equal.
    shifts = np.array([gaps[_LEFT], gaps[_LEFT] + gaps[_MEETING]]) - start
    price = scenario.control_weight / T**3
    pair = _Pair(
        positions=start + shifts,
        velocities=scenario.initial_velocity * T,
        goals=scenario.goal_position + shifts,
        efforts=calc_efforts(dynamics),
        masses=np.diag(dynamics.mass_matrix),
        weight=scenario.goal_weight / price,
        length=float(np.sum(gaps)),
        restitutions=tuple(world.restitutions(scenario)[contacts].tolist()),
    )
    return pair, contacts, price


def _find_contacts(dynamics: ConstantDynamics) -> list[int]:
    """Returns which contact is of which kind."""
    found = list(map(tuple, dynamics.jacobian.tolist()))
    if sorted(found) != sorted(_JACOBIAN) or np.any(dynamics.bias):
        raise refuse_world(
            f"∂φ/∂q = {found}, h = {dynamics.bias.tolist()}",
            "two masses on a line: a wall, a mass, a mass, a wall, and no other force",
        )
    return [found.index(slope) for slope in _JACOBIAN]
