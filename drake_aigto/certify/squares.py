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

import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from pydrake.solvers import Binding, ClarabelSolver, MathematicalProgram, MathematicalProgramResult

from drake_aigto.arrays import Floats
from drake_aigto.certify.box_polynomials import BoxProgram, box_program
from drake_aigto.certify.intervals import UNIT
from drake_aigto.certify.polynomials import Monomial, NotPolynomialError, Polynomial
from drake_aigto.certify.program import Formulas
from drake_aigto.certify.relaxations import Block, Relaxation, TooWideError, relax

_UNDERFLOW = 1e-300


@dataclass(frozen=True, eq=False)
class SquaresBound:
    """What sums of squares say.

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
        x: what a start has where moments say nothing (n,).
    """
    try:
        program = box_program(formulas)
        relaxation = relax(program)
    except (NotPolynomialError, TooWideError) as error:
        return SquaresBound(-math.inf, reason=str(error))
    moments = _Moments(program, relaxation)
    result = moments.solve()
    if not result.is_success() and moments.identity({}, result).bound() > 0.0:
        return SquaresBound(math.inf)
    bound = moments.identity(program.cost, result).bound() * program.scale
    if not math.isfinite(bound):
        return SquaresBound(-math.inf, reason=f"Clarabel: {result.get_solution_result().name}")
    return SquaresBound(bound, program.start(moments.means(result), x))


class _Moments:
    """The least mean of the cost over moments of y."""

    def __init__(self, program: BoxProgram, relaxation: Relaxation) -> None:
        self._program, self._prog = program, MathematicalProgram()
        main = (
            m
            for block in relaxation.blocks
            if block.factor == {(): Fraction(1)}
            for _, _, p in block.entries()
            for m in p
        )
        monomials = sorted({m for m in main if m})
        y = self._prog.NewContinuousVariables(len(monomials), "moment")
        self._moments = dict(zip(monomials, y, strict=True))
        constant, terms = self._linear(program.cost)
        self._prog.AddLinearCost(list(terms.values()), constant, self._read(terms))
        self.blocks = [(block, self._add_block(block)) for block in relaxation.blocks]
        self.rows = [(p, self._add_row(p, math.inf)) for p in relaxation.rows]
        self.equalities = [(p, self._add_row(p, 0.0)) for p in relaxation.equalities]

    def solve(self) -> MathematicalProgramResult:
        return ClarabelSolver().Solve(self._prog)

    def identity(self, cost: Polynomial, result: MathematicalProgramResult) -> Identity:
        """Returns a cost less all that is 0 or more, with the multipliers of an answer."""
        identity = Identity(cost)
        for block, binding in self.blocks:
            identity.take_squares(block, _matrix(result, binding, len(block.basis)))
        for row, binding in self.rows:
            identity.take(row, max(0.0, _dual(result, binding)))
        for row, binding in self.equalities:
            identity.take(row, _dual(result, binding))
        return identity

    def means(self, result: MathematicalProgramResult) -> dict[int, float]:
        return {m[0]: result.GetSolution(y) for m, y in self._moments.items() if len(m) == 1}

    def _linear(self, p: Polynomial) -> tuple[float, dict[Monomial, float]]:
        """Returns the constant and the factors of moments."""
        own = {m: float(c) for m, c in self._program.main(p).items()}
        return own.pop((), 0.0), own

    def _read(self, terms: Iterable[Monomial]) -> list[object]:
        return [self._moments[m] for m in terms]

    def _add_row(self, p: Polynomial, most: float) -> Binding:
        """Adds 0 ≤ the mean of p ≤ most."""
        constant, terms = self._linear(p)
        row = np.array([list(terms.values())])
        if most == 0.0:
            return self._prog.AddLinearEqualityConstraint(row, [-constant], self._read(terms))
        return self._prog.AddLinearConstraint(row, [-constant], [most], self._read(terms))

    def _add_block(self, block: Block) -> Binding:
        size = len(block.basis)
        matrices: defaultdict[Monomial, Floats] = defaultdict(lambda: np.zeros((size, size)))
        for i, j, p in block.entries():
            for m, c in self._program.main(p).items():
                matrices[m][i, j] = matrices[m][j, i] = float(c)
        fixed = matrices.pop((), np.zeros((size, size)))
        return self._prog.AddLinearMatrixInequalityConstraint(
            [fixed, *matrices.values()], self._read(matrices)
        )


def _matrix(result: MathematicalProgramResult, binding: Binding, size: int) -> Floats:
    """Returns Z (size, size), which has its lower triangle's columns one after the other."""
    matrix = np.zeros((size, size))
    columns, rows = np.triu_indices(size)
    matrix[rows, columns] = matrix[columns, rows] = result.GetDualSolution(binding)
    return matrix


def _dual(result: MathematicalProgramResult, binding: Binding) -> float:
    return float(result.GetDualSolution(binding)[0])


class Identity:
    """The cost less what is 0 or more, term by term: at least t where −1 ≤ y ≤ 1.

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
        """Returns t, of which all that is left of other terms, and rounding, is taken away."""
        constant = self._left(())[0]
        losses = [self._left(m) for m in self._terms if m]
        # Even powers are 0 or more.
        parts = [
            min(0.0, low) if _is_even(m) else -max(abs(low), abs(high))
            for m, (low, high) in zip((m for m in self._terms if m), losses, strict=True)
        ]
        total = math.fsum([constant, *parts])
        return total - 2.0 * UNIT * abs(total)

    def _left(self, monomial: Monomial) -> tuple[float, float]:
        """Returns bounds of a term's factor: a product of three roundings each, summed exactly."""
        terms = self._terms[monomial]
        total = math.fsum(terms)
        error = 4.0 * UNIT * math.fsum(map(abs, terms)) + _UNDERFLOW
        return total - error, total + error


def _is_even(monomial: Monomial) -> bool:
    return all(monomial.count(i) % 2 == 0 for i in monomial)


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
