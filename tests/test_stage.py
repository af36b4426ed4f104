"""A stage shows a world's shapes, in the frame that their motion is watched in."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshcat_pages import clips, make_motion, recording
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Meshcat
from pydrake.math import RotationMatrix

from drake_aigto import Scenario, World
from drake_aigto.show import ROOT, Motion, Stage, publish
from drake_aigto.transcription import Touch
from drake_aigto.world import models_directory

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


GONE = 2e-3
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
    assert np.all(sizes[keys > 0.605] < GONE) and keys[-1] == 1.5
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
        shown = scale > GONE
        assert keys[shown] == pytest.approx([touch.start], abs=1e-3)
        assert np.all(np.diff(keys) > 0) and scale[0] < GONE
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
