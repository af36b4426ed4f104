"""Annealing within the first box, at temperatures that are relative to the cost there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drake_aigto.aigo.algorithm import Box, Iterate, as_positive
from drake_aigto.aigo.annealing import SmoothedObjective
from drake_aigto.aigo.newton import HeldUnknowns, newton
from drake_aigto.box import BoxPolynomial, NewtonSystem
from drake_aigto.errors import OptionsError

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class BoundedAnnealing:
    """Annealing for any cost: nothing of its scale has to be known, and no box leaves the first.

        minimise over (c, z = log w)   f̄(c, e^z) − μ Σ_i z_i
        subject to   |c_i − c_i⁰| ≤ w_i⁰,   w_i ≤ w_i⁰

    As `Annealing`, with μ in units of the mean |w_i ∂f̄/∂w_i| of the first box. A variable that f
    hardly depends on keeps its width, which μ alone would widen for ever.

    Attributes:
        initial_temperature: first μ > 0, in units of the first box's mean slope.
        final_temperature: the run has converged below this μ, in the same units.
        cooling: factor on μ after each outer step, in (0, 1).
        tolerance: of the inner minimisation, see `Annealing`.
        max_newton_steps: the most Newton steps at one temperature.
    """

    initial_temperature: float = 1e-3
    final_temperature: float = 1e-8
    cooling: float = 0.5
    tolerance: float = 1e-2
    max_newton_steps: int = 20

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
        """Returns the first box; the memory is it, the unit of μ, and Newton's damping."""
        mean, _, slopes = f.gradient(box.center, box.half_width)
        unit = float(np.mean(np.abs(slopes[box.free]))) if np.any(box.free) else 0.0
        # Where no mean changes with a width, any unit does.
        unit = unit if unit > 0.0 else 1.0
        return Iterate(box, mean, self.initial_temperature * unit, memory=(box, unit, 1e-2))

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Minimises at the temperature, then lowers it."""
        first, unit, damping = iterate.memory
        mu = iterate.temperature
        objective = BoundedSmoothedObjective(f, first, mu, self.tolerance)
        y = objective.unknowns(iterate.box)
        result = newton(objective, y, self.max_newton_steps, damping)
        box = objective.box(result.y)
        return Iterate(
            box,
            f.mean(box.center, box.half_width),
            mu * self.cooling,
            result.steps,
            result.residual,
            (first, unit, result.damping),
        )

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether the temperature has passed the final one."""
        _, unit, _ = iterate.memory
        return iterate.temperature < self.final_temperature * unit


class BoundedSmoothedObjective(SmoothedObjective):
    """`SmoothedObjective` whose steps are cut off at bounds, which hold what pushes out of them."""

    def __init__(self, f: BoxPolynomial, first: Box, temperature: float, tolerance: float) -> None:
        """Prepares for one temperature."""
        super().__init__(f, first.free, temperature, tolerance)
        center, half_width = first.center[f.order], first.half_width[f.order]
        self._lower, self._upper = np.full((2, 2 * f.num_variables), [[-np.inf], [np.inf]])
        self._lower[0::2], self._upper[0::2] = center - half_width, center + half_width
        self._upper[1::2] = self.unknowns(first)[1::2]
        self._is_held = self._now_held = np.repeat(~first.free[f.order], 2)

    def move(self, y: Floats, step: Floats) -> tuple[Floats, Floats]:
        """Returns the nearest y within bounds to where the step leads."""
        moved = np.where(self._is_held, y, np.clip(y + step, self._lower, self._upper))
        taken = np.zeros_like(step)
        np.subtract(moved, y, out=taken, where=~self._is_held)  # a held z is −∞
        return moved, taken

    def evaluate(self, y: Floats) -> NewtonSystem:
        """Returns the objective and its derivatives; 0 where a bound holds an unknown."""
        value, gradient, band = self._parts(y)
        held = (y <= self._lower) & (gradient > 0)
        held |= (y >= self._upper) & (gradient < 0)
        held |= self._is_held
        if not np.array_equal(held, self._now_held):
            self._now_held = held
            self._held = HeldUnknowns(np.flatnonzero(held), 2 * self._f.bandwidth + 1)
        self._held.remove(gradient, band)
        return NewtonSystem(value, gradient, band)
