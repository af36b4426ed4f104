"""Programs of contact that the authors of other systems solve, in their own discretizations.

Sources, with what each is solved from:

- CRISP (Li, Han, Kang, Ma & Yang, RSS 2025, arXiv:2502.01055): a payload on a cart, a waiter's
  plate, a box that is pushed; from zero.
- SPOT (Kang, Liu & Yang, RSS 2025, arXiv:2502.02829): a small box (`small_boxes`).
- NIPOCPEC (Lin & Ohtsuka, github.com/KY-Lin22/NIPOCPEC): three carts in a row, the middle one of
  which pushes; from ones. Nosnoc (Nurkanović & Diehl 2022) has taken it over with other data.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import cos, sin

from benchmarks.collections.small_boxes import SPOT_BOXES, push_small_box, small_box_line
from benchmarks.collections.staged_programs import StagedProblem

# What CasADi and IPOPT from many starts know of CRISP's own payload.
KNOWN = {"payload/25": 2.958349}
_GRAVITY = 9.81  # [m/s²]


def peer_problems() -> Iterator[StagedProblem]:
    """Yields the peers' programs, each with the start that its authors solve it from."""
    for i, task in enumerate(payload_tasks()):
        yield _from(f"payload/{i}", 0.0, partial(payload, *task))
    yield _from("waiter/0", 0.0, waiter)
    for i, goal in enumerate(box_goals()):
        yield _from(f"push_box/{i}", 0.0, partial(push_box, goal))
    for i, start in enumerate(SPOT_BOXES):
        make = partial(push_small_box, start)
        yield StagedProblem(f"small_box/{i}", make, guess=partial(small_box_line, start))
    for name, data in (("NIPOCPEC", NIPOCPEC_CARTS), ("nosnoc", NOSNOC_CARTS)):
        yield _from(f"three_carts/{name}", 1.0, partial(three_carts, data))


def _from(name: str, value: float, prog: Any) -> StagedProblem:
    """Returns a problem whose authors start with all variables at one value."""
    return StagedProblem(name, prog, guess=lambda: np.full(prog().num_vars(), value))


def payload_tasks() -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yields CRISP's 27 starts and goals, each positions and speeds of cargo and cart."""
    for cargo in (3.0, 2.5, 3.5):
        for speeds in ((0.0, 0.0), (-3.0, 0.0), (-4.0, -2.0)):
            for goal in (0.0, -0.5, 0.5):
                first, last = speeds
                yield (np.array([cargo, 3.0, first, first]), np.array([goal, 0.0, last, last]))


def payload(start: np.ndarray, goal: np.ndarray, num_knots: int = 200) -> MathematicalProgram:
    """Returns CRISP's payload on a cart, which slides: linear rows and complementarities.

    ẍ₁ = f/m₁,  ẍ₂ = (u − f)/m₂,  ẋ₁ − ẋ₂ = v − w,  |f| ≤ μ m₁ g,  |x₁ − x₂| ≤ 1,
    0 ≤ v ⊥ w ≥ 0,    w ⊥ μ m₁ g − f,    v ⊥ f + μ m₁ g

    by Euler's method, semi-implicit; forces are of all knots, the last one's are free of charge.
    """
    cargo, cart, dt, most = 1.0, 2.0, 0.02, 0.2 * _GRAVITY
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(num_knots, 4, "x")
    u, f, v, w = (prog.NewContinuousVariables(num_knots, name) for name in "ufvw")
    prog.AddBoundingBoxConstraint(start, start, x[0])
    prog.AddBoundingBoxConstraint(-most, most, f)
    prog.AddBoundingBoxConstraint(0.0, np.inf, np.concatenate([v, w]))
    prog.AddBoundingBoxConstraint(0.0, 0.0, [v[0], w[0]])
    for k in range(num_knots):
        prog.AddLinearConstraint(x[k, 0] - x[k, 1], -1.0, 1.0)
        prog.AddConstraint(v[k] * w[k] <= 0)
        prog.AddConstraint(w[k] * (most - f[k]) <= 0)
        prog.AddConstraint(v[k] * (f[k] + most) <= 0)
    for k in range(num_knots - 1):
        _add_sliding_step(prog, x[k], x[k + 1], (f[k] / cargo, (u[k] - f[k]) / cart), dt)
        prog.AddConstraint(x[k, 2] - x[k, 3] == v[k] - w[k])
        prog.AddQuadraticCost(1e-4 * (f[k] ** 2 + u[k] ** 2))
    _add_goal(prog, x[-1], goal, (1e5, 1e5, 10.0, 10.0))
    return prog


