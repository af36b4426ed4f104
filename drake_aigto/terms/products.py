"""Products of one-variable functions, multiplied out into sums of `Term`s.

A term holds at most one factor of each variable, since the mean of a product of functions of one
variable is not the product of their means. So x·x becomes x², and for waves, at angles a and b,

    2 cos a cos b = cos(a − b) + cos(a + b),    exp a · exp b = exp(a + b),    …

Scales and offsets add up exactly, that like terms of sin(x/3)⁶ are found whatever is rounded.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms.sums import Factor, FunctionKind, Term, with_own_numbers

# More terms than this are refused: 1e6 take some 10 s and 1 GB to parse.
MAX_TERMS = 1_000_000

_POWER, _COSINE, _SINE = FunctionKind.POWER, FunctionKind.COSINE, FunctionKind.SINE
_EXPONENTIAL = FunctionKind.EXPONENTIAL
_TRIGONOMETRIC = (_COSINE, _SINE)
_WAVES = {_COSINE: np.cos, _SINE: np.sin, _EXPONENTIAL: np.exp}


class NoClosedFormError(Exception):
    """A product that no kind of factor stands for; the text says why."""


class TooManyTermsError(Exception):
    """A product of more than MAX_TERMS terms; `count` says how many, before like ones merge."""

    def __init__(self, count: int) -> None:
        """Stores the count."""
        super().__init__(count)
        self.count = count

    def refusal(self, label: str, where: str) -> UnsupportedTermError:
        """Returns the error for a user: the number of terms, what has them, and where."""
        return UnsupportedTermError(
            f"{label} has too many terms",
            got=f"{self.count:,} {where}",
            expected=f"at most {MAX_TERMS:,}",
            remedy="Give parts of it variables of their own by equality constraints.",
        )


# Factors in the order of their variables ↦ coefficient.
Sum = dict[tuple[Factor, ...], float]


def constant(value: float) -> Sum:
    """Returns a number."""
    return {(): value}


def function(
    variable: int, kind: FunctionKind, exponent: int = 1, scale: float = 1.0, offset: float = 0.0
) -> Sum:
    """Returns the function that a `Factor` of these attributes is, times 1."""
    if kind == _POWER:
        return {(Factor(variable, kind, exponent),): 1.0} if exponent else constant(1.0)
    if kind in (FunctionKind.HINGE, FunctionKind.SQUARED_HINGE, FunctionKind.NEG_LOG):
        return {(Factor(variable, kind, exponent, scale, offset),): 1.0}
    coefficient, part = _wave(Factor(variable, kind, exponent, scale, offset))
    return {() if part is None else (part,): coefficient}


def wave_of_sum(kind: FunctionKind, scales: Sequence[tuple[int, float]], offset: float) -> Sum:
    """Returns the cosine, sine or exponential of Σ scale·x + offset, by the addition theorems.

    A cosine or sine of n variables has 2ⁿ⁻¹ terms. Scales are variables, each with its scale.
    """
    (variable, scale), *others = scales
    if kind == _EXPONENTIAL:
        product = function(variable, kind, 0, scale, offset)
        for variable, scale in others:
            product = multiply(product, function(variable, kind, 0, scale))
        return product
    if len(others) >= MAX_TERMS.bit_length():
        raise TooManyTermsError(2 ** len(others))
    cosine = function(variable, _COSINE, 0, scale, offset)
    sine = function(variable, _SINE, 0, scale, offset)
    for variable, scale in others:
        cos, sin = function(variable, _COSINE, 0, scale), function(variable, _SINE, 0, scale)
        minus_sin = {parts: -a for parts, a in sin.items()}
        cosine, sine = (
            add(multiply(cosine, cos), multiply(sine, minus_sin)),
            add(multiply(sine, cos), multiply(cosine, sin)),
        )
    return cosine if kind == _COSINE else sine


def add(*sums: Sum) -> Sum:
    """Returns the sum, without terms that cancel."""
    total: Sum = {}
    for summand in sums:
        _add_into(total, summand.items())
    return {parts: a for parts, a in total.items() if a != 0.0}


def multiply(first: Sum, second: Sum) -> Sum:
    """Returns the product, multiplied out."""
    if len(first) * len(second) > MAX_TERMS:
        raise TooManyTermsError(len(first) * len(second))
    total: Sum = {}
    for parts, a in first.items():
        for others, b in second.items():
            _add_into(total, _times(parts, others, a * b))
    return {parts: a for parts, a in total.items() if a != 0.0}


def power(base: Sum, exponent: int) -> Sum:
    """Returns the whole power ≥ 0, multiplied out."""
    result, steps = constant(1.0), exponent * len(base)  # at least
    for _ in range(exponent):
        steps += (len(result) - 1) * len(base)
        if steps > MAX_TERMS:
            raise TooManyTermsError(steps)
        result = multiply(result, base)
    return result


def compose(total: Sum, values: Sequence[Sum] | Mapping[int, Sum]) -> Sum:
    """Returns a sum whose variables i are replaced by sums values[i], multiplied out.

    Variables that a mapping does not name stay.

    Raises:
        NoClosedFormError: A sum that is not affine replaces the variable of a function that is no
            power, or one of several variables that of a hinge or logarithm.
        TooManyTermsError: There are more than MAX_TERMS.
    """
    return add(*(_compose_term(parts, a, values) for parts, a in total.items()))


def _compose_term(
    parts: tuple[Factor, ...], coefficient: float, values: Sequence[Sum] | Mapping[int, Sum]
) -> Sum:
    product = constant(coefficient)
    for part in parts:
        if isinstance(values, Mapping) and part.variable not in values:
            product = multiply(product, {(part,): 1.0})
            continue
        value = values[part.variable]
        if part.kind == _POWER:
            product = multiply(product, power(value, part.exponent))
        else:
            product = multiply(product, _compose_function(part, value))
    return product


def _compose_function(part: Factor, value: Sum) -> Sum:
    """Returns a wave, hinge or logarithm of an affine sum in place of its variable."""
    scales, offset = _split_affine(value)
    if scales == [(scales[0][0], 1.0)] and not offset:
        return {(part._replace(variable=scales[0][0]),): 1.0}
    offset = float(part.scale) * offset + float(part.offset)
    inside = [(variable, float(part.scale) * scale) for variable, scale in scales]
    if part.kind in _WAVES:
        wave = wave_of_sum(part.kind, inside, offset)
        return multiply(power(value, part.exponent), wave)
    if len(inside) > 1:
        raise NoClosedFormError("a sum of several variables stands in a hinge or logarithm")
    return function(inside[0][0], part.kind, 1, inside[0][1], offset)


def _split_affine(total: Sum) -> tuple[list[tuple[int, float]], float]:
    """Returns [(variable, scale), …] and the offset of an affine sum."""
    scales, offset = [], 0.0
    for parts, coefficient in total.items():
        if not parts:
            offset = coefficient
        elif len(parts) == 1 and parts[0] == Factor(parts[0].variable, _POWER):
            scales.append((parts[0].variable, coefficient))
        else:
            raise NoClosedFormError(
                "a sum that is not affine stands in a function that is no power"
            )
    if not scales:
        raise NoClosedFormError("a constant stands in a function that is no power")
    return scales, offset


def evaluate(total: Sum, x: Floats) -> Floats:
    """Returns a sum of powers, sines and cosines at points (…, n), shape (…), or at Expressions."""
    columns = np.moveaxis(x, -1, 0)  # Of a single point these are numbers, which is much faster.
    values = np.zeros(x.shape[:-1], dtype=np.result_type(x, float))[()]
    for parts, a in total.items():
        product = a
        for part in parts:
            of = columns[part.variable]
            product = product * of**part.exponent
            if part.kind != _POWER:
                product = product * _WAVES[part.kind](float(part.scale) * of + float(part.offset))
        values = values + product
    return values


def to_terms(total: Sum) -> tuple[Term, ...]:
    """Returns a sum as terms of floats."""
    return tuple(
        Term(a, tuple(Factor(*part[:3], float(part.scale), float(part.offset)) for part in parts))
        for parts, a in total.items()
    )


def from_terms(terms: Iterable[Term], places: Sequence[int] | None = None) -> Sum:
    """Returns the sum of terms with variables renamed places[variable], some of them equal.

    Its powers are those of x alone, without scale and offset.
    """
    products = []
    for term in terms:
        product = constant(term.coefficient)
        for f in term.factors:
            variable = f.variable if places is None else places[f.variable]
            product = multiply(product, function(variable, f.kind, f.exponent, f.scale, f.offset))
        products.append(product)
    return add(*products)


def with_own_variables(total: Sum) -> tuple[tuple[Term, ...], list[int]]:
    """Returns a sum's terms over variables 0 … L−1, and which ones these are, rising."""
    return with_own_numbers(to_terms(total))


