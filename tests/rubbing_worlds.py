"""Discs that roll and slide in a plane, above the ground and about each other."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import HalfSpace, ProximityProperties, Shape, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    PrismaticJoint,
    RevoluteJoint,
    RigidBody,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import Diagram, DiagramBuilder

from drake_aigto import World
from drake_aigto.arrays import Floats
from drake_aigto.contact import CompliantLaw, ContactLaw, calc_pushes, calc_tangents
from drake_aigto.dynamics import calc_friction_share

RADIUS = 0.1  # [m]


def add_shape(
    plant: MultibodyPlant,
    body: RigidBody,
    shape: Shape,
    stiffness: float,
    friction: CoulombFriction,
    place: tuple[float, float] = (0.0, 0.0),
) -> None:
    material = ProximityProperties()
    material.AddProperty("material", "coulomb_friction", friction)
    material.AddProperty("material", "point_contact_stiffness", stiffness)
    material.AddProperty("material", "hunt_crossley_dissipation", 0.0)
    pose = RigidTransform([place[0], 0.0, place[1]])
    name = f"{body.name()}_{plant.num_collision_geometries()}"
    plant.RegisterCollisionGeometry(body, pose, shape, name, material)


def make_discs(
    radii: tuple[float, ...] = (RADIUS,),
    stiffness: float = 2e9,
    friction: CoulombFriction | None = None,
    tilts: bool = False,
    across: bool = False,
    turns: bool = True,
    feet: tuple[tuple[float, float], ...] = ((0.0, 0.0),),
    drives: bool = False,
) -> Diagram:
    """Returns balls that move in the plane x, z, with q = (x, z, turn about y) each.

    They weigh 1 kg and are solid. The ground is a half space, or one on a hinge about y at the
    origin that tilts it, whose angle comes last. A motor pushes the first along x, or drives its
    turn. Where
    they go across the plane, too, q = (x, z, y, turn) each. Where
    they do not turn they are blocks, without the last. With other
    feet, what touches are spheres of these radii at (x, z) from the center of mass.
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
        if turns:
            turn = plant.AddJoint(RevoluteJoint(f"turn_{i}", *frames[2:], [0.0, 1.0, 0.0]))
        else:
            plant.WeldFrames(*frames[2:])
        if i == 0:
            plant.AddJointActuator("push", turn if drives else along)
        for foot in feet:
            add_shape(plant, ball, Sphere(radius), stiffness, rough, foot)
    ground = plant.world_body()
    if tilts:
        board = SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.3))
        ground = plant.AddRigidBody("ground", board)
        tilt = RevoluteJoint("tilt", plant.world_frame(), ground.body_frame(), [0.0, 1.0, 0.0])
        plant.AddJoint(tilt)
    add_shape(plant, ground, HalfSpace(), stiffness, rough)
    plant.Finalize()
    rest = np.zeros(int(across) + int(turns))
    starts = [[3.0 * i * max(radii), 2 * radius, *rest] for i, radius in enumerate(radii)]
    plant.SetDefaultPositions(np.append(np.ravel(starts), np.zeros(int(tilts))))
    return builder.Build()


def calc_drag(world: World, law: ContactLaw, q: Floats, v: Floats, forces: Floats) -> Floats:
    """Returns friction of compliant contacts as forces on q, −Tᵀ μ f σ(s / v_s), shape (n,)."""
    assert isinstance(law, CompliantLaw)
    T, levers = calc_tangents(world, law, q)
    shares = calc_friction_share((T @ v) * levers, world.stiction_speed)
    return np.asarray(-(law.friction * forces * shares) @ T)


def accelerate(world: World, law: ContactLaw, q: Floats, v: Floats, u: Floats) -> Floats:
    """Returns v̇ with the forces and the friction of compliant contacts, shape (n,)."""
    forces = calc_pushes(world, law, q, v)
    return world.calc_acceleration(q, v, u, forces, calc_drag(world, law, q, v, forces))
