"""Motions of point masses that fly from touch to touch: least effort, by Newton's method.

Contact fixes positions or ties velocities and leaves times and speeds free. Between two touches
nothing is left to optimize, because the cheapest flight is a cubic; so a contact sequence is a
small smooth problem, which this module solves. It knows nothing of knots, boxes or the planner.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import Polynomial

from drake_aigto.arrays import Floats
from drake_aigto.kernels import kernel
from drake_aigto.linear import solve_factored

# Newton's method: a predicted gain that is rounding, and the most steps.
_RELATIVE, _ABSOLUTE, _MOST_STEPS = 1e-14, 1e-24, 80
_MOST_SHIFTS = 40
# A gain that is small enough if rounding keeps the cost from falling.
_STALLED = 1e-9
# Part of the way to a bound that a step takes at most, and of the predicted gain that it must give.
_TO_BOUND, _SUFFICIENT = 0.9, 1e-4


@dataclass
class Flights:
    """A contact sequence: flights whose ends are linear in what is free, z.

    A flight covers Δ from velocity v₀ to v₁ in time τ, under gravity g along −x. Its least effort
    is that of a cubic:

        min ∫ (ẍ + g)² dt = (v₁ − v₀ + gτ)²/τ + 12 (Δ − (v₀ + v₁)τ/2)²/τ³

    The last flight of a mass ends where it likes, at a price w for its squared distance from the
    goal; Δ is now the way to the goal, and v₁ is free:

        min ∫ (ẍ + g)² dt + w (Δ − Δ_flown)² = 3w/(3 + wτ³) (Δ − v₀τ + gτ²/2)²

    The cost of a sequence is the sum, each times a factor: the squared mass, if masses differ.

    Attributes:
        size: n, the number of free variables.
        gravity: g.
    """

    size: int
    gravity: float = 0.0
    _rows: list[Floats] = field(default_factory=list, repr=False)
    _prices: list[tuple[float, float]] = field(default_factory=list, repr=False)
    _positive: list[Floats] = field(default_factory=list, repr=False)

    def variable(self, number: int) -> Floats:
        """Returns z[number] as a row: n coefficients and a constant."""
        return np.eye(self.size + 1)[number]

    def constant(self, value: float) -> Floats:
        """Returns a number as a row."""
        return value * np.eye(self.size + 1)[-1]

    def keep_positive(self, *rows: Floats) -> None:
        """Takes rows that have to stay above zero, as the times of all flights have."""
        self._positive += rows

    def add(self, flight: Sequence[Floats], factor: float, weight: float = math.inf) -> int:
        """Adds a flight, and returns its number.

        Args:
            flight: Rows of Δ, v₀, v₁, τ.
            factor: Of its cost.
            weight: The price w of the goal; infinite between two touches.
        """
        self._rows.append(np.array(flight))
        self._prices.append((factor, weight))
        self.keep_positive(flight[3])
        return len(self._rows) - 1

    def minimize(self, starts: Floats) -> Iterator[tuple[float, Floats]]:
        """Yields the local optimum (cost, z) of each start (k, n) that leads to one.

        What ends where a row that has to stay above zero is zero is not yielded.
        """
        rows, prices, bounds = (np.array(x) for x in (self._rows, self._prices, self._positive))
        for start in starts:
            if np.all(bounds[:, :-1] @ start + bounds[:, -1] > 0):
                z, cost, is_optimal = _minimize(start, rows, prices, self.gravity, bounds)
                if is_optimal:
                    yield cost, z

    def values(self, z: Floats) -> Floats:
        """Returns Δ, v₀, v₁ and τ of all flights at z, shape (flights, 4); v₁ of a last one too."""
        rows = np.array(self._rows)
        values = rows[:, :, :-1] @ z + rows[:, :, -1]
        g = self.gravity
        for flight, (_, weight) in zip(values, self._prices, strict=True):
            if math.isfinite(weight):
                way, start, _, time = flight
                lift = weight / (3 + weight * time**3) * (way - start * time + g * time**2 / 2)
                # u(t) = 3 lift (τ − t)
                flight[0] = start * time - g * time**2 / 2 + lift * time**3
                flight[2] = start - g * time + 1.5 * lift * time**2
        return values


class Coordinate:
    """A coordinate of a mass, from its start through its flights.

    Attributes:
        time: When the next flight begins, a row.
        place: Where it does.
        velocity: With which velocity.
    """

    def __init__(
        self, flights: Flights, position: float, velocity: float, effort: float = 1.0
    ) -> None:
        """Starts; the effort is the factor of the flights' costs."""
        self._flights, self._effort = flights, effort
        self.time = flights.constant(0.0)
        self.place, self.velocity = flights.constant(position), flights.constant(velocity)
        self._position, self._numbers = position, list[int]()

    def fly(self, time: Floats, place: Floats, before: Floats, after: Floats) -> None:
        """Flies to a touch: its time, its place, the velocity before it and after it."""
        flight = place - self.place, self.velocity, before, time - self.time
        self._numbers.append(self._flights.add(flight, self._effort))
        self.time, self.place, self.velocity = time, place, after

    def finish(self, goal: float, weight: float) -> None:
        """Flies on to time 1, at a price for the squared distance from a goal."""
        zero, one = self._flights.constant(0.0), self._flights.constant(1.0)
        flight = self._flights.constant(goal) - self.place, self.velocity, zero, one - self.time
        self._numbers.append(self._flights.add(flight, self._effort, weight / self._effort))

    def paths(self, z: Floats) -> list[tuple[float, float, Polynomial]]:
        """Returns start, end and path since its start of each flight; rests take no time here."""
        found, time, place = [], 0.0, self._position
        for flight in self._flights.values(z)[self._numbers]:
            way, start, end, span = flight.tolist()
            rest, turn = way - start * span, (end - start) * span
            curve = ((3 * rest - turn) / span**2, (turn - 2 * rest) / span**3) if span > 0 else ()
            found.append((time, time + span, Polynomial([place, start, *curve])))
            time, place = time + span, place + way
        return found


