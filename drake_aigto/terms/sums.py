"""Sums of products of functions of one variable, as data.

Such a sum has a mean over any box in closed form, as means factorize (AIGTO Sec. II-B), and bounds
and derivatives as well: all that optimizers here ever see of a program. Many of them are one set of
flat arrays, so that one call of a kernel walks them all.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, Ints, Records, locked
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


class Factor(NamedTuple):
    """A one-variable function of the local variable `variable` of a block, see `FunctionKind`.

    Attributes:
        variable: Local index of x.
        kind: Which g.
        exponent: The power p ≥ 0, of kinds that have one.
        scale: Factor inside g; in a `Sum`, a Fraction where no float is exact.
        offset: Term inside g; likewise.
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


def with_own_numbers(terms: Sequence[Term]) -> tuple[tuple[Term, ...], list[int]]:
    """Returns terms over variables 0 … L−1, and which ones these are, rising."""
    read = sorted({factor.variable for term in terms for factor in term.factors})
    if len(read) == max(read, default=-1) + 1:
        return tuple(terms), read
    number = {variable: i for i, variable in enumerate(read)}
    renumbered = (
        tuple(f._replace(variable=number[f.variable]) for f in term.factors) for term in terms
    )
    return tuple(map(Term, (term.coefficient for term in terms), renumbered)), read


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
        self.variables = locked(np.atleast_2d(np.array(variables, dtype=np.int64)))
        self._set_weight(weight)
        for term in self.terms:
            self._check_numbers(term)
        self._check_distinct()

    def _set_weight(self, weight: float) -> None:
        if not math.isfinite(weight):
            what = f"the weight of '{self.name}'"
            raise OptionsError(what, got=weight, expected="a finite number")
        self.weight = float(weight)

    def _check_numbers(self, term: Term) -> None:
        numbers = [term.coefficient]
        for factor in term.factors:
            numbers += [factor.scale, factor.offset]
            if factor.exponent < 0 or factor.exponent != int(factor.exponent):
                raise self._refuse(f"the exponent {factor.exponent}", "whole exponents p ≥ 0")
        if not all(map(math.isfinite, numbers)):
            remedy = "Look for a parameter that was not set, or a division by zero."
            raise self._refuse(f"the term {term}", "finite numbers", remedy)

    def _check_distinct(self) -> None:
        """Refuses a term of which two factors read one variable, in the block or in one copy."""
        expected = "at most one factor of each variable in a term"
        remedy = "Multiply factors of one variable into one: x·x is x²."
        read = [[factor.variable for factor in term.factors] for term in self.terms]
        for term, places in zip(self.terms, read, strict=True):
            if len(set(places)) < len(places):
                raise self._refuse(f"the term {term}", expected, remedy)
        if not _repeats(self.variables)[0].size:
            return
        for places in read:
            row, variable = _repeats(self.variables[:, places])
            if row.size:
                got = f"copy {row[0]} with variable {variable[0]} twice"
                raise self._refuse(got, expected, remedy)

    def _refuse(self, got: str, expected: str, remedy: str | None = None) -> UnsupportedTermError:
        what = f"the cost '{self.name}' can't be integrated"
        return UnsupportedTermError(what, got, expected, remedy)

    def with_weight(self, weight: float) -> TermBlock:
        """Returns the same block under another weight; terms and variables are shared."""
        other = copy.copy(self)
        other._set_weight(weight)
        return other

    def with_coefficients(self, coefficients: Sequence[float]) -> TermBlock:
        """Returns the same functions, variables and weight, with other coefficients of the terms.

        Raises:
            UnsupportedTermError: One is not finite.
        """
        other = copy.copy(self)
        pairs = zip(coefficients, self.terms, strict=True)
        other.terms = tuple(Term(number, term.factors) for number, term in pairs)
        if not all(map(math.isfinite, coefficients)):
            for term in other.terms:
                self._check_numbers(term)
        return other


def _repeats(variables: Ints) -> tuple[Ints, Ints]:
    """Returns rows that hold a number twice, and that number."""
    ordered = np.sort(variables, axis=1)
    row, place = np.nonzero(ordered[:, 1:] == ordered[:, :-1])
    return row, ordered[row, place]


# Records, so that kernels have few arrays to take and read one place in memory for each.
COPY = np.dtype([("sum_index", np.int64), ("first_variable", np.int64)], align=True)
SUM = np.dtype([("first_factor", np.int64), ("first_term", np.int64)], align=True)
FACTOR = np.dtype(
    [
        *((name, np.int64) for name in ("variable", "kind", "exponent")),
        *((name, np.float64) for name in ("scale", "offset")),
    ],
    align=True,
)
TERM = np.dtype([("coefficient", np.float64), ("first_member", np.int64)], align=True)