def _sum(a: Any, b: Any) -> Any:
    """Returns the exact sum of floats or fractions, as a float where one has its value."""
    if isinstance(a, float) and isinstance(b, float):
        total = a + b
        shift = total - a
        if (a - (total - shift)) + (b - shift) == 0.0 or not math.isfinite(total):
            return total
    exact = Fraction(a) + Fraction(b)
    rounded = float(exact)
    return rounded if rounded == exact else exact


def _add_into(total: Sum, terms: Iterable[tuple[tuple[Factor, ...], float]]) -> None:
    for parts, coefficient in terms:
        total[parts] = total.get(parts, 0.0) + coefficient


def _times(
    first: tuple[Factor, ...], second: tuple[Factor, ...], coefficient: float
) -> Iterator[tuple[tuple[Factor, ...], float]]:
    """Yields the terms of a product of two terms: two for each variable with waves in both."""
    of_first = {part.variable: part for part in first}
    shared = [part for part in second if part.variable in of_first]
    apart = {part.variable: part for part in (*first, *second)}
    for part in shared:
        del apart[part.variable]
    products: list[tuple[dict[int, Factor], float]] = [(apart, coefficient)]
    for part in shared:
        options = list(_times_part(of_first[part.variable], part))
        products = [
            (parts if option is None else {**parts, option.variable: option}, a * b)
            for parts, a in products
            for b, option in options
        ]
    for parts, a in products:
        yield tuple(parts[variable] for variable in sorted(parts)), a


