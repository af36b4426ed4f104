"""Worlds with several walls that tests of replay share: made in code, or shipped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from pydrake.geometry import HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import DiagramBuilder

from drake_aigto.world import Scenario, World

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
    """Returns a shipped model's world."""
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