def _add_sliding_step(
    prog: MathematicalProgram, x: Any, after: Any, rates: tuple[Any, Any], dt: float
) -> None:
    """Adds a semi-implicit step of two positions and their speeds."""
    for i, rate in enumerate(rates):
        prog.AddConstraint(after[i] == x[i] + dt * after[2 + i])
        prog.AddConstraint(after[2 + i] == x[2 + i] + dt * rate)


def _add_goal(prog: MathematicalProgram, x: Any, goal: Any, weights: Any) -> None:
    """Adds Σ w_i (x_i − goal_i)²."""
    for variable, value, weight in zip(x, goal, weights, strict=True):
        prog.AddQuadraticCost(weight * (variable - value) ** 2)


def push_circle(num_steps: int = 120) -> MathematicalProgram:
    """Returns IMPACT's disc that a pusher has to go round, as we read it, quasistatic.

    Li, Gong & Chalvatzaki (RSS 2026, arXiv:2605.09127), push_circle. With disc q and pusher s, R =
    0.3 m, n = (q − s)/R, t across it, and Euler's method:

        q⁺ = q + Δt (f n + p t) / (μ m g),    s⁺ = s + Δt v,    |p| ≤ 0.1 f
        0 ≤ f ⊥ |q − s|² − R² ≥ 0,    minimize   10⁻² Σ (f² + p² + |v|²) + 100 |q_N − s_0|²

    Of |p| no more is asked. The start is a pusher that stands still.
    """
    radius, grip, dt, cone = 0.3, 0.1 * _GRAVITY, 0.05, 0.1
    begin = np.full(2, -1.5 / np.sqrt(2))
    prog = MathematicalProgram()
    q, s = (prog.NewContinuousVariables(num_steps + 1, 2, name) for name in "qs")
    v, f = (prog.NewContinuousVariables(num_steps, 2, name) for name in "vf")
    prog.AddBoundingBoxConstraint(0.0, 0.0, q[0])
    prog.AddBoundingBoxConstraint(begin, begin, s[0])
    prog.AddBoundingBoxConstraint(0.0, np.inf, f[:, 0])
    for k in range(num_steps):
        n = (q[k] - s[k]) / radius
        force = f[k, 0] * n + f[k, 1] * np.array([-n[1], n[0]])
        for i in range(2):
            prog.AddConstraint(q[k + 1, i] == q[k, i] + dt / grip * force[i])
            prog.AddConstraint(s[k + 1, i] == s[k, i] + dt * v[k, i])
        prog.AddLinearConstraint(f[k, 1] <= cone * f[k, 0])
        prog.AddLinearConstraint(f[k, 1] >= -cone * f[k, 0])
        prog.AddQuadraticCost(1e-2 * (f[k] @ f[k] + v[k] @ v[k]))
    for k in range(num_steps + 1):
        apart = (q[k] - s[k]) @ (q[k] - s[k]) - radius**2
        prog.AddConstraint(apart >= 0)
        if k < num_steps:
            prog.AddConstraint(f[k, 0] * apart <= 0)
    _add_goal(prog, q[-1], begin, (100.0, 100.0))
    prog.SetInitialGuess(q, np.zeros_like(q, dtype=float))
    prog.SetInitialGuess(s, np.tile(begin, (num_steps + 1, 1)))
    return prog


