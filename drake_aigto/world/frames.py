"""Goals of frames, such as an arm's hand: where they should be in the world at the end."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Frame, FrameIndex, JacobianWrtVariable

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import FrameTable, Tree, make_tree_memory
from drake_aigto.errors import ScenarioError
from drake_aigto.world.files import suggest
from drake_aigto.world.places import FrameGoal

# Steps of inverse kinematics, and their damping, as a part of the largest curvature.
_STEPS, _DAMPING = 100, 1e-4


@dataclass(frozen=True, eq=False)
class FrameGoals:
    """Frames of a plant that have goals, as costs of the end: Σ w_k (p − p*)_k² + w (2 sin(θ/2))².

    Attributes:
        tree: that they are fixed to.
        table: of them, F.
    """

    tree: Tree
    table: FrameTable

    @classmethod
    def of(
        cls, plant: MultibodyPlant, tree: Tree, goals: Mapping[str, FrameGoal]
    ) -> FrameGoals | None:
        """Returns the goals of a scenario; None: there are none.

        Raises:
            ScenarioError: there is no such frame, or nothing moves it; says which.
        """
        if not goals:
            return None
        rows = []
        for name, goal in goals.items():
            frame, X_WG = find_frame(plant, name), _as_transform(goal)
            body = int(frame.body().index())
            link = int(tree.body_links[body])
            if link < 0:
                remedy = "Give the goal of a frame of a link that joints move."
                raise ScenarioError(
                    f"frame_goals[{name}]", "a frame that stands still", remedy=remedy
                )
            X = frame.GetFixedPoseInBodyFrame()
            R = tree.body_rotations[body].reshape(3, 3)
            place = tree.body_offsets[body] + R @ X.translation()
            weights = (*goal.weight.xyz, goal.weight.turn[0])
            R = R @ X.rotation().matrix()
            rows.append((link, R, place, X_WG.rotation().matrix(), X_WG.translation(), weights))
        links, *columns = zip(*rows, strict=True)
        arrays = (np.array(column, dtype=float).reshape(len(rows), -1) for column in columns)
        return cls(tree, FrameTable(np.array(links, dtype=np.int64), *arrays))

    def errors(self, q: Floats) -> Floats:
        """Returns p − p* [m] and θ [rad] of each frame, shape (…, F, 4), at q of shape (…, nq)."""
        from drake_aigto.dynamics import measure_frames

        rows = np.array(np.reshape(q, (-1, np.shape(q)[-1])), dtype=float, order="C")
        found = measure_frames(self.tree, self.table, rows, make_tree_memory(self.tree))
        found[..., 3] = np.arccos(np.clip(found[..., 3], -1.0, 1.0))
        return found.reshape(*np.shape(q)[:-1], len(self.table.links), 4)

    def cost(self, q: Floats) -> Floats:
        """Returns what the frames cost, shape (…), at q of shape (…, nq)."""
        errors = self.errors(q)
        errors[..., 3] = 2 * np.sin(errors[..., 3] / 2)
        return np.einsum("...fk,fk", errors**2, self.table.weights)

    def asked(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns errors that are weighed, of positions (…, A) [m] and of turns (…, B) [rad]."""
        errors, is_asked = self.errors(q), self.table.weights > 0
        return errors[..., :3][..., is_asked[:, :3]], errors[..., 3][..., is_asked[:, 3]]


def find_frame(plant: MultibodyPlant, name: str) -> Frame:
    """Returns a frame by its name; a link's has the link's.

    Raises:
        ScenarioError: there is none, or several models have one.
    """
    frames = [plant.get_frame(FrameIndex(i)) for i in range(1, plant.num_frames())]
    names = sorted({each.name() for each in frames if each.name()})
    found = [each for each in frames if each.name() == name]
    if len(found) != 1:
        raise ScenarioError(
            f"frame_goals[{name}]",
            got=f"{len(found)} of this name" if found else "no such frame",
            expected=f"one of {', '.join(names)}",
            hint=suggest(name, names),
        )
    return found[0]


def reach_frames(
    plant: MultibodyPlant, goals: Mapping[str, FrameGoal], q: Floats, is_free: Floats
) -> Floats:
    """Returns positions near q at which frames are nearest to their goals, shape (nq,).

    By damped Gauss-Newton steps within joint limits, along velocities that are free, (nv,): where
    a search begins.
    """
    context, world = plant.CreateDefaultContext(), plant.world_frame()
    lower, upper = plant.GetPositionLowerLimits(), plant.GetPositionUpperLimits()
    frames = [(find_frame(plant, name), _as_transform(g), g.weight) for name, g in goals.items()]
    for _ in range(_STEPS):
        plant.SetPositions(context, q)
        rows, errors = [np.zeros((0, plant.num_velocities()))], [np.zeros(0)]
        for frame, X_WG, weight in frames:
            J = plant.CalcJacobianSpatialVelocity(
                context, JacobianWrtVariable.kV, frame, np.zeros(3), world, world
            )
            X = frame.CalcPoseInWorld(context)
            turn = (X.rotation() @ X_WG.rotation().inverse()).ToAngleAxis()
            off = np.concatenate([turn.angle() * turn.axis(), X.translation() - X_WG.translation()])
            scale = np.sqrt([*weight.turn, *weight.xyz])
            rows.append(scale[:, np.newaxis] * J * is_free)
            errors.append(scale * off)
        A, e = np.vstack(rows), np.concatenate(errors)
        H = A.T @ A
        step = -np.linalg.solve(H + _DAMPING * (np.trace(H) + 1e-9) * np.eye(len(H)), A.T @ e)
        step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-9))
        q = np.clip(q + plant.MapVelocityToQDot(context, step), lower, upper)
    return q


def _as_transform(goal: FrameGoal) -> RigidTransform:
    quaternion = np.array(goal.pose.quaternion)
    return RigidTransform(Quaternion(quaternion / np.linalg.norm(quaternion)), goal.pose.xyz)
