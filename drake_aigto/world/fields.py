"""Typed fields of frozen dataclasses, checked as they are set."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any, Generic, TypeGuard, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, locked, read_only
from drake_aigto.errors import ScenarioError

_Held = TypeVar("_Held")
_NEEDED = object()  # The default of a field that has none.

# Of the largest eigenvalue: what rounding makes of zero.
_ROUNDING = 1e-12


def as_number(
    name: str,
    value: object,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
    unit: str = "",
) -> float:
    """Returns a finite float within bounds.

    Raises:
        ScenarioError: not a number (a bool is none), NaN, infinite, or out of bounds.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ScenarioError(name, got=f"{value!r} ({type(value).__name__})", expected="a number")
    try:
        number = float(value)
    except OverflowError:  # An integer of hundreds of digits.
        number = math.inf
    if not math.isfinite(number):
        raise ScenarioError(name, got=number, expected="a finite number")
    if not (above < number and at_least <= number <= at_most):
        bounds = (("more than", above), ("at least", at_least), ("at most", at_most))
        expected = " and ".join(f"{text} {x:g}" for text, x in bounds if math.isfinite(x))
        raise ScenarioError(
            name, got=f"{number:g} {unit}".strip(), expected=f"{expected} {unit}".strip()
        )
    return number


def as_vector(name: str, value: object) -> Floats:
    """Returns a read-only array (n,) of finite floats, n ≥ 1, from a scalar or a sequence.

    Raises:
        ScenarioError: not numbers, NaN or infinity among them, empty, or of two dimensions.
    """
    if _is_fine(value):
        return read_only(value)
    items = np.array(value, dtype=object, ndmin=1)
    if items.ndim != 1 or items.size == 0:
        raise ScenarioError(
            name,
            got=f"an array of shape {items.shape}",
            expected="a number, or a sequence of one number per coordinate",
        )
    return read_only([as_number(name, item) for item in items])


def _is_fine(value: object) -> TypeGuard[Floats]:
    """Returns whether a value is such an array already, as that of another scenario is."""
    if not (isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim == 1):
        return False
    return value.size > 0 and bool(np.isfinite(value).all())


def as_weight(
    name: str, value: object, *, above: float = -math.inf, at_least: float = -math.inf
) -> float | Floats:
    """Returns a weight on a vector's square: a number for all coordinates, or one for each, (n,).

    Raises:
        ScenarioError: not numbers, NaN or infinity among them, or one out of bounds.
    """
    if isinstance(value, Real):
        return as_number(name, value, above=above, at_least=at_least)
    weights = as_vector(name, value)
    for weight in weights:
        as_number(name, weight, above=above, at_least=at_least)
    return float(weights[0]) if weights.size == 1 else weights


def as_weight_matrix(name: str, value: object) -> float | Floats:
    """Returns such a weight, not below zero, or a symmetric positive semidefinite matrix, (n, n).

    Raises:
        ScenarioError: neither of these.
    """
    if not (_is_sequence(value) and any(map(_is_sequence, value))):
        return as_weight(name, value, at_least=0.0)
    matrix = as_table(name, value)
    if matrix.shape[0] != matrix.shape[1] or np.any(matrix != matrix.T):
        raise ScenarioError(
            name,
            got=f"a matrix {matrix.tolist()}",
            expected="a number, one for each coordinate, or a symmetric matrix",
            remedy="Of any other matrix W, (W + Wᵀ)/2 weighs the same.",
        )
    if matrix.size == 1:
        return as_weight(name, matrix[0], at_least=0.0)
    least, most = np.linalg.eigvalsh(matrix)[[0, -1]]
    if least < -_ROUNDING * max(most, 0.0):
        raise ScenarioError(
            name,
            got=f"a matrix with the eigenvalue {least:g}",
            expected="none below 0",
            remedy="A cost that falls without end has no optimum.",
        )
    return matrix


def as_bound(name: str, value: object) -> float | Floats:
    """Returns a bound for all coordinates, or one for each, (n,); ±inf where there is none.

    Raises:
        ScenarioError: not numbers, or NaN among them.
    """
    items = np.array(value, dtype=object, ndmin=1)
    is_infinite = [isinstance(item, Real) and item in (math.inf, -math.inf) for item in items]
    finite = [0.0 if skip else item for item, skip in zip(items, is_infinite, strict=True)]
    bounds = np.where(is_infinite, items, as_vector(name, finite)).astype(float)
    return float(bounds[0]) if bounds.size == 1 else locked(bounds)


