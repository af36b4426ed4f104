"""Worlds in space as MuJoCo's models move as they do, but for contact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.mujoco_model import MujocoModel
from drake_aigto import Scenario, World
from drake_aigto.errors import ModelError
from drake_aigto.world import SpaceWorld

mujoco: Any = pytest.importorskip("mujoco", reason="pip install 'drake_aigto[models]'")

IN_SPACE = (  # Floating bodies, servos, dampers, thrusters, weightless arms, a planar joint.
    *("arm_and_box/push", "drone/deliver", "finger_and_box/tip", "planar_hand/turn"),
    *("push_tee/to_pose", "quadruped/leap_up", "three_fingers/turn", "throwing_arm/into_the_box"),
)


@pytest.mark.parametrize("name", IN_SPACE)
def test_accelerations_are_the_worlds(name: str) -> None:
    world = World.from_scenario(Scenario.named(name))
    assert isinstance(world, SpaceWorld)
    scenario = world.place(Scenario.named(name))
    found, rng = MujocoModel.of(world, scenario), np.random.default_rng(0)
    data, n, dt = mujoco.MjData(found.model), world.num_velocities, 1e-6
    found.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    for _ in range(3):
        q = world.add(scenario.initial_position, rng.normal(size=n))
        v, u = rng.normal(size=n), rng.normal(size=world.num_actuators)
        found.write(data, q, v)
        np.testing.assert_allclose(found.read(data.qpos, data.qvel), [*q, *v], atol=1e-12)
        data.ctrl[:] = u
        mujoco.mj_forward(found.model, data)
        # Turns have other axes there: velocities are compared after a short time instead.
        mujoco.mj_integratePos(found.model, data.qpos, data.qvel, dt)
        data.qvel += dt * data.qacc
        after = found.read(data.qpos, data.qvel)[-n:]
        expected = world.tree.calc_acceleration(q, v, u)
        scale = np.max(np.abs(expected))
        np.testing.assert_allclose((after - v) / dt, expected, atol=1e-5 * scale)


@pytest.mark.parametrize("name", IN_SPACE)
def test_bodies_are_as_far_apart(name: str) -> None:
    world = World.from_scenario(Scenario.named(name))
    assert isinstance(world, SpaceWorld)
    scenario = world.place(Scenario.named(name))
    found = MujocoModel.of(world, scenario)
    data = mujoco.MjData(found.model)
    q = world.add(scenario.initial_position, 0.1 * np.ones(world.num_velocities))
    found.write(data, q, np.zeros(world.num_velocities))
    mujoco.mj_kinematics(found.model, data)
    compared, plane = 0, mujoco.mjtGeom.mjGEOM_PLANE
    for pair, distance in zip(world.geometry.pairs, world.calc_signed_distance(q), strict=True):
        geoms = [data.geom(f"shape {each}").id for each in pair]
        # It measures no distance to planes, and none that solids overlap by exactly.
        if plane not in found.model.geom_type[geoms] and distance > 0:
            true = mujoco.mj_geomDistance(found.model, data, *geoms, 9.0, None)
            assert distance == pytest.approx(true, abs=2e-4)  # Corners are balls of 1e-4.
            compared += 1
    assert compared or not world.contacts or plane in found.model.geom_type


def test_a_planar_world_is_refused() -> None:
    scenario = Scenario.named("cart_pole/soft_06")
    with pytest.raises(ModelError, match="got a planar one, of sums, expected one in space"):
        MujocoModel.of(World.from_scenario(scenario), scenario)
