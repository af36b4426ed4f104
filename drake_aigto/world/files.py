"""Files of models and scenarios: the shipped ones and the user's."""

from __future__ import annotations

import difflib
import os
from collections.abc import Mapping
from functools import cache
from importlib import resources
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import yaml
from pydrake.common.yaml import yaml_load_data
from pydrake.multibody.parsing import PackageMap

from drake_aigto.errors import ModelError, ScenarioError

_URI_SCHEME = "package://"
# Python packages of the extra "models", in which scenarios find models; and where they have what
# is a package for ROS.
_OF_EXTRA = {
    **dict.fromkeys(("gymnasium", "dm_control"), ""),
    "example-robot-data": "cmeel.prefix/share/example-robot-data",
}
# Fields of a scenario that are texts; all others are made of numbers.
_TEXTS = (
    *("model", "angles", "contact", "ignored_shapes", "packages", "fixed_joints", "actuators"),
    *("limits", "collisions", "allow_ignored", "weightless"),
)


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
    for package in (name for name, folder in _OF_EXTRA.items() if folder):
        if found := _find_installed(package):
            packages.Add(package, str(found))
    return packages


@cache
def _find_installed(package: str) -> Path | None:
    """Returns the folder of an installed Python package, or of what it has for ROS."""
    if folder := _OF_EXTRA.get(package):
        try:
            found = Path(str(distribution(package).locate_file(folder)))
        except PackageNotFoundError:
            return None
        return found if found.is_dir() else None
    python = find_spec(package) if package.isidentifier() else None
    places = python and python.submodule_search_locations
    return Path(places[0]) if places else None


def find_packages(model: Path, given: Mapping[str, str]) -> PackageMap:
    """Returns the packages of a model: all that are known, given ones, and those above its file."""
    packages = package_map()
    for name, folder in given.items():
        path = Path(folder).expanduser()
        if not path.is_dir():
            raise ModelError(f"package {name!r}", got=f"no folder {path}", expected="its folder")
        if packages.Contains(name):
            packages.Remove(name)
        packages.Add(name, str(path.resolve()))
    for parent in model.resolve().parents:
        if (parent / "package.xml").is_file() and parent != models_directory():
            name = read_xml(parent / "package.xml").findtext("name", parent.name).strip()
            for known_as in {name, parent.name}:  # ROS 1 goes by the name, others by the folder.
                if not packages.Contains(known_as):
                    packages.Add(known_as, str(parent))
    return packages


def find_file(uri: str, path: Path, packages: PackageMap) -> Path | None:
    """Returns the file of a URI in a model's file; None in a package that is unknown."""
    scheme, _, rest = uri.strip().partition("://")
    if not rest:
        return path.parent / uri.strip()
    if scheme == "file":
        return Path(rest)
    package, _, inside = rest.lstrip("/").partition("/")
    return Path(packages.GetPath(package)) / inside if packages.Contains(package) else None


def package_of(uri: str) -> str:
    """Returns the package that a URI is in."""
    return uri.partition("://")[2].lstrip("/").partition("/")[0]


def read_xml(path: Path) -> Element:
    """Returns the root of an XML file, with prefixes in its names, such as ``drake:mu_static``.

    Drake's parser knows its own elements by their prefix; ElementTree would give them another one.
    """
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise ModelError(f"model {path}", got=f"no XML: {error}") from error
    return builder.close()


def find_model(model: str) -> Path:
    """Returns the file of a model: a ``package://`` URI, or a path to what Drake parses.

    Raises:
        ModelError: unknown package, or no such file.
    """
    if model.startswith(_URI_SCHEME):
        package, _, relative = model.removeprefix(_URI_SCHEME).partition("/")
        path = _find_package(model, package) / relative
    else:
        path = Path(model).expanduser()
    if not path.is_file():
        raise ModelError(
            f"model {model}",
            got=f"no file {path}",
            expected="an SDF, URDF or MJCF file",
            remedy="A path leads from the folder of the scenario's file, or from the working "
            f"directory. The shipped ones lie in {models_directory()}.",
        )
    return path


