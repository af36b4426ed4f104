"""Motion of contacts with constant J, or at an instant: distances, rates, impulses."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.contact.laws import calc_mobilities
from drake_aigto.dynamics import ConstantInertia
from drake_aigto.kernels import inner, kernel
from drake_aigto.world import SpaceWorld, World, find_anywhere

# Rates of several contacts at once below this are rounding, relative to the largest among them.
_ROUNDING = 1e-13

# Most exchanges in the search for contacts that push: rounding could make it cycle.
_MOST_EXCHANGES = 1000
# Squared frequency below which nothing oscillates [1/s²].
_NO_PACE = 1e-12


class Clearance(NamedTuple):
    """Distance of the ball to a solid: the largest φ of its faces."""

    contact: int  # the face
    distance: float  # φ of that face [m]; at most 0 is inside
    rate: float  # φ̇ [m/s]


class Walls(NamedTuple):
    """Tables of contacts for compiled code (`ConstantInertia`), of S solids.

    If J varies, as for a mechanism at an instant, one more coordinate carries J̇ v: its
    position and velocity are 0, its acceleration is 1, and its column of J is J̇ v. So J v̇ is φ̈
    there, too, and no impulse changes it, as its column of lifts is 0.
    """

    jacobian: Floats  # J, shape (m, nv)
    offset: Floats  # φ(0), shape (m,) [m]
    lifts: Floats  # M⁻¹ J_iᵀ / (J_i M⁻¹ J_iᵀ), shape (m, nv)
    firsts: Ints  # the first contact of each solid, and m, shape (S+1,)

    @classmethod
    def of(cls, inertia: ConstantInertia, turning: Floats | None = None) -> Walls:
        """Returns copies: Numba compiles once more for arrays that are read-only.

        Args:
            inertia: M and J.
            turning: J̇ v, shape (m,) [m/s²]; None where J is constant.
        """
        firsts = [*(faces[0] for faces in inertia.solids), len(inertia.offset)]
        parts = inertia.jacobian, inertia.offset, inertia.lifts
        jacobian, offset, lifts = (np.array(part, order="C") for part in parts)
        if turning is not None:
            jacobian = np.column_stack([jacobian, turning])
            lifts = np.column_stack([lifts, np.zeros(len(lifts))])
        return cls(jacobian, offset, lifts, np.array(firsts))


class ContactMotion:
    """The distances φ of contacts along a motion x = (q, v), and effects of their impulses.

    The faces of one box are one solid, which the ball is outside of while it is in front of one of
    them: its clearance is the largest of their φ. Beyond the box's edges that is a sharp corner,
    where Drake's geometry has one that is as round as the ball.

    Attributes:
        solids: the contacts of each solid.
        walls: the contacts, for compiled code.
        masses: effective mass of each contact, shape (m,) [kg].
    """

    def __init__(self, inertia: ConstantInertia, turning: Floats | None = None) -> None:
        """Prepares arrays for every step, with the turning of `Walls.of`."""
        self._num_contacts = len(inertia.offset)
        self._turning = turning
        self._jacobian = inertia.jacobian
        # (φ, φ̇) = rows x + (φ(0), 0).
        self._rows = np.kron(np.eye(2), inertia.jacobian)
        self._origin = np.concatenate([inertia.offset, np.zeros(self._num_contacts)])
        self.solids = inertia.solids
        self.walls = Walls.of(inertia, turning)
        self.masses = inertia.masses

    @classmethod
    def at(cls, world: World, x: Floats) -> ContactMotion:
        """Returns the motion of contacts of any world at an instant, in the state x = (q, v)."""
        q, v = np.split(x, 2)
        return cls(world.inertia_at(q), world.calc_contact_bias(q, v))

    @classmethod
    def reader(cls, world: World) -> Callable[[Floats], ContactMotion]:
        """Returns a function from states to motions (`at`); a constant one if J is constant."""
        if not world.has_constant_inertia:
            return partial(cls.at, world)
        motion = cls(world.constant_inertia)
        return lambda x: motion

    def calc_distances(self, x: Floats) -> tuple[list[float], list[float]]:
        """Returns φ [m] and φ̇ [m/s] of each contact."""
        both = (self._rows @ x + self._origin).tolist()
        return both[: self._num_contacts], both[self._num_contacts :]

    def calc_clearances(self, x: Floats) -> list[Clearance]:
        """Returns the clearance of each solid."""
        return find_clearances(self.solids, *self.calc_distances(x))

    def calc_pushes(self, acceleration: Floats) -> list[float]:
        """Returns φ̈ of each contact [m/s²]; negative is into the wall."""
        pushes = self._jacobian @ acceleration
        return (pushes if self._turning is None else pushes + self._turning).tolist()

    def calc_supported(self, rates: Floats, contacts: Iterable[int]) -> Floats:
        """Returns the nearest rates x of change of v, or of q, to r that enter none of contacts C.

            minimize ½ (x − r)ᵀ M (x − r)   subject to   J_C x ≥ 0

        For accelerations that is Gauss's principle of least constraint: x = r + M⁻¹ J_Cᵀ λ with
        λ ≥ 0, J_C x ≥ 0, λᵀ J_C x = 0, the forces of rest on frictionless walls. For velocities it
        is a plastic impact.
        """
        held = np.zeros(self._num_contacts, dtype=bool)
        held[list(contacts)] = True
        if not held.any():
            return rates
        rates = self.extend(rates, 1.0)
        x = np.empty_like(rates)
        support(self.walls, held, rates, x)
        return x if self._turning is None else x[:-1]

    def extend(self, row: Floats, value: float) -> Floats:
        """Returns a row of nv values as in `Walls`: with a value for J̇ v if J varies."""
        return row if self._turning is None else np.append(row, value)


def read_clearances(world: World, x: Floats) -> list[Clearance]:
    """Returns the clearance of each solid in any world, in the state x = (q, v)."""
    q, v = np.split(x, 2)
    distances, rates = world.calc_signed_distance(q), world.calc_contact_rate(q, v)
    return find_clearances(world.solids, distances.tolist(), rates.tolist())


def find_clearances(
    solids: tuple[tuple[int, ...], ...], distances: list[float], rates: list[float]
) -> list[Clearance]:
    """Returns the clearance of each solid, given φ [m] and φ̇ [m/s] of each contact."""
    faces = [
        solid[0] if len(solid) == 1 else max(solid, key=distances.__getitem__) for solid in solids
    ]
    return [Clearance(i, distances[i], rates[i]) for i in faces]


def calc_depth(walls: Walls, positions: ArrayLike) -> float:
    """Returns the largest penetration of the ball in a solid, ≥ 0 [m], at q (K, nq) [m]."""
    distances = np.asarray(positions) @ walls.jacobian.T + walls.offset
    outside = np.maximum.reduceat(distances, walls.firsts[:-1], axis=1)
    return -float(np.min(outside, initial=0.0))


@inner
def dot(matrix: Floats, row: int, x: Floats) -> float:
    """Return the product of a matrix's row and x."""
    total = 0.0
    for k in range(x.size):
        total += matrix[row, k] * x[k]
    return total