def _times_part(a: Factor, b: Factor) -> Iterator[tuple[float, Factor | None]]:
    """Yields the terms of a product of two functions of one variable; None for a constant."""
    kinds = {a.kind, b.kind}
    if FunctionKind.HINGE in kinds:
        yield from _times_hinge(a, b)
        return
    if kinds & {FunctionKind.SQUARED_HINGE, FunctionKind.NEG_LOG}:
        raise NoClosedFormError("max(0, y)² or log(y) is multiplied by a function of its variable")
    exponent = a.exponent + b.exponent
    if _POWER in kinds:
        wave = a if b.kind == _POWER else b
        yield 1.0, wave._replace(exponent=exponent)
    elif kinds == {_EXPONENTIAL}:
        scale, offset = _sum(a.scale, b.scale), _sum(a.offset, b.offset)
        yield _wave(Factor(a.variable, _EXPONENTIAL, exponent, scale, offset))
    elif _EXPONENTIAL in kinds:
        raise NoClosedFormError(
            "an exponential and a sine or cosine of one variable are multiplied"
        )
    else:
        same = a.kind == b.kind
        kind = _COSINE if same else _SINE
        # sin a sin b = ½ [cos(a − b) − cos(a + b)],  cos a sin b = ½ [sin(a + b) − sin(a − b)]
        for sign in (-1.0, 1.0):
            scale, offset = _sum(a.scale, sign * b.scale), _sum(a.offset, sign * b.offset)
            negative = b.kind == _SINE and sign == (1 if same else -1)
            coefficient, part = _wave(Factor(a.variable, kind, exponent, scale, offset))
            yield (-0.5 if negative else 0.5) * coefficient, part


def _times_hinge(a: Factor, b: Factor) -> Iterator[tuple[float, Factor | None]]:
    """Yields the terms of a product with h = max(0, −y), y = scale·x + offset.

    x h = −(h² + offset h)/scale. The product of two that are never both above 0 is 0.
    """
    hinge, other = (a, b) if a.kind == FunctionKind.HINGE else (b, a)
    if other.kind == _POWER and other.exponent == 1:
        yield -1.0 / float(hinge.scale), hinge._replace(kind=FunctionKind.SQUARED_HINGE)
        if hinge.offset:
            yield -float(hinge.offset) / float(hinge.scale), hinge
    elif other == hinge:
        yield 1.0, hinge._replace(kind=FunctionKind.SQUARED_HINGE)
    elif other.kind == FunctionKind.HINGE and hinge.scale * other.scale < 0:
        low, high = (hinge, other) if hinge.scale > 0 else (other, hinge)
        if -low.offset / low.scale > -high.offset / high.scale:
            raise NoClosedFormError("two springs that push at once are multiplied")
    else:
        raise NoClosedFormError("max(0, y) is multiplied by that function of its variable")


def _wave(part: Factor) -> tuple[float, Factor | None]:
    """Returns the coefficient and canonical part of x^p times a cosine, sine or exponential.

    A scale of 0 leaves the power; a cosine's and sine's scale is made positive.
    """
    if part.scale == 0:
        alone = Factor(part.variable, _POWER, part.exponent) if part.exponent else None
        with np.errstate(over="ignore", invalid="ignore"):  # Refused with the term's formula.
            return float(_WAVES[part.kind](float(part.offset))), alone
    if part.kind in _TRIGONOMETRIC and part.scale < 0:
        sign = -1.0 if part.kind == _SINE else 1.0
        return sign, part._replace(scale=-part.scale, offset=-part.offset)
    return 1.0, part
