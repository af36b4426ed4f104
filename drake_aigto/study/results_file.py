"""Files of results: JSON of some kind, never written over by another study."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from decimal import ROUND_DOWN, ROUND_HALF_EVEN, Context
from pathlib import Path
from typing import Any

from drake_aigto.errors import AigtoError, ResultsFileError
from drake_aigto.plain import read_json
from drake_aigto.world.files import check_writable


def check_results_file(path: str | os.PathLike[str] | None, resume: bool = False) -> bool:
    """Returns whether there is a file to go on from; None, for no file, passes.

    Raises:
        OutputFileError: the file can't be written.
        ResultsFileError: there is one, and nobody asked to go on from it.
    """
    check_writable(path)
    if path is None or not Path(path).exists():
        return False
    if not resume:
        raise ResultsFileError(
            f"results file {path}",
            got="one that exists",
            remedy="Go on from it (--resume), name another, or delete it first.",
        )
    return True


def read_results(path: str | os.PathLike[str], kind: str | None = None) -> dict[str, Any]:
    """Returns what is in a results file: a JSON object with a field "kind", of any kind if None.

    Raises:
        ResultsFileError: no such file, damaged, or of another kind.
    """
    data = read_json(path, "results file", ResultsFileError)
    found = data.get("kind") if isinstance(data, dict) else None
    if not isinstance(found, str) or kind not in (None, found):
        raise ResultsFileError(
            f"results file {path}",
            got=f"kind {found!r}",
            expected=f"kind {kind!r}" if kind else 'an object with a field "kind"',
        )
    return data


@contextmanager
def refuse_damaged(path: str | os.PathLike[str]) -> Iterator[None]:
    """Has what is wrong with the values of a results file told as its damage.

    Raises:
        ResultsFileError: something was missing, of the wrong type, or out of range.
    """
    try:
        yield
    except (AigtoError, KeyError, TypeError) as error:
        raise ResultsFileError(
            f"results file {path} is damaged",
            got=f"no {error}" if isinstance(error, KeyError) else error,
            remedy="Delete it, and measure again.",
        ) from error


def check_same_question(
    path: str | os.PathLike[str], there: Mapping[str, Any], here: Mapping[str, Any]
) -> None:
    """Refuses to go on from results whose question's fields are others than those asked for here.

    Raises:
        ResultsFileError: says which fields differ.
    """
    names = [name for name in {**here, **there} if there.get(name) != here.get(name)]
    if names:
        raise ResultsFileError(
            f"results file {path} is of another study",
            got=", ".join(f"{name} {there.get(name)}" for name in names),
            expected=", ".join(f"{name} {here.get(name)}" for name in names),
            remedy="Name another file, or ask the same question.",
        )


def round_to(value: float, digits: int, down: bool = False) -> float:
    """Returns a finite number with so many significant digits, as files of results have them.

    It is the nearest one, or the next towards 0.
    """
    rounding = ROUND_DOWN if down else ROUND_HALF_EVEN
    return float(Context(prec=digits, rounding=rounding).create_decimal(repr(float(value))))
