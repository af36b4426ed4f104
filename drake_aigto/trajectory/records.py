"""Frozen records of arrays: equal by value, and to JSON and back without losing a bit."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from drake_aigto.errors import AigtoError, PlanFileError

if TYPE_CHECKING:
    import numpy.typing as npt

_Record = TypeVar("_Record", bound="ArrayRecord")


def read_only(values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Returns a read-only copy, as floats."""
    array = np.array(values, dtype=float)
    array.flags.writeable = False
    return array


class ArrayRecord:
    """Base of frozen dataclasses whose fields are arrays, tuples, numbers or text.

    Subclass with ``@dataclass(frozen=True, eq=False)`` and let ``__post_init__`` check the fields
    and make the arrays read-only (`read_only`).
    """

    def to_dict(self) -> dict[str, Any]:
        """Returns the fields as lists, numbers and text, ready for JSON.

        Python writes floats so that they read back exactly: ``from_dict`` returns an equal record.
        """
        return {name: _plain(value) for name, value in self._fields().items()}

    @classmethod
    def from_dict(cls: type[_Record], data: object) -> _Record:
        """Returns the record that `to_dict` gave.

        Raises:
            PlanFileError: not a mapping, a missing or an unknown key, or a value that does not fit.
        """
        if not isinstance(data, dict):
            raise PlanFileError(cls.__name__, got=type(data).__name__, expected="a mapping")
        names = {field.name for field in dataclasses.fields(cls)}  # type: ignore[arg-type]
        if set(data) != names:
            missing, unknown = sorted(names - set(data)), sorted(set(data) - names, key=str)
            raise PlanFileError(
                cls.__name__,
                got=", ".join([f"no {key}" for key in missing] + [f"{key!r}" for key in unknown]),
                expected=f"the keys {', '.join(sorted(names))}",
                remedy="The file was cut short, or another version wrote it.",
            )
        try:
            return cls(**data)
        except (AigtoError, TypeError, ValueError) as error:
            raise PlanFileError(f"{cls.__name__} can't be read", got=error) from error

    def _fields(self) -> dict[str, Any]:
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {field.name: getattr(self, field.name) for field in fields}

    def __eq__(self, other: object) -> bool:
        """Two records are equal if all fields are, arrays element by element."""
        return self.to_dict() == other.to_dict() if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        """Hashes the fields, so that equal records hash alike."""
        return hash(tuple(_hashable(value) for value in self.to_dict().values()))

    def __reduce__(self) -> tuple[Any, tuple[()]]:
        """Pickles and copies through the constructor, so that arrays stay read-only."""
        return partial(type(self), **self._fields()), ()


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray):
        return value.tolist()
    return list(value) if isinstance(value, tuple) else value


def _hashable(value: object) -> object:
    return tuple(_hashable(item) for item in value) if isinstance(value, list) else value
