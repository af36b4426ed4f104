"""Plans whose duration is free, against what calculus says of a cart that has to keep a pace."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import WORLD_AT, build_world, joint, link
from scipy.optimize import minimize_scalar

from drake_aigto import Plan, Planner, Scenario, World
from drake_aigto.planning import PlanOptions
from drake_aigto.show import format_plan

DISTANCE, PACE, WEIGHT = 1.0, 0.8, 3.0
QUICK = PlanOptions(renewals=8, finalists=1)


@cache
def cart() -> World:
    return build_world(link("cart", 1.0, WORLD_AT) + joint("prismatic", "world", "cart", "1 0 0"))


def ask(least: float, most: float, **changed: Any) -> Scenario:
    """Returns the task of a cart at rest that has to go a DISTANCE, and to get to its PACE."""
    fields: dict[str, Any] = {
        "initial_position": [0.0],
        "initial_velocity": [0.0],
        "goal_position": [DISTANCE],
        "goal_velocity": [PACE],
        "hard_goal": True,
        "control_weight": 1.0,
        "velocity_weight": WEIGHT,
        "duration": 1.0,
        "time_step": 0.02,
        "duration_range": (least, most),
    }
    return Scenario(**{**fields, **changed})


@cache
def plan(least: float, most: float) -> Plan:
    return Planner(ask(least, most), QUICK, cart()).plan()


def calc_cost(T: float) -> float:
    """Returns the least ∫ u² + W w² of a speed's error w, w(0) = −PACE, w(T) = 0, in a time.

    As Lagrange has it, w″ = W w + p, so w = A cosh kt + B sinh kt + C with k² = W, and ∫ w is
    what the DISTANCE is beyond PACE·T.
    """
    k, times = np.sqrt(WEIGHT), np.linspace(0.0, T, 4001)
    waves = np.array([np.cosh(k * times), np.sinh(k * times), np.ones_like(times)])
    sums = [np.sinh(k * T) / k, (np.cosh(k * T) - 1) / k, T]
    parts = np.linalg.solve(
        np.array([waves[:, 0], waves[:, -1], sums]), [-PACE, 0.0, DISTANCE - PACE * T]
    )
    w, u = parts @ waves, k * (parts[0] * waves[1] + parts[1] * waves[0])
    return float(np.trapezoid(u**2 + WEIGHT * w**2, times))


def test_a_free_duration_is_that_which_calculus_says() -> None:
    best = minimize_scalar(calc_cost, bounds=(0.5, 4.0), method="bounded")
    found = plan(0.5, 4.0)
    assert found.holds
    assert 1.1 < best.x < 3.5  # Neither where the search starts nor at an end.
    assert found.trajectory.times[-1] == pytest.approx(best.x, rel=0.01)
    # Held controls cost more, by the square of their steps.
    assert best.fun * (1 - 1e-4) < found.cost < best.fun * (1 + 2e-3)


def test_all_simulations_last_as_long_as_the_plan() -> None:
    found = plan(0.5, 4.0)
    T = found.trajectory.times[-1]
    assert len(found.trajectory.controls) == found.scenario.num_steps
    for replay in (*found.replay, *found.replayed().replay):
        assert replay.times[-1] == pytest.approx(T, rel=1e-9)
        assert replay.cost == pytest.approx(found.cost, rel=1e-4)
        assert replay.positions[-1, 0] == pytest.approx(DISTANCE, abs=1e-3)


@pytest.mark.parametrize(("least", "most", "end"), [(0.5, 1.1, "most"), (1.0, 1.0, "least")])
def test_a_duration_at_the_end_of_its_range_is_told(least: float, most: float, end: str) -> None:
    found = plan(least, most)
    assert found.trajectory.times[-1] == pytest.approx(most if end == "most" else least, rel=1e-6)
    assert found.cost == pytest.approx(calc_cost(found.trajectory.times[-1]), rel=2e-3)
    assert f"the {end} that it may be" in format_plan(found)


def test_a_swing_up_off_a_wall_takes_the_time_that_is_best() -> None:
    """With as much time as its scenario has by default, it costs more."""
    given = Scenario.named("cart_pole/soft_06")
    free = dataclasses.replace(given, duration=1.0, duration_range=(1.0, 2.0))
    planner = Planner(free, QUICK)
    found, at_first = (
        planner.plan(),
        Planner(dataclasses.replace(free, duration_range=None), QUICK, planner.world).plan(),
    )
    assert found.holds
    assert found.cost < at_first.cost
    assert found.replay.drake is not None
    assert found.replay.drake.cost == pytest.approx(found.cost, rel=1e-3)
