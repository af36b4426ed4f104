"""Figures draw the numbers that they are given, name and unit on every axis."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from drake_aigto import Scenario, World
from drake_aigto.aigo import Box, Iterate
from drake_aigto.show.figures import (
    plot_boxes,
    plot_controls,
    plot_motions,
    plot_positions,
    plot_velocities,
)
from drake_aigto.show.motion import PALETTE, Motion
from drake_aigto.transcription import LiteralTranscription, RigidTranscription

TIMES = np.array([0.0, 0.5, 0.5, 1.0])
PLAN = Motion(
    "plan (not a simulation)",
    TIMES,
    np.array([[1.0], [0.0], [0.0], [0.8]]),
    np.array([[-2.0], [-2.0], [1.6], [1.6]]),
    np.array([0.0, 0.4, 1.0]),
    np.array([[0.3], [-0.2]]),
)
TOUCHES = dataclasses.replace(
    PLAN,
    control_times=np.array([0.0, 0.5, 0.6, 0.8, 1.0]),
    controls=np.array([[0.0], [-3.0], [-5.0], [0.3]]),
    forces=np.array([[0.0], [3.0], [5.0], [0.0]]),
    contacts=((0.25, 0.25), (0.5, 0.8)),
)
SIMULATION = Motion("simulation", TIMES, PLAN.positions * 0.9, PLAN.velocities * 0.9)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.named("table1/1")


@pytest.fixture(scope="module")
def world(scenario: Scenario) -> World:
    return World.from_scenario(scenario)


@pytest.fixture
def axes() -> Axes:
    return Figure().add_subplot()


def line(axes: Axes, label: str) -> Any:
    """Returns the one line of this label."""
    (found,) = (line for line in axes.lines if line.get_label() == label)
    return found


def labels(axes: Axes) -> list[str]:
    """Returns the texts of the legend."""
    legend = axes.get_legend()
    assert legend is not None
    return [text.get_text() for text in legend.get_texts()]


def test_lines_are_the_motions(axes: Axes, world: World, scenario: Scenario) -> None:
    plot_positions(axes, [PLAN, SIMULATION], world, scenario)
    for motion, color in zip([PLAN, SIMULATION], PALETTE, strict=False):
        drawn = line(axes, motion.label)
        np.testing.assert_array_equal(drawn.get_xdata(), motion.times)
        np.testing.assert_array_equal(drawn.get_ydata(), motion.positions[:, 0])
        assert to_hex(drawn.get_color()).upper() == color
    assert labels(axes) == ["plan (not a simulation)", "simulation", "goal", "wall"]


def test_an_impact_is_a_vertical_line_of_the_velocity(axes: Axes) -> None:
    plot_velocities(axes, [PLAN])
    np.testing.assert_array_equal(line(axes, PLAN.label).get_ydata(), PLAN.velocities[:, 0])
    assert axes.get_ylabel() == "velocity v [m/s]"


def test_a_control_is_held_between_knots(axes: Axes) -> None:
    plot_controls(axes, [PLAN, SIMULATION])
    control, *_ = axes.lines
    assert control.get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(control.get_xydata(), [[0.0, 0.3], [0.4, -0.2], [1.0, -0.2]])
    assert sum(to_hex(drawn.get_color()).upper() in PALETTE for drawn in axes.lines) == 1


def test_three_axes_share_their_colors_and_have_units(world: World, scenario: Scenario) -> None:
    axes: Sequence[Axes] = Figure().subplots(3, 1)
    plot_motions(axes, [PLAN, SIMULATION], world, scenario)
    assert [ax.get_ylabel() for ax in axes] == [
        "position q [m]",
        "velocity v [m/s]",
        "control u [N]",
    ]
    assert [ax.get_xlabel() for ax in axes] == ["", "", "time t [s]"]
    assert {ax.lines[0].get_color() for ax in axes} == {PALETTE[0]}


def test_planned_contacts_are_marked_in_all_axes_and_named_once(
    world: World, scenario: Scenario
) -> None:
    axes: Sequence[Axes] = Figure().subplots(3, 1)
    plot_motions(axes, [PLAN, TOUCHES, TOUCHES], world, scenario)
    for ax in axes:
        lines: list[Any] = list(ax.lines)
        dotted = [to_hex(drawn.get_color()) for drawn in lines if set(drawn.get_xdata()) == {0.25}]
        boxes = [patch.get_extents().transformed(ax.transData.inverted()) for patch in ax.patches]
        bands = [(box.x0, box.x1) for box in boxes if box.x0 == pytest.approx(0.5)]
        assert [color.upper() for color in dotted] == list(PALETTE[1:3])
        np.testing.assert_allclose(bands, [(0.5, 0.8)] * 2)
    assert labels(axes[0]).count("planned contact") == 1


def test_the_force_of_a_contact_that_lasts_is_shaded_where_it_acts(axes: Axes) -> None:
    plot_controls(axes, [TOUCHES])
    (shade,) = axes.collections
    assert shade.get_label() == "force of the wall λ [N]" in labels(axes)
    (path,) = shade.get_paths()
    for time, force in {0.25: 0.0, 0.55: 3.0, 0.7: 5.0, 0.9: 0.0}.items():
        inside = path.contains_points([(time, force - 0.1), (time, force + 0.1)])
        assert inside.tolist() == [force > 0, False]


def test_no_force_no_legend(axes: Axes) -> None:
    plot_controls(axes, [dataclasses.replace(PLAN, forces=np.zeros((2, 1)))])
    assert not axes.collections and axes.get_legend() is None


def wall_edges(axes: Axes) -> tuple[float, float]:
    """Returns from where to where the wall is shaded."""
    (patch,) = axes.patches
    box = patch.get_extents().transformed(axes.transData.inverted())
    return box.y0, box.y1


def test_the_wall_is_shaded_where_the_distance_is_negative(
    axes: Axes, world: World, scenario: Scenario
) -> None:
    plot_positions(axes, [PLAN], world, scenario)
    low, high = wall_edges(axes)
    assert high == pytest.approx(0)
    assert low < axes.get_ylim()[0] < -0.05
    assert world.calc_signed_distance(np.array([low]))[0] < 0


def test_a_wall_above_is_shaded_above(axes: Axes, scenario: Scenario) -> None:
    class Mirrored:
        num_positions = 1

        def calc_signed_distance(self, q: np.ndarray) -> np.ndarray:
            return 3 - 2 * q

        def calc_contact_jacobian(self, q: np.ndarray) -> np.ndarray:
            return np.array([[-2.0]])

    world: Any = Mirrored()
    plot_positions(axes, [PLAN], world, scenario)
    low, high = wall_edges(axes)
    assert low == pytest.approx(1.5)
    assert high > axes.get_ylim()[1] > 1.55


def test_axes_that_share_a_scale_show_all_of_it_and_the_wall(
    world: World, scenario: Scenario
) -> None:
    axes: Sequence[Axes] = Figure().subplots(1, 2, sharey=True)
    far = dataclasses.replace(PLAN, positions=3 * PLAN.positions)
    for ax, motion in zip(axes, [PLAN, far], strict=True):
        plot_positions(ax, [motion], world, scenario)
    low, high = axes[0].get_ylim()
    assert low < 0 and high > 3
    assert all(wall_edges(ax)[0] < low for ax in axes)


@pytest.mark.parametrize("kind", [LiteralTranscription, RigidTranscription])
@pytest.mark.parametrize(
    ("quantity", "part", "unit"),
    [("position", 0, "m"), ("velocity", 1, "m/s"), ("control", 2, "N")],
)
def test_boxes_are_bands_of_center_and_half_width(
    axes: Axes, world: World, quantity: Any, part: int, unit: str, kind: type
) -> None:
    scenario = Scenario(
        initial_position=1.0, initial_velocity=-2.0, goal_position=0.73, time_step=0.1
    )
    transcription = kind(world, scenario)
    n = transcription.prog().num_vars()
    center = np.linspace(1, 2, n)
    half_widths = [np.full(n, 0.5), np.full(n, 0.1)]
    iterates = [Iterate(Box(center, w), mean=0.0, temperature=0.0) for w in half_widths]
    plot_boxes(axes, transcription, iterates, quantity)
    values = transcription.split(center)[part][:, 0]
    for band, width in zip(axes.collections, (0.5, 0.1), strict=True):
        (path,) = band.get_paths()
        vertices = set(map(tuple, np.round(np.asarray(path.vertices), 9).tolist()))
        for t, c in zip(transcription.GetSampleTimes(), values, strict=False):
            assert {(round(t, 9), round(c + side * width, 9)) for side in (-1, 1)} <= vertices
    walls = ["wall"] if quantity == "position" else []
    assert labels(axes) == [f"within ±0.5 {unit}", f"within ±0.1 {unit}", *walls]
    assert axes.get_ylabel() == f"{quantity} {'qvu'[part]} [{unit}]"
    assert axes.get_xlabel() == "time t [s]"


def test_two_coordinates_look_different_and_have_one_label(axes: Axes) -> None:
    positions = np.column_stack([PLAN.positions, PLAN.positions])
    plot_velocities(axes, [Motion("plane", TIMES, positions, positions)])
    lines: list[Any] = axes.lines[:2]
    first, second = lines
    assert first.get_alpha() > second.get_alpha()
    # Matplotlib leaves labels that begin with an underscore out of legends.
    assert first.get_label() == "plane" and second.get_label().startswith("_")


def test_importing_figures_chooses_no_backend() -> None:
    program = (
        "import sys, drake_aigto.show.figures, drake_aigto.show.playback\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
