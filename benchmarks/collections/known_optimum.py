"""What problems with a known global optimum have in common."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydrake.solvers import MathematicalProgram

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
