"""Mechanisms and their friction in Meshcat, as they are; AIGO's boxes, played as they shrink."""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from mechanisms import build
from meshcat_pages import clips, make_motion, objects, position, recording
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Meshcat
from pydrake.math import RotationMatrix

from drake_aigto import Plan, Planner, PlanOptions, Scenario, World
from drake_aigto.aigo import FullGradient
from drake_aigto.errors import OptionsError
from drake_aigto.paper import LITERAL_LADDER, LiteralOptions, plan_literal
from drake_aigto.planning import BALL_LADDER, Origin
from drake_aigto.show import (
    ROOT,
    BoxRun,
    Motion,
    Stage,
    make_mesh,
    moves_straight,
    play_boxes,
    plot_friction,
    publish,
    run_boxes,
)
from drake_aigto.transcription import Touch
from drake_aigto.world import models_directory

GONE = 2e-3
TIP, STICK = "mechanism/pole/tip", "mechanism/pole/stick_0"


@pytest.fixture(scope="module")
def cart_pole() -> World:
    return build("cart-pole")


def swing(label: str = "plan", **more: Any) -> Motion:
    times = np.linspace(0.0, 1.0, 101)
    q = np.column_stack([np.maximum(0.0, times - 0.5), 2 * times - 0.5])
    return Motion(label, times, q, np.gradient(q, times, axis=0), **more)


def ask(**fields: Any) -> Scenario:
    asked: dict[str, Any] = {
        "initial_position": [0.0, -0.5],
        "initial_velocity": [0.0, 0.0],
        "goal_position": [0.2, 3.0],
        "goal_weight": [1.0, 1.0],
    }
    return Scenario(**{**asked, **fields})


def rotations(meshcat: Meshcat, path: str) -> np.ndarray:
    _, quaternions = clips(meshcat, "quaternion")[path]
    return np.array([RotationMatrix(Quaternion(w, x, y, z)).matrix() for x, y, z, w in quaternions])


def show(meshcat: Meshcat, world: World, *motions: Motion, **fields: Any) -> None:
    publish(motions, meshcat, world, ask(**fields))


def test_links_turn_about_their_joints_in_a_copy_for_each_motion(
    meshcat: Meshcat, cart_pole: World
) -> None:
    show(meshcat, cart_pole, swing("plan"), swing("integrated"), swing("Drake"))
    for copy in (1, 2, 3):
        times, tips = clips(meshcat)[f"{ROOT}/motions/{copy}/{TIP}"]
        playing = times <= 1.0
        cart, angle = np.maximum(0.0, times - 0.5)[playing], 2 * times[playing] - 0.5
        aside = tips[0, 0] - 0.8 * np.sin(-0.5)
        base = tips[0, 2] + 0.8 * np.cos(-0.5)
        path = np.array([aside + cart + 0.8 * np.sin(angle), base - 0.8 * np.cos(angle)]).T
        np.testing.assert_allclose(tips[playing][:, [0, 2]], path, atol=1e-9)
        # The stick stands for the pole: its axis is that from the hinge to the tip.
        axes = rotations(meshcat, f"{ROOT}/motions/{copy}/{STICK}")[playing][:, :, 2]
        expected = np.column_stack([np.sin(angle), 0 * angle, -np.cos(angle)])
        np.testing.assert_allclose(axes, expected, atol=1e-9)
        # The walls are where the tip's face touches them.
        left = position(meshcat, f"{ROOT}/worlds/{copy}/mechanism/wall/left")
        assert left[0] < aside - 0.6


def test_the_control_of_a_slider_is_an_arrow_at_its_joint(
    meshcat: Meshcat, cart_pole: World
) -> None:
    times, controls = np.array([0.0, 0.4, 1.0]), np.array([[5.0], [-10.0]])
    show(meshcat, cart_pole, swing().under(times, controls))
    path = f"{ROOT}/motions/1/control/cart_joint/arrow"
    keys, sizes = clips(meshcat, "scale")[path]
    assert np.all(sizes[keys > 1.0] < GONE)
    times, places = clips(meshcat)[path]
    directions = rotations(meshcat, path)[:, :, 2]
    for held, size, side in ((times < 0.395, 0.5, 1), (times > 0.405, 1.0, -1)):
        np.testing.assert_allclose(sizes[: len(times)][held], size)
        np.testing.assert_allclose(directions[held] - [side, 0, 0], 0, atol=1e-12)
    np.testing.assert_allclose(np.ptp(places[:, 0]), 0.5)  # It goes with the cart.


