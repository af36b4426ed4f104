"""Worlds in space as MuJoCo's models move as they do, but for contact."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.models import Row, compare, find_models, read
from benchmarks.mujoco_judge import MujocoJudge
from benchmarks.mujoco_model import MujocoModel
from drake_aigto import Planner, PlanOptions, Scenario, World, scenario_names
from drake_aigto.errors import ModelError
from drake_aigto.planning import Feedback
from drake_aigto.simulation import replay_with
from drake_aigto.world import SpaceWorld, TaskCost

mujoco: Any = pytest.importorskip("mujoco", reason="pip install 'drake_aigto[models]'")

IN_SPACE = (  # Floating bodies, servos, dampers, thrusters, weightless arms, a planar joint.
    *("arm_and_box/push", "arm_and_gripper/pick", "drone/deliver", "finger_and_box/tip"),
    *("planar_hand/turn", "push_tee/to_pose", "quadruped/leap_up", "space_hopper/hop"),
    *("three_fingers/turn", "throwing_arm/into_the_box"),
)


@pytest.mark.parametrize("name", IN_SPACE)
def test_a_world_accelerates_and_stands_apart_as_mujocos(name: str) -> None:
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


pytest.importorskip("mujoco", reason="pip install 'drake_aigto[models]'")

NAMES = (
    *("suite/acrobot", "suite/cartpole", "suite/pendulum", "suite/reacher", "suite/cheetah"),
    *("suite/hopper", "assets/reacher", "assets/hopper", "assets/inverted_double_pendulum"),
    *("assets/inverted_pendulum", "assets/walker2d", "assets/half_cheetah"),
)


def find(name: str) -> Path:
    found = [path for _, path in find_models() if path.as_posix().endswith(f"{name}.xml")]
    if not found:
        pytest.skip("pip install 'drake_aigto[models]'")
    return found[0]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", NAMES)
def test_dynamics_limits_and_efforts_are_mujocos(name: str) -> None:
    path = find(name)
    row = Row("", name)
    found = read(row, path)
    assert found is not None, row.read
    assert compare(found[0], path) < 1e-9


WHEELS = [
    *("dm_cheetah/leap", "dm_finger/turn", "dm_walker/step", "gymnasium_hopper/hop"),
    *("half_cheetah/leap", "walker2d/step"),
]


def read_scenario(name: str) -> tuple[SpaceWorld, Scenario, Any]:
    if name not in scenario_names():
        pytest.skip("pip install 'drake_aigto[models]'")
    world = World.from_scenario(Scenario.named(name))
    assert isinstance(world, SpaceWorld)
    scenario = world.place(Scenario.named(name))
    return world, scenario, MujocoModel.of(world, scenario).model


@pytest.mark.filterwarnings("ignore:compiler attribute")
@pytest.mark.parametrize("name", WHEELS)
def test_bodies_are_as_far_apart_as_mujoco_has_them(name: str) -> None:
    world, scenario, model = read_scenario(name)
    data: Any = mujoco.MjData(model)
    joints = [world.plant.get_joint(each) for each in world.plant.GetJointIndices()]
    moving = [model.joint(each.name()) for each in joints if each.num_positions()]
    rng = np.random.default_rng(0)
    for _ in range(3):
        q = scenario.initial_position + rng.uniform(-0.3, 0.3, len(moving))
        data.qpos[np.concatenate([each.qposadr for each in moving])] = q
        mujoco.mj_kinematics(model, data)
        for contact, distance in zip(world.contacts, world.calc_signed_distance(q), strict=True):
            name, _, end = contact.name.partition(" with ")[0].partition(" end ")
            geom = data.geom(name.rpartition("::")[2])
            if end:  # Of a capsule, with a half space.
                radius, half, _ = model.geom(geom.name).size
                side = -half if end == "1" else half
                true = geom.xpos[2] + side * geom.xmat.reshape(3, 3)[2, 2] - radius
            else:
                other = data.geom(contact.name.rpartition("::")[2])
                true = mujoco.mj_geomDistance(model, data, geom.id, other.id, 9.0, None)
            assert distance == pytest.approx(true, abs=1e-9)


@pytest.mark.slow  # 30 CPU s each, compiled.
@pytest.mark.filterwarnings("ignore:compiler attribute")
@pytest.mark.parametrize("name", WHEELS)
def test_a_plan_for_the_model_of_a_wheel_holds_and_its_feedback_arrives_in_mujoco(
    name: str,
) -> None:
    world, scenario, _ = read_scenario(name)
    plan = Planner(scenario, PlanOptions(renewals=24, finalists=1), world).plan()
    assert plan.holds and plan.reached
    for replay in plan.replay:
        near = 0.05 if replay.touch_error < 1e-4 else 0.2  # Drake has capsules touch elsewhere.
        assert replay.cost == pytest.approx(plan.cost, rel=near)
    feedback = Feedback(world, scenario, plan.trajectory)
    replay = replay_with(MujocoJudge(), world, scenario, feedback)
    off = np.abs(world.subtract(replay.positions[-1], scenario.goal_position))
    off[~TaskCost.of(world, scenario).is_asked] = 0.0
    if max(off[~world.turns], default=0.0) > 0.05 or off[world.turns].max() > 0.3:
        pytest.xfail(f"MuJoCo's own contact leads {off.max():.2g} m or rad off the goal")
