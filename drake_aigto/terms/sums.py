"""Sums of products of functions of one variable, as data.

Such a sum has a mean over any box in closed form, as means factorize (AIGTO Sec. II-B), and bounds
and derivatives as well: all that optimizers here ever see of a program.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Ints, locked
from drake_aigto.errors import OptionsError, UnsupportedTermError


class FunctionKind(IntEnum):
    """The one-variable functions whose mean over an interval is known in closed form.

    Of x, with y = scale·x + offset:

        POWER           y^p
        SQUARED_HINGE   max(0, −y)², the ReLU² penalty of y ≥ 0 (AIGTO Sec. III-A)
        NEG_LOG         −log y, the log barrier of y ≥ 0
        COSINE          x^p cos y
        EXPONENTIAL     x^p exp y
        SINE            x^p sin y
        HINGE           max(0, −y), the force of a spring that only pushes
    """

    POWER = 0
    SQUARED_HINGE = 1
    NEG_LOG = 2
    COSINE = 3
    EXPONENTIAL = 4
    SINE = 5
    HINGE = 6


# The functions G with G″ = ±scale² G, which take a power x^p as a factor.
WAVES = (FunctionKind.COSINE, FunctionKind.SINE, FunctionKind.EXPONENTIAL)


@dataclass(frozen=True)
class Factor:
    """A one-variable function of the local variable `variable` of a block, see `FunctionKind`.

    Attributes:
        variable: Local index of x.
        kind: Which g.
        exponent: The power p ≥ 0, of kinds that have one.
        scale: Factor inside g.
        offset: Term inside g.
    """

    variable: int
    kind: FunctionKind
    exponent: int = 1
    scale: float = 1.0
    offset: float = 0.0

    def __str__(self) -> str:
        """Returns the formula, with x0 for local variable 0."""
        x = y = f"x{self.variable}"
        if (self.scale, self.offset) != (1.0, 0.0):
            y = f"({self.scale:g}*{x} + {self.offset:g})"
        if self.kind == FunctionKind.POWER:
            return f"{y}^{self.exponent}"
        function = f"{self.kind.name} {y}"
        has_power = self.kind in WAVES and self.exponent > 0
        return f"{x}^{self.exponent} * {function}" if has_power else function


@dataclass(frozen=True)
class Term:
    """coefficient · ∏ factors, no two of which read the same variable."""

    coefficient: float
    factors: tuple[Factor, ...]

    def __str__(self) -> str:
        """Returns the formula."""
        return " * ".join([f"{self.coefficient:g}", *map(str, self.factors)])


class TermBlock:
    """K copies of one sum of terms, each over its own L variables: N stages share one table.

    Attributes:
        name: Description of the cost that it came from.
        terms: The sum's terms over local variables 0 … L−1.
        variables: (K, L) index of each copy's variables in the whole problem.
        weight: Common factor of all copies; 0 switches the block off.

    Raises:
        UnsupportedTermError: A number is not finite, an exponent is negative, or two factors of a
            term read the same variable: the mean of x·x is not the square of the mean of x.
        OptionsError: The weight is not finite.
    """

    def __init__(
        self, name: str, terms: tuple[Term, ...], variables: ArrayLike, weight: float = 1.0
    ) -> None:
        """Checks the terms."""
        self.name = name
        self.terms = tuple(terms)
        self.weight = _finite_weight(name, weight)
        self.variables = locked(np.atleast_2d(np.array(variables, dtype=np.int64)))
        for term in self.terms:
            _check_numbers(name, term)
        self._check_distinct()

    def _check_distinct(self) -> None:
        """Refuses a term of which two factors read one variable, in the block or in one copy."""
        read = [[factor.variable for factor in term.factors] for term in self.terms]
        for term, places in zip(self.terms, read, strict=True):
            if len(set(places)) < len(places):
                raise _repeated_variable(self.name, f"the term {term}")
        if not _repeats(self.variables)[0].size:
            return
        for places in read:
            copy, variable = _repeats(self.variables[:, places])
            if copy.size:
                got = f"copy {copy[0]} with variable {variable[0]} twice"
                raise _repeated_variable(self.name, got)

    def with_weight(self, weight: float) -> TermBlock:
        """Returns the same block under another weight; terms and variables are shared."""
        return self._with(weight=_finite_weight(self.name, weight))

    def with_coefficients(self, coefficients: Sequence[float]) -> TermBlock:
        """Returns the same functions, variables and weight, with other coefficients of the terms.

        Raises:
            UnsupportedTermError: One is not finite.
        """
        pairs = zip(coefficients, self.terms, strict=True)
        terms = tuple(Term(number, term.factors) for number, term in pairs)
        if not all(map(math.isfinite, coefficients)):
            for term in terms:
                _check_numbers(self.name, term)
        return self._with(terms=terms)

    def _with(self, **changes: object) -> TermBlock:
        block = object.__new__(TermBlock)
        block.__dict__.update(self.__dict__, **changes)
        return block


def _repeats(variables: Ints) -> tuple[Ints, Ints]:
    """Returns rows that hold a number twice, and that number."""
    ordered = np.sort(variables, axis=1)
    row, place = np.nonzero(ordered[:, 1:] == ordered[:, :-1])
    return row, ordered[row, place]


def _finite_weight(name: str, weight: float) -> float:
    if not math.isfinite(weight):
        raise OptionsError(f"the weight of '{name}'", got=weight, expected="a finite number")
    return float(weight)


def _check_numbers(name: str, term: Term) -> None:
    numbers = [term.coefficient]
    for factor in term.factors:
        numbers += [factor.scale, factor.offset]
        if factor.exponent < 0 or factor.exponent != int(factor.exponent):
            raise UnsupportedTermError(
                f"the cost '{name}' can't be integrated",
                got=f"the exponent {factor.exponent}",
                expected="whole exponents p ≥ 0",
            )
    if not all(math.isfinite(number) for number in numbers):
        raise UnsupportedTermError(
            f"the cost '{name}' can't be integrated",
            got=f"the term {term}",
            expected="finite numbers",
            remedy="Look for a parameter that was not set, or a division by zero.",
        )


def _repeated_variable(name: str, got: str) -> UnsupportedTermError:
    return UnsupportedTermError(
        f"the cost '{name}' can't be integrated",
        got=got,
        expected="at most one factor of each variable in a term",
        remedy="Multiply factors of one variable into one: x·x is x².",
    )
