"""Which sign an expression keeps, by bounds of its variables and by rows."""

from __future__ import annotations

import math
from collections.abc import Iterable
from functools import cached_property

from pydrake.symbolic import Expression, ExpressionKind

from drake_aigto.solver.intervals import Ranges, is_above
from drake_aigto.terms import operands

# A row g that lies in a range.
RowRange = tuple[Expression, float, float]


class Signs:
    """What rows and bounds say of signs.

    Args:
        rows: formulas and their bounds.
        ranges: of the variables; those that are added later count too.
    """

    def __init__(self, rows: Iterable[RowRange], ranges: Ranges) -> None:
        """Keeps them."""
        self._rows, self._ranges = rows, ranges

    def are_positive(self, e: Expression, is_strict: bool = True) -> bool:
        """Returns whether an expression is above 0, or may be 0 too where that is not strict.

        It is if ranges or a row say so, or if all factors of it keep their signs.
        """
        return self._find(e, is_strict) > 0

    def keeps(self, e: Expression) -> bool:
        """Returns whether an expression keeps its sign, and is never 0."""
        return self._find(e, is_strict=True) != 0

    def _find(self, e: Expression, is_strict: bool) -> int:
        """Returns the sign that an expression keeps, 0 if none."""
        for sign in (1, -1):
            own = e if sign > 0 else -e
            if is_above(own, 0.0, self._ranges, is_strict) or self._is_row_above(own, is_strict):
                return sign
        kind = e.get_kind()
        if kind == ExpressionKind.Div:
            above, below = operands(e)
            return self._find(below, True) and self._find(above, is_strict) * self._find(
                below, True
            )
        if kind == ExpressionKind.Mul:
            return math.prod(self._find(each, is_strict) for each in operands(e))
        return 0

    def _is_row_above(self, e: Expression, is_strict: bool) -> bool:
        """Returns whether a row says that e is above 0."""
        own = e.Expand()
        return any(
            not (rest := own - side).GetVariables()
            and ((least := bound + rest.Evaluate()) > 0.0 or (least == 0.0 and not is_strict))
            for side, bound in self._sides
        )

    @cached_property
    def _sides(self) -> list[tuple[Expression, float]]:
        """Formulas, and what they are not below."""
        return [
            (side.Expand(), bound)
            for formula, low, high in self._rows
            for side, bound in ((formula, low), (-formula, -high))
            if math.isfinite(bound)
        ]
