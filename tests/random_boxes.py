"""Random polynomials and boxes, for the tests of their means."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from hypothesis import strategies as st

from drake_aigto.box import BoxPolynomial
from drake_aigto.terms import WAVES, Factor, FunctionKind, Term, TermBlock

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
    """Returns the symmetric matrix that is stored as a lower band."""
    n = band.shape[1]
    matrix: Floats = np.zeros((n, n))
    for offset, diagonal in enumerate(band):
        assert not diagonal[n - offset :].any(), "entries beyond the matrix"
        matrix += np.diag(diagonal[: n - offset], -offset)
    return np.asarray(matrix + np.tril(matrix, -1).T)
