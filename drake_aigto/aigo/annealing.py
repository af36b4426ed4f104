"""Annealing: AIGO with the box's size set by a temperature, solved by a banded Newton method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_aigto.aigo.algorithm import Box, Iterate, as_positive
from drake_aigto.aigo.newton import HeldUnknowns, Objective, newton
from drake_aigto.box import BoxPolynomial, NewtonSystem
from drake_aigto.errors import OptionsError

Floats = NDArray[np.float64]

_LARGEST_LOG_STEP = 1.0  # A half width changes by no more than a factor e in one Newton step.


@dataclass(frozen=True, kw_only=True)
class Annealing:
    """Lowers a temperature μ, and at each keeps the box stationary.

        minimise over (c, z = log w)   f̄(c, e^z) − μ Σ_i z_i

    This is Algorithm 1 of AIGTO with ζ → ∞: the box of least mean among those of its size, μ being
    the multiplier of log S(w) = log s. Lowering μ shrinks s, and unlike the penalty on S it keeps
    the problem's sparsity, so that Newton's method costs a banded Cholesky a step.

    Attributes:
        initial_temperature: first μ > 0, in units of the cost.
        final_temperature: the run has converged below this μ.
        cooling: factor on μ after each outer step, in (0, 1).
        tolerance: the inner minimisation ends at √(mean of g_i²/(μ D_i)) ≤ tolerance, where μD = μ
            diag(3/w², 2) is the Hessian of a separable cost's stationary box.
        max_newton_steps: the most Newton steps at one temperature.
    """

    initial_temperature: float = 1e-3
    final_temperature: float = 1e-10
    cooling: float = 0.5
    tolerance: float = 1e-2
    max_newton_steps: int = 60

    def __post_init__(self) -> None:
        """Checks the ranges."""
        as_positive("initial_temperature", self.initial_temperature)
        as_positive("final_temperature", self.final_temperature)
        as_positive("cooling", self.cooling, below=1.0)
        as_positive("tolerance", self.tolerance)
        if self.max_newton_steps < 1:
            raise OptionsError("max_newton_steps", got=self.max_newton_steps, expected="1 or more")

    @property
    def max_steps(self) -> int:
        """The number of temperatures."""
        ratio = np.log(self.final_temperature / self.initial_temperature) / np.log(self.cooling)
        return max(0, int(np.ceil(ratio - 1e-9))) + 1

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box."""
        mean = f.mean(box.center, box.half_width)
        return Iterate(box, mean, self.initial_temperature, memory=1e-2)

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Minimises at the temperature, then lowers it; the memory is Newton's damping."""
        objective = SmoothedObjective(f, iterate.box.free, iterate.temperature, self.tolerance)
        return self._cool(f, iterate, objective, iterate.memory)

    def _cool(
        self, f: BoxPolynomial, iterate: Iterate, objective: SmoothedObjective, damping: float
    ) -> Iterate:
        """Returns the objective's minimiser at the next temperature; its memory is the damping."""
        y = objective.unknowns(iterate.box)
        result = newton(objective, y, self.max_newton_steps, damping)
        box = objective.box(result.y)
        return Iterate(
            box,
            f.mean(box.center, box.half_width),
            iterate.temperature * self.cooling,
            result.steps,
            result.residual,
            result.damping,
        )

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether the temperature has passed the final one."""
        return iterate.temperature < self.final_temperature


class SmoothedObjective(Objective):
    """f̄(c, e^z) − μ Σ z over y = (c_i, z_i) side by side in elimination order.

    Args:
        f: the cost.
        free: which variables are not held.
        temperature: μ.
        tolerance: stationary at √(mean g²/(μD)) ≤ tolerance.
        first: a box whose c ± w are bounds of c, and w those of the half width, if given.
    """

    def __init__(
        self,
        f: BoxPolynomial,
        free: NDArray[np.bool_],
        temperature: float,
        tolerance: float,
        first: Box | None = None,
    ) -> None:
        """Prepares for one temperature."""
        self._f, self._mu = f, temperature
        self._free = free[f.order]
        bounds = None if first is None else self._bounds(first)
        self._held = HeldUnknowns(np.repeat(~self._free, 2), 2 * f.bandwidth + 1, bounds)
        self.largest_residual = tolerance * np.sqrt(2 * np.count_nonzero(free) * temperature)

    def _bounds(self, first: Box) -> tuple[Floats, Floats]:
        """Returns lower and upper bounds of y."""
        lower, upper = np.full((2, 2 * self._f.num_variables), [[-np.inf], [np.inf]])
        center, half_width = first.center[self._f.order], first.half_width[self._f.order]
        lower[0::2], upper[0::2] = center - half_width, center + half_width
        upper[1::2] = self.unknowns(first)[1::2]
        return lower, upper

    def move(self, y: Floats, step: Floats) -> tuple[Floats, Floats]:
        """Returns the nearest y within bounds to where the step leads."""
        return self._held.move(y, step)

    def unknowns(self, box: Box) -> Floats:
        """Returns y of a box; z = −∞ where a variable is held."""
        y = np.empty(2 * self._f.num_variables)
        y[0::2] = box.center[self._f.order]
        with np.errstate(divide="ignore"):
            y[1::2] = np.log(box.half_width[self._f.order])
        return y

    def box(self, y: Floats) -> Box:
        """Returns the box of y."""
        center, log_half_width = self._f.to_variables(y)
        return Box(center, np.exp(log_half_width))

    def evaluate(self, y: Floats) -> NewtonSystem:
        """Returns the objective and its derivatives."""
        center, log_half_width = self._f.to_variables(y)
        system = self._f.newton_system(center, np.exp(log_half_width))
        system.gradient[1::2] -= self._mu
        self._held.remove(y, system.gradient, system.band)
        entropy = float(np.sum(y[1::2][self._free]))
        return NewtonSystem(system.value - self._mu * entropy, system.gradient, system.band)

    def scale(self, y: Floats, system: NewtonSystem) -> Floats:
        """Returns μ (3/w², 2), a separable cost's Hessian where w ∂f̄/∂w = μ; 1 where held."""
        scale = np.ones_like(y)
        z = y[1::2][self._free]
        scale[0::2][self._free] = 3 * self._mu * np.exp(-2 * z)
        scale[1::2][self._free] = 2 * self._mu
        return scale

    def limit(self, step: Floats) -> float:
        """Returns the part of the step that changes no half width by more than a factor e."""
        largest = float(np.max(np.abs(step[1::2])))
        return min(1.0, _LARGEST_LOG_STEP / largest) if largest > 0 else 1.0
