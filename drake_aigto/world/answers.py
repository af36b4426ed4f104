"""All at once: what keeps a model from being read, and fields of the scenario that answer it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import yaml

from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.world.model_facts import FixableError
from drake_aigto.world.scenario import Scenario

_MOST = 8  # Answers; there are fewer kinds of errors that have one.


def find_errors(*checks: Callable[[], object]) -> list[ModelError]:
    """Returns what checks raise that do not depend on each other."""
    found = []
    for check in checks:
        try:
            check()
        except ModelError as error:
            found.append(error)
    return found


def gather(
    find: Callable[[Scenario], list[ModelError]], scenario: Scenario, first: FixableError
) -> FixableError:
    """Returns an error of all that is wrong, with one remedy: answers are tried one after another.

    Args:
        find: returns what is wrong with the model as a scenario says it.
        scenario: as it was given.
        first: what was raised for it.
    """
    found: list[ModelError] = [first]
    errors: list[ModelError] = [first]
    answers: dict[str, Any] = {}
    for _ in range(_MOST):
        for error in errors:
            answers = _add(scenario, answers, getattr(error, "fields", {}))
        try:
            errors = find(dataclasses.replace(scenario, **answers))
        except ScenarioError:
            break
        told = set(map(str, found))
        errors = [error for error in errors if str(error) not in told]
        found += errors
        if not errors or not all(isinstance(error, FixableError) for error in errors):
            break
    if len(found) == 1:
        return first
    name = f"model {scenario.model}"
    text = yaml.safe_dump(answers, default_flow_style=True, width=10_000).strip()
    rest = found[-1]
    left = "" if isinstance(rest, FixableError) else f" What is left: {rest.remedy or 'the last'}"
    if scenario.contact == "rigid" and answers.keys() & {"weld", "fixed_joints"}:
        left += " With contact: compliant, links may float, and joints may be many."
    return FixableError(
        name,
        got="; ".join(
            f"{error.what}: {error.got}".removeprefix(f"{name}: ").removesuffix(": None")
            for error in found
        ),
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