def waiter(num_knots: int = 100) -> MathematicalProgram:
    """Returns CRISP's waiter: a finger pulls a plate off a table by friction, and it must not tip.

    Plate x₁ and finger x₂ [m], normal forces N of the table and n of the finger, friction p and f:

        m₁ ẍ₁ = f − p,    m₂ ẍ₂ = u − f,    N + n = m₁ g,    m₁ g l − n (x₂ − x₁ + l) ≥ 0
        ẋ₁ = v − w,    0 ≤ v ⊥ w ≥ 0,    v ⊥ μ₁ N − p ≥ 0,    w ⊥ p + μ₁ N ≥ 0
        ẋ₂ − ẋ₁ = r − q,    0 ≤ r ⊥ q ≥ 0,    r ⊥ μ₂ n − f ≥ 0,    q ⊥ f + μ₂ n ≥ 0
    """
    plate, finger, table_grip, finger_grip, length, dt = 2.0, 1.0, 0.1, 1.0, 7.0, 0.05
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(num_knots, 4, "x")
    slips = [prog.NewContinuousVariables(num_knots, name) for name in "vwrq"]
    push, u, grip, drag, normal = (
        prog.NewContinuousVariables(num_knots, name) for name in ("n", "u", "f", "p", "N")
    )
    start = (-6.0, 0.1, 0.0, 0.0)
    prog.AddBoundingBoxConstraint(start, start, x[0])
    prog.AddBoundingBoxConstraint(0.0, np.inf, np.concatenate([*slips, push, normal]))
    prog.AddBoundingBoxConstraint(0.0, 0.0, [slip[0] for slip in slips])
    prog.AddBoundingBoxConstraint(0.1, np.inf, x[:, 1])
    for k in range(num_knots):
        v, w, r, q = (slip[k] for slip in slips)
        prog.AddLinearConstraint(x[k, 1] - x[k, 0] <= length)
        arm = x[k, 1] - x[k, 0] + length
        prog.AddConstraint(plate * _GRAVITY * length - push[k] * arm >= 0)
        _add_friction(prog, v, w, drag[k], table_grip * normal[k])
        _add_friction(prog, r, q, grip[k], finger_grip * push[k])
    for k in range(num_knots - 1):
        v, w, r, q = (slip[k] for slip in slips)
        rates = (grip[k] - drag[k]) / plate, (u[k] - grip[k]) / finger
        _add_sliding_step(prog, x[k], x[k + 1], rates, dt)
        prog.AddConstraint(x[k, 3] - x[k, 2] == r - q)
        prog.AddConstraint(x[k, 2] == v - w)
        prog.AddConstraint(normal[k] + push[k] == plate * _GRAVITY)
        prog.AddQuadraticCost(1e-4 * (push[k] ** 2 + u[k] ** 2))
    _add_goal(prog, x[-1], (0.1, 0.1, 2.0, 2.0), (100.0,) * 4)
    return prog


def _add_friction(prog: MathematicalProgram, ahead: Any, back: Any, force: Any, most: Any) -> None:
    """Adds Coulomb's law: a force up to `most`, which it is against a sliding ahead or back."""
    prog.AddConstraint(most - force >= 0)
    prog.AddConstraint(force + most >= 0)
    prog.AddConstraint(ahead * back <= 0)
    prog.AddConstraint(ahead * (most - force) <= 0)
    prog.AddConstraint(back * (force + most) <= 0)


def box_goals() -> list[tuple[float, float, float]]:
    """Returns CRISP's 18 goals on a circle of 3 m; each faces the way it lies in."""
    angles = 2 * np.pi * np.arange(18) / 18
    return [(3 * np.cos(t), 3 * np.sin(t), t) for t in angles.tolist()]


def push_box(goal: tuple[float, float, float], num_knots: int = 100) -> MathematicalProgram:
    """Returns CRISP's box, pushed quasi-statically on one of four faces at a time.

    Forces λ₁, λ₂ ≥ 0 and λ₃, λ₄ ≤ 0 act at a point (x, y) of the box, on the face it is at:

        λ₁ ⊥ y + b,  λ₂ ⊥ x + a,  −λ₃ ⊥ b − y,  −λ₄ ⊥ a − x,  λ_i λ_j = 0
    """
    a, b, dt, ground = 0.5, 0.25, 0.02, 0.5 * 1.0 * 9.8
    turning = ground * 0.4 * np.hypot(a, b)
    prog = MathematicalProgram()
    pose = prog.NewContinuousVariables(num_knots, 3, "pose")
    point = prog.NewContinuousVariables(num_knots - 1, 2, "point")
    force = prog.NewContinuousVariables(num_knots - 1, 4, "force")
    prog.AddBoundingBoxConstraint(0.0, 0.0, pose[0])
    for i, side in enumerate((a, b)):
        prog.AddBoundingBoxConstraint(-side, side, point[:, i])
    prog.AddBoundingBoxConstraint(0.0, np.inf, force[:, :2].ravel())
    prog.AddBoundingBoxConstraint(-np.inf, 0.0, force[:, 2:].ravel())
    for k in range(num_knots - 1):
        (x, y), each, angle = point[k], force[k], pose[k, 2]
        along, across = each[1] + each[3], each[0] + each[2]
        rates = (
            (cos(angle) * along - sin(angle) * across) / ground,
            (sin(angle) * along + cos(angle) * across) / ground,
            (x * across - y * along) / turning,
        )
        for i, rate in enumerate(rates):
            prog.AddConstraint(pose[k + 1, i] - pose[k, i] - dt * rate == 0)
        _add_faces(prog, each, (y + b, x + a, b - y, a - x))
        prog.AddQuadraticCost(1e-3 * sum(push**2 for push in each.tolist()))
    _add_goal(prog, pose[-1], goal, (100.0,) * 3)
    return prog


