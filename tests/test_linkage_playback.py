"""Mechanisms are shown as they are: links, walls, ghosts, control and contact, in each copy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mechanisms import build
from meshcat_pages import clips, objects, position
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Meshcat
from pydrake.math import RotationMatrix

from drake_aigto import Scenario, World
from drake_aigto.show import ROOT, Motion, Stage, moves_straight, publish
from drake_aigto.transcription import Touch

GONE = 2e-3
TIP, STICK = "mechanism/pole/tip", "mechanism/pole/stick_0"


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return Meshcat()


@pytest.fixture(scope="module")
def cart_pole() -> World:
    return build("cart-pole")


def swing(label: str = "plan", **more: Any) -> Motion:
    """Returns a cart that stands still, then moves right, while its pole swings at 2 rad/s."""
    times = np.linspace(0.0, 1.0, 101)
    q = np.column_stack([np.maximum(0.0, times - 0.5), 2 * times - 0.5])
    return Motion(label, times, q, np.gradient(q, times, axis=0), **more)


def ask(**fields: Any) -> Scenario:
    """Returns the task to bring the pole upright from where it hangs."""
    asked: dict[str, Any] = {
        "initial_position": [0.0, -0.5],
        "initial_velocity": [0.0, 0.0],
        "goal_position": [0.2, 3.0],
        "goal_weight": [1.0, 1.0],
    }
    return Scenario(**{**asked, **fields})


def rotations(meshcat: Meshcat, path: str) -> np.ndarray:
    """Returns how an object is turned in each of its keys, shape (F, 3, 3)."""
    _, quaternions = clips(meshcat, "quaternion")[path]
    return np.array([RotationMatrix(Quaternion(w, x, y, z)).matrix() for x, y, z, w in quaternions])


def show(meshcat: Meshcat, world: World, *motions: Motion, **fields: Any) -> None:
    publish(motions, meshcat, world, ask(**fields))


def test_links_turn_about_their_joints_in_a_copy_for_each_motion(
    meshcat: Meshcat, cart_pole: World
) -> None:
    show(meshcat, cart_pole, swing("plan"), swing("integrated"), swing("Drake"))
    times, tips = clips(meshcat)[f"{ROOT}/motions/1/{TIP}"]
    middles = []
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
        middles.append((aside, base))
    assert len({tuple(np.round(middle, 6)) for middle in middles}) == 3


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


def test_an_impact_flashes_where_the_wall_is_touched(meshcat: Meshcat, cart_pole: World) -> None:
    show(meshcat, cart_pole, swing(impacts=(Touch.bounce(0.6, 1),)))
    path = f"{ROOT}/motions/1/contacts/1/impacts"
    keys, sizes = clips(meshcat, "scale")[path]
    assert keys[sizes[:, 0] > GONE] == pytest.approx([0.6])
    assert clips(meshcat)[path][1][0, 0] == pytest.approx(0.6)


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


def test_what_keeps_to_no_plane_is_seen_from_the_front() -> None:
    world = build("arm with a slider")
    stage = Stage(world, np.array([[0.0, 0.3, 0.0], [0.5, 0.2, 0.1]]))
    assert not stage.is_flat
    np.testing.assert_allclose(
        stage.X_WT.rotation().matrix().T, [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-12
    )


def test_discs_and_links_do_not_move_straight(cart_pole: World) -> None:
    assert not moves_straight(cart_pole) and not moves_straight(build("two discs"))
