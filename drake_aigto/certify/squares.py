"""Lower bounds of polynomial programs by sums of squares, over cliques of few variables.

Let f be the cost, g ≥ 0 and h = 0 the rows, over −1 ≤ y ≤ 1. If, for all y,

    f − t = Σ_k m_kᵀ Z_k m_k + Σ_j g_j m_jᵀ Z_j m_j + Σ_i λ_i g_i + Σ_i μ_i h_i,   Z ⪰ 0, λ ≥ 0,

with monomials m_k of a clique of variables, and rows times monomials among g and h, then f ≥ t at
all feasible points (Putinar 1993; with cliques, Waki, Kim, Kojima & Muramatsu 2006, SIAM J. Optim.
17:218). The largest such t is a semidefinite program; its other side minimizes over moments of y,
which Clarabel does. Its answer is rounded. So Z gets a little more on its diagonal, until a
Cholesky factor proves it (Rump 2006, BIT 46:433), and λ is cut at 0; the identity is then off by
some Σ r_α y^α, which is −Σ |r_α| at least. Hence the bound is rigorous, however good the answer.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from pydrake.solvers import Binding, ClarabelSolver, MathematicalProgram, MathematicalProgramResult

from drake_aigto.arrays import Floats
from drake_aigto.certify.formulas import Formulas
from drake_aigto.certify.intervals import UNIT
from drake_aigto.certify.polynomials import (
    ONE,
    BoxProgram,
    Monomial,
    NoSquaresError,
    Polynomial,
    box_program,
    number,
    times,
    variables_of,
)

# Clarabel factors a matrix with a row for each entry of a block: Σ entries³ in an iteration.
_MOST_WORK = 4e9
_WIDEST = 60  # block of a clique's variables, and of products of theirs:
_WIDEST_OF_PRODUCTS = 28
_UNDERFLOW = 1e-300


@dataclass(frozen=True, eq=False)
class SquaresBound:
    """Result of sums of squares.

    Attributes:
        lower_bound: of the cost; −∞ if there is none, ∞ if there is no feasible point.
        start: near a minimizer, perhaps (n,); None if there is none.
        reason: why there is no bound, or an empty string.
    """

    lower_bound: float
    start: Floats | None = field(repr=False, default=None)
    reason: str = ""


def bound_by_squares(formulas: Formulas, x: Floats) -> SquaresBound:
    """Returns a lower bound of a polynomial program over its bounds.

    Args:
        formulas: the program.
        x: values of a start for variables without moments (n,).
    """
    try:
        program = box_program(formulas)
        moments = _Moments(program)
    except NoSquaresError as error:
        return SquaresBound(-math.inf, reason=str(error))
    except OverflowError:
        return SquaresBound(-math.inf, reason="its coefficients are beyond the range of numbers")
    result = moments.solve()
    if not result.is_success() and moments.identity({}, result).bound() > 0.0:
        return SquaresBound(math.inf)
    bound = moments.identity(program.cost, result).bound() * program.scale
    if not math.isfinite(bound):
        return SquaresBound(-math.inf, reason=f"Clarabel: {result.get_solution_result().name}")
    return SquaresBound(bound, program.start(moments.means(result), x))


@dataclass(frozen=True, eq=False)
class Block:
    """factor · mᵀ Z m with Z ⪰ 0, m the monomials of a basis."""

    factor: Polynomial
    basis: Sequence[Monomial]

    def entries(self) -> Iterator[tuple[int, int, Polynomial]]:
        """Yields i, j ≤ i and factor m_i m_j."""
        for i, own in enumerate(self.basis):
            for j in range(i + 1):
                yield i, j, times(self.factor, {_product(own, self.basis[j]): ONE})


class _Moments:
    """The least mean of the cost over moments of y.

    Its other side are squares, and products of squares with rows, that the cost less its bound is a
    sum of. They are of order 2 where cliques are small, else of order 1.

    Args:
        program: the cost and the rows.

    Raises:
        NoSquaresError: matrices would be too large, or there is nothing to choose.
    """

    def __init__(self, program: BoxProgram) -> None:
        self._program, self._prog = program, MathematicalProgram()
        self._cliques = _cliques(program)
        sizes = [math.comb(len(clique) + 2, 2) for clique in self._cliques]
        orders = [2 if size <= _WIDEST_OF_PRODUCTS else 1 for size in sizes]
        bases = self._bases(orders)
        if _work(bases) > _MOST_WORK:
            orders = [1] * len(orders)
            bases = self._bases(orders)
        if _work(bases) > _MOST_WORK:
            raise _too_wide(max(map(len, self._cliques)))
        own = sorted({_product(a, b) for basis in bases for a in basis for b in basis} - {()})
        if not own:
            raise NoSquaresError("all variables are fixed")
        y = self._prog.NewContinuousVariables(len(own), "moment")
        self._moments = dict(zip(own, y, strict=True))
        constant, factors, moments = self._linear(program.cost)
        self._prog.AddLinearCost(factors, constant, moments)
        blocks, rows = [Block(number(1), basis) for basis in bases], list(program.inequalities)
        for clique, order in zip(self._cliques, orders, strict=True):
            if order == 2:
                blocks += self._localized(clique)
            else:
                rows += _products_of_bounds(clique)
        self._blocks = [(block, self._add_block(block)) for block in blocks]
        # Rows that are 0 or more have a factor λ ≥ 0, those that are 0 any factor.
        sides = [(p, False) for p in rows] + [(p, True) for p in self._multiplied(bases)]
        self._rows = [(p, eq, self._add_row(p, eq)) for p, eq in sides if self._has_moments(p)]

    def solve(self) -> MathematicalProgramResult:
        return ClarabelSolver().Solve(self._prog)

    def identity(self, cost: Polynomial, result: MathematicalProgramResult) -> Identity:
        """Returns a cost less all that is 0 or more, with the multipliers of an answer."""
        identity = Identity(cost)
        for block, binding in self._blocks:
            # The dual has the columns of Z's lower triangle, one after the other.
            matrix = np.zeros((len(block.basis), len(block.basis)))
            columns, rows = np.triu_indices(len(matrix))
            matrix[rows, columns] = matrix[columns, rows] = result.GetDualSolution(binding)
            identity.take_squares(block, matrix)
        for row, is_equal, binding in self._rows:
            factor = float(result.GetDualSolution(binding)[0])
            identity.take(row, factor if is_equal else max(0.0, factor))
        return identity

    def means(self, result: MathematicalProgramResult) -> dict[int, float]:
        return {m[0]: result.GetSolution(y) for m, y in self._moments.items() if len(m) == 1}

    def _bases(self, orders: Sequence[int]) -> list[tuple[Monomial, ...]]:
        """Returns monomials of each clique, and of each term that these have no product for."""
        bases = [_monomials(c, order) for c, order in zip(self._cliques, orders, strict=True)]
        known = {_product(a, b) for basis in bases for a in basis for b in basis}
        high = [m for m in self._program.main(self._program.cost) if m not in known]
        for group in sorted({tuple(sorted(set(m))) for m in high}):
            degree = max(len(m) for m in high if set(m) <= set(group))
            bases.append(_monomials(group, (degree + 1) // 2))
        return bases

    def _localized(self, clique: Sequence[int]) -> Iterator[Block]:
        """Yields squares times nonnegative polynomials of a clique."""
        basis = _monomials(clique, 1)
        for i in clique:
            yield Block({(): ONE, (i, i): -ONE}, basis)
        for p in self._program.inequalities:
            own = self._program.main(p)
            if variables_of(own) <= set(clique) and max(map(len, own), default=0) <= 2:
                yield Block(p, basis)

    def _multiplied(self, bases: Sequence[Sequence[Monomial]]) -> Iterator[Polynomial]:
        """Yields equalities times the monomials of cliques that they are in."""
        for p in self._program.equalities:
            own = variables_of(self._program.main(p))
            near = [b for c, b in zip(self._cliques, bases, strict=False) if own <= set(c)]
            for m in sorted({m for basis in near for m in basis} | {()}):
                yield times(p, {m: ONE})

    def _has_moments(self, p: Polynomial) -> bool:
        """Returns whether p has only monomials with a moment, except for tiny ones."""
        own = self._program.main(p)
        return any(own) and own.keys() - {()} <= self._moments.keys()

    def _linear(self, p: Polynomial) -> tuple[float, list[float], list[object]]:
        """Returns the constant, the factors of moments, and these moments."""
        own = {m: float(c) for m, c in self._program.main(p).items()}
        constant = own.pop((), 0.0)
        return constant, list(own.values()), [self._moments[m] for m in own]

    def _add_row(self, p: Polynomial, is_equal: bool) -> Binding:
        """Adds 0 ≤ the mean of p, or 0 = it."""
        constant, factors, moments = self._linear(p)
        row, least = np.array([factors]), [-constant]
        if is_equal:
            return self._prog.AddLinearEqualityConstraint(row, least, moments)
        return self._prog.AddLinearConstraint(row, least, [math.inf], moments)

    def _add_block(self, block: Block) -> Binding:
        size = len(block.basis)
        matrices: defaultdict[Monomial, Floats] = defaultdict(lambda: np.zeros((size, size)))
        for i, j, p in block.entries():
            for m, c in self._program.main(p).items():
                matrices[m][i, j] = matrices[m][j, i] = float(c)
        fixed = matrices.pop((), np.zeros((size, size)))
        moments = [self._moments[m] for m in matrices]
        return self._prog.AddLinearMatrixInequalityConstraint([fixed, *matrices.values()], moments)


def elimination(
    num_variables: int, cliques: Sequence[tuple[int, ...]], most: int
) -> list[tuple[int, ...]] | None:
    """Returns every variable, in the order of elimination, with its neighbors then.

    The next one is one of the fewest neighbors. None if these are more than the most, with it.
    """
    beside: list[set[int]] = [set() for _ in range(num_variables)]
    for clique in cliques:
        for i in clique:
            beside[i].update(clique)
    queue = []
    for i, others in enumerate(beside):
        others.discard(i)
        queue.append((len(others), i))
    heapq.heapify(queue)
    order, is_gone = [], [False] * num_variables
    while queue:
        degree, i = heapq.heappop(queue)
        if is_gone[i] or degree != len(beside[i]):
            continue
        if degree >= most:
            return None
        is_gone[i] = True
        order.append((i, *sorted(beside[i])))
        for j in beside[i]:
            beside[j] |= beside[i]
            beside[j] -= {i, j}
            heapq.heappush(queue, (len(beside[j]), j))
    return order


def _cliques(program: BoxProgram) -> list[tuple[int, ...]]:
    """Returns maximal cliques of variables that terms of the cost and rows couple, completed."""
    rows = [program.main(p) for p in (*program.inequalities, *program.equalities)]
    coupled = [variables_of(p) for p in rows]
    coupled += [set(monomial) for monomial in program.main(program.cost)]
    own = sorted(set().union(*coupled))
    place = {i: k for k, i in enumerate(own)}
    order = elimination(len(own), [tuple(place[i] for i in c) for c in coupled], len(own))
    found: list[set[int]] = []
    for clique in order or []:
        if not any(set(clique) <= other for other in found):
            found.append(set(clique))
    return [tuple(sorted(own[k] for k in clique)) for clique in found]


def _monomials(clique: Sequence[int], order: int) -> tuple[Monomial, ...]:
    """Returns all products of up to this many factors."""
    widest = _WIDEST if order == 1 else _WIDEST_OF_PRODUCTS
    if math.comb(len(clique) + order, order) > widest:
        raise _too_wide(len(clique))
    return tuple(
        m for d in range(order + 1) for m in itertools.combinations_with_replacement(clique, d)
    )


def _too_wide(count: int) -> NoSquaresError:
    return NoSquaresError(f"{count} variables are coupled all with all")


def _work(bases: Sequence[Sequence[Monomial]]) -> float:
    return sum((0.5 * len(basis) * (len(basis) + 1)) ** 3 for basis in bases)


def _products_of_bounds(clique: Sequence[int]) -> Iterator[Polynomial]:
    """Yields 1 − y_i² and (1 ± y_i)(1 ± y_j)."""
    for i in clique:
        yield {(): ONE, (i, i): -ONE}
    for i, j in itertools.combinations(clique, 2):
        for a, b in itertools.product((ONE, -ONE), repeat=2):
            yield {(): ONE, (i,): a, (j,): b, (i, j): a * b}


def _product(a: Monomial, b: Monomial) -> Monomial:
    return tuple(sorted(a + b))


class Identity:
    """The cost minus nonnegative terms, term by term: at least t where −1 ≤ y ≤ 1.

    Args:
        cost: f.
    """

    def __init__(self, cost: Polynomial) -> None:
        """Takes nothing away yet."""
        self._terms: defaultdict[Monomial, list[float]] = defaultdict(list)
        self.take(cost, -1.0)

    def take(self, p: Polynomial, factor: float) -> None:
        """Takes factor · p away."""
        for m, c in p.items():
            self._terms[m].append(-factor * float(c))

    def take_squares(self, block: Block, matrix: Floats) -> None:
        """Takes factor · mᵀ Z m away, with Z made definite."""
        definite = _made_definite(matrix)
        for i, j, p in block.entries():
            self.take(p, definite[i, j] * (1.0 if i == j else 2.0))

    def bound(self) -> float:
        """Returns t minus remainders of all other terms, and rounding."""
        try:
            parts = [self._left(())[0]]
            for m in filter(None, list(self._terms)):
                low, high = self._left(m)
                is_even = all(m.count(i) % 2 == 0 for i in m)  # and 0 or more
                parts.append(min(low, 0.0) if is_even else min(low, -high))  # NaN stays NaN
            total = math.fsum(parts)
        except (OverflowError, ValueError):  # ∞ − ∞
            return -math.inf
        return total - 2.0 * UNIT * abs(total) if math.isfinite(total) else -math.inf

    def _left(self, monomial: Monomial) -> tuple[float, float]:
        """Returns bounds of a term's factor: a product of three roundings each, summed exactly."""
        terms = self._terms[monomial]
        total = math.fsum(terms)
        error = 4.0 * UNIT * math.fsum(map(abs, terms)) + _UNDERFLOW
        return total - error, total + error


def _made_definite(matrix: Floats) -> Floats:
    """Returns a matrix with more on its diagonal, so that it has no eigenvalue below 0.

    A floating Cholesky factor of A − c I, with c of (n + 1) u tr A or more, proves A (Rump 2006).
    """
    size = matrix.shape[0]
    if not np.all(np.isfinite(matrix)):
        return np.full_like(matrix, np.nan)
    more = max(0.0, -float(np.linalg.eigvalsh(matrix)[0]))
    margin = 2.0 * (size + 3) * UNIT * (float(np.trace(np.abs(matrix))) + size * more) + 1e-300
    while True:
        more += 2.0 * margin
        moved = matrix + more * np.eye(size)
        try:
            np.linalg.cholesky(moved - margin * np.eye(size))
        except np.linalg.LinAlgError:
            margin *= 2.0
        else:
            return moved
