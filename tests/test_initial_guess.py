"""A motion that a user proposes: one proposal among those of the search."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from marks import slow

from drake_aigto import PlanOptions, Scenario, plan
from drake_aigto.errors import TrajectoryError

FEW: dict[str, Any] = {"renewals": 0, "starts": 1, "confirm": False}
PENDULUM = Scenario.named("pendulum/off_the_wall")


@pytest.mark.parametrize(
    ("name", "share"), [("cart_pole/soft_10", 0.95), *slow(("cart_pole/rigid_10", 1.0))]
)
def test_a_motion_that_is_known_is_led_on(name: str, share: float) -> None:
    """One start alone finds less."""
    scenario = Scenario.named(name)
    known = plan(scenario, PlanOptions(renewals=8, confirm=False))
    found = plan(scenario, PlanOptions(**FEW), initial_guess=known.trajectory)
    assert str(found.best.origin) == "the given guess"
    assert found.cost < known.cost * (1 + 1e-3)
    assert found.cost < share * plan(scenario, PlanOptions(**FEW)).cost


def test_the_touches_of_a_guess_are_a_candidate_of_balls() -> None:
    scenario = Scenario.named("table1/1")
    known = plan(scenario)
    found = plan(scenario, initial_guess=known.trajectory)
    assert "the given guess" in [str(each.origin) for each in found.candidates]
    assert found.cost == pytest.approx(known.cost, rel=1e-9)


@pytest.mark.slow
def test_guesses_that_fit_nothing_are_refused_before_the_search() -> None:
    known = plan(PENDULUM, PlanOptions(**FEW))
    other = Scenario.named("cart_pole/rigid_06")
    motion = known.trajectory
    twice = dataclasses.replace(motion, times=2 * np.asarray(motion.times))
    refused: tuple[tuple[Scenario, Any, str], ...] = (
        (PENDULUM, known, "initial_guess: got Plan, expected a Trajectory. Of a plan, give its"),
        (PENDULUM, twice, f"from 0 to {2 * PENDULUM.duration:g} s, expected from 0 to"),
        (other, motion, r"initial_guess: got \(1, 1, 1\) positions, controls and contacts"),
    )
    for scenario, guess, message in refused:
        with pytest.raises(TrajectoryError, match=message):
            plan(scenario, initial_guess=guess)
