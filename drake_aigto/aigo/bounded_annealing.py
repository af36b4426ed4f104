"""Annealing within the first box, at temperatures that are relative to the cost there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from drake_aigto.aigo.algorithm import Box, Iterate
from drake_aigto.aigo.annealing import Annealing, AnnealingMemory
from drake_aigto.aigo.newton import SmoothedObjective
from drake_aigto.box import BoxPolynomial


@dataclass(frozen=True, kw_only=True)
class BoundedAnnealing(Annealing):
    """Annealing for any cost: nothing of its scale has to be known, and no box leaves the first.

        minimize over (c, z = log w)   f̄(c, e^z) − μ Σ_i z_i
        subject to   |c_i − c_i⁰| ≤ w_i⁰,   w_i ≤ w_i⁰

    As `Annealing`, with μ in units of the mean |w_i ∂f̄/∂w_i| of the first box. A variable that f
    hardly depends on keeps its width, which μ alone would widen for ever.

    Attributes:
        initial_temperature: first μ > 0, in units of the first box's mean slope.
        final_temperature: the run has converged below this μ, in the same units.
        cooling: factor on μ after each outer step, in (0, 1).
        tolerance: of the inner minimization, see `Annealing`.
        max_newton_steps: the most Newton steps at one temperature.
    """

    initial_temperature: float = 1e-3
    final_temperature: float = 1e-8
    cooling: float = 0.5
    tolerance: float = 1e-2
    max_newton_steps: int = 20

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box; the memory is it, the unit of μ, and the annealing's."""
        mean, _, slopes = f.gradient(box.center, box.half_width)
        unit = float(np.mean(np.abs(slopes[box.free]))) if np.any(box.free) else 0.0
        # Where no mean changes with a width, any unit does.
        unit = unit if unit > 0.0 else 1.0
        start = self.initial_temperature * unit
        memory = AnnealingMemory(start)
        return Iterate(box, mean, start, memory=(box, unit, memory))

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Minimizes at the temperature, then lowers it."""
        first, unit, memory = iterate.memory
        objective = SmoothedObjective(f, first.free, iterate.temperature, self.tolerance, first)
        cooled = self._cool(iterate, objective, memory)
        return replace(cooled, memory=(first, unit, cooled.memory))

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether the temperature has passed the final one."""
        _, unit, _ = iterate.memory
        return iterate.temperature < self.final_temperature * unit
