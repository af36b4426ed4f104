"""Annealing: AIGO with the box's size set by a temperature, solved by Newton's method."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.aigo.algorithm import Box, Iterate
from drake_aigto.aigo.descent import NewtonProblem, descend, descend_boldly
from drake_aigto.arrays import Bools, Floats
from drake_aigto.box import BoxPolynomial, Order
from drake_aigto.errors import OptionsError, check_counts, check_positive

_NO_BOUNDS = np.empty(0), np.empty(0)

# Of `raise_penalties`: a penalty W r² leaves a residual of (multiplier)/(2W), so that weights
# raised by R shrink it by 1/R, here to 1e-5 in all.
_RAISES, _RAISE = 5, 10.0
_RAISED_STEPS, _RAISED_TOLERANCE = 10, 1e-10


def make_newton_problem(
    f: BoxPolynomial,
    order: Order,
    free: Bools,
    half_width: ArrayLike = 0.0,
    bounds: tuple[Floats, Floats] = _NO_BOUNDS,
) -> NewtonProblem:
    """Returns the arrays of the hot loop, as `NewtonProblem` has them; μ is 0."""
    places = order.num_unknowns * f.position
    return NewtonProblem(
        *(f.lanes(order), f.copy_weights, np.ones_like(f.copy_weights)),
        *(np.full(f.copy_weights.size, -1), np.empty_like(f.copy_weights)),
        *(places, np.where(free, places, -1)),
        np.array(np.broadcast_to(half_width, free.shape), dtype=float),
        *bounds,
        temperature=0.0,
        shape=f.hessian_shape(order),
        pattern=f.pattern(order),
    )


class NewtonResult(NamedTuple):
    """The end of Newton's method."""

    x: Floats  # the centers, shape (n,)
    value: float  # f̄ there
    steps: int  # iterations
    residual: float  # √(gᵀ diag(H)⁻¹ g) there
    damping: float  # λ to start the next, similar problem with


class CenterObjective:
    """f̄(c, w) over centers c of boxes of given widths; by default f(c): every box is its center.

    Args:
        f: the cost.
        free: which variables are not held, shape (n,).
        tolerance: stationary once √(gᵀ diag(H)⁻¹ g) is no more than this.
        bounds: lower and upper bounds (n,) of the variables, where steps are cut off.
        half_width: w, shape (n,), or a scalar for all.
    """

    def __init__(
        self,
        f: BoxPolynomial,
        free: Bools,
        tolerance: float,
        bounds: tuple[Floats, Floats] | None = None,
        half_width: ArrayLike = 0.0,
    ) -> None:
        """Puts variables in elimination order."""
        within = _NO_BOUNDS if bounds is None else (bounds[0][f.order], bounds[1][f.order])
        self._f, self._tolerance = f, tolerance
        self._problem = make_newton_problem(f, Order.CENTERS, free, half_width, within)

    def descend(self, x: Floats, max_steps: int, damping: float = 0.0) -> NewtonResult:
        """Minimizes from x (n,) by damped steps, see `descent.descend`."""
        y = np.array(x[self._f.order], dtype=float)
        value, _, steps, residual, damping = descend(
            self._problem, y, self._tolerance, max_steps, damping
        )
        (x,) = self._f.to_variables(y)
        return NewtonResult(x, value, steps, residual, damping)

    def descend_boldly(self, x: Floats, max_steps: int) -> tuple[Floats, int]:
        """Takes undamped steps, see `descent.descend_boldly`; returns the end and their number."""
        y = np.array(x[self._f.order], dtype=float)
        steps = descend_boldly(self._problem, y, self._tolerance, max_steps)
        (x,) = self._f.to_variables(y)
        return x, steps


def raise_penalties(f: BoxPolynomial, penalties: Collection[str], x: Floats, free: Bools) -> Floats:
    """Returns the minimizer of f with penalties raised in steps until constraints hold, nearly.

    Args:
        f: the penalized cost.
        penalties: names of the blocks that are penalties.
        x: where to start, shape (n,).
        free: which variables may move, shape (n,).
    """
    weights, damping = {name: f.weights[name] for name in penalties}, 0.0
    for k in range(1, _RAISES + 1):
        raised = f.with_weights({name: w * _RAISE**k for name, w in weights.items()})
        objective = CenterObjective(raised, free, _RAISED_TOLERANCE)
        x, _, _, _, damping = objective.descend(x, _RAISED_STEPS, damping)
    return x


