"""Worlds and controls that the tests of replay share."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
from pydrake.geometry import Box, HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, PrismaticSpring, SpatialInertia, UnitInertia
from pydrake.systems.framework import Diagram, DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource

from drake_aigto.world import Scenario, World


def make_scenario(q: Any = 1.0, v: Any = -2.0, **fields: Any) -> Scenario:
    goal = np.full(np.shape(q), 0.73)
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
