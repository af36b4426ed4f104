"""Costs of a MathematicalProgram: their means over boxes are integrals, whatever their type."""

from __future__ import annotations

import gc
import math

import numpy as np
import pytest
from box_programs import ExpressionOf, add, compile_program, compiled, exact_mean, program
from hypothesis import given
from hypothesis import strategies as st
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression, Polynomial, Variable, log, pow, sin
from pydrake.symbolic import max as smax

from drake_aigto.errors import UnsupportedTermError
from drake_aigto.terms import FunctionKind


def total_cost(prog: MathematicalProgram, x: np.ndarray) -> float:
    return sum(float(prog.EvalBinding(cost, x)[0]) for cost in prog.GetAllCosts())


@st.composite
def polynomials(draw: st.DrawFn) -> ExpressionOf:
    """Random polynomials of three variables: x⁷/8 and a sum of products of affine functions."""
    numbers = st.integers(-8, 8).map(lambda i: i / 4)
    rows = st.lists(numbers, min_size=4, max_size=4)
    products = draw(st.lists(st.lists(rows, min_size=1, max_size=3), min_size=1, max_size=3))
    exponent = draw(st.integers(1, 2))

    def expression_of(x: np.ndarray) -> Expression:
        total = x[0] ** 7 / 8  # of a degree that the products don't reach: never a constant
        for product in products:
            term = Expression(1.0)
            for a, b, c, d in product:
                term *= pow(a * x[0] + b * x[1] + c * x[2] + d, exponent)
            total += term
        return total

    return expression_of


@given(
    polynomials(),
    st.lists(st.floats(-2.0, 5.0), min_size=3, max_size=3),
    st.lists(st.floats(0.25, 2.0), min_size=3, max_size=3),
)
def test_mean_is_drakes_integral_over_the_volume(
    expression_of: ExpressionOf, center: list[float], half_width: list[float]
) -> None:
    prog, x = program()
    expression = expression_of(x)
    add(prog, expression)
    f = compile_program(prog)
    integral = Polynomial(expression)
    for variable, c, w in zip(x, center, half_width, strict=True):
        integral = integral.Integrate(variable, c - w, c + w)
    volume = math.prod(2 * w for w in half_width)
    mean = sum(a.Evaluate() for a in integral.monomial_to_coefficient_map().values()) / volume
    # Drake subtracts primitives at c ± w: their size is what its rounding is measured by.
    size = float(exact_mean(f, np.abs(center) + half_width, half_width)[1])
    assert f.mean(center, half_width) == pytest.approx(mean, abs=1e-12 * (1 + size))


def test_a_hinge_keeps_small_scales_beside_large_offsets() -> None:
    f = compiled(lambda x: smax(0.0, 1e3 - 1e-3 * x[0]) ** 2 - log(1e-3 * x[1] + 1e3))
    factors = {t.factors[0].kind: t.factors[0] for t in f.blocks[0].terms}
    hinge, barrier = factors[FunctionKind.SQUARED_HINGE], factors[FunctionKind.NEG_LOG]
    assert (hinge.scale, hinge.offset) == (1e-3, -1e3)
    assert (barrier.scale, barrier.offset) == (1e-3, 1e3)


def test_linear_quadratic_and_constant_costs_keep_their_value() -> None:
    prog, x = program()
    prog.AddCost(2 * x[0] - x[2] + 3)
    prog.AddCost(Expression(-1.25))
    prog.AddLinearCost([0.0, 4.0], 1.0, [x[1], x[0]])
    prog.AddCost(3 * x[0] * x[1] + x[1] ** 2 - x[2] + 2)
    prog.AddQuadraticCost([[2.0, 0.5], [1.5, -4.0]], [1.0, 0.0], 0.5, [x[2], x[0]], is_convex=False)
    prog.AddQuadraticErrorCost(np.diag([1.0, 2.0]), [0.5, -1.0], [x[0], x[2]])
    f = compile_program(prog)
    for point in np.random.default_rng(3).uniform(-3, 3, (20, 3)):
        assert f(point) == pytest.approx(total_cost(prog, point), rel=1e-13, abs=1e-12)
    mean = f.mean([1.0, 2.0, 3.0], [0.5, 0.25, 1.0])
    squares = 1.0 * 0.5**2 + 1.0 * 0.25**2 + (1.0 + 2.0) * 1.0**2 - 2.0 * 0.5**2
    assert mean == pytest.approx(f([1.0, 2.0, 3.0]) + squares / 3, rel=1e-14)


def test_costs_that_drake_made_are_kept_apart() -> None:
    # Drake's Python objects for them are temporary, so that id() repeats.
    prog, x = program(50)
    for i in range(50):
        prog.AddCost((i + 1) * x[i] ** 2 + i)
    for candidate in (prog, prog.Clone()):
        gc.collect()
        f = compile_program(candidate)
        assert len(f.blocks) == 50
        assert f(np.ones(50)) == sum(2 * i + 1 for i in range(50))


def test_like_terms_of_costs_with_one_name_and_the_same_variables_are_merged() -> None:
    prog, x = program()
    for k in range(1, 11):  # a sum of squares, as residuals give it
        add(prog, (x[0] - k * x[1] ** 2 + 1) ** 2, "residual")
    add(prog, (x[0] + x[1]) ** 3, "another")
    f = compile_program(prog)
    assert [(block.name, len(block.terms)) for block in f.blocks] == [
        ("residual", 6),
        ("another", 4),
    ]
    point = np.array([0.5, -0.75, 0.0])
    assert f(point) == pytest.approx(total_cost(prog, point), rel=1e-14)


