"""Polynomials as tables: what is stored, shared, and refused."""

from __future__ import annotations

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from box_programs import NUM_VARIABLES, Boxes, boxes, dense, eighths, polynomials
from box_programs import blocks as random_blocks
from hypothesis import given, settings
from hypothesis import strategies as st
from pydrake.solvers import Cost, MathematicalProgram
from pydrake.symbolic import Polynomial, pow

from drake_aigto.aigo import CenterObjective
from drake_aigto.box import BoxPolynomial, NewtonSystem, Order, add_means, make_lanes
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.local import PolynomialNlp
from drake_aigto.terms import (
    Factor,
    FunctionKind,
    HiddenError,
    Term,
    TermBlock,
    is_hidden_polynomial,
    read_polynomial,
    stack_terms,
)


def block(*terms: Term, variables: object = (0, 1), name: str = "cost") -> TermBlock:
    return TermBlock(name, terms, variables)  # type: ignore[arg-type]


def power(variable: int) -> Factor:
    return Factor(variable, FunctionKind.POWER)


X0, X1 = power(0), power(1)
BARRIER = Term(1.0, (Factor(0, FunctionKind.NEG_LOG),))


def test_a_weight_of_zero_switches_an_infinite_barrier_off() -> None:
    f = BoxPolynomial(2, (block(BARRIER, name="barrier"), block(Term(2.0, (X1,)), name="slope")))
    outside, width = np.array([-1.0, 3.0]), np.full(2, 0.5)
    assert f.mean(outside, width) == math.inf
    off = f.with_weights({"barrier": 0.0})
    assert off.mean(outside, width) == 6.0
    assert off.gradient(outside, width)[0] == off.newton_system(outside, width).value == 6.0


def test_unknown_names_useless_weights_and_boxes_of_another_size_are_refused() -> None:
    f = BoxPolynomial(2, (block(BARRIER, name="barrier"), block(Term(1.0, (X0,)), name="slope")))
    with pytest.raises(OptionsError, match=r"no cost named \['barier'\].*'barrier', 'slope'"):
        f.with_weights({"barier": 2.0})
    with pytest.raises(OptionsError, match="weight of 'barrier': got nan, expected a finite"):
        f.with_weights({"barrier": math.nan})
    f = BoxPolynomial(2, (block(Term(1.0, (X0, X1))),))
    with pytest.raises(ValueError, match=r"center has shape \(3,\) and half_width \(2,\); expecte"):
        f.mean(np.ones(3), np.ones(2))
    with pytest.raises(ValueError, match=r"half_width \(3,\); expected \(2,\)"):
        f.gradient(np.ones(2), np.ones(3))
    with pytest.raises(ValueError, match=r"half_width is -0\.5 at its least"):
        f.newton_system(np.ones(2), [1.0, -0.5])


@pytest.mark.parametrize(
    ("terms", "variables", "message"),
    [
        ([Term(1.0, (X0, X0))], (0, 1), r"the cost 'cost'.*the term 1 \* x0\^1 \* x0\^1.*x·x is x"),
        ([Term(1.0, (X0, X1))], [(0, 1), (2, 2)], "copy 1 with variable 2 twice.*x·x is x²"),
        ([Term(math.nan, (X0,))], (0, 1), r"the term nan \* x0\^1, expected finite numbers"),
        ([Term(1.0, (X0._replace(offset=math.inf),))], (0, 1), r"\(1\*x0 \+ inf\)\^1"),
        ([Term(1.0, (X0._replace(exponent=-1),))], (0, 1), "exponent -1, expected whole"),
    ],
)
def test_a_term_without_a_right_mean_is_refused(
    terms: list[Term], variables: object, message: str
) -> None:
    with pytest.raises(UnsupportedTermError, match=message):
        block(*terms, variables=variables)


def test_a_variable_may_come_back_in_another_term() -> None:
    f = BoxPolynomial(1, (block(Term(1.0, (X0,)), Term(3.0, (X1,)), variables=(0, 0)),))
    assert f.mean([2.0], 0.5) == 8.0


@pytest.mark.parametrize("order", [[0, 0], [0], [1, 2], [0, 1, 2]])
def test_an_order_that_is_no_permutation_is_refused(order: list[int]) -> None:
    with pytest.raises(OptionsError, match=r"elimination order: got .* expected each of 0 … 1 onc"):
        BoxPolynomial(2, (block(Term(1.0, (X0, X1))),), order)


