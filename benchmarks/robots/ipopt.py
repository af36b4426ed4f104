"""The gradient peer where walls yield: CasADi and IPOPT on a direct transcription, exact Hessian.

Knots k = 0, …, N at k Δt and one beyond; accelerations (q_{k+1} − 2 q_k + q_{k−1})/Δt², velocities
(q_{k+1} − q_{k−1})/2Δt and the mechanics at knots, q_{−1} = q_1 − 2 Δt q̇_0, costs by the trapezoid
rule: second order throughout. u_k acts from half a step before its knot to half a step after it.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from benchmarks.local_peers import casadi
from benchmarks.robots.judge import Control
from benchmarks.robots.mechanics import Mechanism, Tables
from benchmarks.robots.worlds import Question, Setting, Weights, setting_of

IPOPT_STEPS = 120  # with 60, costs of replays are off by more than 1 % in every third optimum
# max(0, y) as (y + √(y² + ε²))/2, which is complementarity 0 ≤ f ⊥ f/k − y ≥ 0 relaxed to f (f/k −
# y) = k ε²/4; ε [m] falls, each program from the optimum of the one before.
_LADDER = (1e-1, 1e-2, 1e-3)
MAX_ITERATIONS = 300  # of each
FARTHEST = 40.0  # [m], [rad]: a bound that none comes near
_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": MAX_ITERATIONS,
    "ipopt.tol": 1e-6,
}
COLD = {**_OPTIONS, "ipopt.mu_strategy": "adaptive"}
WARM = {
    **_OPTIONS,
    "ipopt.warm_start_init_point": "yes",
    "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_mult_bound_push": 1e-6,
    "ipopt.mu_init": 1e-4,
}


def prepare() -> None:
    """Has CasADi take NumPy's sin and cos of its symbols, which new versions ask for."""
    if hasattr(casadi.GlobalOptions, "setNumpyMode"):
        casadi.GlobalOptions.setNumpyMode(1)


def write_symbols(mechanism: Mechanism, q: Any, v: Any, u: Any) -> Tables:
    """Returns a mechanism's tables in CasADi's symbols."""
    n, m = mechanism.coordinates, max(1, mechanism.walls)
    sizes = (n, n), (n, 1), (m, 1), (m, n), (m, 1)
    out = Tables(*(casadi.SX(*size) for size in sizes))
    mechanism.write.py_func(q, v, u, mechanism.wall, out)
    return out


def weigh(w: Weights, position: Any, velocity: Any, q: Any, v: Any, goal: Any) -> Any:
    """Returns what a state costs by these weights of its parts."""
    off = q - goal
    squares = [
        2 - 2 * casadi.cos(off[i]) if is_chordal else off[i] ** 2
        for i, is_chordal in enumerate(w.is_chordal)
    ]
    speeds = (v - w.goal_velocity) ** 2
    return casadi.dot(position, casadi.vertcat(*squares)) + casadi.dot(velocity, speeds)


@cache
def find_program(world: str) -> Program:
    """Returns the program of a world, which one start shares with all others."""
    return Program(setting_of(Question(world, 0)), IPOPT_STEPS)


