"""A plan follows sliders in Meshcat: it changes as they move, and stands where there is none."""

from __future__ import annotations

import dataclasses
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from meshcat_pages import objects, position
from space_models import make_scenario

from drake_aigto import Plan, PlanOptions, Scenario
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
    end = time.monotonic() + 120.0
    while not is_so():
        assert time.monotonic() < end, live.message
        live.look()
        time.sleep(0.005)


def drag(live: Live, slider: str, value: float) -> Plan:
    wait_for(live, lambda: not live.is_searching)
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
    # No cost without what it is worth.
    assert live.labels[1].startswith("plan: simulated ") and live.labels[1].endswith(", energy -")
    assert re.fullmatch(r"plan: defect \de-\d\d, penetration 0 m", live.labels[2])
    assert BALL in objects(live.meshcat)


def test_a_plan_near_the_last_comes_first_and_the_whole_search_once_sliders_rest(
    live: Live,
) -> None:
    first = drag(live, GOAL, 0.62)
    assert live.is_searching and first.options is not None
    live.look()
    assert live.labels[-1] == "searching: a better plan may follow"
    wait_for(live, lambda: not live.is_searching)
    live.look()
    best = live.plan
    assert best is not None and best is not first and best.options != first.options
    assert best.scenario.goal_position == first.scenario.goal_position
    assert best.cost <= 1.001 * first.cost
    assert not any("searching" in label for label in live.labels)


@pytest.mark.slow
def test_another_question_ends_the_search_for_the_one_before() -> None:
    live = Live(Scenario.named("room/two_walls"))
    live.open()
    wait_for(live, lambda: live.plan is not None)
    weight = "control weight × 10^"
    drag(live, weight, 0.3)
    wait_for(live, lambda: live.is_searching)
    asked, seen = drag(live, weight, 0.0).scenario.control_weight, set[float]()

    def is_over() -> bool:
        assert live.plan is not None
        seen.add(live.plan.scenario.control_weight)
        return not live.is_searching

    wait_for(live, is_over)
    live.stop()
    assert seen == {asked} and asked == pytest.approx(live.planner.scenario.control_weight)


@pytest.mark.slow
def test_a_mechanism_s_first_plan_is_of_few_starts_beside_the_last_motion() -> None:
    live = Live(dataclasses.replace(Scenario.named("table1/1"), control_upper=[2.0]))
    live.open()
    wait_for(live, lambda: live.plan is not None)
    first = drag(live, GOAL, 0.7)
    live.stop()
    assert isinstance(first.options, PlanOptions)
    assert (first.options.starts, first.options.renewals, first.stats.searches < 20) == (1, 0, True)


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
    wait_for(live, lambda: not live.is_searching)
    assert live.plan is not None and live.plan.replayed().holds  # Drake's wall stands there, too.
    assert drag(live, WALL, 0.0).cost != near.cost


def test_weights_are_powers_of_ten_of_the_scenarios(live: Live) -> None:
    before = live.planner.scenario
    planned = drag(live, "control weight × 10^", 1.0).scenario
    assert planned.control_weight == pytest.approx(10 * before.control_weight)
    assert planned.goal_weight == before.goal_weight
    drag(live, "control weight × 10^", 0.0)


def test_a_scene_that_is_closed_or_has_no_port_says_so(in_background: Live) -> None:
    port = int(in_background.url.rpartition(":")[2])
    with pytest.raises(OptionsError, match=f"port: got {port}, in use"):
        Live(in_background.planner.scenario, port=port).start()
    in_background.stop()
    assert in_background._repr_html_() == "<p>The live scene is closed.</p>"
    with pytest.raises(OptionsError, match="live scene: got closed, expected a new `Live`"):
        in_background.start()
    assert "call start()" in Live(in_background.planner.scenario)._repr_html_()


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
