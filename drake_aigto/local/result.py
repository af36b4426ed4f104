"""What a local solve gives back."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import NamedTuple

from drake_aigto.arrays import Floats
from drake_aigto.linear import Storage


class LocalStatus(enum.Enum):
    """Why a local solve ended, and what to do about it.

    A point counts as within the tolerances too where only rounding of f or of the rows, relative to
    the terms that they are sums of, keeps it from them.
    """

    CONVERGED = "a stationary point within the tolerances"
    INFEASIBLE = "the rows can't be met near here: start elsewhere, or look for a contradiction"
    ITERATION_LIMIT = "the iterations ran out: allow more, or start closer"
    STALLED = "no step improves any more: loosen the tolerances, or scale the problem better"
    UNBOUNDED = "the unknowns grow without limit: bound the variables, or check the cost's sign"
    NOT_FINITE = "the start has no finite value: start where every term has one"


class LocalIterate(NamedTuple):
    """An iterate, and the step that led to it.

    Attributes:
        cost: f.
        residual: Largest scaled residual of a row.
        optimality: Scaled optimality error, see `LocalResult`.
        barrier: μ.
        shift: What was added to the Hessian's diagonal; 0 where it was convex enough.
        step: Length of the step, in (0, 1]; 0 at the start and after a restoration.
    """

    cost: float
    residual: float
    optimality: float
    barrier: float
    shift: float
    step: float


@dataclass(frozen=True, eq=False)
class LocalResult:
    """Where a local solve ended.

    Attributes:
        x: The point (n,), within its bounds; read-only.
        cost: f(x).
        status: Why it ended.
        iterations: Newton steps, those of the feasibility restoration included.
        residual: max |c_i(x)|.
        optimality: max-norm of the scaled optimality conditions that ended the solve: stationarity
            and complementarity (Wächter & Biegler 2006, eq. (5), without the rows).
        multipliers: λ of the rows (m,), with ∇f + Aᵀλ − z_lower + z_upper = 0; read-only.
        lower_multipliers: z_lower ≥ 0 of the lower bounds (n,), 0 where there is none, and where
            equal bounds hold a variable; read-only.
        upper_multipliers: z_upper ≥ 0 of the upper bounds (n,); read-only.
        storage: How KKT matrices were ordered, stored and factorized, and why.
        history: Every iterate, the start first.
    """

    x: Floats
    cost: float
    status: LocalStatus
    iterations: int
    residual: float
    optimality: float
    multipliers: Floats
    lower_multipliers: Floats
    upper_multipliers: Floats
    storage: Storage = field(repr=False)
    history: tuple[LocalIterate, ...] = ()

    def __post_init__(self) -> None:
        """Locks the arrays."""
        for array in (self.x, self.multipliers, self.lower_multipliers, self.upper_multipliers):
            array.setflags(write=False)

    @property
    def is_success(self) -> bool:
        """Whether the solve converged."""
        return self.status is LocalStatus.CONVERGED
