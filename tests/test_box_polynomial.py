"""Means of whole polynomials over boxes: their laws, their derivatives, and what is refused."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_aigto import OptionsError, UnsupportedTermError
from drake_aigto.box import BoxPolynomial, Factor, FunctionKind, Term, TermBlock
from drake_aigto.box.functions import WAVES
from drake_aigto.box.kernels import add_means, add_newton_system
from drake_aigto.box.reference import exact_mean, relative_error
from drake_aigto.box.tables import stack_terms
from drake_aigto.local import PolynomialNlp

NUM_VARIABLES = 5
# Some ten roundings a factor, and one for each of a few dozen terms.
TOLERANCE = 1e-14
# Waves are not among them: their means may be far smaller than they are, and their rounding errors
# with them not. See test_box_waves.
KINDS = [kind for kind in FunctionKind if kind not in WAVES]
Floats = npt.NDArray[np.float64]
Boxes = tuple[Floats, Floats]


def eighths(low: float, high: float) -> st.SearchStrategy[float]:
    """Multiples of 1/8: sums and products of a few of them are exact."""
    return st.integers(math.ceil(8 * low), math.floor(8 * high)).map(lambda i: i / 8)


@st.composite
def factors(draw: st.DrawFn, variable: int) -> Factor:
    """Factors; logarithms keep their argument positive over `boxes`."""
    kind = draw(st.sampled_from(KINDS))
    exponent = draw(st.integers(0, 4)) if kind is FunctionKind.POWER else 1
    scale = draw(st.sampled_from([-1.0, -0.5, 0.5, 1.0]))
    offset = draw(eighths(11, 15) if kind is FunctionKind.NEG_LOG else eighths(-3, 3))
    return Factor(variable, kind, exponent, scale, offset)


@st.composite
def blocks(draw: st.DrawFn, name: str = "block", copies: int | None = None) -> TermBlock:
    """A few terms in one to three variables, copied onto some of the variables."""
    size = draw(st.integers(1, 3))
    terms = []
    for _ in range(draw(st.integers(1, 4))):
        chosen = draw(st.sets(st.integers(0, size - 1)))
        terms.append(Term(draw(eighths(-3, 3)), tuple(draw(factors(i)) for i in sorted(chosen))))
    count = draw(st.integers(1, 3)) if copies is None else copies
    places = [draw(st.permutations(range(NUM_VARIABLES)))[:size] for _ in range(count)]
    return TermBlock(name, tuple(terms), places, draw(eighths(0.5, 3)))


@st.composite
def polynomials(draw: st.DrawFn) -> BoxPolynomial:
    """A sum of two or three blocks, under the default order."""
    names = ["first", "second", "third"][: draw(st.integers(2, 3))]
    return BoxPolynomial(NUM_VARIABLES, tuple(draw(blocks(name)) for name in names))


@st.composite
def boxes(draw: st.DrawFn, least_width: float = 0.0) -> Boxes:
    """Boxes within |x| ≤ 10, most of them away from the origin."""
    lists = st.lists(eighths(-6, 6), min_size=NUM_VARIABLES, max_size=NUM_VARIABLES)
    widths = st.lists(eighths(least_width, 4), min_size=NUM_VARIABLES, max_size=NUM_VARIABLES)
    return np.array(draw(lists)), np.array(draw(widths))


def size_of(f: BoxPolynomial, box: Boxes) -> float:
    """Returns Σ |a_m| ∏ |μ|, the size that rounding errors are measured by."""
    return float(exact_mean(f, *box)[1])


def dense(band: Floats) -> Floats:
    """Returns the symmetric matrix that is stored as a lower band."""
    n = band.shape[1]
    matrix: Floats = np.zeros((n, n))
    for offset, diagonal in enumerate(band):
        assert not diagonal[n - offset :].any(), "entries beyond the matrix"
        matrix += np.diag(diagonal[: n - offset], -offset)
    return np.asarray(matrix + np.tril(matrix, -1).T)


def in_variable_order(f: BoxPolynomial, matrix: Floats) -> Floats:
    """Returns a Hessian in elimination order as one over all c, then all z."""
    places = f.to_variables(np.arange(float(matrix.shape[0])))
    index = np.concatenate(list(places)).astype(int)
    return np.asarray(matrix[np.ix_(index, index)])


@given(polynomials(), boxes())
def test_mean_is_that_of_exact_arithmetic(f: BoxPolynomial, box: Boxes) -> None:
    mean, size = exact_mean(f, *box)
    assert relative_error(f.mean(*box), mean, size) <= TOLERANCE


@given(polynomials(), boxes(), st.integers(0, NUM_VARIABLES - 1))
def test_mean_is_the_average_over_the_two_halves_of_a_box(
    f: BoxPolynomial, box: Boxes, cut: int
) -> None:
    center, half_width = box
    half = half_width.copy()
    half[cut] /= 2
    step = np.zeros(NUM_VARIABLES)
    step[cut] = half[cut]
    halves = (f.mean(center - step, half) + f.mean(center + step, half)) / 2
    assert halves == pytest.approx(f.mean(*box), abs=1e-12 * size_of(f, box) + 1e-12)


@given(polynomials(), boxes(), st.lists(eighths(-4, 4), min_size=5, max_size=5))
def test_mean_does_not_depend_on_where_the_origin_is(
    f: BoxPolynomial, box: Boxes, shift: list[float]
) -> None:
    def moved(block: TermBlock, copy: int) -> TermBlock:
        variables = block.variables[copy]

        def move(factor: Factor) -> Factor:
            step = factor.scale * shift[variables[factor.variable]]
            return dataclasses.replace(factor, offset=factor.offset - step)

        terms = [Term(t.coefficient, tuple(map(move, t.factors))) for t in block.terms]
        return TermBlock(block.name, tuple(terms), variables, block.weight)

    copies = [moved(b, k) for b in f.blocks for k in range(b.variables.shape[0])]
    g = BoxPolynomial(NUM_VARIABLES, tuple(copies))
    # All numbers are multiples of 1/16, so the functions' arguments are the same to the last bit.
    assert g.mean(box[0] + shift, box[1]) == pytest.approx(
        f.mean(*box), abs=1e-13 * size_of(f, box), rel=0
    )


@given(polynomials(), boxes())
def test_a_box_of_no_width_has_the_value(f: BoxPolynomial, box: Boxes) -> None:
    functions: dict[FunctionKind, Callable[[float, int], float]] = {
        FunctionKind.POWER: lambda y, p: y**p,
        FunctionKind.SQUARED_HINGE: lambda y, _: min(y, 0.0) ** 2,
        FunctionKind.NEG_LOG: lambda y, _: -math.log(y),
    }
    x = box[0]
    value = 0.0
    for block in f.blocks:
        for variables in block.variables:
            for term in block.terms:
                product = block.weight * term.coefficient
                for g in term.factors:
                    y = g.scale * x[variables[g.variable]] + g.offset
                    product *= functions[g.kind](y, g.exponent)
                value += product
    assert f(x) == pytest.approx(value, abs=1e-13 * size_of(f, (x, np.zeros(NUM_VARIABLES))))
    np.testing.assert_array_equal(f.gradient(x, 0.0)[2], 0.0)


@given(boxes(), st.lists(eighths(-2, 2), min_size=9, max_size=9))
def test_mean_of_a_convex_quadratic_is_not_below_its_value_at_the_center(
    box: Boxes, entries: list[float]
) -> None:
    root = np.reshape(entries, (3, 3))
    q = root.T @ root
    terms = [
        Term(q[i, j], (Factor(i, FunctionKind.POWER, 1), Factor(j, FunctionKind.POWER, 1)))
        if i != j
        else Term(q[i, i], (Factor(i, FunctionKind.POWER, 2),))
        for i in range(3)
        for j in range(3)
    ]
    f = BoxPolynomial(NUM_VARIABLES, (TermBlock("quadratic", tuple(terms), [4, 0, 2]),))
    rise = np.diag(q) @ (box[1][[4, 0, 2]] ** 2) / 3
    assert f.mean(*box) - f(box[0]) == pytest.approx(rise, abs=1e-13 * size_of(f, box))
    assert rise >= 0.0


@given(polynomials(), boxes(), st.permutations(range(NUM_VARIABLES)))
def test_results_do_not_depend_on_the_elimination_order(
    f: BoxPolynomial, box: Boxes, order: list[int]
) -> None:
    g = BoxPolynomial(NUM_VARIABLES, f.blocks, order)
    np.testing.assert_array_equal(g.order, order)
    assert g.mean(*box) == f.mean(*box)
    for centers_only in (False, True):
        ours, theirs = f.newton_system(*box, centers_only), g.newton_system(*box, centers_only)
        assert ours.value == theirs.value == pytest.approx(f.mean(*box))
        for mine, other in zip(
            f.to_variables(ours.gradient), g.to_variables(theirs.gradient), strict=True
        ):
            np.testing.assert_array_equal(mine, other)
        np.testing.assert_array_equal(
            in_variable_order(f, dense(ours.band)), in_variable_order(g, dense(theirs.band))
        )


@given(polynomials(), boxes())
def test_copies_of_a_block_are_the_sum_of_separate_blocks(f: BoxPolynomial, box: Boxes) -> None:
    separate = tuple(
        TermBlock(block.name, block.terms, variables, block.weight)
        for block in f.blocks
        for variables in block.variables
    )
    g = BoxPolynomial(NUM_VARIABLES, separate, f.order)
    assert (g.num_terms, g.bandwidth) == (f.num_terms, f.bandwidth)
    size = size_of(f, box)
    assert g.mean(*box) == pytest.approx(f.mean(*box), abs=1e-13 * size)
    np.testing.assert_allclose(
        g.newton_system(*box).band, f.newton_system(*box).band, atol=1e-11 * (1 + size)
    )


def largest_size(f: BoxPolynomial, box: Boxes) -> float:
    """Returns a bound on what the terms come to near the box, on either side of a hinge."""
    center, half_width = box
    return sum(size_of(f, (c, half_width + 1)) for c in (center, np.abs(center), -np.abs(center)))


@given(polynomials(), boxes(least_width=0.5))
def test_gradient_is_the_slope_of_the_mean(f: BoxPolynomial, box: Boxes) -> None:
    center, half_width = box
    value, gradient_c, gradient_z = f.gradient(center, half_width)
    h = 2.0**-17  # so that c ± h is a float; error h²/6 of the third derivative, and 1e-16/h
    scale = 1e-8 * (1 + largest_size(f, box))
    assert value == f.mean(center, half_width)
    for i, unit in enumerate(np.eye(NUM_VARIABLES)):
        slope_c = f.mean(center + h * unit, half_width) - f.mean(center - h * unit, half_width)
        wide, narrow = half_width * np.exp(h * unit), half_width * np.exp(-h * unit)
        slope_z = f.mean(center, wide) - f.mean(center, narrow)
        assert gradient_c[i] == pytest.approx(slope_c / (2 * h), abs=scale)
        assert gradient_z[i] == pytest.approx(slope_z / (2 * h), abs=scale)


@given(polynomials(), boxes(least_width=0.5), st.booleans())
def test_banded_hessian_is_the_slope_of_the_gradient(
    f: BoxPolynomial, box: Boxes, centers_only: bool
) -> None:
    center, half_width = box
    system = f.newton_system(center, half_width, centers_only)
    value, *gradient = f.gradient(center, half_width)
    size = largest_size(f, box)
    parts = gradient[:1] if centers_only else gradient
    assert system.value == pytest.approx(value, abs=1e-13 * size)
    for ours, theirs in zip(f.to_variables(system.gradient), parts, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-12 * (1 + size))
    h = 2.0**-17
    columns = []
    for direction in np.eye(len(parts) * NUM_VARIABLES):
        step_c, step_z = direction[:NUM_VARIABLES], direction[NUM_VARIABLES:]
        moved = [
            f.gradient(center + s * step_c, half_width * np.exp(s * step_z if step_z.size else 0.0))
            for s in (h, -h)
        ]
        forward, backward = (np.concatenate(m[1 : 1 + len(parts)]) for m in moved)
        columns.append((forward - backward) / (2 * h))
    hessian = in_variable_order(f, dense(system.band))
    # The hinge's third derivative jumps by 1/w ≤ 2 at its borders: an error of h there, not h².
    np.testing.assert_allclose(hessian, np.array(columns).T, atol=2 * h * (1 + size))


def test_bandwidth_is_that_of_a_chain_in_its_own_order() -> None:
    product = Term(1.0, (Factor(0, FunctionKind.POWER), Factor(1, FunctionKind.POWER)))
    links = [[i, i + 1] for i in range(9)]
    chain = BoxPolynomial(10, (TermBlock("chain", (product,), links),), range(10))
    assert chain.bandwidth == 1
    assert chain.newton_system(np.ones(10), 0.1).band.shape == (4, 20)
    assert chain.newton_system(np.ones(10), 0.1, centers_only=True).band.shape == (2, 10)
    shuffled = np.random.default_rng(0).permutation(10)
    renamed = BoxPolynomial(10, (TermBlock("chain", (product,), shuffled[links]),))
    assert renamed.bandwidth == 1, "reverse Cuthill-McKee finds the chain"


@given(polynomials(), boxes(), eighths(-4, 4))
def test_mean_is_linear_in_the_weights(f: BoxPolynomial, box: Boxes, factor: float) -> None:
    scaled = f.with_weights({name: factor * weight for name, weight in f.weights.items()})
    shares = f.mean_by_block(*box)
    size = 1e-13 * (1 + abs(factor)) * size_of(f, box)
    assert scaled.mean(*box) == pytest.approx(factor * f.mean(*box), abs=size)
    assert set(shares) == set(f.weights)
    total = sum(weight * shares[name] for name, weight in f.weights.items())
    assert total == pytest.approx(f.mean(*box), abs=size)
    assert f.with_weights({"first": 0.0}).mean(*box) == pytest.approx(
        f.mean(*box) - f.weights["first"] * shares["first"], abs=size
    )


@given(polynomials(), boxes())
def test_new_weights_leave_the_old_polynomial_as_it_was(f: BoxPolynomial, box: Boxes) -> None:
    before, weights = f.mean(*box), f.weights
    f.with_weights({"second": 17.0})
    assert (f.mean(*box), f.weights) == (before, weights)


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


def test_unknown_names_and_useless_weights_are_refused() -> None:
    f = BoxPolynomial(2, (block(BARRIER, name="barrier"), block(Term(1.0, (X0,)), name="slope")))
    with pytest.raises(OptionsError, match=r"no cost named \['barier'\].*'barrier', 'slope'"):
        f.with_weights({"barier": 2.0})
    with pytest.raises(OptionsError, match="weight of 'barrier': got nan, expected a finite"):
        f.with_weights({"barrier": math.nan})


@pytest.mark.parametrize(
    ("terms", "variables", "message"),
    [
        (
            [Term(1.0, (X0, X0))],
            (0, 1),
            r"the cost 'cost'.*the term 1 \* x0\^1 \* x0\^1.*x·x is x²",
        ),
        ([Term(1.0, (X0, X1))], [(0, 1), (2, 2)], "copy 1 with variable 2 twice.*x·x is x²"),
        ([Term(math.nan, (X0,))], (0, 1), r"the term nan \* x0\^1, expected finite numbers"),
        ([Term(1.0, (dataclasses.replace(X0, offset=math.inf),))], (0, 1), r"\(1\*x0 \+ inf\)\^1"),
        (
            [Term(1.0, (dataclasses.replace(X0, exponent=-1),))],
            (0, 1),
            "exponent -1, expected whole",
        ),
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
    with pytest.raises(
        OptionsError, match=r"elimination order: got .* expected each of 0 … 1 once"
    ):
        BoxPolynomial(2, (block(Term(1.0, (X0, X1))),), order)


def test_boxes_of_another_size_or_of_negative_width_are_refused() -> None:
    f = BoxPolynomial(2, (block(Term(1.0, (X0, X1))),))
    with pytest.raises(
        ValueError, match=r"center has shape \(3,\) and half_width \(2,\); expected"
    ):
        f.mean(np.ones(3), np.ones(2))
    with pytest.raises(ValueError, match=r"half_width \(3,\); expected \(2,\)"):
        f.gradient(np.ones(2), np.ones(3))
    with pytest.raises(ValueError, match=r"half_width is -0\.5 at its least"):
        f.newton_system(np.ones(2), [1.0, -0.5])


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
    product, square = Term(2.0, (X0, X1)), Term(1.0, (dataclasses.replace(X0, exponent=2),))
    blocks = (
        block(product, square, variables=[(0, 1), (1, 2)]),
        block(square, variables=(2,)),
        block(product, square, variables=(0, 2), name="other"),
    )
    stacked = stack_terms(blocks)
    assert stacked.copies["sum_index"].tolist() == [0, 0, 1, 0]
    assert (stacked.factors.size, stacked.most_factors, stacked.longest_term) == (4, 3, 2)
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
    f.mean_by_block(x, 0.5)
    f.with_weights({"cost": 2.0}).newton_system(x, 0.5)
    f.newton_system(x, 0.5, centers_only=True)
    separable = BoxPolynomial(2, (block(Term(1.0, (X0,))),))
    separable.newton_system(x, 0.5, centers_only=True)
    nlp = PolynomialNlp(2, (cost,), (cost,), np.full(2, -np.inf), np.full(2, np.inf))
    nlp.evaluate(x)
    nlp.kkt_structure.assemble(x, np.ones(2), np.ones(1))
    for kernel in (add_means, add_newton_system):
        signatures = kernel.signatures  # type: ignore[union-attr]
        assert len(signatures) == 1, "each costs a second when the package first runs"


def test_nothing_to_integrate_is_zero() -> None:
    for f in (BoxPolynomial(0, ()), BoxPolynomial(3, ())):
        x = np.ones(f.num_variables)
        assert (f(x), f.num_terms, f.bandwidth) == (0.0, 0, 0)
        assert f.newton_system(x, 1.0).gradient.shape == (2 * x.size,)