def test_the_control_of_a_hinge_is_an_arc_about_its_axis(meshcat: Meshcat) -> None:
    world = build("double pendulum")
    times = np.array([0.0, 1.0])
    q = np.array([[0.3, 0.2], [0.5, 0.2]])
    motion = Motion("plan", times, q, np.zeros((2, 2))).under(times, np.array([[-2.0]]))
    show(meshcat, world, motion)
    path = f"{ROOT}/motions/1/control/lower_joint/arc"
    shown = rotations(meshcat, path)[0]
    np.testing.assert_allclose(shown[:, 2], [0, -1, 0], atol=1e-12)  # The hinge's axis is +y.
    elbow = clips(meshcat)[path][1][0]
    np.testing.assert_allclose(elbow[[0, 2]], [-np.sin(0.3), -np.cos(0.3)], atol=1e-12)
    assert {f"{path}/ring", f"{path}/head"} <= set(objects(meshcat))


def test_a_contact_that_lasts_has_an_arrow_while_it_lasts(
    meshcat: Meshcat, cart_pole: World
) -> None:
    forces = np.array([[0.0, 0.0], [0.0, 8.0], [0.0, 0.0]])
    knots = np.array([0.0, 0.3, 0.5, 1.0])
    held: dict[str, Any] = {"control_times": knots, "controls": np.zeros((3, 1)), "forces": forces}
    show(meshcat, cart_pole, swing(**held))
    path = f"{ROOT}/motions/1/contacts/1/force"
    keys, sizes = clips(meshcat, "scale")[path]
    np.testing.assert_allclose(sizes[(keys > 0.305) & (keys < 0.495)], 1.0)
    assert np.all(sizes[(keys < 0.295) | (keys > 0.505)] < GONE)
    # The right wall, whose face is at 0.6 m, pushes to the left.
    times, places = clips(meshcat)[path]
    pushing = (times > 0.305) & (times < 0.495)
    directions = rotations(meshcat, path)[pushing, :, 2]
    np.testing.assert_allclose(directions - [-1, 0, 0], 0, atol=1e-12)
    np.testing.assert_allclose(places[pushing, 0], 0.6)


def test_ghosts_are_the_start_and_the_goal(meshcat: Meshcat, cart_pole: World) -> None:
    show(meshcat, cart_pole, swing())
    start = position(meshcat, f"{ROOT}/ghosts/1/start/{TIP}")
    goal = position(meshcat, f"{ROOT}/ghosts/1/goal/{TIP}")
    moved = [0.2 + 0.8 * (np.sin(3.0) + np.sin(0.5)), 0, 0.8 * (np.cos(0.5) - np.cos(3.0))]
    np.testing.assert_allclose(goal - start, moved, atol=1e-12)
    material = objects(meshcat)[f"{ROOT}/ghosts/1/goal/{TIP}"]["materials"][0]
    assert material["transparent"] and material["opacity"] < 0.5


def test_a_goal_without_weight_is_where_the_motion_ends(meshcat: Meshcat, cart_pole: World) -> None:
    show(meshcat, cart_pole, swing(), goal_weight=[0.0, 1.0])
    start = position(meshcat, f"{ROOT}/ghosts/1/start/{TIP}")
    goal = position(meshcat, f"{ROOT}/ghosts/1/goal/{TIP}")
    assert goal[0] - start[0] == pytest.approx(0.5 + 0.8 * (np.sin(3.0) + np.sin(0.5)))
    show(meshcat, cart_pole, swing(), goal_weight=[0.0, 0.0])
    assert not [path for path in objects(meshcat) if "/goal/" in path]


