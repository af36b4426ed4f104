"""A function with a known global minimum: numbers, exact gradients and a program from one text."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import ExpressionCost, MathematicalProgram
from pydrake.symbolic import MakeVectorVariable

Floats = NDArray[np.float64]

_COMPLEX_STEP = 1e-30  # its square is lost beside any number that is not tiny itself


@dataclass(frozen=True, eq=False, init=False)
class Part:
    """Σ_k function(x[variables[k, 0]], …, x[variables[k, L−1]]): one function, bound K times.

    Attributes:
        function: takes L numbers, arrays or Drake Expressions, and works on them alike. Analytic.
        variables: indices into x, shape (K, L), read-only.
    """

    function: Callable[..., Any]
    variables: NDArray[np.intp]

    def __init__(self, function: Callable[..., Any], variables: ArrayLike) -> None:
        """Lock the array; a single copy may be given as a flat one."""
        object.__setattr__(self, "function", function)
        _set_array(self, "variables", np.atleast_2d(np.array(variables, dtype=np.intp)))


def _set_array(owner: object, name: str, array: NDArray[Any]) -> None:
    """Set a field of a frozen dataclass to a read-only array."""
    array.setflags(write=False)
    object.__setattr__(owner, name, array)


@dataclass(frozen=True, eq=False, init=False)
class GlobalProblem:
    """minimise f(x) = Σ parts subject to lower ≤ x ≤ upper, whose global minimum is known.

    Attributes:
        name: as in the literature, with the number of variables where there are several versions.
        lower: of the start box, shape (n,), read-only.
        upper: of the start box, shape (n,), read-only.
        minimum: f*, the least value over the box.
        minimizers: known points where it is taken, shape (k, n), read-only; not always all of them.
        parts: what f is the sum of.
        source: where formula, box and minimum are from, and where the literature errs.
    """

    name: str
    lower: Floats
    upper: Floats
    minimum: float
    minimizers: Floats
    parts: tuple[Part, ...] = field(repr=False)
    source: str = field(repr=False)

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
        points = np.atleast_2d(np.array(minimizers, dtype=float))
        _set_array(self, "minimizers", points)
        for bound, values in zip(("lower", "upper"), box, strict=True):
            _set_array(self, bound, np.array(np.broadcast_to(values, points.shape[1:]), float))
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "minimum", minimum)
        object.__setattr__(self, "parts", tuple(parts))
        object.__setattr__(self, "source", source)

    @property
    def num_variables(self) -> int:
        """The number n of variables."""
        return self.lower.size

    def evaluate(self, x: ArrayLike | Sequence[Any]) -> Any:
        """Return f at x (n,) of Drake Expressions, or at numbers of shape (…, n)."""
        point = np.asarray(x)
        if point.dtype == object:
            return sum(
                part.function(*point[copy]) for part in self.parts for copy in part.variables
            )
        value = np.zeros(point.shape[:-1], dtype=np.result_type(point, float))
        for part in self.parts:
            columns = np.moveaxis(point[..., part.variables], -1, 0)
            value = value + np.sum(part.function(*columns), axis=-1)
        return value if value.ndim else value.item()

    def gradient(self, x: ArrayLike) -> Floats:
        """Return ∇f at x (n,) to rounding, Im f(x + i h e_j) / h: nothing is there to cancel."""
        point = np.asarray(x, dtype=complex)
        gradient = np.zeros(self.num_variables)
        for part in self.parts:
            columns = list(point[part.variables].T)
            for j, column in enumerate(columns):
                stepped = [*columns[:j], column + 1j * _COMPLEX_STEP, *columns[j + 1 :]]
                slope = part.function(*stepped).imag / _COMPLEX_STEP
                np.add.at(gradient, part.variables[:, j], slope)
        return gradient

    def prog(self) -> MathematicalProgram:
        """Return the program; a part is one ExpressionCost, bound to each of its copies."""
        prog = MathematicalProgram()
        x = prog.NewContinuousVariables(self.num_variables, "x")
        prog.AddBoundingBoxConstraint(self.lower, self.upper, x)
        for part in self.parts:
            places = MakeVectorVariable(part.variables.shape[1], "y")
            cost = ExpressionCost(part.function(*places))
            index = {place.get_id(): i for i, place in enumerate(places)}
            order = [index[variable.get_id()] for variable in cost.vars()]
            for copy in part.variables[:, order]:
                prog.AddCost(cost, vars=x[copy])
        return prog
