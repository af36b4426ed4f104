"""The best known motion of a point mass in a room with a box: sequences, one corner at most."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.optima.least_effort import Coordinate, Flights
from benchmarks.optima.walls_optimum import ContactOptimum, KnownTouch
from drake_aigto.arrays import Floats
from drake_aigto.dynamics import ConstantDynamics
from drake_aigto.paper import calc_efforts, refuse_world
from drake_aigto.world import Scenario, World

# Paths are looked at so many times, and may be this deep inside anything.
_SAMPLES, _TOLERANCE = 4001, 1e-6
# Newton's starts of the sequence of one axis, and around a corner.
_STARTS, _CORNER_STARTS = 40, 6


@dataclass(frozen=True)
class _Face:
    """A wall of the room, or a face of the box."""

    contact: int
    axis: int
    place: float
    side: int  # 1 if the mass that touches it is above, −1 if below
    restitution: float
    is_of_box: bool


@dataclass(frozen=True)
class _Path:
    """A local optimum of one or both axes.

    Attributes:
        cost: of these axes.
        touches: time, face and speed of each.
        positions: at all samples, a row for each axis.
    """

    cost: float
    touches: tuple[tuple[float, _Face, float], ...]
    positions: Floats


def block_optimum(world: World, scenario: Scenario, most_touches: int = 4) -> ContactOptimum:
    """Returns the best motion that is known of a room with a box in it.

    An upper bound, by exhaustive search: nobody has proven that there is nothing better.

    Box and walls are across axes, so between touches the axes know nothing of each other, and a
    touch changes one of them. First, for each axis alone: local optima of all its sequences of up
    to `most_touches` faces, such as lie ahead of each other, by Newton's method from seeded starts.
    Of all pairs of them, that which costs least and is admissible: clear of the box, and beside it
    where its faces are touched. Second, pairs that would cost less but are not admissible are led
    through a corner of the box, at a time and a velocity that are free. Left out are motions
    through several corners, rest, and turning in flight on the way to the next face.

    Args:
        world: a room: two coordinates, four walls and one box, no bias.
        scenario: start, goal, duration, weights and restitution; it has to fit the world.
        most_touches: of one axis.

    Raises:
        ModelError: another kind of world.
        ScenarioError: the scenario does not fit the world (`World.check`).
    """
    world.check(scenario)
    world.check_plain(scenario)
    room = _make_room(world, scenario)
    by_axis = [list(room.solve_axis(axis, most_touches)) for axis in range(2)]
    best = room.find_clear_pair(by_axis)
    best = room.cut_corners(by_axis, best)
    T = scenario.duration
    touches = sorted(
        KnownTouch(time * T, time * T, face.contact, speed / T)
        for time, face, speed in best.touches
    )
    return ContactOptimum(scenario.control_weight / T**3 * best.cost, tuple(touches))


@dataclass(frozen=True)
class _Room:
    """The problem in unit time: minimize Σ_i efforts_i ∫ ẍ_i² dt + weight ‖x(1) − goal‖²."""

    position: Floats
    velocity: Floats
    goal: Floats
    efforts: Floats
    weight: float
    faces: tuple[_Face, ...]

    @property
    def box(self) -> Floats:
        """The box: lower and upper corner, in rows."""
        ends = [
            sorted(face.place for face in self.faces if face.is_of_box and face.axis == axis)
            for axis in range(2)
        ]
        return np.array(ends).T

    def sequences(self, axis: int, most_touches: int) -> Iterator[tuple[_Face, ...]]:
        """Yields the faces that one axis may touch in turn, never turning on its way."""
        faces = [face for face in self.faces if face.axis == axis]
        longest: list[tuple[_Face, ...]] = [()]
        for _ in range(most_touches + 1):
            yield from longest
            longest = [
                (*sequence, face)
                for sequence in longest
                for face in faces
                if not sequence or _is_ahead(sequence[-1], face)
            ]

    def solve_axis(self, axis: int, most_touches: int) -> Iterator[_Path]:
        """Yields all local optima of one axis that stay in the room."""
        rng = np.random.default_rng(0)
        for sequence in self.sequences(axis, most_touches):
            problem = _Sequence(self, {axis: sequence}, None)
            costs: list[float] = []
            for cost, z in problem.flights.minimize(problem.starts(rng)):
                if not any(math.isclose(cost, other, rel_tol=1e-6) for other in costs):
                    costs.append(cost)
                    path = problem.path(cost, z)
                    if self._is_inside(path.positions[0], axis):
                        yield path

    def _is_inside(self, positions: Floats, axis: int) -> bool:
        """Returns whether a coordinate stays between the walls of the room."""
        walls = [face.place for face in self.faces if face.axis == axis and not face.is_of_box]
        low, high = min(walls) - _TOLERANCE, max(walls) + _TOLERANCE
        return bool(np.all((positions >= low) & (positions <= high)))

    def is_clear(self, positions: Floats, touches: Sequence[tuple[float, _Face, float]]) -> bool:
        """Returns whether a motion stays in the room and out of the box, and touches its faces."""
        lower, upper = self.box
        if not all(self._is_inside(positions[axis], axis) for axis in range(2)):
            return False
        is_in_box = (positions > lower[:, None] + _TOLERANCE) & (
            positions < upper[:, None] - _TOLERANCE
        )
        if np.any(np.all(is_in_box, axis=0)):
            return False
        for time, face, _ in touches:
            across = 1 - face.axis
            beside = positions[across][round(time * (_SAMPLES - 1))]
            if face.is_of_box and not lower[across] <= beside <= upper[across]:
                return False
        return True

    def find_clear_pair(self, by_axis: Sequence[Sequence[_Path]]) -> _Path:
        """Returns the cheapest admissible pair of motions of both axes."""
        for pair in _by_cost(by_axis):
            path = _join(*pair)
            if self.is_clear(path.positions, path.touches):
                return path
        return _Path(math.inf, (), np.empty((2, 0)))

    def cut_corners(self, by_axis: Sequence[Sequence[_Path]], best: _Path) -> _Path:
        """Returns the cheapest motion through a corner, or this one if none is cheaper."""
        rng = np.random.default_rng(0)
        tried = set()
        for pair in _by_cost(by_axis):
            if pair[0].cost + pair[1].cost >= best.cost:
                break
            faces = {axis: tuple(face for _, face, _ in pair[axis].touches) for axis in range(2)}
            places = (range(len(faces[axis]) + 1) for axis in range(2))
            for after, corner in itertools.product(
                itertools.product(*places), itertools.product(*self.box.T.tolist())
            ):
                if (key := (faces[0], faces[1], after, corner)) in tried:
                    continue
                tried.add(key)
                problem = _Sequence(self, faces, (after, corner))
                best = self._improve(best, problem, problem.starts_around(pair, rng))
        return best

    def _improve(self, best: _Path, problem: _Sequence, starts: Floats) -> _Path:
        """Returns a sequence's cheapest admissible motion, or this one if none is cheaper."""
        for cost, z in problem.flights.minimize(starts):
            if cost < best.cost:
                path = problem.path(cost, z)
                if self.is_clear(path.positions, path.touches):
                    best = path
        return best