def test_the_window_has_all_of_a_motion_in_it(cart_pole: World) -> None:
    motion = swing()
    stage = Stage(cart_pole, motion.positions)
    (tips,) = stage.trace(motion.positions)
    assert stage.is_flat
    np.testing.assert_allclose(np.ptp(tips[:, 2]), 0, atol=1e-12)
    assert np.all(tips[:, :2] - 0.05 >= stage.low - 1e-9)
    assert np.all(tips[:, :2] + 0.05 <= stage.high + 1e-9)
    # Walls at ±0.6 m are near enough to be seen.
    assert stage.low[0] < -0.6 and stage.high[0] > 0.6
    assert tips[0, 1] < tips[-1, 1]  # Up is up.


def test_what_keeps_to_no_plane_is_seen_from_a_little_above() -> None:
    world = build("arm with a slider")
    stage = Stage(world, np.array([[0.0, 0.3, 0.0], [0.5, 0.2, 0.1]]))
    assert not stage.is_flat
    x, y, towards = stage.X_WT.rotation().matrix().T
    assert abs(x[2]) < 1e-12 and y[2] > 0.9 and 0.4 < towards[2] < 0.5


def test_discs_and_links_do_not_move_straight(cart_pole: World) -> None:
    assert not moves_straight(cart_pole) and not moves_straight(build("two discs"))


@pytest.fixture(scope="module")
def run(plan: Plan) -> BoxRun:
    return run_boxes(plan)


@pytest.fixture(scope="module")
def shown(plan: Plan, run: BoxRun) -> Meshcat:
    shown = Meshcat()
    play_boxes(plan, shown, run=run)
    return shown


def test_the_rung_that_the_plan_came_from_is_run_again(plan: Plan, run: BoxRun) -> None:
    assert plan.best.origin.rung == run.rung in BALL_LADDER
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


@pytest.mark.slow
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


def test_boxes_are_centers_and_half_widths_to_scale(shown: Meshcat, run: BoxRun) -> None:
    center, half_width = run.positions(run.result.history[0])
    paths = [f"{ROOT}/boxes/0/{k}" for k in range(len(center))]
    placed, scaled = clips(shown), clips(shown, "scale")
    places = [placed[path][1][0] for path in paths]
    heights = np.array([scaled[path][1][0, 1] for path in paths])
    metre = heights[5] / (2 * half_width[5, 0])
    wide = half_width[:, 0] > 0.1
    np.testing.assert_allclose(heights[wide], metre * 2 * half_width[wide, 0], rtol=1e-9)
    rise = np.array([place[1] for place in places])
    np.testing.assert_allclose(np.diff(rise), metre * np.diff(center[:, 0]), atol=1e-9)
    steps = np.diff([place[0] for place in places])
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)


def test_one_text_is_shown_at_a_time_and_the_plan_at_the_end(shown: Meshcat) -> None:
    visible = clips(shown, "visible")
    plan_times, plan_shown = visible.pop(f"{ROOT}/boxes/plan")
    assert not plan_shown[0] and plan_shown[-1]
    texts = [path for path in visible if "/texts/" in path]
    assert len(texts) == len([path for path in objects(shown) if "/texts/" in path]) > 5
    for time in np.linspace(0, plan_times[-1], 50):
        shown = [bool(keys[times <= time][-1]) for times, keys in visible.values()]
        assert sum(shown) == 1


