"""Sums of terms of a mechanism's cost over boxes, in variables in which forces have means."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression

from drake_aigto.arrays import Bools, Floats
from drake_aigto.terms import (
    Factor,
    FunctionKind,
    NoClosedFormError,
    Sum,
    add,
    compose,
    constant,
    evaluate,
    expression_terms,
    from_terms,
    function,
    multiply,
)
from drake_aigto.world import World


class Reading(NamedTuple):
    """A signed distance as a function of a variable z of its knot: φ = scale · z + offset.

    Attributes:
        variable: the place of z among the knot's variables.
        scale: ∂φ/∂z.
        offset: φ at z = 0 [m].
    """

    variable: int
    scale: float
    offset: float

    @property
    def depth(self) -> Sum:
        """max(0, −φ)."""
        return function(self.variable, FunctionKind.HINGE, 1, self.scale, self.offset)


@dataclass(frozen=True)
class BoxCoordinates:
    """The variables z = (y, s) of a knot, with positions and distances as their functions.

    The force k max(0, −φ) of a soft wall has a mean over boxes where φ is affine in one variable.
    So where φ(q) = c q_j + g(the others) + b, with constants c and b, as for the tip of a pole on a
    cart, y_j = q_j + g/c takes the place of q_j. The other y are coordinates themselves. Where
    there is no such j, φ − b has a variable s of its own, which a program has to penalize.

    Attributes:
        positions: q as functions of z, n of them.
        distances: φ − b as functions of y, for each s, S of them.
        contacts: the selected ones.
        readings: of the signed distances of these.
    """

    positions: tuple[Sum, ...]
    distances: tuple[Sum, ...] = ()
    contacts: tuple[int, ...] = ()
    readings: tuple[Reading, ...] = ()

    @classmethod
    def of(cls, world: World, contacts: Iterable[int]) -> BoxCoordinates:
        """Returns those of some of a world's contacts."""
        found = cls(variables(range(world.num_positions)))
        for i in contacts:
            distance = read_sum(world.contacts[i].signed_distance, world.positions)
            found = replace(found, contacts=(*found.contacts, i))
            found = found._with_contact(compose(distance, found.positions))
        return found

    @property
    def num_positions(self) -> int:
        """Coordinates, n."""
        return len(self.positions)

    @property
    def num_variables(self) -> int:
        """Variables of a knot, n + S."""
        return len(self.positions) + len(self.distances)

    def calc_positions(self, z: Floats) -> Floats:
        """Returns q, shape (…, n), at z of shape (…, n + S)."""
        return np.stack([evaluate(q, z) for q in self.positions], axis=-1)

    def calc_variables(self, world: World, q: Floats) -> Floats:
        """Returns z, shape (…, n + S), at q of shape (…, n)."""
        z = np.zeros((*q.shape[:-1], self.num_variables))
        z[..., : self.num_positions] = q
        phi = world.calc_signed_distance(q) if self.contacts else z
        for i, reading in zip(self.contacts, self.readings, strict=True):
            z[..., reading.variable] = (phi[..., i] - reading.offset) / reading.scale
        return z

    def _with_contact(self, distance: Sum) -> BoxCoordinates:
        """Returns the same with a reading of one more distance, a function of y."""
        for reading in self._find_readings(distance):
            if self._can_be_multiplied(reading):
                return replace(self, readings=(*self.readings, reading))
        taken = {reading.variable for reading in self.readings}
        for j in range(self.num_positions):
            readers = [parts for parts in distance if any(part.variable == j for part in parts)]
            if j not in taken and readers == [(Factor(j, FunctionKind.POWER),)]:
                return self._with_substitution(j, distance)
        return self._with_variable(distance)

    def _find_readings(self, distance: Sum) -> list[Reading]:
        """Returns the reading of a distance from existing variables, if possible."""
        varying, offset = _split_constant(distance)
        known = [*variables(range(self.num_positions)), *self.distances]
        ratios = (_find_ratio(varying, other) for other in known)
        return [Reading(i, ratio, offset) for i, ratio in enumerate(ratios) if ratio is not None]

    def _can_be_multiplied(self, reading: Reading) -> bool:
        """Returns whether the product with every other force of the variable has a mean."""
        others = [each for each in self.readings if each.variable == reading.variable]
        try:
            for other in others:
                multiply(reading.depth, other.depth)
        except NoClosedFormError:
            return False
        return True

    def _with_substitution(self, j: int, distance: Sum) -> BoxCoordinates:
        """Returns the same with y_j such that a distance is c y_j + b."""
        varying, offset = _split_constant(distance)
        scale = varying.pop((Factor(j, FunctionKind.POWER),))
        values = list(variables(range(self.num_positions)))
        values[j] = add(values[j], {parts: -a / scale for parts, a in varying.items()})
        return replace(
            self,
            positions=tuple(compose(q, values) for q in self.positions),
            distances=tuple(compose(s, values) for s in self.distances),
            readings=(*self.readings, Reading(j, scale, offset)),
        )

    def _with_variable(self, distance: Sum) -> BoxCoordinates:
        """Returns the same with a variable of a distance's own."""
        varying, offset = _split_constant(distance)
        return replace(
            self,
            distances=(*self.distances, varying),
            readings=(*self.readings, Reading(self.num_variables, 1.0, offset)),
        )


