"""What problems with a known global optimum have in common.

A function with a known global minimum: numbers, exact gradients and a program from one text.

A constrained program with a known global optimum: numbers and a Drake program from one text.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import Expression, MakeVectorVariable
from pydrake.symbolic import cos as symbolic_cos

from drake_aigto.arrays import Floats


@dataclass(frozen=True, eq=False, init=False)
class KnownOptimum:
    """A problem over lower ≤ x ≤ upper whose global minimum is known.

    Attributes:
        name: as in the literature, with the number of variables where there are several versions.
        lower: shape (n,), read-only.
        upper: shape (n,), read-only.
        minimum: f*, the least cost of all feasible x.
        minimizers: known points where it is taken, shape (k, n), read-only; not always all of them.
        source: where formula, box and minimum are from, and where the literature errs.
    """

    name: str
    lower: Floats
    upper: Floats
    minimum: float
    minimizers: Floats
    source: str = field(repr=False)

    def _set(
        self,
        name: str,
        box: tuple[ArrayLike, ArrayLike],
        minimum: float,
        minimizers: ArrayLike,
        **others: Any,
    ) -> None:
        """Set all fields; bounds may be scalars, and a single minimizer may be flat."""
        points = np.atleast_2d(np.array(minimizers, dtype=float))
        arrays = {"minimizers": points}
        for bound, values in zip(("lower", "upper"), box, strict=True):
            arrays[bound] = np.array(np.broadcast_to(values, points.shape[1:]), dtype=float)
        for array in arrays.values():
            array.setflags(write=False)
        fields = {"name": name, "minimum": float(minimum), **arrays, **others}
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    @property
    def num_variables(self) -> int:
        """The number n of variables."""
        return self.lower.size

    def _start_program(self) -> tuple[MathematicalProgram, NDArray[Any]]:
        """Return a program of x and its bounds, and x."""
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(self.num_variables, "x")
        prog.AddBoundingBoxConstraint(self.lower, self.upper, x)
        return prog, x


_COMPLEX_STEP = 1e-30  # its square is lost beside any number that is not tiny itself


@dataclass(frozen=True, eq=False, init=False)
class Part:
    """Σ_k function(x[variables[k, 0]], …, x[variables[k, L−1]], *parameters[k]): K alike summands.

    Attributes:
        function: takes L numbers, arrays or Drake Expressions, and its parameters; analytic.
        variables: indices into x, shape (K, L), read-only.
        parameters: shape (K, P), read-only; P = 0 if all summands are the same.
    """

    function: Callable[..., Any]
    variables: NDArray[np.intp]
    parameters: Floats

    def __init__(
        self,
        function: Callable[..., Any],
        variables: ArrayLike,
        parameters: ArrayLike | None = None,
    ) -> None:
        """Lock the arrays; flat variables are a single summand's, or those of each parameter."""
        places = np.atleast_2d(np.array(variables, dtype=np.intp))
        numbers = np.zeros((len(places), 0)) if parameters is None else np.array(parameters, float)
        numbers = numbers.reshape(len(numbers), -1)
        object.__setattr__(self, "function", function)
        _set_array(
            self, "variables", np.array(np.broadcast_to(places, (len(numbers), places.shape[1])))
        )
        _set_array(self, "parameters", numbers)

    def __call__(self, x: NDArray[Any]) -> Any:
        """Return the sum at numbers of shape (…, n)."""
        columns = np.moveaxis(x[..., self.variables], -1, 0)
        return np.sum(self.function(*columns, *self.parameters.T), axis=-1)

    def slopes(self, x: Floats) -> Iterator[tuple[NDArray[np.intp], Floats]]:
        """Yield the derivatives of all summands by one of their variables, and its indices (K,).

        To rounding: Im function(x + i h) / h, where nothing is there to cancel.
        """
        columns = list(x[self.variables].T.astype(complex))
        for j, column in enumerate(columns):
            stepped = [*columns[:j], column + 1j * _COMPLEX_STEP, *columns[j + 1 :]]
            values = self.function(*stepped, *self.parameters.T)
            yield self.variables[:, j], values.imag / _COMPLEX_STEP

    def bind(self, prog: MathematicalProgram, x: NDArray[Any]) -> None:
        """Add the summands as ExpressionCosts of decision variables x; one if they are the same."""
        places = MakeVectorVariable(self.variables.shape[1], "y")
        index = {place.get_id(): i for i, place in enumerate(places)}
        is_shared = not self.parameters.size
        costs = [
            ExpressionCost(self.function(*places, *numbers))
            for numbers in self.parameters[: 1 if is_shared else None].tolist()
        ]
        order = [index[variable.get_id()] for variable in costs[0].vars()]
        for k, copy in enumerate(self.variables[:, order]):
            prog.AddCost(costs[0 if is_shared else k], vars=x[copy])


def _set_array(owner: object, name: str, array: NDArray[Any]) -> None:
    """Set a field of a frozen dataclass to a read-only array."""
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


@dataclass(frozen=True, eq=False, init=False)
class GlobalProblem(KnownOptimum):
    """minimise f(x) = Σ parts subject to lower ≤ x ≤ upper, whose global minimum is known.

    Attributes:
        parts: what f is the sum of.
    """

    parts: tuple[Part, ...] = field(repr=False)

    def __init__(
        self,
        name: str,
        box: tuple[ArrayLike, ArrayLike],
        minimum: float,
        minimizers: ArrayLike,
        parts: Sequence[Part],
        source: str,
    ) -> None:
        """Give all arrays their shapes; bounds may be scalars, a single minimizer may be flat."""
        self._set(name, box, minimum, minimizers, parts=tuple(parts), source=source)

    def evaluate(self, x: ArrayLike | Sequence[Any]) -> Any:
        """Return f at x (n,) of Drake Expressions, or at numbers of shape (…, n)."""
        point = np.asarray(x)
        if point.dtype == object:
            return sum(
                part.function(*point[copy], *numbers)
                for part in self.parts
                for copy, numbers in zip(part.variables, part.parameters.tolist(), strict=True)
            )
        return sum(part(point) for part in self.parts)

    def gradient(self, x: ArrayLike) -> Floats:
        """Return ∇f at x (n,), exact to rounding."""
        gradient = np.zeros(self.num_variables)
        for part in self.parts:
            for variables, slopes in part.slopes(np.asarray(x, dtype=float)):
                np.add.at(gradient, variables, slopes)
        return gradient

    def prog(self) -> MathematicalProgram:
        """Return the program; alike summands share an ExpressionCost."""
        prog, x = self._start_program()
        for part in self.parts:
            part.bind(prog, x)
        return prog


def cos(angle: Any) -> Any:
    """Return the cosine of numbers, or of a Drake Expression."""
    return symbolic_cos(angle) if isinstance(angle, Expression) else np.cos(angle)


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
