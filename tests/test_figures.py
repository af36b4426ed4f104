"""Figures draw the numbers that they are given, name and unit on every axis; mechanisms, too."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from box_programs import compile_program
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from mechanisms import build
from pydrake.solvers import ExpressionCost, MathematicalProgram

from benchmarks.paper_figures import plot_integrated_product
from drake_aigto import Scenario, World
from drake_aigto.aigo import Box, Iterate
from drake_aigto.errors import ModelError
from drake_aigto.paper import LiteralTranscription, bounce_costs, rigid_optimum
from drake_aigto.show import (
    PALETTE,
    Motion,
    coordinate_names,
    draw_mechanism,
    plot_boxes,
    plot_contact_forces,
    plot_controls,
    plot_cost_history,
    plot_cost_landscape,
    plot_motions,
    plot_path,
    plot_phase_portrait,
    plot_positions,
    plot_strobe,
    run_boxes,
)
from drake_aigto.transcription import RigidTranscription, Touch

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
    touches=(Touch.bounce(0.25), Touch(0.5, 0.8)),
)
SIMULATION = Motion("simulation", TIMES, PLAN.positions * 0.9, PLAN.velocities * 0.9)


def line(axes: Axes, label: str) -> Any:
    (found,) = (line for line in axes.lines if line.get_label() == label)
    return found


def labels(axes: Axes) -> list[str]:
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


def test_a_control_is_held_between_knots(axes: Axes, world: World) -> None:
    plot_controls(axes, [PLAN, SIMULATION], world)
    control, *_ = axes.lines
    assert control.get_drawstyle() == "steps-post"
    np.testing.assert_array_equal(control.get_xydata(), [[0.0, 0.3], [0.4, -0.2], [1.0, -0.2]])
    assert sum(to_hex(drawn.get_color()).upper() in PALETTE for drawn in axes.lines) == 1
    assert not axes.collections and axes.get_legend() is None  # No force is shaded.


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
    # An impact is a vertical line.
    np.testing.assert_array_equal(line(axes[1], PLAN.label).get_ydata(), PLAN.velocities[:, 0])


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


def test_the_force_of_a_contact_that_lasts_is_shaded_where_it_acts(
    axes: Axes, world: World
) -> None:
    plot_controls(axes, [TOUCHES], world)
    (shade,) = axes.collections
    assert shade.get_label() == "force of the wall λ [N]" in labels(axes)
    (path,) = shade.get_paths()
    for time, force in {0.25: 0.0, 0.55: 3.0, 0.7: 5.0, 0.9: 0.0}.items():
        inside = path.contains_points([(time, force - 0.1), (time, force + 0.1)])
        assert inside.tolist() == [force > 0, False]


def wall_edges(axes: Axes) -> tuple[float, float]:
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


def test_walls_on_both_sides_are_shaded_on_both_sides(axes: Axes) -> None:
    scenario = Scenario.named("corridor/three_bounces")
    plot_positions(axes, [PLAN], World.from_scenario(scenario), scenario)
    boxes = [patch.get_extents().transformed(axes.transData.inverted()) for patch in axes.patches]
    left, right = ((box.y0, box.y1) for box in boxes)
    low, high = axes.get_ylim()
    assert left[0] < low < -0.05 < left[1] == pytest.approx(0)
    assert right[1] > high > 1.05 > right[0] == pytest.approx(1)
    assert labels(axes)[-1] == "walls"


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


# A quarter of a room, with a bounce at its right wall and one at its front wall.
PLANE = Motion(
    "plan",
    np.array([0.0, 0.4, 0.4, 0.7, 0.7, 1.0]),
    np.array([[0.6, 0.7], [1.0, 0.3], [1.0, 0.3], [0.7, 0.0], [0.7, 0.0], [0.4, 0.3]]),
    np.array([[1.0, -1.0]] * 2 + [[-1.0, -1.0]] * 2 + [[-1.0, 1.0]] * 2),
    np.array([0.0, 0.5, 1.0]),
    np.array([[0.1, 0.2], [0.3, 0.4]]),
    touches=(Touch.bounce(0.4, 1), Touch.bounce(0.7, 2)),
)


@pytest.fixture(scope="module")
def room() -> Scenario:
    return Scenario.named("room/two_walls")


def test_each_coordinate_has_its_column(room: Scenario) -> None:
    world = World.from_scenario(room)
    grid = Figure().subplots(3, 2)
    plot_motions(grid, [PLANE], world, room)
    for i, (name, column) in enumerate(zip("xy", grid.T, strict=True)):
        assert [axes.get_ylabel() for axes in column] == [
            f"{name} position [m]",
            f"{name} velocity [m/s]",
            f"{name} control [N]",
        ]
        top, middle, bottom = column
        np.testing.assert_array_equal(line(top, "plan").get_ydata(), PLANE.positions[:, i])
        np.testing.assert_array_equal(line(middle, "plan").get_ydata(), PLANE.velocities[:, i])
        assert PLANE.controls is not None
        np.testing.assert_array_equal(bottom.lines[0].get_ydata()[:-1], PLANE.controls[:, i])
        goals = [drawn.get_ydata() for drawn in top.lines if drawn.get_marker() == "*"]
        assert goals[0] == room.goal_position[i]
    assert [axes.get_legend() is None for axes in grid[0]] == [False, True]


def test_only_touches_that_push_a_coordinate_are_in_its_column_by_name(room: Scenario) -> None:
    grid = Figure().subplots(3, 2)
    plot_motions(grid, [PLANE], World.from_scenario(room), room)
    for column, time, name in zip(grid.T, (0.4, 0.7), ("right wall", "front wall"), strict=True):
        assert [text.get_text() for text in column[0].texts] == [name]
        for axes in column:
            dotted = [drawn.get_xdata()[0] for drawn in axes.lines if len(drawn.get_xdata()) == 2]
            assert time in dotted and {0.4, 0.7} - {time} != set(dotted) & {0.4, 0.7}


def test_too_few_axes_paths_of_one_coordinate_and_landscapes_of_several_walls_are_refused(
    axes: Axes, world: World, scenario: Scenario, room: Scenario
) -> None:
    with pytest.raises(ModelError, match=r"got one coordinate, expected two\. Use plot_positions"):
        plot_path(axes, [PLAN], world, scenario)
    with pytest.raises(ModelError, match=r"axes: got \(3, 1\), expected \(3, 2\)"):
        plot_motions(Figure().subplots(3, 1), [PLANE], World.from_scenario(room), room)
    corridor = Scenario.named("room/two_walls")
    with pytest.raises(ModelError, match="the exact optimum"):
        plot_cost_landscape(axes, World.from_scenario(corridor), corridor, {})


def solids(axes: Axes) -> list[np.ndarray]:
    return [np.asarray(patch.get_xy())[:-1] for patch in axes.patches if isinstance(patch, Polygon)]


def test_a_path_has_its_start_goal_and_bounces(axes: Axes, room: Scenario) -> None:
    plot_path(axes, [PLANE], World.from_scenario(room), room)
    np.testing.assert_array_equal(line(axes, "plan").get_xydata(), PLANE.positions)
    bounces = line(axes, "planned contact").get_xydata()
    np.testing.assert_array_equal(bounces, [[1.0, 0.3], [0.7, 0.0]])
    np.testing.assert_array_equal(line(axes, "start").get_xydata(), [room.initial_position])
    stars: list[Any] = [drawn for drawn in axes.lines if drawn.get_marker() == "*"]
    np.testing.assert_array_equal(stars[0].get_xydata(), [room.goal_position])
    assert axes.get_aspect() == 1
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x position [m]", "y position [m]")


def test_solids_are_where_the_ball_can_not_be(axes: Axes) -> None:
    scenario = Scenario.named("room_with_block/around")
    plot_path(axes, [PLANE], World.from_scenario(scenario), scenario)
    *walls, block = solids(axes)
    assert len(walls) == 4
    square = [(x, y) for x in (0.4, 0.6) for y in (0.4, 0.6)]
    assert sorted(map(tuple, np.round(block, 12).tolist())) == square
    assert axes.get_xlim() == axes.get_ylim() == pytest.approx((-0.05, 1.05))


def test_two_masses_on_a_line_can_not_change_places(axes: Axes) -> None:
    scenario = Scenario.named("two_masses/apart")
    world = World.from_scenario(scenario)
    assert coordinate_names(world) == ["left slider", "right slider"]
    plot_path(axes, [PLANE], world, scenario)
    _, beyond, _ = solids(axes)
    assert np.all(beyond[:, 0] >= beyond[:, 1] - 1e-12)
    assert np.any(beyond[:, 0] > beyond[:, 1] + 0.1)


EVEN = np.linspace(0.0, 1.0, 51)


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
def cart_pole(soft: Scenario) -> World:
    return World.from_scenario(soft)


def move(velocity: list[float], **more: Any) -> Motion:
    q = np.array([0.5, 0.0]) + np.outer(EVEN, velocity)
    return Motion("plan", EVEN, q, np.tile(velocity, (len(EVEN), 1)), **more)


def outlines(axes: Axes) -> list[np.ndarray]:
    return [np.asarray(patch.get_xy()) for patch in axes.patches if isinstance(patch, Polygon)]


def test_each_coordinate_has_its_name_and_unit(cart_pole: World, soft: Scenario) -> None:
    assert coordinate_names(cart_pole) == ["rail", "hinge"]
    grid = Figure().subplots(3, 2)
    control = np.array([0.0, 1.0]), np.array([[3.0]])
    plot_motions(grid, [move([0.1, 1.0]).under(*control)], cart_pole, soft)
    assert [each.get_ylabel() for each in grid.T.ravel()] == [
        *("rail position [m]", "rail velocity [m/s]", "rail control [N]"),
        *("hinge position [rad]", "hinge velocity [rad/s]", "hinge control [N m]"),
    ]
    assert [text.get_text() for text in grid[2, 1].texts] == ["no actuator"]


def test_a_goal_without_weight_is_not_drawn(cart_pole: World, soft: Scenario) -> None:
    task = Scenario.from_plain({**soft.to_plain(), "goal_weight": [0.0, 1.0]})
    grid = Figure().subplots(3, 2)
    plot_motions(grid, [move([0.1, 1.0])], cart_pole, task)
    stars = [[line for line in each.lines if line.get_marker() == "*"] for each in grid[0]]
    assert stars[0] == [] and stars[1][0].get_ydata() == [np.pi]
    plot_phase_portrait(axes := Figure().subplots(), [move([0.1, 1.0])], cart_pole, task, 0)
    assert "goal" not in axes.get_legend_handles_labels()[1]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("rail position [m]", "rail velocity [m/s]")


def test_soft_walls_push_as_deep_as_they_are_entered(
    axes: Axes, cart_pole: World, soft: Scenario
) -> None:
    plot_contact_forces(axes, [move([1.0, 0.0])], cart_pole, soft)
    (line,) = axes.lines
    depth = np.maximum(0.0, -cart_pole.calc_signed_distance(move([1.0, 0.0]).positions)[:, 1])
    assert np.max(depth) > 0.5
    stiffness = cart_pole.stiffness[1]
    np.testing.assert_allclose(np.asarray(line.get_ydata()), stiffness * depth, rtol=1e-12)
    assert [text.get_text() for text in axes.texts] == ["right wall"]


def test_links_are_drawn_where_they_are_at_evenly_spaced_times(
    axes: Axes, cart_pole: World, soft: Scenario
) -> None:
    motion = move([-0.5, 1.0], impacts=(Touch.bounce(0.5, 0),))
    plot_strobe(axes, motion, cart_pole, soft, count=5)
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


def test_turns_of_the_goal_that_do_not_count_bring_it_near(
    cart_pole: World, soft: Scenario
) -> None:
    task = Scenario.from_plain({**soft.to_plain(), "angles": "chordal"})
    grid = Figure().subplots(3, 2)
    plot_motions(grid, [move([0.0, -3.0])], cart_pole, task)
    stars = [line for line in grid[0, 1].lines if line.get_marker() == "*"]
    assert np.asarray(stars[0].get_ydata())[0] == pytest.approx(-np.pi)


def test_a_report_has_a_mechanism_in_pictures(cart_pole: World, soft: Scenario) -> None:
    motions = [move([1.0, 0.5]), move([1.0, 0.6])]
    captions = [caption for _, caption in draw_mechanism(motions, cart_pole, soft)]
    assert [caption.split()[0] for caption in captions] == ["Links", "Contact"]
    away = [move([-0.2, 0.1])]
    assert len(list(draw_mechanism(away, cart_pole, soft))) == 1


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