def extremes(path: Polynomial, last: float) -> tuple[float, float]:
    """Returns the least and the largest value of a cubic over 0 ≤ t ≤ last."""
    a, b, c, d = np.append(path.coef, np.zeros(4 - path.coef.size)).tolist()
    times = [0.0, last]
    # The stable form of the quadratic formula, for 3d t² + 2c t + b.
    discriminant = c * c - 3 * b * d
    if discriminant > 0:
        q = -(c + math.copysign(math.sqrt(discriminant), c))
        roots = [q / (3 * d)] if d else []
        roots += [b / q] if q else []
        times += [t for t in roots if 0.0 < t < last]
    values = [a + t * (b + t * (c + t * d)) for t in times]
    return min(values), max(values)


@kernel
def _through(x: Floats, g: float, slope: Floats, bend: Floats) -> float:
    """Returns the effort of a flight x = (Δ, v₀, v₁, τ), with its derivatives."""
    way, start, end, t = x
    W, S = end - start + g * t, way - (start + end) * t / 2
    by_W, by_S = 2 * W / t, 24 * S / t**3
    dW, dS = (0.0, -1.0, 1.0, g), (1.0, -t / 2, -t / 2, -(start + end) / 2)
    for i in range(4):
        slope[i] = by_W * dW[i] + by_S * dS[i]
        for j in range(4):
            bend[i, j] = 2 / t * dW[i] * dW[j] + 24 / t**3 * dS[i] * dS[j]
    slope[3] -= (W / t) ** 2 + 36 * S**2 / t**4
    for i in range(4):
        mixed = -2 * W / t**2 * dW[i] - 72 * S / t**4 * dS[i]
        bend[i, 3] += mixed
        bend[3, i] += mixed
    bend[3, 3] += 2 * W**2 / t**3 + 144 * S**2 / t**5
    for i in (1, 2):
        bend[i, 3] -= by_S / 2
        bend[3, i] -= by_S / 2
    return W**2 / t + 12 * S**2 / t**3


@kernel
def _last(x: Floats, w: float, g: float, slope: Floats, bend: Floats) -> float:
    """Returns the cost of a last flight x = (Δ, v₀, ·, τ), with its derivatives."""
    way, start, _, t = x
    k, D = 3 * w / (3 + w * t**3), way - start * t + g * t**2 / 2
    by_t = -((k * t) ** 2)  # of k
    dD = (1.0, -t, 0.0, -start + g * t)
    for i in range(4):
        slope[i] = 2 * k * D * dD[i]
        for j in range(4):
            bend[i, j] = 2 * k * dD[i] * dD[j]
    slope[3] += by_t * D**2
    for i in range(4):
        bend[i, 3] += 2 * by_t * D * dD[i]
        bend[3, i] += 2 * by_t * D * dD[i]
    bend[3, 3] += 2 * k**2 * t * (k * t**3 - 1) * D**2 + 2 * k * D * g
    bend[1, 3] -= 2 * k * D
    bend[3, 1] -= 2 * k * D
    return k * D**2


