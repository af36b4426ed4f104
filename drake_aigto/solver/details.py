"""Options of `AigoSolver`, and its results as a MathematicalProgramResult."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from pydrake.solvers import (
    ClpSolver,
    MathematicalProgram,
    MathematicalProgramResult,
    SolutionResult,
    SolverId,
)

from drake_aigto.arrays import Floats
from drake_aigto.certify import Certificate, explain_infeasibility, is_infeasible, relative_gap
from drake_aigto.errors import OptionsError, check_counts, check_positive
from drake_aigto.linear import Storage

PolishName = Literal["newton", "ipopt", "snopt", "none"]

_MOST_CELLS = 20_000  # of each proof that some rows contradict each other


@dataclass(frozen=True, kw_only=True)
class AigoOptions:
    """Options of `AigoSolver`; each may also be set in SolverOptions under its name.

        options = SolverOptions()
        options.SetOption(AigoSolver.id(), "rounds", 20)

    Attributes:
        polish: the local solver that improves every box center on the true constraints: "newton"
            (`local.InteriorPoint`), "ipopt" or "snopt" through Drake, or "none".
        rounds: the most rounds in which boxes of some variables are renewed (`aigo.BoxSearch`).
            With constraints, they are shared out to three weights of their penalties. Also the most
            ladders of penalties, where there are stages or complementarities; a climb by interior
            points, where complementarities share a side, counts as three.
        patience: rounds in a row without a better point that end the search; with constraints, a
            sixth of them does at each weight; with ladders, three eighths of them do, and the
            points that are kept begin anew, until they led to the best cost twice, and eight
            ladders did, unless interior points climb too.
        feasibility: the largest violation of a constraint in an answer that is called a solution
            (`AigoDetails.violation`).
        first_half_width: half width of the first box where a variable has no bounds, relative to
            max(1, |guess|); it doubles from there while that lowers the cost's mean.
        max_doublings: how often it does so at most.
        starts: number of points, spread over the first box, that are polished too; none in programs
            of more than 30 variables.
        decades: where variables have no bounds, as many points again are spread beyond the first
            box and polished, up to its half width times 10 to this power; farther, as long as that
            leads to lower ones. 0: none.
        certify: whether a lower bound of the cost (`drake_aigto.certify`) is raised until it proves
            the answer, and bounds the first box. Without it, programs of up to 100 variables are
            bounded by 400 cells, and by up to 6,400 as long as twice as many leave a third of the
            gap; there is no search where they prove the answer.
        cells: the most cells that bounds are taken of; 0, without `certify`: none, no bound.
        seconds: the most that these take in all; None: as long as it takes. The bound depends on
            the clock then, and `AigoDetails.certificate` says so.
        presolve: whether variables that an equality defines are substituted.
        seed: of everything random.
    """

    polish: PolishName = "newton"
    rounds: int = 200
    patience: int = 80
    feasibility: float = 1e-6
    first_half_width: float = 1.0
    max_doublings: int = 10
    starts: int = 20
    decades: int = 6
    certify: bool = False
    cells: int = 500_000
    seconds: float | None = None
    presolve: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks the choices and ranges."""
        if self.polish not in (known := get_args(PolishName)):
            expected = f"one of {', '.join(known)}"
            raise OptionsError("polish", got=repr(self.polish), expected=expected)
        check_positive(self, "feasibility", "first_half_width")
        check_counts(self, rounds=0, patience=1, max_doublings=0, starts=0, decades=0, seed=0)
        check_counts(self, cells=int(self.certify))
        if self.seconds is not None:
            check_positive(self, "seconds")
        for name in ("rounds", "patience", "max_doublings", "starts", "decades", "cells", "seed"):
            if (value := getattr(self, name)) != int(value):
                raise OptionsError(name, got=value, expected="a whole number")

    def with_solver_options(self, values: Mapping[str, Any]) -> AigoOptions:
        """Returns these options with those replaced that Drake's SolverOptions name.

        Raises:
            OptionsError: an unknown name, or a value out of range.
        """
        known = [field.name for field in dataclasses.fields(self)]
        for name in values.keys() - known:
            expected = f"one of {', '.join(known)}"
            raise OptionsError(f"unknown option {name!r} of AigoSolver", expected=expected)
        return dataclasses.replace(self, **values)


# Drake compares ids by identity.
SOLVER_ID = SolverId("AIGO")


