"""Discs that roll and slide in a plane, above the ground and about each other."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import HalfSpace, ProximityProperties, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    MultibodyPlant,
)
from pydrake.multibody.tree import (
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import Diagram, DiagramBuilder

RADIUS = 0.1  # [m]


def add_shape(
    plant: MultibodyPlant,
    body: RigidBody,
    shape: Shape,
    stiffness: float,
    friction: CoulombFriction,
) -> None:
    """Adds a collision shape of its body's name to a body's origin."""
    material = ProximityProperties()
    material.AddProperty("material", "coulomb_friction", friction)
    material.AddProperty("material", "point_contact_stiffness", stiffness)
    material.AddProperty("material", "hunt_crossley_dissipation", 0.0)
    plant.RegisterCollisionGeometry(body, RigidTransform(), shape, body.name(), material)


def make_discs(
    radii: tuple[float, ...] = (RADIUS,),
    stiffness: float = 2e9,
    friction: CoulombFriction | None = None,
    tilts: bool = False,
    across: bool = False,
) -> Diagram:
    """Returns balls that move in the plane x, z, with q = (x, z, turn about y) each.

    They weigh 1 kg and are solid. The ground is a half space, or one on a hinge about y at the
    origin that tilts it, whose angle comes last. A motor pushes the first along x. Where
    they go across the plane, too, q = (x, z, y, turn) each.
    """
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    rough = friction or CoulombFriction(0.3, 0.3)
    for i, radius in enumerate(radii):
        slide = plant.AddRigidBody(f"slide_{i}", SpatialInertia.Zero())
        lift = plant.AddRigidBody(f"lift_{i}", SpatialInertia.Zero())
        inertia = SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(radius))
        ball = plant.AddRigidBody(f"ball_{i}", inertia)
        frames = plant.world_frame(), slide.body_frame(), lift.body_frame(), ball.body_frame()
        along = plant.AddJoint(PrismaticJoint(f"x_{i}", *frames[:2], [1.0, 0.0, 0.0]))
        plant.AddJoint(PrismaticJoint(f"z_{i}", *frames[1:3], [0.0, 0.0, 1.0]))
        if across:
            aside = plant.AddRigidBody(f"aside_{i}", SpatialInertia.Zero())
            step = PrismaticJoint(f"y_{i}", lift.body_frame(), aside.body_frame(), [0.0, 1.0, 0.0])
            plant.AddJoint(step)
            frames = *frames[:2], aside.body_frame(), frames[3]
        plant.AddJoint(RevoluteJoint(f"turn_{i}", *frames[2:], [0.0, 1.0, 0.0]))
        if i == 0:
            plant.AddJointActuator("push", along)
        add_shape(plant, ball, Sphere(radius), stiffness, rough)
    ground = plant.world_body()
    if tilts:
        board = SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.3))
        ground = plant.AddRigidBody("ground", board)
        tilt = RevoluteJoint("tilt", plant.world_frame(), ground.body_frame(), [0.0, 1.0, 0.0])
        plant.AddJoint(tilt)
    add_shape(plant, ground, HalfSpace(), stiffness, rough)
    plant.Finalize()
    rest = np.zeros(1 + across)
    starts = [[3.0 * i * max(radii), 2 * radius, *rest] for i, radius in enumerate(radii)]
    plant.SetDefaultPositions(np.append(np.ravel(starts), np.zeros(int(tilts))))
    return builder.Build()
