"""Sums of products, compiled to a list of multiplications: the tapes of mechanisms."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from drake_aigto.arrays import Floats, Ints, read_only
from drake_aigto.contact.tables import SOURCE, FrictionTerm, Row
from drake_aigto.dynamics import Blend, EquationsOfMotion
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import Factor, FunctionKind, Term, expression_terms
from drake_aigto.world import World

# The places of the factors of a product, in order ↦ coefficient.
Sum = dict[tuple[int, ...], float]


class SumTape(NamedTuple):
    """Z sums f: ℝⁿ → ℝᶻ of products, in the order in which they are computed.

    Each value has a place: 1 at 0, then the n coordinates, then cos y and sin y of each of W waves,
    y = scale·x + offset, then P products of two earlier values each.

    Attributes:
        code: W, P, the number of early products, of sums that change, and of early ones of these;
            then x of each wave, two factors of each product, and for each sum that changes its
            number, the number of its summands and their places. Early ones suffice for values
            without derivatives.
        numbers: scale and offset of each wave, then the coefficient of each summand.
        constants: the sums that never change, shape (Z,); others are 0 there.
    """

    code: Ints
    numbers: Floats
    constants: Floats


class TapeBuilder:
    """Reads sums, differentiates them, and compiles them to a `SumTape`."""

    def __init__(self, variables: Iterable[Any]) -> None:
        """Takes the variables of the sums, in their order."""
        self.variables = list(variables)
        self._waves: dict[tuple[int, float, float], int] = {}

    def read(self, expression: Any) -> Sum:
        """Returns a sum of products of powers, sin and cos.

        Raises:
            UnsupportedTermError: it is none.
        """
        terms = expression_terms("the world", expression, self.variables, is_row=True)
        return self.collect("the world", terms, range(len(self.variables)))

    def collect(self, label: str, terms: Iterable[Term], variables: Sequence[int]) -> Sum:
        """Returns the sum of terms over these of the variables.

        Raises:
            UnsupportedTermError: a factor is no power, sin or cos; names it by the label.
        """
        found: Sum = {}
        for term in terms:
            places = [p for each in term.factors for p in self._find_places(label, each, variables)]
            _add(found, tuple(sorted(places)), term.coefficient)
        return found

    def _find_places(self, label: str, factor: Factor, variables: Sequence[int]) -> list[int]:
        """Returns the places of values with this factor as their product."""
        variable = int(variables[factor.variable])
        powers = [1 + variable] * factor.exponent
        if factor.kind == FunctionKind.POWER:
            return powers
        if factor.kind not in (FunctionKind.COSINE, FunctionKind.SINE):
            raise UnsupportedTermError(label, got=str(factor), expected="powers, sin and cos")
        number = self._waves.setdefault((variable, factor.scale, factor.offset), len(self._waves))
        is_sine = factor.kind == FunctionKind.SINE
        return [*powers, 1 + len(self.variables) + 2 * number + is_sine]

    def differentiate(self, sum_: Sum, variable: int) -> Sum:
        """Returns ∂f/∂x of a sum."""
        found: Sum = {}
        waves, first = list(self._waves), 1 + len(self.variables)
        for product, coefficient in sum_.items():
            for i, place in enumerate(product):
                rest = product[:i] + product[i + 1 :]
                if place == 1 + variable:
                    _add(found, rest, coefficient)
                elif place >= first and waves[(place - first) // 2][0] == variable:
                    scale, is_sine = waves[(place - first) // 2][1], (place - first) % 2
                    other = place - 1 if is_sine else place + 1
                    slope = coefficient * (scale if is_sine else -scale)
                    _add(found, tuple(sorted((*rest, other))), slope)
        return {product: c for product, c in found.items() if c != 0.0}

    def differentiate_along(self, sum_: Sum, rates: Floats) -> Sum:
        """Returns Σ_j (c_j0 + Σ_k c_jk x_k) ∂f/∂x_j of a sum; rates are c, shape (J, 1 + K)."""
        found: Sum = {}
        for j in np.flatnonzero(rates.any(axis=1)).tolist():
            for product, slope in self.differentiate(sum_, j).items():
                for k in np.flatnonzero(rates[j]).tolist():
                    longer = tuple(sorted((*product, k))) if k else product
                    _add(found, longer, slope * float(rates[j, k]))
        return {product: c for product, c in found.items() if c != 0.0}

    def build(self, values: list[Sum], slopes: list[Sum]) -> SumTape:
        """Returns the tape of sums: values and slopes; values can be computed alone."""
        sums = [*values, *slopes]
        places = _ProductPlaces(1 + len(self.variables) + 2 * len(self._waves))
        changing = [
            (
                number,
                {places.find(product): c for product, c in sums[number].items()},
                len(places.factors),
            )
            for number in range(len(sums))
            if any(sums[number])
        ]
        early = [row for row in changing if row[0] < len(values)]
        waves = list(self._waves)
        code = [len(waves), len(places.factors), early[-1][2] if early else 0]
        code += [len(changing), len(early), *(variable for variable, _, _ in waves)]
        code += [place for pair in places.factors for place in pair]
        numbers = [number for _, *wave in waves for number in wave]
        for number, summands, _ in changing:
            code += [number, len(summands), *summands]
            numbers += summands.values()
        constants = [0.0 if any(sum_) else sum_.get((), 0.0) for sum_ in sums]
        return SumTape(read_only(code, np.int64), read_only(numbers), read_only(constants))


class _ProductPlaces:
    """Places of products, each made of a shorter one and one more factor."""

    def __init__(self, first: int) -> None:
        self.factors: list[tuple[int, int]] = []
        self._first = first
        self._known: dict[tuple[int, ...], int] = {(): 0}

    def find(self, product: tuple[int, ...]) -> int:
        if len(product) == 1:
            return product[0]
        if product not in self._known:
            self.factors.append((self.find(product[:-1]), product[-1]))
            self._known[product] = self._first + len(self.factors) - 1
        return self._known[product]


def _add(sum_: Sum, product: tuple[int, ...], coefficient: float) -> None:
    sum_[product] = sum_.get(product, 0.0) + coefficient


# Reading a world takes longer than simulating it for a period, as filters and controllers do.
_tapes: WeakKeyDictionary[World, dict[tuple[float, ...], SumTape]] = WeakKeyDictionary()


def read_tape(world: World, is_rigid: bool, frictions: Sequence[FrictionTerm]) -> SumTape:
    """Returns the tape of a world, compiled once for the contacts with friction."""
    known = _tapes.setdefault(world, {})
    key = is_rigid, *(term.numbers[SOURCE] for term in frictions)
    if key not in known:
        mixed = _mix(world.blended, is_rigid, frictions) if world.blended else None
        known[key] = mixed or _compile(world, is_rigid, [term.row for term in frictions])
    return known[key]


def _mix(blend: Blend, is_rigid: bool, frictions: Sequence[FrictionTerm]) -> SumTape | None:
    """Returns the tape of a blend of worlds; None: theirs are of other products."""

    def read(world: World) -> SumTape:
        return read_tape(world, is_rigid, frictions)

    if not blend.are_alike(lambda world: (read(world).code,)):
        return None
    numbers = blend.mix(lambda world: read(world).numbers)
    return SumTape(read(blend.first).code, numbers, blend.mix(lambda world: read(world).constants))


def _compile(world: EquationsOfMotion, is_rigid: bool, rows: Sequence[Row]) -> SumTape:
    """Returns the tape of M, h, φ, J, T and their derivatives; those for `hold_contacts` if rigid.

    Rows T are expressions, shape (n,) each.
    """
    n = world.num_positions
    builder = TapeBuilder([*world.positions, *world.velocities])
    upper = np.triu_indices(n)
    mass = [builder.read(entry) for entry in world.mass_matrix[upper]]
    # A place for a constant, which blends of worlds may have.
    bias = [{(): 0.0} | builder.read(entry) for entry in world.bias]
    distance = [{(): 0.0} | builder.read(each.signed_distance) for each in world.contacts]
    differentiate: Any = builder.differentiate
    jacobian = [[differentiate(phi, j) for j in range(n)] for phi in distance]
    slopes = [differentiate(entry, j) for entry in mass for j in range(n)]
    slopes += [differentiate(entry, j) for entry in bias for j in range(2 * n)]
    bends = [[differentiate(row[i], j) for i, j in zip(*upper, strict=True)] for row in jacobian]
    tangents = [builder.read(entry) for row in rows for entry in row]
    spins = [differentiate(entry, c) for entry in tangents for c in range(n)]
    slopes += [*(bend for each in bends for bend in each), *spins]
    if is_rigid:
        of_contacts = [_contract(each, np.transpose(upper).tolist(), n) for each in bends]
        of_friction = [
            _contract(spins[first : first + n * n], list(np.ndindex(n, n)), n)
            for first in range(0, len(spins), n * n)
        ]
        slopes += [differentiate(f, c) for f in (*of_contacts, *of_friction) for c in range(n)]
    normals = [entry for row in jacobian for entry in row]
    return builder.build([*mass, *bias, *distance, *normals, *tangents], slopes)


def _contract(bends: Sequence[Sum], places: Sequence[Sequence[int]], n: int) -> Sum:
    """Returns vᵀ S v of the entries of a matrix: all, or a symmetric one's upper triangle."""
    found: Sum = {}
    for bend, (i, j) in zip(bends, places, strict=True):
        for product, coefficient in bend.items():
            whole = tuple(sorted((*product, 1 + n + i, 1 + n + j)))
            twice = len(bends) < n * n and i != j
            found[whole] = found.get(whole, 0.0) + (2 if twice else 1) * coefficient
    return found
