"""SCIP as another prover: its bounds are floating point with tolerances, and prove nothing.

Bolusani et al. 2024, "The SCIP Optimization Suite 9.0", arXiv:2402.17702. It is not installed with
this package, but with its extra `scip`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import mul
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.certify.formulas import Formulas, Summand, formula_of
from drake_aigto.certify.tape import Operation
from drake_aigto.errors import OptionsError, UnsupportedTermError

_LARGE = 1e20  # infinite to SCIP
# Operations on entries before them.
_ARITHMETIC: Mapping[Operation, Callable[[list[Any], int, int, float], Any]] = {
    Operation.NUMBER: lambda _, a, b, p: p,
    Operation.SHIFT: lambda own, a, b, p: own[a] + p,
    Operation.SCALE: lambda own, a, b, p: p * own[a],
    Operation.ADD: lambda own, a, b, p: own[a] + own[b],
    Operation.MULTIPLY: lambda own, a, b, p: own[a] * own[b],
    Operation.RECIPROCAL: lambda own, a, b, p: 1.0 / own[a],
    # Of a number, SCIP would make an expression of degree 0.
    Operation.POWER: lambda own, a, b, p: reduce(mul, [own[a]] * b) if b < 4 else own[a] ** b,
    Operation.REAL_POWER: lambda own, a, b, p: own[a] ** p,
}


def _scip() -> Any:
    try:
        import pyscipopt
    except ImportError:
        raise OptionsError(
            "prover",
            got="'scip', which is not installed",
            remedy="Install it with this package: `pip install 'drake_aigto[scip]'`.",
        ) from None
    return pyscipopt


def bound_by_scip(
    formulas: Formulas, gap: float, seconds: float | None
) -> tuple[float, Floats | None]:
    """Returns SCIP's lower bound, ∞ if it finds no feasible point, and its best point (n,)."""
    scip = _scip()
    model = scip.Model()
    model.hideOutput()
    ends = np.clip([formulas.lower, formulas.upper], -_LARGE, _LARGE).T.tolist()
    x = [model.addVar(lb=low, ub=high) for low, high in ends]
    functions = {
        Operation.EXP: scip.exp,
        Operation.LOG: scip.log,
        Operation.SIN: scip.sin,
        Operation.COS: scip.cos,
        Operation.ABS: abs,
    }
    cost = model.addVar(lb=None, ub=None)
    model.addCons(cost >= write_sum(formulas.summands, x, functions))
    model.setObjective(cost)
    for row in formulas.rows:
        own = write_sum((row,), x, functions)
        if row.lower == row.upper:
            model.addCons(own == row.lower)
            continue
        if math.isfinite(row.upper):
            model.addCons(own <= row.upper)
        if math.isfinite(row.lower):
            model.addCons(own >= row.lower)
    model.setParam("limits/gap", gap)
    model.setParam("lp/threads", 1)
    model.setParam("timing/clocktype", 1)  # of the processor
    if seconds is not None:
        model.setParam("limits/time", seconds)
    model.optimize()
    if model.getStatus() == "infeasible":
        return math.inf, None
    bound = float(model.getDualbound())
    best = model.getBestSol() if model.getNSols() else None
    point = None if best is None else np.array([best[each] for each in x])
    return (bound if bound > -_LARGE else -math.inf), point


def write_sum(
    parts: Sequence[Summand], x: Sequence[Any], functions: Mapping[Operation, Callable[[Any], Any]]
) -> Any:
    """Returns the sum of some summands in another program's expressions.

    Args:
        parts: the summands.
        x: its variables (n,).
        functions: those that it has, but for arithmetic and powers.

    Raises:
        UnsupportedTermError: a function that it lacks, by name.
    """
    values: list[Any] = []
    for number, a, b, p in formula_of(parts, range(len(x))):
        operation = Operation(number)
        if operation in functions:
            values.append(functions[operation](values[a]))
        elif operation == Operation.VARIABLE:
            values.append(x[a])
        elif operation in _ARITHMETIC:
            values.append(_ARITHMETIC[operation](values, a, b, p))
        else:
            raise UnsupportedTermError(
                "the prover has no such function",
                got=operation.name.lower(),
                remedy="Use the package's own prover.",
            )
    return 0.0 * x[0] + values[-1]
