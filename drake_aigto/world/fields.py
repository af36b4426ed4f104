"""Typed fields of frozen dataclasses, checked as they are set; and checks of several at once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from numbers import Real
from typing import Any, Generic, TypeGuard, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, locked, read_only
from drake_aigto.errors import ScenarioError

_Held = TypeVar("_Held")
_NEEDED = object()  # The default of a field that has none.

# Whole numbers of steps are recognized up to this relative error: 1.0 / 0.005 is not 200 exactly.
_STEP_TOLERANCE = 1e-9
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
    """Returns a finite float within bounds."""
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


def as_vector(name: str, value: Any, **bounds: Any) -> Floats:
    """Returns a read-only array (n,) of finite floats, n ≥ 1, from a scalar, a sequence or a row.

    Bounds of each are those of `as_number`.

    Raises:
        ScenarioError: not numbers, NaN or infinity among them, empty, of two dimensions, or one
            out of bounds.
    """
    is_array = isinstance(value, np.ndarray) and value.dtype == np.float64 and value.ndim == 1
    # An array of finite numbers already, as that of another scenario is.
    if not (is_array and np.size(value) and np.isfinite(value).all()):
        items = np.array(value, dtype=object, ndmin=1)
        items = items[0] if items.ndim == 2 and len(items) == 1 else items
        if items.ndim != 1 or items.size == 0:
            raise ScenarioError(
                name,
                got=f"an array of shape {items.shape}",
                expected="a number, or a sequence of one number per coordinate",
            )
        value = [as_number(name, item) for item in items]
    vector = read_only(value)
    for number in vector if bounds else ():
        as_number(name, number, **bounds)
    return vector


def as_weight(name: str, value: object, **bounds: float) -> float | Floats:
    """Returns a weight on a vector's square: a number for all coordinates, or one for each, (n,).

    Raises:
        ScenarioError: as `as_vector` does.
    """
    weights = as_vector(name, value, **bounds)
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
    """Returns a bound for all coordinates, or one for each, (n,); ±inf where there is none."""
    items = np.array(value, dtype=object, ndmin=1)
    is_infinite = [isinstance(item, Real) and item in (math.inf, -math.inf) for item in items]
    finite = [0.0 if skip else item for item, skip in zip(items, is_infinite, strict=True)]
    bounds = np.where(is_infinite, items, as_vector(name, finite)).astype(float)
    return float(bounds[0]) if bounds.size == 1 else locked(bounds)


def as_table(name: str, value: object) -> Floats:
    """Returns a read-only array (K, n) of finite floats; of numbers, one per row."""
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
    """Returns the least and the most of a quantity above zero, least ≤ most."""
    ends = as_vector(name, value)
    if len(ends) != 2:
        raise ScenarioError(name, got=ends.tolist(), expected="the least and the most")
    least, most = (as_number(name, end, above=0.0, unit=unit) for end in ends)
    if least > most:
        raise ScenarioError(
            name, got=f"from {least:g} to {most:g} {unit}", expected="the least first"
        )
    return least, most


def as_names(name: str, value: object) -> tuple[str, ...]:
    """Returns texts as a tuple, from a sequence of them."""
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


def check_steps(duration: float, time_step: float) -> None:
    """Refuses a duration that is no whole number of time steps."""
    steps = duration / time_step
    if not math.isfinite(steps):
        raise ScenarioError(
            "time_step",
            got=f"{time_step:g} s for a duration of {duration:g} s",
            expected="a number of steps that can be counted",
        )
    if round(steps) >= 1 and abs(steps - round(steps)) <= _STEP_TOLERANCE * steps:
        return
    fewer, more = max(1, math.floor(steps)), math.ceil(steps)
    durations = " or ".join(f"{n * time_step:.12g} s" for n in sorted({fewer, more}))
    time_steps = " or ".join(f"{duration / n:.12g} s" for n in sorted({fewer, more}))
    raise ScenarioError(
        "duration",
        got=f"{duration:.12g} s, which is {steps:.6g} steps of {time_step:.12g} s",
        expected="a whole number of time steps",
        remedy=f"The nearest that fit: duration {durations}, or time_step {time_steps}.",
    )


def check_counts(name: str, weighed_by: Mapping[str, Any], what: str) -> None:
    """Refuses a field that is given, where all that would weigh it is zero or false."""
    if any(np.any(weight) for weight in weighed_by.values()):
        return
    raise ScenarioError(
        name,
        got=", ".join(f"{other} = {weight}" for other, weight in weighed_by.items()),
        expected=f"{what} that counts",
        remedy=f"Without {' or '.join(weighed_by)} it counts for nothing.",
    )


def check_size(name: str, values: Floats, size: int) -> None:
    """Refuses a vector, or rows of a table or a matrix, of another size than the model's."""
    got = values.shape[-1]
    if got != size:
        of_what = "actuator" if name == "control_weight" else "coordinate"
        raise ScenarioError(
            name,
            got=f"{got} value{'s' if got > 1 else ''}{' a row' if values.ndim > 1 else ''}",
            expected=f"{size}, one for each {of_what} of the model",
        )


def check_bounds(quantity: str, least: Any, most: Any) -> None:
    """Refuses a lower bound above the upper one, and bounds that leave nothing.

    Each is a number, an array, None, or by names, which are checked once they are an array.

    Raises:
        ScenarioError: they are crossed, or of different sizes.
    """
    if isinstance(least, Mapping) or isinstance(most, Mapping):
        return
    name, other = f"{quantity}_lower", f"{quantity}_upper"
    lower = np.atleast_1d(-np.inf if least is None else least)
    upper = np.atleast_1d(np.inf if most is None else most)
    if lower.size != upper.size and min(lower.size, upper.size) > 1:
        raise ScenarioError(
            name,
            got=f"{lower.size} numbers, and {upper.size} in {other}",
            expected="as many in both, or one number for all",
        )
    for low, high in np.broadcast(lower, upper):
        if low > high or low == np.inf or high == -np.inf:
            raise ScenarioError(
                name,
                got=f"{low:g}, with {other} = {high:g}",
                expected="a lower bound that is not above the upper one",
            )


def check_reference(times: Floats | None, tables: Mapping[str, Floats]) -> None:
    """Refuses a reference without times, times alone, and tables of another number of rows."""
    if times is None and not tables:
        return
    if times is None or not tables:
        raise ScenarioError(
            "reference_times",
            got="none" if times is None else "them alone",
            expected="times, with reference_positions or reference_velocities at them",
        )
    if np.any(np.diff(times) <= 0):
        raise ScenarioError("reference_times", got=times.tolist(), expected="increasing times")
    for name, table in tables.items():
        if len(table) != len(times):
            raise ScenarioError(
                name, got=f"{len(table)} rows", expected=f"{len(times)}, one for each time"
            )
