"""A constrained program with a known global optimum: numbers and a Drake program from one text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import ExpressionCost, MathematicalProgram

from drake_aigto.study.global_problem import Floats

# x_1, …, x_n, numbers or Drake Expressions → the rows.
Rows = Callable[..., Sequence[Any]]


def no_rows(*_: Any) -> Sequence[Any]:
    """Return no rows."""
    return ()


@dataclass(frozen=True, eq=False, init=False)
class ConstrainedProblem:
    """minimise Σ costs(x)  s.t.  equalities(x) = 0,  inequalities(x) ≥ 0,  lower ≤ x ≤ upper.

    Attributes:
        name: as in the literature.
        lower: shape (n,), read-only.
        upper: shape (n,), read-only.
        minimum: f*, the least cost of all feasible x.
        minimizers: known points where it is taken, shape (k, n), read-only; not always all of them.
        source: where it is from, or why the optimum is one.
    """

    name: str
    lower: Floats
    upper: Floats
    minimum: float
    minimizers: Floats
    costs: Rows = field(repr=False)
    equalities: Rows = field(repr=False)
    inequalities: Rows = field(repr=False)
    source: str = field(repr=False)

    def __init__(
        self,
        name: str,
        box: tuple[ArrayLike, ArrayLike],
        minimum: float,
        minimizers: ArrayLike,
        costs: Callable[..., Any],
        *,
        equalities: Rows = no_rows,
        inequalities: Rows = no_rows,
        source: str,
    ) -> None:
        """Give all arrays their shapes; costs may return a single number, bounds may be scalars."""
        points = np.atleast_2d(np.array(minimizers, dtype=float))
        arrays = {"minimizers": points}
        for bound, values in zip(("lower", "upper"), box, strict=True):
            arrays[bound] = np.array(np.broadcast_to(values, points.shape[1:]), dtype=float)
        for array in arrays.values():
            array.setflags(write=False)
        fields = {
            "name": name,
            "minimum": float(minimum),
            "costs": costs,
            "equalities": equalities,
            "inequalities": inequalities,
            "source": source,
        }
        for key, value in (fields | arrays).items():
            object.__setattr__(self, key, value)

    @property
    def num_variables(self) -> int:
        """The number n of variables."""
        return self.lower.size

    def summands(self, x: Sequence[Any] | NDArray[Any]) -> Sequence[Any]:
        """Return the summands of the cost at x (n,)."""
        costs = self.costs(*x)
        return costs if isinstance(costs, (list, tuple)) else (costs,)

    def evaluate(self, x: Sequence[Any] | NDArray[Any]) -> Any:
        """Return the cost at x (n,), numbers or Expressions."""
        return sum(self.summands(x))

    def violation(self, x: ArrayLike) -> float:
        """Return the largest residual of a row or bound at x (n,); 0 if all hold."""
        point = np.asarray(x, dtype=float)
        rows = [
            *np.abs(self.equalities(*point)),
            *-np.asarray(self.inequalities(*point), dtype=float),
            *(self.lower - point),
            *(point - self.upper),
        ]
        return float(max(0.0, *rows))

    def prog(self) -> MathematicalProgram:
        """Return the program; Drake picks the kind of each constraint."""
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(self.num_variables, "x")
        prog.AddBoundingBoxConstraint(self.lower, self.upper, x)
        for summand in self.summands(x):
            cost = ExpressionCost(summand)
            prog.AddCost(cost, vars=cost.vars())
        for row in self.equalities(*x):
            prog.AddConstraint(row, 0.0, 0.0)
        for row in self.inequalities(*x):
            prog.AddConstraint(row, 0.0, np.inf)
        return prog
