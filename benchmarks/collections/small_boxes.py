"""A small box that is pushed on one face at a time, chosen anew in each step, as SPOT poses it.

Kang, Liu & Yang, RSS 2025, arXiv:2502.02829. Its relaxation needs no start; others get the line to
the goal.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram

# SPOT's ten starts of its box: angle [rad], position [m].
SPOT_BOXES = (
    (1.9775, 0.1473, 0.2967),
    (2.5497, 0.3912, 0.1107),
    (-2.3437, 0.3872, 0.3547),
    (2.5973, 0.2456, 0.3802),
    (0.8316, 0.3401, 0.3036),
    (-2.5287, 0.1426, 0.3273),
    (-1.3917, 0.2265, 0.3229),
    (0.2946, 0.3747, 0.2177),
    (2.8746, 0.3377, 0.2966),
    (2.9210, 0.3878, 0.1514),
)
# Half sides [m] of SPOT's box, how far the pusher stays from corners, and what turns the box.
_HALF_X, _HALF_Y, _CLEAR, _SMALL_DT, _FARTHEST = 0.05, 0.1, 0.99, 0.1, 0.6
_SMALL_TURNING = 0.3 * np.hypot(_HALF_X, _HALF_Y)


class _SmallBox(NamedTuple):
    """Variables of SPOT's box: of N + 1 knots, and of N steps."""

    pose: Any  # cos and sin of the angle, and the position (N + 1, 4)
    turn: Any  # cos and sin of a step's (N, 2)
    point: Any  # of the pusher, in the box (N, 2)
    force: Any  # in the box (N, 2)
    faces: Any  # 1 of the one that is pushed (N, 4)


def push_small_box(start: tuple[float, float, float], num_steps: int = 30) -> MathematicalProgram:
    """Returns SPOT's box, pushed quasi-statically on one of four faces, chosen by λ_i in {0, 1}.

    With R the rotation of a knot, p the pusher's point and F its force in the box:

        s⁺ = s + dt R F,    sin Δθ = dt/(c r) (p_x F_y − p_y F_x),    λ_i (1 − λ_i) = 0,  Σ λ_i² = 1
        λ₁ (p_y − b) + λ₂ (p_x − a) + λ₃ (p_y + b) + λ₄ (p_x + a) = 0
        (λ₁ + λ₃) F_x + (λ₂ + λ₄) F_y = 0,    −λ₁ F_y, −λ₂ F_x, λ₃ F_y, λ₄ F_x ≥ 0

    SPOT's rows cos² θ + sin² θ = 1 of all knots are left out: they follow from those of the steps.
    Its λ_i have no bounds, which say nothing new.
    """
    prog = MathematicalProgram()
    sizes = (num_steps + 1, 4), (num_steps, 2), (num_steps, 2), (num_steps, 2), (num_steps, 4)
    names = ("pose", "turn", "point", "force", "face")
    box = _SmallBox(
        *(prog.NewContinuousVariables(*size, name) for size, name in zip(sizes, names, strict=True))
    )
    first = np.array([np.cos(start[0]), np.sin(start[0]), *start[1:]])
    most = np.array([1.0, 1.0, _FARTHEST, _FARTHEST])
    prog.AddBoundingBoxConstraint(first, first, box.pose[0])
    for knot in box.pose[1:]:
        prog.AddBoundingBoxConstraint(-most, most, knot)
    prog.AddBoundingBoxConstraint(0.7, 1.0, box.turn[:, 0])
    for i, side in enumerate((_HALF_X, _HALF_Y)):
        prog.AddBoundingBoxConstraint(-side, side, box.point[:, i])
    prog.AddBoundingBoxConstraint(-1.0, 1.0, box.force.ravel())
    prog.AddBoundingBoxConstraint(0.0, 1.0, box.faces.ravel())
    for k in range(num_steps):
        _add_small_step(prog, box, k)
        _add_choice(prog, box.point[k], box.force[k], box.faces[k])
        weight = 10.0 if k == num_steps - 1 else 1.0
        cosine, sine, x, y = box.pose[k + 1]
        off = (cosine - 1) ** 2 + sine**2 + (x**2 + y**2) / _FARTHEST**2
        prog.AddQuadraticCost(weight * off + box.force[k, 0] ** 2 + box.force[k, 1] ** 2)
    return prog


def _add_small_step(prog: MathematicalProgram, box: _SmallBox, k: int) -> None:
    (cosine, sine, x, y), after = box.pose[k], box.pose[k + 1]
    (px, py), (fx, fy), (c, s) = box.point[k], box.force[k], box.turn[k]
    prog.AddConstraint(after[2] - x - _SMALL_DT * (cosine * fx - sine * fy) == 0)
    prog.AddConstraint(after[3] - y - _SMALL_DT * (sine * fx + cosine * fy) == 0)
    prog.AddConstraint(s - _SMALL_DT / _SMALL_TURNING * (px * fy - py * fx) == 0)
    prog.AddConstraint(after[0] - (cosine * c - sine * s) == 0)
    prog.AddConstraint(after[1] - (sine * c + cosine * s) == 0)
    prog.AddConstraint(c**2 + s**2 == 1)


def _add_choice(prog: MathematicalProgram, point: Any, force: Any, faces: Any) -> None:
    """Adds that one face is chosen, that the pusher is on it, and pushes inwards."""
    (x, y), (fx, fy), (up, right, down, left) = point, force, faces
    for face in faces:
        prog.AddConstraint(face * (1 - face) == 0)
    prog.AddConstraint(sum(face**2 for face in faces.tolist()) == 1)
    sides = up * (y - _HALF_Y) + right * (x - _HALF_X) + down * (y + _HALF_Y) + left * (x + _HALF_X)
    prog.AddConstraint(sides == 0)
    prog.AddConstraint((up + down) * fx + (right + left) * fy == 0)
    for face, inward in ((up, -fy), (right, -fx), (down, fy), (left, fx)):
        prog.AddConstraint(face * inward >= 0)
    for face, along, side in (
        *((face, x, _HALF_X) for face in (up, down)),
        *((face, y, _HALF_Y) for face in (right, left)),
    ):
        prog.AddConstraint(face * (_CLEAR * side - along) >= 0)
        prog.AddConstraint(face * (_CLEAR * side + along) >= 0)


def small_box_line(start: tuple[float, float, float], num_steps: int = 30) -> np.ndarray:
    """Returns x of a box that goes straight to its goal, pushed by nobody, faces undecided."""
    parts = np.linspace(1.0, 0.0, num_steps + 1)
    angles = parts * start[0]
    pose = np.column_stack([np.cos(angles), np.sin(angles), np.outer(parts, start[1:])])
    turns = np.diff(angles)
    turn = np.column_stack([np.cos(turns), np.sin(turns)])
    rest = np.zeros(4 * num_steps), np.full(4 * num_steps, 0.5)
    return np.concatenate([pose.ravel(), turn.ravel(), *rest])
