"""What `AigoSolver` gives back, as a MathematicalProgramResult."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydrake.solvers import (
    ClpSolver,
    MathematicalProgram,
    MathematicalProgramResult,
    SolutionResult,
    SolverId,
)

from drake_aigto.arrays import Floats
from drake_aigto.certify import Certificate, relative_gap
from drake_aigto.linear import Storage

# Drake compares ids by identity.
SOLVER_ID = SolverId("AIGO")


class AigoStatus(enum.Enum):
    """Why a solve ended, and what to make of it."""

    SOLVED = "the best feasible point of all boxes and ladders"
    SOLVED_IN_PART = (
        "the best feasible point of the part that was searched, as some variables have no bounds: "
        "the details say which part; bound the variables to have all of it searched"
    )
    PROVEN = "no feasible point costs less, by 1e-6 of the cost or its scale: it is proven"
    NO_FEASIBLE_POINT = (
        "no box or ladder led to a feasible point, which is no proof that there is none: allow "
        "more of them, give a guess, or bound the variables"
    )
    INFEASIBLE = "the rows leave no feasible point within the bounds, by interval arithmetic"
    CONTRADICTORY_BOUNDS = "bounds or constants contradict each other: there is no feasible point"
    FALLS_WITHOUT_END = (
        "the cost seems to fall without end, which is no proof: bound the variables, or check its "
        "sign"
    )
    NOT_FINITE = "the cost is not finite in any box: bound the variables to where it is"
    INTERRUPTED = "interrupted: the answer is the best so far"


_DRAKE_STATUS = {
    AigoStatus.SOLVED: SolutionResult.kSolutionFound,
    AigoStatus.SOLVED_IN_PART: SolutionResult.kSolutionFound,
    AigoStatus.PROVEN: SolutionResult.kSolutionFound,
    AigoStatus.NO_FEASIBLE_POINT: SolutionResult.kIterationLimit,
    AigoStatus.INFEASIBLE: SolutionResult.kInfeasibleConstraints,
    AigoStatus.CONTRADICTORY_BOUNDS: SolutionResult.kInfeasibleConstraints,
    AigoStatus.FALLS_WITHOUT_END: SolutionResult.kUnbounded,
    AigoStatus.NOT_FINITE: SolutionResult.kSolverSpecificError,
    AigoStatus.INTERRUPTED: SolutionResult.kIterationLimit,
}


@dataclass(frozen=True, eq=False)
class AigoDetails:
    """What `MathematicalProgramResult.get_solver_details` returns.

    Attributes:
        status: why the solve ended.
        violation: the largest violation of a constraint at the answer, relative to the row's
            largest coefficient, or largest term within the bounds, where that is below 1, and
            beyond what rounding of the variables alone may make of it.
        boxes: how many boxes were shrunk.
        iterations: inner iterations of AIGO, all boxes.
        polishes: how many points were polished.
        origin: which algorithm, from which box, led to the answer.
        substituted: numbers of the variables that presolve left out, in the order of doing so.
        lifted: functions without a mean, for which variables with rows stood.
        complementarities: how many rows were read as λ s = 0, or λ s ≤ ε, of λ, s ≥ 0, and relaxed.
        ladders: how many ladders of penalties or of interior points were begun: 0 unless there are
            complementarities, or the program is a long chain of stages.
        repeats: how many of the ladders ended at the answer's cost, to 1e-3 of it: where it is 1,
            others found nothing as good, and a longer search may find better.
        cost: of the answer.
        first_center: of the first box, shape (n,); of what was left out, its value there.
        first_half_width: of the first box, shape (n,); NaN of what was left out.
        searched: lower and upper bounds, shape (n,) each, of the part that points were spread over:
            the variables' own, or those that rows leave, where there are two. What was left out
            is searched wherever the others are.
        widths: for each weight of the penalties, for each first algorithm: geometric-mean half
            widths of the first box as it shrank.
        box_storage: how Newton systems over boxes were ordered, stored and factorized, and why;
            None where no box was shrunk.
        kkt_storage: the same of the local solver's; None where there was no polish of ours.
        certificate: what is known of the least cost; None unless the options ask for it.
    """

    status: AigoStatus
    violation: float
    boxes: int
    iterations: int
    polishes: int
    origin: str
    first_center: Floats = field(repr=False)
    first_half_width: Floats = field(repr=False)
    searched: tuple[Floats, Floats] = field(repr=False)
    widths: tuple[tuple[tuple[float, ...], ...], ...] = field(repr=False)
    box_storage: Storage | None = None
    kkt_storage: Storage | None = None
    substituted: tuple[int, ...] = ()
    lifted: tuple[str, ...] = ()
    complementarities: int = 0
    ladders: int = 0
    repeats: int = 0
    cost: float = np.inf
    certificate: Certificate | None = None

    @property
    def lower_bound(self) -> float:
        """No feasible point costs less; −∞ where nothing is known."""
        return self.certificate.lower_bound if self.certificate else -np.inf

    @property
    def gap(self) -> float:
        """(cost − lower bound) / max(|cost|, the program's scale); ∞ where nothing is known."""
        if self.certificate is None:
            return np.inf
        return relative_gap(self.cost, self.lower_bound, self.certificate.scale)

    @classmethod
    def of_nothing(cls, status: AigoStatus, x: Floats) -> AigoDetails:
        """Returns details of a solve that did not start."""
        nothing = np.zeros(x.size)
        return cls(status, np.inf, 0, 0, 0, "none", x, nothing, (x, x), ())

    def __str__(self) -> str:
        """Returns the status, and what was searched where that is not all of it."""
        lines = [f"{self.status.name}: {self.status.value}", f"found by {self.origin}"]
        if self.status in (AigoStatus.SOLVED_IN_PART, AigoStatus.FALLS_WITHOUT_END):
            lines += [
                f"searched {low:g} ≤ x[{i}] ≤ {high:g}"
                for i, (low, high) in enumerate(zip(*self.searched, strict=True))
                if np.isfinite(low) or np.isfinite(high)
            ]
        return "\n".join(lines)


class AigoProgramResult(MathematicalProgramResult):
    """A MathematicalProgramResult whose solver is AIGO."""

    def __init__(self) -> None:
        """Starts unsolved."""
        super().__init__()
        self._details: AigoDetails | None = None

    def get_solver_id(self) -> SolverId:
        """Returns AIGO's id."""
        return SOLVER_ID

    def get_solver_details(self) -> AigoDetails | None:
        """Returns what it took, and why it ended."""
        return self._details


def fill_result(
    result: Any, prog: MathematicalProgram, x: Floats, cost: float, details: AigoDetails
) -> None:
    """Writes a solution into a MathematicalProgramResult.

    Python has no setter for the map of decision variables or the cost. A program of the same
    variables with a constant cost, solved into the result, sets both.
    """
    constant = MathematicalProgram()
    variables = prog.decision_variables()
    constant.AddDecisionVariables(variables)
    constant.AddLinearCost(a=np.zeros(len(variables)), b=cost, vars=variables)
    ClpSolver().Solve(constant, None, None, result)
    result.set_x_val(x)
    result.set_solution_result(_DRAKE_STATUS[details.status])
    if isinstance(result, AigoProgramResult):
        result._details = details
