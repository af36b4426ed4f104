"""Presolve: variables that an equality row defines are substituted, and found again afterwards."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.solver.question import Question, Row
from drake_aigto.solver.ranges import sum_range
from drake_aigto.terms import (
    ConstraintRow,
    FunctionKind,
    NoClosedFormError,
    Part,
    Sum,
    TermBlock,
    TooManyTermsError,
    add,
    compose,
    constant,
    evaluate,
    from_terms,
    with_own_variables,
)

# What a variable is divided by may be so much smaller than other coefficients of its row.
_LEAST_PIVOT = 1e-4
# A row that defines a variable may have so many terms, as its powers are multiplied out.
_MOST_TERMS = 60
# It is not tried where so many times more terms than before would be multiplied out.
_MOST_MULTIPLIED = 10
# A program of few variables may grow, for all of them meet anyway, but not without end.
_FEW, _MOST_COST_TERMS, _MOST_DEGREE = 40, 500, 16


@dataclass(frozen=True, eq=False)
class Piece:
    """A cost, or one row.

    Attributes:
        label: how messages call it.
        name: of the cost or constraint that it came from.
        total: its terms over x.
        bounds: of a row; None for a cost.
    """

    label: str
    name: str
    total: Sum
    bounds: tuple[float, float] | None = None

    @cached_property
    def variables(self) -> list[int]:
        """Which of x it reads, rising."""
        return _variables(self.total)

    @property
    def is_equality(self) -> bool:
        """Whether it is a row with one bound."""
        return self.bounds is not None and self.bounds[0] == self.bounds[1]

    @property
    def size(self) -> int:
        """How many terms boxes see of it at most: of a row, those of its square."""
        count = len(self.total)
        return count if self.bounds is None else (count + 1) * (count + 2) // 2

    @property
    def degree(self) -> int:
        """The largest total degree of a term."""
        return max((sum(part.exponent for part in parts) for parts in self.total), default=0)


@dataclass(frozen=True, eq=False)
class Definition:
    """x_j = Σ terms of other variables.

    Attributes:
        variable: j.
        total: the terms over x.
    """

    variable: int
    total: Sum


@dataclass(frozen=True, eq=False)
class Reduced:
    """A program without the variables that its rows define.

    Attributes:
        question: what is left, over z.
        kept: which of x are z.
        definitions: in the order of their making, each over variables that were there by then.
        lower: bounds of x, shape (n,).
        upper: shape (n,).
    """

    question: Question
    kept: Ints
    definitions: tuple[Definition, ...]
    lower: Floats
    upper: Floats

    @property
    def defined(self) -> list[int]:
        """Which of x were left out, in that order."""
        return [definition.variable for definition in self.definitions]

    def restore(self, z: Floats) -> Floats:
        """Returns x (n,) within its bounds, with the values of what was left out."""
        x = np.zeros(self.lower.size)
        x[self.kept] = z
        x = np.clip(x, self.lower, self.upper)
        for definition in reversed(self.definitions):
            j = definition.variable
            with np.errstate(over="ignore", invalid="ignore"):  # Far out a definition may overflow.
                value = evaluate(definition.total, x)
            x[j] = np.clip(value, self.lower[j], self.upper[j])
        return x


def keep_all(question: Question) -> Reduced:
    """Returns a program as it is."""
    lower, upper = question.lower, question.upper
    return Reduced(question, np.arange(lower.size), (), lower, upper)


def substitute(question: Question) -> Reduced:
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
    if not any(each.row.lower == each.row.upper for each in question.rows):
        return keep_all(question)
    lower, upper = question.lower, question.upper
    pieces, definitions = _Substitution(_split(question), lower, upper).run()
    gone = {definition.variable for definition in definitions}
    kept = np.array([i for i in range(lower.size) if i not in gone], dtype=np.int64)
    reduced = _join(pieces, kept, lower, upper)
    reduced.row_sizes = question.row_sizes
    return Reduced(reduced, kept, definitions, lower, upper)


def _split(question: Question) -> Iterator[Piece]:
    """Yields every copy of all costs and rows."""
    for block in question.costs:
        for copy in block.variables.tolist():
            yield Piece(block.name, block.name, from_terms(block.terms, copy))
    for each in question.rows:
        bounds = each.row.lower, each.row.upper
        for copy in each.block.variables.tolist():
            total = from_terms(each.row.terms, copy)
            yield Piece(each.label, each.block.name, total, bounds)


def _join(pieces: Iterable[Piece], kept: Ints, lower: Floats, upper: Floats) -> Question:
    """Returns the question of pieces over z, alike ones as copies of one sum."""
    place = {variable: i for i, variable in enumerate(kept.tolist())}
    alike: dict[tuple[Any, ...], list[list[int]]] = {}
    for piece in pieces:
        terms, read = with_own_variables(piece.total)
        copies = alike.setdefault((piece.label, piece.name, piece.bounds, terms), [])
        copies.append([place[variable] for variable in read])
    question = Question(kept.size)
    question.lower, question.upper = lower[kept], upper[kept]
    costs = []
    for (label, name, bounds, terms), copies in alike.items():
        block = TermBlock(name, terms, copies)
        if bounds is None:
            costs.append(block)
        else:
            question.add(Row(label, ConstraintRow(terms, *bounds), block))
    question.costs = tuple(costs)
    return question


class _Substitution:
    """One run: pieces by number, and the numbers of those that read a variable."""

    def __init__(self, pieces: Iterable[Piece], lower: Floats, upper: Floats) -> None:
        self._pieces: dict[int, Piece] = {}
        self._readers: dict[int, set[int]] = {}
        self._lower, self._upper = lower, upper
        self._definitions: list[Definition] = []
        self._num_added = 0
        self._tried: dict[int, int] = {}
        for piece in pieces:
            self._add(piece)

    def run(self) -> tuple[list[Piece], tuple[Definition, ...]]:
        """Goes over the rows until none defines anything more."""
        changed = True
        while changed:
            rows = [number for number, piece in self._pieces.items() if piece.is_equality]
            changed = False
            for number in rows:
                if number in self._pieces and self._is_new(number):
                    changed |= self._use(number)
        return list(self._pieces.values()), tuple(self._definitions)

    def _is_new(self, number: int) -> bool:
        """Returns whether anything has changed around a row since it was tried."""
        around = [self._readers[variable] for variable in self._pieces[number].variables]
        newest = max(set.union(set(), *around), default=number)
        before, self._tried[number] = self._tried.get(number), newest
        return newest != before

    def _add(self, piece: Piece) -> None:
        self._pieces[self._num_added] = piece
        for variable in piece.variables:
            self._readers.setdefault(variable, set()).add(self._num_added)
        self._num_added += 1

    def _remove(self, number: int) -> None:
        for variable in self._pieces.pop(number).variables:
            self._readers[variable].discard(number)

    def _use(self, number: int) -> bool:
        """Substitutes one of the variables that a row defines, if it pays for any."""
        row = self._pieces[number]
        for definition in sorted(_define(row), key=self._cheapness):
            readers = self._readers[definition.variable] - {number}
            before = [self._pieces[reader] for reader in sorted(readers)]
            after = _insert(before, definition)
            if after is None:
                continue
            kept = self._bound(row, definition)
            if self._fits([*before, row], after, kept):
                self._replace(definition, [*after, *kept])
                return True
        return False

    def _cheapness(self, definition: Definition) -> tuple[bool, int]:
        """Orders definitions: first those of variables without bounds, which few pieces read."""
        j = definition.variable
        is_open = bool(np.isinf(self._lower[j]) and np.isinf(self._upper[j]))
        return not is_open, len(self._readers[j])

    def _replace(self, definition: Definition, pieces: Iterable[Piece]) -> None:
        """Has pieces stand for all that read a variable."""
        for reader in sorted(self._readers[definition.variable]):
            self._remove(reader)
        for piece in pieces:
            self._add(piece)
        self._definitions.append(definition)

    def _bound(self, row: Piece, definition: Definition) -> list[Piece]:
        """Returns the row that keeps a substituted variable within its bounds, if one has to."""
        terms, read = with_own_variables(definition.total)
        least, most = sum_range(terms, self._lower[read], self._upper[read])
        low, high = (float(side[definition.variable]) for side in (self._lower, self._upper))
        if low <= least and most <= high:
            return []
        return [replace(row, total=definition.total, bounds=(low, high))]

    def _fits(self, before: Sequence[Piece], after: Sequence[Piece], kept: Sequence[Piece]) -> bool:
        """Returns whether boxes see no more terms after than before, or few variables.

        A row that stays to keep bounds does not count, for it replaces one that is as long.
        """
        if _size(after) <= _size(before):
            return True
        costs = [piece for piece in after if piece.bounds is None]
        num_variables = len(self._readers) - len(self._definitions)
        return (
            num_variables <= _FEW
            and _size_of_rows([*after, *kept]) <= _size_of_rows(before)
            and all(piece.size <= _MOST_COST_TERMS for piece in costs)
            and all(piece.degree <= _MOST_DEGREE for piece in costs)
        )


def _size(pieces: Iterable[Piece]) -> int:
    return sum(piece.size for piece in pieces)


def _size_of_rows(pieces: Iterable[Piece]) -> int:
    return _size(piece for piece in pieces if piece.bounds is not None)


def _define(row: Piece) -> Iterator[Definition]:
    """Yields what a row has each variable be that stands once, alone and linearly."""
    if row.bounds is None or len(row.total) > _MOST_TERMS:
        return
    counts = Counter(part.variable for parts in row.total for part in parts)
    largest = max((abs(a) for parts, a in row.total.items() if parts), default=0.0)
    for parts, a in row.total.items():
        if len(parts) != 1 or parts[0] != Part(j := parts[0].variable, FunctionKind.POWER):
            continue
        if counts[j] == 1 and abs(a) >= _LEAST_PIVOT * largest:
            rest = {others: -b / a for others, b in row.total.items() if others != parts}
            yield Definition(j, add(rest, constant(row.bounds[0] / a)))


def _insert(pieces: Iterable[Piece], definition: Definition) -> list[Piece] | None:
    """Returns pieces without the variable that is defined; None where one would have no mean."""
    found = []
    for piece in pieces:
        reading: Sum = {}
        total: Sum = {}
        count = 0
        for parts, a in piece.total.items():
            exponents = [part.exponent for part in parts if part.variable == definition.variable]
            (reading if exponents else total)[parts] = a
            count += math.comb(len(definition.total) + sum(exponents), sum(exponents))
        if count > _MOST_MULTIPLIED * max(len(piece.total), _MOST_TERMS):
            return None
        try:
            total = add(total, compose(reading, {definition.variable: definition.total}))
        except (NoClosedFormError, TooManyTermsError):
            return None
        found.append(replace(piece, total=total))
    return found


def _variables(total: Sum) -> list[int]:
    """Returns the variables that a sum reads, rising."""
    return sorted({part.variable for parts in total for part in parts})
