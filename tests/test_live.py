"""A plan follows sliders in Meshcat: it changes as they move, and stands where there is none."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from meshcat_pages import objects, position
from space_models import make_scenario

from drake_aigto import Plan, Scenario
from drake_aigto.errors import OptionsError
from drake_aigto.show import ROOT, Live

GOAL, SPEED, WALL = "goal x [m]", "speed x [m/s]", "wall nearer [m]"
BALL = f"{ROOT}/candidates/0/point_mass_and_wall/ball/ball_visual"


@pytest.fixture(scope="module")
def live() -> Iterator[Live]:
    live = Live(Scenario.named("table1/1"))
    live.open()
    wait_for(live, lambda: live.plan is not None)
    yield live
    live.stop()


def wait_for(live: Live, is_so: Callable[[], bool]) -> None:
    """Looks at sliders until something is so."""
    end = time.monotonic() + 120.0
    while not is_so():
        assert time.monotonic() < end, live.message
        live.look()
        time.sleep(0.005)


def drag(live: Live, slider: str, value: float) -> Plan:
    """Returns the plan after a slider was moved."""
    before = live.plan
    live.meshcat.SetSliderValue(slider, value)
    wait_for(live, lambda: live.plan is not before)
    assert live.plan is not None
    return live.plan


def test_the_plan_follows_from_bounce_to_brake(live: Live) -> None:
    bounces = drag(live, SPEED, -1.8)
    assert len(bounces.best.contacts) == 1 and live.labels[0].endswith("touches wall")
    brakes = drag(live, SPEED, -0.3)
    assert brakes.scenario.initial_velocity[0] == pytest.approx(-0.3, abs=0.02)
    assert brakes.best.contacts == () and np.isfinite(live.latency)
    assert live.labels[0].startswith("plan: cost ") and "touches nothing" in live.labels[0]
    assert BALL in objects(live.meshcat)


def test_a_goal_inside_a_wall_is_told_and_the_plan_stands(live: Live) -> None:
    before = drag(live, GOAL, 0.7)
    live.meshcat.SetSliderValue(GOAL, -0.07)
    wait_for(live, lambda: bool(live.message))
    assert live.plan is before and live.message.startswith("goal_position is inside")
    assert live.labels[-1] == f"no plan: {live.message}"
    assert drag(live, GOAL, 0.5) is not before and live.message == ""


def test_a_kick_plans_on_from_where_the_motion_is_and_sliders_bring_it_back(live: Live) -> None:
    before = drag(live, GOAL, 0.6)
    live.kick()
    wait_for(live, lambda: live.plan is not before)
    kicked = live.plan
    assert kicked is not None and kicked.scenario.goal_position[0] == pytest.approx(0.6, abs=0.01)
    assert kicked.scenario.initial_velocity[0] != before.scenario.initial_velocity[0]
    assert (
        drag(live, GOAL, 0.65).scenario.initial_position[0] == before.scenario.initial_position[0]
    )


def test_a_wall_is_drawn_where_the_plan_has_it(live: Live) -> None:
    drag(live, SPEED, -1.8)
    drawn = f"{ROOT}/world/point_mass_and_wall/wall/wall_visual"
    before = position(live.meshcat, drawn)
    near = drag(live, WALL, 0.2)
    at = np.interp(
        near.best.contacts[0].time, near.trajectory.times, near.trajectory.positions[:, 0]
    )
    assert at == pytest.approx(live.meshcat.GetSliderValue(WALL), abs=1e-3)
    moved = position(live.meshcat, drawn) - before
    np.testing.assert_allclose(moved, [live.meshcat.GetSliderValue(WALL), 0, 0], atol=1e-12)
    assert near.find_world(live.planner.world).calc_signed_distance(np.array([0.2]))[0] < 0.01
    assert drag(live, WALL, 0.0).cost != near.cost


def test_weights_are_powers_of_ten_of_the_scenarios(live: Live) -> None:
    before = live.planner.scenario
    planned = drag(live, "control weight × 10^", 1.0).scenario
    assert planned.control_weight == pytest.approx(10 * before.control_weight)
    assert planned.goal_weight == before.goal_weight
    drag(live, "control weight × 10^", 0.0)


def test_in_a_notebook_it_plays_in_the_background(in_background: Live) -> None:
    shown = in_background._repr_html_()
    assert (
        shown.startswith(f'<iframe src="{in_background.url}"') and "localhost" in in_background.url
    )


@pytest.fixture
def in_background() -> Iterator[Live]:
    live = Live(Scenario.named("table1/1")).start()
    yield live
    live.stop()


def test_bodies_that_float_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match="got bodies that float, expected coordinates that"):
        Live(make_scenario(tmp_path))
