"""Worlds and controls that the tests of replay share."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from pydrake.geometry import Box, HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, PrismaticSpring, SpatialInertia, UnitInertia
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from drake_aigto import PlanOptions, Scenario
from drake_aigto.planning import Plan, plan
from drake_aigto.world import World


def make_scenario(q: Any = 1.0, v: Any = -2.0, goal: Any = None, **fields: Any) -> Scenario:
    goal = np.full(np.shape(q), 0.73) if goal is None else goal
    return Scenario(initial_position=q, initial_velocity=v, goal_position=goal, **fields)


@cache
def shipped_world(mass: float | None = None) -> World:
    return World.from_scenario(make_scenario(mass=mass))


def hold(value: float, duration: float = 1.0, steps: int = 200) -> tuple[Any, Any]:
    return np.linspace(0.0, duration, steps + 1), np.full((steps, 1), value)


def make_properties(
    stiffness: float | None = 2e9, dissipation: float | None = 0.0
) -> ProximityProperties:
    """Returns what a shape without friction is made of; None: not given."""
    properties = ProximityProperties()
    properties.AddProperty("material", "coulomb_friction", CoulombFriction(0.0, 0.0))
    if dissipation is not None:
        properties.AddProperty("material", "hunt_crossley_dissipation", dissipation)
    if stiffness is not None:
        properties.AddProperty("material", "point_contact_stiffness", stiffness)
    return properties


def make_diagram(
    num_joints: int = 1,
    spring: float = 0.0,
    reference: float = 0.0,
    stiffness: float | None = 2e9,
    push: float | None = None,
    gravity: float = 0.0,
    rail: tuple[float, float] = (1.0, 1.0),
    num_actuators: int = 2,
    density: float = 1.0,
    dissipation: float | None = 0.0,
    thickness: float = 0.0,
) -> Diagram:
    """Returns a ball of 1.5 kg before a wall at x = 0, made in code as a user would.

    With two joints it hangs on a carriage of 0.5 kg that moves along the rail, and slides on it
    along (4, 3)/5, askew to the wall, so that an impulse moves both. The spring pulls the first
    joint to its reference. A push comes from a source that drives the actuator. Gravity [m/s²]
    pulls to the wall. All masses are multiplied by the density. A wall with a thickness is a box.
    """
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    plant.mutable_gravity_field().set_gravity_vector([-gravity, 0.0, 0.0])
    properties = make_properties(stiffness, dissipation)
    inertia = UnitInertia.SolidSphere(0.1)
    ball = plant.AddRigidBody("ball", SpatialInertia(1.5 * density, np.zeros(3), inertia))
    parent, slide = plant.world_frame(), [1.0, 0.0, 0.0]
    if num_joints == 2:
        carriage = plant.AddRigidBody(
            "carriage", SpatialInertia(0.5 * density, np.zeros(3), inertia)
        )
        axis = np.array([*rail, 0.0]) / math.hypot(*rail)
        plant.AddJoint(PrismaticJoint("rail", parent, carriage.body_frame(), axis))
        parent, slide = carriage.body_frame(), [0.8, 0.6, 0.0]
    plant.AddJoint(PrismaticJoint("slider", parent, ball.body_frame(), slide))
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    for joint in joints[:num_actuators]:
        plant.AddJointActuator(joint.name(), joint)
    if spring:
        plant.AddForceElement(PrismaticSpring(joints[0], reference, spring))
    plant.RegisterCollisionGeometry(
        ball, RigidTransform([0.1, 0, 0]), Sphere(0.1), "ball", properties
    )
    facing_x = RigidTransform(RotationMatrix.MakeYRotation(np.pi / 2), [-thickness / 2, 0, 0])
    wall = Box(1.0, 1.0, thickness) if thickness else HalfSpace()
    plant.RegisterCollisionGeometry(plant.world_body(), facing_x, wall, "wall", properties)
    plant.Finalize()
    if push is not None:
        source = builder.AddSystem(ConstantVectorSource([push]))
        builder.Connect(source.get_output_port(), plant.get_actuation_input_port())
    return builder.Build()


RADIUS = 0.05


def make_task(world: str, q: Any, v: Any, **fields: Any) -> Scenario:
    """Returns a scenario of a shipped model."""
    goal = np.full(np.shape(q), 0.3)
    model = f"package://drake_aigto_models/{world}.sdf"
    return Scenario(
        model=model, initial_position=q, initial_velocity=v, goal_position=goal, **fields
    )


@cache
def shipped(world: str) -> World:
    starts = {
        "two_masses": [0.3, 0.7],
        "room": [0.3, 0.7],
        "room_with_block": [0.2, 0.7],
        "corridor": [0.5],
        "floor": [0.5],
    }
    start = np.array(starts[world])
    scenario = Scenario(
        model=f"package://drake_aigto_models/{world}.sdf",
        initial_position=start,
        initial_velocity=0 * start,
        goal_position=start,
    )
    return World.from_scenario(scenario)


def hold_still(world: World, duration: float = 1.0, steps: int = 20) -> tuple[Any, Any]:
    """Returns knots, and no control."""
    return np.linspace(0.0, duration, steps + 1), np.zeros((steps, world.num_actuators))


@cache
def make_line(masses: tuple[float, ...], gravity: float = 0.0) -> World:
    """Returns two balls in a row before one wall.

    Gravity [m/s²] pulls to the wall.
    """
    builder, plant = _start(gravity)
    for i, mass in enumerate(masses):
        ball = _add_ball(plant, f"ball_{i}", mass)
        joint = PrismaticJoint(f"x_{i}", plant.world_frame(), ball.body_frame(), [1.0, 0.0, 0.0])
        plant.AddJointActuator(f"push_{i}", plant.AddJoint(joint))
        plant.RegisterCollisionGeometry(
            ball, RigidTransform([2 * RADIUS * i, 0, 0]), Sphere(RADIUS), f"ball_{i}", _material()
        )
    _add_wall(plant, "wall", 0.0)
    plant.Finalize()
    plant.SetDefaultPositions(1.0 + np.arange(len(masses)))
    return World.from_diagram(builder.Build())


def make_wedge(angle: float, restitution: Sequence[float | None] = (None, None)) -> World:
    """Returns a ball that moves in the plane between two walls, φ_0 = y and one at an angle."""
    builder, plant = _start(0.0)
    carriage = plant.AddRigidBody("carriage", SpatialInertia.Zero())
    ball = _add_ball(plant, "ball", 1.0)
    for name, parent, child, axis in (
        ("x", plant.world_frame(), carriage.body_frame(), [1.0, 0.0, 0.0]),
        ("y", carriage.body_frame(), ball.body_frame(), [0.0, 1.0, 0.0]),
    ):
        plant.AddJointActuator(name, plant.AddJoint(PrismaticJoint(name, parent, child, axis)))
    plant.RegisterCollisionGeometry(ball, RigidTransform(), Sphere(RADIUS), "ball", _material())
    _add_wall(plant, "floor", math.pi / 2, restitution[0])
    _add_wall(plant, "slope", angle - math.pi / 2, restitution[1])
    plant.Finalize()
    plant.SetDefaultPositions([math.cos(angle / 2), math.sin(angle / 2)])
    return World.from_diagram(builder.Build())


def _start(gravity: float) -> tuple[DiagramBuilder, Any]:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    plant.mutable_gravity_field().set_gravity_vector([-gravity, 0.0, 0.0])
    return builder, plant


def _inertia(mass: float) -> SpatialInertia:
    return SpatialInertia(mass, np.zeros(3), UnitInertia.SolidSphere(RADIUS))


def _add_ball(plant: Any, name: str, mass: float) -> Any:
    return plant.AddRigidBody(name, _inertia(mass))


def _material(restitution: float | None = None) -> ProximityProperties:
    properties = ProximityProperties()
    properties.AddProperty("material", "coulomb_friction", CoulombFriction(0.0, 0.0))
    properties.AddProperty("material", "hunt_crossley_dissipation", 0.0)
    properties.AddProperty("material", "point_contact_stiffness", 2e9)
    if restitution is not None:
        properties.AddProperty("material", "restitution", restitution)
    return properties


def _add_wall(plant: Any, name: str, facing: float, restitution: float | None = None) -> None:
    """Adds a half space whose normal is (cos, sin) of an angle, a radius behind the origin."""
    normal = np.array([math.cos(facing), math.sin(facing), 0.0])
    pose = RigidTransform(RotationMatrix.MakeFromOneVector(normal, 2), -RADIUS * normal)
    plant.RegisterCollisionGeometry(
        plant.world_body(), pose, HalfSpace(), name, _material(restitution)
    )


COARSE: dict[str, Any] = {"time_step": 0.02}
UNCONFIRMED = PlanOptions(confirm=False)


def table1(row: int, **fields: Any) -> Scenario:
    return dataclasses.replace(Scenario.named(f"table1/{row}"), **fields)


@cache
def bounce_plan() -> Plan:
    return plan(table1(1, **COARSE))