def _find_package(model: str, package: str) -> Path:
    """Returns the folder of a package: Drake's, ours, or that of an installed Python package."""
    packages = package_map()
    if packages.Contains(package):
        return Path(packages.GetPath(package))
    if found := _find_installed(package):
        return found
    check_installed(model, package)
    raise ModelError(
        f"model {model}",
        got=f"the unknown package {package!r}",
        expected=f"one of {', '.join(sorted(packages.GetPackageNames()))}, or an installed "
        "Python package",
        remedy="Name a model of your own by its path.",
    )


def check_installed(model: str, package: str) -> None:
    """Refuses a model in a package of the extra "models" that is not installed."""
    if package in _OF_EXTRA and not _find_installed(package):
        raise ModelError(
            f"model {model}",
            got=f"the Python package {package!r}, which is not installed",
            remedy="Install the extra that brings it: pip install 'drake_aigto[models]'.",
        )


def scenario_files() -> dict[str, Path]:
    """Returns the files of all shipped scenarios, by name, sorted."""
    directory = models_directory() / "scenarios"
    paths = directory.glob("**/*.yaml")
    return dict(sorted((p.relative_to(directory).with_suffix("").as_posix(), p) for p in paths))


def scenario_names() -> list[str]:
    """Returns the names of the shipped scenarios whose models are installed, sorted.

    Some are of models in other packages, which the extra "models" brings.
    """
    missing = [f"package://{name}/" for name in _OF_EXTRA if not _find_installed(name)]
    texts = {name: path.read_text("utf-8") for name, path in scenario_files().items()}
    for scene in models_directory().glob("*.dmd.yaml"):
        uses = {name for name, text in texts.items() if scene.name in text}
        texts |= {name: texts[name] + scene.read_text("utf-8") for name in uses}
    return [name for name, text in texts.items() if not any(each in text for each in missing)]


def scenario_seconds() -> dict[str, float]:
    """Returns how long a plan takes for shipped scenarios, by name, as measured [CPU s]."""
    path = models_directory() / "seconds.yaml"
    return yaml.safe_load(path.read_text("utf-8")) if path.exists() else {}


def scenario_summaries() -> dict[str, str]:
    """Returns the names of all shipped scenarios, and what each shows: its file's first line."""
    lines = {
        name: path.read_text("utf-8").splitlines()[0] for name, path in scenario_files().items()
    }
    return {name: line.lstrip("# ").rstrip(".") for name, line in lines.items()}


def suggest(word: str, known: list[str]) -> str | None:
    """Returns the known word that is meant, as a question, if one is near."""
    close = difflib.get_close_matches(word, known, n=1)
    return f"Did you mean {close[0]!r}?" if close else None


def refuse_name(what: str, name: str, known: list[str], got: object = None) -> ScenarioError:
    """Returns the error of a name that is none of the known ones."""
    return ScenarioError(what, got, f"one of {', '.join(known)}", hint=suggest(name, known))


def read_scenario(path: str | os.PathLike[str]) -> object:
    """Returns what is in a YAML file; what is no text may be numbers.

    A model's path from the file's folder, if the model is there, leads from the working directory.
    """
    try:
        data = yaml_load_data(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError(f"scenario file {path} can't be read", got=error) from error
    except yaml.YAMLError as error:
        raise ScenarioError(
            f"{path} is not valid YAML", got=" ".join(str(error).split())
        ) from error
    if not isinstance(data, dict):
        return data
    fields = {k: v if k in _TEXTS else _parse_numbers(v) for k, v in data.items()}
    model = fields.get("model")
    if isinstance(model, str) and (beside := Path(path).parent / model).is_file():
        fields["model"] = str(beside)
    return fields


def _parse_numbers(value: object) -> object:
    """Reads numbers that YAML 1.1 takes for text, such as 1e-3; leaves anything else alone."""
    if isinstance(value, list):
        return [_parse_numbers(item) for item in value]
    if isinstance(value, dict):
        return {key: _parse_numbers(item) for key, item in value.items()}
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value
