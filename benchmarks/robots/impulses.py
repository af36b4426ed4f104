"""The gradient peer where walls are rigid: CasADi and IPOPT, with impulses between phases.

Which walls are touched, and how often, is read off a random roll-out; when is left to IPOPT, as in
any program of several phases. Each has as many steps of the implicit midpoint rule, of second
order, and a length of its own; u is held in each step. Between phases wall i is hit:

    q_{k+1} − q_k = h (v_k + v_{k+1})/2,    M (v_{k+1} − v_k) = h f    in the middle;    φ(q_k) ≥ 0
    φ_i = 0,    M (v⁺ − v⁻) = J_iᵀ p,    J_i v⁺ = −e J_i v⁻,    p ≥ 0    between phases
"""

from __future__ import annotations

import itertools
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from benchmarks.local_peers import casadi
from benchmarks.robots.ipopt import COLD, FARTHEST, IPOPT_STEPS, prepare, weigh, write_symbols
from benchmarks.robots.judge import Control
from benchmarks.robots.mechanics import make_tables
from benchmarks.robots.worlds import WORLDS, Question, Setting, setting_of

_SHORTEST = 1e-3  # phase, in parts of the duration
_STRONGEST = 1e3  # impulse [N s]
_REST = 1e-4  # [m/s]


class Touch(NamedTuple):
    """A touch of a roll-out."""

    time: float  # [s]
    wall: int
    before: np.ndarray  # v⁻ (n,)
    after: np.ndarray  # v⁺ (n,)
    impulse: float  # p [N s], nearly


def find_touches(question: Question, states: np.ndarray) -> list[Touch]:
    """Returns the first touches of walls in a roll-out at equal times (L + 1, 2n).

    There a wall that is near is neared no more. As many as are listed for the world at most.
    """
    setting, touches = setting_of(question), []
    mechanism, n = setting.mechanism, setting.mechanism.coordinates
    step, rest = setting.duration / (len(states) - 1), np.zeros(mechanism.controls)
    out, before = make_tables(mechanism), np.zeros(mechanism.walls)
    for number, x in enumerate(states):
        mechanism.write.py_func(x[:n], x[n:], rest, mechanism.wall, out)
        rates = out.normal @ x[n:]
        for wall in np.flatnonzero((before < -_REST) & (rates > -_REST)).tolist():
            change, normal = rates[wall] - before[wall], out.normal[wall]
            if out.gap[wall] < 2 * step * change:
                impulse = change / (normal @ np.linalg.solve(out.mass, normal))
                speeds = states[number - 1, n:], x[n:]
                touches.append(Touch((number - 0.5) * step, wall, *speeds, float(impulse)))
        before = rates
    return touches[: WORLDS[question.world].touches]


class _Symbols(NamedTuple):
    """Variables: by coordinate, control or one, and by knot, step, touch or phase."""

    q: Any  # (n, N + 1)
    v: Any  # before a touch (n, N + 1)
    after: Any  # v⁺ of touches (n, K)
    impulse: Any  # p (1, K)
    u: Any  # (nu, N)
    length: Any  # of phases (1, K + 1)


class _Rows(NamedTuple):
    """Rows of a program."""

    zero: list[Any]
    positive: list[Any]
    norm: list[Any]  # u·u, bounded


@cache
def find_rigid_program(world: str, touches: int) -> RigidProgram:
    """Returns the program of so many touches, which all questions of a world share."""
    return RigidProgram(setting_of(Question(world, 0)), touches)


