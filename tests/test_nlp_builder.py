"""Problems put together from numbers are those that are compiled from programs."""

from __future__ import annotations

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram

from drake_aigto import UnsupportedTermError
from drake_aigto.local import InteriorPoint, NlpBuilder, compile_nlp


def test_a_built_problem_is_the_compiled_one() -> None:
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    s = prog.NewContinuousVariables(1, "s")
    for one, other in ((x[0], x[1]), (x[1], x[2])):
        prog.AddCost(2.0 * one * other + 3.0 * other**2 + 1.5)
        prog.AddConstraint(one**2 * other - 4.0 == 0)
    prog.AddLinearConstraint(2.0 * x[0] - x[2] + 1.0 - s[0] == 0)
    prog.AddLinearConstraint(x[1] + 2.0 * x[2] == 5.0)
    prog.AddBoundingBoxConstraint(-1.0, 2.0, s)
    prog.AddBoundingBoxConstraint(-3.0, 0.5, x[:1])
    compiled = compile_nlp(prog)

    builder = NlpBuilder()
    x_ = builder.new(3)
    pairs = np.column_stack([x_[:-1], x_[1:]])
    builder.add_cost("cost", [(2.0, (0, 1)), (3.0, (1, 1)), (1.5, ()), (0.0, (0,))], pairs)
    builder.add_row("row", [(1.0, (0, 0, 1)), (-4.0, ())], pairs)
    builder.bound_sum("sum", np.array([2.0, 0.0, -1.0]), x_, -1.0, 2.0, offset=1.0)
    builder.bound_sum("equal", np.array([0.0, 1.0, 2.0]), x_, 5.0, 5.0)
    builder.bound_sum("one", np.array([-2.0, 0.0, 0.0]), x_, 0.0, 7.0, offset=1.0)
    built = builder.build()

    np.testing.assert_array_equal(built.lower, compiled.lower)
    np.testing.assert_array_equal(built.upper, compiled.upper)
    point = builder.complete(np.array([0.3, -1.2, 0.7]))
    assert point[3] == pytest.approx(2 * 0.3 - 0.7 + 1.0)
    costs, rows = zip(*(nlp.evaluate(point) for nlp in (built, compiled)), strict=True)
    assert costs[0] == pytest.approx(costs[1])
    np.testing.assert_allclose(np.sort(rows[0]), np.sort(rows[1]), atol=1e-15)
    solved = [InteriorPoint().solve(nlp, point).cost for nlp in (built, compiled)]
    assert solved[0] == pytest.approx(solved[1])


def test_bounds_that_contradict_each_other_are_refused() -> None:
    builder = NlpBuilder()
    x = builder.new(2)
    builder.bound(x, 0.0, 1.0)
    builder.bound(x[1], 2.0, 3.0)
    with pytest.raises(UnsupportedTermError) as error:
        builder.build()
    assert str(error.value) == (
        "the bounds of unknown 1 leave it no value: got [2, 1], expected lower ≤ upper. "
        "Relax one of the constraints on it."
    )
