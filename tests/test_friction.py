"""Friction of a model, which no plan knows: refused where it acts, or left out when asked."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from pydrake.geometry import HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import Diagram, DiagramBuilder
from refusals import refuse_work

from drake_aigto import (
    ModelError,
    OptionsError,
    Planner,
    PlanOptions,
    Scenario,
    World,
    plan,
    replay_drake,
)
from drake_aigto.show import format_plan
from drake_aigto.world import models_directory

Y = [0.0, 1.0, 0.0]


def material(friction: float | None) -> ProximityProperties:
    properties = ProximityProperties()
    if friction is not None:
        properties.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
    return properties


def make_diagram(
    frictions: tuple[float | None, float | None], along: bool = False, spins: bool = False
) -> Diagram:
    """Returns a ball above the ground, which may also move along it, or spin."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    inertia = SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.1))
    lift = plant.AddRigidBody("lift", SpatialInertia.Zero())
    ball = plant.AddRigidBody("ball", inertia)
    rise = PrismaticJoint("rise", plant.world_frame(), lift.body_frame(), [0.0, 0.0, 1.0])
    plant.AddJointActuator("rise", plant.AddJoint(rise))
    frames = lift.body_frame(), ball.body_frame()
    if spins:
        plant.AddJoint(RevoluteJoint("turn", *frames, Y))
    elif along:
        plant.AddJoint(PrismaticJoint("move", *frames, Y))
    else:
        plant.WeldFrames(*frames)
    shapes = (ball, Sphere(0.1), "ball"), (plant.world_body(), HalfSpace(), "ground")
    for (body, shape, name), friction in zip(shapes, frictions, strict=True):
        plant.RegisterCollisionGeometry(body, RigidTransform(), shape, name, material(friction))
    plant.Finalize()
    plant.SetDefaultPositions(np.ones(plant.num_positions()))
    return builder.Build()


@pytest.mark.parametrize(
    ("frictions", "expected"),
    [
        ((0.3, 0.6), 2 * 0.3 * 0.6 / 0.9),
        ((0.0, 0.6), 0.0),
        ((None, None), 0.5),  # Drake's default, of which only contexts know.
        ((None, 1.0), 2 / 3),
    ],
)
def test_friction_is_what_drake_makes_of_both_shapes(
    frictions: tuple[float | None, float | None], expected: float
) -> None:
    world = World.from_diagram(make_diagram(frictions, along=True))
    assert sum(world.frictions.values()) == pytest.approx(expected, rel=1e-12)


def test_friction_acts_on_what_slides_or_spins_and_not_on_what_only_comes_and_goes() -> None:
    rough, rubbing = (1.0, 1.0), {"ball against ground": 1.0}
    assert World.from_diagram(make_diagram(rough)).frictions == {}
    assert World.from_diagram(make_diagram(rough, along=True)).frictions == rubbing
    assert World.from_diagram(make_diagram(rough, spins=True)).frictions == rubbing


@pytest.fixture
def rough_room(tmp_path: Path) -> Path:
    """Returns the shipped room without a word about friction."""
    text = (models_directory() / "room.sdf").read_text(encoding="utf-8")
    path = tmp_path / "rough_room.sdf"
    path.write_text(re.sub(r"<drake:mu_.*>", "", text), encoding="utf-8")
    return path


def test_friction_whose_impacts_are_not_planned_is_refused_before_any_work(
    rough_room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rough = dataclasses.replace(Scenario.named("room/bank_shot"), model=str(rough_room))
    monkeypatch.setattr("drake_aigto.planning.planner.BallTask", refuse_work)
    pendulum = dataclasses.replace(Scenario.named("pendulum/off_the_wall"), friction=0.2)
    with pytest.raises(ModelError, match=r"got friction 0.2 and a mechanism of one coordinate"):
        Planner(pendulum)
    with pytest.raises(OptionsError, match=r"aigo_steps: got 9 for a mechanism"):
        Planner(rough, PlanOptions(aigo_steps=9))


def test_friction_that_is_left_out_as_asked_changes_nothing_and_is_told(rough_room: Path) -> None:
    smooth = Scenario.named("room/bank_shot")
    rough = dataclasses.replace(smooth, model=str(rough_room), friction=0.0)
    found, expected = plan(rough), plan(smooth)
    assert found.cost == expected.cost
    drake, without = found.replay.drake, expected.replay.drake
    assert drake is not None
    assert without is not None
    assert drake.cost == without.cost
    assert Scenario.from_plain(found.scenario.to_plain()).friction == 0.0
    world = World.from_scenario(rough)
    said = "left out of the simulation, as asked: the model's, μ = 1"
    assert said in format_plan(found)
    assert "friction" not in format_plan(expected)
    # The model's own friction is what the plan would have met.
    control = found.trajectory.times, found.trajectory.controls
    met = replay_drake(world, dataclasses.replace(rough, friction=None), *control)
    assert met.cost > 100 * drake.cost


# Shapes that overlap wherever the joints are.

RAIL = """<link name="rail"><collision name="rail_collision">
      <pose>0 0 -0.049 0 0 0</pose>
      <geometry><plane><normal>0 0 1</normal></plane></geometry>
    </collision></link>
    <joint name="rail_to_world" type="fixed"><parent>world</parent><child>rail</child></joint>
  </model>"""


def slide(directory: Path, rough: bool) -> Scenario:
    """Returns a task in the shipped corridor, with a ball that is 1 mm deep in a rail."""
    scenario = Scenario.named("corridor/three_bounces")
    text = (models_directory() / "corridor.sdf").read_text(encoding="utf-8")
    text = re.sub(r"<drake:mu_.*>", "", text) if rough else text
    path = directory / "rail.sdf"
    path.write_text(text.replace("</model>", RAIL), encoding="utf-8")
    return dataclasses.replace(scenario, model=str(path))


def test_friction_of_what_the_ball_always_overlaps_is_refused_or_left_out_as_asked(
    tmp_path: Path,
) -> None:
    rough = slide(tmp_path, rough=True)
    with pytest.raises(ModelError, match=r"friction of ball against rail: got μ = 1 where .*"):
        World.from_scenario(rough)
    found = plan(dataclasses.replace(rough, friction=0.0))
    assert found.holds
    assert found.best.cost == plan(Scenario.named("corridor/three_bounces")).cost
    assert "left out of the simulation, as asked: the model's, μ = 1" in format_plan(found)


def test_what_the_ball_overlaps_without_friction_changes_nothing(tmp_path: Path) -> None:
    found, expected = (
        plan(slide(tmp_path, rough=False)),
        plan(Scenario.named("corridor/three_bounces")),
    )
    assert found.holds
    assert found.cost == expected.cost
    assert found.find_world().num_contacts == 2