@inner
def find_size(x: Floats) -> float:
    """Return the largest |x_i|, but at least 1."""
    size = 1.0
    for i in range(x.size):
        size = max(size, abs(x[i]))
    return size


@kernel
def calc_time_to_wall(distance: float, rate: float, push: float) -> float:
    """Return the first t ≥ 0 at which φ + φ̇ t + φ̈ t²/2 falls to 0 [s]; infinity if there is none.

    The distance φ is at least 0, or below 0 where the rate φ̇ > 0; the push φ̈ is constant.
    """
    discriminant = rate * rate - 2 * push * distance
    if discriminant < 0:
        return math.inf
    if rate < 0:
        return 2 * distance / (math.sqrt(discriminant) - rate)
    return (math.sqrt(discriminant) + rate) / -push if push < 0 else math.inf


@kernel
def support(walls: Walls, held: Bools, free: Floats, rates: Floats) -> None:
    """Write the nearest rates x to free ones r, shape (nv,), that enter none of the held contacts.

    `ContactMotion.calc_supported` has the problem. With multipliers μ_i = A_ii λ_i it is

        x = r + Σ μ_i lift_i,    0 ≤ μ ⊥ J_C x ≥ 0

    solved by exchanging the first μ_i or (J x)_i below 0 for the other, until there is none (K. G.
    Murty, "Note on a Bard-type scheme for solving the complementarity problem", Opsearch 11, 1974).
    Both may be one array.
    """
    m, tolerance = held.size, 0.0
    # w = table[:, :m] z + table[:, m], where z are the multipliers and w the rates J x, but each
    # in the place of the other for what pushes.
    table, pushes = np.empty((m, m + 1)), held.copy()
    for i in range(m):
        pushes[i] = False
        for j in range(m + 1):
            table[i, j] = 0.0
        if held[i]:
            table[i, m] = dot(walls.jacobian, i, free)
            tolerance = max(tolerance, _ROUNDING * abs(table[i, m]))
            for j in range(m):
                if held[j]:
                    for k in range(free.size):
                        table[i, j] += walls.jacobian[i, k] * walls.lifts[j, k]
    for _ in range(_MOST_EXCHANGES):
        least = 0
        while least < m and not (held[least] and table[least, m] < -tolerance):
            least += 1
        if least == m:
            break
        _exchange(table, least)
        pushes[least] = not pushes[least]
    for k in range(free.size):
        rates[k] = free[k]
    for i in range(m):
        if pushes[i]:
            add(rates, table[i, m], walls.lifts, i)


