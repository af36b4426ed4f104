"""Lower bounds: below every value, near the least one, and above nothing that exact numbers say."""

from __future__ import annotations

import itertools
import math
import operator
import re
import sys
import time
from collections.abc import Callable, Sequence
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import mpmath
import numpy as np
import pydrake.symbolic as sym
import pytest
from pydrake.solvers import ExpressionConstraint, ExpressionCost, MathematicalProgram

from benchmarks.collections.constrained_programs import concave_programs
from benchmarks.random_programs import random_program
from drake_aigto.certify import (
    Method,
    Operation,
    Relaxation,
    Tape,
    certify,
    enclose_all,
    explain_infeasibility,
    formula_of,
    intervals,
    is_infeasible,
    make_tape,
    read_formulas,
    safe_bound,
)
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.kernels import kernel
from drake_aigto.solver import AigoOptions, AigoSolver, AigoStatus

Interval = tuple[float, float]

CERTIFY = AigoOptions(certify=True)


def box(size: int) -> tuple[MathematicalProgram, Any]:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(size, "x")
    prog.AddBoundingBoxConstraint(-2.0, 2.0, x)
    return prog, x


def program(cost: Callable[..., Any], size: int) -> tuple[MathematicalProgram, Any]:
    prog, x = box(size)
    add_cost(prog, cost(*x))
    return prog, x


def add_cost(prog: MathematicalProgram, cost: Any) -> None:
    evaluator = ExpressionCost(sym.Expression(0.0) + cost)
    prog.AddCost(evaluator, vars=evaluator.vars())


def chain(roots: np.ndarray, links: np.ndarray) -> MathematicalProgram:
    prog, x = box(len(roots))
    for i, own in enumerate(roots):
        well = sym.Expression(1.0)
        for root in own:
            well *= x[i] - root
        add_cost(prog, well + (links[i] * x[i] * x[i + 1] if i + 1 < len(roots) else 0.0))
    return prog


@kernel
def _all(x: Interval, y: Interval, p: int) -> tuple[Interval, ...]:
    return intervals.plus(x, y), intervals.times(x, y), intervals.power(x, p)


@kernel
def _waves(x: Interval) -> tuple[Interval, ...]:
    return intervals.sine(x), intervals.cosine(x), intervals.exponential(x)


def test_intervals_hold_the_exact_result_of_their_ends() -> None:
    rng = np.random.default_rng(0)
    for number in range(600):
        # Every other one is so small that products underflow, some with an end at 0.
        least, ends = (-8, rng.normal(size=4)) if number % 2 else (-220, rng.normal(size=4))
        ends[rng.random(4) < 0.2 * (least < -8)] = 0.0
        a, b = sorted(ends[:2] * 10.0 ** rng.integers(least, 8))
        c, d = sorted(ends[2:] * 10.0 ** rng.integers(least, 8))
        p = int(rng.integers(0, 7))
        exact = [
            [Fraction(x) + Fraction(y) for x in (a, b) for y in (c, d)],
            [Fraction(x) * Fraction(y) for x in (a, b) for y in (c, d)],
            [Fraction(x) ** p for x in (a, b)],
        ]
        for (low, high), values in zip(_all((a, b), (c, d), p), exact, strict=True):
            assert Fraction(low) <= min(values)
            assert max(values) <= Fraction(high)


def test_waves_hold_the_values_in_between() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        a = rng.uniform(-30.0, 30.0)
        b = a + 10.0 ** rng.uniform(-6.0, 1.0)
        inside = np.linspace(a, b, 50)
        for function, (low, high) in zip((np.sin, np.cos, np.exp), _waves((a, b)), strict=True):
            assert low <= np.min(function(inside))
            assert np.max(function(inside)) <= high


