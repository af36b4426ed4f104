"""Which parts of a task contradict each other, or would count for nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import ScenarioError


def check_counts(name: str, weighed_by: Mapping[str, Any], what: str) -> None:
    """Refuses a field that is given, where all that would weigh it is zero or false.

    Raises:
        ScenarioError: it counts for nothing; says what would count.
    """
    if any(np.any(weight) for weight in weighed_by.values()):
        return
    raise ScenarioError(
        name,
        got=", ".join(f"{other} = {weight}" for other, weight in weighed_by.items()),
        expected=f"{what} that counts",
        remedy=f"Without {' or '.join(weighed_by)} it counts for nothing.",
    )


def check_bounds(quantity: str, least: float | Floats | None, most: float | Floats | None) -> None:
    """Refuses a lower bound above the upper one, and bounds that leave nothing.

    Raises:
        ScenarioError: they are crossed, or of different sizes.
    """
    name, other = f"{quantity}_lower", f"{quantity}_upper"
    lower = np.atleast_1d(-np.inf if least is None else least)
    upper = np.atleast_1d(np.inf if most is None else most)
    if lower.size != upper.size and min(lower.size, upper.size) > 1:
        raise ScenarioError(
            name,
            got=f"{lower.size} numbers, and {upper.size} in {other}",
            expected="as many in both, or one number for all",
        )
    for low, high in np.broadcast(lower, upper):
        if low > high or low == np.inf or high == -np.inf:
            raise ScenarioError(
                name,
                got=f"{low:g}, with {other} = {high:g}",
                expected="a lower bound that is not above the upper one",
            )


def check_duration(duration: float, ends: tuple[float, float]) -> None:
    """Refuses a duration outside its range.

    Raises:
        ScenarioError: it is.
    """
    least, most = ends
    if not least <= duration <= most:
        raise ScenarioError(
            "duration",
            got=f"{duration:g} s",
            expected=f"within duration_range, {least:g} to {most:g} s",
            remedy="The search starts from it.",
        )


def check_reference(times: Floats | None, tables: Mapping[str, Floats]) -> None:
    """Refuses a reference without times, times alone, and tables of another number of rows.

    Raises:
        ScenarioError: times and tables do not go together.
    """
    if times is None and not tables:
        return
    if times is None or not tables:
        raise ScenarioError(
            "reference_times",
            got="none" if times is None else "them alone",
            expected="times, with reference_positions or reference_velocities at them",
        )
    if np.any(np.diff(times) <= 0):
        raise ScenarioError("reference_times", got=times.tolist(), expected="increasing times")
    for name, table in tables.items():
        if len(table) != len(times):
            raise ScenarioError(
                name, got=f"{len(table)} rows", expected=f"{len(times)}, one for each time"
            )
