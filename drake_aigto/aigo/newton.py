"""Newton's method on banded systems, damped until it descends."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs

from drake_aigto.box import BoxPolynomial, NewtonSystem

Floats = NDArray[np.float64]

_ARMIJO = 1e-4  # share of the linear decrease that a step must reach
_HARDER, _SOFTER = 4.0, 0.25  # factors on the damping after a failed and an immediate success
_LEAST_DAMPING, _FIRST_DAMPING = 1e-8, 1e-3
_MAX_TRIALS = 40  # of the damping, in one step: 4⁴⁰ is past any scale


class Objective(ABC):
    """A function of unknowns y (n,) in elimination order, held ones included.

    Attributes:
        largest_residual: y is stationary where √(Σ g²/D) is no more than this.
    """

    largest_residual: float

    @abstractmethod
    def evaluate(self, y: Floats) -> NewtonSystem:
        """Returns value, gradient, Hessian; held unknowns have gradient 0 and an identity row."""

    @abstractmethod
    def scale(self, y: Floats, system: NewtonSystem) -> Floats:
        """Returns the diagonal D > 0 (n,) that the damping λD is measured in."""

    def limit(self, step: Floats) -> float:
        """Returns the part of a step, in (0, 1], that may be taken."""
        return 1.0

    def move(self, y: Floats, step: Floats) -> tuple[Floats, Floats]:
        """Returns where a step leads, and the part of it that was taken."""
        return y + step, step


@dataclass(frozen=True)
class NewtonResult:
    """Where Newton's method ended.

    Attributes:
        y: the unknowns.
        value: the objective there.
        steps: iterations.
        residual: √(Σ g²/D) there.
        damping: λ to start the next, similar problem with.
    """

    y: Floats
    value: float
    steps: int
    residual: float
    damping: float


def newton(objective: Objective, y: Floats, max_steps: int, damping: float) -> NewtonResult:
    """Minimises by steps (H + λD) s = −g.

    λ is raised until H + λD is positive definite and s descends (Armijo), and lowered after a step
    that did so at once.
    """
    system = objective.evaluate(y)
    steps, residual = 0, np.inf
    for steps in range(max_steps + 1):
        scale = objective.scale(y, system)
        residual = _residual(system, scale)
        if steps == max_steps or residual <= objective.largest_residual:
            break
        accepted, damping = _descend(objective, y, system, scale, damping)
        if accepted is None:
            break  # Rounding hides any further descent.
        y, system = accepted
    return NewtonResult(y, system.value, steps, residual, damping)


def _residual(system: NewtonSystem, scale: Floats) -> float:
    """Returns √(Σ g²/D); infinity where that is too large for a number."""
    with np.errstate(over="ignore"):
        return float(np.sqrt(np.sum(system.gradient**2 / scale)))


def _descend(
    objective: Objective, y: Floats, system: NewtonSystem, scale: Floats, damping: float
) -> tuple[tuple[Floats, NewtonSystem] | None, float]:
    """Returns the next point and system, or None if no damping descends, and the next damping."""
    for trial in range(_MAX_TRIALS):
        accepted = _try_step(objective, y, system, scale, damping)
        if accepted is not None:
            softer = max(_SOFTER * damping, _LEAST_DAMPING) if trial == 0 else damping
            return accepted, softer
        damping = max(_HARDER * damping, _FIRST_DAMPING)
    return None, damping


def _try_step(
    objective: Objective, y: Floats, system: NewtonSystem, scale: Floats, damping: float
) -> tuple[Floats, NewtonSystem] | None:
    """Returns the point and system after a damped step, or None if it does not descend."""
    band = system.band.copy(order="F")  # LAPACK would copy once more
    band[0] += damping * scale
    factor, info = dpbtrf(band, lower=1)
    if info != 0:
        return None
    step = dpbtrs(factor, -system.gradient, lower=1)[0]
    step *= objective.limit(step)
    moved, step = objective.move(y, step)
    tried = objective.evaluate(moved)
    if not tried.value <= system.value + _ARMIJO * float(system.gradient @ step):
        return None
    return moved, tried


class HeldUnknowns:
    """Unknowns that a banded system leaves out: their rows and columns become the identity's.

    These are the ones that are held for good and, within bounds, those at a bound which the
    gradient pushes out of it.

    Args:
        is_held: for good, in elimination order.
        bandwidth: of the system.
        bounds: lower and upper bounds in elimination order, if there are any.
    """

    def __init__(
        self,
        is_held: NDArray[np.bool_],
        bandwidth: int,
        bounds: tuple[Floats, Floats] | None = None,
    ) -> None:
        """Finds the band entries of those that are held for good."""
        self._always, self._bandwidth, self._bounds = is_held, bandwidth, bounds
        self._find(is_held)

    def _find(self, is_held: NDArray[np.bool_]) -> None:
        """Finds the band entries of these rows and columns."""
        self._now = is_held
        self._indices = np.flatnonzero(is_held)
        offsets = np.arange(1, self._bandwidth + 1)
        rows, columns = np.meshgrid(offsets, self._indices, indexing="ij")
        before = columns - rows
        inside = before >= 0
        self._row_entries = rows[inside], before[inside]

    def remove(self, y: Floats, gradient: Floats, band: Floats) -> None:
        """Changes gradient and band at y in place."""
        if self._bounds is not None:
            lower, upper = self._bounds
            held = (y <= lower) & (gradient > 0)
            held |= (y >= upper) & (gradient < 0)
            held |= self._always
            if not np.array_equal(held, self._now):
                self._find(held)
        gradient[self._indices] = 0.0
        band[:, self._indices] = 0.0
        band[self._row_entries] = 0.0
        band[0, self._indices] = 1.0

    def move(self, y: Floats, step: Floats) -> tuple[Floats, Floats]:
        """Returns the nearest point within bounds to where a step leads, and the part taken."""
        if self._bounds is None:
            return y + step, step
        moved = np.where(self._always, y, np.clip(y + step, *self._bounds))
        taken = np.zeros_like(step)
        np.subtract(moved, y, out=taken, where=~self._always)  # what is held may be −∞
        return moved, taken


class PointObjective(Objective):
    """f(c) itself: every box has shrunk to its center.

    Args:
        f: the cost.
        free: which variables are not held.
        tolerance: stationary once √(gᵀ diag(H)⁻¹ g) is no more than this.
        bounds: lower and upper bounds (n,) of the variables, where steps are cut off.
    """

    def __init__(
        self,
        f: BoxPolynomial,
        free: NDArray[np.bool_],
        tolerance: float,
        bounds: tuple[Floats, Floats] | None = None,
    ) -> None:
        """Brings all in elimination order."""
        self._f = f
        within = None if bounds is None else (bounds[0][f.order], bounds[1][f.order])
        self._held = HeldUnknowns(~free[f.order], f.bandwidth, within)
        self.largest_residual = tolerance

    def move(self, y: Floats, step: Floats) -> tuple[Floats, Floats]:
        """Returns the point within bounds that is nearest to where the step leads."""
        return self._held.move(y, step)

    def evaluate(self, y: Floats) -> NewtonSystem:
        """Returns f and its derivatives."""
        f = self._f
        (center,) = f.to_variables(y)
        system = f.newton_system(center, 0.0, centers_only=True)
        self._held.remove(y, system.gradient, system.band)
        return system

    def scale(self, y: Floats, system: NewtonSystem) -> Floats:
        """Returns |diag H|, kept off zero."""
        diagonal = np.abs(system.band[0])
        return diagonal + 1e-12 * diagonal.max(initial=0.0) + np.finfo(float).tiny


def bold_newton(objective: Objective, y: Floats, max_steps: int) -> tuple[Floats, int]:
    """Takes Newton steps of many problems at once, that are not coupled, without looking back.

    Where the Hessian is not positive definite, its diagonal is raised until it dominates. No step
    is damped, as damping would bind the problems together: the caller judges each problem's end.

    Returns:
        The end and the number of steps.
    """
    for steps in range(max_steps):
        system = objective.evaluate(y)
        residual = _residual(system, objective.scale(y, system))
        if not residual > objective.largest_residual:
            return y, steps
        factor, info = dpbtrf(system.band, lower=1)
        if info != 0:
            factor, info = dpbtrf(_dominated_by_diagonal(system.band), lower=1)
        if info != 0:
            return y, steps  # The gradient is flat, or not finite.
        y, _ = objective.move(y, dpbtrs(factor, -system.gradient, lower=1)[0])
    return y, max_steps


def _dominated_by_diagonal(band: Floats) -> Floats:
    """Returns the band with H_ii raised to 1.1 Σ_j≠i |H_ij|, or to |H_ii| if that is more."""
    beside = np.zeros(band.shape[1])
    for d, diagonal in enumerate(np.abs(band[1:]), start=1):
        beside[: beside.size - d] += diagonal[: beside.size - d]
        beside[d:] += diagonal[: beside.size - d]
    raised = band.copy()
    raised[0] = np.maximum(np.abs(band[0]), 1.1 * beside)
    return raised
