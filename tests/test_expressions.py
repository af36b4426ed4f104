"""Sums of products of one-variable functions: multiplied out rightly, or refused with a reason."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from box_programs import (
    ExpressionOf,
    add,
    compile_program,
    compiled,
    exact_mean,
    program,
    relative_error,
)
from hypothesis import given
from hypothesis import strategies as st
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression, Variable, cos, exp, if_then_else, log, pow, sin, sqrt, tan
from pydrake.symbolic import max as smax
from pydrake.symbolic import min as smin

from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local import compile_nlp
from drake_aigto.terms import MAX_TERMS, FunctionKind


def levy(x: np.ndarray) -> Expression:
    w = [1 + (v - 1) / 4 for v in x]  # NumPy warns of operations on whole arrays of variables
    middle = sum((v - 1) ** 2 * (1 + 10 * sin(math.pi * v + 1) ** 2) for v in w[:-1])
    last = (w[-1] - 1) ** 2 * (1 + sin(2 * math.pi * w[-1]) ** 2)
    return sin(math.pi * w[0]) ** 2 + middle + last


def rastrigin(x: np.ndarray) -> Expression:
    return 10 * len(x) + sum(v**2 - 10 * cos(2 * math.pi * v) for v in x)


FORMS: dict[str, ExpressionOf] = {
    "sine": lambda x: sin(x[0]),
    "cosine of minus": lambda x: cos(1 - 3 * x[0]),
    "sine of minus": lambda x: 2 * sin(1 - 3 * x[0]),
    "sine squared": lambda x: sin(x[0]) ** 2,
    "sine times cosine": lambda x: sin(x[0]) * cos(2 * x[0]),
    "cosine times sine": lambda x: cos(3 * x[0] + 1) * sin(x[0] - 0.5),
    "power of a sine": lambda x: sin(3 * x[0] + 1) ** 6,
    "power times sine squared": lambda x: x[0] ** 2 * sin(3 * x[0] + 1) ** 2,
    "exponentials": lambda x: exp(x[0]) * exp(-2 * x[0]),
    "exponentials that cancel": lambda x: x[1] * exp(x[0] + 0.5) * exp(-x[0]),
    "exponential cubed": lambda x: x[0] * exp(0.5 * x[0] - 1) ** 3,
    "different variables": lambda x: x[0] ** 2 * sin(x[1]) * exp(x[2]),
    "cosines of two variables": lambda x: cos(x[0]) * cos(x[1]),
    "sine of a sum": lambda x: sin(x[0] + x[1]),
    "cosine of three": lambda x: cos(x[0] - 2 * x[1] + 0.5 * x[2] - 1),
    "sine of three": lambda x: x[1] ** 2 * sin(x[0] - 2 * x[1] + 0.5 * x[2] - 1),
    "exponential of a sum": lambda x: exp(0.5 * x[0] - x[1] + 0.25),
    "sines of sums multiplied": lambda x: sin(x[0] + x[1]) * cos(x[0] - x[1]),
    "a product of sums": lambda x: (x[0] - sin(x[1])) ** 2 * (1 + exp(x[2])) / 3,
    "an argument that is affine": lambda x: sin((x[0] - 1) ** 2 - x[0] ** 2),
    "an argument that is constant": lambda x: x[1] * sin((x[0] - 1) ** 2 - x[0] ** 2 + 2 * x[0]),
    "beside hinge and barrier": lambda x: (
        cos(x[0]) * x[0] ** 3 + smax(0.0, 1 - x[0]) ** 2 - 2 * log(x[2]) + x[1] ** 4 / 2
    ),
    "a hinge of another variable": lambda x: (2 * smax(0.0, x[0] - 1)) ** 2 * cos(x[1]),
    "half a hinge": lambda x: (-smax(0.0, x[0]) / 2) ** 2 + sin(x[0]),
    "divided": lambda x: (sin(x[0]) - log(x[2])) / 4,
    "a constant beside a cubic": lambda x: x[0] ** 3 + 7.5,
    "a product of affine sums": lambda x: (x[0] + 2 * x[1]) ** 2 * (1 - x[2]) / 3,
    "a hinge": lambda x: smax(0.0, -x[0]) ** 2,
    "a hinge, zero second": lambda x: smax(-x[0], 0.0) ** 2,
    "an upper bound": lambda x: smax(x[1] - 0.75, 0.0) ** 2,
    "an upper bound, zero first": lambda x: 2.5 * smax(0.0, 3 * x[1] - 0.75) ** 2,
    "a hinge times itself": lambda x: smax(0.0, -x[0]) * smax(0.0, -x[0]),
    "a scaled hinge squared": lambda x: (2 * smax(0.0, x[0] - 1)) ** 2,
    "a hinge of a polynomial that is affine": lambda x: (
        smax(0.0, (x[0] - 1) ** 2 - x[0] ** 2 + 0.5) ** 2
    ),
    "a hinge with a minus": lambda x: -3 * smax(0.0, x[0]) ** 2,
    "a barrier": lambda x: -log(x[2]),
    "a barrier of an upper bound": lambda x: -0.1 * log(4.0 - 0.5 * x[2]),
    "a barrier divided": lambda x: -log(x[2]) / 2,
    "a weighed sum of all": lambda x: (
        0.5 * (x[0] ** 2 * x[1] - log(x[2]) + smax(0.0, 1 - x[0]) ** 2 + 4)
    ),
    "a nested sum": lambda x: 2 * (x[0] - 3 * (log(x[2]) - x[1] ** 4)) - x[0] * (x[1] + 1),
    "Levy": levy,
    "Rastrigin": rastrigin,
}


@pytest.mark.parametrize("form", FORMS)
def test_every_form_keeps_its_value_and_has_the_mean_of_its_table(form: str) -> None:
    prog, x = program()
    expression = FORMS[form](x)
    add(prog, expression)
    f = compile_program(prog)
    rng = np.random.default_rng(11)
    for _ in range(6):
        point = rng.uniform(-4.0, 4.0, 3)
        point[2] = abs(point[2]) + 0.5  # the logarithms' domain
        value = expression.Evaluate(dict(zip(x, point, strict=True)))
        total, size = exact_mean(f, point, np.zeros(3))
        assert relative_error(f(point), total, size) <= 1e-14
        assert f(point) == pytest.approx(value, rel=0.0, abs=1e-13 * max(1.0, float(size)))
        box = point, rng.uniform(0.0, 0.5, 3)
        mean, size = exact_mean(f, *box)
        assert abs(f.mean(*box) - float(mean)) <= 1e-13 * max(1.0, float(size))


def kinds(f: BoxPolynomial) -> list[tuple[FunctionKind, int, float]]:
    """Returns kind, power and scale of all factors."""
    factors = {factor for term in f.blocks[0].terms for factor in term.factors}
    return sorted((factor.kind, factor.exponent, factor.scale) for factor in factors)


def test_products_of_waves_become_sums_of_few() -> None:
    assert kinds(compiled(lambda x: sin(x[0]) ** 2)) == [(FunctionKind.COSINE, 0, 2.0)]
    assert kinds(compiled(lambda x: x[0] ** 2 + sin(x[0]) ** 2 + cos(x[0]) ** 2)) == [
        (FunctionKind.POWER, 2, 1.0)
    ]
    # By thirds, so that sums of scales are rounded: like terms are found all the same.
    sixth = compiled(lambda x: sin(x[0] / 3 + 0.1) ** 6)
    scales = [scale for *_, scale in kinds(sixth)]
    assert len(sixth.blocks[0].terms) == 4  # a constant, and three harmonics
    np.testing.assert_allclose(scales, [2 / 3, 4 / 3, 2.0], rtol=1e-16)
    assert kinds(compiled(lambda x: exp(x[0]) * exp(-x[0]) * x[1])) == [
        (FunctionKind.POWER, 1, 1.0)
    ]


def test_a_sine_is_exactly_odd_and_zero_at_zero() -> None:
    f = compiled(lambda x: sin(2 * x[0]))
    assert f([0.0, 1.0, 2.0]) == 0.0
    assert f.mean([0.0, 1.0, 2.0], 3.0) == 0.0
    assert f([-0.7, 0.0, 0.0]) == -f([0.7, 0.0, 0.0])


numbers = st.integers(-6, 6).map(lambda i: i / 4)
affine = st.tuples(numbers, numbers, numbers, numbers)


@st.composite
def products(draw: st.DrawFn) -> ExpressionOf:
    """Random sums of products of affine functions, their sines and cosines, or exponentials."""
    recipes = draw(
        st.lists(
            st.tuples(
                st.sampled_from(["trigonometric", "exponential"]),
                st.lists(st.tuples(st.integers(0, 2), st.integers(1, 3), affine), max_size=3),
            ),
            min_size=1,
            max_size=3,
        )
    )

    def expression_of(x: np.ndarray) -> Expression:
        total = sin(x[0])  # so that the whole is never a polynomial
        for family, factors in recipes:
            product = Expression(0.5)
            for which, exponent, (a, b, c, d) in factors:
                y = a * x[0] + b * x[1] + c * x[2] + d
                waves = (sin, cos) if family == "trigonometric" else (exp, exp)
                product *= pow(y if which == 2 else waves[which](y), exponent)
            total += product
        return total

    return expression_of


@given(products(), st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3))
def test_any_product_keeps_its_value_and_slopes(
    expression_of: ExpressionOf, point: list[float]
) -> None:
    _, x = program()
    expression = expression_of(x)
    place = dict(zip(x, point, strict=True))
    f = compiled(expression_of)
    # Angles are up to 60, so that a wave's rounding is up to 60 ulp of its coefficient.
    waves = sum(abs(term.coefficient) for term in f.blocks[0].terms)
    size = waves + float(exact_mean(f, point, np.zeros(3))[1])
    assert f(point) == pytest.approx(expression.Evaluate(place), rel=1e-12, abs=1e-12 * size)
    slopes = [expression.Differentiate(v).Evaluate(place) for v in x]
    _, gradient, _ = f.gradient(point, np.zeros(3))
    np.testing.assert_allclose(gradient, slopes, rtol=1e-11, atol=1e-11 * size)


TWICE: dict[str, ExpressionOf] = {
    "powers and a hinge": lambda v: (
        v[0] * v[1] ** 2 * v[2] + 2 * v[0] * v[1] - v[2] + smax(0.0, v[0]) ** 2
    ),
    "x sin y": lambda v: v[0] * sin(v[1]),
    "waves": lambda v: sin(v[0]) * cos(2 * v[1] + 1) * v[2] ** 2,
    "three waves": lambda v: sin(v[0]) * sin(v[1]) * cos(v[2]),
    "exponentials": lambda v: v[0] ** 2 * exp(v[0]) * exp(-0.5 * v[1]) * v[2],
    "waves that cancel": lambda v: sin(v[0] - v[1]) + v[2] * cos(v[0] - v[1]),
}


@pytest.mark.parametrize("form", TWICE)
@pytest.mark.parametrize("places", [(0, 0, 1), (1, 0, 1), (2, 2, 2)])
def test_a_variable_bound_twice_is_integrated_as_one(form: str, places: Sequence[int]) -> None:
    v = [Variable(name) for name in "abc"]
    formula = TWICE[form](np.array(v))
    shared = ExpressionCost(formula)
    prog, x = program()
    bound = {name: x[i] for name, i in zip("abc", places, strict=True)}
    prog.AddCost(shared, vars=[bound[a.get_name()] for a in shared.vars()])
    prog.AddCost(shared, vars=list(x[: len(shared.vars())]))  # a copy whose variables all differ
    plain = MathematicalProgram()
    plain.AddDecisionVariables(x)
    substituted = formula.Substitute({a: Expression(bound[a.get_name()]) for a in v})
    apart = formula.Substitute({a: Expression(x[i]) for i, a in enumerate(shared.vars())})
    add(plain, substituted)
    add(plain, apart)
    f, g = compile_program(prog), compile_program(plain)
    box = np.array([2.0, 3.0, -1.0]), np.array([1.0, 0.5, 2.0])
    assert f.mean(*box) == pytest.approx(g.mean(*box), rel=1e-13, abs=1e-14)
    assert f.newton_system(*box).value == pytest.approx(g.mean(*box), rel=1e-13, abs=1e-14)
    value = (substituted + apart).Evaluate(dict(zip(x, box[0], strict=True)))
    assert f(box[0]) == pytest.approx(value, rel=1e-13, abs=1e-14)


def test_binding_a_variable_twice_is_refused_where_the_product_has_no_closed_form() -> None:
    a, b = Variable("a"), Variable("b")
    cost = ExpressionCost(sin(a) * exp(b))
    cost.set_description("growing")
    prog, x = program(1)
    prog.AddCost(cost, vars=[x[0], x[0]])
    with pytest.raises(
        UnsupportedTermError,
        match=r"'growing'.*bound to a variable twice.*an exponential and a sine",
    ):
        compile_program(prog)


REFUSED: dict[str, tuple[ExpressionOf, str]] = {
    "exponential times sine": (
        lambda x: 2 * exp(x[0]) * sin(x[0]),
        r"exp\(x\(0\)\).*, where an exponential and a sine or cosine of one variable are mult",
    ),
    "sine of a square": (lambda x: sin(x[0] ** 2), r"sin\(.*, where the argument of sin\(.*\) is"),
    "exponential of a sine": (lambda x: exp(sin(x[0])), r"where the argument of exp\(.*\) is not"),
    "root of a sine": (lambda x: pow(sin(x[0]), 0.5), r"where the exponent of pow\(.*\) is not a"),
    "a power of two": (lambda x: pow(2.0, x[0]), r"where the exponent of pow\(.*\) is not a whole"),
    "divided by a cosine": (lambda x: x[0] / cos(x[1]), r"where the divisor cos\(x\(1\)\) is not"),
    "a hinge times a sine": (
        lambda x: smax(0.0, x[0]) ** 2 * sin(x[0]),
        r"where max\(0, y\)² or log\(y\) is multiplied",
    ),
    "a barrier times a sine": (
        lambda x: -log(x[0]) * sin(x[1]),
        r"where a logarithm is multiplied by another function",
    ),
    "rational": (lambda x: x[0] + 1 / x[1], r"\(1 / x\(1\)\)"),
    "a cancelled fraction": (lambda x: x[0] ** 2 / x[0], r"pow\(x\(0\), 2\) / x\(0\)"),
    "tangent": (lambda x: x[1] ** 4 + tan(x[0]), r"tan\(x\(0\)\), where tan"),
    "absolute value": (lambda x: x[0] ** 3 + 2 * abs(x[0]), r"\(2 \* abs\(x\(0\)\)\)"),
    "square root": (lambda x: sqrt(x[0]), r"sqrt\(x\(0\)\)"),
    "broken power": (lambda x: pow(x[0], 1.5), r"pow\(x\(0\), 1.5\)"),
    "a case": (lambda x: if_then_else(x[0] > 1, x[0], x[1]), "if"),
    "max of two variables": (lambda x: smax(x[0], x[1]) ** 2, r"max\(x\(0\), x\(1\)\)"),
    "a hinge, not squared": (lambda x: smax(0.0, x[0]), r"max\(0, x\(0\)\)"),
    "a hinge, cubed": (lambda x: smax(0.0, x[0]) ** 3, r"pow\(max\(0, x\(0\)\), 3\)"),
    "a hinge from another floor": (lambda x: smax(1.0, x[0]) ** 2, r"max\(1, x\(0\)\)"),
    "a minimum": (lambda x: smin(0.0, x[0]) ** 2, r"min\(0, x\(0\)\)"),
    "a hinge of two variables": (lambda x: smax(0.0, x[0] - x[1]) ** 2, r"max\(0, \(x\(0\)"),
    "a hinge of a square": (lambda x: smax(0.0, 1 - x[0] ** 2) ** 2, r"max\(0, \(1 - pow"),
    "a barrier with the other sign": (lambda x: 2 * log(x[0]), r"\(2 \* log\(x\(0\)\)\)"),
    "a barrier of two variables": (lambda x: -log(x[0] + x[1]), r"log\(.*\) is a function of 2"),
    "a barrier of a square": (lambda x: -log(x[0] ** 2), r"log\(pow\(x\(0\), 2\)\)"),
    "a barrier times a variable": (lambda x: -x[1] * log(x[0]), r"\* log\(x\(0\)\)"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_term_without_a_closed_form_is_refused_by_cost_term_and_reason(case: str) -> None:
    expression_of, term = REFUSED[case]
    prog, x = program()
    add(prog, x[0] ** 2 + x[1] ** 4, "fine")
    add(prog, expression_of(x) + sin(x[2]), "troublesome")
    with pytest.raises(
        UnsupportedTermError,
        match=rf"cost 'troublesome' of x\(0\).*the term .*{term}.*(equality|Check the term's sign)",
    ):
        compile_program(prog)


TOO_MANY: dict[str, tuple[ExpressionOf, str]] = {
    "a power of a sum": (lambda x: pow(sum(x), 12), r"1,251,677,700"),
    "a product of powers": (lambda x: pow(sum(x), 6) * pow(sum(x) + 1, 6), r"\d+,\d{3},\d{3}"),
    "a product of waves": (
        lambda x: pow(sum(sin(v) for v in x[:20]), 3) * pow(sum(cos(v) for v in x[:20]), 3),
        r"2,\d{3},\d{3}",
    ),
    "a sine of a sum": (lambda x: sin(sum(x[:25])), r"16,777,216"),
    "a huge exponent": (lambda x: pow(1 + sin(x[0]), 1e6), r"2,000,000"),
}


@pytest.mark.parametrize("case", TOO_MANY)
def test_too_many_terms_are_refused_with_their_number(case: str) -> None:
    expression_of, count = TOO_MANY[case]
    with pytest.raises(
        UnsupportedTermError,
        match=rf"'the cost' of x\(0\).*too many terms.*{count}.*at most 1,000,000.*equality",
    ):
        compiled(expression_of, 25)
    assert MAX_TERMS == 1_000_000


def test_long_powers_of_few_terms_are_no_trouble() -> None:
    f = compiled(lambda x: pow(x[0] + 1, 6) * pow(x[0] - 2, 6) * pow(x[0] + x[1], 4) + sin(x[0]))
    assert f.num_terms < 80
    assert f([0.5, 0.25, 0.0]) == pytest.approx(1.5**12 * 0.75**4 + math.sin(0.5), rel=1e-12)


def test_numbers_that_are_not_finite_are_refused() -> None:
    for expression_of in (
        lambda x: sin(math.inf * x[0]),
        lambda x: cos(math.inf * x[0]) * cos(x[0]),
        lambda x: math.inf * sin(x[0]),
        lambda x: exp(x[0] + 1000) * exp(-x[0]),
        lambda x: math.inf * x[0] ** 3,
        lambda x: smax(0.0, math.inf - x[0]) ** 2,
    ):
        with pytest.raises(UnsupportedTermError, match=r"'the cost'.*term .*inf.*finite numbers"):
            compiled(expression_of)


def test_the_local_solver_sees_values_slopes_and_curvatures() -> None:
    prog, x = program()
    expression = x[0] ** 2 * sin(2 * x[1] + 1) * exp(-x[2]) + cos(x[0] + x[1])
    add(prog, expression)
    nlp = compile_nlp(prog)
    point = np.array([0.7, -1.3, 0.4])
    place = dict(zip(x, point, strict=True))
    assert nlp.evaluate(point)[0] == pytest.approx(expression.Evaluate(place), rel=1e-14)
    gradient, band = nlp.kkt_structure.assemble(point, np.ones(nlp.num_costs), np.empty(0))
    places = nlp.kkt_structure.variable_places
    slopes = [expression.Differentiate(v) for v in x]
    np.testing.assert_allclose(gradient, [s.Evaluate(place) for s in slopes], rtol=1e-13)
    for i in range(3):
        for j in range(i + 1):
            curvature = slopes[i].Differentiate(x[j]).Evaluate(place)
            first, last = sorted((places[i], places[j]))
            assert band[last - first, first] == pytest.approx(curvature, rel=1e-13, abs=1e-14)