@pytest.fixture
def painted(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    figures: list[Figure] = []

    def remember(figure: Figure, *corners: Any) -> Any:
        figures.append(figure)
        return make_mesh(figure, *corners)

    monkeypatch.setattr("drake_aigto.show.box_playback.make_mesh", remember)
    return figures


@pytest.mark.slow
def test_each_coordinate_has_its_panel_and_nothing_passes_for_a_motion(
    painted: list[Figure],
) -> None:
    scenario = dataclasses.replace(Scenario.named("room/bank_shot"), time_step=0.1)
    options = PlanOptions(aigo_steps=10, confirm=False, finalists=1, branches=0)
    shown = Meshcat()
    play_boxes(Planner(scenario, options).plan(), shown)
    graph = painted[0]
    assert [axes.get_ylabel() for axes in graph.axes] == ["x position [m]", "y position [m]"]
    assert graph.texts[0].get_text() == "AIGO's boxes: the optimization, not a motion"
    assert painted[-1].texts[0].get_text() == "polished: plan (not a simulation)"
    assert painted[1].texts[0].get_text().startswith("iteration 0 of ")
    assert {path.split("/")[-2] for path in objects(shown) if path[-1].isdigit()} >= {"0", "1"}


WEIGHT, PULL = 9.81, 1.5  # [N]
FOLDER = f"{ROOT}/motions/1"


@cache
def read(name: str) -> tuple[World, Scenario, float]:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    return world, scenario, float(world.friction_coefficients(scenario).max())


def drag() -> Motion:
    """Returns a block of 1 kg: pulled in vain, sliding from 0.3 s on, without weight from 0.7 s."""
    times = np.linspace(0.0, 1.0, 101)
    q = np.column_stack([np.maximum(0.0, times - 0.3), np.full(101, 0.15)])
    v = np.column_stack([times > 0.305, np.zeros(101)]).astype(float)
    knots = np.array([0.0, 0.3, 0.7, 1.0])
    controls, forces = np.array([[PULL], [5.0], [0.0]]), np.array([[WEIGHT], [WEIGHT], [0.0]])
    return Motion("plan", times, q, v, knots, controls, forces)


def seen(meshcat: Meshcat, path: str, times: list[float]) -> list[float]:
    """Returns how large an object is at these times."""
    keys, scales = clips(meshcat, "scale")[f"{FOLDER}/{path}"]
    return [float(np.interp(time, keys, scales[:, 0])) for time in times]


def point(meshcat: Meshcat, path: str, time: float) -> np.ndarray:
    """Returns where an object's z axis points at the last key before a time."""
    keys, quaternions = clips(meshcat, "quaternion")[f"{FOLDER}/{path}"]
    x, y, z, w = quaternions[np.searchsorted(keys, time) - 1]
    return RotationMatrix(Quaternion(w, x, y, z)).matrix()[:, 2]


def test_a_lasting_contact_has_a_filled_cone_while_it_sticks_and_ribs_while_it_slips(
    meshcat: Meshcat,
) -> None:
    world, scenario, mu = read("sliding_block/to_rest")
    publish([drag()], meshcat, world, scenario)
    cones = f"{FOLDER}/friction/0/force"
    shown = objects(meshcat)
    parts = {path.removeprefix(cones) for path in shown if path.startswith(cones)}
    assert parts == {"/stick", "/slip/rim", *(f"/slip/rib_{i}" for i in range(4))}
    cone = shown[f"{cones}/stick"]
    assert cone["materials"][0]["opacity"] < 0.5
    at = [0.1, 0.5, 0.8]
    assert seen(meshcat, "friction/0/force/stick", at) == pytest.approx([1, 0, 0], abs=GONE)
    assert seen(meshcat, "friction/0/force/slip", at) == pytest.approx([0, 1, 0], abs=GONE)
    assert point(meshcat, "friction/0/force/slip", 0.5) == pytest.approx([0, 0, 1])
    # What sticks takes the pull, what slips is at the edge of its cone.
    for time, friction in ((0.1, PULL), (0.5, mu * WEIGHT)):
        force = np.array([-friction, 0.0, WEIGHT])
        arrow = point(meshcat, "contacts/0/force", time)
        assert arrow == pytest.approx(force / np.linalg.norm(force), abs=1e-9)


@pytest.mark.parametrize("sticks", [True, False])
def test_an_impulse_is_seen_for_a_moment_with_the_cone_of_how_it_ends(
    meshcat: Meshcat, sticks: bool
) -> None:
    world, scenario, mu = read("billiard/spin_shot")
    contact, q = 3, np.array([0.5, 0.9, 0.0])
    J, T = world.calc_contact_jacobian(q)[contact], world.rubbing.calc_tangent_jacobian(q)[contact]
    after = 0.5 * J if sticks else 0.5 * J + T
    before = after - np.linalg.solve(world.calc_mass_matrix(q), 1.2 * J - 0.9 * mu * 1.2 * T)
    times = np.array([0.0, 0.4, 0.4, 1.0])
    places = np.array([q - 0.4 * before, q, q, q + 0.6 * after])
    velocities = np.array([before, before, after, after])
    struck = Motion("plan", times, places, velocities, impacts=(Touch.bounce(0.4, contact),))
    publish([struck], meshcat, world, scenario)
    folder, (mode, other) = f"friction/{contact}/impulse", ("stick", "slip")[:: 2 * sticks - 1]
    at = [0.39, 0.41, 0.69, 0.71]
    for part in ("arrow", mode):
        assert seen(meshcat, f"{folder}/{part}", at) == pytest.approx([0, 1, 1, 0], abs=GONE)
    assert not [path for path in objects(meshcat) if f"{folder}/{other}" in path]
    # The ball's two sliders carry its mass: its momentum changes along the impulse.
    change = np.append((after - before)[:2], 0.0)
    arrow = point(meshcat, f"{folder}/arrow", 0.5)
    assert arrow == pytest.approx(change / np.linalg.norm(change), abs=1e-9)
    cosine = arrow @ point(meshcat, f"{folder}/{mode}", 0.5)
    assert np.tan(np.arccos(cosine)) == pytest.approx(0.9 * mu)


def test_what_does_not_rub_has_no_cones(meshcat: Meshcat) -> None:
    world, scenario, _ = read("billiard/spin_shot")
    still = Motion("plan", np.array([0.0, 1.0]), np.full((2, 3), 0.5), np.zeros((2, 3)))
    publish([still], meshcat, world, scenario)
    assert not [path for path in objects(meshcat) if "/friction/" in path]


def test_a_figure_has_the_friction_of_contact_that_lasts_and_impulses_on_an_axis_of_their_own() -> (
    None
):
    world, scenario, mu = read("sliding_block/to_rest")
    plot_friction(axes := Figure().subplots(), drag(), world, scenario)
    line, rings, crosses = axes.lines
    assert axes.get_ylabel() == "friction [N]"
    times, friction = np.asarray(line.get_xdata()), np.abs(np.asarray(line.get_ydata()))
    for first, last, size in ((0.0, 0.29, PULL), (0.31, 0.69, mu * WEIGHT), (0.71, 1.0, 0.0)):
        held = (times > first) & (times < last)
        np.testing.assert_allclose(friction[held], size, atol=1e-9)
    assert np.max(rings.get_xdata()) < 0.31 < 0.7 > np.max(crosses.get_xdata())
    slid, row = drag(), 50
    struck = dataclasses.replace(
        slid,
        times=np.insert(slid.times, row, 0.5),
        positions=np.insert(slid.positions, row, slid.positions[row], axis=0),
        velocities=np.insert(slid.velocities, row, [1.0, -2.0], axis=0),
        impacts=(Touch.bounce(0.5, 0),),
    )
    plot_friction((figure := Figure()).subplots(), struck, world, scenario)
    forces, impulses = figure.axes
    assert [forces.get_ylabel(), impulses.get_ylabel()] == ["friction [N]", "friction [N s]"]
    (bar,) = impulses.patches
    assert isinstance(bar, Rectangle)
    assert bar.get_height() == pytest.approx(2 * mu * 2.0)  # of 1 kg that fell at 2 m/s
    assert len(forces.lines) == 3


# World → which of T's axes are which of the world's.
PLANES = {
    "room/two_walls": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],  # from above
    "floor/rebound": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],  # from the front
    "table1/1": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
}


