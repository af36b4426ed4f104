"""Starts so near to a wall that the first bounce comes at once, whatever the control."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from replay_worlds import make_wedge

from benchmarks.optima import walls_optimum
from drake_aigto import (
    PlanOptions,
    Scenario,
    World,
    plan,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.transcription import touches_at_once

CORRIDOR = "package://drake_aigto_models/corridor.sdf"


def make_scenario(distance: float, **fields: Any) -> Scenario:
    ends: dict[str, Any] = {"initial_velocity": -2.0, "goal_position": 0.73}
    return Scenario(initial_position=distance, **ends, restitution=0.8, **fields)


@pytest.mark.parametrize("distance", [1e-12, 1e-8, 1e-5])
@pytest.mark.parametrize("fields", [{}, {"model": CORRIDOR}], ids=["wall", "corridor"])
def test_a_plan_is_the_optimum_however_near_to_a_wall_it_starts(
    distance: float, fields: dict[str, str]
) -> None:
    scenario = make_scenario(distance, **fields)
    world = World.from_scenario(scenario)
    found = plan(scenario, PlanOptions(confirm=False), world)
    assert found.cost == pytest.approx(walls_optimum(world, scenario).cost, rel=1e-3)
    assert found.best.contacts[0].time == pytest.approx(distance / 2, rel=0.01)


def test_what_is_touched_at_once_is_found_in_the_order_of_time() -> None:
    world = make_wedge(1.5)
    start = np.linalg.solve(world.calc_contact_jacobian(np.zeros(2)), [3e-9, 2e-9])
    toward = -start / np.linalg.norm(start)

    def bounces(position: Any, velocity: Any) -> list[tuple[float, int]]:
        scenario = Scenario(
            initial_position=position, initial_velocity=velocity, goal_position=[0.5, 0.5]
        )
        return [(touch.start, touch.contact) for touch in touches_at_once(world, scenario)]

    times = np.linalg.norm(start)  # Both walls at once, but for rounding.
    assert [time for time, _ in bounces(start, toward)] == pytest.approx([times, times])
    assert next(contact for _, contact in bounces(start, [0.0, -1.0])) == 0
    assert not bounces(start, -toward)
    assert not bounces([0.5, 0.4], toward)


@pytest.mark.parametrize("control", [0.0, -1.0])
def test_drake_sees_no_wall_any_more_once_it_is_left(control: float) -> None:
    # As its integrator's Jacobian is of differences, it did: the end was 4 to 33 cm off.
    ends: dict[str, Any] = {"initial_velocity": 0.05, "goal_position": 0.5}
    scenario = Scenario(model=CORRIDOR, initial_position=1 - 1e-11, **ends)
    world = World.from_scenario(scenario)
    times = np.concatenate([[0.0, 1e-10], np.linspace(2e-10, 1.0, 150)])
    controls = np.full((len(times) - 1, 1), control)
    rigid, drake = (
        replay(world, scenario, times, controls) for replay in (replay_event_driven, replay_drake)
    )
    assert drake.positions[-1] == pytest.approx(rigid.positions[-1], abs=2e-4)
