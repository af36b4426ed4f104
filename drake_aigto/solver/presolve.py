"""Presolve: variables that an equality row defines are substituted, and found again afterwards."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from drake_aigto.arrays import Floats, Ints
from drake_aigto.solver.question import Question
from drake_aigto.solver.ranges import sum_range
from drake_aigto.terms import (
    ConstraintRow,
    Factor,
    FunctionKind,
    NoClosedFormError,
    Term,
    TermBlock,
    TooManyTermsError,
    compose,
    evaluate,
    from_terms,
    function,
    to_terms,
)

# What a variable is divided by may be so much smaller than other coefficients of its row.
_LEAST_PIVOT = 1e-4
# A row that defines a variable may have so many terms, as its powers are multiplied out.
_MOST_TERMS = 60
# A program of few variables may grow, for all of them meet anyway, but not without end.
_FEW, _MOST_COST_TERMS, _MOST_DEGREE = 40, 500, 16


@dataclass(frozen=True)
class Piece:
    """A cost, or one row, over its own variables.

    Attributes:
        label: how messages call it.
        name: of the cost or constraint that it came from.
        terms: over local variables 0 … L−1.
        variables: which of x these are.
        bounds: of a row; None for a cost.
    """

    label: str
    name: str
    terms: tuple[Term, ...]
    variables: tuple[int, ...]
    bounds: tuple[float, float] | None = None

    @property
    def is_equality(self) -> bool:
        """Whether it is a row with one bound."""
        return self.bounds is not None and self.bounds[0] == self.bounds[1]

    @property
    def size(self) -> int:
        """How many terms boxes see of it at most: of a row, those of its square."""
        count = len(self.terms)
        return count if self.bounds is None else (count + 1) * (count + 2) // 2


@dataclass(frozen=True)
class Definition:
    """x_j = Σ terms of other variables.

    Attributes:
        variable: j.
        terms: over local variables.
        variables: which of x these are.
    """

    variable: int
    terms: tuple[Term, ...]
    variables: tuple[int, ...]

    def value(self, x: Floats) -> float:
        """Returns x_j from the others of x (n,)."""
        return float(evaluate(from_terms(self.terms), x[list(self.variables)]))


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

    def restore(self, z: Floats) -> Floats:
        """Returns x (n,) within its bounds, with the values of what was left out."""
        x = np.zeros(self.lower.size)
        x[self.kept] = z
        x = np.clip(x, self.lower, self.upper)
        for definition in reversed(self.definitions):
            j = definition.variable
            x[j] = np.clip(definition.value(x), self.lower[j], self.upper[j])
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
    return Reduced(_join(pieces, kept, lower, upper), kept, definitions, lower, upper)


def _split(question: Question) -> Iterator[Piece]:
    """Yields every copy of all costs and rows."""
    for block in question.costs:
        for copy in block.variables.tolist():
            yield Piece(block.name, block.name, block.terms, tuple(copy))
    for each in question.rows:
        bounds = each.row.lower, each.row.upper
        for copy in each.block.variables.tolist():
            yield Piece(each.label, each.block.name, each.row.terms, tuple(copy), bounds)


def _join(pieces: Iterable[Piece], kept: Ints, lower: Floats, upper: Floats) -> Question:
    """Returns the question of pieces, equal ones as copies of one sum."""
    place = {variable: i for i, variable in enumerate(kept.tolist())}
    alike: dict[Piece, list[list[int]]] = {}
    for piece in pieces:
        copies = alike.setdefault(replace(piece, variables=()), [])
        copies.append([place[variable] for variable in piece.variables])
    question = Question(kept.size)
    question.lower, question.upper = lower[kept], upper[kept]
    costs = []
    for piece, copies in alike.items():
        block = TermBlock(piece.name, piece.terms, copies)
        if piece.bounds is None:
            costs.append(block)
        else:
            row = ConstraintRow(piece.terms, *piece.bounds)
            question.add(piece.label, row, block)
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
        # Stages have the same sums, of other variables.
        self._compose, self._solve = cache(_compose), cache(_solve)
        for piece in pieces:
            self._add(piece)
        self._may_grow = len(self._readers) <= _FEW

    def run(self) -> tuple[tuple[Piece, ...], tuple[Definition, ...]]:
        """Goes over the rows until none defines anything more."""
        changed = True
        while changed:
            rows = [number for number, piece in self._pieces.items() if piece.is_equality]
            changed = False
            for number in rows:
                if number in self._pieces:
                    changed |= self._use(number)
        return tuple(self._pieces.values()), tuple(self._definitions)

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
        best: tuple[int, Definition, list[Piece]] | None = None
        for definition in self._define(self._pieces[number]):
            others = self._others(number, definition)
            pieces = self._insert_all(others, definition)
            if pieces is None:
                continue
            row = self._bound(self._pieces[number], definition)
            growth = _growth(others, pieces, self._pieces[number], row, self._may_grow)
            if growth is not None and (best is None or growth < best[0]):
                best = growth, definition, [*pieces, *row]
        if best is None:
            return False
        _, definition, pieces = best
        for reader in sorted(self._readers[definition.variable]):
            self._remove(reader)
        for piece in pieces:
            self._add(piece)
        self._definitions.append(definition)
        return True

    def _define(self, row: Piece) -> Iterator[Definition]:
        """Yields what a row defines."""
        if row.bounds is None or len(row.terms) > _MOST_TERMS:
            return
        for place, terms in self._solve(row.terms, row.bounds[0]).items():
            others = tuple(i for i in row.variables if i != row.variables[place])
            yield Definition(row.variables[place], terms, others)

    def _others(self, number: int, definition: Definition) -> list[Piece]:
        readers = sorted(self._readers[definition.variable] - {number})
        return [self._pieces[reader] for reader in readers]

    def _insert_all(self, pieces: Sequence[Piece], definition: Definition) -> list[Piece] | None:
        """Returns the pieces without a variable; None where one would have no mean."""
        found = []
        for piece in pieces:
            rest = tuple(i for i in piece.variables if i != definition.variable)
            union = (*rest, *(i for i in definition.variables if i not in rest))
            place = {variable: i for i, variable in enumerate(union)}
            places = tuple(place.get(i, -1) for i in piece.variables)
            inner = tuple(place[i] for i in definition.variables)
            composed = self._compose(piece.terms, places, definition.terms, inner)
            if composed is None:
                return None
            terms, read = composed
            variables = tuple(union[i] for i in read)
            found.append(replace(piece, terms=terms, variables=variables))
        return found

    def _bound(self, row: Piece, definition: Definition) -> list[Piece]:
        """Returns the row that keeps a substituted variable within its bounds, if one has to."""
        j, places = definition.variable, list(definition.variables)
        least, most = sum_range(definition.terms, self._lower[places], self._upper[places])
        low, high = float(self._lower[j]), float(self._upper[j])
        if low <= least and most <= high:
            return []
        terms, variables = definition.terms, definition.variables
        return [replace(row, terms=terms, variables=variables, bounds=(low, high))]


def _growth(
    before: Sequence[Piece],
    after: Sequence[Piece],
    row: Piece,
    bound: Sequence[Piece],
    may_grow: bool,
) -> int | None:
    """Returns by how many terms a program grows; None if that is too much."""
    growth = _size(after) - _size(before) - row.size
    if growth <= 0:
        return growth
    costs = [piece for piece in after if piece.bounds is None]
    rows = [piece for piece in (*after, *bound) if piece.bounds is not None]
    old_rows = [piece for piece in (*before, row) if piece.bounds is not None]
    fits = (
        _size(rows) <= _size(old_rows)
        and all(piece.size <= _MOST_COST_TERMS for piece in costs)
        and all(_degree(piece) <= _MOST_DEGREE for piece in costs)
    )
    return growth if may_grow and fits else None


def _size(pieces: Iterable[Piece]) -> int:
    return sum(piece.size for piece in pieces)


def _degree(piece: Piece) -> int:
    """Returns the largest total degree of a term."""
    return max((sum(f.exponent for f in term.factors) for term in piece.terms), default=0)


def _solve(terms: tuple[Term, ...], value: float) -> dict[int, tuple[Term, ...]]:
    """Returns what Σ terms = value has each variable be that stands once, alone and linearly."""
    counts: dict[int, int] = {}
    for term in terms:
        for factor in term.factors:
            counts[factor.variable] = counts.get(factor.variable, 0) + 1
    largest = max((abs(term.coefficient) for term in terms if term.factors), default=0.0)
    found = {}
    for term in terms:
        if len(term.factors) == 1 and abs(term.coefficient) >= _LEAST_PIVOT * largest:
            (factor,) = term.factors
            if (
                factor == Factor(factor.variable, FunctionKind.POWER)
                and counts[factor.variable] == 1
            ):
                found[factor.variable] = _solved_for(terms, value, term)
    return found


def _solved_for(terms: tuple[Term, ...], value: float, own: Term) -> tuple[Term, ...]:
    """Returns −(Σ other terms − value)/a, numbered without the variable of the term a x."""
    (factor,) = own.factors
    count = 1 + max(f.variable for term in terms for f in term.factors)
    places = [i - (i > factor.variable) for i in range(count)]
    total = from_terms((term for term in terms if term is not own), places)
    total[()] = total.get((), 0.0) - value
    return to_terms({parts: -a / own.coefficient for parts, a in total.items() if a})


def _compose(
    terms: tuple[Term, ...],
    places: tuple[int, ...],
    definition: tuple[Term, ...],
    inner: tuple[int, ...],
) -> tuple[tuple[Term, ...], tuple[int, ...]] | None:
    """Returns terms into which a definition is put, and what they still read of the union.

    Args:
        terms: over local variables.
        places: which of the union of both's variables those are; −1 for the one that is defined.
        definition: over its own.
        inner: which of the union those are.
    """
    defined = from_terms(definition, inner)
    values = [defined if i < 0 else function(i, FunctionKind.POWER) for i in places]
    try:
        total = compose(from_terms(terms), values)
    except (NoClosedFormError, TooManyTermsError):
        return None
    read = tuple(sorted({part.variable for parts in total for part in parts}))
    number = {variable: i for i, variable in enumerate(read)}
    renamed = {
        tuple(part._replace(variable=number[part.variable]) for part in parts): a
        for parts, a in total.items()
    }
    return to_terms(renamed), read
