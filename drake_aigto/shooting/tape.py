"""Sums of products of coordinates, sin and cos, compiled to a list of multiplications."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import accumulate
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
        code: W, P, how many products come early, Z, how many sums come early; then x of each wave,
            two factors of each product, where each sum starts among the summands (Z + 1), and the
            place of each summand. What is early is all that values without derivatives need.
        numbers: scale and offset of each wave, then the coefficient of each summand.
    """

    code: Ints
    numbers: Floats


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

    def build(self, values: list[Sum], slopes: list[Sum]) -> Tape:
        """Returns the tape of sums: values first, which can be had alone."""
        places = _ProductPlaces(1 + len(self._variables) + 2 * len(self._waves))
        sums = [[(places.find(p), c) for p, c in sum_.items()] for sum_ in values]
        num_early = len(places.factors), len(values)
        sums += [[(places.find(p), c) for p, c in sum_.items()] for sum_ in slopes]
        entries = [entry for sum_ in sums for entry in sum_]
        waves = list(self._waves)
        code = [len(waves), len(places.factors), num_early[0], len(sums), num_early[1]]
        code += [variable for variable, _, _ in waves]
        code += [place for pair in places.factors for place in pair]
        code += [*accumulate(map(len, sums), initial=0), *(place for place, _ in entries)]
        numbers = [number for _, *wave in waves for number in wave]
        numbers += [coefficient for _, coefficient in entries]
        return Tape(read_only(code, np.int64), read_only(numbers))


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
    """Computes the sums at x, and their derivatives if asked.

    Args:
        code: of the tape.
        numbers: of the tape.
        x: the coordinates, shape (n,).
        has_slopes: whether the derivatives are computed, too.
        values: memory for what has a place.
        sums: the result, shape (Z,).
    """
    num_waves, num_products, num_sums = code[0], code[1], code[3]
    factors = 5 + num_waves
    starts = factors + 2 * num_products
    places, coefficients = starts + num_sums + 1, 2 * num_waves
    if not has_slopes:
        num_products, num_sums = code[2], code[4]
    values[0] = 1.0
    for i in range(x.size):
        values[1 + i] = x[i]
    at = 1 + x.size
    for w in range(num_waves):
        y = numbers[2 * w] * x[code[5 + w]] + numbers[2 * w + 1]
        values[at] = np.cos(y)
        values[at + 1] = np.sin(y)
        at += 2
    for p in range(num_products):
        values[at + p] = values[code[factors + 2 * p]] * values[code[factors + 2 * p + 1]]
    for z in range(num_sums):
        total = 0.0
        for e in range(code[starts + z], code[starts + z + 1]):
            total += numbers[coefficients + e] * values[code[places + e]]
        sums[z] = total
