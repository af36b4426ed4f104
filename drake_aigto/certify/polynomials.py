"""Formulas as polynomials with exact coefficients; waves of angles are variables of their own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction

from drake_aigto.certify.tape import Entry, Operation

# Indices of a product's factors, rising; a square has one twice.
Monomial = tuple[int, ...]
# Σ c_m m as m ↦ c_m.
Polynomial = dict[Monomial, Fraction]

_MOST_TERMS = 10_000
_MOST_TURNS = 8  # as cos(8 x) has 8 factors


class NotPolynomialError(Exception):
    """A formula is no polynomial of few terms; its message says why."""


def plus(p: Polynomial, q: Polynomial, factor: int | Fraction = 1) -> Polynomial:
    """Returns p + factor q."""
    total = dict(p)
    for monomial, c in q.items():
        total[monomial] = total.get(monomial, Fraction(0)) + factor * c
    return {monomial: c for monomial, c in total.items() if c}


def times(p: Polynomial, q: Polynomial) -> Polynomial:
    """Returns p q.

    Raises:
        NotPolynomialError: it has too many terms.
    """
    if len(p) * len(q) > _MOST_TERMS:
        raise NotPolynomialError("it has too many terms, multiplied out")
    product: Polynomial = {}
    for a, c in p.items():
        for b, d in q.items():
            monomial = tuple(sorted(a + b))
            product[monomial] = product.get(monomial, Fraction(0)) + c * d
    return {monomial: c for monomial, c in product.items() if c}


def power(p: Polynomial, exponent: int) -> Polynomial:
    """Returns p^exponent."""
    product = number(1)
    for _ in range(exponent):
        product = times(product, p)
    return product


def number(c: float | Fraction) -> Polynomial:
    """Returns a constant."""
    return {(): Fraction(c)} if c else {}


def substitute(p: Polynomial, values: Mapping[int, Polynomial]) -> Polynomial:
    """Returns p with polynomials in place of its variables."""
    total: Polynomial = {}
    for monomial, c in p.items():
        term = number(c)
        for i in monomial:
            term = times(term, values[i])
        total = plus(total, term)
    return total


def variables_of(polynomials: Iterable[Polynomial]) -> set[int]:
    """Returns the indices of all variables."""
    return {i for p in polynomials for monomial in p for i in monomial}


class PolynomialReader:
    """Reads formulas over n variables; cos x_i and sin x_i become variables n, n + 1, ….

    Args:
        num_variables: n.

    Attributes:
        waves: i ↦ the index of cos x_i, which that of sin x_i follows.
    """

    def __init__(self, num_variables: int) -> None:
        """Knows no wave yet."""
        self._next = num_variables
        self.waves: dict[int, int] = {}

    def read(self, entries: Sequence[Entry], variables: Sequence[int]) -> Polynomial:
        """Returns a formula's polynomial.

        Args:
            entries: of a tape.
            variables: which variable of the program each place is.

        Raises:
            NotPolynomialError: it is none.
        """
        values: list[Polynomial] = []
        for operation, a, b, p in entries:
            if operation == Operation.NUMBER:
                values.append(number(p))
            elif operation == Operation.VARIABLE:
                values.append({(variables[a],): Fraction(1)})
            else:
                values.append(self._apply(Operation(operation), values, a, b, p))
        return values[-1]

    def _apply(
        self, operation: Operation, values: Sequence[Polynomial], a: int, b: int, p: float
    ) -> Polynomial:
        own = values[a]
        match operation:
            case Operation.SHIFT:
                return plus(own, number(p))
            case Operation.SCALE:
                return times(own, number(p))
            case Operation.ADD:
                return plus(own, values[b])
            case Operation.MULTIPLY:
                return times(own, values[b])
            case Operation.POWER:
                return power(own, b)
            case Operation.RECIPROCAL if set(own) == {()}:
                return number(1 / own[()])
            case Operation.COS:
                return self._wave(own)[0]
            case Operation.SIN:
                return self._wave(own)[1]
        raise NotPolynomialError(f"{operation.name.lower()} is no polynomial")

    def _wave(self, angle: Polynomial) -> tuple[Polynomial, Polynomial]:
        """Returns cos and sin of Σ n_i x_i, by the addition theorem."""
        if any(len(monomial) != 1 or c.denominator != 1 for monomial, c in angle.items()):
            raise NotPolynomialError("a wave is of more than whole multiples of variables")
        if sum(abs(c) for c in angle.values()) > _MOST_TURNS:
            raise NotPolynomialError(f"a wave is of more than {_MOST_TURNS} variables")
        cosine, sine = number(1), number(0)
        for (i,), turns in angle.items():
            first = self.waves.setdefault(i, self._next)
            self._next = max(self._next, first + 2)
            c: Polynomial = {(first,): Fraction(1)}
            s: Polynomial = {(first + 1,): Fraction(1 if turns > 0 else -1)}
            for _ in range(abs(int(turns))):
                cosine, sine = (
                    plus(times(cosine, c), times(sine, s), -1),
                    plus(times(sine, c), times(cosine, s)),
                )
        return cosine, sine
