"""The cost of a task: its formula, written out once more, and what it does not depend on."""

from __future__ import annotations

import dataclasses
import pickle
import re
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from mechanisms import build
from refusals import check_refused
from replay_worlds import make_scenario, make_task, shipped, shipped_world

from benchmarks.baselines import BASELINES, run_baseline
from benchmarks.optima import block_optimum, masses_optimum, walls_optimum
from drake_aigto import Planner, PlanOptions, Scenario, World
from drake_aigto.errors import ScenarioError
from drake_aigto.paper import (
    LiteralWithForces,
    RigidWithForces,
    SingleShooting,
    bounce_costs,
    make_literal_task,
    plan_literal,
    rigid_optimum,
)
from drake_aigto.planning import PhaseProblem, make_ball_task
from drake_aigto.transcription import RigidTranscription
from drake_aigto.world import Scales, TaskCost

Q_START, V_START, GOAL = [0.3, 0.2], [0.0, 0.0], [-0.2, 3.0]
TURNS = np.arange(-3, 4)
RUNNING: dict[str, Any] = {"position_weight": [2.0, 3.0], "velocity_weight": [0.1, 0.2]}
FINAL: dict[str, Any] = {
    "goal_weight": [[4.0, 1.0], [1.0, 5.0]],
    "goal_velocity_weight": [[2.0, -1.0], [-1.0, 3.0]],
}


@cache
def cart_pole() -> World:
    return build("cart-pole")


def ask(**fields: Any) -> Scenario:
    given = {"goal_weight": [1.0, 1.0], **fields}
    return Scenario(initial_position=Q_START, initial_velocity=V_START, goal_position=GOAL, **given)


def cost_of(**fields: Any) -> TaskCost:
    return TaskCost.of(cart_pole(), ask(**fields))


def motion(number: int = 7) -> tuple[Any, Any, Any, Any]:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, number)
    return (
        t,
        rng.normal(size=(number, 2)),
        rng.normal(size=(number, 2)),
        rng.normal(size=(number, 1)),
    )


def test_a_plain_task_costs_what_it_always_did() -> None:
    world = World.from_scenario(Scenario.named("room/bank_shot"))
    scenario = Scenario.named("room/bank_shot")
    cost, rng = TaskCost.of(world, scenario), np.random.default_rng(1)
    t, (q, v, u) = np.arange(5.0), rng.normal(size=(3, 5, 2))
    effort = scenario.control_weight * np.sum(u**2, axis=1)
    miss = scenario.goal_weight * np.sum((q - scenario.goal_position) ** 2, axis=1)
    np.testing.assert_allclose(cost.running(t, q, v, u), effort, rtol=4e-16)
    np.testing.assert_allclose(cost.final(q, v), miss, rtol=4e-16)
    np.testing.assert_allclose(
        cost.goal_error(q), np.linalg.norm(q - scenario.goal_position, axis=1), rtol=4e-16
    )


def test_only_what_the_goal_weighs_is_off_it() -> None:
    scenario = Scenario.named("billiard/spin_shot")
    cost = TaskCost.of(World.from_scenario(scenario), scenario)
    assert cost.is_asked.tolist() == [True, True, False]
    q = scenario.goal_position + np.array([0.3, -0.4, 7.0])
    assert cost.goal_error(q) == pytest.approx(0.5)
    weightless = dataclasses.replace(scenario, goal_weight=np.zeros(3))
    assert TaskCost.of(World.from_scenario(scenario), weightless).is_asked.all()


