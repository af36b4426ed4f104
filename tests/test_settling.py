"""Finalists in space whose motion is lost in shorter steps are left soon."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drake_aigto.planning import settle
from drake_aigto.shooting import IMPLICIT

COST = 2.0


class Problem:
    """Closes any motion at the given costs, in turn, and keeps the options it was asked with."""

    mechanism = None  # As in a plane, one way to close gaps without states.
    cost_scale = 100.0

    def __init__(self, costs: list[float]) -> None:
        self.costs, self.asked = costs, list[Any]()

    def solve(self, controls: Any, states: Any, options: Any, prices: Any) -> Any:
        self.asked.append(options)
        cost = self.costs[min(len(self.asked), len(self.costs)) - 1]
        wide = options.rungs[0]
        return motion(cost, options.substeps, is_left=cost > min(wide.most, options.most_promised))


def motion(cost: float, substeps: int, is_left: bool = False) -> Any:
    return SimpleNamespace(
        controls=np.zeros((1, 1)),
        states=None,
        prices=None,
        cost=cost,
        exact_cost=cost,
        substeps=substeps,
        order=IMPLICIT,
        is_left=is_left,
        violation=0.0,
        replay=None,
    )


def follow(costs: list[float], monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Problem]:
    steady = "drake_aigto.planning.mechanisms.closing.steady"
    monkeypatch.setattr(steady, lambda world, scenario, problem, found: found)
    nothing: Any = None
    problem: Any = Problem(costs)
    return settle(nothing, nothing, problem, motion(COST, 4), np.inf), problem


def test_a_motion_that_is_lost_in_shorter_steps_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    found, problem = follow([COST, 50 * COST], monkeypatch)
    assert found.cost == COST
    assert [each.substeps for each in problem.asked] == [4, 8]
    assert problem.asked[0].rungs[0].most == np.inf  # Before, its cost says little.


def test_a_motion_that_costs_somewhat_more_in_shorter_steps_is_followed_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, problem = follow([COST, 3 * COST], monkeypatch)
    steps = [(each.substeps, each.order) for each in problem.asked]
    assert steps == [(count, IMPLICIT) for count in (4, 8, 16, 32, 64)]
