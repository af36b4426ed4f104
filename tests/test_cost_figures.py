"""Figures of costs and phase portraits draw what they say."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from box_programs import compile_program
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from pydrake.solvers import ExpressionCost, MathematicalProgram

from benchmarks.paper_figures import (
    paper_methods,
    plot_integrated_product,
    plot_methods,
    write_numbers,
)
from drake_aigto import Scenario, World, replay_event_driven
from drake_aigto.errors import ModelError
from drake_aigto.paper import bounce_costs, rigid_optimum
from drake_aigto.planning import Candidate, Origin
from drake_aigto.show import (
    Motion,
    gradient_motions,
    plot_cost_history,
    plot_cost_landscape,
    plot_phase_portrait,
    run_boxes,
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return dataclasses.replace(Scenario.named("table1/1"), time_step=0.05)


@pytest.mark.parametrize("half_width", [0.0, 1.0, 2.5])
def test_the_integrated_product_is_aigos_mean_of_the_penalty(axes: Axes, half_width: float) -> None:
    plot_integrated_product(axes, half_width)
    prog = MathematicalProgram()
    x, y = prog.NewContinuousVariables(2)
    prog.AddCost(ExpressionCost(x**2 * y**2), vars=np.array([x, y]))
    f = compile_program(prog)
    drawn: list[Any] = list(axes.collections)
    (levels,) = {tuple(each.levels) for each in drawn if each.filled}
    corner = f.mean(np.array([3.0, -3.0]), np.full(2, half_width))
    assert levels[-1] == pytest.approx(corner)
    lowest = [line for line in axes.lines if line.get_marker() == "o"]
    assert len(lowest) == (half_width > 0)
    assert axes.get_title() == ("mean over ±1" if half_width == 1 else axes.get_title())


def test_cost_falls_over_iterations_and_defects_have_their_own_scale(axes: Axes, plan: Any) -> None:
    run = run_boxes(plan)
    right = plot_cost_history(axes, run)
    mean, cost = axes.lines
    (defect,) = right.lines
    history = run.result.history
    np.testing.assert_array_equal(mean.get_ydata(), [iterate.mean for iterate in history])
    assert np.asarray(mean.get_xdata())[-1] == run.result.num_inner_steps
    center = history[-1].box.center
    assert np.asarray(cost.get_ydata())[-1] == run.transcription.scenario_cost(center)
    largest = max(run.transcription.defects(center).values())
    assert np.asarray(defect.get_ydata())[-1] == largest
    assert (axes.get_yscale(), right.get_yscale()) == ("log", "log")
    legend = axes.get_legend()
    assert legend is not None and "largest defect" in legend.get_texts()[-1].get_text()


def test_bounces_cost_least_at_the_exact_optimum(world: World, scenario: Scenario) -> None:
    optimum = rigid_optimum(world, scenario)
    time, speed = optimum.bounce_times[0], -optimum.impact_velocities[0]
    assert bounce_costs(world, scenario, time, speed) == pytest.approx(optimum.cost)
    times, speeds = np.meshgrid(np.linspace(0.01, 0.99, 99), np.linspace(0.0, 4.0, 81))
    costs = bounce_costs(world, scenario, times, speeds)
    assert np.nanmin(costs) >= optimum.cost
    assert np.nanmin(costs) == pytest.approx(optimum.cost, rel=0.3)


def test_a_touch_that_only_comes_after_another_has_no_cost(world: World) -> None:
    fast: dict[str, Any] = {"initial_velocity": -6.0, "time_step": 0.05}
    scenario = dataclasses.replace(Scenario.named("table1/1"), **fast)
    # At −6 m/s it is at the wall long before 0.9 s, unless it brakes, which an early end of the
    # cubic can not: it dips below.
    costs = bounce_costs(world, scenario, np.array([0.15, 0.9]), np.array([6.0, 0.1]))
    assert np.isfinite(costs[0]) and np.isnan(costs[1])
    s = np.linspace(0, 1, 1001)
    hermite = (1 + 2 * s) * (1 - s) ** 2 - 6 * 0.9 * s * (1 - s) ** 2 + 0.1 * 0.9 * s**2 * (1 - s)
    assert np.min(hermite) < 0


def test_a_landscape_has_the_optimum_and_where_methods_end(
    axes: Axes, world: World, scenario: Scenario, plan: Any
) -> None:
    flight = dataclasses.replace(plan.best, contacts=())
    plot_cost_landscape(axes, world, scenario, {"AIGTO": plan.best, "other": flight})
    star, ours, other = axes.lines
    (contact,) = plan.best.contacts
    assert np.asarray(ours.get_xdata())[0] == contact.time
    at = np.asarray(star.get_xydata()), np.asarray(ours.get_xydata())
    np.testing.assert_allclose(*at, atol=0.02)
    assert np.all(np.isnan(np.asarray(other.get_xydata())))
    assert [str(line.get_label()) for line in axes.lines] == [
        "exact optimum",
        "AIGTO: holds",
        "other: holds, no contact",
    ]


def test_a_landscape_of_several_walls_is_refused(axes: Axes) -> None:
    corridor = Scenario.named("room/two_walls")
    with pytest.raises(ModelError, match="the exact optimum"):
        plot_cost_landscape(axes, World.from_scenario(corridor), corridor, {})


BOUNCE = Motion(
    "bounce",
    np.array([0.0, 0.5, 0.5, 1.0]),
    np.array([[1.0], [0.0], [0.0], [0.8]]),
    np.array([[-2.0], [-2.0], [1.6], [1.6]]),
)


def test_a_phase_portrait_is_velocity_against_position(
    axes: Axes, world: World, scenario: Scenario
) -> None:
    plot_phase_portrait(axes, [BOUNCE], world, scenario)
    way = next(line for line in axes.lines if line.get_label() == "bounce")
    np.testing.assert_array_equal(
        way.get_xydata(), np.hstack([BOUNCE.positions, BOUNCE.velocities])
    )
    start = next(line for line in axes.lines if line.get_label() == "start")
    np.testing.assert_array_equal(start.get_xydata(), [[1.0, -2.0]])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("position q [m]", "velocity v [m/s]")
    (wall,) = axes.patches
    low, high = axes.get_xlim()
    box = wall.get_extents().transformed(axes.transData.inverted())
    assert box.x0 < low < 0 == pytest.approx(box.x1, abs=1e-9) and high > 1


SCENARIO = dataclasses.replace(Scenario.named("table1/2"), time_step=0.02)


@pytest.fixture(scope="module")
def row_2() -> World:
    return World.from_scenario(SCENARIO)


@pytest.fixture(scope="module")
def runs(row_2: World) -> Mapping[str, Candidate]:
    return paper_methods(SCENARIO, row_2)


def test_boxes_alone_are_off_and_gradients_from_them_are_not(runs: Mapping[str, Candidate]) -> None:
    aigto, refined, random = runs.values()
    assert list(runs) == ["AIGTO", "gradient from AIGTO", "gradient from a random guess"]
    assert not aigto.is_feasible and refined.is_feasible
    assert random.origin == Origin("random") and random.start_cost != aigto.start_cost


def test_each_method_has_its_line_and_velocities_are_aigtos(
    runs: Mapping[str, Candidate], row_2: World
) -> None:
    axes = Figure().subplots(3, 1)
    plot_methods(axes, runs, row_2, SCENARIO)
    labels = [line.get_label() for line in axes[0].lines]
    assert labels[:3] == list(runs)
    aigto = list(runs.values())[:2]
    fastest = max(np.max(np.abs(run.trajectory.velocities)) for run in aigto)
    assert max(map(abs, axes[1].get_ylim())) <= 2.5 * fastest


def test_no_cost_is_written_without_what_makes_it_worth_something(
    runs: Mapping[str, Candidate],
) -> None:
    axes: Axes = Figure().add_subplot()
    write_numbers(axes, runs)
    written = [text.get_text() for text in axes.texts]
    assert written[:5] == ["cost", "defect", "in wall", "energy", "rigid"]
    costs = [f"{float(text):.1e}" for text in written if re.fullmatch(r"[\d.e+-]+", text)]
    for run in runs.values():
        assert f"{run.max_defect:.0e}" in written
        for cost in (run.cost, run.replay.cost):
            assert f"{cost:.1e}" in costs


@pytest.mark.slow
def test_before_one_wall_it_is_a_plan_and_its_simulation() -> None:
    scenario = Scenario.named("table1/1")
    world = World.from_scenario(scenario)
    planned, simulated = gradient_motions(world, scenario)
    assert planned.label == "SNOPT from zero: plan (not a simulation)"
    assert simulated.label == "SNOPT from zero: simulation: exactly rigid"
    assert planned.controls is not None and simulated.controls is not None
    np.testing.assert_array_equal(planned.controls, simulated.controls)
    # It brakes and turns before the wall, as the paper says of gradient solvers.
    assert not planned.touches and np.min(planned.positions) > 0.1
    np.testing.assert_array_equal(planned.positions[0], scenario.initial_position)


def test_between_walls_it_is_the_simulation_of_one_guess() -> None:
    scenario = dataclasses.replace(Scenario.named("corridor/lossy"), time_step=0.1)
    world = World.from_scenario(scenario)
    (simulated,) = gradient_motions(world, scenario, seed=1)
    assert simulated.label == "SNOPT from a random guess: simulation: exactly rigid"
    assert simulated.control_times is not None and simulated.controls is not None
    replay = replay_event_driven(world, scenario, simulated.control_times, simulated.controls)
    np.testing.assert_allclose(simulated.positions[-1], replay.positions[-1])
    (again,) = gradient_motions(world, scenario, seed=1)
    np.testing.assert_array_equal(again.positions, simulated.positions)
