"""Sums of squares: near the least value of coupled polynomials, and never above it."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction
from typing import Any

import numpy as np
import pydrake.symbolic as sym
import pytest
from pydrake.solvers import ExpressionCost, MathematicalProgram

from benchmarks.collections.constrained_programs import concave_programs
from drake_aigto.certify import Block, Identity, Method, bound_by_squares, certify, read_formulas


def coupled(size: int) -> tuple[MathematicalProgram, Any]:
    """Returns variables in [−1, 2], all bounded."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(size, "x")
    prog.AddBoundingBoxConstraint(-1.0, 2.0, x)
    return prog, x


def quadratic(matrix: np.ndarray, x: Any) -> Any:
    return sum(c * x[i] * x[j] for (i, j), c in np.ndenumerate(matrix))


def test_a_concave_program_of_many_coupled_variables_is_proven() -> None:
    problem = next(each for each in concave_programs() if each.num_variables == 13)
    found = certify(problem.prog(), problem.minimizers[0])
    assert found.method == Method.SQUARES
    assert found.gap <= 1e-6
    assert found.lower_bound <= problem.minimum


def test_waves_of_differences_are_polynomials() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(12, "x")
    prog.AddCost(sum(sym.cos(a - b) for a, b in itertools.combinations(x, 2)))
    found = certify(prog)
    assert found.method == Method.SQUARES
    assert found.lower_bound <= -6.0  # as |Σ exp(i x)|² = 12 + 2 f ≥ 0
    assert found.lower_bound == pytest.approx(-6.0, abs=1e-5)


def test_no_bound_is_above_the_best_value() -> None:
    rng = np.random.default_rng(5)
    for trial in range(8):
        size = int(rng.integers(2, 7))
        prog, x = coupled(size)
        matrix, cubic = rng.normal(size=(size, size)), rng.normal(size=size)
        row = rng.normal(size=(size, size))
        total = quadratic(matrix, x) + sum(a * x_i**3 for a, x_i in zip(cubic, x, strict=True))
        cost = ExpressionCost(total + x[0] ** 2 * x[-1] ** 2)
        prog.AddCost(cost, vars=cost.vars())
        if trial % 2:
            prog.AddConstraint(quadratic(row, x) <= 1.0)
        found = bound_by_squares(read_formulas(prog), np.zeros(size))
        points = rng.uniform(-1.0, 2.0, (5000, size))
        values = np.einsum("ki,ij,kj->k", points, matrix, points) + points**3 @ cubic
        values += points[:, 0] ** 2 * points[:, -1] ** 2
        if trial % 2:
            values = values[np.einsum("ki,ij,kj->k", points, row, points) <= 1.0]
        least = np.min(values, initial=math.inf)
        assert found.lower_bound <= least
        assert found.lower_bound > -100.0  # which sums of ranges are below


def test_however_bad_the_multipliers_are_the_bound_holds() -> None:
    rng = np.random.default_rng(6)
    cost = {(0, 0, 1): Fraction(1), (1,): Fraction(-1, 3), (): Fraction(2)}
    basis = ((), (0,), (1,), (0, 1))
    for _ in range(20):
        identity = Identity(cost)
        matrix = rng.normal(size=(4, 4))
        identity.take_squares(Block({(): Fraction(1)}, basis), matrix + matrix.T)
        identity.take({(): Fraction(1), (0,): Fraction(-1)}, rng.uniform())
        y = rng.uniform(-1.0, 1.0, (2, 1000))
        assert identity.bound() <= np.min(y[0] ** 2 * y[1] - y[1] / 3 + 2.0)


def test_that_coupled_rows_contradict_each_other_is_proven() -> None:
    """Σ_{i<j} x_i x_j ≥ −½ Σ x_i² is −6 at least where |x| ≤ 1."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(12, "x")
    prog.AddBoundingBoxConstraint(-1.0, 1.0, x)
    pairs = sum(a * b for a, b in itertools.combinations(x, 2))
    prog.AddCost(pairs)
    prog.AddConstraint(pairs <= -5.9)
    assert not certify(prog).is_infeasible
    prog.AddConstraint(pairs <= -6.1)
    assert certify(prog).is_infeasible


def test_what_stands_in_the_way_is_said() -> None:
    prog, x = coupled(6)
    (free,) = prog.NewContinuousVariables(1, "free")
    prog.AddCost(free**2 + sum(x[i] * x[j] for i, j in itertools.combinations(range(6), 2)))
    assert bound_by_squares(read_formulas(prog), np.zeros(7)).reason == "free(0) lacks a bound"
    prog, x = coupled(12)
    prog.AddCost(sum(sym.exp(x[i] * x[j]) for i, j in itertools.combinations(range(12), 2)))
    assert certify(prog).reason.endswith("no sums of squares: exp is no polynomial")
