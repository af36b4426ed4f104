"""Programs, terms and factors that the tests of boxes share.

Box means in exact arithmetic: slow, and what the kernels are checked against. They come from the
primitives, (G(b) − G(a))/(b − a) over the interval [a, b] that x runs through, or y = scale·x +
offset, with the floats taken as the numbers that they are. Random polynomials and boxes, for the
tests of their means. Programs and matrices whose bands are wide: arrows and grids.
"""

from __future__ import annotations

import decimal
import math
from collections.abc import Callable
from fractions import Fraction

import numpy as np
import numpy.typing as npt
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression

from drake_aigto.box import D_C, D_CC, D_CZ, D_Z, D_ZZ, VALUE, BoxPolynomial, factor_mean
from drake_aigto.linear import Pattern
from drake_aigto.terms import WAVES, Factor, FunctionKind, Term, TermBlock, parse_costs

ExpressionOf = Callable[[np.ndarray], Expression]


def program(num_variables: int = 3) -> tuple[MathematicalProgram, np.ndarray]:
    prog = MathematicalProgram()
    return prog, prog.NewContinuousVariables(num_variables, "x")


def add(prog: MathematicalProgram, expression: Expression, name: str = "") -> None:
    cost = ExpressionCost(expression)
    cost.set_description(name)
    prog.AddCost(cost, vars=cost.vars())


def compile_program(prog: MathematicalProgram, order: npt.ArrayLike | None = None) -> BoxPolynomial:
    return BoxPolynomial(prog.num_vars(), parse_costs(prog), order)


def compiled(expression_of: ExpressionOf, num_variables: int = 3) -> BoxPolynomial:
    prog, x = program(num_variables)
    add(prog, expression_of(x), "the cost")
    return compile_program(prog)


def power(variable: int, exponent: int = 1) -> Factor:
    return Factor(variable, FunctionKind.POWER, exponent)


def univariate(coefficients: np.ndarray) -> BoxPolynomial:
    """Returns Σ a_p x^p."""
    terms = tuple(Term(float(a), (power(0, p),) if p else ()) for p, a in enumerate(coefficients))
    return BoxPolynomial(1, (TermBlock("f", terms, [[0]]),))


def evaluate(factor: Factor, center: float, half_width: float) -> npt.NDArray[np.float64]:
    """Returns the row of μ and its derivatives, in the order of the kernels."""
    row = np.full(6, np.nan)
    factor_mean(
        int(factor.kind), factor.exponent, factor.scale, factor.offset, center, half_width, row
    )
    return row


def evaluate_in_a_program(
    factor: Factor, center: float, half_width: float
) -> npt.NDArray[np.float64]:
    f = BoxPolynomial(1, (TermBlock("f", (Term(1.0, (factor,)),), [[0]]),))
    system = f.newton_system(np.array([center]), half_width)
    (cc, zz), (cz, _) = system.band
    return np.array([system.value, *system.gradient, cc, cz, zz])


def mean_by_block(
    f: BoxPolynomial, center: npt.ArrayLike, half_width: npt.ArrayLike
) -> dict[str, float]:
    """Returns each block's share of f̄, divided by its weight."""
    off = dict.fromkeys(f.weights, 0.0)
    return {name: f.with_weights({**off, name: 1.0}).mean(center, half_width) for name in off}


# Enough for second differences of steps 1e-20, over intervals of 1e-15 of their center.
_DIGITS = 120


def exact_factor_mean(factor: Factor, center: Fraction, half_width: Fraction) -> Fraction:
    """Mean of a factor over |x − center| ≤ half_width.

    Those of logarithms, cosines, sines and exponentials are right to 100 digits or so.

    Raises:
        ValueError: The interval leaves the domain of a logarithm.
    """
    if factor.kind in WAVES:
        return _wave_mean(factor, center, half_width)
    middle = Fraction(factor.scale) * center + Fraction(factor.offset)
    reach = abs(Fraction(factor.scale)) * half_width
    if not reach:
        return _value(factor, middle)
    rise = _primitive(factor, middle + reach) - _primitive(factor, middle - reach)
    return rise / (2 * reach)


