"""Ranges of Drake's symbolic expressions over boxes."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Mapping

from pydrake.symbolic import Expression, ExpressionKind

from drake_aigto.solver.ranges import Range, cosine_range, power_range, product
from drake_aigto.terms import operands

# By a variable's id.
Ranges = Mapping[int, Range]

_ALL = (-math.inf, math.inf)
_MOST_SPLITS = 500


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

    def fails(low: float) -> bool:
        return low <= bound if is_strict else low < bound

    variables = [variable.get_id() for variable in e.GetVariables()]
    box = {i: ranges.get(i, _ALL) for i in variables}
    queue = [(interval(e, box)[0], 0, box)]
    for number in range(1, 2 * _MOST_SPLITS, 2):
        low, _, box = heapq.heappop(queue)
        if not fails(low):
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


def _add(*parts: Range) -> Range:
    return math.fsum(low for low, _ in parts), math.fsum(high for _, high in parts)


def _multiply(*parts: Range) -> Range:
    found = 1.0, 1.0
    for part in parts:
        found = product(*found, *part)
    return found


def _divide(a: Range, b: Range) -> Range:
    if b[0] <= 0.0 <= b[1]:
        return _ALL
    return product(*a, 1.0 / b[1], 1.0 / b[0])


def _raise(base: Range, exponent: Range) -> Range:
    low, high = base
    p = exponent[0]
    if exponent[0] != exponent[1]:
        return _ALL
    if p == int(p) and p >= 0:
        return power_range(low, high, int(p))
    if p == int(p):
        return _divide((1.0, 1.0), _raise(base, (-p, -p)))
    if low < 0.0:
        return _ALL
    return _monotone(lambda y: _power(y, p))(base) if p > 0.0 or low > 0.0 else _ALL


def _power(base: float, exponent: float) -> float:
    try:
        return math.pow(base, exponent)
    except OverflowError:
        return math.inf


def _exp(y: float) -> float:
    return math.exp(y) if y < 700.0 else math.inf


def _monotone(function: Callable[[float], float]) -> Callable[[Range], Range]:
    """Returns the rule of a function that rises or falls everywhere."""

    def rule(y: Range) -> Range:
        ends = function(y[0]), function(y[1])
        return min(ends), max(ends)

    return rule


def _abs(y: Range) -> Range:
    low, high = y
    least = 0.0 if low <= 0.0 <= high else min(abs(low), abs(high))
    return least, max(abs(low), abs(high))


def _log(y: Range) -> Range:
    if y[0] < 0.0:
        return _ALL
    return tuple(math.log(end) if end > 0.0 else -math.inf for end in y)  # type: ignore[return-value]


def _cosine(y: Range) -> Range:
    return cosine_range(*y)


def _sine(y: Range) -> Range:
    return cosine_range(y[0] - math.pi / 2, y[1] - math.pi / 2)


_RULES: Mapping[ExpressionKind, Callable[..., Range]] = {
    ExpressionKind.Add: _add,
    ExpressionKind.Mul: _multiply,
    ExpressionKind.Div: _divide,
    ExpressionKind.Pow: _raise,
    ExpressionKind.Exp: _monotone(_exp),
    ExpressionKind.Log: _log,
    ExpressionKind.Sqrt: lambda y: _raise(y, (0.5, 0.5)),
    ExpressionKind.Abs: _abs,
    ExpressionKind.Cos: _cosine,
    ExpressionKind.Sin: _sine,
    ExpressionKind.Tan: lambda y: _divide(_sine(y), _cosine(y)),
    ExpressionKind.Max: lambda a, b: (max(a[0], b[0]), max(a[1], b[1])),
    ExpressionKind.Min: lambda a, b: (min(a[0], b[0]), min(a[1], b[1])),
    ExpressionKind.Tanh: _monotone(math.tanh),
    ExpressionKind.Atan: _monotone(math.atan),
    ExpressionKind.Asin: _monotone(lambda y: math.asin(min(1.0, max(-1.0, y)))),
    ExpressionKind.Acos: _monotone(lambda y: math.acos(min(1.0, max(-1.0, y)))),
}
