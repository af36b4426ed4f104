"""Polynomials that Drake evaluates, but whose formula it hides, read off their values.

`MathematicalProgram.AddCost(expression)` makes a PolynomialCost of a polynomial of degree above 2;
it has no class in Python and no symbolic value.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import Cost, EvaluatorBase
from pydrake.symbolic import MakeVectorContinuousVariable
from scipy.linalg import lstsq

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.terms.sums import Factor, FunctionKind, Term

_HIGHEST_DEGREE = 16  # of a variable
_MOST_MONOMIALS = 1000
_FAR = 1e9  # where the highest power of a variable is all that counts
_PRESENT = 1e-9  # of the largest coefficient: less is rounding, before points far out tell more
_ALIKE = 1e-11  # values, relative to the sum of all monomials' sizes
_REWEIGHED = 3
_HELD_OUT = 50
_MAGNITUDES = (-3.0, 3.0)  # of points, as powers of ten
_SEED = 0


class HiddenError(Exception):
    """No polynomial was found that gives the values."""


def is_hidden_polynomial(evaluator: EvaluatorBase) -> bool:
    """Returns whether an evaluator is Drake's PolynomialCost."""
    if type(evaluator) is not Cost:
        return False
    name = evaluator.ToLatex(MakeVectorContinuousVariable(evaluator.num_vars(), "x"))
    return "PolynomialCost" in name


@lru_cache(maxsize=64)  # A program is parsed again where functions without means are lifted.
def read_polynomial(cost: EvaluatorBase) -> tuple[Term, ...]:
    """Returns the terms of a PolynomialCost, found from its values.

    Monomials are found one variable after another, those that follow held at random numbers
    (Zippel, *Probabilistic algorithms for sparse polynomials*, 1979), and only of variables that
    change each other's slope. Coefficients are least squares of relative errors over points whose
    sizes range over six powers of ten. The polynomial has to give the values at points that were
    not used.

    Args:
        cost: of variables x (n,).

    Raises:
        HiddenError: it has too many monomials, or too high a degree, or rounding hides some.
    """
    return _Reader(cost).run()