class Program:
    """Positions at knots 0, …, N + 1 and forces at 0, …, N, for any start, between soft walls."""

    def __init__(self, setting: Setting, num_steps: int) -> None:
        """Makes the program of N steps, and IPOPT for it."""
        prepare()
        self.num_steps, self._setting = num_steps, setting
        n, nu = setting.mechanism.coordinates, setting.mechanism.controls
        q, u = casadi.SX.sym("q", n, num_steps + 2), casadi.SX.sym("u", nu, num_steps + 1)
        parameters = casadi.SX.sym("parameters", n + 1)  # the start's velocity, ε
        cost, rows = self._write(q, u, parameters)
        variables = casadi.veccat(q, u)
        program = {"x": variables, "p": parameters, "f": cost, "g": rows}
        self._solvers = [
            casadi.nlpsol(name, "ipopt", program, options)
            for name, options in (("cold", COLD), ("warm", WARM))
        ]

    def _write(self, q: Any, u: Any, parameters: Any) -> tuple[Any, Any]:
        """Returns J and the rows that are zero."""
        step, w = self._setting.duration / self.num_steps, self._setting.weights
        velocity, smoothing = parameters[:-1], parameters[-1]
        before = casadi.horzcat(q[:, 1] - 2 * step * velocity, q[:, :-2])
        v = (q[:, 1:] - before) / (2 * step)
        rate = (q[:, 1:] - 2 * q[:, :-1] + before) / step**2
        rows, running = [], []
        for k in range(self.num_steps + 1):
            rows.append(self._balance(q[:, k], v[:, k], u[:, k], rate[:, k], smoothing))
            running.append(
                weigh(w, w.position, w.velocity, q[:, k], v[:, k], w.goal)
                + casadi.dot(w.control, u[:, k] ** 2)
            )
        total = step * (sum(running) - (running[0] + running[-1]) / 2)
        end = weigh(w, w.final_position, w.final_velocity, q[:, -2], v[:, -1], w.goal)
        return total + end, casadi.veccat(*rows)

    def _balance(self, q: Any, v: Any, u: Any, rate: Any, smoothing: Any) -> Any:
        """Returns M v̇ − f − Jᵀ λ at a knot."""
        mechanism, stiffness = self._setting.mechanism, self._setting.stiffness
        out = write_symbols(mechanism, q, v, u)
        row = out.mass @ rate - out.force
        for i in range(mechanism.walls if stiffness else 0):
            push = stiffness * (casadi.sqrt(out.gap[i] ** 2 + smoothing**2) - out.gap[i]) / 2
            row -= out.normal[i, :].T * push
        return row

    def solve(
        self, question: Question, states: np.ndarray, controls: np.ndarray
    ) -> tuple[float, Control]:
        """Returns J and a control, each value of which is held for half a step; inf if not solved.

        Args:
            question: where it starts.
            states: q and v of the guess, at the knots (N + 1, 2n).
            controls: of the guess, at the knots (N + 1, nu).
        """
        setting = setting_of(question)
        n, steps = setting.mechanism.coordinates, self.num_steps
        lower, upper = self._bounds(setting)
        q = np.vstack([states[:, :n], 2 * states[-1, :n] - states[-2, :n]])
        guess = {"x0": np.clip(np.concatenate([q.ravel(), controls.ravel()]), lower, upper)}
        promised, u = np.inf, np.zeros((steps + 1, controls.shape[1]))
        for number, smoothing in enumerate(_LADDER):
            solver, parameters = self._solvers[min(number, 1)], [*setting.start[n:], smoothing]
            answer = solver(**guess, p=parameters, lbx=lower, ubx=upper, lbg=0, ubg=0)
            if not solver.stats()["success"]:
                return np.inf, Control.even(u, setting.duration)
            guess = {"x0": answer["x"], "lam_x0": answer["lam_x"], "lam_g0": answer["lam_g"]}
            promised = float(answer["f"])
        u = np.array(answer["x"]).ravel()[-u.size :].reshape(u.shape)
        return promised, Control.even(np.repeat(u, 2, axis=0)[1:-1], setting.duration)

    def _bounds(self, setting: Setting) -> tuple[np.ndarray, np.ndarray]:
        """Returns those of all variables; the start's position is held by them."""
        n, steps = setting.mechanism.coordinates, self.num_steps
        nu, force = setting.mechanism.controls, min(setting.mechanism.force, 1e3)
        ranges = np.clip(setting.ranges[:, :n], -FARTHEST, FARTHEST)
        lower, upper = (
            np.concatenate([np.tile(each, steps + 2), np.full((steps + 1) * nu, sign * force)])
            for each, sign in zip(ranges, (-1, 1), strict=True)
        )
        lower[:n] = upper[:n] = setting.start[:n]
        return lower, upper