def exact_mean(
    polynomial: BoxPolynomial, center: ArrayLike, half_width: ArrayLike
) -> tuple[Fraction, Fraction]:
    """The mean f̄ = Σ a_m ∏ μ, and Σ |a_m| ∏ |μ|, which its rounding error is measured by.

    Args:
        polynomial: What is integrated; its logarithms must stay on their domain.
        center: Box center (n,).
        half_width: Box half width (n,).
    """
    c = [Fraction(x) for x in np.asarray(center, dtype=float).tolist()]
    w = [Fraction(x) for x in np.asarray(half_width, dtype=float).tolist()]
    total, size = Fraction(0), Fraction(0)
    for block in polynomial.blocks:
        for variables in block.variables.tolist():
            for term in block.terms:
                product = Fraction(block.weight) * Fraction(term.coefficient)
                for factor in term.factors:
                    i = variables[factor.variable]
                    product *= exact_factor_mean(factor, c[i], w[i])
                total += product
                size += abs(product)
    return total, size


def _value(factor: Factor, y: Fraction) -> Fraction:
    if factor.kind is FunctionKind.POWER:
        return y**factor.exponent
    if factor.kind is FunctionKind.SQUARED_HINGE:
        return min(y, Fraction(0)) ** 2
    return -_log(y)


def _primitive(factor: Factor, y: Fraction) -> Fraction:
    if factor.kind is FunctionKind.POWER:
        return y ** (factor.exponent + 1) / (factor.exponent + 1)
    if factor.kind is FunctionKind.SQUARED_HINGE:
        return min(y, Fraction(0)) ** 3 / 3
    return y - y * _log(y) if y else Fraction(0)


def _log(y: Fraction) -> Fraction:
    if y <= 0:
        raise ValueError(f"log of {float(y):g}")
    with decimal.localcontext(decimal.Context(prec=_DIGITS)):
        return Fraction(_decimal(y).ln())


def _wave_mean(factor: Factor, center: Fraction, half_width: Fraction) -> Fraction:
    """Mean of x^p times a cosine, sine or exponential of y, in as many digits as cancel and more.

    A difference of primitives has lost (p + 1) log10 1/|scale·half_width| digits.
    """
    scale, offset = Fraction(factor.scale), Fraction(factor.offset)
    if not scale or not half_width:
        power = Factor(0, FunctionKind.POWER, factor.exponent)
        value = exact_factor_mean(power, center, half_width)
        with decimal.localcontext(decimal.Context(prec=2 * _DIGITS)):
            return value * Fraction(_wave(factor.kind, _decimal(scale * center + offset), 0))
    ratios = (1 / (scale * half_width), center / half_width, scale * center + offset)
    lost = max(_decades(ratio) for ratio in ratios)
    with decimal.localcontext(decimal.Context(prec=_DIGITS + (factor.exponent + 6) * lost)):
        rise = _wave_primitive(factor, center + half_width)
        rise -= _wave_primitive(factor, center - half_width)
        return Fraction(rise) / (2 * half_width)


def _decades(ratio: Fraction) -> int:
    """log10 |ratio|, rounded up and not below 0."""
    bits = ratio.numerator.bit_length() - ratio.denominator.bit_length() + 1
    return max(0, math.ceil(bits * math.log10(2.0)))


def _wave_primitive(factor: Factor, x: Fraction) -> decimal.Decimal:
    """∫ x^p g(y) dx = Σ_i (−1)^i p!/(p−i)! x^{p−i} g^{(−i−1)}(y) / scale^{i+1}, by parts."""
    y = _decimal(Fraction(factor.scale) * x + Fraction(factor.offset))
    scale, point = decimal.Decimal(factor.scale), _decimal(x)
    total, falling = decimal.Decimal(0), decimal.Decimal(1) / scale
    for i in range(factor.exponent + 1):
        rest = factor.exponent - i
        power = point**rest if rest else decimal.Decimal(1)  # Decimal has no 0⁰
        total += falling * power * _wave(factor.kind, y, i + 1)
        falling *= -rest / scale
    return total


def _wave(kind: FunctionKind, y: decimal.Decimal, primitives: int) -> decimal.Decimal:
    """The cosine, sine or exponential of y, integrated so many times."""
    if kind is FunctionKind.EXPONENTIAL:
        return y.exp()
    cosine, sine = _cosine_and_sine(y)
    quarters = primitives + (kind is FunctionKind.SINE)  # sin = ∫ cos
    return (cosine, sine, -cosine, -sine)[quarters % 4]


