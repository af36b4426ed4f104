"""A task in other units is the same task: the same touches at the same parts of its duration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scaled_worlds import Factors, scale_scenario

from drake_aigto import PlanOptions, Scenario, World, plan
from drake_aigto.planning import Candidate, needs_shooting

# Ten and a hundred times as large, heavy or long-lasting, and as small; where gravity counts,
# lengths go with the square of times.
ANY = (Factors(0.1, 10.0, 100.0), Factors(100.0, 0.01, 10.0), Factors(0.01, 1.0, 1.0))
FALLING = (Factors(100.0, 10.0, 10.0), Factors(0.01, 0.1, 0.1))


def check(name: str, all_factors: tuple[Factors, ...], options: PlanOptions, folder: Path) -> None:
    """Plans in each of these units, and compares."""

    def find(factors: Factors) -> Candidate:
        return plan(scale_scenario(name, folder, factors), options).best

    shipped = find(Factors(1.0, 1.0, 1.0))
    for factors in all_factors:
        best = find(factors)
        assert best.cost == pytest.approx(shipped.cost, rel=1e-6), factors
        assert best.replay.cost == pytest.approx(shipped.replay.cost, rel=1e-6), factors
        assert [each.index for each in best.contacts] == [each.index for each in shipped.contacts]
        times = [[each.time for each in found.contacts] for found in (best, shipped)]
        assert np.array(times[0]) / factors.time == pytest.approx(times[1], rel=1e-6)


BALLS = PlanOptions(confirm=False)
FEW = PlanOptions(confirm=False, starts=6, renewals=8, search_steps=30)


def test_a_ball_in_other_units_has_the_same_plan(tmp_path: Path) -> None:
    scenario = Scenario.named("table1/1")
    assert not needs_shooting(World.from_scenario(scenario), scenario)
    check("table1/1", ANY, BALLS, tmp_path)


@pytest.mark.slow
def test_an_acrobot_in_other_units_has_the_same_plan(tmp_path: Path) -> None:
    check("acrobot/swing_up", FALLING, FEW, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factors"), [("corridor/lossy", ANY), ("two_masses/apart", ANY)])
def test_balls_between_walls_in_other_units_have_the_same_plan(
    name: str, factors: tuple[Factors, ...], tmp_path: Path
) -> None:
    check(name, factors, BALLS, tmp_path)
