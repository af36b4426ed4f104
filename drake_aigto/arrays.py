"""Types of arrays, and arrays that nobody changes."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Records = NDArray[np.void]

_Array = TypeVar("_Array", bound=NDArray[Any])


def locked(array: _Array) -> _Array:
    """Returns an array, which is read-only from now on."""
    array.setflags(write=False)
    return array
