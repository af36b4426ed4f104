"""Values, derivatives and ladders of penalties at points."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from local_problems import add_cost
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import cos, exp, sin

from drake_aigto.kernels import kernel
from drake_aigto.local import (
    InteriorPoint,
    PenaltyLadder,
    PolynomialNlp,
    compile_nlp,
    differentiate,
    evaluate,
    factorize_band,
    make_point_system,
    make_point_tables,
    solve_band,
)


def chain(num_stages: int = 12) -> PolynomialNlp:
    """Returns a program with all kinds of factors, in stages; one variable is held."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2 * num_stages, "x").reshape(num_stages, 2)
    for i in range(num_stages):
        a, b = x[i]
        add_cost(prog, (a - 1.5) ** 4 + a * b**3 + b**2 * cos(2 * a + 0.3) + 0.1 * exp(b) * a)
        if i:
            before, _ = x[i - 1]
            prog.AddConstraint(a - before + 0.3 * sin(b - before) - 0.2 * b == 0)
    prog.AddBoundingBoxConstraint(-2.0, 2.0, x.ravel())
    prog.AddBoundingBoxConstraint(0.7, 0.7, x[0, :1])
    return compile_nlp(prog)


@kernel
def values_at(tables: Any, x: Any, values: Any, rows: Any) -> float:
    return evaluate(tables, x, values, rows)


@kernel
def derivatives_at(tables: Any, x: Any, scale: float, multipliers: Any, system: Any) -> None:
    differentiate(tables, x, scale, multipliers, system)


@kernel
def solution(band: Any, right: Any) -> bool:
    is_definite = factorize_band(band)
    if is_definite:
        solve_band(band, right)
    return is_definite


def test_values_are_those_of_the_program() -> None:
    nlp = chain()
    tables = make_point_tables(nlp)
    rows, values = np.empty(nlp.num_rows), np.empty(tables.functions.size)
    for seed in range(5):
        x = np.random.default_rng(seed).uniform(-2, 2, nlp.num_variables)
        f, expected = nlp.evaluate(x)
        assert values_at(tables, x, values, rows) == pytest.approx(f, rel=1e-12)
        np.testing.assert_allclose(rows, expected, atol=1e-12)


def test_derivatives_are_those_of_finite_differences() -> None:
    nlp, step = chain(4), 1e-6
    tables = make_point_tables(nlp)
    system, rng = make_point_system(tables), np.random.default_rng(1)
    x, multipliers = rng.uniform(-2, 2, nlp.num_variables), rng.normal(size=nlp.num_rows)
    free = np.flatnonzero(tables.places >= 0)
    places = tables.places[free]

    def slopes(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        derivatives_at(tables, at, 3.0, multipliers, system)
        jacobian = np.zeros((nlp.num_rows, tables.size))
        rows = np.repeat(np.arange(nlp.num_rows), np.diff(tables.first_entries))
        jacobian[rows, tables.entry_places] = system.jacobian
        return system.gradient.copy(), jacobian

    gradient, jacobian = slopes(x)
    hessian = np.zeros((tables.size, tables.size))
    for d in range(tables.bandwidth + 1):
        column = np.arange(tables.size - d)
        hessian[column, column + d] = hessian[column + d, column] = system.hessian[column, d]
    for i, place in zip(free, places, strict=True):
        ends = [x + sign * step * (np.arange(x.size) == i) for sign in (1, -1)]
        (f, c), (g, e) = (nlp.evaluate(end) for end in ends)
        assert gradient[place] == pytest.approx(3.0 * (f - g) / (2 * step), rel=1e-6, abs=1e-6)
        np.testing.assert_allclose(jacobian[:, place], (c - e) / (2 * step), atol=1e-6)
        (upper, above), (lower, below) = (slopes(end) for end in ends)
        change = (upper + multipliers @ above - lower - multipliers @ below) / (2 * step)
        np.testing.assert_allclose(hessian[:, place], change, atol=1e-5, rtol=1e-6)


@pytest.mark.parametrize("bandwidth", [0, 1, 4])
def test_bands_are_solved_unless_they_are_indefinite(bandwidth: int) -> None:
    rng = np.random.default_rng(bandwidth)
    band = rng.uniform(-1, 1, (9, bandwidth + 1))
    band[:, 0] = 2.5 * (bandwidth + 1)
    matrix = np.zeros((9, 9))
    for d in range(bandwidth + 1):
        matrix += np.diag(band[: 9 - d, d], -d)
    matrix += np.tril(matrix, -1).T
    x = rng.uniform(-1, 1, 9)
    right = matrix @ x
    assert solution(band.copy(), right)
    np.testing.assert_allclose(right, x, atol=1e-12)
    band[5, 0] = -1.0
    assert not solution(band, right)


def test_a_ladder_leads_from_anywhere_to_a_feasible_point_near_an_optimum() -> None:
    nlp = chain()
    center, half_width = np.zeros(nlp.num_variables), np.full(nlp.num_variables, 2.0)
    tables, none = make_point_tables(nlp), np.empty(0, dtype=np.int64)
    ladder = PenaltyLadder(nlp, tables, center, half_width, none, np.zeros(nlp.num_rows, bool))
    rng = np.random.default_rng(2)
    for _ in range(5):
        end = ladder.climb(rng.uniform(-2, 2, center.size), 0.01, 1e3)
        assert end.is_nearly_feasible
        assert np.max(np.abs(nlp.evaluate(end.x)[1])) <= 1e-3
        assert end.cost == pytest.approx(nlp.evaluate(end.x)[0])
        # No feasible direction leads down by more than the last barrier is worth.
        polished = InteriorPoint.warm().solve(nlp, end.x)
        assert polished.is_success
        assert polished.cost == pytest.approx(end.cost, rel=0.05)


def test_a_ladder_to_a_point_too_dear_is_given_up() -> None:
    nlp = chain()
    center, half_width = np.zeros(nlp.num_variables), np.full(nlp.num_variables, 2.0)
    tables, none = make_point_tables(nlp), np.empty(0, dtype=np.int64)
    ladder = PenaltyLadder(nlp, tables, center, half_width, none, np.zeros(nlp.num_rows, bool))
    whole = ladder.climb(center, 0.01, 1e3)
    cut = ladder.climb(center, 0.01, 1e3, most=whole.cost - 10.0)
    assert cut.steps < whole.steps and not cut.is_nearly_feasible
