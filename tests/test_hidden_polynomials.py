"""Polynomials whose formula Drake hides, read off their values."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.solvers import Cost, MathematicalProgram, QuadraticCost
from pydrake.symbolic import Polynomial, pow

from drake_aigto.terms import (
    FunctionKind,
    HiddenError,
    Term,
    is_hidden_polynomial,
    read_polynomial,
)


def hide(num_variables: int, formula: Any) -> tuple[Any, Cost]:
    """Returns the formula of new variables, and Drake's cost of it."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(num_variables, "x")
    expression = formula(x)
    binding = prog.AddCost(expression)
    assert binding.variables().size == num_variables
    return Polynomial(expression), binding.evaluator()


def table(terms: tuple[Term, ...]) -> dict[tuple[tuple[int, int], ...], float]:
    assert all(f.kind == FunctionKind.POWER for term in terms for f in term.factors)
    return {
        tuple((f.variable, f.exponent) for f in term.factors): term.coefficient for term in terms
    }


def expected(polynomial: Polynomial) -> dict[tuple[tuple[int, int], ...], float]:
    order = sorted(polynomial.indeterminates(), key=lambda variable: variable.get_id())
    number = {variable.get_id(): i for i, variable in enumerate(order)}
    return {
        tuple(sorted((number[v.get_id()], e) for v, e in monomial.get_powers().items())): value
        for monomial, coefficient in polynomial.monomial_to_coefficient_map().items()
        if (value := coefficient.Evaluate())
    }


def check(num_variables: int, formula: Any) -> None:
    polynomial, cost = hide(num_variables, formula)
    assert is_hidden_polynomial(cost)
    found, true = table(read_polynomial(cost)), expected(polynomial)
    assert found.keys() == true.keys()
    for monomial, coefficient in true.items():
        assert found[monomial] == pytest.approx(coefficient, rel=1e-10)


@given(st.data())
def test_sparse_polynomials_are_read(data: st.DataObject) -> None:
    n = data.draw(st.integers(1, 5), "n")
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1), "seed"))
    powers = (rng.integers(0, 4, (rng.integers(1, 8), n)) * (rng.random(n) < 0.7)).tolist()
    numbers = rng.choice([-1, 1], len(powers)) * 10.0 ** rng.uniform(-3, 3, len(powers))

    def formula(x: Any) -> Any:
        terms = (c * math.prod(map(pow, x, p)) for c, p in zip(numbers, powers, strict=True))
        return sum(pow(x_i, 4) for x_i in x) + sum(terms)

    check(n, formula)


@pytest.mark.parametrize(
    ("num_variables", "formula"),
    [
        (1, lambda x: 1e-3 * (x[0] - 1000) ** 2 * (x[0] + 5) ** 2 - x[0]),
        (2, lambda x: (1 - x[0]) ** 2 + 100 * (x[1] - x[0] ** 2) ** 2),
        (
            20,
            lambda x: sum((1 - a) ** 2 + 100 * (b - a * a) ** 2 for a, b in itertools.pairwise(x)),
        ),
        (3, lambda x: np.pi * x[0] * x[1] * x[2] - 1e-7 * x[0] ** 5),
        (3, lambda x: sum(x) ** 6),
    ],
    ids=["minima far apart", "Rosenbrock", "a chain", "numbers far apart", "dense"],
)
def test_polynomials_that_people_write_are_read(num_variables: int, formula: Any) -> None:
    check(num_variables, formula)


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        (lambda x: x[0] ** 3 + 1e-30 * x[1] ** 5, "rounding hides"),
        (lambda x: x[0] ** 17 + x[1], "its degree in a variable is 17"),
        (lambda x: x[0] ** 3 + 1e305 * x[1], "not finite"),
    ],
)
def test_what_values_do_not_tell_is_not_guessed(formula: Any, message: str) -> None:
    prog = MathematicalProgram()
    binding = prog.AddCost(formula(prog.NewContinuousVariables(2, "x")))
    with pytest.raises(HiddenError, match=message):
        read_polynomial(binding.evaluator())


def test_more_monomials_than_can_be_told_apart_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drake_aigto.terms.hidden_polynomials._MOST_MONOMIALS", 20)
    _, cost = hide(3, lambda x: sum(x) ** 4)
    with pytest.raises(HiddenError, match="more than 20 monomials"):
        read_polynomial(cost)


def test_other_costs_are_none() -> None:
    assert not is_hidden_polynomial(QuadraticCost(np.eye(2), np.zeros(2), 0.0))
