"""The gradient peer: CasADi and IPOPT on a direct transcription of the cart-pole, exact Hessian.

Knots k = 0, …, N at k Δt and one beyond; accelerations (q_{k+1} − 2 q_k + q_{k−1})/Δt², velocities
(q_{k+1} − q_{k−1})/2Δt and the mechanics at knots, q_{−1} = q_1 − 2 Δt q̇_0, costs by the trapezoid
rule: second order throughout. u_k acts from half a step before its knot to half a step after it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.local_peers import casadi
from benchmarks.robots.cart_pole import (
    CART,
    DURATION,
    FINAL,
    GRAVITY,
    LARGEST_FORCE,
    LARGEST_POSITION,
    LENGTH,
    RUNNING,
    STIFFNESS,
    TIP,
    Question,
)

# max(0, y) as (y + √(y² + ε²))/2, which is complementarity 0 ≤ f ⊥ f/k − y ≥ 0 relaxed to f (f/k −
# y) = k ε²/4; ε [m] falls, each program from the optimum of the one before.
LADDER = (1e-1, 1e-2, 1e-3)
MAX_ITERATIONS = 300  # of each
_FARTHEST_ANGLE = 40.0  # [rad]: a bound that none comes near
_OPTIONS: dict[str, Any] = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.max_iter": MAX_ITERATIONS,
    "ipopt.tol": 1e-6,
}
_COLD = {**_OPTIONS, "ipopt.mu_strategy": "adaptive"}
_WARM = {
    **_OPTIONS,
    "ipopt.warm_start_init_point": "yes",
    "ipopt.warm_start_bound_push": 1e-6,
    "ipopt.warm_start_mult_bound_push": 1e-6,
    "ipopt.mu_init": 1e-4,
}


class Program:
    """Positions at knots 0, …, N + 1 and forces at 0, …, N, for any start and walls."""

    def __init__(self, num_steps: int) -> None:
        """Makes the program of N steps, and IPOPT for it."""
        self.num_steps = num_steps
        cart, angle = (casadi.SX.sym(name, num_steps + 2) for name in ("cart", "angle"))
        force = casadi.SX.sym("force", num_steps + 1)
        parameters = casadi.SX.sym("parameters", 4)  # ȧ and θ̇ of the start, d, ε
        cost, rows = self._write(cart, angle, force, parameters)
        variables = casadi.veccat(cart, angle, force)
        program = {"x": variables, "p": parameters, "f": cost, "g": rows}
        self._solvers = [
            casadi.nlpsol(name, "ipopt", program, options)
            for name, options in (("cold", _COLD), ("warm", _WARM))
        ]

    def _write(self, cart: Any, angle: Any, u: Any, parameters: Any) -> tuple[Any, Any]:
        """Returns J and the rows that are zero, the second kind over 5 m."""
        step = DURATION / self.num_steps
        a, th = cart[:-1], angle[:-1]
        c, s = casadi.cos(th), casadi.sin(th)
        (_, cart_rate), (speed, spin_rate) = (
            _differences(each, parameters[k], step) for k, each in enumerate((cart, angle))
        )
        f = _push(a + LENGTH * s, parameters[2], parameters[3])
        rows = casadi.veccat(
            (CART + TIP) * cart_rate + TIP * LENGTH * (c * spin_rate - s * speed**2) - u - f,
            (LENGTH * spin_rate + c * cart_rate + GRAVITY * s - c * f / TIP) / 5,
        )
        running = RUNNING[0] * a**2 + RUNNING[1] * (2 + 2 * c) + RUNNING[2] * speed**2
        running += RUNNING[3] * u**2
        final = FINAL[0] * a[-1] ** 2 + FINAL[1] * (2 + 2 * c[-1]) + FINAL[2] * speed[-1] ** 2
        ends = (running[0] + running[-1]) / 2
        return step * (casadi.sum1(running) - ends) + final, rows

    def solve(
        self, question: Question, states: np.ndarray, controls: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Returns J and controls (2 N,), each held for half a step; inf, nan if not solved.

        Args:
            question: where it starts.
            states: a, ȧ, θ, θ̇ of the guess, at the knots (N + 1, 4).
            controls: of the guess, at the knots (N + 1,).
        """
        n = self.num_steps
        lower, upper = self._bounds(question)
        positions = [np.append(q, 2 * q[-1] - q[-2]) for q in (states[:, 0], states[:, 2])]
        guess = {"x0": np.clip(np.concatenate([*positions, controls]), lower, upper)}
        rates = (question.start[1], question.start[3])
        for number, smoothing in enumerate(LADDER):
            solver = self._solvers[min(number, 1)]
            parameters = [*rates, question.wall, smoothing]
            answer = solver(**guess, p=parameters, lbx=lower, ubx=upper, lbg=0, ubg=0)
            if not solver.stats()["success"]:
                return np.inf, np.full(2 * n, np.nan)
            guess = {"x0": answer["x"], "lam_x0": answer["lam_x"], "lam_g0": answer["lam_g"]}
        forces = np.array(answer["x"]).ravel()[-n - 1 :]
        return float(answer["f"]), np.repeat(forces, 2)[1:-1]

    def _bounds(self, question: Question) -> tuple[np.ndarray, np.ndarray]:
        """Returns those of all variables; the start's position is held by them."""
        n = self.num_steps
        limits = (LARGEST_POSITION, _FARTHEST_ANGLE, LARGEST_FORCE)
        upper = np.repeat(limits, (n + 2, n + 2, n + 1))
        lower = -upper
        for place, value in ((0, question.start[0]), (n + 2, question.start[2])):
            lower[place] = upper[place] = value
        return lower, upper


def _differences(q: Any, start_rate: Any, step: float) -> tuple[Any, Any]:
    """Returns velocities and accelerations at knots 0, …, N, of positions at 0, …, N + 1."""
    before = casadi.vertcat(q[1] - 2 * step * start_rate, q[:-2])
    return (q[1:] - before) / (2 * step), (q[1:] - 2 * q[:-1] + before) / step**2


def _push(p: Any, wall: Any, smoothing: Any) -> Any:
    """Returns the smoothed f."""
    left, right = (
        (beyond + casadi.sqrt(beyond**2 + smoothing**2)) / 2 for beyond in (-wall - p, p - wall)
    )
    return STIFFNESS * (left - right)
