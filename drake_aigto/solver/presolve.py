"""Presolve: variables that an equality row defines are substituted, and found again afterwards."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from drake_aigto import terms
from drake_aigto.arrays import Floats, Ints
from drake_aigto.solver.program import AigoProgram, Definition, ParsedProgram
from drake_aigto.solver.ranges import sum_range

# The least coefficient of a variable that its row defines, relative to the row's largest one.
_LEAST_PIVOT = 1e-4
# The most terms of a row that defines a variable, as its powers are multiplied out.
_MOST_TERMS = 60
# The most terms that multiplying out may lead to, relative to those before.
_MOST_MULTIPLIED = 10
# A program of few variables may grow, for all of them meet anyway, but not without end.
_FEW, _MOST_COST_TERMS, _MOST_DEGREE = 40, 500, 16


@dataclass(frozen=True, eq=False)
class BoundedSum:
    """A cost, or one row."""

    label: str  # name of it in messages
    name: str  # of the cost or constraint that it came from
    total: terms.Sum  # its terms over x
    bounds: tuple[float, float] | None = None  # of a row; None for a cost

    @cached_property
    def variables(self) -> list[int]:
        """Variables of x that it reads, rising."""
        return sorted({part.variable for parts in self.total for part in parts})

    @property
    def is_equality(self) -> bool:
        """Whether it is a row with one bound."""
        return self.bounds is not None and self.bounds[0] == self.bounds[1]

    @property
    def size(self) -> int:
        """The most terms of it that boxes see: of a row, those of its square."""
        count = len(self.total)
        return count if self.bounds is None else (count + 1) * (count + 2) // 2

    @property
    def degree(self) -> int:
        """The largest total degree of a term."""
        return max((sum(part.exponent for part in parts) for parts in self.total), default=0)


def presolve(program: AigoProgram) -> AigoProgram:
    """Returns a program without variables that equality rows define.

    A row a x_j + g = 0, where a is a number and g has no x_j, has −g/a stand wherever x_j stood: in
    powers of it, and where g is affine, in waves of it. That is done where boxes see no more terms
    than before, rows by their squares: auxiliary variables of a lift vanish, and a control that
    one row and the cost have; but the states of a long chain stay, which would each depend on all
    controls before. In programs of few variables costs may grow.

    Bounds of x_j stay as a row, unless they hold for all that the others' bounds allow.

    Raises:
        ContradictionError: a row that is left is one of constants, and does not hold.
    """
    given = program.given
    if not any(each.is_equality for each in given.rows):
        return program
    pieces, definitions = _Substitution(_split(given), given.lower, given.upper).run()
    kept = np.delete(np.arange(given.lower.size), [variable for variable, _ in definitions])
    parsed = _join(pieces, kept, given.lower, given.upper)
    return AigoProgram(program.source, program.lifted, given, parsed, definitions)


def _split(parsed: ParsedProgram) -> Iterator[BoundedSum]:
    """Yields every copy of all costs and rows."""
    costs = ((block.name, block, None) for block in parsed.costs)
    rows = ((each.label, each.block, (each.lower, each.upper)) for each in parsed.rows)
    for label, block, bounds in (*costs, *rows):
        for copy in block.variables.tolist():
            yield BoundedSum(label, block.name, terms.from_terms(block.terms, copy), bounds)


def _join(pieces: Iterable[BoundedSum], kept: Ints, lower: Floats, upper: Floats) -> ParsedProgram:
    """Returns the program of pieces over z, alike ones as copies of one sum."""
    place = {variable: i for i, variable in enumerate(kept.tolist())}
    alike: dict[tuple[Any, ...], list[list[int]]] = {}
    for piece in pieces:
        sums, read = terms.with_own_variables(piece.total)
        copies = alike.setdefault((piece.label, piece.name, piece.bounds, sums), [])
        copies.append([place[variable] for variable in read])
    parsed = ParsedProgram(kept.size)
    parsed.lower, parsed.upper = lower[kept], upper[kept]
    for (label, name, bounds, sums), copies in alike.items():
        block = terms.TermBlock(name, sums, copies)
        if bounds is None:
            parsed.costs += (block,)
        else:
            parsed.add(terms.ParsedRow(label, block, *bounds))
    return parsed


class _Substitution:
    """One run: pieces by number, and the numbers of those that read a variable."""

    def __init__(self, pieces: Iterable[BoundedSum], lower: Floats, upper: Floats) -> None:
        self._pieces: dict[int, BoundedSum] = {}
        self._readers: dict[int, set[int]] = {}
        self._lower, self._upper = lower, upper
        self._definitions: list[Definition] = []
        self._num_added = 0
        self._tried: dict[int, int] = {}
        for piece in pieces:
            self._add(piece)

    def run(self) -> tuple[list[BoundedSum], tuple[Definition, ...]]:
        """Goes over the rows until none defines anything more."""
        changed = True
        while changed:
            rows = [number for number, piece in self._pieces.items() if piece.is_equality]
            changed = False
            for number in rows:
                if number not in self._pieces:
                    continue
                around = [self._readers[each] for each in self._pieces[number].variables]
                newest = max(set.union(set(), *around), default=number)
                if newest != self._tried.get(number):  # Something has changed around it since.
                    self._tried[number] = newest
                    changed |= self._use(number)
        return list(self._pieces.values()), tuple(self._definitions)

    def _add(self, piece: BoundedSum) -> None:
        self._pieces[self._num_added] = piece
        for variable in piece.variables:
            self._readers.setdefault(variable, set()).add(self._num_added)
        self._num_added += 1

    def _use(self, number: int) -> bool:
        """Substitutes one of the variables that a row defines, if it pays for any."""
        row = self._pieces[number]
        for definition in sorted(_define(row), key=self._cheapness):
            readers = sorted(self._readers[definition.variable])
            before = [self._pieces[reader] for reader in readers if reader != number]
            after = _insert(before, definition)
            if after is None:
                continue
            kept = self._bound(row, definition)
            if self._fits([*before, row], after, kept):
                for reader in readers:
                    for variable in self._pieces.pop(reader).variables:
                        self._readers[variable].discard(reader)
                for piece in (*after, *kept):
                    self._add(piece)
                self._definitions.append(definition)
                return True
        return False

    def _cheapness(self, definition: Definition) -> tuple[bool, int]:
        """Orders definitions: first those of variables without bounds, which few pieces read."""
        j = definition.variable
        is_open = bool(np.isinf(self._lower[j]) and np.isinf(self._upper[j]))
        return not is_open, len(self._readers[j])

    def _bound(self, row: BoundedSum, definition: Definition) -> list[BoundedSum]:
        """Returns the row that keeps a substituted variable within its bounds, if one has to."""
        own, read = terms.with_own_variables(definition.total)
        least, most = sum_range(own, self._lower[read], self._upper[read])
        low, high = (float(side[definition.variable]) for side in (self._lower, self._upper))
        if low <= least and most <= high:
            return []
        return [replace(row, total=definition.total, bounds=(low, high))]

    def _fits(
        self, before: Sequence[BoundedSum], after: Sequence[BoundedSum], kept: Sequence[BoundedSum]
    ) -> bool:
        """Returns whether boxes see no more terms after than before, or few variables.

        A row that stays to keep bounds does not count, for it replaces one that is as long.
        """
        if _size(after) <= _size(before):
            return True
        of_rows = [
            _size(piece for piece in pieces if piece.bounds is not None)
            for pieces in (before, [*after, *kept])
        ]
        num_variables = len(self._readers) - len(self._definitions)
        return (
            num_variables <= _FEW
            and of_rows[1] <= of_rows[0]
            and all(
                piece.size <= _MOST_COST_TERMS and piece.degree <= _MOST_DEGREE
                for piece in after
                if piece.bounds is None
            )
        )


def _size(pieces: Iterable[BoundedSum]) -> int:
    return sum(piece.size for piece in pieces)


def _define(row: BoundedSum) -> Iterator[Definition]:
    """Yields the definitions of variables that stand in a row once, alone and linearly."""
    if row.bounds is None or len(row.total) > _MOST_TERMS:
        return
    counts = Counter(part.variable for parts in row.total for part in parts)
    largest = max((abs(a) for parts, a in row.total.items() if parts), default=0.0)
    for parts, a in row.total.items():
        if len(parts) != 1 or parts[0] != terms.Factor(
            j := parts[0].variable, terms.FunctionKind.POWER
        ):
            continue
        if counts[j] == 1 and abs(a) >= _LEAST_PIVOT * largest:
            rest = {others: -b / a for others, b in row.total.items() if others != parts}
            yield Definition(j, terms.add(rest, terms.constant(row.bounds[0] / a)))


def _insert(pieces: Iterable[BoundedSum], definition: Definition) -> list[BoundedSum] | None:
    """Returns pieces without the variable that is defined; None where one would have no mean."""
    found = []
    for piece in pieces:
        reading: terms.Sum = {}
        total: terms.Sum = {}
        count = 0
        for parts, a in piece.total.items():
            exponents = [part.exponent for part in parts if part.variable == definition.variable]
            (reading if exponents else total)[parts] = a
            count += math.comb(len(definition.total) + sum(exponents), sum(exponents))
        if count > _MOST_MULTIPLIED * max(len(piece.total), _MOST_TERMS):
            return None
        try:
            total = terms.add(
                total, terms.compose(reading, {definition.variable: definition.total})
            )
        except (terms.NoClosedFormError, terms.TooManyTermsError):
            return None
        found.append(replace(piece, total=total))
    return found