class StackedTerms(NamedTuple):
    """Sums of terms, and copies of them that are bound to variables.

    Shape letters: T sums, C copies, F factors and M terms over all sums. Entries that belong to one
    of another array end where those of the next one start; a last entry marks the end. All arrays
    are read-only.

    Attributes:
        copies: The sum of each copy, and its first place in copy_variables (C,).
        copy_variables: Variables of the copies, one copy after the other.
        sums: First factor and first term of each sum (T + 1,).
        factors: Each factor's `Factor`, whose variable is a place among its copy's (F,).
        terms: Coefficient of each term, and its first place in members (M + 1,).
        members: Factors of the terms, counted from their sum's first.
    """

    copies: Records
    copy_variables: Ints
    sums: Records
    factors: Records
    terms: Records
    members: Ints

    @property
    def coefficients(self) -> Floats:
        """Of the terms, one sum after the other, and one at the end (M + 1,), read-only."""
        return locked(np.ascontiguousarray(self.terms["coefficient"]))

    def with_coefficients(self, coefficients: Floats) -> StackedTerms:
        """Returns the same with other coefficients of the terms (M,)."""
        terms = self.terms.copy()
        terms["coefficient"][:-1] = coefficients
        return self._replace(terms=locked(terms))

    def first_terms(self, counts: Iterable[int]) -> list[int]:
        """Returns the place of each block's first term, given how many copies each has."""
        firsts = np.cumsum([0, *counts])[:-1]
        places: list[int] = self.sums["first_term"][self.copies["sum_index"][firsts]].tolist()
        return places

    def couplings(self) -> tuple[Ints, Ints]:
        """Returns pairs of variables that a term of a copy reads, each once and with itself.

        Returns:
            The copies (P,), and the pairs (P, 2).
        """
        lengths = np.diff(self.terms["first_member"])
        term_sum = np.repeat(np.arange(self.sums.size - 1), np.diff(self.sums["first_term"]))
        first_factor = np.repeat(self.sums["first_factor"][term_sum], lengths)
        variable = self.factors["variable"][first_factor + self.members]
        term, pair = _ranges(lengths**2)
        first_member = self.terms["first_member"][term]
        a, b = (variable[first_member + part] for part in np.divmod(pair, lengths[term]))
        # One number for each (sum, a, b), to find those that differ.
        base = int(np.max(variable, initial=0)) + 1
        found = np.unique((term_sum[term] * base + a) * base + b)
        sums, a, b = found // base**2, found // base % base, found % base
        starts = np.searchsorted(sums, np.arange(self.sums.size))
        copies, pair = _ranges(np.diff(starts)[self.copies["sum_index"]])
        pair += starts[self.copies["sum_index"][copies]]
        first_variable = self.copies["first_variable"][copies]
        columns = [self.copy_variables[first_variable + part[pair]] for part in (a, b)]
        return copies, np.column_stack(columns)


def copy_weights(blocks: Sequence[TermBlock]) -> Floats:
    """Returns the weight of each copy, block after block (C,)."""
    counts = [len(block.variables) for block in blocks]
    return np.repeat(np.array([block.weight for block in blocks], dtype=float), counts)


def stack_terms(blocks: Sequence[TermBlock]) -> StackedTerms:
    """Returns the arrays of some blocks; copies in the blocks' order, equal sums stored once."""
    place_of: dict[tuple[Term, ...], int] = {}
    block_sums = [place_of.setdefault(block.terms, len(place_of)) for block in blocks]
    factors: list[tuple[float, ...]] = []
    terms: list[tuple[float, int]] = []
    members: list[int] = []
    sums = [(0, 0)]
    for sum_ in place_of:
        places: dict[Factor, int] = {}
        for term in sum_:
            terms.append((term.coefficient, len(members)))
            members += [places.setdefault(factor, len(places)) for factor in term.factors]
        factors += [(f.variable, f.kind, f.exponent, f.scale, f.offset) for f in places]
        sums.append((len(factors), len(terms)))
    terms.append((0.0, len(members)))
    counts = [block.variables.shape[0] for block in blocks]
    copies = np.empty(sum(counts), dtype=COPY)
    copies["sum_index"] = np.repeat(block_sums, counts)
    sizes = np.repeat([block.variables.shape[1] for block in blocks], counts)
    copies["first_variable"] = np.cumsum(sizes) - sizes
    variables = [np.empty(0, dtype=np.int64), *(block.variables.ravel() for block in blocks)]
    arrays = (
        copies,
        np.concatenate(variables),
        np.array(sums, dtype=SUM),
        np.array(factors, dtype=FACTOR),
        np.array(terms, dtype=TERM),
        np.array(members, dtype=np.int64),
    )
    return StackedTerms(*map(locked, arrays))


def _ranges(lengths: Ints) -> tuple[Ints, Ints]:
    """Returns every k and every number 0 … lengths[k] − 1, one range after the other."""
    k = np.repeat(np.arange(lengths.size), lengths)
    return k, np.arange(k.size) - (np.cumsum(lengths) - lengths)[k]
