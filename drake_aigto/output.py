"""Files that are written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path

from drake_aigto.errors import OutputFileError


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


def check_writable(path: str | os.PathLike[str] | None) -> None:
    """Refuses a file that could not be written once long work is done; None passes.

    Raises:
        OutputFileError: its folder does not exist or may not be written to, or it is a folder.
    """
    if path is None:
        return
    path = Path(path)
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
