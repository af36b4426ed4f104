"""A task of two coordinates with every field of a scenario, none but restitution at its default.

But for `periodic`, which takes the place of a goal.
"""

from __future__ import annotations

from typing import Any

ALL_FIELDS: dict[str, Any] = {
    "packages": {"robots": "/opt/robots"},
    "weld": {"base": [0.0, 0.0, 1.0]},
    "fixed_joints": ["wrist_*"],
    "actuators": ["elbow"],
    "effort_limits": {"elbow": 2.0},
    "servos": {"elbow": [20.0, 0.5]},
    "thrusters": [{"body": "drone", "drag": 0.5}],
    "weightless": ["arm"],
    "limits": "ignore",
    "collisions": "none",
    "material": {"*": {"stiffness": 1e6}},
    "allow_ignored": ["fluid"],
    "model": "other.sdf",
    "initial_position": [1.0, 2.0],
    "initial_velocity": [0.0, -3.0],
    "goal_position": [0.5, 0.0],
    "goal_velocity": [0.0, 1.0],
    "hard_goal": True,
    "angles": "modulo",
    "duration": 2.0,
    "time_step": 0.1,
    "duration_range": [1.0, 3.0],
    "control_weight": [0.1, 0.2],
    "goal_weight": [[2.0, -1.0], [-1.0, 2.0]],
    "frame_goals": {"hand": {"xyz": [1.0, 0.0, 0.0], "weight": {"xyz": 2.0}}},
    "goal_velocity_weight": [1.0, 0.0],
    "position_weight": [3.0, 4.0],
    "velocity_weight": 5.0,
    "reference_times": [0.0, 1.0],
    "reference_positions": [[0.0, 1.0], [1.0, 0.0]],
    "reference_velocities": [[1.0, 1.0], [2.0, 2.0]],
    "position_lower": [float("-inf"), -1.0],
    "position_upper": 9.0,
    "velocity_lower": -8.0,
    "velocity_upper": [8.0, float("inf")],
    "control_lower": [-7.0, -6.0],
    "control_upper": 7.0,
    "control_norm": 9.0,
    "contact": "compliant",
    "epsilon": 0.2,
    "delta": 0.3,
    "restitution": 1.0,
    "mass": 3.0,
    "friction": 0.0,
    "dry_friction": [0.5, 0.6],
    "stiction_speed": 0.02,
    "clearance": {"ball against wall": 0.1},
    "ignored_shapes": ["foot", "3"],
}