@inner
def add(x: Floats, factor: float, matrix: Floats, row: int) -> None:
    """Add a matrix's row times a factor to x."""
    for k in range(x.size):
        x[k] += factor * matrix[row, k]


@inner
def _exchange(table: Floats, pivot: int) -> None:
    """Exchange w_i and z_i in a table w = T (z, 1)."""
    inverse = 1.0 / table[pivot, pivot]
    table[pivot, pivot] = -1.0
    for j in range(table.shape[1]):
        table[pivot, j] *= -inverse
    for i in range(table.shape[0]):
        if i != pivot:
            factor = table[i, pivot]
            table[i, pivot] = 0.0
            for j in range(table.shape[1]):
                table[i, j] += factor * table[pivot, j]


def contact_delay(world: World) -> float:
    """Returns the longest duration of an elastic contact of the world, π √(m / k) [s].

    A rigid wall reverses the ball at once. Drake's compliant one, of stiffness k = k₁ k₂ /
    (k₁ + k₂), keeps it for half a period of m = (J_i M⁻¹ J_iᵀ)⁻¹ on a spring, which delays all
    that follows.

    Raises:
        ModelError: a shape has no stiffness.
    """
    return max(contact_delays(world), default=0.0)


def contact_delays(world: World, q: Floats | None = None) -> list[float]:
    """Returns `contact_delay` of each contact [s].

    If m depends on q it is the one there; without q, the smaller one of two positions, as at either
    a link may be stretched out along a wall's normal, with infinite effective mass.
    """
    if isinstance(world, SpaceWorld):
        place = world.plant.GetDefaultPositions()
        J = world.calc_contact_jacobian(place)
        mobilities = calc_mobilities(world.calc_mass_matrix(place), J)
        return (np.pi / np.sqrt(np.maximum(mobilities * world.stiffness, _NO_PACE))).tolist()
    reader = ContactMotion.reader(world)
    places = (world.plant.GetDefaultPositions(), find_anywhere(world.plant)) if q is None else (q,)
    motions = [reader(np.concatenate([place, np.zeros(len(place))])) for place in places]
    delays = [calc_delays(motion, world.stiffness) for motion in motions]
    return np.min(delays, axis=0).tolist()


def calc_delays(motion: ContactMotion, stiffness: Floats, longest: float = math.inf) -> list[float]:
    """Returns durations of contacts of stiffness (m,) [N/m], limited to the longest [s]."""
    pairs = zip(motion.masses, stiffness, strict=True)
    return [min(math.pi * math.sqrt(m / k), longest) for m, k in pairs]
