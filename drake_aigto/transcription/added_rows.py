"""Users' constraints as rows that boxes and local solvers take: equalities, and bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff
from pydrake.solvers import Constraint
from pydrake.symbolic import MakeVectorVariable, Variable

from drake_aigto.arrays import Floats, Ints
from drake_aigto.transcription.additions import Addition, Additions
from drake_aigto.transcription.shared import formula_rows, is_affine_in_one, shared_constraint

# How the variables of their own are called.
SLACK = "slack"


@dataclass(frozen=True, eq=False)
class AddedRow:
    """A row lower ≤ y(x) ≤ upper of a user's constraint, K times.

    An inequality that is not about one variable has a slack of its own each time, as penalties need
    one variable: y(x) − s = 0 with lower ≤ s ≤ upper.

    Attributes:
        row: y − s, or y with its bounds.
        reads: the decision variables that it reads, shape (K, …).
        stages: the last knot that it reads, shape (K,).
        slacks: which decision variable s is, shape (K,), or (0,) without slacks.
        bounds: of s.
        unit: of y.
    """

    row: Constraint
    reads: Ints
    stages: Ints
    slacks: Ints
    bounds: tuple[float, float]
    unit: float

    def fill(self, x: Floats) -> None:
        """Sets the slacks among decision variables (n,) to y(x)."""
        for slack, read in zip(self.slacks, self.reads, strict=False):
            x[slack] = 0.0
            x[slack] = self.row.Eval(x[read])[0]

    def widen(self, center: Floats, half_width: Floats) -> None:
        """Sets the slacks' half widths, those of y in a box to first order, both (n,)."""
        for slack, read in zip(self.slacks, self.reads, strict=False):
            half_width[slack] = 0.0
            value = np.asarray(self.row.Eval(InitializeAutoDiff(center[read]).ravel()))
            half_width[slack] = np.abs(ExtractGradient(value)[0]) @ half_width[read]


def make_rows(
    addition: Addition, additions: Additions, reads: Ints, stages: Ints, new: Callable[[int], Ints]
) -> Iterator[AddedRow]:
    """Yields the rows of a user's constraint, one of these additions.

    Its K copies read decision variables (K, …), at knots up to these stages (K,); `new` returns so
    many new variables.

    Raises:
        UnsupportedTermError: Drake does not give its formula.
    """
    x, s = MakeVectorVariable(reads.shape[1], "x"), Variable("s")
    place = {variable.get_id(): i for i, variable in enumerate([*x, s])}
    rows = list(formula_rows(addition.evaluator, addition.name, x))
    for (y, lower, upper), unit in zip(rows, additions.units(addition).tolist(), strict=True):
        bounds = lower / unit, upper / unit
        if lower == upper or is_affine_in_one(y):
            shared, slacks = shared_constraint(y / unit, addition.name, *bounds), new(0)
            columns = reads
        else:
            shared, slacks = shared_constraint(y / unit - s, addition.name), new(len(reads))
            columns = np.column_stack([reads, slacks])
        order = [place[variable.get_id()] for variable in shared.placeholders]
        yield AddedRow(shared.evaluator, columns[:, order], stages, slacks, bounds, unit)
