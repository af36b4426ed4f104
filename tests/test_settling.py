"""How finalists in space are settled: what begins from their states, and what is left soon."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from drake_aigto.contact import TreeMechanism
from drake_aigto.errors import ProgramError
from drake_aigto.planning import close_gaps, settle, steady
from drake_aigto.shooting import IMPLICIT, ShootingOptions

COST = 2.0


class Problem:
    """Closes any motion at the given costs, in turn, and keeps the options it was asked with."""

    mechanism: Any = None  # As in a plane.
    cost_scale = 100.0

    def __init__(self, costs: list[float]) -> None:
        self.costs, self.asked = costs, list[Any]()

    def solve(self, controls: Any, states: Any, options: Any, prices: Any) -> Any:
        self.asked.append(options)
        cost = self.costs[min(len(self.asked), len(self.costs)) - 1]
        wide = options.rungs[0]
        return motion(cost, options.substeps, is_left=cost > min(wide.most, options.most_promised))


def motion(cost: float, substeps: int, is_left: bool = False, is_converged: bool = False) -> Any:
    return SimpleNamespace(
        controls=np.zeros((1, 1)),
        states=None,
        prices=None,
        cost=cost,
        exact_cost=cost,
        substeps=substeps,
        order=IMPLICIT,
        is_left=is_left,
        is_converged=is_converged,
        violation=0.0,
        replay=None,
    )


def follow(costs: list[float], monkeypatch: pytest.MonkeyPatch) -> tuple[Any, Problem]:
    name, nothing = "drake_aigto.planning.mechanisms.settling.steady", cast(Any, None)
    monkeypatch.setattr(name, lambda world, scenario, problem, found: found)
    problem: Any = Problem(costs)
    return settle(nothing, nothing, problem, motion(COST, 4), np.inf), problem


def test_a_motion_that_is_lost_in_shorter_steps_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    found, problem = follow([COST, 50 * COST], monkeypatch)
    assert found.cost == COST
    assert [each.substeps for each in problem.asked] == [4, 8]
    assert problem.asked[0].rungs[0].most == np.inf  # Before, its cost says little.


@pytest.mark.parametrize(
    ("costs", "best", "steps"),
    [
        ([COST, 3 * COST], COST, (4, 8)),
        ([COST, 0.9 * COST, 0.895 * COST, 0.1], 0.895 * COST, (4, 8, 16)),
        ([COST * 0.9**k for k in range(6)], COST * 0.9**4, (4, 8, 16, 32, 64)),
    ],
)
def test_steps_are_halved_as_long_as_that_lowers_the_cost_by_more_than_a_hundredth(
    costs: list[float], best: float, steps: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    found, problem = follow(costs, monkeypatch)
    assert found.cost == best
    asked = [(each.substeps, each.order) for each in problem.asked]
    assert asked == [(count, IMPLICIT) for count in steps]


@pytest.mark.parametrize(
    ("share", "steps"), [(1.005, [4]), (0.995, [4]), (1.03, [4, 8]), (1.2, [4, 8])]
)
def test_what_costs_as_much_under_the_law_needs_no_shorter_steps(
    share: float, steps: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    def simulate(_: Any, __: Any, ___: Any, found: Any) -> Any:
        return SimpleNamespace(**{**vars(found), "exact_cost": share * found.cost})

    monkeypatch.setattr("drake_aigto.planning.mechanisms.settling.steady", simulate)
    nothing, problem = cast(Any, None), cast(Any, Problem([COST]))

    def solve(_: Any, __: Any, options: Any, ___: Any) -> Any:
        problem.asked.append(options)
        return motion(COST, options.substeps, is_converged=True)

    problem.solve = solve
    found = settle(nothing, nothing, problem, motion(COST, 4), np.inf)
    assert found.exact_cost == share * COST
    assert [each.substeps for each in problem.asked] == steps


@pytest.mark.parametrize(
    ("exact", "best", "steps"),
    [([400.0, 390.0, 2.0], 390.0, [4, 32]), ([400.0, 150.0, 2.0], 2.0, [4, 32, 64])],
)
def test_what_the_law_wrecks_has_far_shorter_steps_while_they_halve_its_cost(
    exact: list[float], best: float, steps: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    left = iter(exact)

    def simulate(_: Any, __: Any, ___: Any, found: Any) -> Any:
        return SimpleNamespace(**{**vars(found), "exact_cost": next(left)})

    monkeypatch.setattr("drake_aigto.planning.mechanisms.settling.steady", simulate)
    nothing, problem = cast(Any, None), cast(Any, Problem([COST]))
    found = settle(nothing, nothing, problem, motion(COST, 4), np.inf)
    assert found.exact_cost == best
    assert [each.substeps for each in problem.asked] == steps


@pytest.mark.parametrize(
    ("order", "ways"), [(IMPLICIT, ["alone", "wary", "whole"]), (4, ["whole", "wary", "alone"])]
)
def test_steps_of_another_order_begin_from_the_states(order: int, ways: list[str]) -> None:
    problem, found = Problem([50 * COST]), motion(COST, 4)
    problem.mechanism = TreeMechanism.__new__(TreeMechanism)
    asked = []

    def solve(controls: Any, states: Any, options: Any, prices: Any) -> Any:
        asked.append("alone" if states is None else "wary" if options.is_wary else "whole")
        return Problem.solve(problem, controls, states, options, prices)

    other: Any = SimpleNamespace(mechanism=problem.mechanism, solve=solve)
    options = ShootingOptions(order=order)
    close_gaps(other, found, found.controls, np.zeros((2, 2)), options)
    assert asked == ways
    limits = [each.rungs[0].most for each in problem.asked]
    assert limits == ([1.05 * COST] * 2 if order == IMPLICIT else [np.inf] * 2) + [np.inf]


def test_feedback_is_about_the_states_of_a_motion() -> None:
    asked = []

    def resolve(controls: Any, substeps: int, states: Any = None, order: int = 4) -> Any:
        asked.append((substeps, states, order))
        raise ProgramError("controls", got="enough", expected="no more")

    problem: Any = SimpleNamespace(resolve=resolve)
    nothing: Any = None
    found = motion(COST, 4)
    found.states = np.ones((2, 2))
    with pytest.raises(ProgramError):
        steady(nothing, nothing, problem, found)
    assert asked == [(4, found.states, IMPLICIT)]