def _is_ahead(one: _Face, other: _Face) -> bool:
    """Returns whether a mass that leaves one face may go straight to the other."""
    return other.side == -one.side and one.side * (other.place - one.place) > 0


def _by_cost(by_axis: Sequence[Sequence[_Path]]) -> Iterator[tuple[_Path, _Path]]:
    """Yields pairs of paths, the cheapest first."""
    one, other = (sorted(paths, key=lambda path: path.cost) for paths in by_axis)
    if not one or not other:
        return
    heap = [(path.cost + other[0].cost, i, 0) for i, path in enumerate(one)]
    heapq.heapify(heap)
    while heap:
        _, i, j = heapq.heappop(heap)
        yield one[i], other[j]
        if j + 1 < len(other):
            heapq.heappush(heap, (one[i].cost + other[j + 1].cost, i, j + 1))


def _join(one: _Path, other: _Path) -> _Path:
    return _Path(
        one.cost + other.cost,
        (*one.touches, *other.touches),
        np.vstack([one.positions, other.positions]),
    )


class _Sequence:
    """The faces that one or both axes touch, and where between them a corner is passed.

    Free are time and speed of each touch; of a corner its time and both velocities.
    """

    def __init__(
        self,
        room: _Room,
        faces: dict[int, tuple[_Face, ...]],
        corner: tuple[tuple[int, ...], tuple[float, ...]] | None,
    ) -> None:
        self.room, self.faces, self.corner = room, faces, corner
        self.first_of_corner = 2 * sum(map(len, faces.values()))
        self.flights = Flights(self.first_of_corner + (0 if corner is None else 3))
        self.coordinates: list[Coordinate] = []
        first = 0
        for axis in faces:
            self._add_axis(axis, first)
            first += 2 * len(faces[axis])

    def _add_axis(self, axis: int, first: int) -> None:
        room, variable, constant = self.room, self.flights.variable, self.flights.constant
        state = room.position[axis], room.velocity[axis], float(room.efforts[axis])
        coordinate = Coordinate(self.flights, *state)
        stops: list[tuple[Floats, Floats, Floats, Floats]] = []
        for i, face in enumerate(self.faces[axis]):
            time, speed = variable(first + 2 * i), variable(first + 2 * i + 1)
            self.flights.keep_positive(speed)
            after = face.side * face.restitution * speed
            stops.append((time, constant(face.place), -face.side * speed, after))
        if self.corner is not None:
            number, (after_touch, places) = self.first_of_corner, self.corner
            passing = variable(number + 1 + axis)
            stop = variable(number), constant(places[axis]), passing, passing
            stops.insert(after_touch[axis], stop)
        for stop in stops:
            coordinate.fly(*stop)
        coordinate.finish(float(room.goal[axis]), room.weight)
        self.coordinates.append(coordinate)

    def starts(self, rng: np.random.Generator) -> Floats:
        """Returns where to start Newton's method for one axis, by chance, shape (k, n)."""
        ((axis, faces),) = self.faces.items()
        if not faces:
            return np.empty((1, 0))
        places = np.array([self.room.position[axis], *(f.place for f in faces)])
        ways = np.maximum(np.abs(np.diff(places)), 0.05)
        starts = np.empty((_STARTS, 2 * len(faces)))
        spans = rng.dirichlet(np.full(len(faces) + 1, 2.0), _STARTS)[:, :-1]
        starts[:, ::2] = np.cumsum(spans, axis=1)
        starts[:, 1::2] = ways / spans * np.exp(0.3 * rng.normal(size=spans.shape))
        return starts

    def starts_around(self, pair: tuple[_Path, _Path], rng: np.random.Generator) -> Floats:
        """Returns starts near a pair of motions, passing the corner at some times."""
        z = [value for path in pair for time, _, speed in path.touches for value in (time, speed)]
        starts = []
        for _ in range(_CORNER_STARTS):
            time = rng.uniform(0.05, 0.95)
            k = round(time * (_SAMPLES - 2))
            velocities = [
                (_SAMPLES - 1) * float(np.diff(p.positions[0, k : k + 2])[0]) for p in pair
            ]
            starts.append([*z, time, *velocities])
        return np.array(starts)

    def path(self, cost: float, z: Floats) -> _Path:
        """Returns the motion of this z."""
        times, positions = np.linspace(0.0, 1.0, _SAMPLES), []
        for coordinate in self.coordinates:
            row = np.empty(_SAMPLES)
            for first, _, piece in coordinate.paths(z):
                row[times >= first] = piece(times[times >= first] - first)
            positions.append(row)
        faces = [face for axis in self.faces for face in self.faces[axis]]
        touches = [(float(z[2 * i]), face, float(z[2 * i + 1])) for i, face in enumerate(faces)]
        return _Path(cost, tuple(touches), np.array(positions))


