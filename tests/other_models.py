"""Small models in MJCF, as other people write them, and tasks for them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from drake_aigto import Scenario

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
    model = folder / "double_pendulum.xml"
    model.write_text(DOUBLE_PENDULUM, encoding="utf-8")
    return Scenario(
        model=str(model),
        initial_position=np.zeros(3),
        initial_velocity=np.zeros(3),
        goal_position=[0.5, 0.0, 0.0],
        goal_weight=np.full(3, 100.0),
        control_weight=1e-3,
        duration=2.0,
        time_step=0.04,
        ignored_shapes="all",
    )