def variables(places: Iterable[int]) -> tuple[Sum, ...]:
    """Returns variables as sums."""
    return tuple(function(place, FunctionKind.POWER) for place in places)


def read_sum(expression: Expression, names: Sequence[Any] | NDArray[Any]) -> Sum:
    """Returns an expression of the world as a sum over the places of its variables."""
    return from_terms(expression_terms("the world", expression, names, is_row=True))


def _split_constant(distance: Sum) -> tuple[Sum, float]:
    """Returns the varying part of a sum, and its constant."""
    varying = dict(distance)
    return varying, varying.pop((), 0.0)


def _find_ratio(one: Sum, other: Sum) -> float | None:
    """Returns a number r such that one = r · other, if there is one."""
    if one.keys() != other.keys():
        return None
    ratios = [a / other[parts] for parts, a in one.items()]
    return ratios[0] if np.allclose(ratios, ratios[0], rtol=1e-12, atol=0.0) else None


class StageSums:
    """Positions, velocities and forces at a knot as sums over (z_{k−1}, z_k, z_{k+1}).

    Args:
        world: the mechanism.
        coordinates: z.
        stiffness: k of the springs of its contacts [N/m].
        dissipation: d of these [s/m].
        time_step: dt [s].

    Attributes:
        positions: q_k, n sums.
        velocities: v_k, n sums.
        forces: p_k = M a + h − Jᵀ f, n sums.
        distances: s_k − φ(q_k) + b, S sums.
    """

    def __init__(
        self,
        world: World,
        coordinates: BoxCoordinates,
        stiffness: Floats,
        dissipation: Floats,
        time_step: float,
    ) -> None:
        """Expands products."""
        self._coordinates, self._dt = coordinates, time_step
        self._num = coordinates.num_variables
        positions = coordinates.positions
        before, self.positions, after = ([self._at(q, k) for q in positions] for k in range(3))
        self.velocities = [self._slope(*ends) for ends in zip(before, after, strict=True)]
        own = variables(range(coordinates.num_positions, coordinates.num_variables))
        self.distances = [
            self._at(add(s, scaled(-1.0, distance)), 1)
            for s, distance in zip(own, coordinates.distances, strict=True)
        ]
        accelerations = [
            scaled(time_step**-2, add(a, b, scaled(-2.0, q)))
            for a, q, b in zip(before, self.positions, after, strict=True)
        ]
        self.forces = self._calc_forces(world, accelerations, stiffness, dissipation)

    def _at(self, total: Sum, k: int) -> Sum:
        """Returns a sum over z as one over z_{k−1}, z_k or z_{k+1}, k = 0, 1, 2."""
        return compose(total, variables(range(k * self._num, (k + 1) * self._num)))

    def _slope(self, before: Sum, after: Sum) -> Sum:
        return scaled(1 / (2 * self._dt), add(after, scaled(-1.0, before)))

    def _calc_forces(
        self, world: World, accelerations: list[Sum], stiffness: Floats, dissipation: Floats
    ) -> list[Sum]:
        springs = zip(self._coordinates.readings, stiffness, dissipation, strict=True)
        pushes = [self._push(*spring) for spring in springs]
        jacobian = [
            self._read(world.contacts[i].jacobian, world) for i in self._coordinates.contacts
        ]
        bias = self._read(world.bias, world)
        return [
            add(
                bias[i],
                *map(multiply, self._read(row, world), accelerations),
                *(scaled(-1.0, multiply(J[i], f)) for J, f in zip(jacobian, pushes, strict=True)),
            )
            for i, row in enumerate(world.mass_matrix)
        ]

    def _push(self, reading: Reading, stiffness: float, dissipation: float) -> Sum:
        """Returns k max(0, −φ) (1 − d φ̇) of a spring."""
        (z,) = variables([reading.variable])
        rate = scaled(reading.scale, self._slope(self._at(z, 0), self._at(z, 2)))
        damping = add(constant(1.0), scaled(-dissipation, rate))
        return scaled(stiffness, multiply(self._at(reading.depth, 1), damping))

    def _read(self, expressions: NDArray[Any], world: World) -> list[Sum]:
        """Returns expressions of q and v at the knot."""
        names = [*world.positions, *world.velocities]
        values = [*self.positions, *self.velocities]
        return [compose(read_sum(each, names), values) for each in expressions]


