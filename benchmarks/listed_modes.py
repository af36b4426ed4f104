"""The least cost of a shot with spin, by a list of which walls are touched and how impacts end.

A ball on a table, (x, y, θ), is pushed along x and y and spun, each for a price, and only where it
is in the end counts. Between two touches its best motion is known: cubics in x and y, as quick a
change of spin at all times. What is left are the touches, and for each sequence of walls and modes
they are a small program for IPOPT:

    minimize  Σ phases' costs   over   durations h, at touches q and v⁻, and impulses p_t
    subject to  Σ h = T,   φ_i(q) = 0,   p_n = −(1 + e) m J_i v⁻ ≥ 0,
                s⁺ = 0 and |p_t| ≤ μ p_n (stick), or p_t = −σ μ p_n and σ s⁺ ≥ 0 (slip)

Sequences whose optimum without modes, |p_t| ≤ μ p_n alone, costs more than the best so far are left
out with all their modes, as are motions that pass through walls. Controls are free functions of
time here, so that plans, whose controls are held, cost a little more.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from benchmarks.local_peers import casadi
from drake_aigto.arrays import Floats
from drake_aigto.world import Scenario, World

MOST_TOUCHES = 3
# Starts of a sequence of so many touches without modes, and in each mode besides what that found.
_STARTS, _STARTS_IN_MODES = (1, 4, 4, 2), 1
# The shortest phase, as a part of the duration, and the slowest touch [m/s].
_SHORTEST, _SLOWEST = 1e-3, 1e-3
# What is deeper inside of a wall is no motion [m]; IPOPT's answers may be off by so much.
_DEEP, _OFF = 1e-4, 1e-6
_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": 100,
}
STICK, FORWARD, BACKWARD, ANY = 0, 1, -1, 2


class Listed(NamedTuple):
    """The best motion of a list."""

    cost: float
    walls: tuple[int, ...]
    modes: tuple[int, ...]
    solves: int


@dataclass(frozen=True, eq=False)
class Shot:
    """A question as numbers: m = 4 walls, q = (x, y, θ).

    Attributes:
        world: the table.
        scenario: the question.
    """

    world: World
    scenario: Scenario
    masses: Floats = field(init=False)

    def __post_init__(self) -> None:
        """Reads masses."""
        q = self.scenario.initial_position
        object.__setattr__(self, "masses", np.diag(self.world.calc_mass_matrix(q)).copy())

    @cached_property
    def rows(self) -> tuple[Floats, Floats, Floats]:
        """J, T and φ at q = 0, shape (m, 3) twice and (m,)."""
        q = np.zeros(3)
        tangents = self.world.rubbing.calc_tangent_jacobian(q)
        return self.world.calc_contact_jacobian(q), tangents, self.world.calc_signed_distance(q)

    @cached_property
    def prices(self) -> Floats:
        """What an effort costs: R m² of each coordinate."""
        return np.broadcast_to(self.scenario.control_weight, 3) * self.masses**2


class _Program:
    """The program of so many touches, for any walls and modes, which are bounds and parameters."""

    def __init__(self, shot: Shot, touches: int) -> None:
        self._shot, self._touches = shot, touches
        h, at = casadi.SX.sym("h", touches + 1), casadi.SX.sym("at", 6, touches)
        parameters = casadi.SX.sym("p", 7, touches)
        cost, rows = self._write(h, at, parameters)
        variables = casadi.vertcat(h, casadi.vec(at))
        whole = {"x": variables, "p": casadi.vec(parameters), "f": cost, "g": rows}
        self._solve = casadi.nlpsol("touches", "ipopt", whole, _OPTIONS)
        self._read = casadi.Function("after", [variables, casadi.vec(parameters)], [self._after])

    def _write(self, h: Any, at: Any, parameters: Any) -> tuple[Any, Any]:
        """Returns the cost, and the rows: Σ h, then φ, J v⁻, s⁺, and both edges of the cone."""
        scenario, m = self._shot.scenario, self._shot.masses
        e, mu = scenario.restitution, scenario.friction
        q, v = casadi.DM(scenario.initial_position), casadi.DM(scenario.initial_velocity)
        cost, rows, after = 0, [casadi.sum1(h)], []
        for j in range(self._touches):
            place, before, tangent = at[:2, j], at[2:5, j], at[5, j]
            J, T, gap = parameters[:3, j], parameters[3:6, j], parameters[6, j]
            cost += self._price(q, v, place, before, h[j])
            rate = casadi.dot(J, before)
            normal = -(1 + e) * rate / casadi.sum1(J**2 / m)
            q, v = place, before + (J * normal + T * tangent) / m
            rows += [casadi.dot(J[:2], place) + gap, rate, casadi.dot(T, v)]
            rows += [mu * normal - tangent, mu * normal + tangent]
            after.append(v)
        self._after = casadi.horzcat(*after) if after else casadi.DM(3, 0)
        return cost + self._price_end(q, v, h[self._touches]), casadi.vertcat(*rows)

    def _price(self, q: Any, v: Any, place: Any, before: Any, h: Any) -> Any:
        """Returns ∫ Σ R u² of the best way between two states in a time h."""
        way, R = place - q[:2], self._shot.prices
        first, last = v[:2], before[:2]
        squares = 4 * (first**2 + first * last + last**2) / h
        squares += 12 * way**2 / h**3 - 12 * way * (first + last) / h**2
        return casadi.dot(R[:2], squares) + R[2] * (before[2] - v[2]) ** 2 / h

    def _price_end(self, q: Any, v: Any, h: Any) -> Any:
        """Returns the same to the best end."""
        scenario, R = self._shot.scenario, self._shot.prices[:2]
        weights = np.broadcast_to(scenario.goal_weight, 3)[:2]
        stiffness = 3 * R / h**3
        miss = scenario.goal_position[:2] - q[:2] - v[:2] * h
        return casadi.sum1(stiffness * weights / (stiffness + weights) * miss**2)

    def solve(
        self, walls: tuple[int, ...], modes: tuple[int, ...], start: Floats
    ) -> tuple[float, Floats]:
        """Returns the cost of a local optimum, infinite if there is none, and its variables."""
        inf, T = np.inf, self._shot.scenario.duration
        J, tangents, gaps = self._shot.rows
        given = [np.concatenate([J[i], tangents[i], [gaps[i]]]) for i in walls]
        low, high = [T], [T]
        for mode in modes:
            slips = {STICK: (0.0, 0.0), FORWARD: (0.0, inf), BACKWARD: (-inf, 0.0)}
            s = slips.get(mode, (-inf, inf))
            low += [0.0, -inf, s[0], 0.0, 0.0]
            high += [0.0, -_SLOWEST, s[1]]
            high += [0.0 if mode == BACKWARD else inf, 0.0 if mode == FORWARD else inf]
        free = np.full(len(start), inf)
        least = np.concatenate([np.full(len(walls) + 1, _SHORTEST * T), -free[len(walls) + 1 :]])
        parameters = np.concatenate([[], *given])
        found = self._solve(x0=start, p=parameters, lbg=low, ubg=high, lbx=least, ubx=free)
        x, rows = np.array(found["x"]).ravel(), np.array(found["g"]).ravel()
        off = np.maximum(np.array(low) - rows, rows - np.array(high))
        if not np.all(np.isfinite(x)) or np.max(off) > _OFF or self._is_inside(x, parameters):
            return inf, x
        return float(found["f"]), x

    def _is_inside(self, x: Floats, parameters: Floats) -> bool:
        """Returns whether the motion passes through a wall."""
        scenario, k = self._shot.scenario, self._touches
        h, at = x[: k + 1], x[k + 1 :].reshape(k, 6)
        after = np.array(self._read(x, parameters)).reshape(3, k).T
        q, v = scenario.initial_position[:2], scenario.initial_velocity[:2]
        s = np.linspace(0.0, 1.0, 40)[:, np.newaxis]
        J, _, gaps = self._shot.rows
        for j in range(k + 1):
            if j < k:
                way, first, last = at[j, :2] - q, h[j] * v, h[j] * at[j, 2:4]
                bend, twist = 3 * way - 2 * first - last, first + last - 2 * way
            else:
                first, weights = h[j] * v, np.broadcast_to(scenario.goal_weight, 3)[:2]
                stiffness = 3 * self._shot.prices[:2] / h[j] ** 3
                off = weights / (stiffness + weights) * (scenario.goal_position[:2] - q - first)
                bend, twist = 1.5 * off, -0.5 * off
            path = q + s * (first + s * (bend + s * twist))
            if np.min(path @ J[:, :2].T + gaps) < -_DEEP:
                return True
            if j < k:
                q, v = at[j, :2], after[j, :2]
        return False


class ListOfModes:
    """All sequences of up to three touches, in all modes."""

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Compiles a program for each number of touches."""
        self._shot = Shot(world, scenario)
        self._programs = [_Program(self._shot, k) for k in range(MOST_TOUCHES + 1)]
        self._solves = 0

    def find_best(self, seed: int) -> Listed:
        """Returns the best motion of the list, from starts that are drawn by a seed."""
        rng = np.random.default_rng(seed)
        best = Listed(np.inf, (), (), 0)
        relaxed = [self._relax(walls, rng) for walls in self._list_walls()]
        for bound, walls, x in sorted(relaxed, key=lambda each: each[0]):
            if bound >= best.cost:
                break
            for modes in product((STICK, FORWARD, BACKWARD), repeat=len(walls)):
                for start in [x, *(self._draw(walls, rng) for _ in range(_STARTS_IN_MODES))]:
                    cost, _ = self._solve(walls, modes, start)
                    if cost < best.cost:
                        best = Listed(cost, walls, modes, 0)
        return best._replace(solves=self._solves)

    def _list_walls(self) -> Iterator[tuple[int, ...]]:
        for touches in range(MOST_TOUCHES + 1):
            yield from product(range(self._shot.world.num_contacts), repeat=touches)

    def _relax(
        self, walls: tuple[int, ...], rng: np.random.Generator
    ) -> tuple[float, tuple[int, ...], Floats]:
        """Returns the least cost of a sequence without modes."""
        tries = [
            self._solve(walls, (ANY,) * len(walls), self._draw(walls, rng))
            for _ in range(_STARTS[len(walls)])
        ]
        cost, x = min(tries, key=lambda each: each[0])
        return cost, walls, x

    def _solve(
        self, walls: tuple[int, ...], modes: tuple[int, ...], start: Floats
    ) -> tuple[float, Floats]:
        self._solves += 1
        return self._programs[len(walls)].solve(walls, modes, start)

    def _draw(self, walls: tuple[int, ...], rng: np.random.Generator) -> Floats:
        """Returns a start: touches at random places and times, straight ways between them."""
        scenario, (J, _, gaps) = self._shot.scenario, self._shot.rows
        k, T = len(walls), scenario.duration
        h = T * rng.dirichlet(np.full(k + 1, 3.0))
        q, found = scenario.initial_position[:2], []
        for j, wall in enumerate(walls):
            place = scenario.initial_position[:2] + rng.uniform() * (
                scenario.goal_position[:2] - scenario.initial_position[:2]
            )
            place = place + rng.normal(scale=0.2, size=2) * (J[wall, :2] == 0)
            place = place - J[wall, :2] * (J[wall, :2] @ place + gaps[wall])
            velocity = (place - q) / h[j]
            spin = scenario.initial_velocity[2] * rng.uniform()
            found.append([*place, *velocity, spin, 0.0])
            q = place
        return np.concatenate([h, np.ravel(found)])