def _make_room(world: World, scenario: Scenario) -> _Room:
    """Returns the problem in unit time."""
    dynamics = _read_room(world)
    q, T = scenario.initial_position, scenario.duration
    distances, restitutions = world.calc_signed_distance(q), world.restitutions(scenario).tolist()
    solids = [contact.solid for contact in world.contacts]
    faces = []
    for contact, slopes in enumerate(dynamics.jacobian):
        axis = int(np.argmax(np.abs(slopes)))
        place = float(q[axis] - distances[contact] / slopes[axis])
        side, is_of_box = 1 if slopes[axis] > 0 else -1, solids.count(solids[contact]) > 1
        faces.append(_Face(contact, axis, place, side, restitutions[contact], is_of_box))
    return _Room(
        position=q,
        velocity=scenario.initial_velocity * T,
        goal=scenario.goal_position,
        efforts=calc_efforts(dynamics),
        weight=scenario.goal_weight * T**3 / scenario.control_weight,
        faces=tuple(faces),
    )


def _read_room(world: World) -> ConstantDynamics:
    """Returns the dynamics of a room with one box; refuses what is none."""
    dynamics = world.constant_dynamics
    faces = sorted(map(tuple, dynamics.jacobian.tolist()))
    sizes = sorted(map(len, dynamics.solids))
    expected = sorted(2 * [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)])
    if faces != expected or sizes != [1, 1, 1, 1, 4] or np.any(dynamics.bias):
        raise refuse_world(
            f"∂φ/∂q = {faces} of solids with {sizes} faces, h = {dynamics.bias.tolist()}",
            "four walls and one box across two axes, and no other force",
        )
    return dynamics