def _add_faces(prog: MathematicalProgram, forces: Any, gaps: tuple[Any, ...]) -> None:
    """Adds that one force at most acts, on the face where the pusher is."""
    signs = (1, 1, -1, -1)
    for i, (push, gap) in enumerate(zip(forces, gaps, strict=True)):
        prog.AddConstraint(signs[i] * push * gap <= 0)
        for j in range(i + 1, len(signs)):
            prog.AddConstraint(signs[i] * signs[j] * push * forces[j] <= 0)


class Carts(NamedTuple):
    """Data of three carts in a row.

    Attributes:
        steps: how many.
        dt: of a step [s].
        held: for so many steps a control is the same.
        running: weights of positions and speeds, off the goal.
        control: weight of u².
        force: weight of λ².
        final: weights at the end.
        lower: bounds of positions and speeds.
        upper: bounds of positions and speeds.
        most: largest control.
    """

    steps: int
    dt: float
    held: int
    running: tuple[float, ...]
    control: float
    force: float
    final: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    most: float


NIPOCPEC_CARTS = Carts(
    steps=200,
    dt=0.02,
    held=1,
    running=(50.0, 50.0, 50.0, 0.05, 0.05, 0.05),
    control=0.05,
    force=0.05,
    final=(50.0, 5.0, 50.0, 5.0, 0.5, 5.0),
    lower=(-8.0, -8.0, -8.0, -20.0, -20.0, -20.0),
    upper=(8.0, 8.0, 8.0, 20.0, 20.0, 20.0),
    most=50.0,
)
NOSNOC_CARTS = Carts(
    steps=60,
    dt=5.0 / 60.0,
    held=3,
    running=(10.0, 1.0, 10.0, 0.1, 0.1, 0.1),
    control=0.1,
    force=0.0,
    final=(1e3, 1e2, 1e3, 10.0, 10.0, 10.0),
    lower=(-15.0, -15.0, -10.0, -5.0, -5.0, -5.0),
    upper=(10.0, 15.0, 15.0, 5.0, 5.0, 5.0),
    most=20.0,
)


def three_carts(data: Carts) -> MathematicalProgram:
    """Returns three carts of 1 kg and 2 m: the middle one is to push the outer ones apart.

        q̈₁ = −2 q̇₁ − λ₁,  q̈₂ = −2 q̇₂ + u + λ₁ − λ₂,  q̈₃ = −2 q̇₃ + λ₂
        0 ≤ λ₁ ⊥ q₂ − q₁ − 2 ≥ 0,    0 ≤ λ₂ ⊥ q₃ − q₂ − 2 ≥ 0

    by Euler's implicit method, as NIPOCPEC; nosnoc's own steps follow the switches, which have
    variables of their own.
    """
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(data.steps + 1, 6, "x")
    u = prog.NewContinuousVariables(data.steps // data.held, "u")
    force = prog.NewContinuousVariables(data.steps, 2, "force")
    start, goal = (-3.0, 0.0, 3.0, 0.0, 0.0, 0.0), (-5.0, 0.0, 5.0, 0.0, 0.0, 0.0)
    prog.AddBoundingBoxConstraint(start, start, x[0])
    for knot in x[1:]:
        prog.AddBoundingBoxConstraint(data.lower, data.upper, knot)
    prog.AddBoundingBoxConstraint(-data.most, data.most, u)
    prog.AddBoundingBoxConstraint(0.0, np.inf, force.ravel())
    for k in range(data.steps):
        own, after = u[k // data.held], x[k + 1]
        left, right = force[k]
        for i, push in enumerate((-left, own + left - right, right)):
            prog.AddConstraint(after[i] == x[k, i] + data.dt * after[3 + i])
            prog.AddConstraint(after[3 + i] == x[k, 3 + i] + data.dt * (push - 2 * after[3 + i]))
        for push, gap in ((left, after[1] - after[0] - 2), (right, after[2] - after[1] - 2)):
            prog.AddConstraint(gap >= 0)
            prog.AddConstraint(push * gap <= 0)
        _add_goal(prog, after, goal, data.dt * np.array(data.running))
        running = data.control * own**2 + data.force * (left**2 + right**2)
        prog.AddQuadraticCost(data.dt * running)
    _add_goal(prog, x[-1], goal, data.final)
    return prog
