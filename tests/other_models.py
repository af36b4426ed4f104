"""Small models in MJCF and URDF, as other people write them, and tasks for them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from drake_aigto import Scenario, World

# A cart with two poles above each other, in the masses and gears of common benchmarks: ±500 N.
DOUBLE_PENDULUM = """<mujoco model="double_pendulum">
  <default><joint damping="0.05"/><geom type="capsule" size="0.045"/></default>
  <worldbody>
    <body name="cart">
      <joint name="slider" type="slide" axis="1 0 0" range="-1 1"/>
      <geom name="cart" size="0.1" fromto="-0.1 0 0 0.1 0 0"/>
      <body name="pole">
        <joint name="hinge" axis="0 1 0"/>
        <geom name="pole" fromto="0 0 0 0 0 0.6"/>
        <body name="pole2" pos="0 0 0.6">
          <joint name="hinge2" axis="0 1 0"/>
          <geom name="pole2" fromto="0 0 0 0 0 0.6"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="slide" joint="slider" gear="500" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def carry_double_pendulum(folder: Path) -> Scenario:
    """Returns the task to carry both poles, upright at start and end, 0.5 m along the rail."""
    return Scenario(
        model=write(folder / "double_pendulum.xml", DOUBLE_PENDULUM),
        initial_position=np.zeros(3),
        initial_velocity=np.zeros(3),
        goal_position=[0.5, 0.0, 0.0],
        goal_weight=np.full(3, 100.0),
        control_weight=1e-3,
        duration=2.0,
        time_step=0.04,
        ignored_shapes="all",
    )


def pose(path: Path, text: str, stiffness: float, friction: float, **fields: Any) -> Scenario:
    """Returns a task of a model whose shapes all touch alike."""
    material: Any = {"*": {"stiffness": stiffness, "dissipation": 1.0, "friction": friction}}
    model = write(path, text)
    return Scenario(model=model, material=material, contact="compliant", **fields)


# An arm of two links whose hand, a ball, can hit a puck on a rail.
ARM_AND_PUCK = """<mujoco model="arm_and_puck">
  <worldbody>
    <body name="upper" pos="0 0 0.7">
      <joint name="shoulder" axis="0 -1 0" damping="0.02"/>
      <inertial pos="0 0 -0.2" mass="0.6" diaginertia="0.008 0.008 0.001"/>
      <body name="fore" pos="0 0 -0.4">
        <joint name="elbow" axis="0 -1 0" damping="0.02" range="-143 143"/>
        <inertial pos="0 0 -0.15" mass="0.4" diaginertia="0.004 0.004 0.0005"/>
        <geom name="hand" type="sphere" size="0.04" pos="0 0 -0.3"/>
      </body>
    </body>
    <body name="puck" pos="0.15 0 0">
      <joint name="rail" type="slide" axis="1 0 0" damping="0.1" range="-2 2"/>
      <inertial pos="0 0 0" mass="0.3" diaginertia="0.0003 0.0003 0.0003"/>
      <geom name="puck" type="sphere" size="0.05"/>
    </body>
  </worldbody>
  <actuator><motor joint="shoulder"/><motor joint="elbow" ctrlrange="-6 6"/></actuator>
</mujoco>
"""


def hit_puck(folder: Path) -> Scenario:
    """Returns the task to hit the puck to 0.65 m from where it starts."""
    return pose(
        folder / "arm_and_puck.xml",
        ARM_AND_PUCK,
        5000.0,
        0.4,
        initial_position={"shoulder": -0.5, "elbow": -0.3},
        initial_velocity=np.zeros(3),
        goal_position={"rail": 0.65},
        goal_weight={"rail": 100.0},
        goal_velocity_weight={"rail": 1.0},
        control_weight=0.05,
        duration=1.5,
        time_step=0.03,
    )


# A body on a leg of two links, in a plane, with motors at hip and knee.
LEG = """<mujoco model="leg">
  <compiler angle="radian"/>
  <worldbody>
    <geom name="ground" type="plane" size="20 20 1"/>
    <body name="body">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <joint name="pitch" axis="0 1 0"/>
      <inertial pos="0 0 0" mass="4" diaginertia="0.05 0.05 0.05"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0" damping="0.05" range="-2 2"/>
        <inertial pos="0 0 -0.1" mass="0.5" diaginertia="0.003 0.003 0.0005"/>
        <body name="shank" pos="0 0 -0.2">
          <joint name="knee" axis="0 1 0" damping="0.05" range="-2.6 2.6"/>
          <inertial pos="0 0 -0.1" mass="0.3" diaginertia="0.002 0.002 0.0005"/>
          <geom name="foot" type="sphere" size="0.02" pos="0 0 -0.2"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor joint="hip" ctrlrange="-40 40"/><motor joint="knee" ctrlrange="-40 40"/>
  </actuator>
</mujoco>
"""