def _cosine_and_sine(y: decimal.Decimal) -> tuple[decimal.Decimal, decimal.Decimal]:
    """Taylor's series at y/2^n, and n doublings."""
    doublings = max(0, y.adjusted() + 1) * 4 + 10
    with decimal.localcontext() as context:
        context.prec += doublings
        part = y / 2**doublings
        cosine, sine = decimal.Decimal(0), decimal.Decimal(0)
        term, n = decimal.Decimal(1), 0
        while abs(term) > decimal.Decimal(10) ** -context.prec:
            cosine, sine = cosine + term, sine + term * part / (n + 1)
            term *= -part * part / ((n + 1) * (n + 2))
            n += 2
        for _ in range(doublings):
            cosine, sine = cosine * cosine - sine * sine, 2 * cosine * sine
    return +cosine, +sine


def _decimal(number: Fraction) -> decimal.Decimal:
    return decimal.Decimal(number.numerator) / decimal.Decimal(number.denominator)


def relative_error(computed: float, exact: Fraction, size: Fraction) -> float:
    """|computed − exact| / size; 0 where both are 0."""
    if not math.isfinite(computed):
        return math.inf
    error = abs(Fraction(computed) - exact)
    return float(error / size) if size else (math.inf if error else 0.0)


def exact_row(factor: Factor, center: float, half_width: float) -> dict[int, Fraction]:
    """Returns the mean, and derivatives as central differences, right to h² = 1e-40 of its size."""
    h = Fraction(1, 10**20)
    c, w = Fraction(center), Fraction(half_width)
    dc = h * (w or abs(c) or 1)

    def mean(i: int, j: int) -> Fraction:
        return exact_factor_mean(factor, c + i * dc, w + j * h * w)

    here, left, right, narrow, wide = mean(0, 0), mean(-1, 0), mean(1, 0), mean(0, -1), mean(0, 1)
    mixed = mean(1, 1) - mean(1, -1) - mean(-1, 1) + mean(-1, -1)
    d_z = (wide - narrow) / (2 * h)  # w ∂/∂w, over steps h w
    return {
        VALUE: here,
        D_C: (right - left) / (2 * dc),
        D_CC: (right - 2 * here + left) / dc**2,
        D_Z: d_z,
        D_CZ: mixed / (4 * dc * h),
        D_ZZ: (wide - 2 * here + narrow) / h**2 + d_z,  # w² ∂²/∂w² + w ∂/∂w
    }


NUM_VARIABLES = 5
# Some ten roundings a factor, and one for each of a few dozen terms.
TOLERANCE = 1e-14
# Waves are not among them: their means may be far smaller than they are, and their rounding errors
# with them not. See test_box_waves. Nor is the hinge, whose slope jumps where a box has no width:
# see test_box_functions.
KINDS = [kind for kind in FunctionKind if kind not in (*WAVES, FunctionKind.HINGE)]
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


def dense(band: Floats) -> Floats:
    n = band.shape[1]
    matrix: Floats = np.zeros((n, n))
    for offset, diagonal in enumerate(band):
        assert not diagonal[n - offset :].any(), "entries beyond the matrix"
        matrix += np.diag(diagonal[: n - offset], -offset)
    return np.asarray(matrix + np.tril(matrix, -1).T)


Ints = np.ndarray


def arrow(size: int, beside: int = 2) -> Ints:
    """Returns the edges (2, P) of a chain of unknowns, the first of which is coupled to all."""
    i = np.arange(size)
    chain = [np.vstack([i[1:-k], i[1 + k :]]) for k in range(1, beside + 1)]
    return np.hstack([*chain, np.vstack([np.zeros(size - 1, dtype=np.int64), i[1:]])])


def grid(side: int) -> Ints:
    i = np.arange(side * side).reshape(side, side)
    along = np.vstack([i[:, :-1].ravel(), i[:, 1:].ravel()])
    return np.hstack([along, np.vstack([i[:-1].ravel(), i[1:].ravel()])])


def whole(pattern: Pattern, values: np.ndarray) -> np.ndarray:
    """Returns the dense matrix of a pattern's entries (E,)."""
    matrix = np.zeros((pattern.size, pattern.size))
    matrix[pattern.rows, pattern.columns] = matrix[pattern.columns, pattern.rows] = values
    return matrix
