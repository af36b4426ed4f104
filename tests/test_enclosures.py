"""Enclosures, relaxations and bounds hold what exact numbers and high precision say."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import mpmath
import numpy as np
import pydrake.symbolic as sym
import pytest
from marks import slow
from pydrake.solvers import ExpressionConstraint, MathematicalProgram
from random_functions import (
    FUNCTIONS,
    HIGH_PRECISION,
    add_cost,
    box,
    program,
    random_edge,
    random_function,
)

from drake_aigto.certify import (
    Operation,
    Relaxation,
    Tape,
    certify,
    enclose_all,
    formula_of,
    intervals,
    make_tape,
    read_formulas,
    safe_bound,
)
from drake_aigto.kernels import kernel

Interval = tuple[float, float]


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


ONE: dict[str, Callable[..., Any]] = {
    "square": lambda m, x: x**2,
    "cube": lambda m, x: x**3,
    "seventh power": lambda m, x: x**7,
    "quotient": lambda m, x: 1 / x,
    "root": lambda m, x: m.sqrt(x),
    "power 1.5": lambda m, x: m.pow(x, 1.5),
    "power -0.3": lambda m, x: m.pow(x, -0.3),
    "exp": lambda m, x: m.exp(x),
    "log": lambda m, x: m.log(x),
    "x log x": lambda m, x: x * m.log(x),
    "sin": lambda m, x: m.sin(x),
    "cos": lambda m, x: m.cos(x),
    "tanh": lambda m, x: m.tanh(x),
    "atan": lambda m, x: m.atan(x),
}


@pytest.mark.parametrize("count", [60, *slow(4000)])
@pytest.mark.parametrize("name", ONE)
def test_a_function_of_one_variable_is_enclosed(name: str, count: int) -> None:
    """Value and derivatives hold over cells of widths from nothing to the size of x."""
    function = ONE[name]
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


MPMATH: dict[Operation, Callable[..., Any]] = {
    Operation.SHIFT: lambda a, b, p, v: v[a] + p,
    Operation.SCALE: lambda a, b, p, v: p * v[a],
    Operation.ADD: lambda a, b, p, v: v[a] + v[b],
    Operation.MULTIPLY: lambda a, b, p, v: v[a] * v[b],
    Operation.RECIPROCAL: lambda a, b, p, v: 1 / v[a],
    Operation.POWER: lambda a, b, p, v: v[a] ** int(b),
    Operation.REAL_POWER: lambda a, b, p, v: v[a] ** p,
    Operation.MAX: lambda a, b, p, v: max(v[a], v[b]),
    Operation.ABS: lambda a, b, p, v: abs(v[a]),
    Operation.ATAN: lambda a, b, p, v: mpmath.atan(v[a]),
    Operation.X_LOG: lambda a, b, p, v: v[a] * mpmath.log(v[a]),
}


def values_of(tape: Tape, x: Sequence[Any]) -> list[Any]:
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


@pytest.mark.parametrize("seed", [0, *slow(1)])
def test_relaxations_hold_at_all_points_of_a_cell_in_high_precision(seed: int) -> None:
    rng = np.random.default_rng([8, seed])
    for _ in range(6):
        size = int(rng.integers(1, 5))
        prog, x = box(size, -1.0, 2.0)
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
        bound = relaxation.bound(narrowed[0], narrowed[1], np.inf)[0]
        structure, cell = relaxation.structure, relaxation.cell
        with mpmath.workdps(40):
            for _ in range(5):
                point = [mpmath.mpf(v) for v in rng.uniform(*ends).tolist()]
                values = values_of(structure.joint.tape, point)
                assert values[structure.joint.roots[0]] >= bound
                for column, value in enumerate(values):
                    assert is_within(value, cell.box[:, column])
                for row in range(cell.lower.size):
                    terms = range(structure.starts[row], structure.starts[row + 1])
                    parts = [values[structure.columns[k]] * float(cell.values[k]) for k in terms]
                    total, rounding = sum(parts), 1e-35 * sum(map(abs, parts))  # of 40 digits
                    assert total + rounding >= cell.lower[row]
                    assert total - rounding <= cell.upper[row]


@pytest.mark.parametrize("reach", [1.0, np.inf])
def test_a_cell_keeps_its_points_that_cost_no_more_than_the_cutoff(reach: float) -> None:
    rng, exact = np.random.default_rng(12), SimpleNamespace(**HIGH_PRECISION)
    for _ in range(20):
        size = int(rng.integers(2, 4))
        point = rng.normal(size=size)
        reaches = np.where(rng.random((2, size)) < 0.5, reach, 1e-3)
        ends = point - reaches[0], point + reaches[1]
        prog, x = box(size, *ends)
        cost, row = (random_function(rng, size, 3) for _ in range(2))
        add_cost(prog, cost(sym, x) + 0.1 * x[0])
        written = ExpressionConstraint([row(sym, x) + 0.1 * x[1]], [-np.inf], [1e9])
        prog.AddConstraint(written, vars=written.vars())
        cutoff = float(cost(exact, point.tolist()) + 0.1 * point[0])
        low, high = (end.copy() for end in ends)
        Relaxation(read_formulas(prog)).bound(low, high, cutoff + 1e-12 * (1.0 + abs(cutoff)))
        assert np.all((low <= point) & (point <= high))


@pytest.mark.parametrize("p", [0.5, 0.3, 1.5, -0.3])
def test_relaxations_hold_where_a_power_begins(p: float) -> None:
    """At 0 a root has no slope, and a tangent there says nothing."""
    prog, (x,) = box(1, 0.0, 1.0)
    add_cost(prog, x)
    row = ExpressionConstraint([sym.pow(x, p)], [-np.inf], [np.inf])
    prog.AddConstraint(row, vars=row.vars())
    relaxation = Relaxation(read_formulas(prog))
    relaxation.bound(np.zeros(1), np.ones(1), np.inf)
    structure, cell = relaxation.structure, relaxation.cell
    for w in ((at, at**p) for at in (1e-12, 1e-3, 0.5, 1.0)):
        for row, (first, last) in enumerate(itertools.pairwise(structure.starts)):
            total = cell.values[first:last] @ np.array(w)[structure.columns[first:last]]
            slack = 1e-14 * (1.0 + abs(total))
            assert cell.lower[row] - slack <= total <= cell.upper[row] + slack


def test_however_bad_the_multipliers_are_the_bound_holds() -> None:
    rng = np.random.default_rng(6)
    prog, x = box(3, -1.0, 2.0)

    def quadratic() -> Any:
        return sum(c * x[i] * x[j] for (i, j), c in np.ndenumerate(rng.normal(size=(3, 3))))

    add_cost(prog, quadratic() + sym.exp(x[0] * x[1]))
    prog.AddConstraint(quadratic() <= 1.0)
    relaxation = Relaxation(read_formulas(prog))
    relaxation.bound(np.full(3, -1.0), np.full(3, 2.0), np.inf)
    structure, cell = relaxation.structure, relaxation.cell
    points = rng.uniform(-1.0, 2.0, (3000, 3))
    feasible = [p for p in points if prog.CheckSatisfied(prog.GetAllConstraints(), p, 0.0)]
    (cost,) = prog.GetAllCosts()
    least = min(prog.EvalBinding(cost, p)[0] for p in feasible)
    root = structure.joint.roots[0]
    for _ in range(50):
        y = rng.normal(size=cell.lower.size) * 10.0 ** rng.uniform(-3.0, 3.0)
        assert safe_bound(structure, cell, (root, 1.0), y) <= least


@pytest.mark.parametrize(
    ("seed", "count"), [([7, 0], 15), *slow(*(([9, number], 1000) for number in range(10)))]
)
def test_a_feasible_point_is_never_excluded(seed: list[int], count: int) -> None:
    """Rows and bounds that a point meets just about, fixed variables and rows twice among them.

    Functions end there, variables are pinned, and costs have scales of 1e±150.
    """
    rng = np.random.default_rng(seed)
    exact = SimpleNamespace(**HIGH_PRECISION)

    def value_at(function: Callable[..., Any], numbers: Sequence[Any]) -> float:
        with mpmath.workdps(40):
            try:
                value = float(function(exact, numbers))
            except (ZeroDivisionError, TypeError):  # A complex number is no value.
                return math.inf
        return math.inf if math.isnan(value) else value

    def draw() -> Callable[..., Any]:
        kind, i = rng.random(), int(rng.integers(size))
        if kind < 0.1:
            return lambda m, x: 1.0 * x[i]
        return random_edge(rng, point) if kind < 0.3 else random_function(rng, size, 3)

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
        numbers = list(map(mpmath.mpf, point.tolist()))
        cost, scale = draw(), float(10.0 ** rng.choice([0.0, 0.0, 0.0, -150.0, 100.0]))
        add_cost(prog, scale * (cost(sym, x) + 0.1 * x[0]))
        for _ in range(int(rng.integers(0, 4))):
            row = draw()
            value = value_at(row, numbers)
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
        least = scale * (value_at(cost, numbers) + 0.1 * float(point[0]))
        cells = int(10.0 ** rng.uniform(0.0, 2.8))
        found = certify(prog, point if trial % 2 else None, cells=cells)
        assert not found.is_infeasible or least == math.inf  # The cost has no value there.
        slack = 1e-12 * (1e-3 * scale + abs(least)) if math.isfinite(least) else 0.0
        assert found.lower_bound <= least + slack
