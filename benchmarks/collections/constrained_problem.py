"""A constrained program with a known global optimum: numbers and a Drake program from one text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import ExpressionCost, MathematicalProgram

from benchmarks.collections.known_optimum import KnownOptimum

# x_1, …, x_n, numbers or Drake Expressions → the rows.
Rows = Callable[..., Sequence[Any]]


def no_rows(*_: Any) -> Sequence[Any]:
    """Return no rows."""
    return ()


@dataclass(frozen=True, eq=False, init=False)
class ConstrainedProblem(KnownOptimum):
    """minimise Σ costs(x)  s.t.  equalities(x) = 0,  inequalities(x) ≥ 0,  lower ≤ x ≤ upper.

    Attributes:
        costs: the summands of the cost.
        equalities: rows that have to be 0.
        inequalities: rows that have to be 0 or more.
    """

    costs: Rows = field(repr=False)
    equalities: Rows = field(repr=False)
    inequalities: Rows = field(repr=False)

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
        rows = {"costs": costs, "equalities": equalities, "inequalities": inequalities}
        self._set(name, box, minimum, minimizers, **rows, source=source)

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
        prog, x = self._start_program()
        for summand in self.summands(x):
            cost = ExpressionCost(summand)
            prog.AddCost(cost, vars=cost.vars())
        for row in self.equalities(*x):
            prog.AddConstraint(row, 0.0, 0.0)
        for row in self.inequalities(*x):
            prog.AddConstraint(row, 0.0, np.inf)
        return prog
