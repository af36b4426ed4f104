"""Which squares a bound of a polynomial program is made of: cliques, monomials and products."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction

from drake_aigto.certify.box_polynomials import BoxProgram
from drake_aigto.certify.cliques import elimination
from drake_aigto.certify.polynomials import Monomial, Polynomial, number, times, variables_of

# Clarabel factors a matrix with a row for each entry of a block: Σ entries³ in an iteration.
_MOST_WORK = 4e9
_WIDEST = 60  # block of a clique's variables, and of products of theirs:
_WIDEST_OF_PRODUCTS = 28


class TooWideError(Exception):
    """Matrices would be too large; its message says why."""


@dataclass(frozen=True, eq=False)
class Block:
    """factor · mᵀ Z m with Z ⪰ 0, m the monomials of a basis."""

    factor: Polynomial
    basis: Sequence[Monomial]

    def entries(self) -> Iterator[tuple[int, int, Polynomial]]:
        """Yields i, j ≤ i and factor m_i m_j."""
        for i, own in enumerate(self.basis):
            for j in range(i + 1):
                yield i, j, times(self.factor, _single(own + self.basis[j]))


@dataclass(frozen=True, eq=False)
class Relaxation:
    """What the cost, less its bound, is a sum of.

    Attributes:
        blocks: squares, and products of squares with rows.
        rows: 0 or more, with a factor λ ≥ 0 each.
        equalities: 0, with any factor each.
    """

    blocks: Sequence[Block]
    rows: Sequence[Polynomial]
    equalities: Sequence[Polynomial]


def relax(program: BoxProgram) -> Relaxation:
    """Returns a relaxation of order 2 where cliques are small, else of order 1.

    Raises:
        TooWideError: matrices would be too large.
    """
    cliques = _cliques(program)
    orders = [2 if math.comb(len(c) + 2, 2) <= _WIDEST_OF_PRODUCTS else 1 for c in cliques]
    bases = _bases(program, cliques, orders)
    if _work(bases) > _MOST_WORK:
        orders = [1] * len(cliques)
        bases = _bases(program, cliques, orders)
    if _work(bases) > _MOST_WORK:
        raise TooWideError(f"{max(map(len, cliques))} variables are coupled all with all")
    known = {_product(a, b) for basis in bases for a in basis for b in basis}
    blocks, rows = [Block(number(1), basis) for basis in bases], list(program.inequalities)
    for clique, order in zip(cliques, orders, strict=True):
        if order == 2:
            blocks += _localized(program, clique)
        else:
            rows += _products_of_bounds(clique)
    return Relaxation(
        blocks,
        [p for p in rows if _is_of(program.main(p), known)],
        [p for p in _multiplied(program, cliques, bases) if _is_of(program.main(p), known)],
    )


def _is_of(p: Polynomial, known: set[Monomial]) -> bool:
    return any(p.keys()) and p.keys() <= known


def _cliques(program: BoxProgram) -> list[tuple[int, ...]]:
    """Returns maximal cliques of variables that terms of the cost and rows couple, completed."""
    rows = [program.main(p) for p in (*program.inequalities, *program.equalities)]
    coupled = [tuple(variables_of([p])) for p in rows]
    coupled += [tuple(set(monomial)) for monomial in program.main(program.cost)]
    own = sorted({i for clique in coupled for i in clique})
    place = {i: k for k, i in enumerate(own)}
    order = elimination(len(own), [tuple(place[i] for i in c) for c in coupled], len(own))
    found: list[set[int]] = []
    for clique in order or []:
        if not any(set(clique) <= other for other in found):
            found.append(set(clique))
    return [tuple(sorted(own[k] for k in clique)) for clique in found]


def _bases(
    program: BoxProgram, cliques: Sequence[tuple[int, ...]], orders: Sequence[int]
) -> list[tuple[Monomial, ...]]:
    """Returns monomials of each clique, and of each term that these have no product for."""
    bases = [_monomials(c, order) for c, order in zip(cliques, orders, strict=True)]
    known = {_product(a, b) for basis in bases for a in basis for b in basis}
    high = [m for m in program.main(program.cost) if m not in known]
    groups = sorted({tuple(sorted(set(m))) for m in high})
    for group in groups:
        degree = max(len(m) for m in high if set(m) <= set(group))
        bases.append(_monomials(group, (degree + 1) // 2))
    return bases


def _monomials(clique: Sequence[int], order: int) -> tuple[Monomial, ...]:
    """Returns all products of so many factors at most."""
    widest = _WIDEST if order == 1 else _WIDEST_OF_PRODUCTS
    if math.comb(len(clique) + order, order) > widest:
        raise TooWideError(f"{len(clique)} variables are coupled all with all")
    return tuple(
        m for d in range(order + 1) for m in itertools.combinations_with_replacement(clique, d)
    )


def _work(bases: Iterable[Sequence[Monomial]]) -> float:
    return sum((0.5 * len(basis) * (len(basis) + 1)) ** 3 for basis in bases)


def _localized(program: BoxProgram, clique: Sequence[int]) -> Iterator[Block]:
    """Yields squares times what is 0 or more in a clique."""
    basis = _monomials(clique, 1)
    for i in clique:
        yield Block({(): Fraction(1), (i, i): Fraction(-1)}, basis)
    for p in program.inequalities:
        own = program.main(p)
        if variables_of([own]) <= set(clique) and max(map(len, own), default=0) <= 2:
            yield Block(p, basis)


def _products_of_bounds(clique: Sequence[int]) -> Iterator[Polynomial]:
    """Yields 1 − y_i² and (1 ± y_i)(1 ± y_j)."""
    one = Fraction(1)
    for i in clique:
        yield {(): one, (i, i): -one}
    for i, j in itertools.combinations(clique, 2):
        for a, b in itertools.product((one, -one), repeat=2):
            yield {(): one, (i,): a, (j,): b, (i, j): a * b}


def _multiplied(
    program: BoxProgram, cliques: Sequence[tuple[int, ...]], bases: Sequence[Sequence[Monomial]]
) -> Iterator[Polynomial]:
    """Yields equalities times the monomials of cliques that they are in."""
    for p in program.equalities:
        own = variables_of([program.main(p)])
        near = [b for c, b in zip(cliques, bases, strict=False) if own <= set(c)]
        for m in sorted({m for basis in near for m in basis} | {()}):
            yield times(p, _single(m))


def _single(factors: Monomial) -> Polynomial:
    return {tuple(sorted(factors)): Fraction(1)}


def _product(a: Monomial, b: Monomial) -> Monomial:
    return tuple(sorted(a + b))
