"""Ranges and signs of Drake's expressions over boxes, by interval arithmetic without rounding."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property

from pydrake.symbolic import Expression, ExpressionKind

from drake_aigto.solver.ranges import Range, cosine_range, power_range, product
from drake_aigto.terms import operands

_ALL = (-math.inf, math.inf)
_MOST_SPLITS = 500

# By a variable's id.
Ranges = Mapping[int, Range]
# A row g, and its lower and upper bound.
RowRange = tuple[Expression, float, float]


def interval(e: Expression, ranges: Ranges) -> Range:
    """Returns bounds of an expression, term by term; all numbers where it may be undefined.

    Args:
        e: of sums, products, quotients, powers, roots, and functions of one argument.
        ranges: of its variables; those that are missing may be anything.
    """
    kind = e.get_kind()
    if kind == ExpressionKind.Constant:
        return e.Evaluate(), e.Evaluate()
    if kind == ExpressionKind.Var:
        (variable,) = e.GetVariables()
        return ranges.get(variable.get_id(), _ALL)
    if kind not in _RULES:
        return _ALL
    low, high = _RULES[kind](*(interval(each, ranges) for each in operands(e)))
    return _ALL if math.isnan(low) or math.isnan(high) else (low, high)


def is_above(e: Expression, bound: float, ranges: Ranges, is_strict: bool) -> bool:
    """Returns whether an expression is shown to be above a bound, halving its widest variables.

    Args:
        e: the expression.
        bound: the least value.
        ranges: of its variables; one without two ends is not halved.
        is_strict: whether the bound itself is too low.
    """
    box = {v.get_id(): ranges.get(v.get_id(), _ALL) for v in e.GetVariables()}
    queue = [(interval(e, box)[0], 0, box)]
    for number in range(1, 2 * _MOST_SPLITS, 2):
        low, _, box = heapq.heappop(queue)
        if low > bound or (low == bound and not is_strict):
            return True
        widths = {i: b - a for i, (a, b) in box.items() if math.isfinite(b - a) and b > a}
        if not widths:
            return False
        widest = max(widths, key=widths.__getitem__)
        a, b = box[widest]
        for half, part in enumerate(((a, (a + b) / 2), ((a + b) / 2, b))):
            smaller = {**box, widest: part}
            heapq.heappush(queue, (interval(e, smaller)[0], number + half, smaller))
    return False


class Signs:
    """Signs that expressions keep, by ranges of their variables, also later ones, and by rows."""

    def __init__(self, rows: Iterable[RowRange], ranges: Ranges) -> None:
        """Keeps them."""
        self._rows, self._ranges = rows, ranges

    def find(self, e: Expression, is_strict: bool = True) -> int:
        """Returns the sign, 1 or −1, that an expression keeps; 0 if none is known.

        It is known from ranges, from a row, or from the signs of all factors. Unless it is strict,
        the expression may also be 0.
        """
        for sign in (1, -1):
            own = e if sign > 0 else -e
            if is_above(own, 0.0, self._ranges, is_strict) or self._is_row_above(own, is_strict):
                return sign
        kind = e.get_kind()
        if kind == ExpressionKind.Div:
            above, below = operands(e)
            sign = self.find(below)
            return sign and self.find(above, is_strict) * sign
        if kind == ExpressionKind.Mul:
            return math.prod(self.find(each, is_strict) for each in operands(e))
        return 0

    def _is_row_above(self, e: Expression, is_strict: bool) -> bool:
        """Returns whether a row says that e is above 0."""
        own = _expanded(e)
        return any(
            not (rest := own - side).GetVariables()
            and ((least := bound + rest.Evaluate()) > 0.0 or (least == 0.0 and not is_strict))
            for side, bound in self._sides
        )

    @cached_property
    def _sides(self) -> list[tuple[Expression, float]]:
        """Formulas, and their lower bounds."""
        return [
            (_expanded(side), bound)
            for formula, low, high in self._rows
            for side, bound in ((formula, low), (-formula, -high))
            if math.isfinite(bound)
        ]


def _expanded(e: Expression) -> Expression:
    """Returns e with its products multiplied out, unless Drake has no value of a factor."""
    try:
        return e.Expand()
    except ValueError:  # Of (−x)^0.3 it takes the root of −1.
        return e


def _multiply(*parts: Range) -> Range:
    found = 1.0, 1.0
    for part in parts:
        found = product(*found, *part)
    return found


def _divide(a: Range, b: Range) -> Range:
    return _ALL if b[0] <= 0.0 <= b[1] else product(*a, 1.0 / b[1], 1.0 / b[0])


def _raise(base: Range, exponent: Range) -> Range:
    low, high = base
    p = exponent[0]
    if exponent[0] != exponent[1]:
        return _ALL
    if p == int(p):
        if p >= 0:
            return power_range(low, high, int(p))
        return _divide((1.0, 1.0), _raise(base, (-p, -p)))
    if low < 0.0 or (p < 0.0 and low == 0.0):
        return _ALL
    return _monotone(lambda y: _power(y, p))(base)


def _power(base: float, exponent: float) -> float:
    try:
        return math.pow(base, exponent)
    except OverflowError:
        return math.inf


def _monotone(function: Callable[[float], float]) -> Callable[[Range], Range]:
    """Returns the rule of a function that rises or falls everywhere."""
    return lambda y: (min(map(function, y)), max(map(function, y)))


def _abs(y: Range) -> Range:
    low, high = y
    least = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    return least, max(abs(low), abs(high))


def _sine_range(y: Range) -> Range:
    return cosine_range(y[0] - math.pi / 2, y[1] - math.pi / 2)


def _log(y: float) -> float:
    return math.log(y) if y > 0.0 else -math.inf


_RULES: Mapping[ExpressionKind, Callable[..., Range]] = {
    ExpressionKind.Add: lambda *y: (math.fsum(a for a, _ in y), math.fsum(b for _, b in y)),
    ExpressionKind.Mul: _multiply,
    ExpressionKind.Div: _divide,
    ExpressionKind.Pow: _raise,
    ExpressionKind.Exp: _monotone(lambda y: math.exp(y) if y < 700.0 else math.inf),
    ExpressionKind.Log: lambda y: _ALL if y[0] < 0.0 else _monotone(_log)(y),
    ExpressionKind.Sqrt: lambda y: _raise(y, (0.5, 0.5)),
    ExpressionKind.Abs: _abs,
    ExpressionKind.Cos: lambda y: cosine_range(*y),
    ExpressionKind.Sin: lambda y: _sine_range(y),
    ExpressionKind.Tan: lambda y: _divide(_sine_range(y), cosine_range(*y)),
    ExpressionKind.Max: lambda a, b: (max(a[0], b[0]), max(a[1], b[1])),
    ExpressionKind.Min: lambda a, b: (min(a[0], b[0]), min(a[1], b[1])),
    ExpressionKind.Tanh: _monotone(math.tanh),
    ExpressionKind.Atan: _monotone(math.atan),
    ExpressionKind.Asin: _monotone(lambda y: math.asin(min(1.0, max(-1.0, y)))),
    ExpressionKind.Acos: _monotone(lambda y: math.acos(min(1.0, max(-1.0, y)))),
}