@kernel
def _value(row: Floats, z: Floats) -> float:
    """Returns what a row is at z."""
    value = row[z.size]
    for i in range(z.size):
        value += row[i] * z[i]
    return value


@kernel
def _evaluate(
    z: Floats, rows: Floats, prices: Floats, g: float, gradient: Floats, hessian: Floats
) -> float:
    """Returns the cost of a sequence at z, with its derivatives."""
    n = z.size
    gradient[:] = 0.0
    hessian[:, :] = 0.0
    x, slope, bend = np.empty(4), np.empty(4), np.empty((4, 4))
    total = 0.0
    for flight in range(len(rows)):
        row = rows[flight]
        factor, weight = prices[flight]
        for a in range(4):
            x[a] = _value(row[a], z)
        if np.isinf(weight):
            total += factor * _through(x, g, slope, bend)
        else:
            total += factor * _last(x, weight, g, slope, bend)
        for a in range(4):
            for i in range(n):
                if row[a, i] != 0.0:
                    gradient[i] += factor * row[a, i] * slope[a]
                    for b in range(4):
                        for j in range(n):
                            hessian[i, j] += factor * row[a, i] * bend[a, b] * row[b, j]
    return total


@kernel
def _factor(L: Floats) -> bool:
    """Puts the Cholesky factor in place of a matrix; returns whether it is safely positive."""
    for j in range(len(L)):
        largest = L[j, j]
        for k in range(j):
            L[j, j] -= L[j, k] ** 2
        if not L[j, j] > 1e-12 * largest:
            return False
        L[j, j] = math.sqrt(L[j, j])
        for i in range(j + 1, len(L)):
            for k in range(j):
                L[i, j] -= L[i, k] * L[j, k]
            L[i, j] /= L[j, j]
    return True


@kernel
def _newton_step(gradient: Floats, hessian: Floats) -> Floats:
    """Returns a step down: Newton's, with the least shift, by powers of 4, that makes it one."""
    n = gradient.size
    scale = np.empty(n)
    for i in range(n):
        scale[i] = abs(hessian[i, i]) + 1e-12
    shift = 0.0
    for _ in range(_MOST_SHIFTS):
        shifted = hessian.copy()
        for i in range(n):
            shifted[i, i] += shift * scale[i]
        if _factor(shifted):
            step = -gradient
            solve_factored(n, shifted, step)
            return step
        shift = 4 * shift if shift else 1e-3
    return np.full(n, np.nan)  # Numbers overflowed.


@kernel
def _longest(z: Floats, step: Floats, bounds: Floats) -> float:
    """Returns how much of a step to take at most, to stay within bounds."""
    length = 1.0
    for bound in bounds:
        left, change = _value(bound, z), 0.0
        for i in range(z.size):
            change += bound[i] * step[i]
        if change < 0:
            length = min(length, -_TO_BOUND * left / change)
    return length


@kernel
def _minimize(
    start: Floats, rows: Floats, prices: Floats, g: float, bounds: Floats
) -> tuple[Floats, float, bool]:
    """Returns where Newton's method with line search ends, the cost, and whether it converged."""
    n = start.size
    z, trial = start.copy(), start.copy()
    gradient, hessian = np.empty(n), np.empty((n, n))
    cost = _evaluate(z, rows, prices, g, gradient, hessian)
    for _ in range(_MOST_STEPS):
        step = _newton_step(gradient, hessian)
        gain = 0.0
        for i in range(n):
            gain -= gradient[i] * step[i]
        if gain <= _RELATIVE * cost + _ABSOLUTE:
            return z, cost, True
        length = _longest(z, step, bounds)
        while True:
            for i in range(n):
                trial[i] = z[i] + length * step[i]
            value = _evaluate(trial, rows, prices, g, gradient, hessian)
            if value <= cost - _SUFFICIENT * length * gain:
                break
            length /= 2
            if length < 1e-10:
                return z, cost, gain <= _STALLED * cost + _ABSOLUTE
        z[:], cost = trial, value
    return z, cost, False
