"""Which fields of a task contradict each other, or would count for nothing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import ScenarioError

if TYPE_CHECKING:
    from drake_aigto.world.scenario import Scenario


def check_task(scenario: Scenario) -> None:
    """Refuses what contradicts itself, or counts for nothing, whatever the model.

    Raises:
        ScenarioError: names the field.
    """
    for quantity in ("position", "velocity", "control"):
        _check_bounds(scenario, quantity)
    _check_duration(scenario)
    _check_reference(scenario)
    if scenario.goal_velocity is not None and not _weighs_goal_velocity(scenario):
        raise ScenarioError(
            "goal_velocity",
            got="no weight on it",
            expected="goal_velocity_weight or velocity_weight above 0, or hard_goal",
            remedy="Give one of these; without them it counts for nothing.",
        )
    if scenario.contact == "compliant" and scenario.restitution != 1.0:
        raise ScenarioError(
            "restitution",
            got=f"{scenario.restitution:g} with compliant contact",
            expected="none, as compliant walls lose what the model's dissipation takes",
            remedy="Leave it out, or ask for contact: rigid.",
        )


def _weighs_goal_velocity(scenario: Scenario) -> bool:
    """Returns whether the goal's velocity counts: at the end, or on the way without reference."""
    if scenario.hard_goal or np.any(scenario.goal_velocity_weight):
        return True
    return scenario.reference_velocities is None and bool(np.any(scenario.velocity_weight))


def _check_bounds(scenario: Scenario, quantity: str) -> None:
    """Refuses a lower bound above the upper one, and bounds that leave nothing."""
    names = f"{quantity}_lower", f"{quantity}_upper"
    bounds = [getattr(scenario, name) for name in names]
    lower, upper = (
        none if bound is None else np.atleast_1d(bound)
        for bound, none in zip(bounds, (-np.inf, np.inf), strict=True)
    )
    if np.size(lower) != np.size(upper) and min(np.size(lower), np.size(upper)) > 1:
        raise ScenarioError(
            names[0],
            got=f"{np.size(lower)} numbers, and {np.size(upper)} in {names[1]}",
            expected="as many in both, or one number for all",
        )
    for least, most in np.broadcast(lower, upper):
        if not least <= most or least == np.inf or most == -np.inf:
            raise ScenarioError(
                names[0],
                got=f"{least:g}, with {names[1]} = {most:g}",
                expected="a lower bound that is not above the upper one",
            )


def _check_duration(scenario: Scenario) -> None:
    """Refuses a duration outside its range."""
    if scenario.duration_range is None:
        return
    least, most = scenario.duration_range
    if not least <= scenario.duration <= most:
        raise ScenarioError(
            "duration",
            got=f"{scenario.duration:g} s",
            expected=f"within duration_range, {least:g} to {most:g} s",
            remedy="The search starts from it.",
        )


def _check_reference(scenario: Scenario) -> None:
    """Refuses a reference without times, of another number of rows, or without a weight."""
    times, tables = scenario.reference_times, dict(_find_references(scenario))
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


def _find_references(scenario: Scenario) -> Iterator[tuple[str, Floats]]:
    """Yields the references that are given, each by its name; refuses one that counts nothing."""
    for name, table, weighed_by in (
        ("reference_positions", scenario.reference_positions, "position_weight"),
        ("reference_velocities", scenario.reference_velocities, "velocity_weight"),
    ):
        if table is None:
            continue
        if not np.any(getattr(scenario, weighed_by)):
            raise ScenarioError(
                name,
                got=f"{weighed_by} = 0",
                expected=f"a {weighed_by} above 0",
                remedy="Without it the reference counts for nothing.",
            )
        yield name, table
