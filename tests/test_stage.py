"""A stage shows a world's shapes, in the frame that their motion is watched in."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drake_aigto import Scenario, World
from drake_aigto.show import Stage
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
