"""IPOPT on the multiple shooting that plans solve: contact smoothed less and less, exact slopes.

    min J(z, u)   s.t.   f(z_k, u_k) − z_{k+1} = 0,   bounds of z and u

with z₁, …, z_K the states after each of K stages. CasADi calls our compiled stages for values and
sparse first derivatives; IPOPT estimates second ones.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.local_peers import casadi
from benchmarks.robots.judge import Control
from drake_aigto.arrays import Floats
from drake_aigto.kernels import borrow, kernel
from drake_aigto.shooting import (
    LINEARIZE,
    ShootingOptions,
    ShootingProblem,
    Smoothing,
    make_memory,
    travel,
)

_LADDER = ShootingOptions(rungs=tuple(Smoothing(each, 1, 1.0) for each in (0.1, 1e-2, 1e-3)))
_OPTIONS = {
    "print_time": False,
    "ipopt.print_level": 0,
    "ipopt.sb": "yes",
    "ipopt.hessian_approximation": "limited-memory",
    "ipopt.max_iter": 300,  # of each rung, as the next
    "ipopt.max_cpu_time": 10.0,
    "ipopt.tol": 1e-4,
}
_Base: Any = object if casadi is None else casadi.Callback


@kernel
def expand_motion(program: Any, states: Floats, controls: Floats, eps: float, memory: Any) -> float:
    """Computes all stages about a motion to second order, without bounds, and returns its cost."""
    program, memory = borrow(program), borrow(memory)
    return travel(program, states, controls, LINEARIZE, 0.0, eps, np.inf, 0, memory)


class ShootingProgram:
    """The program of a problem without phases; its controls have no common bound on their norm."""

    def __init__(self, problem: ShootingProblem) -> None:
        """Makes the program, for IPOPT."""
        self._problem, self._tables = problem, problem.make_program(_LADDER)
        bounds, nz = self._tables.bounds, len(problem.start)
        K, nu = bounds.lower_control.shape
        self._shape, self._memory = (K, nz, nu), make_memory(self._tables)
        self._smoothing, self._at, self._cost = 0.0, np.full(K * (nz + nu), np.nan), np.inf
        rows, columns = np.divmod(np.arange(K * nz * (nz + nu)), nz + nu)
        stages = rows // nz
        is_state = columns < nz
        places = np.where(is_state, (stages - 1) * nz, K * nz - nz + stages * nu) + columns
        self._kept = ~(is_state & (stages == 0))
        self._rows, self._columns = rows[self._kept], places[self._kept]
        self._bounds = {
            f"{side}bx": np.concatenate([states[1:, :nz].ravel(), controls.ravel()])
            for side, states, controls in (
                ("l", bounds.lower, bounds.lower_control),
                ("u", bounds.upper, bounds.upper_control),
            )
        }
        n, m = self._at.size, K * nz
        own = np.arange(m)
        triplets = [*self._rows, *own], [*self._columns, *own]
        sparsity = casadi.Sparsity.triplet(m, n, *([int(each) for each in t] for t in triplets))
        self._order = np.lexsort(triplets)  # Of triplets, by column as CasADi has them.
        self._parts = (
            _Part("cost", (n, 1), self._calc_cost, casadi.Sparsity.dense(1, n), self._calc_slope),
            _Part("rows", (n, m), self._calc_rows, sparsity, self._calc_slopes),
        )
        x = casadi.MX.sym("x", n)
        cost, gaps = (part(x) for part in self._parts)
        self._solver = casadi.nlpsol("ipopt", "ipopt", {"x": x, "f": cost, "g": gaps}, _OPTIONS)
        self._expand(np.zeros(n))  # What compiles does so before IPOPT's clock starts.

    @staticmethod
    def fits(problem: ShootingProblem) -> bool:
        """Returns whether there are no phases, no quaternions, and no norm of controls."""
        mechanism = problem.mechanism
        is_flat = mechanism.num_positions == mechanism.num_velocities
        return problem.phases is None and is_flat and not np.isfinite(problem.control_norm)

    def solve(self, states: np.ndarray, controls: np.ndarray) -> tuple[float, Control]:
        """Returns J and the held control; infinite if IPOPT fails at a smoothing.

        Args:
            states: q and v of the guess at the knots (N + 1, 2n).
            controls: of the guess (N, nu).
        """
        x, promised = np.concatenate([states[1:].ravel(), controls.ravel()]), np.inf
        for rung in _LADDER.rungs:
            self._smoothing, self._at[:] = rung.smoothing * self._problem.length, np.nan
            answer = self._solver(x0=np.nan_to_num(x), lbg=0, ubg=0, **self._bounds)
            x = np.array(answer["x"]).ravel()
            is_solved = self._solver.stats()["success"]
            promised = float(answer["f"]) if is_solved else np.inf
            if not is_solved:
                break
        return promised, Control(self._problem.times, x[-controls.size :].reshape(controls.shape))

    def _expand(self, x: np.ndarray) -> None:
        """Computes cost, rows and derivatives, once at each point."""
        if np.array_equal(x, self._at):
            return
        K, nz, nu = self._shape
        states = np.vstack([self._problem.start, x[: K * nz].reshape(K, nz)])
        controls = x[K * nz :].reshape(K, nu).copy()
        self._cost = expand_motion(self._tables, states, controls, self._smoothing, self._memory)
        self._at = x.copy()

    def _calc_cost(self, x: np.ndarray) -> Any:
        self._expand(x)
        return self._cost

    def _calc_slope(self, x: np.ndarray) -> Any:
        self._expand(x)
        l1, nz = self._memory.expansion.l1, self._shape[1]
        return np.concatenate([l1[1:, :nz].ravel(), l1[:-1, nz:].ravel()])[np.newaxis]

    def _calc_rows(self, x: np.ndarray) -> Any:
        self._expand(x)
        return self._memory.expansion.gaps.ravel()

    def _calc_slopes(self, x: np.ndarray) -> Any:
        self._expand(x)
        slopes = self._memory.expansion.F.ravel()[self._kept]
        own = -np.ones(self._shape[0] * self._shape[1])
        return np.concatenate([slopes, own])[self._order]


class _Part(_Base):
    """A function of x that CasADi asks for, with its Jacobian of known sparsity."""

    def __init__(
        self,
        name: str,
        sizes: tuple[int, int],
        calc: Any,
        sparsity: Any = None,
        calc_slopes: Any = None,
        is_slope: bool = False,
    ) -> None:
        super().__init__()
        self._sizes, self._calc, self._is_slope = sizes, calc, is_slope
        self._sparsity, self._calc_slopes = sparsity, calc_slopes
        self._slope: _Part | None = None  # Kept, as CasADi does not.
        self.construct(name, {})

    def get_n_in(self) -> int:
        return 1 + self._is_slope

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> Any:
        return casadi.Sparsity.dense(self._sizes[i], 1)

    def get_sparsity_out(self, _: int) -> Any:
        return self._sparsity if self._is_slope else casadi.Sparsity.dense(self._sizes[1], 1)

    def eval(self, arguments: Any) -> list[Any]:
        found = self._calc(np.array(arguments[0]).ravel())
        return [casadi.DM(self._sparsity, found.ravel()) if self._is_slope else found]

    def has_jacobian(self) -> bool:
        return not self._is_slope

    def get_jacobian(self, name: str, *_: Any) -> Any:
        self._slope = _Part(name, self._sizes, self._calc_slopes, self._sparsity, is_slope=True)
        return self._slope
