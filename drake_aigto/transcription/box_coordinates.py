"""Variables in which the forces of walls are functions of one variable, so that they have means."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import Expression

from drake_aigto.arrays import Floats
from drake_aigto.terms import (
    FunctionKind,
    NoClosedFormError,
    Part,
    Sum,
    add,
    compose,
    evaluate,
    expression_terms,
    from_terms,
    function,
    multiply,
)
from drake_aigto.world import World


class Reading(NamedTuple):
    """How a signed distance is read off a variable z of its knot: φ = scale · z + offset.

    Attributes:
        variable: the place of z among the knot's variables.
        scale: ∂φ/∂z.
        offset: φ where z is 0 [m].
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
    """The variables z = (y, s) of a knot, and how positions and distances are read off them.

    The force k max(0, −φ) of a soft wall has a mean over boxes where φ is affine in one variable.
    So where φ(q) = c q_j + g(the others) + b, with constants c and b, as for the tip of a pole on a
    cart, y_j = q_j + g/c takes the place of q_j. The other y are coordinates themselves. Where
    there is no such j, φ − b has a variable s of its own, which a program has to penalize.

    Attributes:
        positions: q as functions of z, n of them.
        distances: φ − b as functions of y, for each s, S of them.
        contacts: those that were asked for.
        readings: how the signed distance of each of these is read off.
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
            if j not in taken and readers == [(Part(j, FunctionKind.POWER),)]:
                return self._with_substitution(j, distance)
        return self._with_variable(distance)

    def _find_readings(self, distance: Sum) -> list[Reading]:
        """Returns how a distance can be read off the variables that there are."""
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
        scale = varying.pop((Part(j, FunctionKind.POWER),))
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
    """Returns what varies of a sum, and its constant."""
    varying = dict(distance)
    return varying, varying.pop((), 0.0)


def _find_ratio(one: Sum, other: Sum) -> float | None:
    """Returns a number r such that one = r · other, if there is one."""
    if one.keys() != other.keys():
        return None
    ratios = [a / other[parts] for parts, a in one.items()]
    return ratios[0] if np.allclose(ratios, ratios[0], rtol=1e-12, atol=0.0) else None
