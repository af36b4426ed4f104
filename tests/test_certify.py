"""Lower bounds: below every value, near the least one, and above nothing that exact numbers say."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pydrake.symbolic as sym
import pytest
from pydrake.solvers import ExpressionCost, MathematicalProgram

from drake_aigto.certify import Method, certify
from drake_aigto.certify.enclosures import HESSIAN
from drake_aigto.certify.intervals import cosine, exponential, plus, power, sine, times
from drake_aigto.certify.program import formula_of, read_formulas
from drake_aigto.certify.tape import make_tape
from drake_aigto.certify.values import enclose_all
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.jit import kernel
from drake_aigto.solver import AigoOptions, AigoSolver, AigoStatus

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
def _all(a: float, b: float, c: float, d: float, p: int) -> tuple[tuple[float, float], ...]:
    return plus(a, b, c, d), times(a, b, c, d), power(a, b, p)


@kernel
def _waves(a: float, b: float) -> tuple[tuple[float, float], ...]:
    return sine(a, b), cosine(a, b), exponential(a, b)


def test_intervals_hold_the_exact_result_of_their_ends() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        a, b = sorted(rng.normal(size=2) * 10.0 ** rng.integers(-8, 8))
        c, d = sorted(rng.normal(size=2) * 10.0 ** rng.integers(-8, 8))
        p = int(rng.integers(0, 7))
        exact = [
            [Fraction(x) + Fraction(y) for x in (a, b) for y in (c, d)],
            [Fraction(x) * Fraction(y) for x in (a, b) for y in (c, d)],
            [Fraction(x) ** p for x in (a, b)],
        ]
        for (low, high), values in zip(_all(a, b, c, d, p), exact, strict=True):
            assert Fraction(low) <= min(values)
            assert max(values) <= Fraction(high)


def test_waves_hold_the_values_in_between() -> None:
    rng = np.random.default_rng(1)
    for _ in range(200):
        a = rng.uniform(-30.0, 30.0)
        b = a + 10.0 ** rng.uniform(-6.0, 1.0)
        inside = np.linspace(a, b, 50)
        for function, (low, high) in zip((np.sin, np.cos, np.exp), _waves(a, b), strict=True):
            assert low <= np.min(function(inside))
            assert np.max(function(inside)) <= high


FUNCTIONS = (
    lambda x, y: (1.0 - x) ** 2 + 10.0 * (y - x**2) ** 2 + sym.sin(3.0 * x),
    lambda x, y: sym.exp(x) * y + sym.sqrt(x**2 + y**2 + 0.5) - 1.0 / (3.0 + x * y / 2.0),
    lambda x, y: sym.abs(x - 0.3) + sym.max(x, y) - sym.cos(4.0 * x * y),
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
    found = enclose_all(tape, np.zeros(6, dtype=np.int64), low, high, HESSIAN)

    def exact(x: Any, y: Any) -> Any:
        return eval(text, {**HIGH_PRECISION, "x": x, "y": y})

    with mpmath.workdps(40):
        for c in range(6):
            point = [mpmath.mpf(v) for v in rng.uniform(low[c], high[c]).tolist()]
            assert is_within(exact(*point), found.values[c])
            for i, order in enumerate([(1, 0), (0, 1)]):
                assert is_within(mpmath.diff(exact, point, order), found.gradients[c, i])
            for i, order in enumerate([(2, 0), (1, 1), (0, 2)]):
                assert is_within(mpmath.diff(exact, point, order), found.hessians[c, i])


def is_within(value: Any, ends: np.ndarray) -> bool:
    low, high = ends.tolist()
    return bool(low <= value <= high)


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


def test_a_constrained_optimum_is_proven() -> None:
    prog, (x, y) = program(lambda x, y: x**2 * y - x, 2)
    prog.AddConstraint(x**2 + y**2 == 1.0)
    prog.AddConstraint(x * y >= -0.4)
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    angles = np.linspace(0.0, 2.0 * np.pi, 100_001)
    a, b = np.cos(angles), np.sin(angles)
    least = np.min((a**2 * b - a)[a * b >= -0.4])
    assert least - 1e-5 <= details.lower_bound <= least


def test_an_optimum_that_mirrors_itself_on_a_curved_bound_is_proven() -> None:
    """HS 29: at each of four optima, f is bent along the bound, and the multiplier is 1/√2."""
    prog, (x, y, z) = program(lambda x, y, z: -10.0 * x * y * z, 3)
    prog.AddConstraint(x**2 + 2.0 * y**2 + 4.0 * z**2 <= 6.0)
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.lower_bound == pytest.approx(-10.0, abs=1e-4)  # at x = √2, y = 1, z = 1/√2


def test_what_only_rows_vary_along_is_cut_too() -> None:
    """HS 66: the cost has no y."""
    prog = MathematicalProgram()
    x, y, z = prog.NewContinuousVariables(3, "x")
    prog.AddBoundingBoxConstraint(0.0, 10.0, [x, y, z])
    prog.AddCost(0.2 * z - 0.8 * x)
    prog.AddConstraint(y - sym.exp(x) >= 0.0)
    prog.AddConstraint(z - sym.exp(y) >= 0.0)
    details = AigoSolver(CERTIFY).Solve(prog).get_solver_details()
    assert details.status == AigoStatus.PROVEN
    assert details.certificate.cells < 10_000
    assert details.lower_bound == pytest.approx(0.5181632741, abs=1e-6)


def test_that_there_is_no_feasible_point_is_proven() -> None:
    prog, (x, y) = program(lambda x, y: x, 2)
    prog.AddConstraint((x - y) ** 2 + (x * y - 3.0) ** 2 <= -0.01)
    result = AigoSolver(CERTIFY).Solve(prog)
    assert certify(prog).is_infeasible
    assert result.get_solver_details().status == AigoStatus.INFEASIBLE


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


def test_a_cost_of_one_sign_keeps_its_constant_and_its_sign() -> None:
    prog, x = program(lambda x: -(x**2) + 7.0, 1)
    prog.AddLinearCost([0.0], 1.0, x)
    assert certify(prog).lower_bound == pytest.approx(4.0, abs=1e-6)