FUNCTIONS = (
    lambda x, y: (1.0 - x) ** 2 + 10.0 * (y - x**2) ** 2 + sym.sin(3.0 * x),
    lambda x, y: sym.exp(x) * y + sym.sqrt(x**2 + y**2 + 0.5) - 1.0 / (3.0 + x * y / 2.0),
    lambda x, y: sym.abs(x - 0.3) + sym.max(x, y) - sym.cos(4.0 * x * y),
    lambda x, y: sym.pow(3.0 + x, 1.1) * sym.pow(4.0 + y, -0.3) + sym.pow(2.5 + x * y / 4.0, 0.7),
    lambda x, y: sym.log(3.0 + x) * sym.atan(y) + sym.tanh(x * y) + 0.1 * x**4 - 0.3 * x**2,
)


@pytest.mark.parametrize("function", FUNCTIONS)
def test_a_bound_is_at_the_least_of_a_dense_grid(function: Callable[..., Any]) -> None:
    prog, x = program(function, 2)
    found = certify(prog)
    grid = np.linspace(-2.0, 2.0, 81)
    cost = sum(binding.evaluator().expression() for binding in prog.GetAllCosts())
    values = [cost.Evaluate(dict(zip(x, (a, b), strict=True))) for a in grid for b in grid]
    assert found.method == Method.CELLS
    assert found.gap <= 1e-6
    assert found.lower_bound <= min(values)
    assert found.lower_bound >= min(values) - 0.05  # what the grid misses


NAMES = ("sin", "cos", "tanh", "exp", "log", "sqrt", "atan")
HIGH_PRECISION = {name: getattr(mpmath, name) for name in NAMES}
HIGH_PRECISION |= {"abs": abs, "max": max, "min": min, "pow": operator.pow}


@pytest.mark.parametrize("function", FUNCTIONS)
def test_enclosures_hold_derivatives_in_high_precision(function: Callable[..., Any]) -> None:
    prog, _ = program(function, 2)
    names = [sym.Variable(name) for name in "xy"]
    text = str(function(*names))
    formulas = read_formulas(prog)
    tape = make_tape([formula_of(formulas.summands, (0, 1))])
    rng = np.random.default_rng(4)
    low = rng.uniform(-1.5, 1.0, (6, 2))
    high = low + 10.0 ** rng.uniform(-9.0, -0.5, (6, 2))
    jets = enclose_all(tape, np.zeros(6, dtype=np.int64), low, high, order=2)

    def exact(x: Any, y: Any) -> Any:
        return eval(text, {**HIGH_PRECISION, "x": x, "y": y})

    with mpmath.workdps(40):
        for c in range(6):
            point = [mpmath.mpf(v) for v in rng.uniform(low[c], high[c]).tolist()]
            assert is_within(exact(*point), jets[c, 0])
            for i, order in enumerate([(1, 0), (0, 1), (2, 0), (1, 1), (0, 2)]):
                assert is_within(mpmath.diff(exact, point, order), jets[c, 1 + i])


def is_within(value: Any, ends: np.ndarray) -> bool:
    low, high = ends.tolist()
    return bool(low <= value <= high)


UNARY: tuple[Callable[..., Any], ...] = (
    lambda m, a: m.sin(a),
    lambda m, a: m.cos(2.0 * a),
    lambda m, a: m.tanh(a),
    lambda m, a: m.atan(a),
    lambda m, a: m.exp(m.sin(a)),
    lambda m, a: m.log(1.0 + a * a),
    lambda m, a: m.pow(2.0 + m.cos(a), 1.3),
    lambda m, a: m.sqrt(0.5 + a**2),
    lambda m, a: m.pow(m.abs(a), 1.5),
    lambda m, a: m.sqrt(m.abs(a)),
    lambda m, a: m.abs(a),
    lambda m, a: a**2 - 0.5 * a,
    lambda m, a: a**3,
    lambda m, a: 1.0 / (1.5 + m.sin(a)),
)
BINARY: tuple[Callable[..., Any], ...] = (
    lambda m, a, b: a + b,
    lambda m, a, b: a - 3.0 * b,
    lambda m, a, b: a * b,
    lambda m, a, b: m.max(a, b),
    lambda m, a, b: m.min(a, b),
    lambda m, a, b: a / (1.0 + b * b),
)


