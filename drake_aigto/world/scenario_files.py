"""Files of scenarios: the shipped ones, and YAML."""

from __future__ import annotations

import difflib
import os
from pathlib import Path

import yaml
from pydrake.common.yaml import yaml_load_data

from drake_aigto.errors import ScenarioError
from drake_aigto.world.files import models_directory

# Everything else in a file is made of numbers.
_TEXTS = ("model", "angles", "contact", "ignored_shapes")


def scenario_names() -> list[str]:
    """Returns the names that `Scenario.named` knows, sorted."""
    directory = scenarios_directory()
    paths = directory.glob("**/*.yaml")
    return sorted(path.relative_to(directory).with_suffix("").as_posix() for path in paths)


def scenarios_directory() -> Path:
    """Returns where the shipped scenarios lie."""
    return models_directory() / "scenarios"


def suggest(word: str, known: list[str]) -> str | None:
    """Returns the known word that is meant, as a question, if one is near."""
    close = difflib.get_close_matches(word, known, n=1)
    return f"Did you mean {close[0]!r}?" if close else None


def read_scenario(path: str | os.PathLike[str]) -> object:
    """Returns what is in a YAML file; what is no text may be numbers."""
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
    return {k: v if k in _TEXTS else _parse_numbers(v) for k, v in data.items()}


def _parse_numbers(value: object) -> object:
    """Reads numbers that YAML 1.1 takes for text, such as 1e-3; leaves anything else alone."""
    if isinstance(value, list):
        return [_parse_numbers(item) for item in value]
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value