class RigidProgram:
    """A program of K touches, of which walls is a parameter."""

    def __init__(self, setting: Setting, touches: int) -> None:
        """Makes the program, and IPOPT for it."""
        prepare()
        mechanism = self._mechanism = setting.mechanism
        self.num_steps = N = IPOPT_STEPS // (touches + 1) * (touches + 1)
        self._touches, n = touches, mechanism.coordinates
        self._shapes = [
            (n, N + 1),
            (n, N + 1),
            (n, touches),
            (1, touches),
            (mechanism.controls, N),
            (1, touches + 1),
        ]
        names = zip(_Symbols._fields, self._shapes, strict=True)
        x = _Symbols(*(casadi.SX.sym(name, *shape) for name, shape in names))
        goal, e, duration = casadi.SX.sym("goal", n), casadi.SX.sym("e"), casadi.SX.sym("duration")
        walls = casadi.SX.sym("walls", mechanism.walls, touches)
        rows = _Rows([casadi.sum2(x.length) - duration], [], [])
        cost = self._write(setting, x, goal, walls, rows)
        for number in range(touches):
            self._hit(x, number, e, walls[:, number], rows)
        self._counts = [casadi.veccat(*each).numel() for each in rows]
        program = {
            "x": casadi.veccat(*x),
            "p": casadi.veccat(goal, e, duration, walls),
            "f": cost,
            "g": casadi.veccat(*(row for each in rows for row in each)),
        }
        self._solver = casadi.nlpsol("rigid", "ipopt", program, COLD)

    def _write(self, setting: Setting, x: _Symbols, goal: Any, walls: Any, rows: _Rows) -> Any:
        """Returns J, and writes the rows of all steps."""
        w, total, steps = setting.weights, 0.0, self.num_steps // (self._touches + 1)
        for k in range(self.num_steps):
            phase, first = divmod(k, steps)
            start = x.after[:, phase - 1] if phase > 0 and first == 0 else x.v[:, k]
            q, v = (x.q[:, k] + x.q[:, k + 1]) / 2, (start + x.v[:, k + 1]) / 2
            h, u = x.length[phase] / steps, x.u[:, k]
            out = write_symbols(self._mechanism, q, v, u)
            rows.zero.append(x.q[:, k + 1] - x.q[:, k] - h * v)
            rows.zero.append(out.mass @ (x.v[:, k + 1] - start) - h * out.force)
            gap = write_symbols(self._mechanism, x.q[:, k + 1], v, u).gap
            if (k + 1) % steps == 0 and phase < self._touches:
                gap = casadi.if_else(walls[:, phase] > 0, 1.0, gap)  # It is a row of `_hit`.
            rows.positive.append(gap)
            rows.norm.append(casadi.dot(u, u))
            rate = weigh(w, w.position, w.velocity, q, v, goal) + casadi.dot(w.control, u**2)
            total += h * rate
        return total + weigh(w, w.final_position, w.final_velocity, x.q[:, -1], x.v[:, -1], goal)

    def _hit(self, x: _Symbols, number: int, e: Any, wall: Any, rows: _Rows) -> None:
        """Writes the rows of a touch; the wall is 1 where it is, else 0."""
        k = (number + 1) * self.num_steps // (self._touches + 1)
        before, after = x.v[:, k], x.after[:, number]
        out = write_symbols(self._mechanism, x.q[:, k], before, x.u[:, 0])
        normal = wall.T @ out.normal
        rows.zero.append(casadi.dot(wall, out.gap))
        rows.zero.append(out.mass @ (after - before) - normal.T * x.impulse[number])
        rows.zero.append(normal @ (after + e * before))

    def solve(
        self, question: Question, touches: list[Touch], states: np.ndarray, controls: np.ndarray
    ) -> tuple[float, Control]:
        """Returns J and the held control; infinite if it is not solved.

        Args:
            question: of this world.
            touches: K of them.
            states: q and v of the guess at equal times (L + 1, 2n).
            controls: of the guess (L + 1, nu).
        """
        setting, N, n = setting_of(question), self.num_steps, self._mechanism.coordinates
        ends = np.array([0.0, *(touch.time for touch in touches), setting.duration])
        steps = N // (self._touches + 1)
        phases = [np.linspace(*pair, steps, endpoint=False) for pair in itertools.pairwise(ends)]
        times = np.append(np.concatenate(phases), ends[-1])
        even = np.linspace(0.0, setting.duration, len(states))
        x = np.column_stack([np.interp(times, even, each) for each in states.T])
        u = np.column_stack([np.interp(times[:-1], even, each) for each in controls.T])
        v, after = x[:, n:], np.array([touch.after for touch in touches]).reshape(-1, n)
        for number, touch in enumerate(touches):
            v[(number + 1) * steps] = touch.before
        impulses = np.array([touch.impulse for touch in touches])
        parts = [x[:, :n], v, after, impulses, u, np.diff(ends)]
        lower, upper = self._bounds(setting)
        walls = np.eye(self._mechanism.walls)[[touch.wall for touch in touches]]
        answer = self._solver(
            x0=np.clip(np.concatenate([each.ravel() for each in parts]), lower, upper),
            p=[*setting.weights.goal, setting.restitution, setting.duration, *walls.ravel()],
            lbx=lower,
            ubx=upper,
            lbg=np.repeat([0.0, 0.0, -np.inf], self._counts),
            ubg=np.repeat([0.0, np.inf, setting.norm**2], self._counts),
        )
        found, tail = np.array(answer["x"]).ravel(), self._touches + 1
        h = np.repeat(found[-tail:] / steps, steps)
        values = found[-tail - u.size : -tail].reshape(u.shape)
        is_solved = self._solver.stats()["success"]
        promised = float(answer["f"]) if is_solved else np.inf
        return promised, Control(np.concatenate([[0.0], np.cumsum(h)]), values)

    def _bounds(self, setting: Setting) -> tuple[np.ndarray, np.ndarray]:
        """Returns those of all variables, which hold the start and a hard goal."""
        T, force, both = setting.duration, min(self._mechanism.force, 1e3), []
        for sign, ranges in zip((-1, 1), setting.ranges, strict=True):
            q, v, after, impulse, u, length = (np.empty(shape[::-1]) for shape in self._shapes)
            q[:], v[:] = np.split(np.clip(ranges, -FARTHEST, FARTHEST), 2)
            q[0], v[0] = np.split(setting.start, 2)
            if setting.is_hard:
                q[-1] = setting.weights.goal
            after[:], u[:] = v[-1], sign * force
            impulse[:], length[:] = (_STRONGEST, 2 * T) if sign > 0 else (0.0, _SHORTEST * T)
            parts = (q, v, after, impulse, u, length)
            both.append(np.concatenate([each.ravel() for each in parts]))
        return both[0], both[1]