def test_a_shared_evaluator_is_parsed_once_and_means_the_sum_of_its_bindings() -> None:
    a, b = Variable("a"), Variable("b")
    shared = ExpressionCost(a**3 * b - log(b) + smax(0.0, a - 1.0) ** 2)
    shared.set_description("stage")
    together, x = program(21)
    apart = MathematicalProgram()
    apart.AddDecisionVariables(x)
    order = [v.get_name() for v in shared.vars()]
    for k in range(20):
        pair = {"a": x[k], "b": x[k + 1]}
        together.AddCost(shared, vars=[pair[name] for name in order])
        add(apart, shared.expression().Substitute({a: pair["a"], b: pair["b"]}), f"stage {k}")
    f, g = compile_program(together), compile_program(apart)
    assert (len(f.blocks), len(g.blocks)) == (1, 20)
    assert f.blocks[0].variables.shape == (20, 2)
    assert f.num_terms == g.num_terms == 60
    box = np.linspace(2.0, 4.0, 21), np.linspace(0.0, 1.0, 21)
    assert f.mean(*box) == pytest.approx(g.mean(*box), rel=1e-14)
    for ours, theirs in zip(f.gradient(*box)[1:], g.gradient(*box)[1:], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-13, atol=1e-12)


def test_the_mean_of_a_square_is_not_the_square_of_the_mean() -> None:
    a, b = Variable("a"), Variable("b")
    prog, x = program(1)
    prog.AddCost(ExpressionCost(a * b), vars=[x[0], x[0]])
    quadratic, y = program(1)
    matrix = [[0.0, 1.0], [1.0, 0.0]]
    quadratic.AddQuadraticCost(matrix, [0.0, 0.0], [y[0], y[0]], is_convex=False)
    for each in (prog, quadratic):
        assert compile_program(each).mean([2.0], [1.0]) == pytest.approx(4.0 + 1.0 / 3.0)


def test_opaque_costs_are_refused_with_the_remedy() -> None:
    remedy = r"Add it as `c = ExpressionCost\(expression\); prog.AddCost\(c, vars=c.vars\(\)\)`"
    prog, x = program()
    prog.AddCost(x[0] ** 17).evaluator().set_description("cube")
    with pytest.raises(
        UnsupportedTermError, match=rf"'cube' of x\(0\).*got a PolynomialCost, .*{remedy}"
    ):
        compile_program(prog)
    prog, x = program(5)
    prog.AddCost(lambda z: z[0] ** 2, vars=x)
    with pytest.raises(UnsupportedTermError, match=r"'PyFunctionCost' of x\(0\), x\(1\), x\(2\),"):
        compile_program(prog)


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_costs_whose_numbers_are_not_finite_are_refused(bad: float) -> None:
    def linear(prog: MathematicalProgram, x: np.ndarray) -> None:
        prog.AddLinearCost([bad], 0.0, x[:1]).evaluator().set_description("unset")

    def offset(prog: MathematicalProgram, x: np.ndarray) -> None:
        prog.AddLinearCost([1.0], bad, x[:1]).evaluator().set_description("unset")

    def quadratic(prog: MathematicalProgram, x: np.ndarray) -> None:
        binding = prog.AddQuadraticCost([[bad]], [0.0], x[:1], is_convex=True)
        binding.evaluator().set_description("unset")

    for add_cost in (linear, offset, quadratic):
        prog, x = program()
        add_cost(prog, x)
        with pytest.raises(
            UnsupportedTermError, match=f"'unset'.*the term {bad}.*finite numbers.*was not set"
        ):
            compile_program(prog)


def test_constraints_are_not_read_and_the_order_is_kept() -> None:
    prog, x = program(4)
    add(prog, (x[0] * x[3]) ** 2 + x[1] * x[2] ** 3)
    prog.AddConstraint(sin(x[0]) <= 0.5)
    f = compile_program(prog, order=[0, 3, 1, 2])
    assert (f.order.tolist(), f.bandwidth) == ([0, 3, 1, 2], 1)
    assert compile_program(prog).bandwidth == 1, "reverse Cuthill-McKee pairs them too"


def test_unnamed_costs_go_by_their_type() -> None:
    prog, x = program()
    prog.AddCost(x[0] + 1)
    prog.AddCost(x[0] ** 2)
    add(prog, x[0] ** 4)
    assert set(compile_program(prog).weights) == {"LinearCost", "QuadraticCost", "ExpressionCost"}


def test_costs_that_are_too_many_terms_as_one_are_parsed_each(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("drake_aigto.terms.products.MAX_TERMS", 8)
    prog, x = program()
    add(prog, (x[0] + x[1]) ** 5, "power")
    add(prog, (x[0] + 2 * x[1]) ** 4, "power")
    f = compile_program(prog)
    assert f.num_terms == 6 + 5
    point = np.linspace(0.5, 1.0, prog.num_vars())
    u, v = point[:2]
    assert f(point) == pytest.approx((u + v) ** 5 + (u + 2 * v) ** 4, rel=1e-13)