class AigoStatus(enum.Enum):
    """Why a solve ended, and how to read it."""

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
    INTERRUPTED = "interrupted: the answer is the best so far, if there is any"

    def if_proven(self, prog: MathematicalProgram) -> AigoStatus:
        """Returns this one, which denies any feasible point, if ranges of rows prove that.

        Presolve proves none: powers are logarithms to it, which at 0 have no value that powers may
        have.
        """
        return self if is_infeasible(prog) else AigoStatus.NO_FEASIBLE_POINT

    def explain(self, prog: MathematicalProgram, cells: int = 0) -> str:
        """Returns which rows or bounds contradict each other, if this says that some do.

        Nothing, if that takes too many cells, or is interrupted.

        Args:
            prog: the program.
            cells: which proved it; 0: ranges of rows did.
        """
        denies = (AigoStatus.INFEASIBLE, AigoStatus.CONTRADICTORY_BOUNDS)
        with suppress(KeyboardInterrupt):
            most = min(2 * cells, _MOST_CELLS)
            return explain_infeasibility(prog, most) if self in denies else ""
        return ""


# All others are solutions.
_DRAKE_STATUS = {
    AigoStatus.NO_FEASIBLE_POINT: SolutionResult.kIterationLimit,
    AigoStatus.INFEASIBLE: SolutionResult.kInfeasibleConstraints,
    AigoStatus.CONTRADICTORY_BOUNDS: SolutionResult.kInfeasibleConstraints,
    AigoStatus.FALLS_WITHOUT_END: SolutionResult.kUnbounded,
    AigoStatus.NOT_FINITE: SolutionResult.kSolverSpecificError,
    AigoStatus.INTERRUPTED: SolutionResult.kIterationLimit,
}


@dataclass(frozen=True, eq=False)
class AigoDetails:
    """Details of a solve, as `MathematicalProgramResult.get_solver_details` returns them.

    Attributes:
        status: why the solve ended.
        violation: the largest violation of a constraint at the answer, relative to the row's
            largest coefficient, or largest term within the bounds, where that is below 1, and
            beyond the share that rounding of the variables alone may have in it.
        boxes: number of boxes that were shrunk.
        iterations: inner iterations of AIGO, all boxes.
        polishes: number of points that were polished.
        origin: the algorithm, and the box, that led to the answer.
        substituted: numbers of the variables that presolve left out, in the order of doing so.
        lifted: functions without a mean, for which variables with rows stood.
        complementarities: number of rows read as λ s = 0, or λ s ≤ ε, of λ, s ≥ 0, and relaxed.
        ladders: number of ladders of penalties or of interior points: 0 unless there are
            complementarities, or the program is a long chain of stages.
        repeats: number of ladders that ended at the answer's cost, to 1e-3 of it: where it is 1,
            others found nothing as good, and a longer search may find better.
        cost: of the answer.
        first_center: of the first box, shape (n,); of variables left out, their values there.
        first_half_width: of the first box, shape (n,); NaN of variables left out.
        searched: lower and upper bounds, shape (n,) each, of the part that points were spread over:
            the variables' own, or those that rows leave, where there are two. Variables left out
            are searched wherever the others are.
        widths: for each weight of the penalties, for each first algorithm: geometric-mean half
            widths of the first box as it shrank.
        box_storage: order, storage and factorization of Newton systems over boxes, and why;
            None where no box was shrunk.
        kkt_storage: the same of the local solver's; None where there was no polish of ours.
        certificate: a lower bound of the cost; None where it was neither asked for nor cheap.
        conflict: rows that contradict each other, one a line, with what the others leave of each,
            or bounds that cross; empty unless that is proven, whatever the cost.
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
    conflict: str = ""

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
    def of_nothing(cls, status: AigoStatus, x: Floats, prog: MathematicalProgram) -> AigoDetails:
        """Returns details of a solve that did not start."""
        nothing, conflict = np.zeros(x.size), status.explain(prog)
        return cls(status, np.inf, 0, 0, 0, "none", x, nothing, (x, x), (), conflict=conflict)

    def __str__(self) -> str:
        """Returns the status, the part that was searched where that is not all, and what is amiss.

        A proof takes rows exactly: it may deny any point where an answer violates one by 1e-7.
        """
        lines = [f"{self.status.name}: {self.status.value}", f"found by {self.origin}"]
        if self.status == AigoStatus.SOLVED and self.lower_bound == np.inf:
            lines += [f"no point meets all rows exactly: this one is off by {self.violation:.1e}"]
        if self.status in (AigoStatus.SOLVED_IN_PART, AigoStatus.FALLS_WITHOUT_END):
            lines += [
                f"searched {low:g} ≤ x[{i}] ≤ {high:g}"
                for i, (low, high) in enumerate(zip(*self.searched, strict=True))
                if np.isfinite(low) or np.isfinite(high)
            ]
        return "\n".join(filter(None, [*lines, self.conflict]))


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
        """Returns how the solve went, and why it ended."""
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
    result.set_solution_result(_DRAKE_STATUS.get(details.status, SolutionResult.kSolutionFound))
    if isinstance(result, AigoProgramResult):
        result._details = details
