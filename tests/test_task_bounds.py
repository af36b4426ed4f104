"""Within which bounds a motion has to stay: the model's limits, and those of the scenario."""

from __future__ import annotations

import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import DOUBLE_PENDULUM, PASSIVE, build_world

from drake_aigto import Scenario, ScenarioError, World

LIMIT = "<limit><lower>-1</lower><upper>4</upper><velocity>5</velocity><effort>20</effort></limit>"
INF = np.inf


@cache
def arm() -> World:
    """Returns a double pendulum without walls, the first hinge of which has limits."""
    return build_world(DOUBLE_PENDULUM.replace(PASSIVE, LIMIT))


def ask(**fields: Any) -> Scenario:
    ends = {"initial_position": [0.0, 0.0], "initial_velocity": [0.0, 0.0]}
    return Scenario(**{**ends, "goal_position": [3.0, 0.0], **fields})


def test_without_bounds_of_the_scenario_the_models_count() -> None:
    bounds = arm().bounds(ask())
    assert bounds is arm().limits
    np.testing.assert_array_equal(bounds.position, [[-1.0, -INF], [4.0, INF]])
    np.testing.assert_array_equal(bounds.control, [[-20.0, -INF], [20.0, INF]])


def test_the_narrower_of_both_bounds_counts_coordinate_by_coordinate() -> None:
    bounds = arm().bounds(
        ask(
            position_lower=[-2.0, -1.5],
            position_upper=[3.5, INF],
            velocity_upper=6.0,
            control_lower=-3.0,
            control_upper=[30.0, 2.0],
        )
    )
    np.testing.assert_array_equal(bounds.position, [[-1.0, -1.5], [3.5, INF]])
    np.testing.assert_array_equal(bounds.velocity, [[-5.0, -INF], [5.0, 6.0]])
    np.testing.assert_array_equal(bounds.control, [[-3.0, -3.0], [20.0, 2.0]])
    assert not bounds.control.flags.writeable
    np.testing.assert_array_equal(arm().limits.control[0], [-20.0, -INF])


@pytest.mark.parametrize("turns", [-2, -1, 1, 2])
def test_a_goal_of_an_angle_may_be_turns_beyond_the_bounds_where_turns_do_not_count(
    turns: int,
) -> None:
    goal = [3.0 + 2 * np.pi * turns, 0.0]
    for angles in ("modulo", "chordal"):
        arm().check(ask(goal_position=goal, angles=angles))
    with pytest.raises(ScenarioError, match=r"goal_position\[0\]: got .* from -1 to 4"):
        arm().check(ask(goal_position=goal))
    with pytest.raises(ScenarioError, match=r"goal_position\[0\]: got .* from -1 to 2"):
        arm().check(ask(goal_position=goal, angles="modulo", position_upper=2.0))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"position_lower": 0.5}, "initial_position[0]: got 0, expected from 0.5 to 4, by its joi"),
        ({"position_upper": 2.0}, "goal_position[0]: got 3, expected from -1 to 2"),
        ({"velocity_lower": [-INF, 1.0]}, "initial_velocity[1]: got 0, expected from 1 to inf"),
        (
            {"goal_velocity": [6.0, 0.0], "goal_velocity_weight": 1.0},
            "goal_velocity[0]: got 6, expected from -5 to 5",
        ),
        ({"control_upper": [1.0] * 3}, "control_upper: got 3 values, expected 2, or one for all"),
        (
            {"control_lower": [30.0, 0.0]},
            "control_lower and control_upper, [0]: got nothing from 30 to 20, expected bounds "
            "within the model's limits, -20 to 20",
        ),
    ],
)
def test_bounds_that_leave_out_what_is_asked_are_refused(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        arm().check(ask(**fields))
