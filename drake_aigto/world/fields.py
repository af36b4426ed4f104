"""Typed fields of frozen dataclasses, checked as they are set."""

from __future__ import annotations

import math
from numbers import Real
from typing import TypeGuard, overload

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats, read_only
from drake_aigto.errors import ScenarioError


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


class VectorField:
    """A dataclass field that takes a scalar or a sequence and holds a read-only array (n,)."""

    def __set_name__(self, owner: type, name: str) -> None:
        """Learns the field's name."""
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type) -> VectorField: ...
    @overload
    def __get__(self, instance: object, owner: type) -> Floats: ...
    def __get__(self, instance: object, owner: type) -> object:
        """Returns the array."""
        if instance is None:
            # So a dataclass sees that the field has no default.
            raise AttributeError(self._name)
        return instance.__dict__[self._name]

    def __set__(self, instance: object, value: ArrayLike) -> None:
        """Checks and stores; a frozen dataclass calls this once, from ``__init__``."""
        instance.__dict__[self._name] = as_vector(self._name, value)
