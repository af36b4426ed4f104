"""What plans and reports say of tasks whose coordinates are lengths and angles."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanisms import build

from drake_aigto import Plan, Scenario, World
from drake_aigto.planning import Candidate, Origin, PlanStats, Replays
from drake_aigto.show import (
    Page,
    add_question,
    angle_text,
    format_plan,
    miss_text,
    report_plan,
    simulation_label,
    task_items,
)
from drake_aigto.simulation import Replay
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scales, TaskCost

ENDS: dict[str, Any] = {
    "initial_position": [0.1, 0.2],
    "initial_velocity": [0.0, 0.5],
    "goal_position": [0.0, 3.0],
    "goal_weight": [1.0, 2.0],
}
TURNED = 3.002 + 2 * np.pi  # A turn and 2 mrad beyond the goal.


@cache
def cart_pole() -> World:
    return World.from_scenario(Scenario.named("cart_pole/soft_06"))


def end_at(q: Any, v: Any, scenario: Scenario) -> Replay:
    """Returns a replay that ends there."""
    q, v = np.array(q), np.array(v)
    ends = np.stack([scenario.initial_position, q]), np.stack([scenario.initial_velocity, v])
    return Replay(
        simulator="event-driven",
        cost=1.0,
        goal_error=float(TaskCost.of(cart_pole(), scenario).goal_error(q)),
        max_penetration=0.0,
        bounce_times=(),
        bounce_contacts=(),
        energies_before=(),
        energies_after=(),
        compliance_error=0.0,
        compliance_cost=0.0,
        matched_speeds=(),
        times=np.array([0.0, scenario.duration]),
        positions=ends[0],
        velocities=ends[1],
    )


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({}, "1.0 mm and 6.29 rad"),
        ({"angles": "modulo"}, "1.0 mm and 2.0 mrad"),
        ({"angles": "chordal"}, "1.0 mm and 2.0 mrad"),
        (
            {"angles": "modulo", "goal_velocity_weight": [0.0, 1.0]},
            "1.0 mm, 2.0 mrad, 0.25 m/s and 0.50 rad/s",
        ),
        (
            {"hard_goal": True, "goal_velocity": [0.25, -0.5]},
            "1.0 mm, 6.29 rad, 0 m/s and 0 rad/s",
        ),
    ],
)
def test_a_miss_is_told_in_the_units_of_what_misses(more: dict[str, Any], expected: str) -> None:
    scenario = Scenario(**{**ENDS, **more})
    run = end_at([1e-3, TURNED], [0.25, -0.5], scenario)
    assert miss_text(run, scenario, cart_pole()) == expected


@pytest.mark.parametrize(
    ("radians", "text"),
    [(1.234, "1.23 rad"), (0.05, "50.0 mrad"), (3e-6, "3.0 µrad"), (0.0, "0 rad")],
)
def test_an_angle_is_told_in_the_unit_it_is_best_read_in(radians: float, text: str) -> None:
    assert angle_text(radians) == text


def test_a_world_knows_the_unit_of_its_coordinates() -> None:
    names = ("throwing_ball", "pendulum", "cart-pole")
    assert [build(name).position_unit for name in names] == ["m", "rad", "m, rad"]


def test_a_task_says_all_that_it_asks_for() -> None:
    scenario = Scenario(
        **ENDS,
        goal_velocity=[0.0, 1.0],
        hard_goal=True,
        angles="modulo",
        duration_range=(0.5, 2.0),
        control_lower=-20.0,
        position_upper=[1.0, np.inf],
        contact="compliant",
    )
    assert task_items(scenario, cart_pole()) == [
        "q(0) = (0.1 m, 0.2 rad)",
        "v(0) = (0 m/s, 0.5 rad/s)",
        "goal (0 m, 3 rad)",
        "goal velocity (0 m/s, 1 rad/s)",
        "hard goal",
        "modulo angles",
        "duration range [0.5, 2]",
        "position upper [1, inf]",
        "control lower -20",
        "compliant contact",
    ]


def make_plan(scenario: Scenario) -> Plan:
    """Returns a plan that ends a millimeter, a turn and two milliradians off the goal."""
    run = end_at([1e-3, TURNED], [0.0, 0.0], scenario)
    still = np.zeros((2, 2))
    trajectory = Trajectory(run.times, run.positions, still, still[:1, :1], still, still[:1])
    candidate = Candidate(
        origin=Origin("boxes"),
        start_cost=2.0,
        start_defects={"dynamics": 0.0},
        trajectory=trajectory,
        cost=1.0,
        goal_error=run.goal_error,
        defects={"dynamics": 0.0},
        max_penetration=0.0,
        contacts=(),
        replay=run,
        scales=Scales.of(cart_pole(), scenario),
    )
    return Plan(scenario, "mechanism", (candidate,), Replays(run, None), PlanStats(1, 1, {}), None)


def test_a_plan_of_a_mechanism_is_written() -> None:
    scenario = Scenario(**ENDS, velocity_weight=[0.0, 1.0], angles="modulo", contact="compliant")
    plan = make_plan(scenario)
    text = format_plan(plan, cart_pole())
    assert text.count("ends 1.0 mm and 2.0 mrad off the goal") == 2
    assert "1.0 mm 2.0 mrad  none" in text  # In the table of candidates.
    assert "restitution" not in text and "stiffness 200 N/m, dissipation 0 s/m" in text
    assert max(map(len, text.splitlines())) <= 100
    again = dataclasses.replace(plan, scenario=dataclasses.replace(scenario, contact="rigid"))
    assert "restitution 1" in format_plan(again, cart_pole())


def test_a_report_of_a_mechanism_is_written() -> None:
    scenario = Scenario(**ENDS, velocity_weight=[0.0, 1.0], angles="modulo", contact="compliant")
    written = report_plan(make_plan(scenario), cart_pole())
    assert "Links at evenly spaced times" in written and "boxes can&#x27;t be had" in written
    for part in ("R = 0.001; Q_v = [0, 1]; Q_T = [1, 2]", "λ = k x max(0, 1 + d ẋ)", "3 rad)"):
        assert part in written


def test_where_nothing_touches_no_wall_is_told_of() -> None:
    scenario = Scenario.named("acrobot/swing_up")
    world, page = World.from_scenario(scenario), Page("A question")
    add_question(page, scenario, world)
    asked = page.to_html()
    assert "contacts</th><td>none" in asked and "restitution" not in asked
    replay = end_at([0.0, 3.0], [0.0, 0.0], Scenario(**ENDS))
    assert simulation_label(replay, world) == "simulation: integrated"
    assert simulation_label(replay, cart_pole()) == "simulation: exactly rigid"
