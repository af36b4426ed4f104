"""Plants of all joints of a tree."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    Joint,
    PlanarJoint,
    PrismaticJoint,
    RevoluteJoint,
    RevoluteSpring,
    RigidBody,
    RpyFloatingJoint,
    ScrewJoint,
    SpatialInertia,
    UniversalJoint,
    WeldJoint,
)

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import Tree, TreeMemory, make_tree_memory, place
from drake_aigto.kernels import borrow, kernel

AXIS = np.array([0.36, 0.48, 0.8])


def random_pose(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform(RollPitchYaw(rng.uniform(-1.0, 1.0, 3)), rng.uniform(-0.5, 0.5, 3))


def add_body(plant: MultibodyPlant, name: str, rng: np.random.Generator) -> RigidBody:
    """Returns a new box, of some kg, whose center of mass is off its origin."""
    size = rng.uniform(0.1, 0.5, 3)
    inertia = SpatialInertia.SolidBoxWithMass(float(rng.uniform(0.5, 2.0)), *size.tolist())
    inertia = inertia.ReExpress(random_pose(rng).rotation()).Shift(rng.uniform(-0.2, 0.2, 3))
    return plant.AddRigidBody(name, inertia)


def attach(
    plant: MultibodyPlant,
    parent: RigidBody,
    child: RigidBody,
    make: Callable[..., Joint],
    rng: np.random.Generator,
) -> Joint:
    frame_P, frame_C = (
        plant.AddFrame(_fixed(f"{child.name()}_{end}", body, random_pose(rng)))
        for end, body in (("F", parent), ("M", child))
    )
    return plant.AddJoint(make(f"joint_{child.name()}", frame_P, frame_C))


def _fixed(name: str, body: RigidBody, pose: RigidTransform):  # type: ignore[no-untyped-def]
    from pydrake.multibody.tree import FixedOffsetFrame

    return FixedOffsetFrame(name, body.body_frame(), pose)


JOINTS: dict[str, Callable[..., Joint]] = {
    "revolute": lambda name, F, M: RevoluteJoint(name, F, M, AXIS, damping=0.3),
    "prismatic": lambda name, F, M: PrismaticJoint(name, F, M, AXIS, damping=0.2),
    "screw": lambda name, F, M: ScrewJoint(name, F, M, AXIS, 0.7, 0.1),
    "planar": lambda name, F, M: PlanarJoint(name, F, M, [0.1, 0.2, 0.3]),
    "universal": lambda name, F, M: UniversalJoint(name, F, M, 0.2),
    "ball_rpy": lambda name, F, M: BallRpyJoint(name, F, M, 0.4),
    "rpy_floating": lambda name, F, M: RpyFloatingJoint(name, F, M, 0.1, 0.2),
    "weld": lambda name, F, M: WeldJoint(name, F, M, RigidTransform([0.1, 0.2, 0.3])),
}


def make_zoo(seed: int = 0) -> MultibodyPlant:
    """Returns a plant with every kind of joint: a floating body with branches, and an arm."""
    rng, plant = np.random.default_rng(seed), MultibodyPlant(0.0)
    base = add_body(plant, "base", rng)
    arm = add_body(plant, "arm", rng)
    shoulder = attach(plant, plant.world_body(), arm, JOINTS["revolute"], rng)
    plant.AddForceElement(RevoluteSpring(shoulder, 0.3, 2.0))
    plant.AddJointActuator("shoulder", shoulder).set_default_rotor_inertia(0.01)
    plant.get_joint_actuator(plant.GetJointActuatorIndices()[0]).set_default_gear_ratio(5.0)
    parents = [base, arm]
    for k, (name, make) in enumerate(list(JOINTS.items()) * 2):
        body = add_body(plant, f"{name}_{k}", rng)
        joint = attach(plant, parents[int(rng.integers(len(parents)))], body, make, rng)
        if joint.num_velocities() == 1:
            plant.AddJointActuator(f"motor_{k}", joint)
        parents.append(body)
    plant.Finalize()
    return plant


def sample_state(
    plant: MultibodyPlant, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q = plant.GetDefaultPositions()
    for index in plant.GetJointIndices():
        joint = plant.get_joint(index)
        count, start = joint.num_positions(), joint.position_start()
        values = rng.uniform(-1.0, 1.0, count)
        if joint.type_name() == "quaternion_floating":
            values[:4] /= np.linalg.norm(values[:4])
        q[start : start + count] = values
    return q, rng.normal(size=plant.num_velocities()), rng.normal(size=plant.num_actuators())


def difference_slopes(tree: Tree, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Returns central differences of v̇ along the manifold, by v and by u, shape (n, 2 n + nu).

    They err by 1e-12 of the third derivative, and 1e-10 of rounding.
    """
    calc, n, nu, step = tree.calc_acceleration, len(v), len(u), 1e-6
    columns = [
        calc(tree.add(q, each), v, u) - calc(tree.add(q, -each), v, u) for each in step * np.eye(n)
    ]
    columns += [calc(q, v + each, u) - calc(q, v - each, u) for each in step * np.eye(n)]
    columns += [calc(q, v, u + each) - calc(q, v, u - each) for each in step * np.eye(nu)]
    return np.array(columns).T / (2 * step)


def calc_poses(tree: Tree, q: Floats) -> tuple[Floats, Floats]:
    memory = make_tree_memory(tree)
    _place_links(tree, np.array(q, dtype=float), memory)
    R, p = tree.body_rotations.reshape(-1, 3, 3).copy(), tree.body_offsets.copy()
    for b in np.flatnonzero(tree.body_links >= 0):
        turn, origin = np.split(memory.poses[tree.body_links[b]], [9])
        turn = turn.reshape(3, 3)
        R[b], p[b] = turn @ R[b], origin + turn @ p[b]
    return R, p


@kernel
def _place_links(tree: Tree, q: Floats, memory: TreeMemory) -> None:
    tree, memory = borrow(tree), borrow(memory)
    for i in range(tree.parents.size):
        place(tree, i, q, memory)
