"""Figures of the paper draw what its methods found, and write its numbers."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.paper_figures import paper_methods, plot_methods, write_numbers
from drake_aigto import Scenario, World, replay_event_driven
from drake_aigto.planning import Candidate, Origin
from drake_aigto.show import gradient_motions

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
