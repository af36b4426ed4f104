"""Types of arrays, arrays that nobody changes, and frozen records of them, equal by value."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Records = NDArray[np.void]

_Array = TypeVar("_Array", bound=NDArray[Any])


def locked(array: _Array) -> _Array:
    """Returns an array, which is read-only from now on."""
    array.setflags(write=False)
    return array


def read_only(values: ArrayLike, dtype: Any = float) -> NDArray[Any]:
    """Returns a read-only copy."""
    return locked(np.array(values, dtype=dtype))


def interpolate(at: ArrayLike, times: ArrayLike, rows: Floats) -> Floats:
    """Returns rows (K, n) at rising times (K,), linear between, at others (…), shape (…, n)."""
    at, times = np.asarray(at, dtype=float), np.asarray(times, dtype=float)
    values = np.empty((*at.shape, rows.shape[1]))
    for i, column in enumerate(rows.T):
        values[..., i] = np.interp(at, times, column)
    return values


class ArrayRecord:
    """Base of frozen dataclasses whose fields are arrays, tuples, dicts, numbers or text.

    Subclass with ``@dataclass(frozen=True, eq=False)`` and let ``__post_init__`` check the fields
    and make the arrays read-only (`read_only`).
    """

    def _fields(self) -> dict[str, Any]:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {field.name: getattr(self, field.name) for field in fields}

    def _key(self) -> tuple[object, ...]:
        """Returns the fields, arrays as their shape and values."""
        return tuple(map(_hashable, self._fields().values()))

    def __eq__(self, other: object) -> bool:
        """Two records are equal if all fields are, arrays element by element."""
        return self._key() == other._key() if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        """Hashes the fields, so that equal records hash alike."""
        return hash(self._key())

    def __reduce__(self) -> tuple[Any, tuple[()]]:
        """Pickles and copies through the constructor, so that arrays stay read-only."""
        return partial(type(self), **self._fields()), ()


class LockedArrays:
    """Base of frozen dataclasses whose arrays become read-only copies."""

    def __post_init__(self) -> None:
        """Makes the arrays read-only."""
        for name, value in vars(self).items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, read_only(value, value.dtype))


def _hashable(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.shape, *value.ravel().tolist()
    if isinstance(value, tuple):
        return tuple(map(_hashable, value))
    return frozenset(value.items()) if isinstance(value, Mapping) else value
