"""Lower bounds at edges: sides without an end, edges of domains, and of the range of numbers."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pydrake.symbolic as sym
import pytest
from pydrake.solvers import ExpressionConstraint, MathematicalProgram
from random_functions import add_cost, box, program

from benchmarks.random_programs import random_program
from drake_aigto.certify import certify, is_infeasible
from drake_aigto.solver import AigoOptions, AigoSolver

SMALL, TINY = -8.437660688527946e-86, -3.8056667485585995e-75


@pytest.mark.slow
def test_a_bound_that_is_missing_is_derived_or_named() -> None:
    prog = MathematicalProgram()
    (x,) = prog.NewContinuousVariables(1, "speed")
    add_cost(prog, x**4 - 3.0 * x**2 + x)
    assert certify(prog).gap <= 1e-6
    add_cost(prog, -(x**6))
    found = certify(prog, cells=200)
    assert found.lower_bound == -math.inf
    assert "speed(0) has no lower bound" in found.reason
    prog, x = program(lambda x: -(x**2) + 7.0, 1)
    prog.AddLinearCost([0.0], 1.0, x)
    assert certify(prog).lower_bound == pytest.approx(4.0, abs=1e-6)
    options = AigoOptions(certify=True, cells=2000, rounds=4, seed=3)
    result = AigoSolver(options).Solve(random_program(np.random.default_rng([0, 120])))
    assert result.get_solver_details().lower_bound == -math.inf
    # Its cells go so far out that powers overflow.
    result = AigoSolver(options).Solve(random_program(np.random.default_rng([11, 34])))
    assert result.get_solver_details().lower_bound <= result.get_optimal_cost() + 1e-6


@pytest.mark.parametrize(
    ("cost", "row", "reason"),
    [
        (lambda x, y: x**3 + y**2, None, "x(0) has no lower bound"),
        (lambda x, y: x**4 - x * y, None, "x(0) has no lower bound, x(1) has no lower bound"),
        (lambda x, y: x**3 + y**2, (1.0, 1.0), "x(0) has no lower bound, x(1) has no upper bound"),
        (lambda x, y: y**2 - sym.log(x), None, "x(0) has no upper bound"),
    ],
)
def test_a_bound_that_no_cell_gives_far_out_is_named_before_a_search(
    cost: Callable[..., Any], row: Any, reason: str
) -> None:
    prog, (x, y) = box(2, -np.inf, np.inf)
    add_cost(prog, cost(x, y))
    if row:
        prog.AddLinearConstraint([row], [-3.0], [np.inf], [x, y])
    found = certify(prog)
    assert found.lower_bound == -math.inf
    assert found.reason == reason
    assert found.cells < 100  # 400,000, in minutes


def linked(own: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *x: sum(map(own, x)) + sum(a * b for a, b in itertools.pairwise(x))


def partial_power(x: Any, y: Any) -> Any:
    """Has no value in a part of cells, where slopes prove nothing; least at x = .1 and y = 2."""
    return sym.pow(x - 0.1, 1.5) + 0.3 * x + 0.2 * y**2 - sym.pow(y, 2.5)


@pytest.mark.parametrize(
    ("cost", "row", "lower", "upper", "least"),
    [
        (lambda x: x**2, None, 2.0, 2.0, 4.0),  # fixed
        (lambda x: x + 1e-300 * x**2, None, 3.0, 3.0, 3.0),
        (linked(lambda x: x * sym.log(x)), None, [1e-9] * 5, 1.0, math.inf),
        (
            linked(lambda x: 1.0 / (2.0 + sym.sin(x) + sym.cos(x)) - 0.01 * x),
            None,
            [-50.0] * 5,
            50.0,
            0.0,
        ),
        (linked(lambda x: sym.exp(2.0 * x) - sym.exp(x) + x**2), None, [-800.0] * 5, 800.0, 0.0),
        (linked(lambda x: x**30), None, [-1e12] * 5, 1e12, 0.0),
        (lambda x, y: x + sym.pow(x + y, 1.5), None, [-1.0, -1.0], [1.0, 0.5], -0.5),
        (lambda x, y: 3.0 * x + sym.pow(x + y / 3.0, 2.5), None, [-1.0, -1.0], [1.0, 0.7], -0.7),
        (partial_power, None, [-3.0, -1.0], 2.0, 0.83 - 2.0**2.5),
        (partial_power, None, [-0.7, -4.0], 2.0, 0.83 - 2.0**2.5),
        (lambda x, y: 1e-250 * x**2 * y**2, None, [1e80, 1e80], 1e81, 1e70),
        (lambda x: (1e-162 * (x - 0.5)) ** 2, None, -1.0, 1.0, 0.0),
        (lambda x: 1e-300 * sym.exp(800.0 * x), None, 0.5, 1.0, 1e-126),
        # Rows that overflow, of numbers that do, and whose products underflow:
        (
            lambda x, y: x,
            (lambda x, y: 1e-250 * x**2 * y**2, -math.inf, 1e71),
            [1e80, 1e80],
            1e81,
            1e80,
        ),
        (
            lambda x: x,
            (lambda x: 1e200 * (1e200 * x - 1e200) - 1e300, -math.inf, 0.0),
            0.5,
            2.0,
            0.5,
        ),
        (
            lambda x, y, z: x,
            (
                lambda x, y, z: -7.8e22 * x * y**2 - 4.6e-73 * y**2 * z**3,
                -7.8e22 * 1.74e-08 * SMALL**2 * (1 + 1e-13),
                -7.8e22 * 1.74e-08 * SMALL**2 * (1 - 1e-13),
            ),
            [1.7388e-08, SMALL, TINY],
            [1.7406e-08, 8.4e-83, TINY],
            1.74e-08,
        ),
        # 0 log 0 = 0, and so are its multiples.
        (lambda x: x, (lambda x: 0.5 * x * sym.log(0.5 * x), -1e-15, 1e-15), -5.0, 0.0, 0.0),
        # A root that is 0 at an end: its slope there has no value.
        (lambda x: x, (lambda x: sym.sqrt(sym.abs(sym.cos(x))), 0.5, 0.9), 0.0, 3.0, 0.63),
        # Poles within cells, across which slopes say nothing.
        (lambda x, y, z: sym.pow(1.0 / x, 0.3) + y + z, None, [-math.inf, 0, 0], 4.0, 0.66),
        (lambda x: x, (lambda x: sym.exp(x) / x, -math.inf, -1e30), -1e-12, 0.03, -9e-31),
        # A power above the number of operations.
        (lambda x: x, (lambda x: sym.sqrt(0.5 + x**18), -np.inf, 2.5), -16.0, 1.1, -1.0),
    ],
)
def test_edges_of_numbers_and_of_domains_bring_no_false_claim(
    cost: Callable[..., Any], row: Any, lower: Any, upper: Any, least: float
) -> None:
    """Programs with a feasible point that costs no more than the least that is given."""
    prog, x = box(np.size(lower), lower, upper)
    add_cost(prog, cost(*x))
    if row:
        formula, low, high = row
        constraint = ExpressionConstraint([formula(*x)], [low], [high])
        prog.AddConstraint(constraint, vars=constraint.vars())
    assert not is_infeasible(prog)
    for cells in (1, 10, 300):
        found = certify(prog, cells=cells)
        assert not found.is_infeasible
        assert found.lower_bound <= least + 1e-9 * abs(least)


@pytest.mark.parametrize("size", [1, 5])
@pytest.mark.parametrize(("sign", "least"), [(1.0, -math.exp(-1.0)), (-1.0, 0.0)])
def test_x_log_x_is_0_at_0(size: int, sign: float, least: float) -> None:
    prog, x = box(size, 0.0, 1.0)
    for own in x:
        add_cost(prog, sign * own * sym.log(own))
    found = certify(prog)
    assert found.gap <= 1e-6
    assert size * least - 1e-5 <= found.lower_bound <= size * least + 1e-15


def test_numbers_that_overflow_bring_no_warning() -> None:
    prog, (x,) = box(1, -np.inf, 2e60)
    add_cost(prog, 1e150 * sym.sqrt(sym.abs(x**3)))
    details = AigoSolver(AigoOptions(certify=True, rounds=2)).Solve(prog).get_solver_details()
    assert details.lower_bound == 0.0
    assert 0.0 <= details.cost < np.inf
    # Sides of cells do, too.
    prog, (x,) = box(1, -1.5e308, 1.5e308)
    add_cost(prog, sym.atan(x) ** 2)
    assert certify(prog, cells=100).lower_bound == 0.0