def random_function(rng: np.random.Generator, size: int, depth: int) -> Callable[..., Any]:
    """Returns a function of a namespace of functions, and of numbers or Expressions."""
    if depth == 0:
        i, scale = int(rng.integers(size)), float(rng.choice([1.0, -2.0, 0.3]))
        return lambda m, x: scale * x[i]
    first, last = (random_function(rng, size, depth - 1) for _ in range(2))
    if rng.random() < 0.5:
        one = UNARY[int(rng.integers(len(UNARY)))]
        return lambda m, x: one(m, first(m, x))
    both = BINARY[int(rng.integers(len(BINARY)))]
    return lambda m, x: both(m, first(m, x), last(m, x))


ONE = {
    "square": lambda m, x: x**2,
    "cube": lambda m, x: x**3,
    "seventh power": lambda m, x: x**7,
    "quotient": lambda m, x: 1 / x,
    "root": lambda m, x: m.sqrt(x),
    "power 1.5": lambda m, x: m.pow(x, 1.5),
    "power -0.3": lambda m, x: m.pow(x, -0.3),
    "exp": lambda m, x: m.exp(x),
    "log": lambda m, x: m.log(x),
    "sin": lambda m, x: m.sin(x),
    "cos": lambda m, x: m.cos(x),
    "tanh": lambda m, x: m.tanh(x),
    "atan": lambda m, x: m.atan(x),
}


def check_enclosures(function: Callable[..., Any], count: int) -> None:
    """Checks value and derivatives over cells of widths from nothing to the size of x."""
    rng, exact = np.random.default_rng(11), SimpleNamespace(**HIGH_PRECISION)
    x = sym.Variable("x")
    prog = MathematicalProgram()
    prog.AddDecisionVariables(np.array([x]))
    add_cost(prog, function(sym, x))
    tape = make_tape([formula_of(read_formulas(prog).summands, (0,))])
    size = 10.0 ** rng.uniform(-9.0, 2.0, count)
    low, high = size, size * (1.0 + rng.choice([0.0, 1e-15, 1e-9, 1e-3, 1.0], count))
    cells = low[:, None], high[:, None]
    jets = enclose_all(tape, np.zeros(count, dtype=np.int64), *cells, order=2)
    with mpmath.workdps(60):
        for own, *ends in zip(jets, low, high, strict=True):
            at = mpmath.mpf(float(rng.uniform(*ends)))
            for order in range(3):
                value = mpmath.diff(lambda x: function(exact, x), at, order, h=at * 1e-15)
                assert own[order, 0] <= value <= own[order, 1]


@pytest.mark.parametrize("name", ONE)
def test_a_function_of_one_variable_is_enclosed(name: str) -> None:
    check_enclosures(ONE[name], 60)


@pytest.mark.slow
@pytest.mark.parametrize("name", ONE)
def test_a_function_of_one_variable_is_enclosed_at_thousands_of_points(name: str) -> None:
    check_enclosures(ONE[name], 4000)


@pytest.mark.parametrize("seed", range(4))
def test_a_feasible_point_is_never_excluded(seed: int) -> None:
    check_feasible_points(np.random.default_rng([7, seed]), 40)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_a_feasible_point_is_never_excluded_in_10000_programs(seed: int) -> None:
    check_feasible_points(np.random.default_rng([9, seed]), 1000)


