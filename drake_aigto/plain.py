"""Dataclasses to plain JSON values and back, by cattrs; and files, written whole or not at all.

Floats are written so that they read back to the same bits, NaN and infinity as Python's JSON has
them; arrays are lists of lists. A class with methods
`to_plain` and `from_plain` of its own is written and read by these.
"""

from __future__ import annotations

import json
import os
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin

import numpy as np

from drake_aigto.errors import AigtoError, DamagedDataError, OutputFileError

if TYPE_CHECKING:
    from cattrs import Converter


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a text file whole or not at all (`write_bytes`)."""
    write_bytes(path, text.encode())


def write_bytes(path: str | os.PathLike[str], data: bytes) -> None:
    """Writes a file whole or not at all: to a neighbor first, which then takes its name.

    Raises:
        OutputFileError: it can't be written.
    """
    path = Path(path)
    temporary = _temporary(path)
    try:
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        raise _refuse_output(path, error.strerror or error) from error
    finally:
        temporary.unlink(missing_ok=True)


def check_writable(*paths: str | os.PathLike[str] | None) -> None:
    """Refuses files that could not be written once long work is done; None passes.

    Raises:
        OutputFileError: a folder does not exist or may not be written to, or a file is a folder.
    """
    for path in (Path(each) for each in paths if each is not None):
        if path.is_dir():
            raise _refuse_output(path, "a folder")
        if not path.parent.is_dir():
            raise _refuse_output(path, f"no folder {path.parent}")
        temporary = _temporary(path)
        try:
            temporary.touch()
            temporary.unlink()
        except OSError as error:
            raise _refuse_output(path, error.strerror or error) from error


def _temporary(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")


def _refuse_output(path: Path, reason: object) -> OutputFileError:
    return OutputFileError(
        f"{path} can't be written",
        got=reason,
        remedy="Name a file in a folder that exists and may be written to.",
    )


_T = TypeVar("_T")

# Metadata of a dataclass's field that is left out: written and read otherwise, or not at all.
LEFT_OUT = {"plain": False}


def called(key: str) -> dict[str, str]:
    """Returns metadata of a dataclass's field that has another name among plain values."""
    return {"plain": key}


_EXPECTED = {str: "text", bool: "true or false", int: "a whole number", float: "a number"}


def to_plain(value: object) -> Any:
    """Returns a dataclass, or what has dataclasses in it, as dicts, lists, numbers and text."""
    return _converter().unstructure(value)


def from_plain(kind: type[_T], data: object, name: str | None = None) -> _T:
    """Returns the value that `to_plain` was given.

    Args:
        kind: its type; every field has to be of the type that it is annotated with.
        data: plain values.
        name: of the value, for errors; that of its type if None.

    Raises:
        DamagedDataError: a missing or unknown field, or one that does not fit; names it.
    """
    try:
        return _converter().structure(data, kind)
    except Exception as error:  # Whatever a constructor raises, its field does not fit.
        raise _explain(error, name or kind.__name__) from error


def read_json(path: str | os.PathLike[str], what: str, refuse: type[AigtoError]) -> Any:
    """Returns what is in a JSON file.

    Args:
        path: of the file.
        what: it is, such as "plan file".
        refuse: the error that is raised if it can't be read, or is cut short or no JSON.
    """
    try:
        return json.loads(Path(path).read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise refuse(
            f"{what} {path} is cut short or no JSON", got=error, remedy="Make it again."
        ) from error
    except (OSError, UnicodeDecodeError) as error:
        raise refuse(f"{what} {path} can't be read", got=error) from error


@cache
def _converter() -> Converter:
    # Loaded with the first file, not with this package.
    from cattrs import Converter
    from cattrs.gen import make_dict_structure_fn, make_dict_unstructure_fn
    from cattrs.strategies import use_class_methods

    converter = Converter(forbid_extra_keys=True, unstruct_collection_overrides={tuple: list})
    for kind in _EXPECTED:
        converter.register_structure_hook(kind, _check)
    converter.register_structure_hook_func(_is_choice, _check_choice)
    converter.register_unstructure_hook_func(_is_array, np.ndarray.tolist)
    converter.register_structure_hook_func(_is_array, lambda data, _: np.array(data, dtype=float))
    converter.register_unstructure_hook_factory(
        _is_special, lambda kind: make_dict_unstructure_fn(kind, converter, **_overrides(kind))
    )
    converter.register_structure_hook_factory(
        _is_special,
        lambda kind: make_dict_structure_fn(
            kind, converter, _cattrs_forbid_extra_keys=True, **_overrides(kind)
        ),
    )
    use_class_methods(converter, "from_plain", "to_plain")
    return converter


def _is_special(kind: Any) -> bool:
    return bool(is_dataclass(kind) and _overrides(kind))


def _overrides(kind: Any) -> dict[str, Any]:
    """Returns cattrs' overrides: the fields that are left out, or have another name."""
    from cattrs.gen import override

    keys = {field.name: field.metadata["plain"] for field in fields(kind) if field.metadata}
    return {name: override(rename=key or None, omit=not key) for name, key in keys.items()}


def _is_array(kind: Any) -> bool:
    return np.ndarray in (kind, get_origin(kind))


def _is_choice(kind: Any) -> bool:
    return get_origin(kind) is Literal


def _check(value: Any, kind: type[Any]) -> Any:
    """Returns a number or text, which cattrs would make of nearly everything."""
    if type(value) is kind or (kind is float and type(value) is int):
        return kind(value)
    raise _refuse(value, _EXPECTED[kind])


def _check_choice(value: Any, kind: Any) -> Any:
    """Returns one of the values of a `Literal`."""
    if value in (choices := get_args(kind)):
        return value
    raise _refuse(value, f"one of {', '.join(map(repr, choices))}")


def _refuse(value: Any, expected: str) -> DamagedDataError:
    return DamagedDataError("", got=repr(value), expected=expected)  # `_explain` names the field.


def _explain(error: BaseException, path: str) -> DamagedDataError:
    """Returns the error that names the first field that does not fit, and says why."""
    from cattrs import ClassValidationError, ForbiddenExtraKeysError, IterableValidationError

    if isinstance(error, ClassValidationError | IterableValidationError):
        inside, others = error.group_exceptions()
        if not inside:
            return _explain(others[0], path)
        inner, note = inside[0]
        name = getattr(note, "name", None)
        return _explain(inner, f"{path}.{name}" if name else f"{path}[{note.index!r}]")
    if isinstance(error, ForbiddenExtraKeysError):
        unknown = ", ".join(sorted(error.extra_fields))
        return DamagedDataError(path, f"unknown {unknown}", f"fields of {error.cl.__name__}")
    if isinstance(error, KeyError):
        return DamagedDataError(path, got="nothing", expected="a value")
    if isinstance(error, DamagedDataError) and not error.what:
        return DamagedDataError(path, error.got, error.expected)
    return DamagedDataError(path, got=error)
