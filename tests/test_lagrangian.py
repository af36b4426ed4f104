"""Augmented Lagrangians: their minimisers become feasible at a weight that stays as it is."""

from __future__ import annotations

import numpy as np
from pydrake.solvers import ExpressionCost, MathematicalProgram

from drake_aigto.aigo import Box
from drake_aigto.box import BoxPolynomial
from drake_aigto.local import InteriorPoint, PolynomialNlp, compile_nlp
from drake_aigto.solver.lagrangian import AugmentedLagrangian
from drake_aigto.solver.program import AigoProgram, read_program


def two_rows() -> tuple[AigoProgram, Box]:
    """Returns min x₀⁴ + x₁² + x₂²  s.t.  x₀ + x₁ = 3,  x₁ x₂ = 1, which are told apart by λ."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    cost = ExpressionCost(x[0] ** 4 + x[1] ** 2 + x[2] ** 2)
    prog.AddCost(cost, vars=cost.vars())
    prog.AddConstraint(x[0] + x[1] == 3)
    prog.AddConstraint(x[1] * x[2] == 1)
    return read_program(prog), Box(np.ones(3), np.full(3, 2.0))


def minimise(f: BoxPolynomial, y: np.ndarray) -> np.ndarray:
    n = y.size
    nlp = PolynomialNlp(n, f.blocks, (), np.full(n, -np.inf), np.full(n, np.inf))
    return InteriorPoint().solve(nlp, y).x


def test_multipliers_make_constraints_hold_where_a_penalty_alone_does_not() -> None:
    program, first = two_rows()
    lagrangian = AugmentedLagrangian(program, first)
    y, residuals = np.array([1.0, 2.0, 0.5]), []
    for _ in range(12):
        y = minimise(lagrangian.function(1.0), y)
        residuals.append(np.max(np.abs(program.nlp.evaluate(y)[1])))
        lagrangian.update(1.0, y)
    assert residuals[0] > 1e-2 and residuals[-1] < 1e-4 * residuals[0]
    exact = InteriorPoint().solve(compile_nlp(program.source), y)
    np.testing.assert_allclose(y, exact.x, atol=1e-4)
    np.testing.assert_allclose(lagrangian.multipliers, exact.multipliers, atol=1e-3)


def test_its_value_and_mean_are_those_of_the_sum() -> None:
    program, first = two_rows()
    lagrangian = AugmentedLagrangian(program, first)
    y = np.array([0.3, -1.0, 2.0])
    plain = lagrangian.function(2.0)(y)
    lagrangian.update(2.0, y)
    residuals = program.nlp.evaluate(y)[1]
    moved = lagrangian.function(2.0)
    assert np.isclose(moved(y) - plain, lagrangian.multipliers @ residuals, rtol=1e-9)
    points = np.random.default_rng(0).uniform(y - 0.5, y + 0.5, (4000, 3))
    values = [moved(point) for point in points]
    error = np.std(values) / np.sqrt(len(values))
    assert abs(np.mean(values) - moved.mean(y, 0.5)) < 5 * error


def test_multipliers_stay_where_residuals_are_not_finite() -> None:
    program, first = two_rows()
    lagrangian = AugmentedLagrangian(program, first)
    lagrangian.update(1.0, np.full(3, np.inf))
    np.testing.assert_array_equal(lagrangian.multipliers, [0, 0])
