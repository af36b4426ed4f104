"""Plans of changed tasks, against the best that other methods have found."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from other_models import hit_puck, hop_on_leg
from scaled_worlds import Factors, scale_scenario

from drake_aigto import Planner, PlanOptions, Scenario, World, plan
from drake_aigto.planning import Aim, MechanismSearch, MechanismTask, make_mechanism_task
from drake_aigto.shooting import ShootingOptions, Smoothing

pytestmark = pytest.mark.slow
SPINNER = Scenario.named("spinner/two_radians")
BLOCK = "pushed_block/slide"
QUICK = PlanOptions(confirm=False)


@pytest.mark.parametrize(("angle", "most"), [(2.8, 4.9), (3.0, 4.9), (np.pi, 4.9)])
def test_a_spinner_is_turned_by_any_angle(angle: float, most: float) -> None:
    reference = np.array(SPINNER.reference_positions)
    reference[-1, -1] = angle
    goal = [*SPINNER.goal_position[:2], angle]
    scenario = dataclasses.replace(SPINNER, goal_position=goal, reference_positions=reference)
    found = plan(scenario)
    assert found.holds and not found.best.is_idle
    assert found.cost < most


def test_descents_of_sliding_contacts_come_back_from_nearby() -> None:
    planner = Planner(SPINNER, PlanOptions(renewals=8, finalists=1, confirm=False))
    found = planner.plan()
    task = MechanismTask(planner.world, SPINNER, PlanOptions())
    best, options = found.trajectory.controls, ShootingOptions((Smoothing(1e-4, 20, 1e-5),), 8, 2)
    costs = []
    for seed in range(6):
        off = 0.05 * np.std(best) * np.random.default_rng(seed).normal(size=best.shape)
        costs.append(task.shooting(len(best)).solve(best + off, options=options).cost)
    # 1.09; 1.32 with damping that holds controls, not states.
    assert np.median(costs) < 1.2 * found.cost


def test_a_payload_is_polished_to_its_own_cost_where_goals_weigh_much() -> None:
    shipped = Scenario.named("payload/transport")
    scenario = dataclasses.replace(
        shipped, duration=5.54, control_weight=shipped.control_weight / 7.4
    )
    # Of three seeds; 0.13 to 0.17 with descents that end in parts of what goals weigh.
    assert plan(scenario, PlanOptions(seed=2, confirm=False)).cost < 0.083


def test_an_unstable_motion_between_sharp_walls_is_polished_near_its_states() -> None:
    """117.95 from its controls, which lead elsewhere as walls get sharper; 100.75 in two passes."""
    shipped = Scenario.named("cart_pole/soft_10")
    T, mass = 3.5824383326262828, 0.026953265276805718
    scenario = dataclasses.replace(shipped, duration=T, time_step=T / 143, mass=mass)
    found = plan(scenario, QUICK)
    assert found.holds
    assert found.cost < 70.3


@pytest.mark.parametrize(
    ("name", "duration", "seeds"),
    [("cart_pole/soft_10", 4.5, (0, 1, 2, 3)), ("cart_pole/soft_06", 3.3, (0, 1, 2, 3))],
)
def test_a_longer_horizon_costs_hardly_more_where_a_pole_may_stand_in_its_end(
    name: str, duration: float, seeds: tuple[int, ...]
) -> None:
    """By seed 94 to 149 and 82 to 128, if motions of the whole horizon are all that is tried."""
    short = Scenario.named(name)
    steps = round(duration * 40 / 1.5)
    long = dataclasses.replace(short, duration=duration, time_step=duration / steps)
    most = 1.02 * plan(short, QUICK).cost
    for seed in seeds:
        found = plan(long, dataclasses.replace(QUICK, seed=seed))
        assert found.holds
        assert found.cost < most


def test_steps_that_are_wary_do_not_come_first_in_a_polish() -> None:
    """From wary ones, which stop far from where they began, this seed's plan cost 1864."""
    found = plan(Scenario.named("cart_pole/dry"), dataclasses.replace(QUICK, seed=1))
    assert found.holds
    assert found.cost < 655