@pytest.mark.parametrize("name", PLANES)
def test_a_plane_is_looked_at_with_its_way_up(name: str) -> None:
    scenario = Scenario.named(name)
    stage = Stage(World.from_scenario(scenario), np.array([scenario.initial_position]))
    assert stage.is_line == (name == "table1/1")
    np.testing.assert_allclose(stage.X_WT.rotation().matrix().T, PLANES[name], atol=1e-12)
    # Places are those of the world, which the joints of these models count from its origin.
    (places,) = stage.trace(np.array([scenario.initial_position, scenario.goal_position]))
    moved = scenario.goal_position - scenario.initial_position
    along = slice(1, 2) if name == "floor/rebound" else slice(0, moved.size)
    np.testing.assert_allclose((places[1] - places[0])[along], moved, atol=1e-12)


def test_shapes_for_contact_are_shown_where_none_are_for_show(tmp_path: Path) -> None:
    text = (models_directory() / "point_mass_and_wall.sdf").read_text(encoding="utf-8")
    bare = re.sub(r"<visual.*?</visual>", "", text, flags=re.DOTALL)
    plane = re.sub(
        r"<box>.*?</box>", "<plane><normal>1 0 0</normal></plane>", bare, flags=re.DOTALL
    )
    model = tmp_path / "bare.sdf"
    model.write_text(plane.replace("<pose>-8 0 0 0 0 0</pose>", ""), encoding="utf-8")
    ends: dict[str, Any] = {"initial_position": 1.0, "initial_velocity": 0.0, "goal_position": 0.7}
    stage = Stage(World.from_scenario(Scenario(model=str(model), **ends)), np.array([[1.0]]))
    ball, wall = sorted(stage.actors, key=lambda actor: actor.name)
    assert (ball.moves, wall.moves) == (True, False)
    # Of a half space, a slab whose face is the plane's.
    face = stage.pose(wall, np.array([1.0])).multiply([0, 0, wall.shape.height() / 2])
    np.testing.assert_allclose(face, [-0.05, 0, 0], atol=1e-12)