class AnnealingMemory(NamedTuple):
    """State of an annealing between two steps."""

    problem: NewtonProblem  # of Newton's method; the boxes of all temperatures share it
    unit: float  # of temperatures, in units of the cost
    temperature: float  # μ that the box was made for
    damping: float = 1e-2  # Newton's, for the next steps


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

    _is_bounded: ClassVar[bool] = False  # Whether boxes stay within the first one.

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_positive(self, "initial_temperature", "final_temperature", "tolerance")
        check_positive(self, "cooling", below=1.0)
        check_counts(self, max_newton_steps=1)
        if not 0 <= self.narrowing < np.inf:
            raise OptionsError("narrowing", got=self.narrowing, expected="a number, 0 or more")

    @property
    def max_steps(self) -> int:
        """One more than temperatures, as `minimize` checks its end before each step."""
        ratio = np.log(self.final_temperature / self.initial_temperature) / np.log(self.cooling)
        return max(0, int(np.ceil(ratio - 1e-9))) + 2

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box."""
        return self._start(f, box, f.mean(box.center, box.half_width), 1.0)

    def _start(self, f: BoxPolynomial, box: Box, mean: float, unit: float) -> Iterate:
        bounds, start = (np.empty(0), np.empty(0)), self.initial_temperature * unit
        if self._is_bounded:
            lower, upper = bounds = _unknowns(f, box), _unknowns(f, box)
            lower[0::2] -= box.half_width[f.order]
            upper[0::2] += box.half_width[f.order]
            lower[1::2] = -np.inf
        problem = make_newton_problem(f, Order.BOXES, box.free, 0.0, bounds)
        return Iterate(box, mean, start, memory=AnnealingMemory(problem, unit, start))

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Minimizes at the temperature over (c_i, z_i), then lowers it."""
        memory, temperature = iterate.memory, iterate.temperature
        y, problem = _unknowns(f, iterate.box), memory.problem._replace(temperature=temperature)
        if self.narrowing:
            y[1::2] += self.narrowing * np.log(temperature / memory.temperature)
        num_free = np.count_nonzero(problem.free_places >= 0)
        limit = self.tolerance * math.sqrt(2 * num_free * temperature)
        _, mean, steps, residual, damping = descend(
            problem, y, limit, self.max_newton_steps, memory.damping
        )
        center, log_half_width = f.to_variables(y)
        return Iterate(
            *(Box(center, np.exp(log_half_width)), mean, temperature * self.cooling),
            *(steps, residual, memory._replace(temperature=temperature, damping=damping)),
        )

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether the temperature has passed the final one."""
        return iterate.temperature < self.final_temperature * iterate.memory.unit


@dataclass(frozen=True, kw_only=True)
class BoundedAnnealing(Annealing):
    """Annealing for any cost: nothing of its scale has to be known, and no box leaves the first.

        minimize over (c, z = log w)   f̄(c, e^z) − μ Σ_i z_i
        subject to   |c_i − c_i⁰| ≤ w_i⁰,   w_i ≤ w_i⁰

    As `Annealing`, with both temperatures in units of the mean |w_i ∂f̄/∂w_i| of the first box. A
    variable that f hardly depends on keeps its width, which μ alone would widen for ever.
    """

    final_temperature: float = 1e-8
    max_newton_steps: int = 20

    _is_bounded: ClassVar[bool] = True

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box."""
        mean, _, slopes = f.gradient(box.center, box.half_width)
        unit = float(np.mean(np.abs(slopes[box.free]))) if np.any(box.free) else 0.0
        # Where no mean changes with a width, any unit does.
        return self._start(f, box, mean, unit if unit > 0.0 else 1.0)


def _unknowns(f: BoxPolynomial, box: Box) -> Floats:
    """Returns (c_i, z_i) of a box in elimination order (2n,); z = −∞ where a variable is held."""
    y = np.empty(2 * f.num_variables)
    y[0::2] = box.center[f.order]
    with np.errstate(divide="ignore"):
        y[1::2] = np.log(box.half_width[f.order])
    return y


@dataclass(frozen=True)
class SlowMotion:
    """Annealing's boxes, Newton step by Newton step.

    An outer step is one Newton step, and keeps the temperature; or none, where the box is
    stationary or has had its most steps, and lowers it.

    Attributes:
        annealing: the algorithm to watch.
    """

    annealing: Annealing

    @property
    def max_steps(self) -> int:
        """As many as the annealing may take at all its temperatures."""
        return self.annealing.max_steps * (self.annealing.max_newton_steps + 1)

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the first box; the memory is the annealing's, and steps at the temperature."""
        return _with_memory(self.annealing.init(f, box), 0)

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Takes one Newton step, or goes on to the next temperature."""
        memory, taken = iterate.memory
        if taken == self.annealing.max_newton_steps:
            cooled = iterate.temperature * self.annealing.cooling
            return replace(iterate, temperature=cooled, inner_steps=0, memory=(memory, 0))
        one = replace(self.annealing, max_newton_steps=1)
        after = one.step(f, replace(iterate, memory=memory))
        if after.inner_steps == 0:
            return _with_memory(after, 0)
        after = replace(after, temperature=iterate.temperature)
        return _with_memory(after, taken + 1)

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether the annealing has ended."""
        memory, _ = iterate.memory
        return self.annealing.terminate(f, replace(iterate, memory=memory))


def _with_memory(iterate: Iterate, taken: int) -> Iterate:
    return replace(iterate, memory=(iterate.memory, taken))