def hop_on_leg(folder: Path) -> Scenario:
    """Returns the task to hop by 0.4 m, upright."""
    start = {"z": 0.3495, "hip": -0.6, "knee": 1.2}
    return pose(
        folder / "leg.xml",
        LEG,
        40000.0,
        0.8,
        initial_position=start,
        initial_velocity=np.zeros(5),
        goal_position={"x": 0.4, "pitch": 0.0, **start},
        goal_weight={"x": 100.0, "z": 100.0, "pitch": 50.0, "hip": 1.0, "knee": 1.0},
        goal_velocity_weight={"x": 5.0, "z": 5.0, "pitch": 2.0, "hip": 0.1, "knee": 0.1},
        stiction_speed=0.05,
        duration=0.8,
        time_step=0.02,
    )


GRAVITY = 9.81


ARM = """<mujoco model="arm">
  <compiler angle="degree"/>
  <default>
    <joint damping="0.5"/>
    <geom contype="0" conaffinity="0"/>
    <default class="strong"><motor gear="5" ctrlrange="-2 3"/></default>
  </default>
  <option timestep="0.002" integrator="RK4" OPTION/>
  FLAGS
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="upper" pos="0 0 2">
      <joint name="shoulder" axis="0 1 0" JOINT/>
      <geom name="rod" type="capsule" fromto="0 0 0 0 0 -1" size="0.05" mass="2"/>
      <body name="lower" pos="0 0 -1">
        <joint name="elbow" axis="0 1 0" limited="true" range="-90 120"/>
        <geom name="stick" type="capsule" fromto="0 0 0 0 0 -0.5" size="0.04" mass="1"/>
        <site name="tip" pos="0 0 -0.5"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    ACTUATORS
  </actuator>
  <sensor><jointpos joint="elbow"/></sensor>
</mujoco>
"""


MOTOR = '<motor name="motor" joint="shoulder" class="strong"/>'


GANTRY = """<robot name="gantry">
  <link name="world"/>
  <link name="bridge">INERTIAL</link>
  <link name="trolley">INERTIAL COLLISION</link>
  <joint name="x" type="prismatic">
    <parent link="world"/><child link="bridge"/><axis xyz="1 0 0"/>
    <limit effort="EFFORT" lower="-2" upper="2" velocity="9"/>
    <dynamics damping="0.3" friction="0.7"/>
  </joint>
  <joint name="y" type="prismatic">
    <parent link="bridge"/><child link="trolley"/><axis xyz="0 1 0"/>
    <limit effort="8" lower="-2" upper="2" velocity="9"/>
  </joint>
  MORE
</robot>
"""


INERTIAL = (
    '<inertial><mass value="MASS"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
)


TRANSMISSION = (
    '<transmission name="t"><type>transmission_interface/SimpleTransmission</type>'
    '<joint name="x"/><actuator name="drive"/></transmission>'
)


MESH = '<collision name="NAME"><geometry><mesh filename="FILE"/></geometry></collision>'


def write(path: Path, text: str, **parts: str) -> str:
    defaults = {"OPTION": "", "FLAGS": "", "JOINT": "", "ACTUATORS": MOTOR}
    defaults |= {"MORE": TRANSMISSION, "INERTIAL": INERTIAL, "EFFORT": "5", "COLLISION": ""}
    defaults |= {"MASS": "2"}
    for name, part in {**defaults, **parts, "MASS": parts.get("MASS", "2")}.items():
        text = text.replace(name, part)
    path.write_text(text, encoding="utf-8")
    return str(path)


def make(model: str, size: int = 2, **fields: Any) -> World:
    ends = {"initial_position": np.zeros(size), "initial_velocity": np.zeros(size)}
    fields = {"ignored_shapes": "all", "goal_position": np.full(size, 0.1), **ends, **fields}
    return World.from_scenario(Scenario(model=model, **fields))