def scaled(factor: float, total: Sum) -> Sum:
    """Returns a sum times a number."""
    return multiply(constant(factor), total) if factor else {}


def combine(weights: Iterable[float], sums: Iterable[Sum]) -> Sum:
    """Returns Σ w_i sum_i."""
    return add(*map(scaled, map(float, weights), sums))


def quadratic(weights: Floats, sums: Sequence[Sum]) -> Sum:
    """Returns Σ_ij w_ij sum_i sum_j of a symmetric matrix (n, n)."""
    pairs = zip(*np.nonzero(np.triu(weights)), strict=True)
    return add(
        *(
            scaled((1 + (i != j)) * float(weights[i, j]), multiply(sums[i], sums[j]))
            for i, j in pairs
        )
    )


_COSINE, _SINE = (function(0, kind, 0) for kind in (FunctionKind.COSINE, FunctionKind.SINE))


@dataclass(frozen=True, eq=False)
class TrackingSums:
    """eᵀ Q e + ėᵀ Qv ė = fixed + Σ_i p_i basis_i, e = q − about_q, ė = v − about_v.

    Attributes:
        position_weight: Q, shape (n, n).
        velocity_weight: Qv, shape (n, n).
        is_chordal: coordinates with 2 − 2 cos e as e²; Q has only its diagonal there.
    """

    position_weight: Floats
    velocity_weight: Floats
    is_chordal: Bools

    @property
    def _chord_weights(self) -> Floats:
        return np.where(self.is_chordal, np.diag(self.position_weight), 0.0)

    @property
    def _exact_weight(self) -> Floats:
        return self.position_weight - np.diag(self._chord_weights)

    def fixed(self, positions: Sequence[Sum], velocities: Sequence[Sum]) -> Sum:
        """Returns the part without parameters, given sums for q and v."""
        return add(
            quadratic(self._exact_weight, positions),
            quadratic(self.velocity_weight, velocities),
            constant(2.0 * float(np.sum(self._chord_weights))),
        )

    def basis(self, positions: Sequence[Sum], velocities: Sequence[Sum]) -> list[Sum]:
        """Returns the factors of parameters."""
        chords, exact, rates = self._members()
        waves = [compose(wave, [positions[i]]) for wave in (_COSINE, _SINE) for i in chords]
        lines = [*(positions[i] for i in exact), *(velocities[i] for i in rates)]
        return [*waves, *lines, constant(1.0)]

    def calc_parameters(self, about_q: Floats, about_v: Floats) -> Floats:
        """Returns p."""
        chords, exact, rates = self._members()
        slope, rate = self._exact_weight @ about_q, self.velocity_weight @ about_v
        angles, weights = about_q[chords], self._chord_weights[chords]
        parts = weights * np.cos(angles), weights * np.sin(angles), slope[exact], rate[rates]
        return np.append(-2 * np.concatenate(parts), about_q @ slope + about_v @ rate)

    def _members(self) -> list[list[int]]:
        """Returns the coordinates with chords, other squares, and squares of velocities."""
        weights = np.diag(self._chord_weights), self._exact_weight, self.velocity_weight
        return [np.flatnonzero(np.any(each, axis=1)).tolist() for each in weights]
