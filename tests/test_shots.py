"""Motions after a kick, or under a control that fades, whose bounces a plan may have."""

from __future__ import annotations

import dataclasses

import pytest
from marks import slow

from drake_aigto import PlanOptions, Scenario, World, plan
from drake_aigto.planning import draw_shots

QUICK = PlanOptions(confirm=False)


def make_room(start: list[float], velocity: list[float], goal: list[float]) -> Scenario:
    return dataclasses.replace(
        Scenario.named("room_with_block/around"),
        initial_position=start,
        initial_velocity=velocity,
        goal_position=goal,
        duration=2.25,
        time_step=0.0375,
        restitution=1.0,
    )


@pytest.mark.parametrize("name", ["floor/rebound", *slow("room/two_walls", "corridor/six_bounces")])
def test_the_first_shot_bounces_where_the_best_plan_does(name: str) -> None:
    scenario = dataclasses.replace(Scenario.named(name), restitution=1.0)
    best, world = plan(scenario, QUICK), World.from_scenario(scenario)
    task = world.place(scenario)
    first, again = (next(draw_shots(world, task, best.cost, 20)) for _ in range(2))
    assert list(first.bounce_contacts) == [each.index for each in best.best.contacts]
    assert again.positions.tolist() == first.positions.tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "velocity", "goal", "most"),
    [
        # Shooting from controls knows 5.464e-5 of the first; both cost 7.1e-4 and 2.1e-4 by
        # boxes, contacts of the uncontrolled motion and neighbors of both alone.
        ([0.145087603, 0.54855293], [1.097545529, 1.473706911], [0.46478135, 0.224210219], 5.5e-5),
        (
            [0.578529358, 0.131142048],
            [-0.066247519, -1.72720329],
            [0.811419244, 0.587697358],
            5.1e-5,
        ),
    ],
)
def test_a_motion_that_passes_a_corner_on_its_other_side_is_found(
    start: list[float], velocity: list[float], goal: list[float], most: float
) -> None:
    found = plan(make_room(start, velocity, goal), QUICK)
    assert found.holds
    assert found.cost < most
