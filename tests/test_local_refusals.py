"""What the local solver refuses, by name and before it starts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from local_problems import PROBLEMS
from pydrake.solvers import (
    MathematicalProgram,
)
from pydrake.symbolic import cos, exp, log, sin, tan
from pydrake.symbolic import max as symbolic_max

from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.local import InteriorPoint, PolynomialNlp, compile_nlp


def constrained(add: Callable[[MathematicalProgram, Any], object]) -> MathematicalProgram:
    prog = MathematicalProgram()
    add(prog, prog.NewContinuousVariables(2, "x"))
    return prog


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (
            lambda p, x: p.AddConstraint(sin(x[0] * x[1]) == 0),
            r"constraint 'ExpressionConstraint' of x\(0\), x\(1\) .* the term sin\(.*not affine",
        ),
        (
            lambda p, x: p.AddConstraint(exp(x[0]) * sin(x[0]) == x[1]),
            r"the term \(exp\(x\(0\)\) \* sin\(x\(0\)\)\), where an exponential and a sine",
        ),
        (
            lambda p, x: p.AddConstraint(log(x[0]) == x[1]),
            r"the term log\(x\(0\)\), where .* stands in a constraint, .* take exp of both sides",
        ),
        (
            lambda p, x: p.AddConstraint(symbolic_max(0.0, x[0]) ** 2 == x[1]),
            r"stands in a constraint",
        ),
        (lambda p, x: p.AddConstraint(cos(x[0]) >= 0.5), r"-inf ≤ \(-1 \* cos\(x\(0\)\)\) ≤ -0\.5"),
        (lambda p, x: p.AddConstraint(1 / x[0] == x[1]), "Multiply denominators out"),
        (lambda p, x: p.AddConstraint(x[0] * x[1] >= 1), r"inequality.*variable s of its own"),
        (lambda p, x: p.AddConstraint(x[0] + x[1] <= 1), "an inequality of several variables"),
        (lambda p, x: p.AddConstraint(lambda z: z, [0.0], [0.0], x[:1]), "PyFunctionConstraint"),
        (lambda p, x: p.AddLorentzConeConstraint(x), "LorentzConeConstraint"),
        (
            lambda p, x: p.AddQuadraticConstraint(np.full((2, 2), np.nan), np.zeros(2), 0, 0, x),
            "got a number that is NaN or infinite in 0 ≤ nan",
        ),
        (
            lambda p, x: (p.AddConstraint(x[0] >= 3), p.AddConstraint(x[0] <= 2)),
            r"bounds of x\(0\) leave it no value: got \[3, 2\]",
        ),
        (lambda p, x: p.AddCost(tan(x[0])), "the cost"),
    ],
)
def test_unsupported_programs_are_refused_by_name(
    add: Callable[[MathematicalProgram, Any], object], message: str
) -> None:
    with pytest.raises(UnsupportedTermError, match=message):
        compile_nlp(constrained(add))


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda nlp: InteriorPoint().solve(nlp, [1.0]), r"x0: got shape \(1,\), expected \(2,\)"),
        (
            lambda nlp: InteriorPoint().solve(nlp, [1.0, np.nan]),
            r"x0: got 1 entries that are NaN or infinite.*initial guess is NaN",
        ),
        (lambda nlp: InteriorPoint(tolerance=0.0), "tolerance: got 0, expected a number above 0"),
        (lambda nlp: InteriorPoint(bound_push=0.5), "bound_push: got 0.5, expected .* below 0.5"),
        (lambda nlp: InteriorPoint(max_iterations=-1), "max_iterations: got -1"),
        (lambda nlp: nlp.evaluate([1.0]), "the point: got shape"),
        (
            lambda nlp: compile_nlp(PROBLEMS["HS 6"].program(), [0, 0]),
            "the elimination order: got 2 entries",
        ),
    ],
)
def test_bad_numbers_are_refused(call: Callable[[PolynomialNlp], object], message: str) -> None:
    nlp = compile_nlp(PROBLEMS["HS 6"].program())
    with pytest.raises(OptionsError, match=message):
        call(nlp)
