"""Annealing: AIGO with the box's size set by a temperature, solved by a banded Newton method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto.aigo.algorithm import Box, Iterate, as_positive
from drake_aigto.aigo.newton import SmoothedObjective, newton
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import OptionsError


class AnnealingMemory(NamedTuple):
    """What an annealing carries along.

    Attributes:
        temperature: μ that the box was made for.
        damping: Newton's, for the next steps.
        objective: of that temperature, to make the next one of.
    """

    temperature: float
    damping: float = 1e-2
    objective: SmoothedObjective | None = None


@dataclass(frozen=True, kw_only=True)
class Annealing:
    """Lowers a temperature μ, and at each keeps the box stationary.

        minimize over (c, z = log w)   f̄(c, e^z) − μ Σ_i z_i

    This is Algorithm 1 of AIGTO with ζ → ∞: the box of least mean among those of its size, μ being
    the multiplier of log S(w) = log s. Lowering μ shrinks s, and unlike the penalty on S it keeps
    the problem's sparsity, so that Newton's method costs a banded Cholesky a step.

    Attributes:
        initial_temperature: first μ > 0, in units of the cost.
        final_temperature: the run has converged below this μ.
        cooling: factor on μ after each outer step, in (0, 1).
        tolerance: the inner minimization ends at √(mean of g_i²/(μ D_i)) ≤ tolerance, where μD = μ
            diag(3/w², 2) is the Hessian of a separable cost's stationary box.
        max_newton_steps: the most Newton steps at one temperature.
        narrowing: half widths are multiplied by this power of the ratio before Newton's steps at a
            lower temperature: 1/2 is how those of a quadratic's stationary box follow μ.
    """

    initial_temperature: float = 1e-3
    final_temperature: float = 1e-10
    cooling: float = 0.5
    tolerance: float = 1e-2
    max_newton_steps: int = 60
    narrowing: float = 0.0

    def __post_init__(self) -> None:
        """Checks the ranges."""
        as_positive("initial_temperature", self.initial_temperature)
        as_positive("final_temperature", self.final_temperature)
        as_positive("cooling", self.cooling, below=1.0)
        as_positive("tolerance", self.tolerance)
        if self.max_newton_steps < 1:
            raise OptionsError("max_newton_steps", got=self.max_newton_steps, expected="1 or more")
        if not 0 <= self.narrowing < np.inf:
            raise OptionsError("narrowing", got=self.narrowing, expected="a number, 0 or more")

    @property
    def max_steps(self) -> int:
        """One more than there are temperatures, as `minimize` asks before a step whether to end."""
        ratio = np.log(self.final_temperature / self.initial_temperature) / np.log(self.cooling)
        return max(0, int(np.ceil(ratio - 1e-9))) + 2

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box."""
        mean = f.mean(box.center, box.half_width)
        start = self.initial_temperature
        return Iterate(box, mean, start, memory=AnnealingMemory(start))

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Minimizes at the temperature, then lowers it."""
        known = iterate.memory.objective
        if known is None or known.f is not f:
            known = SmoothedObjective(f, iterate.box.free, iterate.temperature, self.tolerance)
        return self._cool(iterate, known.at(iterate.temperature), iterate.memory)

    def _cool(
        self, iterate: Iterate, objective: SmoothedObjective, memory: AnnealingMemory
    ) -> Iterate:
        """Returns the objective's minimizer at the next temperature."""
        y = objective.unknowns(iterate.box)
        if self.narrowing:
            y[1::2] += self.narrowing * np.log(iterate.temperature / memory.temperature)
        result = newton(objective, y, self.max_newton_steps, memory.damping)
        return Iterate(
            objective.box(result.y),
            result.mean,
            iterate.temperature * self.cooling,
            result.steps,
            result.residual,
            AnnealingMemory(iterate.temperature, result.damping, objective),
        )

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether the temperature has passed the final one."""
        return iterate.temperature < self.final_temperature
