"""Questions drawn by seed: which they are, and what is told of plans."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.questions import NEAR, WIDE, Asked, Row, draw, format_results
from drake_aigto import Scenario, World
from drake_aigto.errors import ScenarioError

ROW = Row("cart_pole/soft_06", 0, 80.0, 80.0, 168.0, 79.0, math.inf, False, 60, 3, 1.0)


@pytest.mark.parametrize("name", ["cart_pole/soft_06", "corridor/lossy"])
def test_questions_are_the_same_again_others_to_tune_on_and_fit_their_world(name: str) -> None:
    shipped, asked = Scenario.named(name), [draw(name, number, False) for number in range(2)]
    assert len({*asked, *(draw(name, number, True) for number in range(2)), shipped}) == 5
    for number, scenario in enumerate(asked):
        World.from_scenario(scenario).check(scenario)
        assert draw.__wrapped__(name, number, False) == scenario
        factor = scenario.duration / shipped.duration
        assert 0.3 <= factor <= 4.0 and 10 <= scenario.num_steps <= 400


def test_plans_are_near_the_best_that_anything_has_found() -> None:
    assert ROW.best == 79.0 and not ROW.is_within(NEAR) and ROW.is_within(WIDE)
    assert replace(ROW, known=70.0).best == 70.0
    none = replace(ROW, number=1, cost=math.inf, error="no plan")
    assert not none.is_within(WIDE)
    idle = replace(ROW, number=2, cost=168.0, is_idle=True)
    line = format_results([ROW, none, idle]).splitlines()[1].split()
    assert line == ["cart_pole/soft_06", "3", "0", "33", "inf", "1", "1", "1.00"]
    nothing = replace(ROW, cost=0.0, rival=np.inf)
    assert nothing.is_within(NEAR)


def test_a_world_that_is_not_shipped_is_refused() -> None:
    with pytest.raises(ScenarioError, match="unknown scenario 'cart_pole/soft'"):
        Asked(("cart_pole/soft",))
