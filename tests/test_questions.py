"""Questions drawn by seed: which they are, and what is told of plans."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.local_peers import casadi
from benchmarks.questions import NEAR, WIDE, Row, draw, format_results, main
from benchmarks.rivals import SAMPLERS, ask_rivals, roll_out, sample
from benchmarks.shooting_ipopt import ShootingProgram
from drake_aigto import PlanOptions, Scenario, World
from drake_aigto.errors import ScenarioError
from drake_aigto.planning import make_mechanism_task

ROW = Row("cart_pole/soft_06", 0, 80.0, 80.0, 168.0, 79.0, math.inf, False, 60, 3, 1.0)


@pytest.mark.slow
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
        main(["cart_pole/soft"])


# Near its rest, where all methods have one optimum.
SWAYING = replace(
    Scenario.named("acrobot/swing_up"),
    duration=0.5,
    time_step=0.05,
    initial_position=[0.3, -0.2],
    goal_position=[0.0, 0.0],
)


@pytest.mark.slow
@pytest.mark.skipif(casadi is None, reason="CasADi is not installed")
def test_ipopt_has_the_optimum_of_our_shooting() -> None:
    world = World.from_scenario(SWAYING)
    problem = make_mechanism_task(world, SWAYING, PlanOptions()).shooting(SWAYING.num_steps)
    controls = np.full((SWAYING.num_steps, 1), 0.1)
    ours = problem.solve(controls, None)
    promised, control = ShootingProgram(problem).solve(
        problem.simulate(controls, 4).states, controls
    )
    assert promised == pytest.approx(ours.cost, rel=1e-4)
    assert control.values == pytest.approx(ours.controls, abs=1e-2 * np.abs(ours.controls).max())


@pytest.mark.slow
def test_rivals_find_the_optimum_of_an_easy_task_and_no_less() -> None:
    world = World.from_scenario(SWAYING)
    problem = make_mechanism_task(world, SWAYING, PlanOptions()).shooting(SWAYING.num_steps)
    least = problem.solve(np.zeros((SWAYING.num_steps, 1)), None).cost
    assert ask_rivals(world, SWAYING, 0.3, np.inf) == pytest.approx(least, rel=1e-2)


@pytest.mark.parametrize("method", SAMPLERS)
def test_samplers_find_less_from_generation_to_generation(method: str) -> None:
    far = replace(SWAYING, goal_position=[1.0, -0.5])
    world = World.from_scenario(far)
    problem = make_mechanism_task(world, far, PlanOptions()).shooting(far.num_steps)
    least = problem.solve(np.full((far.num_steps, 1), 0.1), None).cost
    generations = sample(problem, lambda each: roll_out(problem, each), method)
    costs = [next(generations)[0] for _ in range(20)]
    assert least < min(costs) < 1.02 * least < costs[0]
    if method == "predictive sampling":  # The mean is one of the samples.
        assert all(np.diff(costs) <= 0)