def test_every_term_is_the_formulas() -> None:
    times, rows, speeds = [0.2, 0.8], [[0.0, 1.0], [2.0, -1.0]], [[1.0, 0.0], [0.0, 4.0]]
    cost = cost_of(
        **RUNNING,
        **FINAL,
        control_weight=0.5,
        goal_velocity=[1.0, -1.0],
        reference_times=times,
        reference_positions=rows,
        reference_velocities=speeds,
    )
    for t, q, v, u in zip(*motion(), strict=True):
        share = np.clip((t - 0.2) / 0.6, 0.0, 1.0)
        e_q = q - ((1 - share) * np.array(rows[0]) + share * np.array(rows[1]))
        e_v = v - ((1 - share) * np.array(speeds[0]) + share * np.array(speeds[1]))
        running = (
            0.5 * u[0] ** 2 + e_q @ np.diag([2.0, 3.0]) @ e_q + e_v @ np.diag([0.1, 0.2]) @ e_v
        )
        np.testing.assert_allclose(cost.running(t, q, v, u), running, rtol=1e-14)
        (a, b), (c, d) = q - GOAL, v - np.array([1.0, -1.0])
        final = 4 * a * a + 2 * a * b + 5 * b * b + 2 * c * c - 2 * c * d + 3 * d * d
        np.testing.assert_allclose(cost.final(q, v), final, rtol=1e-13)


def test_without_a_reference_the_way_is_weighed_about_the_goal() -> None:
    cost = cost_of(**RUNNING, goal_velocity=[0.5, 1.0])
    t, _, _, u = motion()
    rest = np.broadcast_to(GOAL, (7, 2)), np.broadcast_to([0.5, 1.0], (7, 2))
    np.testing.assert_array_equal(cost.running(t, *rest, u), 1e-3 * u[:, 0] ** 2)


@pytest.mark.parametrize("angles", ["modulo", "chordal"])
def test_turns_count_only_where_angles_are_exact(angles: Any) -> None:
    t, q, v, u = motion()
    weights = {**RUNNING, "goal_weight": [4.0, 5.0]}
    turned = q + np.array([0.0, 2 * np.pi]) * TURNS[:, np.newaxis]
    cost, exact = cost_of(**weights, angles=angles), cost_of(**weights)
    for each in (cost, exact):
        ratios = np.array(
            [
                each.running(t, turned, v, u) / each.running(t, q, v, u),
                each.final(turned, v) / each.final(q, v),
            ]
        )
        is_same = np.abs(ratios - 1) < 1e-12
        assert is_same.tolist() == [[each is cost or turn == 0 for turn in TURNS]] * 2
    np.testing.assert_allclose(cost.goal_error(turned), cost.goal_error(q), rtol=1e-12)
    assert np.all(np.abs(cost.goal_errors(turned)[:, 1]) <= np.pi)
    slid = q + np.array([2 * np.pi, 0.0])
    assert np.all(cost.final(slid, v) != cost.final(q, v))  # A slider does not turn.


def test_a_chord_squared_is_two_minus_two_cosines_and_nearly_the_angle_where_it_is_small() -> None:
    cost, exact = (cost_of(goal_weight=[0.0, 1.0], angles=each) for each in ("chordal", "exact"))
    angles = np.linspace(-3.0, 3.0, 13)
    q = GOAL + np.stack([angles, angles], axis=1)
    np.testing.assert_allclose(cost.final(q, q), 2 - 2 * np.cos(angles), atol=1e-14)
    small = GOAL + np.array([0.0, 1e-3])
    # 2 − 2 cos e = e² (1 − e²/12 + …)
    np.testing.assert_allclose(cost.final(small, small), exact.final(small, small), rtol=1e-7)
    assert cost.final(small, small) < exact.final(small, small)