@settings(max_examples=10)
@given(polynomials(), boxes())
def test_boxes_may_be_lists_read_only_or_strided(f: BoxPolynomial, box: Boxes) -> None:
    center, half_width = box
    expected = f.mean(center, half_width)
    frozen = center.copy()
    frozen.setflags(write=False)
    assert f.mean(list(center), tuple(half_width)) == expected
    assert f.mean(frozen, np.repeat(half_width, 2)[::2]) == expected
    assert f.mean(center, 0.5) == f.mean(center, np.full(NUM_VARIABLES, 0.5))


def test_tables_are_read_only_and_the_callers_array_is_not() -> None:
    variables = np.array([[0, 1]])
    table = block(Term(1.0, (X0, X1)), variables=variables)
    variables[0, 0] = 7
    assert table.variables.tolist() == [[0, 1]]
    stacked = [part for part in stack_terms([table]) if isinstance(part, np.ndarray)]
    for array in (table.variables, BoxPolynomial(2, (table,)).order, *stacked):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


@given(polynomials())
def test_couplings_are_the_pairs_within_a_term(f: BoxPolynomial) -> None:
    pairs = {
        (variables[a.variable], variables[b.variable])
        for block in f.blocks
        for variables in block.variables.tolist()
        for term in block.terms
        for a in term.factors
        for b in term.factors
    }
    assert {(i, j) for i, j in f.couplings().tolist()} == pairs


def test_equal_sums_are_stored_once() -> None:
    product, square = Term(2.0, (X0, X1)), Term(1.0, (X0._replace(exponent=2),))
    blocks = (
        block(product, square, variables=[(0, 1), (1, 2)]),
        block(square, variables=(2,)),
        block(product, square, variables=(0, 2), name="other"),
    )
    stacked = stack_terms(blocks)
    assert stacked.copies["sum_index"].tolist() == [0, 0, 1, 0]
    longest_term = np.max(np.diff(stacked.terms["first_member"]))
    assert (stacked.factors.size, longest_term) == (4, 2)
    assert stacked.copy_variables.tolist() == [0, 1, 1, 2, 2, 0, 2]


@pytest.mark.parametrize("zeros", [(), (3,), (0, 9), (2, 5, 7)])
def test_slopes_of_a_long_product_are_right_also_where_factors_are_zero(zeros: list[int]) -> None:
    n = 10
    x = np.arange(2.0, n + 2)
    x[list(zeros)] = 0.0
    f = BoxPolynomial(
        n, (block(Term(1.0, tuple(map(power, range(n)))), variables=range(n)),), range(n)
    )
    others = [np.prod(np.delete(x, i)) for i in range(n)]
    np.testing.assert_array_equal(f.gradient(x, 0.5)[1], others)
    system = f.newton_system(x, 0.5, centers_only=True)
    np.testing.assert_array_equal(system.gradient, others)
    pairs = [[np.prod(np.delete(x, [i, j])) if i != j else 0.0 for i in range(n)] for j in range(n)]
    np.testing.assert_array_equal(dense(system.band), pairs)


def test_boxes_and_points_share_one_compilation() -> None:
    cost = block(Term(1.0, (X0, X1)))
    f = BoxPolynomial(2, (cost,))
    x = np.ones(2)
    f.gradient(x, 0.5)
    compilations = len(add_means.signatures)  # type: ignore[attr-defined]
    f.mean(x, 0.5)
    f.with_weights({"cost": 2.0}).newton_system(x, 0.5)
    f.newton_system(x, 0.5, centers_only=True)
    separable = BoxPolynomial(2, (block(Term(1.0, (X0,))),))
    separable.newton_system(x, 0.5, centers_only=True)
    nlp = PolynomialNlp(2, (cost,), (cost,), np.full(2, -np.inf), np.full(2, np.inf))
    nlp.evaluate(x)
    nlp.cost_magnitude(x)
    nlp.kkt_structure.assemble(x, np.ones(2), np.ones(1))
    CenterObjective(f, np.ones(2, bool), 1e-9).descend(x, 1)
    signatures = add_means.signatures  # type: ignore[attr-defined]
    assert len(signatures) == compilations, "each costs seconds when the package first runs"


