"""Where the shipped models lie, how a model's name becomes a file, and how files are written."""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

from pydrake.multibody.parsing import PackageMap

from drake_aigto.errors import ModelError, OutputFileError

_URI_SCHEME = "package://"


def models_directory() -> Path:
    """Returns the folder of the shipped models and scenarios.

    An installed wheel has it inside the package, a checkout next to it.

    Raises:
        ModelError: neither place has it: the installation is broken.
    """
    package = Path(str(resources.files("drake_aigto")))
    for directory in (package / "models", package.parent / "models"):
        if (directory / "package.xml").is_file():
            return directory
    raise ModelError(
        "the shipped models are missing",
        got=f"no package.xml in {package / 'models'} or {package.parent / 'models'}",
        remedy="Install drake_aigto again.",
    )


def package_map() -> PackageMap:
    """Returns Drake's packages and ours, in which ``package://drake_aigto_models/…`` is found.

    For a Parser of your own, ``parser.package_map().AddMap(package_map())``: then
    ``parser.AddModelsFromUrl(scenario.model)`` reads a shipped model, from a checkout or a wheel.
    """
    packages = PackageMap()
    packages.AddPackageXml(models_directory() / "package.xml")
    return packages


def find_model(model: str) -> Path:
    """Returns the file of a model: a ``package://`` URI, or a path to what Drake parses.

    Raises:
        ModelError: unknown package, or no such file.
    """
    if model.startswith(_URI_SCHEME):
        package, _, relative = model.removeprefix(_URI_SCHEME).partition("/")
        packages = package_map()
        if not packages.Contains(package):
            raise ModelError(
                f"model {model}",
                got=f"the unknown package {package!r}",
                expected=f"one of {', '.join(sorted(packages.GetPackageNames()))}",
                remedy="Name a model of your own by its path.",
            )
        path = Path(packages.GetPath(package)) / relative
    else:
        path = Path(model).expanduser()
    if not path.is_file():
        raise ModelError(
            f"model {model}",
            got=f"no file {path}",
            expected="an SDF or URDF file",
            remedy=f"The shipped ones lie in {models_directory()}.",
        )
    return path


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
