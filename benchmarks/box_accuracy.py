"""How far box means are from exact rational arithmetic, and how parsing grows with the stages.

    python -m benchmarks.box_accuracy [--samples 4000] [--seed 0]

Prints the worst relative error of each kind of function, that of a power p times a wave relative to
(|c| + w)^p times the bound of the wave's mean, and of random polynomials to Σ |a_m| ∏ |μ|, for w =
0 and 1e-12 to 1e3 and |c| = 0 and 1e-12 to 1e3 (both signs). The goal is 1e-13; the exit status is
1 if it is missed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import MakeVectorVariable

from benchmarks.collections.rational_means import exact_factor_mean, exact_mean, relative_error
from drake_aigto.box import BoxPolynomial
from drake_aigto.box.functions import VALUE, factor_mean
from drake_aigto.terms import WAVES, Factor, FunctionKind, Term, TermBlock, parse_costs

GOAL = 1e-13
GRID = [0.0, *10.0 ** np.arange(-12, 4)]
Worst = tuple[float, str]


def sample_sizes(rng: np.random.Generator, count: int) -> np.ndarray:
    """0 in one of ten cases, and else 1e-12 to 1e3, all sizes alike."""
    sizes = 10.0 ** rng.uniform(-12.0, 3.0, count)
    return np.where(rng.random(count) < 0.1, 0.0, sizes)


def boxes(rng: np.random.Generator, samples: int) -> Iterator[tuple[float, float]]:
    """(c, w): the grid of decades, random ones, and those at and next to |c| = w."""
    yield from ((sign * c, w) for c in GRID for w in GRID for sign in (1.0, -1.0))
    signs = rng.choice([-1.0, 1.0], samples)
    yield from zip(signs * sample_sizes(rng, samples), sample_sizes(rng, samples), strict=True)
    for w in 10.0 ** rng.uniform(-12.0, 3.0, samples // 10):
        for c in (w, np.nextafter(w, 0.0), np.nextafter(w, np.inf), w * rng.uniform(0.5, 1.5)):
            yield from ((c, w), (-c, w))


def worst_of_function(factor: Factor, cases: Iterator[tuple[float, float]]) -> Worst:
    """Largest relative error over boxes; those off a logarithm's domain are left out."""
    worst = (0.0, "")
    row = np.empty(6)
    for c, w in cases:
        if factor.kind is FunctionKind.NEG_LOG and (c <= 0.0 or w > c):
            continue
        factor_mean(int(factor.kind), factor.exponent, factor.scale, factor.offset, c, w, row)
        exact = exact_factor_mean(factor, Fraction(c), Fraction(w))
        size = abs(exact)
        if factor.kind is FunctionKind.NEG_LOG:  # value at c and departure from it: they may cancel
            at_center = exact_factor_mean(factor, Fraction(c), Fraction(0))
            size = abs(at_center) + abs(exact - at_center)
        elif factor.kind in WAVES:
            size = Fraction(size_of_wave(factor, c, w))
        worst = max(worst, (relative_error(row[VALUE], exact, size), f"c = {c:.3g}, w = {w:.3g}"))
    return worst


def size_of_wave(factor: Factor, c: float, w: float) -> float:
    """The greatest (|c| + w)^p |g|, which the mean is below by at least 1/s for s = scale·w > 1."""
    reach = abs(factor.scale) * w
    greatest = 1.0
    if factor.kind is FunctionKind.EXPONENTIAL:
        greatest = float(np.exp(factor.scale * c + factor.offset + reach))
    return (abs(c) + w) ** factor.exponent * greatest / max(reach, 1.0)


def random_polynomial(rng: np.random.Generator, num_variables: int) -> BoxPolynomial:
    """Forty terms of degree up to 6 in up to four of the variables."""
    terms = []
    for _ in range(40):
        chosen = rng.choice(num_variables, size=rng.integers(1, 5), replace=False)
        powers = rng.multinomial(6, np.full(chosen.size, 1.0 / chosen.size))
        factors = (
            Factor(int(i), FunctionKind.POWER, int(p))
            for i, p in zip(chosen, powers, strict=True)
            if p
        )
        terms.append(Term(rng.normal() * 10.0 ** rng.uniform(-3, 3), tuple(factors)))
    return BoxPolynomial(
        num_variables, (TermBlock("random", tuple(terms), [range(num_variables)]),)
    )


def _span(values: np.ndarray) -> str:
    return f"{np.min(np.abs(values)):.0e} … {np.max(np.abs(values)):.0e}"


def worst_of_polynomials(rng: np.random.Generator, samples: int) -> Worst:
    """Largest error of polynomials in six variables, relative to Σ |a_m| ∏ |μ|."""
    worst = (0.0, "")
    for _ in range(samples // 20):
        f = random_polynomial(rng, 6)
        center = rng.choice([-1.0, 1.0], 6) * sample_sizes(rng, 6)
        half_width = sample_sizes(rng, 6)
        error = relative_error(f.mean(center, half_width), *exact_mean(f, center, half_width))
        worst = max(worst, (error, f"|c| = {_span(center)}, w = {_span(half_width)}"))
    return worst


def seconds_to_parse(num_stages: int) -> tuple[float, int]:
    """Time to parse copies of one quartic stage, and the number of its terms."""
    x = MakeVectorVariable(6, "x")
    stage = ExpressionCost((x[0] * (x[1] - x[2]) - 0.1) ** 2 + ((x[3] - x[4]) * (x[5] + x[0])) ** 2)
    place = {v.get_id(): i for i, v in enumerate(x)}
    places = [place[v.get_id()] for v in stage.vars()]
    prog = MathematicalProgram()
    variables = prog.NewContinuousVariables(3 * (num_stages + 1))
    for k in range(num_stages):
        prog.AddCost(stage, vars=variables[3 * k : 3 * k + 6][places])
    start = time.perf_counter()
    f = BoxPolynomial(prog.num_vars(), parse_costs(prog), range(prog.num_vars()))
    return time.perf_counter() - start, f.num_terms


def main() -> int:
    """Print the tables; 1 if the goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--samples", type=int, default=4000, help="random boxes a function")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)

    functions = {f"x^{p}": Factor(0, FunctionKind.POWER, p) for p in range(9)}
    functions["max(0, -x)^2"] = Factor(0, FunctionKind.SQUARED_HINGE)
    functions["-log x"] = Factor(0, FunctionKind.NEG_LOG)
    for kind, scale in zip(WAVES, (2.0 * np.pi, 2.0 * np.pi, 0.25), strict=True):
        for p in (0, 1, 8):
            name = f"x^{p} {kind.name.lower()} of {scale:.2f} x"
            functions[name] = Factor(0, kind, p, scale, 0.1)
    found = {
        name: worst_of_function(factor, boxes(rng, arguments.samples))
        for name, factor in functions.items()
    }
    found["polynomials, degree 6"] = worst_of_polynomials(rng, arguments.samples)
    print(f"{'function':28}{'worst error':>12}  at")
    for name, (error, where) in found.items():
        print(f"{name:28}{error:12.1e}  {where}")

    print(f"\n{'stages':>8}{'terms':>9}{'parsing [ms]':>14}{'per stage [µs]':>16}")
    for num_stages in (200, 2000, 20000):
        seconds, terms = min(seconds_to_parse(num_stages) for _ in range(3))
        print(f"{num_stages:8}{terms:9}{1e3 * seconds:14.1f}{1e6 * seconds / num_stages:16.2f}")
    return int(max(error for error, _ in found.values()) > GOAL)


if __name__ == "__main__":
    sys.exit(main())