def check_feasible_points(rng: np.random.Generator, count: int) -> None:
    """Rows and bounds that a point meets just about, fixed variables and rows twice among them."""
    exact = SimpleNamespace(**HIGH_PRECISION)
    for trial in range(count):
        size = int(rng.integers(1, 7))
        scales = [-150.0, -8.0, 0.0, 0.0, 0.0, 0.0, 4.0, 60.0]
        point = rng.normal(size=size) * 10.0 ** rng.choice(scales)
        point[rng.random(size) < 0.1] = 0.0  # edges of domains
        reach = np.abs(point) * rng.choice([0.0, 1e-9, 1.0, 30.0], (2, size))
        reach[rng.random((2, size)) < 0.1] = np.inf
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(size, "x")
        prog.AddBoundingBoxConstraint(point - reach[0], point + reach[1], x)
        cost = random_function(rng, size, 3)
        add_cost(prog, cost(sym, x) + 0.1 * x[0])
        for _ in range(int(rng.integers(0, 4))):
            row = random_function(rng, size, 3)
            with mpmath.workdps(40):
                value = float(row(exact, list(map(mpmath.mpf, point.tolist()))))
            if not math.isfinite(value):
                continue
            slack = 1e-12 * (1e-3 + abs(value))
            ends = [
                [value - slack, value + slack],
                [value - slack, np.inf],
                [-np.inf, value + slack],
            ]
            for _ in range(int(rng.integers(1, 3))):
                low, high = ends[int(rng.integers(3))]
                written = sym.Expression(0.0) + row(sym, x)
                if not written.GetVariables():  # Terms cancel; Drake takes no such constraint.
                    continue
                constraint = ExpressionConstraint([written], [low], [high])
                prog.AddConstraint(constraint, vars=constraint.vars())
        with mpmath.workdps(40):
            numbers = list(map(mpmath.mpf, point.tolist()))
            least = float(cost(exact, numbers) + 0.1 * numbers[0])
        cells = int(10.0 ** rng.uniform(0.0, 2.8))
        found = certify(prog, point if trial % 2 else None, cells=cells)
        assert not found.is_infeasible
        slack = 1e-12 * (1e-3 + abs(least)) if math.isfinite(least) else 0.0
        assert found.lower_bound <= least + slack


def test_no_bound_of_a_random_program_is_above_the_best_value() -> None:
    rng = np.random.default_rng(2)
    for trial in range(60):
        size = int(rng.integers(1, 7))
        roots, links = rng.uniform(-2.0, 2.0, (size, 4)), rng.normal(size=size)
        prog = chain(roots, links)
        if trial % 3 == 0 and size > 1:
            x = prog.decision_variables()
            prog.AddConstraint(x[0] * x[1] + x[0] ** 2 <= rng.normal())
        found = certify(prog, cells=int(rng.integers(1, 500)))
        points = rng.uniform(-2.0, 2.0, (300, size))
        values = np.prod(points[:, :, None] - roots, axis=-1).sum(axis=1)
        values += (links[:-1] * points[:, :-1] * points[:, 1:]).sum(axis=1)
        feasible = [prog.CheckSatisfied(prog.GetAllConstraints(), p, 0.0) for p in points]
        assert found.lower_bound <= np.min(values[feasible], initial=math.inf)
        assert found.lower_bound <= found.best_cost


def test_a_chain_is_proven_as_its_last_cell_is_convex() -> None:
    rng = np.random.default_rng(3)
    centers = np.linspace(-1.8, 1.8, 4)
    prog = chain(centers + rng.uniform(-0.3, 0.3, (40, 4)), rng.uniform(-0.3, 0.3, 40))
    result = AigoSolver(CERTIFY).Solve(prog)
    details = result.get_solver_details()
    assert details.certificate.method == Method.CLIQUES
    assert details.status == AigoStatus.PROVEN
    assert details.gap <= 1e-9
    assert result.get_optimal_cost() <= AigoSolver().Solve(prog).get_optimal_cost() + 1e-9


@pytest.mark.parametrize("lower", [(-3.0, -1.0), (-0.7, -4.0)])
def test_no_bound_is_above_the_best_value_where_a_cost_has_no_value(lower: Any) -> None:
    """Where a root has no value in a part of a cell, slopes prove nothing about that cell."""
    prog = MathematicalProgram()
    x, y = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint(lower, [2.0, 2.0], [x, y])
    add_cost(prog, sym.pow(x - 0.1, 1.5) + 0.3 * x + 0.2 * y**2 - sym.pow(y, 2.5))
    least = 0.03 + 0.2 * 4.0 - 2.0**2.5  # x = 0.1, y = 2
    for cells in (10, 100, 1000):
        assert certify(prog, cells=cells).lower_bound <= least + 1e-12
    assert certify(prog).lower_bound == pytest.approx(least, abs=1e-3)


