"""The protocol of AIGO's algorithms, init, step and terminate, and the loop that drives them."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from drake_aigto.arrays import Bools, Floats, read_only
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import OptionsError
from drake_aigto.linear import Storage


@dataclass(frozen=True, eq=False)
class Box:
    """A(c, w) = {x : |x_i − c_i| ≤ w_i}; a variable with w_i = 0 is held at c_i.

    Attributes:
        center: c, shape (n,), read-only.
        half_width: w ≥ 0, shape (n,), read-only; a scalar is spread over all variables.
    """

    center: Floats
    half_width: Floats

    def __post_init__(self) -> None:
        """Checks and locks both arrays."""
        center, half_width = read_only(self.center), read_only(self.half_width)
        if half_width.shape != center.shape:
            half_width = read_only(np.broadcast_to(half_width, center.shape))
        if not (np.isfinite(center).all() and np.isfinite(half_width).all()):
            raise OptionsError(
                "box", got="NaN or infinity", expected="finite center and half width"
            )
        if half_width.min(initial=0.0) < 0:
            raise OptionsError(
                "half_width", got=f"{half_width.min():g}", expected="0 (held) or more everywhere"
            )
        object.__setattr__(self, "center", center)
        object.__setattr__(self, "half_width", half_width)

    @property
    def free(self) -> Bools:
        """Whether each variable is not held, shape (n,)."""
        return self.half_width > 0

    @property
    def log_size(self) -> float:
        """Σ log 2w_i = log S(w) over the free variables; S itself underflows for many of them."""
        return float(np.sum(np.log(2 * self.half_width[self.free])))

    @property
    def mean_half_width(self) -> float:
        """Geometric mean of the free variables' half widths; 0 if all are held."""
        free = self.half_width[self.free]
        return float(np.exp(np.mean(np.log(free)))) if free.size else 0.0


class Status(enum.Enum):
    """Why a run ended."""

    CONVERGED = "the boxes have shrunk as far as asked"
    STEP_LIMIT = "the number of outer steps ran out: allow more, or shrink faster"
    INTERRUPTED = "interrupted: the result is the best so far"
    NOT_FINITE = "the mean is not finite: the first box reaches where a term has no value"


@dataclass(frozen=True)
class Iterate:
    """State of an algorithm after an outer step.

    Attributes:
        box: the current box.
        mean: f̄ over it.
        temperature: μ that the box is stationary for, or will be asked to be.
        inner_steps: iterations of the inner minimization in this outer step.
        residual: scaled size of the gradient that the inner minimization left.
        memory: whatever the algorithm carries along.
    """

    box: Box
    mean: float
    temperature: float
    inner_steps: int = 0
    residual: float = float("inf")
    memory: Any = None

    @classmethod
    def of_gradient(
        cls, box: Box, means: tuple[float, Floats, Floats], inner_steps: int, memory: Any
    ) -> Iterate:
        """Returns where a method of gradients stands, given f̄, ∂f̄/∂c, ∂f̄/∂z: μ is ∂f̄/∂z's mean."""
        mean, by_center, by_log_width = means
        temperature = float(np.sum(by_log_width)) / max(1, int(np.count_nonzero(box.free)))
        residual = float(np.linalg.norm(by_center[box.free]))
        return cls(box, mean, temperature, inner_steps, residual, memory)


class Algorithm(Protocol):
    """One way to shrink boxes; a frozen dataclass of its settings."""

    @property
    def max_steps(self) -> int:
        """The most outer steps."""

    def init(self, f: BoxPolynomial, box: Box) -> Iterate:
        """Returns the iterate to start from."""

    def step(self, f: BoxPolynomial, iterate: Iterate) -> Iterate:
        """Returns the iterate after one outer step."""

    def terminate(self, f: BoxPolynomial, iterate: Iterate) -> bool:
        """Returns whether the boxes have shrunk as far as asked."""


@dataclass(frozen=True)
class AigoResult:
    """The end of a run.

    Attributes:
        status: why it ended.
        box: the last box; its center is the answer.
        cost: f(c).
        history: every iterate, the start first, for plots without a second run.
        storage: how Newton systems are ordered, stored and factorized, and why.
    """

    status: Status
    box: Box
    cost: float
    history: tuple[Iterate, ...] = field(repr=False)
    storage: Storage = field(repr=False)

    @property
    def is_converged(self) -> bool:
        """Whether the boxes shrank as far as asked."""
        return self.status is Status.CONVERGED

    @property
    def num_inner_steps(self) -> int:
        """Inner iterations in all."""
        return sum(iterate.inner_steps for iterate in self.history)


def minimize(
    f: BoxPolynomial,
    box: Box,
    algorithm: Algorithm,
    callback: Callable[[Iterate], None] | None = None,
) -> AigoResult:
    """Shrinks a box onto a low point of f.

    The same input gives the same bits. Ctrl-C ends the run and returns the best so far.

    Args:
        f: the cost.
        box: where to start; variables of half width 0 are held.
        algorithm: such as `Annealing()` or `FullGradient()`.
        callback: called with every iterate, the start included.

    Returns:
        The result; of the boxes, the last is the best, as each is smaller than the one before.
    """
    iterate = algorithm.init(f, box)
    history = [iterate]
    status = Status.STEP_LIMIT
    try:
        if callback:
            callback(iterate)
        for _ in range(algorithm.max_steps):
            if not np.isfinite(iterate.mean):
                status = Status.NOT_FINITE
                break
            if algorithm.terminate(f, iterate):
                status = Status.CONVERGED
                break
            iterate = algorithm.step(f, iterate)
            history.append(iterate)
            if callback:
                callback(iterate)
    except KeyboardInterrupt:
        status = Status.INTERRUPTED
    last = history[-1]
    return AigoResult(status, last.box, f(last.box.center), tuple(history), f.storage)