def test_a_wall_without_a_visual_is_drawn_by_its_collision_shape(tmp_path: Path) -> None:
    text = (models_directory() / "corridor.sdf").read_text(encoding="utf-8")
    walls = text.index("left_wall")
    bare = text[:walls] + re.sub(r"<visual.*?</visual>", "", text[walls:], flags=re.DOTALL)
    model = tmp_path / "bare.sdf"
    model.write_text(bare, encoding="utf-8")
    scenario = dataclasses.replace(Scenario.named("corridor/lossy"), model=str(model))
    actors = Stage(World.from_scenario(scenario), np.array([scenario.initial_position])).actors
    shipped = World.from_scenario(Scenario.named("corridor/lossy"))
    expected = Stage(shipped, np.array([scenario.initial_position])).actors
    assert {actor.body.split("/")[1] for actor in actors} == {
        actor.body.split("/")[1] for actor in expected
    }


UNSEEN = 2e-3
RADIUS = 0.05  # of the corridor's ball [m]


def along(meshcat: Meshcat, path: str) -> np.ndarray:
    _, quaternions = clips(meshcat, "quaternion")[path]
    rotations = [RotationMatrix(Quaternion(w, x, y, z)) for x, y, z, w in quaternions]
    return np.array([rotation.matrix()[:, 2] for rotation in rotations])


def scales(meshcat: Meshcat, path: str) -> tuple[np.ndarray, np.ndarray]:
    """Returns the times and sizes of a shape's keys; all three directions have one scale."""
    times, values = clips(meshcat, "scale")[path]
    assert np.all(values == values[:, :1])
    return times, values[:, 0]


def test_an_arrow_has_the_size_and_the_direction_of_the_control(meshcat: Meshcat) -> None:
    scenario = Scenario.named("table1/1")
    times, controls = np.array([0.0, 0.2, 0.6, 1.0]), np.array([[2.0], [-4.0], [0.0]])
    motion = make_motion("plan", 0.7).under(times, controls)
    publish([motion], meshcat, World.from_scenario(scenario), scenario)
    arrow = f"{ROOT}/motions/1/control/point_mass_and_wall/ball/arrow"
    keys, sizes = scales(meshcat, arrow)
    directions = along(meshcat, arrow)
    for first, end, size, side in ((0.0, 0.195, 0.5, 1), (0.205, 0.595, 1.0, -1)):
        held = (keys >= first) & (keys < end)
        np.testing.assert_allclose(sizes[held], size)
        np.testing.assert_allclose(
            directions[held[: len(directions)]] - [side, 0, 0], 0, atol=1e-12
        )
    assert np.all(sizes[keys > 0.605] < UNSEEN) and keys[-1] == 1.5
    # Without control there is none.
    still = motion.under(np.array([0.0, 1.0]), np.zeros((1, 1)))
    publish([still, make_motion("rigid", 0.6)], meshcat, World.from_scenario(scenario), scenario)
    assert not [path for path in clips(meshcat) if path.endswith("/arrow")]


