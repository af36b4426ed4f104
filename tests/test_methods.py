"""The paper's three methods, drawn with all that has to be known of their costs."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.paper_figures import paper_methods, plot_methods, write_numbers
from drake_aigto import Scenario, World
from drake_aigto.planning import Candidate, Origin

SCENARIO = dataclasses.replace(Scenario.named("table1/2"), time_step=0.02)


@pytest.fixture(scope="module")
def world() -> World:
    return World.from_scenario(SCENARIO)


@pytest.fixture(scope="module")
def runs(world: World) -> Mapping[str, Candidate]:
    return paper_methods(SCENARIO, world)


def test_boxes_alone_are_off_and_gradients_from_them_are_not(
    runs: Mapping[str, Candidate],
) -> None:
    aigto, refined, random = runs.values()
    assert list(runs) == ["AIGTO", "gradient from AIGTO", "gradient from a random guess"]
    assert not aigto.is_feasible and refined.is_feasible
    assert random.origin == Origin("random") and random.start_cost != aigto.start_cost


def test_the_same_seed_gives_the_same_guess(world: World, runs: Mapping[str, Candidate]) -> None:
    again, other = (list(paper_methods(SCENARIO, world, seed=i).values())[2] for i in (0, 1))
    first = list(runs.values())[2]
    assert again.start_cost == first.start_cost != other.start_cost


def test_each_method_has_its_line_and_velocities_are_aigtos(
    runs: Mapping[str, Candidate], world: World
) -> None:
    axes = Figure().subplots(3, 1)
    plot_methods(axes, runs, world, SCENARIO)
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
    for run in runs.values():
        for number in (f"{run.cost:.1e}", f"{run.max_defect:.0e}", f"{run.replay.cost:.1e}"):
            assert number in written
