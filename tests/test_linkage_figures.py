"""Figures of mechanisms: each coordinate in its unit, links as they move, what soft walls push."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from mechanisms import build

from drake_aigto import Scenario, World
from drake_aigto.show import (
    Motion,
    coordinate_names,
    draw_mechanism,
    plot_contact_forces,
    plot_motions,
    plot_phase_portrait,
    plot_strobe,
)
from drake_aigto.transcription import Touch

TIMES = np.linspace(0.0, 1.0, 51)


@pytest.fixture(scope="module")
def soft() -> Scenario:
    """The cart-pole whose tip starts 0.1 m in front of the soft right wall, 200 N/m."""
    return Scenario(
        model="package://drake_aigto_models/cart_pole_soft_06.sdf",
        initial_position=[0.5, 0.0],
        initial_velocity=[1.0, 0.0],
        goal_position=[0.0, np.pi],
        goal_weight=[1.0, 1.0],
        contact="compliant",
    )


@pytest.fixture(scope="module")
def world(soft: Scenario) -> World:
    return World.from_scenario(soft)


def move(velocity: list[float], **more: Any) -> Motion:
    """Returns a motion from (0.5, 0) at a constant velocity for 1 s."""
    q = np.array([0.5, 0.0]) + np.outer(TIMES, velocity)
    return Motion("plan", TIMES, q, np.tile(velocity, (len(TIMES), 1)), **more)


def outlines(axes: Axes) -> list[np.ndarray]:
    return [np.asarray(patch.get_xy()) for patch in axes.patches if isinstance(patch, Polygon)]


def test_each_coordinate_has_its_name_and_unit(world: World, soft: Scenario) -> None:
    assert coordinate_names(world) == ["rail", "hinge"]
    grid = Figure().subplots(3, 2)
    control = np.array([0.0, 1.0]), np.array([[3.0]])
    plot_motions(grid, [move([0.1, 1.0]).under(*control)], world, soft)
    assert [each.get_ylabel() for each in grid.T.ravel()] == [
        *("rail position [m]", "rail velocity [m/s]", "rail control [N]"),
        *("hinge position [rad]", "hinge velocity [rad/s]", "hinge control [N m]"),
    ]
    assert [text.get_text() for text in grid[2, 1].texts] == ["no actuator"]


def test_a_goal_without_weight_is_not_drawn(world: World, soft: Scenario) -> None:
    task = Scenario.from_plain({**soft.to_plain(), "goal_weight": [0.0, 1.0]})
    grid = Figure().subplots(3, 2)
    plot_motions(grid, [move([0.1, 1.0])], world, task)
    stars = [[line for line in each.lines if line.get_marker() == "*"] for each in grid[0]]
    assert stars[0] == [] and stars[1][0].get_ydata() == [np.pi]
    plot_phase_portrait(axes := Figure().subplots(), [move([0.1, 1.0])], world, task, 0)
    assert "goal" not in axes.get_legend_handles_labels()[1]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("rail position [m]", "rail velocity [m/s]")


def test_soft_walls_push_as_deep_as_they_are_entered(
    axes: Axes, world: World, soft: Scenario
) -> None:
    plot_contact_forces(axes, [move([1.0, 0.0])], world, soft)
    (line,) = axes.lines
    depth = np.maximum(0.0, -world.calc_signed_distance(move([1.0, 0.0]).positions)[:, 1])
    assert np.max(depth) > 0.5
    stiffness = world.stiffness[1]
    np.testing.assert_allclose(np.asarray(line.get_ydata()), stiffness * depth, rtol=1e-12)
    assert [text.get_text() for text in axes.texts] == ["right wall"]


def test_links_are_drawn_where_they_are_at_evenly_spaced_times(
    axes: Axes, world: World, soft: Scenario
) -> None:
    motion = move([-0.5, 1.0], impacts=(Touch.bounce(0.5, 0),))
    plot_strobe(axes, motion, world, soft, count=5)
    shapes = outlines(axes)
    for t in (0.0, 0.25, 0.5, 0.75, 1.0):
        tip = np.array([0.5 - 0.5 * t + 0.8 * np.sin(t), -0.8 * np.cos(t)])
        assert any(
            np.allclose(shape.mean(axis=0), tip, atol=4e-3) and np.ptp(shape[:, 0]) < 0.1
            for shape in shapes
        )
    (contacts,) = (line for line in axes.lines if line.get_marker() == "o")
    # The left wall's face, less the tip's radius, is 0.6 m from the middle.
    assert np.asarray(contacts.get_xdata())[0] == pytest.approx(-0.64, abs=0.05)
    assert axes.get_aspect() == 1 and (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "z [m]")


def test_turns_of_the_goal_that_do_not_count_bring_it_near(world: World, soft: Scenario) -> None:
    task = Scenario.from_plain({**soft.to_plain(), "angles": "chordal"})
    grid = Figure().subplots(3, 2)
    plot_motions(grid, [move([0.0, -3.0])], world, task)
    stars = [line for line in grid[0, 1].lines if line.get_marker() == "*"]
    assert np.asarray(stars[0].get_ydata())[0] == pytest.approx(-np.pi)


def test_a_report_has_a_mechanism_in_pictures(world: World, soft: Scenario) -> None:
    motions = [move([1.0, 0.5]), move([1.0, 0.6])]
    captions = [caption for _, caption in draw_mechanism(motions, world, soft)]
    assert [caption.split()[0] for caption in captions] == ["Links", "Contact"]
    away = [move([-0.2, 0.1])]
    assert len(list(draw_mechanism(away, world, soft))) == 1


def test_what_keeps_to_no_plane_is_seen_from_a_little_above(axes: Axes) -> None:
    arm = build("arm with a slider")
    q = np.array([[0.0, 0.3, 0.0], [0.5, 0.2, 0.1]])
    task = Scenario(
        initial_position=q[0],
        initial_velocity=[0.0, 0.0, 0.0],
        goal_position=q[1],
        goal_weight=[1.0, 1.0, 1.0],
        control_weight=[1.0, 1.0, 1.0],
    )
    plot_strobe(axes, Motion("plan", np.array([0.0, 1.0]), q, 0 * q), arm, task)
    assert axes.get_ylabel() == "up, seen from above [m]"
    assert len(outlines(axes)) > 2