@pytest.mark.parametrize(
    ("name", "controls", "expected"),
    [
        ("room/two_walls", [3.0, -4.0], [[3.0, -4.0]]),  # one link, whose actuators add up
        ("two_masses/apart", [1.0, -0.5], [[1.0, 0.0], [-0.5, 0.0]]),
    ],
)
def test_each_link_has_an_arrow_which_is_the_sum_of_its_actuators(
    meshcat: Meshcat, name: str, controls: list[float], expected: list[list[float]]
) -> None:
    scenario = Scenario.named(name)
    q = np.array([scenario.initial_position] * 2)
    motion = Motion("plan", np.array([0.0, 1.0]), q, np.zeros((2, 2)))
    motion = motion.under(motion.times, np.array([controls]))
    publish([motion], meshcat, World.from_scenario(scenario), scenario)
    arrows = sorted(path for path in clips(meshcat) if path.endswith("/arrow"))
    lengths = np.linalg.norm(expected, axis=1)
    for path, force, length in zip(arrows, expected, lengths, strict=True):
        assert along(meshcat, path)[0, :2] == pytest.approx(force / length)
        assert scales(meshcat, path)[1][0] == pytest.approx(length / np.max(lengths))


def test_a_flash_is_where_and_when_a_wall_is_touched(meshcat: Meshcat) -> None:
    scenario = Scenario.named("corridor/three_bounces")
    times = np.array([0.0, 0.4, 0.4, 0.9, 0.9, 1.4])
    q = np.array([[0.5], [1.0], [1.0], [0.0], [0.0], [0.3]])
    v = np.array([[1.0], [4.0], [-2.0], [-2.0], [1.0], [1.0]])
    touches = Touch.bounce(0.4, 1), Touch.bounce(0.9, 0)
    motion = Motion("plan", times, q, v, impacts=touches)
    world = World.from_scenario(scenario)
    publish([motion], meshcat, world, scenario)
    sizes = {}
    for touch, face in zip(touches, (1, -1), strict=True):
        path = f"{ROOT}/motions/1/contacts/{touch.contact}/impacts"
        keys, scale = scales(meshcat, path)
        shown = scale > UNSEEN
        assert keys[shown] == pytest.approx([touch.start], abs=1e-3)
        assert np.all(np.diff(keys) > 0) and scale[0] < UNSEEN
        ball_places = clips(meshcat)[f"{ROOT}/motions/1/corridor/ball/ball_visual"]
        there = ball_places[1][np.argmin(np.abs(ball_places[0] - touch.start)), 0]
        assert clips(meshcat)[path][1][0, 0] == pytest.approx(there + face * RADIUS)
        sizes[touch.start] = scale[shown][0]
    # The faster impact is the larger flash.
    assert sizes[0.4] == pytest.approx(1) and 0.4 < sizes[0.9] < 0.9


def test_all_parts_have_one_length_so_that_they_repeat_together(meshcat: Meshcat) -> None:
    scenario = Scenario.named("table1/1")
    motion = dataclasses.replace(make_motion("plan", 0.7), impacts=(Touch.bounce(0.97),))
    motion = motion.under(np.array([0.0, 1.0]), np.ones((1, 1)))
    publish([motion], meshcat, World.from_scenario(scenario), scenario)
    message = recording(meshcat)
    ends = [
        max(key["time"] for track in each["clip"]["tracks"] for key in track["keys"])
        for each in message["animations"]
    ]
    assert len(ends) == 3 and set(ends) == {1500}
    options, loop_repeat = message["options"], 2201  # three.js
    assert options["play"] and options["loopMode"] == loop_repeat and options["repetitions"] > 1000