def on_a_circle() -> tuple[MathematicalProgram, float]:
    prog, (x, y) = program(lambda x, y: x**2 * y - x, 2)
    prog.AddConstraint(x**2 + y**2 == 1.0)
    prog.AddConstraint(x * y >= -0.4)
    angles = np.linspace(0.0, 2.0 * np.pi, 100_001)
    a, b = np.cos(angles), np.sin(angles)
    return prog, float(np.min((a**2 * b - a)[a * b >= -0.4]))


def hs29() -> tuple[MathematicalProgram, float]:
    """f is bent along the bound at each of four optima, where the multiplier is 1/√2."""
    prog, (x, y, z) = program(lambda x, y, z: -10.0 * x * y * z, 3)
    prog.AddConstraint(x**2 + 2.0 * y**2 + 4.0 * z**2 <= 6.0)
    return prog, -10.0  # at x = √2, y = 1, z = 1/√2


def hs66() -> tuple[MathematicalProgram, float]:
    """Only rows vary along y."""
    prog = MathematicalProgram()
    x, y, z = prog.NewContinuousVariables(3, "x")
    prog.AddBoundingBoxConstraint(0.0, 10.0, [x, y, z])
    prog.AddCost(0.2 * z - 0.8 * x)
    prog.AddConstraint(y - sym.exp(x) >= 0.0)
    prog.AddConstraint(z - sym.exp(y) >= 0.0)
    return prog, 0.5181632742  # rounded up


@pytest.mark.parametrize(("make", "below"), [(on_a_circle, 1e-5), (hs29, 1e-4), (hs66, 1e-6)])
def test_a_constrained_optimum_is_proven(make: Callable[[], Any], below: float) -> None:
    prog, least = make()
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.certificate.cells < 10_000
    assert least - below <= details.lower_bound <= least


def test_that_there_is_no_feasible_point_is_proven() -> None:
    prog, (x, y) = program(lambda x, y: x, 2)
    prog.AddConstraint((x - y) ** 2 + (x * y - 3.0) ** 2 <= -0.01)
    result = AigoSolver(CERTIFY).Solve(prog)
    assert certify(prog).is_infeasible
    assert result.get_solver_details().status == AigoStatus.INFEASIBLE


def test_what_rounding_may_leave_is_not_called_infeasible() -> None:
    """A row that holds at x = 0.3 alone, as 3 · 0.1 is rounded, and one that holds nowhere."""
    prog, (x,) = program(lambda x: x, 1)
    prog.AddConstraint((x - 0.1) ** 2 <= (0.3 - 0.1) ** 2)
    prog.AddConstraint((x - 0.5) ** 2 <= (0.3 - 0.5) ** 2)
    assert not is_infeasible(prog)
    prog.AddConstraint(sym.exp(x) >= 1.36)
    assert is_infeasible(prog)


def test_a_bound_that_is_missing_is_derived_or_named() -> None:
    prog = MathematicalProgram()
    (x,) = prog.NewContinuousVariables(1, "speed")
    add_cost(prog, x**4 - 3.0 * x**2 + x)
    assert certify(prog).gap <= 1e-6
    add_cost(prog, -(x**6))
    found = certify(prog, cells=200)
    assert found.lower_bound == -math.inf
    assert "speed(0) has no lower bound" in found.reason


def test_a_function_without_an_enclosure_is_refused_by_name() -> None:
    prog, _ = program(lambda x: sym.sinh(x), 1)
    with pytest.raises(UnsupportedTermError, match="got Sinh in sinh"):
        certify(prog)