def test_a_cost_is_pickled_equal_and_read_only() -> None:
    cost = cost_of(**RUNNING, **FINAL, angles="modulo")
    again = pickle.loads(pickle.dumps(cost))
    assert again == cost
    assert not again.QT.flags.writeable
    assert again.is_modulo.tolist() == [False, True]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"goal_weight": 1.0}, "goal_weight: got one number, 1, for sliders and hinges alike, exp"),
        ({"velocity_weight": 2.0}, "velocity_weight: got one number, 2, for sliders and hinges"),
        ({"goal_weight": [1.0] * 3}, "goal_weight: got 3 values, expected 2, one for each coord"),
        ({"goal_weight": np.eye(3)}, "goal_weight: got 3 values a row, expected 2, one for each"),
        ({"control_weight": [1.0, 1.0]}, "control_weight: got 2 values, expected 1, one for each"),
        (
            {"goal_velocity": [1.0], "goal_velocity_weight": [1.0, 1.0]},
            "goal_velocity: got 1 value, expected 2",
        ),
        (
            {**RUNNING, "reference_times": [0.0], "reference_positions": [[1.0, 2.0, 3.0]]},
            "reference_positions: got 3 values a row, expected 2",
        ),
        (
            {**FINAL, "angles": "chordal"},
            "goal_weight: got [[4.0, 1.0], [1.0, 5.0]] with angles: chordal, expected nothing off",
        ),
    ],
)
def test_a_cost_that_does_not_fit_the_world_is_refused(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        cost_of(**fields)


def test_weights_and_turns_fit_what_they_count_for() -> None:
    cost_of(goal_weight=0.0)
    cost_of(goal_weight=1.0, hard_goal=True)
    scenario = Scenario.named("table1/1")
    asked = Scenario(**{**scenario.to_plain(), "angles": "modulo"})
    with pytest.raises(ScenarioError, match="angles: got 'modulo', expected 'exact', as no coord"):
        World.from_scenario(scenario).check(asked)


def _run_baseline(name: str, world: World, task: Scenario) -> None:
    run_baseline(name, world, task, seconds=1.0)


# One field of each kind: costs, ends, bounds, contact, and time.
EXTRAS: dict[str, Any] = {
    "velocity_weight": 1.0,
    "hard_goal": True,
    "control_upper": 1.0,
    "contact": "compliant",
    "duration_range": (0.5, 2.0),
}
DOORS: dict[str, Callable[[World, Scenario], Any]] = {
    "plan_literal": lambda world, task: plan_literal(task, world=world),
    "make_literal_task": make_literal_task,
    "make_ball_task": make_ball_task,
    "SingleShooting": SingleShooting,
    "LiteralWithForces": LiteralWithForces,
    "RigidWithForces": RigidWithForces,
    "RigidTranscription": RigidTranscription,
    "PhaseProblem": PhaseProblem,
    "rigid_optimum": rigid_optimum,
    "bounce_costs": lambda world, task: bounce_costs(world, task, [0.5], [1.0]),
    "walls_optimum": walls_optimum,
    "masses_optimum": masses_optimum,
    "block_optimum": block_optimum,
    **{name: partial(_run_baseline, name) for name in BASELINES},
}


@pytest.mark.parametrize("field", EXTRAS)
@pytest.mark.parametrize("door", DOORS)
def test_a_task_that_would_lose_something_is_refused(door: str, field: str) -> None:
    task = make_scenario(**{field: EXTRAS[field]})
    with pytest.raises(ScenarioError, match=rf"^{field}: got .* would ignore it"):
        DOORS[door](shipped_world(), task)


def test_a_planner_refuses_such_weights_for_its_next_plan_too() -> None:
    task = make_task("room", [0.3, 0.7], [0.0, 0.0], time_step=0.1)
    planner = Planner(task, PlanOptions(confirm=False), shipped("room"))
    for name in ("goal_weight", "control_weight"):
        changed: dict[str, Any] = {name: [1.0, 2.0]}
        with pytest.raises(ScenarioError, match=rf"^{name}: got \[1.0, 2.0\], expected one number"):
            planner.plan(**changed)


def test_the_command_line_refuses_what_its_planner_would_ignore(capsys: Any) -> None:
    message = "control_norm: got 9.0, expected its default, None. What plans for balls"
    words = ["--transcription", "literal", "--control-norm", "9"]
    check_refused(["plan", "table1/1", *words], message, capsys)


def test_the_unit_of_costs_of_such_a_task_is_what_it_costs_to_stay() -> None:
    world, task = shipped_world(), make_scenario(2.0, 0.0, goal_weight=3.0, duration=2.0)
    miss = 2.0 - 0.73
    assert (
        Scales.of(world, task).cost
        == 3.0 * max(miss, world.calc_signed_distance(np.array([2.0]))[0]) ** 2
    )
    weighed = dataclasses.replace(task, position_weight=5.0)
    np.testing.assert_allclose(Scales.of(world, weighed).cost, (3.0 + 2.0 * 5.0) * miss**2)
    hard = dataclasses.replace(task, hard_goal=True)
    alone = dataclasses.replace(task, goal_weight=0.0)
    assert Scales.of(world, hard).cost == Scales.of(world, alone).cost > 0
