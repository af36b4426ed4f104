"""Programs, terms and factors that the tests of boxes share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression

from drake_aigto.box import BoxPolynomial, factor_mean
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock, parse_costs

ExpressionOf = Callable[[np.ndarray], Expression]


def program(num_variables: int = 3) -> tuple[MathematicalProgram, np.ndarray]:
    """Returns an empty program and its variables."""
    prog = MathematicalProgram()
    return prog, prog.NewContinuousVariables(num_variables, "x")


def add(prog: MathematicalProgram, expression: Expression, name: str = "") -> None:
    """Adds an ExpressionCost, which keeps its formula."""
    cost = ExpressionCost(expression)
    cost.set_description(name)
    prog.AddCost(cost, vars=cost.vars())


def compile_program(prog: MathematicalProgram, order: npt.ArrayLike | None = None) -> BoxPolynomial:
    """Returns the table of a program's costs."""
    return BoxPolynomial(prog.num_vars(), parse_costs(prog), order)


def compiled(expression_of: ExpressionOf, num_variables: int = 3) -> BoxPolynomial:
    """Returns the table of one ExpressionCost."""
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
    """Returns the same, from the Newton system of a cost that is this factor."""
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
