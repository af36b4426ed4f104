"""Friction of a model, which no plan knows: refused where it acts, or left out when asked."""

from __future__ import annotations

import dataclasses
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import Diagram, DiagramBuilder
from refusals import refuse_work

from drake_aigto import Planner, PlanOptions, Scenario, World, plan
from drake_aigto.dynamics import calc_friction_share
from drake_aigto.errors import ModelError, OptionsError, ScenarioError
from drake_aigto.show import format_plan
from drake_aigto.simulation import replay_drake, replay_event_driven
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


def test_friction_acts_on_what_slides_or_spins_and_grows_smoothly_from_rest() -> None:
    rough, rubbing = (1.0, 1.0), {"ball against ground": 1.0}
    assert World.from_diagram(make_diagram(rough)).frictions == {}
    assert World.from_diagram(make_diagram(rough, along=True)).frictions == rubbing
    assert World.from_diagram(make_diagram(rough, spins=True)).frictions == rubbing
    speeds = np.array([-3.0, -1.0, -0.5, 0.0, 0.25, 1.0, 7.0])
    x = 0.25
    expected = [-1, -1, -0.5, 0, 10 * x**3 - 15 * x**4 + 6 * x**5, 1, 1]
    np.testing.assert_allclose(calc_friction_share(0.01 * speeds, 0.01), expected, atol=1e-15)


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


RAIL = """<link name="rail"><collision name="rail_collision">
      <pose>0 0 -0.049 0 0 0</pose>
      <geometry><plane><normal>0 0 1</normal></plane></geometry>
    </collision></link>
    <joint name="rail_to_world" type="fixed"><parent>world</parent><child>rail</child></joint>
  </model>"""


def slide(directory: Path) -> Scenario:
    """Returns a task in the shipped corridor, with a ball that is 1 mm deep in a rough rail."""
    scenario = Scenario.named("corridor/three_bounces")
    text = (models_directory() / "corridor.sdf").read_text(encoding="utf-8")
    text = re.sub(r"<drake:mu_.*>", "", text)
    path = directory / "rail.sdf"
    path.write_text(text.replace("</model>", RAIL), encoding="utf-8")
    return dataclasses.replace(scenario, model=str(path))


@pytest.mark.slow
def test_friction_of_what_the_ball_always_overlaps_is_refused_or_left_out_as_asked(
    tmp_path: Path,
) -> None:
    rough = slide(tmp_path)
    with pytest.raises(ModelError, match=r"friction of ball against rail: got μ = 1 where .*"):
        World.from_scenario(rough)
    found = plan(dataclasses.replace(rough, friction=0.0))
    assert found.holds
    assert found.best.cost == plan(Scenario.named("corridor/three_bounces")).cost
    assert "left out of the simulation, as asked: the model's, μ = 1" in format_plan(found)


def ask(**changes: Any) -> Scenario:
    fields: dict[str, Any] = {
        "duration": 1.0,
        "initial_position": [1.0, 1.5],
        "initial_velocity": [-1.0, 0.0],
    }
    return dataclasses.replace(Scenario.named("cart_pole/dry"), **{**fields, **changes})


@cache
def read_dry() -> World:
    return World.from_scenario(ask())


def calc_energy(x: Any) -> float:
    q, v = x[:2], x[2:]
    kinetic = float(read_dry().calc_kinetic_energy(q, v))
    return kinetic - 0.1 * 9.81 * float(np.cos(q[1]))


def test_what_slides_loses_the_friction_times_its_way_and_what_rests_stays() -> None:
    world, start = read_dry(), {"initial_position": [0.0, 0.0], "initial_velocity": [3.0, 2.0]}
    times, rest = np.array([0.0, 0.3]), {**start, "initial_velocity": [0.0, 0.0]}
    for replay in (replay_event_driven, replay_drake):
        slid = replay(world, ask(**start), times, np.zeros((1, 1)))
        x = np.hstack([slid.positions, slid.velocities])
        assert x[-1, 2] > 1.0
        lost = calc_energy(x[0]) - calc_energy(x[-1])
        assert lost == pytest.approx(2.0 * (x[-1, 0] - x[0, 0]), rel=1e-7)
        held = replay(world, ask(**rest), times, np.array([[1.8]]))
        assert 0 < held.positions[-1, 0] < 0.3 * world.stiction_speed


def test_both_replays_agree_on_what_rubs() -> None:
    times = np.linspace(0.0, 1.0, 21)
    controls = 6 * np.sin(9 * times[:-1, np.newaxis])
    own, drake = (
        replay(read_dry(), ask(), times, controls) for replay in (replay_event_driven, replay_drake)
    )
    np.testing.assert_allclose(own.positions[-1], drake.positions[-1], atol=1e-6)
    assert own.cost == pytest.approx(drake.cost, rel=1e-7)
    smooth = dataclasses.replace(ask(), dry_friction=None)
    without = replay_drake(World.from_scenario(smooth), smooth, times, controls)
    assert np.abs(without.positions[-1] - drake.positions[-1]).max() > 0.1


def test_a_plan_on_a_dry_rail_holds_in_both_simulations_and_pays_for_the_friction() -> None:
    options = PlanOptions(renewals=0, finalists=1, starts=3)
    plan = Planner(ask(), options).plan()
    assert plan.holds
    for replay in plan.replay:
        assert replay.cost == pytest.approx(plan.cost, rel=1e-3)
    smooth = dataclasses.replace(ask(), dry_friction=None)
    assert Planner(smooth, options).plan().cost < 0.99 * plan.cost


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("dry_friction", [-1.0, 0.0], "dry_friction: got -1, expected at least 0"),
        ("dry_friction", [np.nan, 0.0], "dry_friction: got nan, expected a finite number"),
        ("dry_friction", [1.0], "dry_friction: got 1 value, expected 2, one for each coordinate"),
        ("stiction_speed", 0.0, "stiction_speed: got 0 m/s, expected more than 0 m/s"),
    ],
)
def test_bad_friction_is_refused(field: str, value: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        World.from_scenario(ask(**{field: value}))


def test_a_world_with_other_friction_is_refused() -> None:
    for field, value in (("dry_friction", [1.0, 0.0]), ("stiction_speed", 0.5)):
        with pytest.raises(
            ScenarioError, match=f"{field}: .* Give the scenario the world's {field}"
        ):
            read_dry().check(ask(**{field: value}))
    smooth = World.from_scenario(dataclasses.replace(ask(), dry_friction=None))
    with pytest.raises(ModelError, match="dry_friction: got a diagram in which nothing applies"):
        World.from_diagram(smooth.diagram, dry_friction=np.ones(2))
