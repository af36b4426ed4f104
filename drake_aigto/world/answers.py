"""All at once: what keeps a model from being read, and fields of the scenario that answer it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import yaml

from drake_aigto.errors import AigtoError, ModelError
from drake_aigto.world.model_facts import FixableError
from drake_aigto.world.scenario import Scenario

_MOST = 8  # Answers; there are fewer kinds of errors that have one.


def gather(
    read: Callable[[Scenario], object], scenario: Scenario, first: FixableError
) -> FixableError:
    """Returns an error of all that is wrong, with one remedy: answers are tried one after another.

    Args:
        read: reads the model as a scenario says, or raises.
        scenario: as it was given.
        first: what was raised for it.
    """
    found: list[AigtoError] = [first]
    answers: dict[str, Any] = {}
    for _ in range(_MOST):
        if not isinstance(last := found[-1], FixableError):
            break
        answers = _add(scenario, answers, last.fields)
        try:
            read(dataclasses.replace(scenario, **answers))
        except AigtoError as error:
            if isinstance(error, ModelError):
                found.append(error)
                continue
        break
    if len(found) == 1:
        return first
    name = f"model {scenario.model}"
    text = yaml.safe_dump(answers, default_flow_style=True, width=10_000).strip()
    rest = found[-1]
    left = "" if isinstance(rest, FixableError) else f" What is left: {rest.remedy or 'the last'}"
    return FixableError(
        name,
        got="; ".join(f"{error.what}: {error.got}".removeprefix(f"{name}: ") for error in found),
        remedy=f"These fields of the scenario answer that: {text}, or change the model.{left}",
        fields=answers,
    )


def _add(scenario: Scenario, answers: dict[str, Any], more: dict[str, Any]) -> dict[str, Any]:
    """Returns answers with others, beside what the scenario has."""
    added = dict(answers)
    for name, value in more.items():
        own = added.get(name, getattr(scenario, name))
        if isinstance(value, dict):
            added[name] = {**own, **value}
        elif isinstance(value, list):
            added[name] = list(dict.fromkeys([*own, *value]))
        else:
            added[name] = value
    return added