class _Reader:
    def __init__(self, cost: EvaluatorBase) -> None:
        self._cost, self._num_variables = cost, cost.num_vars()
        self._rng = np.random.default_rng(_SEED)
        self._held = self._draw(1)[0]
        self._total_degree = self._degree(slice(None))
        # Which variables (n, n) share a monomial: one changes the other's slope.
        changed = self._held + np.diag(self._draw(1)[0])
        slopes, *found = (
            ExtractGradient(self._cost.Eval(InitializeAutoDiff(x)))[0]
            for x in (self._held, *changed)
        )
        sizes = np.abs(found) + np.abs(slopes)
        near: Bools = np.abs(found - slopes) > _PRESENT * sizes
        self._neighbors = near | near.T

    def run(self) -> tuple[Term, ...]:
        """Returns the terms."""
        powers = np.zeros((1, self._num_variables), dtype=np.int64)
        for variable in range(self._num_variables):
            powers = np.concatenate([powers, self._find_monomials(variable, powers)])
            if len(powers) > _MOST_MONOMIALS:
                raise HiddenError(f"it has more than {_MOST_MONOMIALS} monomials")
        powers, coefficients = self._fit(powers)
        points = np.concatenate([self._draw_far(powers, _HELD_OUT), self._draw(_HELD_OUT)])
        sizes = _monomials(points, powers)
        errors = np.abs(sizes @ coefficients - self._evaluate(points))
        if np.any(errors > _ALIKE * (np.abs(sizes) @ np.abs(coefficients))):
            raise HiddenError("rounding hides some of its monomials")
        return tuple(
            Term(
                value,
                tuple(Factor(i, FunctionKind.POWER, row[i]) for i in np.flatnonzero(row).tolist()),
            )
            for row, value in zip(powers.tolist(), coefficients.tolist(), strict=True)
        )

    def _evaluate(self, points: Floats) -> Floats:
        """Returns values at points (m, n), shape (m,)."""
        values = np.array([self._cost.Eval(point)[0] for point in points])
        if not np.all(np.isfinite(values)):
            raise HiddenError("its values are not finite")
        return values

    def _draw(self, count: int) -> Floats:
        """Returns points (count, n) whose numbers are in ±[0.5, 1.5]."""
        size = count, self._num_variables
        return self._rng.choice([-1.0, 1.0], size) * self._rng.uniform(0.5, 1.5, size)

    def _draw_far(self, powers: Ints, count: int) -> Floats:
        """Returns points (2 count, n) of all magnitudes, half of them 0 but for one monomial's."""
        size = count, self._num_variables
        common = self._rng.uniform(*_MAGNITUDES, (2 * count, 1))
        points = self._draw(2 * count) * 10.0**common
        points[::2] *= 10.0 ** self._rng.uniform(*_MAGNITUDES, size)
        points[count:] *= powers[self._rng.integers(len(powers), size=count)] > 0
        return points

    def _degree(self, variables: slice | int) -> int:
        """Returns the degree in some variables together, from how fast values grow with them."""
        points = np.tile(self._held, (3, 1))
        points[:, variables] = np.outer((0.0, _FAR, 2.0 * _FAR), self._held)[:, variables]
        base, near, far = self._evaluate(points)
        if far == base or near == base:
            return 0
        degree = round(math.log2(abs((far - base) / (near - base))))
        if degree > _HIGHEST_DEGREE:
            raise HiddenError(f"its degree in a variable is {degree}")
        return degree

    def _find_monomials(self, variable: int, known: Ints) -> Ints:
        """Returns powers (t, n) of monomials with a variable and those before it.

        Args:
            variable: its number.
            known: powers of all monomials of those before, variables from this one on held.
        """
        others = known[:, : variable + 1] > 0
        known = known[~np.any(others & ~self._neighbors[variable, : variable + 1], axis=1)]
        degree = self._degree(variable)
        powers = np.repeat(known, degree, axis=0)
        powers[:, variable] = np.tile(np.arange(1, degree + 1), len(known))
        powers = powers[np.sum(powers, axis=1) <= self._total_degree]
        if len(powers) > _MOST_MONOMIALS:
            raise HiddenError(f"it may have more than {_MOST_MONOMIALS} monomials")
        points = self._draw(2 * len(powers) + 2)
        points[:, variable + 1 :] = self._held[variable + 1 :]
        without = points.copy()
        without[:, variable] = 0.0
        changes = self._evaluate(points) - self._evaluate(without)
        found = np.abs(_least_squares(_monomials(points, powers), changes))
        return powers[found > _PRESENT * np.max(found, initial=0.0)]

    def _fit(self, powers: Ints) -> tuple[Ints, Floats]:
        """Returns monomials (t, n) and coefficients (t,) whose relative errors are least."""
        points = self._draw_far(powers, 2 * len(powers))
        values, sizes = self._evaluate(points), _monomials(points, powers)
        coefficients = np.ones(len(powers))
        for _ in range(_REWEIGHED):
            totals = np.abs(sizes) @ np.abs(coefficients)
            weights = np.divide(1.0, totals, out=np.zeros_like(totals), where=totals > 0.0)
            coefficients = _least_squares(weights[:, None] * sizes, weights * values)
            shares = np.max(weights[:, None] * np.abs(sizes * coefficients), axis=0)
            counts = shares > _ALIKE  # The others are rounding.
            powers, sizes, coefficients = powers[counts], sizes[:, counts], coefficients[counts]
        return powers, np.array([_shortest(value) for value in coefficients.tolist()])


def _monomials(points: Floats, powers: Ints) -> Floats:
    """Returns monomials (m, t) of powers (t, n) at points (m, n)."""
    return np.prod(points[:, None, :] ** powers[None], axis=2)


def _least_squares(matrix: Floats, values: Floats) -> Floats:
    """Returns the least squares solution, columns divided by their sizes first."""
    sizes = np.linalg.norm(matrix, axis=0)
    found: Floats = lstsq(matrix / sizes, values, lapack_driver="gelsy")[0]
    return found / sizes


def _shortest(value: float) -> float:
    """Returns the number of nine digits that somebody may have written, if it is that close."""
    written = float(f"{value:.9g}")
    return written if abs(written - value) <= _ALIKE * abs(value) else value
