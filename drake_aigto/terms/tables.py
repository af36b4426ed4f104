"""Many `TermBlock`s as one set of flat arrays, so that one call of a kernel walks them all."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints, Records, locked
from drake_aigto.terms.sums import Factor, Term, TermBlock

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

    Shape letters: T sums, C copies, F factors and M terms over all sums. What belongs to an entry
    of an array ends where that of the next one starts, for which a last entry stands at the end.
    All arrays are read-only.

    Attributes:
        copies: The sum of each copy, and its first place in copy_variables (C,).
        copy_variables: Variables of the copies, one copy after the other.
        sums: First factor and first term of each sum (T + 1,).
        factors: Each factor's `Factor`, whose variable is a place among its copy's (F,).
        terms: Coefficient of each term, and its first place in members (M + 1,).
        members: Factors of the terms, counted from their sum's first.
        most_factors: Largest number of different factors that a sum has.
    """

    copies: Records
    copy_variables: Ints
    sums: Records
    factors: Records
    terms: Records
    members: Ints
    most_factors: int

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
        """Returns the place of the first term of each of the blocks, which have so many copies."""
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
    most_factors = 0
    for sum_ in place_of:
        places: dict[Factor, int] = {}
        for term in sum_:
            terms.append((term.coefficient, len(members)))
            members += [places.setdefault(factor, len(places)) for factor in term.factors]
        factors += [(f.variable, f.kind, f.exponent, f.scale, f.offset) for f in places]
        sums.append((len(factors), len(terms)))
        most_factors = max(most_factors, len(places))
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
    for array in arrays:
        array.setflags(write=False)
    return StackedTerms(*arrays, most_factors)


def _ranges(lengths: Ints) -> tuple[Ints, Ints]:
    """Returns every k and every number 0 … lengths[k] − 1, one range after the other."""
    k = np.repeat(np.arange(lengths.size), lengths)
    return k, np.arange(k.size) - (np.cumsum(lengths) - lengths)[k]