def test_all_transcendental_functions_share_a_compilation_and_so_do_all_others() -> None:
    hinge, cosine = (
        Term(1.0, (Factor(0, kind),)) for kind in (FunctionKind.SQUARED_HINGE, FunctionKind.COSINE)
    )
    for first, second in ((Term(1.0, (X0,)), hinge), (BARRIER, cosine)):
        compilations = []
        for term in (first, second):
            BoxPolynomial(2, (block(term),)).gradient(np.ones(2), 0.5)
            compilations.append(len(add_means.signatures))  # type: ignore[attr-defined]
        assert compilations[0] == compilations[1]


def test_nothing_to_integrate_is_zero() -> None:
    for f in (BoxPolynomial(0, ()), BoxPolynomial(3, ())):
        x = np.ones(f.num_variables)
        assert (f(x), f.num_terms, f.bandwidth) == (0.0, 0, 0)
        assert f.newton_system(x, 1.0).gradient.shape == (2 * x.size,)


ORDER = range(NUM_VARIABLES)


def rescaled(block: TermBlock, factor: float) -> TermBlock:
    terms = [
        dataclasses.replace(term, coefficient=factor * term.coefficient) for term in block.terms
    ]
    return TermBlock(block.name, tuple(terms), block.variables, block.weight)


def sum_of(systems: list[NewtonSystem]) -> NewtonSystem:
    value, gradient, band = zip(*((s.value, s.gradient, s.band) for s in systems), strict=True)
    return NewtonSystem(sum(value), np.sum(gradient, axis=0), np.sum(band, axis=0))


@pytest.mark.slow
@settings(max_examples=8)
@given(
    random_blocks(copies=3),
    boxes(),
    st.lists(eighths(-2, 2), min_size=2, max_size=4),
    st.booleans(),
)
def test_copies_add_up(
    block: TermBlock, box: Boxes, factors: list[float], centers_only: bool
) -> None:
    # More copies than there are lanes, of sums that differ in their coefficients.
    many = [rescaled(block, factor) for factor in factors * 15]
    together = BoxPolynomial(NUM_VARIABLES, tuple(many), ORDER)
    alone = [
        TermBlock("alone", one.terms, [copy], one.weight) for one in many for copy in one.variables
    ]
    pieces = [BoxPolynomial(NUM_VARIABLES, (one,), ORDER) for one in alone]
    size = 1.0 + sum(abs(f.mean(*box)) for f in pieces)
    assert together.mean(*box) == pytest.approx(sum(f.mean(*box) for f in pieces), abs=1e-12 * size)
    width = max((f.bandwidth for f in pieces), default=0)
    for f in (together, *pieces):
        f.bandwidth = width
    ours = together.newton_system(*box, centers_only)
    theirs = sum_of([f.newton_system(*box, centers_only) for f in pieces])
    for name in ("value", "gradient", "band"):
        expected = getattr(theirs, name)
        largest = 1.0 + size + np.max(np.abs(expected))
        np.testing.assert_allclose(getattr(ours, name), expected, rtol=0, atol=1e-12 * largest)
    gradients = [np.array(f.gradient(*box)[1:]) for f in pieces]
    largest = 1.0 + size + max(np.max(np.abs(gradient)) for gradient in gradients)
    np.testing.assert_allclose(
        together.gradient(*box)[1:], np.sum(gradients, axis=0), rtol=0, atol=1e-11 * largest
    )


@given(random_blocks(copies=2), st.integers(1, 100))
def test_sums_that_differ_in_numbers_share_a_tape(block: TermBlock, copies: int) -> None:
    many = TermBlock("many", block.terms, np.tile(block.variables, (copies, 1)))
    stacked = stack_terms([many, rescaled(block, 2.0)])
    for order in Order:
        lanes = make_lanes(stacked, order)
        assert lanes.tapes.size == 2, "the tape, and the entry that ends it"
        assert lanes.most_lanes == min(64, 2 * copies + 2)


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


def test_more_monomials_than_can_be_told_apart_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drake_aigto.terms.hidden_polynomials._MOST_MONOMIALS", 20)
    _, cost = hide(3, lambda x: sum(x) ** 4)
    with pytest.raises(HiddenError, match="more than 20 monomials"):
        read_polynomial(cost)