def linked(own: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *x: sum(map(own, x)) + sum(a * b for a, b in itertools.pairwise(x))


@pytest.mark.parametrize(
    ("cost", "lower", "upper", "least"),
    [
        (lambda x: x**2, 2.0, 2.0, 4.0),  # fixed
        (lambda x: x + 1e-300 * x**2, 3.0, 3.0, 3.0),
        (linked(lambda x: x * sym.log(x)), [1e-9] * 5, 1.0, math.inf),
        (
            linked(lambda x: 1.0 / (2.0 + sym.sin(x) + sym.cos(x)) - 0.01 * x),
            [-50.0] * 5,
            50.0,
            0.0,
        ),
        (linked(lambda x: sym.exp(2.0 * x) - sym.exp(x) + x**2), [-800.0] * 5, 800.0, 0.0),
        (linked(lambda x: x**30), [-1e12] * 5, 1e12, 0.0),
        (lambda x, y: x + sym.pow(x + y, 1.5), [-1.0, -1.0], [1.0, 0.5], -0.5),
        (lambda x, y: 3.0 * x + sym.pow(x + y / 3.0, 2.5), [-1.0, -1.0], [1.0, 0.7], -0.7),
        (lambda x, y: 1e-250 * x**2 * y**2, [1e80, 1e80], 1e81, 1e70),
        (lambda x: (1e-162 * (x - 0.5)) ** 2, -1.0, 1.0, 0.0),
        (lambda x: 1e-300 * sym.exp(800.0 * x), 0.5, 1.0, 1e-126),
    ],
)
def test_edges_of_numbers_and_of_domains_bring_no_false_claim(
    cost: Callable[..., Any], lower: Any, upper: Any, least: float
) -> None:
    """Costs with a value, none lower than the least, where numbers or formulas end."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(np.size(lower), "x")
    prog.AddBoundingBoxConstraint(lower * np.ones(x.size), upper * np.ones(x.size), x)
    add_cost(prog, cost(*x))
    for cells in (1, 10, 300):
        found = certify(prog, cells=cells)
        assert not found.is_infeasible
        assert found.lower_bound <= least + 1e-9 * abs(least)


def test_a_row_that_overflows_is_not_infeasible() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(2, "x")
    prog.AddBoundingBoxConstraint(1e80, 1e81, x)
    prog.AddCost(x[0])
    prog.AddConstraint(1e-250 * x[0] ** 2 * x[1] ** 2 <= 1e71)
    assert certify(prog, cells=300).lower_bound <= 1e80


def test_a_row_whose_products_underflow_is_not_infeasible() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    small, tiny = -8.437660688527946e-86, -3.8056667485585995e-75
    prog.AddBoundingBoxConstraint([1.7388e-08, small, tiny], [1.7406e-08, 8.4e-83, tiny], x)
    row, at = -7.8e22 * x[0] * x[1] ** 2 - 4.6e-73 * x[1] ** 2 * x[2] ** 3, 1.74e-08
    value = -7.8e22 * at * small**2  # The other product is smaller by 200 orders of magnitude.
    prog.AddConstraint(row, (1 + 1e-13) * value, (1 - 1e-13) * value)
    prog.AddCost(x[0])
    assert not is_infeasible(prog)
    assert certify(prog, cells=300).lower_bound <= at


def test_a_variable_that_a_row_fixes_does_not_end_the_search() -> None:
    prog, x = program(lambda x, y, z: (x - y) ** 2 + sym.sin(3.0 * y) + y * z**2, 3)
    prog.AddConstraint(x[0] == 1.0 / 3.0)
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.certificate.cells < 1000


def test_a_cost_that_falls_without_end_raises_nothing() -> None:
    prog = random_program(np.random.default_rng([0, 120]))
    result = AigoSolver(AigoOptions(certify=True, cells=2000, rounds=4, seed=3)).Solve(prog)
    assert result.get_solver_details().lower_bound == -math.inf


def test_a_cost_of_one_sign_keeps_its_constant_and_its_sign() -> None:
    prog, x = program(lambda x: -(x**2) + 7.0, 1)
    prog.AddLinearCost([0.0], 1.0, x)
    assert certify(prog).lower_bound == pytest.approx(4.0, abs=1e-6)


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
    assert found.gap <= 1e-6
    assert found.lower_bound <= problem.minimum


MPMATH: dict[Operation, Callable[..., Any]] = {
    Operation.SHIFT: lambda a, b, p, v: v[a] + p,
    Operation.SCALE: lambda a, b, p, v: p * v[a],
    Operation.ADD: lambda a, b, p, v: v[a] + v[b],
    Operation.MULTIPLY: lambda a, b, p, v: v[a] * v[b],
    Operation.RECIPROCAL: lambda a, b, p, v: 1 / v[a],
    Operation.POWER: lambda a, b, p, v: v[a] ** int(b),
    Operation.REAL_POWER: lambda a, b, p, v: v[a] ** p,
    Operation.MAX: lambda a, b, p, v: max(v[a], v[b]),
    Operation.MIN: lambda a, b, p, v: min(v[a], v[b]),
    Operation.ABS: lambda a, b, p, v: abs(v[a]),
    Operation.ATAN: lambda a, b, p, v: mpmath.atan(v[a]),
}


def values_of(tape: Tape, x: Sequence[Any]) -> list[Any]:
    """Returns the values of a tape's entries at a point."""
    values: list[Any] = []
    for number, a, b, p in zip(*tape[:4], strict=True):
        operation = Operation(number)
        if operation == Operation.NUMBER:
            values.append(mpmath.mpf(float(p)))
        elif operation == Operation.VARIABLE:
            values.append(x[a])
        elif operation in MPMATH:
            values.append(MPMATH[operation](a, b, mpmath.mpf(float(p)), values))
        else:
            values.append(HIGH_PRECISION[operation.name.lower()](values[a]))
    return values


@pytest.mark.parametrize("seed", range(3))
def test_relaxations_hold_at_all_points_of_a_cell_in_high_precision(seed: int) -> None:
    rng = np.random.default_rng([8, seed])
    for _ in range(15):
        size = int(rng.integers(1, 5))
        prog, x = coupled(size)
        for k in range(3):
            formula = sym.Expression(0.1) * x[0] + random_function(rng, size, 3)(sym, x)
            if k == 0:
                add_cost(prog, formula)
            else:
                row = ExpressionConstraint([formula], [-np.inf], [1e9])
                prog.AddConstraint(row, vars=row.vars())
        relaxation = Relaxation(read_formulas(prog))
        low = rng.uniform(-1.0, 1.0, size)
        ends = low, low + 10.0 ** rng.uniform(-6.0, 0.0, size)
        narrowed = [end.copy() for end in ends]
        bound = relaxation.bound(narrowed[0], narrowed[1], np.inf).bound
        (structure, cell), w = relaxation.linear_program, []
        with mpmath.workdps(40):
            for _ in range(5):
                point = [mpmath.mpf(v) for v in rng.uniform(*ends).tolist()]
                values = values_of(structure.joint.tape, point)
                w = [values[entry] for entry in structure.entries]
                assert values[structure.joint.roots[0]] >= bound
                for column, value in enumerate(w):
                    assert is_within(value, cell.box[:, column])
                for row in range(cell.lower.size):
                    terms = range(structure.starts[row], structure.starts[row + 1])
                    total = sum(w[structure.columns[k]] * float(cell.values[k]) for k in terms)
                    assert is_within(total, np.array([cell.lower[row], cell.upper[row]]))


def test_however_bad_the_multipliers_are_the_bound_holds() -> None:
    rng = np.random.default_rng(6)
    prog, x = coupled(3)
    add_cost(prog, quadratic(rng.normal(size=(3, 3)), x) + sym.exp(x[0] * x[1]))
    prog.AddConstraint(quadratic(rng.normal(size=(3, 3)), x) <= 1.0)
    relaxation = Relaxation(read_formulas(prog))
    relaxation.bound(np.full(3, -1.0), np.full(3, 2.0), np.inf)
    structure, cell = relaxation.linear_program
    points = rng.uniform(-1.0, 2.0, (3000, 3))
    feasible = [p for p in points if prog.CheckSatisfied(prog.GetAllConstraints(), p, 0.0)]
    (cost,) = prog.GetAllCosts()
    least = min(prog.EvalBinding(cost, p)[0] for p in feasible)
    residuals = np.empty_like(structure.cost)
    for _ in range(50):
        y = rng.normal(size=cell.lower.size) * 10.0 ** rng.uniform(-3.0, 3.0)
        assert (
            safe_bound(structure, cell, structure.cost, structure.constant, y, residuals) <= least
        )


def test_that_coupled_rows_contradict_each_other_is_proven() -> None:
    """Σ_{i<j} x_i x_j ≥ −½ Σ x_i² is −2.5 at least where |x| ≤ 1."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(5, "x")
    prog.AddBoundingBoxConstraint(-1.0, 1.0, x)
    pairs = sum(a * b for a, b in itertools.combinations(x, 2))
    prog.AddCost(pairs)
    prog.AddConstraint(pairs <= -1.9)
    assert not certify(prog, cells=500).is_infeasible
    prog.AddConstraint(pairs <= -2.6)
    assert certify(prog).is_infeasible


def long_proof() -> MathematicalProgram:
    """Returns a program of many cells: all of seven waves are coupled."""
    prog, x = coupled(7)
    add_cost(prog, sum(sym.sin(5.0 * a * b + a) for a, b in itertools.combinations(x, 2)))
    return prog


def test_seconds_end_a_proof_and_progress_is_told() -> None:
    lines: list[str] = []
    start = time.monotonic()
    found = certify(long_proof(), seconds=2.5, progress=lines.append)
    assert time.monotonic() - start < 10.0
    assert "depends on the clock" in found.reason
    assert math.isfinite(found.lower_bound)
    assert lines[0].startswith("bound ")


def test_an_interruption_keeps_the_bound_so_far() -> None:
    prog = long_proof()
    known = certify(prog, cells=100).lower_bound

    def interrupt(_: str) -> None:
        raise KeyboardInterrupt

    found = certify(prog, progress=interrupt)
    assert found.reason == "interrupted: this is the bound so far"
    assert known <= found.lower_bound < math.inf


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"seconds": 0.0}, "seconds: got 0.0, expected a number above 0"),
        ({"seconds": math.nan}, "seconds: got nan, expected a number above 0"),
        ({"cells": 0}, "cells: got 0, expected a number above 0"),
        ({"prover": "gurobi"}, "prover: got 'gurobi', expected one of own, scip"),
    ],
)
def test_a_bad_limit_is_refused(wrong: dict[str, Any], message: str) -> None:
    prog, _ = program(lambda x: x, 1)
    with pytest.raises(OptionsError, match=re.escape(message)):
        certify(prog, **wrong)


def test_scip_proves_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    prog, least = on_a_circle()
    pytest.importorskip("pyscipopt")
    found = certify(prog, prover="scip")
    assert found.method == Method.SCIP
    assert found.best_cost == pytest.approx(least, abs=1e-5)
    assert found.lower_bound == pytest.approx(least, abs=1e-5)
    monkeypatch.setitem(sys.modules, "pyscipopt", None)
    with pytest.raises(OptionsError, match=re.escape("pip install 'drake_aigto[scip]'")):
        certify(prog, prover="scip")


def test_few_rows_that_contradict_each_other_are_told_with_numbers() -> None:
    prog, (x, y, z) = program(lambda x, y, z: x + y + z, 3)
    prog.AddConstraint(x * y + z <= 5.0)
    prog.AddConstraint(x >= 1.0 + 0.1 * y)
    wrong = [prog.AddConstraint(x**2 + y**2 <= 1.0), prog.AddConstraint(x + 0.5 * y >= 1.7)]
    prog.AddConstraint(sym.exp(z) >= 0.2)
    wrong[0].evaluator().set_description("disc")
    wrong[1].evaluator().set_description("beyond")
    text = explain_infeasibility(prog)
    assert len(text.splitlines()) == 2
    assert "'disc'" in text and "'beyond'" in text
    assert "has to be in [-inf, -1.7], and is in [-1.5, 1.5] where the others hold" in text
    details = AigoSolver(AigoOptions(rounds=2, starts=2)).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.INFEASIBLE
    assert text in str(details)
    prog.RemoveConstraint(wrong[1])
    assert not explain_infeasibility(prog)


def test_bounds_that_cross_are_told() -> None:
    prog = MathematicalProgram()
    (x,) = prog.NewContinuousVariables(1, "x")
    prog.AddConstraint(x >= 2.0)
    prog.AddConstraint(x <= 1.0)
    assert explain_infeasibility(prog) == "x(0) has to be at least 2, and at most 1"
