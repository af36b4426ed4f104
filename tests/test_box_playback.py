"""AIGO's boxes are played as they shrink, and run again as they were."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from meshcat_pages import clips, objects
from pydrake.geometry import Meshcat

from drake_aigto import Plan, Planner, PlanOptions, Scenario, World
from drake_aigto.aigo import AigoResult, FullGradient, SlowMotion, minimize
from drake_aigto.errors import OptionsError
from drake_aigto.paper import LITERAL_LADDER, LiteralOptions, plan_literal
from drake_aigto.planning import Origin, make_ball_task
from drake_aigto.show import ROOT, BoxRun, make_mesh, play_boxes, run_boxes

OPTIONS = PlanOptions(aigo_steps=20, confirm=False, finalists=1)


@pytest.fixture(scope="module")
def plan() -> Plan:
    scenario = dataclasses.replace(Scenario.named("table1/1"), time_step=0.05)
    return Planner(scenario, OPTIONS).plan()


@pytest.fixture(scope="module")
def run(plan: Plan) -> BoxRun:
    return run_boxes(plan)


@pytest.fixture(scope="module")
def meshcat(plan: Plan, run: BoxRun) -> Meshcat:
    meshcat = Meshcat()
    play_boxes(plan, meshcat, run=run)
    return meshcat


def test_the_rung_that_the_plan_came_from_is_run_again(plan: Plan, run: BoxRun) -> None:
    assert plan.best.origin.rung == run.rung in OPTIONS.ball_ladder
    last = run.problem.run_aigo(run.rung).box
    # Newton step by Newton step it comes to the same.
    np.testing.assert_allclose(run.result.box.center, last.center, atol=1e-6)
    np.testing.assert_allclose(run.result.box.half_width, last.half_width, rtol=1e-2)


def test_boxes_that_no_file_tells_of_are_refused(plan: Plan) -> None:
    best = dataclasses.replace(plan.best, origin=Origin("zero"))
    priced = dataclasses.replace(plan.best, added_costs={"tax": 1.0})
    for other, lacks in (
        (dataclasses.replace(plan, candidates=(best,)), "no rung of AIGO's ladder"),
        (dataclasses.replace(plan, options=None), "no options"),
        (dataclasses.replace(plan, candidates=(priced,)), r".* one's own, by name only \(tax\)"),
    ):
        with pytest.raises(OptionsError, match=f"got a plan that names {lacks}"):
            run_boxes(other)


def test_a_literal_plan_has_the_boxes_of_its_options() -> None:
    scenario = dataclasses.replace(Scenario.named("table1/1"), time_step=0.05)
    options = LiteralOptions(algorithm="full gradient", ladder=LITERAL_LADDER[3:4], confirm=False)
    run = run_boxes(plan_literal(scenario, options))
    assert run.problem.options is options
    assert run.rung is options.ladder[0]
    algorithm = run.problem.make_algorithm(run.rung)
    assert isinstance(algorithm, FullGradient)
    last = run.problem.run_aigo(run.rung).box
    np.testing.assert_array_equal(run.result.box.center, last.center)


def test_picked_iterates_shrink_evenly(run: BoxRun) -> None:
    shown = run.pick(10)
    widths = np.array([run.positions(run.result.history[i])[1].max() for i in shown])
    assert shown == sorted(set(shown)) and len(shown) <= 10
    assert shown[0] == 0 and shown[-1] == len(run.result.history) - 1
    assert np.all(np.diff(widths[:-1]) < 0)
    assert len(run.pick(10, smallest=widths[0])) == 2


def test_boxes_are_centers_and_half_widths_to_scale(meshcat: Meshcat, run: BoxRun) -> None:
    center, half_width = run.positions(run.result.history[0])
    paths = [f"{ROOT}/boxes/0/{k}" for k in range(len(center))]
    placed, scaled = clips(meshcat), clips(meshcat, "scale")
    places = [placed[path][1][0] for path in paths]
    heights = np.array([scaled[path][1][0, 1] for path in paths])
    metre = heights[5] / (2 * half_width[5, 0])
    wide = half_width[:, 0] > 0.1
    np.testing.assert_allclose(heights[wide], metre * 2 * half_width[wide, 0], rtol=1e-9)
    rise = np.array([place[1] for place in places])
    np.testing.assert_allclose(np.diff(rise), metre * np.diff(center[:, 0]), atol=1e-9)
    steps = np.diff([place[0] for place in places])
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)


def test_boxes_shrink_until_they_are_barely_seen(meshcat: Meshcat) -> None:
    heights = clips(meshcat, "scale")[f"{ROOT}/boxes/0/10"][1][:, 1]
    assert heights[0] > 3 * heights[-1] > 0


def test_one_text_is_shown_at_a_time_and_the_plan_at_the_end(meshcat: Meshcat) -> None:
    visible = clips(meshcat, "visible")
    plan_times, plan_shown = visible.pop(f"{ROOT}/boxes/plan")
    assert not plan_shown[0] and plan_shown[-1]
    texts = [path for path in visible if "/texts/" in path]
    assert len(texts) == len([path for path in objects(meshcat) if "/texts/" in path]) > 5
    for time in np.linspace(0, plan_times[-1], 50):
        shown = [bool(keys[times <= time][-1]) for times, keys in visible.values()]
        assert sum(shown) == 1


def test_all_parts_have_one_length(meshcat: Meshcat) -> None:
    ends = {round(times[-1], 6) for times, _ in clips(meshcat).values()}
    ends |= {round(times[-1], 6) for times, _ in clips(meshcat, "visible").values()}
    assert len(ends) == 1


@pytest.fixture
def painted(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    figures: list[Figure] = []

    def remember(figure: Figure, *corners: Any) -> Any:
        figures.append(figure)
        return make_mesh(figure, *corners)

    monkeypatch.setattr("drake_aigto.show.box_playback.make_mesh", remember)
    return figures


def test_each_coordinate_has_its_panel_and_nothing_passes_for_a_motion(
    painted: list[Figure],
) -> None:
    scenario = dataclasses.replace(Scenario.named("room/bank_shot"), time_step=0.1)
    options = PlanOptions(aigo_steps=10, confirm=False, finalists=1, branches=0)
    meshcat = Meshcat()
    play_boxes(Planner(scenario, options).plan(), meshcat)
    graph = painted[0]
    assert [axes.get_ylabel() for axes in graph.axes] == ["x position [m]", "y position [m]"]
    assert graph.texts[0].get_text() == "AIGO's boxes: the optimization, not a motion"
    assert painted[-1].texts[0].get_text() == "polished: plan (not a simulation)"
    assert painted[1].texts[0].get_text().startswith("iteration 0 of ")
    assert {path.split("/")[-2] for path in objects(meshcat) if path[-1].isdigit()} >= {"0", "1"}


def test_slow_motion_ends_where_annealing_does(plan: Plan) -> None:
    problem = make_ball_task(World.from_scenario(plan.scenario), plan.scenario, OPTIONS)
    annealing: Any = problem.make_algorithm(OPTIONS.ball_ladder[2])
    results: list[AigoResult] = [
        minimize(problem.polynomial, problem.box, algorithm)
        for algorithm in (annealing, SlowMotion(annealing))
    ]
    fast, slow = results
    assert slow.status is fast.status
    assert slow.num_inner_steps == pytest.approx(fast.num_inner_steps, abs=5)
    assert len(slow.history) > len(fast.history)
    np.testing.assert_allclose(slow.box.center, fast.box.center, atol=1e-6)
