"""Sums of products of coordinates, sin and cos, compiled to a list of multiplications."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints, read_only
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.jit import inner
from drake_aigto.terms import Factor, FunctionKind, expression_terms

# The places of the factors of a product, in order ↦ coefficient.
Sum = dict[tuple[int, ...], float]


class Tape(NamedTuple):
    """Z sums f: ℝⁿ → ℝᶻ of products, in the order in which they are computed.

    Each value has a place: 1 at 0, then the n coordinates, then cos y and sin y of each of W waves,
    y = scale·x + offset, then P products of two earlier values each.

    Attributes:
        code: W, P, how many products come early, how many sums change, and how many of these come
            early; then x of each wave, two factors of each product, and of each sum that changes
            its number, the number of its summands and their places. What is early is all that
            values without derivatives need.
        numbers: scale and offset of each wave, then the coefficient of each summand.
        constants: the sums that never change, shape (Z,); others are 0 there.
    """

    code: Ints
    numbers: Floats
    constants: Floats


class TapeBuilder:
    """Reads sums, differentiates them, and compiles them to a `Tape`."""

    def __init__(self, variables: Iterable[Any]) -> None:
        """Takes the variables of the sums, in their order."""
        self._variables = list(variables)
        self._waves: dict[tuple[int, float, float], int] = {}

    def read(self, expression: Any) -> Sum:
        """Returns a sum of products of powers, sin and cos.

        Raises:
            UnsupportedTermError: it is none.
        """
        found: Sum = {}
        for term in expression_terms("the world", expression, self._variables, is_row=True):
            places = [place for factor in term.factors for place in self._find_places(factor)]
            _add(found, tuple(sorted(places)), term.coefficient)
        return found

    def _find_places(self, factor: Factor) -> list[int]:
        """Returns the places whose product a factor is."""
        powers = [1 + factor.variable] * factor.exponent
        if factor.kind == FunctionKind.POWER:
            return powers
        if factor.kind not in (FunctionKind.COSINE, FunctionKind.SINE):
            raise UnsupportedTermError("the world", got=str(factor), expected="powers, sin and cos")
        wave = factor.variable, factor.scale, factor.offset
        number = self._waves.setdefault(wave, len(self._waves))
        is_sine = factor.kind == FunctionKind.SINE
        return [*powers, 1 + len(self._variables) + 2 * number + is_sine]

    def differentiate(self, sum_: Sum, variable: int) -> Sum:
        """Returns ∂f/∂x of a sum."""
        found: Sum = {}
        waves, first = list(self._waves), 1 + len(self._variables)
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

    def build(self, values: list[Sum], slopes: list[Sum], more: Sequence[Sum] = ()) -> Tape:
        """Returns the tape of sums: values and slopes, of which values can be had alone.

        More values stand behind the slopes.
        """
        sums, first = [*values, *slopes, *more], len(values) + len(slopes)
        order = [*range(len(values)), *range(first, len(sums)), *range(len(values), first)]
        places = _ProductPlaces(1 + len(self._variables) + 2 * len(self._waves))
        changing = [
            (
                number,
                {places.find(product): c for product, c in sums[number].items()},
                len(places.factors),
            )
            for number in order
            if any(sums[number])
        ]
        early = [row for row in changing if not len(values) <= row[0] < first]
        waves = list(self._waves)
        code = [len(waves), len(places.factors), early[-1][2] if early else 0]
        code += [len(changing), len(early), *(variable for variable, _, _ in waves)]
        code += [place for pair in places.factors for place in pair]
        numbers = [number for _, *wave in waves for number in wave]
        for number, summands, _ in changing:
            code += [number, len(summands), *summands]
            numbers += summands.values()
        constants = [0.0 if any(sum_) else sum_.get((), 0.0) for sum_ in sums]
        return Tape(read_only(code, np.int64), read_only(numbers), read_only(constants))


class _ProductPlaces:
    """Where products stand, each made of a shorter one and one factor more."""

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


@inner
def run_tape(
    code: Ints, numbers: Floats, x: Floats, has_slopes: bool, values: Floats, sums: Floats
) -> None:
    """Computes the sums at x that change, and their derivatives if asked.

    Args:
        code: of the tape.
        numbers: of the tape.
        x: the coordinates, shape (n,).
        has_slopes: whether the derivatives are computed, too.
        values: memory for what has a place.
        sums: the result, shape (Z,); those that never change are there already.
    """
    num_products, num_sums = (code[1], code[3]) if has_slopes else (code[2], code[4])
    values[0] = 1.0
    for i in range(x.size):
        values[1 + i] = x[i]
    at, read, number = 1 + x.size, 5, 0
    for _ in range(code[0]):
        y = numbers[number] * x[code[read]] + numbers[number + 1]
        values[at] = np.cos(y)
        values[at + 1] = np.sin(y)
        at, read, number = at + 2, read + 1, number + 2
    for _ in range(num_products):
        values[at] = values[code[read]] * values[code[read + 1]]
        at, read = at + 1, read + 2
    read = 5 + code[0] + 2 * code[1]
    for _ in range(num_sums):
        total, z, count = 0.0, code[read], code[read + 1]
        read += 2
        for _ in range(count):
            total += numbers[number] * values[code[read]]
            read, number = read + 1, number + 1
        sums[z] = total