def test_a_motion_is_mended_whose_violation_is_priced_above_all_else(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fastest = np.array([3.0, 5.0])  # of cart and pole [m/s, rad/s]
    scenario = dataclasses.replace(
        Scenario.named("cart_pole/soft_06"), velocity_lower=-fastest, velocity_upper=fastest
    )
    task = make_mechanism_task(World.from_scenario(scenario), scenario, PlanOptions())
    drops = []
    for seed in range(6):
        guess = task.guesses.draw("coast", np.random.default_rng(seed))
        rough = task.close(guess, Aim())
        with monkeypatch.context() as dear:
            dear.setattr("drake_aigto.planning.mechanisms.task._PRICE", 1e5)
            found = task.close(guess, Aim())
            assert task.rank(found) <= task.rank(rough)
        drops.append(found.violation / rough.violation if rough.violation else 1.0)
    assert min(drops) < 0.1


def test_a_paddle_bats_once_where_a_motion_that_bats_twice_is_near() -> None:
    """0.896 with two touches; without the second one a closing begins at three times that."""
    scenario = dataclasses.replace(
        Scenario.named("paddle/bat"), restitution=0.674036783280805, mass=0.025908392438485126
    )
    found = plan(scenario, QUICK)
    assert found.holds
    assert found.cost < 0.7303


def test_an_arm_hits_a_puck_where_gaps_can_not_be_closed_by_whole_steps(tmp_path: Path) -> None:
    found = plan(hit_puck(tmp_path), PlanOptions(renewals=0, starts=4, finalists=1))
    assert found.holds and found.best.contacts
    assert found.cost < 0.35  # idle: about 1.5


def test_a_leg_with_limits_is_closed_where_whole_steps_blow_it_up(tmp_path: Path) -> None:
    planner = Planner(hop_on_leg(tmp_path))
    task = planner.task
    assert isinstance(task, MechanismTask)
    found = task.close(task.guesses.plain("rest", 0.0), Aim())
    misses, cost = task.rank(found)
    assert not misses and cost < 50.0  # 3e4, 175 rad beyond its limits, by whole steps


def test_a_small_spinner_is_turned_as_a_large_one(tmp_path: Path) -> None:
    found = plan(scale_scenario("spinner/two_radians", tmp_path, Factors(0.1, 1.0, 1.0)))
    assert found.holds and found.best.contacts
    assert found.cost < 2.85  # idle: 42.667


@pytest.mark.parametrize(
    ("position", "velocity", "most"),
    [
        ([0.8037304251537628, 0.71672183364263], [-0.975128387370213, 0.08554995881670191], 132.0),
        (
            [0.9350092221974413, 0.6589850492023026],
            [-0.8464870215039917, -2.195667155432691],
            132.0,
        ),
    ],
)
def test_poles_that_a_wall_has_whirled_up_stand(
    position: list[float], velocity: list[float], most: float
) -> None:
    scenario = dataclasses.replace(
        Scenario.named("cart_pole/soft_06"), initial_position=position, initial_velocity=velocity
    )
    found = plan(scenario)
    assert found.holds and found.cost < most


def test_a_hopper_hops_for_less_than_in_one_stride() -> None:
    found = plan(Scenario.named("hopper/hop"))
    assert found.holds and found.cost < 7.6  # In the steps that springs ask for: 8.04.
    assert found.stats.searches > found.stats.found >= 1


@pytest.mark.parametrize(("name", "is_pressed"), [("hopper/hop", True), (BLOCK, False)])
def test_steps_are_shortened_where_they_do_not_resolve_friction(
    name: str, is_pressed: bool
) -> None:
    scenario, options = Scenario.named(name), PlanOptions(starts=4, renewals=9, threads=1)
    task = make_mechanism_task(World.from_scenario(scenario), scenario, options)
    coarse, search = task._closing.substeps, MechanismSearch(task)
    search.explore()
    best = search.motions[0].result
    problem, errors = task.pose_again(best), []
    for substeps in (coarse, 2 * coarse, 4 * coarse):
        errors.append(problem.add_errors(dataclasses.replace(best, substeps=substeps)))
    assert sorted(errors, reverse=True) == errors
    assert not task.is_coarse(best)
    assert task.is_coarse(dataclasses.replace(best, substeps=coarse)) == is_pressed
    assert (best.substeps > coarse) == is_pressed


@pytest.mark.parametrize(
    ("name", "duration", "steps", "most"),
    [
        ("cart_pole/soft_06", 4.5, 120, 83.0),
        ("cart_pole/rigid_06", 4.5, 120, 83.0),
        ("acrobot/swing_up", 6.0, 120, 90.0),
    ],
)
def test_motions_in_a_longer_horizon_rest_at_the_goal_or_wait_first(
    name: str, duration: float, steps: int, most: float
) -> None:
    scenario = dataclasses.replace(
        Scenario.named(name), duration=duration, time_step=duration / steps
    )
    task = make_mechanism_task(World.from_scenario(scenario), scenario, PlanOptions())
    search = MechanismSearch(task)
    search.explore()
    assert search.motions[0].cost < most


@pytest.mark.parametrize(
    ("name", "factor", "restitution"),
    [
        ("corridor/six_bounces", 3.0, 1.0),
        ("room/bank_shot", 3.0, 1.0),  # In a corner, off the other wall first.
        ("room/bank_shot", 8.0, 0.9),
    ],
)
def test_limits_that_do_not_bind_change_no_plan_however_often_it_bounces(
    name: str, factor: float, restitution: float
) -> None:
    shipped = Scenario.named(name)
    T, h = factor * shipped.duration, factor * shipped.time_step
    free = dataclasses.replace(shipped, duration=T, time_step=h, restitution=restitution)
    limited = Scenario.from_plain({**free.to_plain(), "effort_limits": {"*": 1e3}})
    costs = [plan(each, PlanOptions(confirm=False)).cost for each in (free, limited)]
    # One road solves in closed form, the other by shooting, from the touches of motion let go.
    assert costs[1] == pytest.approx(costs[0], rel=1e-3)


def test_limits_that_do_not_bind_do_not_hide_the_way_past_a_corner() -> None:
    free = dataclasses.replace(
        Scenario.named("room_with_block/around"),
        initial_position=[0.716, 0.758],
        initial_velocity=[-0.04, -0.16],
        goal_position=[0.159, 0.538],
        duration=2.25,
        time_step=0.0375,
        restitution=0.8,
    )
    limited = Scenario.from_plain({**free.to_plain(), "effort_limits": {"*": 1e3}})
    costs = [plan(each, PlanOptions(confirm=False)).cost for each in (free, limited)]
    # 2.9 times as much, where a corner that knots cut was made a bounce.
    assert costs[1] < 1.01 * costs[0]


def test_limits_that_do_not_bind_do_not_hide_the_way_around_a_block() -> None:
    shipped = Scenario.named("room_with_block/around")
    limited = Scenario.from_plain({**shipped.to_plain(), "effort_limits": {"*": 1e3}})
    costs = [plan(each, PlanOptions(confirm=False)).cost for each in (shipped, limited)]
    # 9.4 times as much, where motions that dip into the block were not led off it.
    assert costs[1] < 1.5 * costs[0]