def as_sizes(name: str, value: object) -> Floats:
    """Returns a read-only array (n,) of finite floats that are not below zero.

    Raises:
        ScenarioError: not numbers, or one of them is below zero, NaN or infinite.
    """
    sizes = as_vector(name, value)
    for size in sizes:
        as_number(name, size, at_least=0.0)
    return sizes


def as_table(name: str, value: object) -> Floats:
    """Returns a read-only array (K, n) of finite floats; of numbers, one a row.

    Raises:
        ScenarioError: not numbers, not finite, empty, or rows that differ in length.
    """
    rows = value if _is_sequence(value) else [value]
    table = [as_vector(name, row) for row in rows]
    if len({len(row) for row in table}) != 1:
        raise ScenarioError(
            name, got=f"{value!r}", expected="rows of numbers, one for each coordinate"
        )
    return read_only(table)


def _is_sequence(value: object) -> TypeGuard[Sequence[Any]]:
    """Returns whether a value has items, which a text is not taken for."""
    if isinstance(value, np.ndarray):
        return value.ndim > 0
    return isinstance(value, Sequence) and not isinstance(value, str)


def as_range(name: str, value: object, unit: str) -> tuple[float, float]:
    """Returns the least and the most of a quantity above zero, least ≤ most.

    Raises:
        ScenarioError: not two numbers, or the least is not above zero or is more than the most.
    """
    ends = as_vector(name, value)
    if len(ends) != 2:
        raise ScenarioError(name, got=ends.tolist(), expected="the least and the most")
    least, most = (as_number(name, end, above=0.0, unit=unit) for end in ends)
    if least > most:
        raise ScenarioError(
            name, got=f"from {least:g} to {most:g} {unit}", expected="the least first"
        )
    return least, most


def as_flag(name: str, value: object) -> bool:
    """Returns True or False.

    Raises:
        ScenarioError: something else.
    """
    if isinstance(value, bool | np.bool_):
        return bool(value)
    raise ScenarioError(name, got=repr(value), expected="true or false")


def as_choice(name: str, value: object, choices: tuple[str, ...]) -> str:
    """Returns one of the choices.

    Raises:
        ScenarioError: something else.
    """
    if isinstance(value, str) and value in choices:
        return value
    raise ScenarioError(name, got=repr(value), expected=f"one of {', '.join(map(repr, choices))}")


def as_names(name: str, value: object) -> tuple[str, ...]:
    """Returns texts as a tuple, from a sequence of them.

    Raises:
        ScenarioError: something else, a single text or an empty one among them.
    """
    if isinstance(value, list | tuple) and all(isinstance(each, str) and each for each in value):
        return tuple(value)
    raise ScenarioError(name, got=repr(value), expected="a list of names")


class ArrayField(Generic[_Held]):
    """A dataclass field that is checked, and holds what its check makes of a value.

    Args:
        check: given the field's name and a value, returns what is held, or raises.
        default: what is held if nothing is given, unchecked; without it, a value is needed. A field
            whose default is None takes None.
    """

    def __init__(self, check: Callable[[str, object], _Held], default: Any = _NEEDED) -> None:
        """Stores the check and the default."""
        self._check, self._default = check, default

    def __set_name__(self, owner: type, name: str) -> None:
        """Learns the field's name."""
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> ArrayField[_Held]: ...
    @overload
    def __get__(self, instance: object, owner: type) -> _Held: ...
    def __get__(self, instance: object, owner: type) -> object:
        """Returns what is held; of the class, the default."""
        if instance is not None:
            return instance.__dict__[self._name]
        if self._default is _NEEDED:
            raise AttributeError(self._name)  # So a dataclass sees that there is no default.
        return self._default

    def __set__(self, instance: object, value: ArrayLike | None) -> None:
        """Checks and stores; a frozen dataclass calls this once, from ``__init__``."""
        is_default = value is self._default
        instance.__dict__[self._name] = value if is_default else self._check(self._name, value)
