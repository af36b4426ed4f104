"""`AigoSolver`: AIGO as a Drake solver for any polynomial MathematicalProgram."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake import solvers

from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError
from drake_aigto.solver.details import (
    SOLVER_ID,
    AigoDetails,
    AigoOptions,
    AigoProgramResult,
    AigoStatus,
    fill_result,
)
from drake_aigto.solver.program import ContradictionError, read_program
from drake_aigto.solver.solve import Solve

_SUPPORTED = {
    solvers.ProgramAttribute.kLinearCost,
    solvers.ProgramAttribute.kQuadraticCost,
    solvers.ProgramAttribute.kGenericCost,
    solvers.ProgramAttribute.kL2NormCost,
    solvers.ProgramAttribute.kLinearConstraint,
    solvers.ProgramAttribute.kLinearEqualityConstraint,
    solvers.ProgramAttribute.kQuadraticConstraint,
    solvers.ProgramAttribute.kLorentzConeConstraint,
    solvers.ProgramAttribute.kRotatedLorentzConeConstraint,
    solvers.ProgramAttribute.kExponentialConeConstraint,
    solvers.ProgramAttribute.kGenericConstraint,
    solvers.ProgramAttribute.kCallback,
}


class AigoSolver(solvers.SolverInterface):
    """Global minima of polynomial programs, by boxes that shrink, without sampling.

        minimize f(x)  subject to  lower ≤ g(x) ≤ upper

    Costs are sums of products of one-variable functions (`drake_aigto.terms.parse_costs` lists
    them); constraints are bounds, and rows that are sums of products of powers, sin, cos and exp.
    For quotients, roots, logarithms, tan, tanh, atan and their like, |x|, max, min, functions of
    functions, norms and cones of Drake the solver adds variables and rows of its own
    (`AigoDetails.lifted`). Polynomials whose formula Drake hides are read off their values.
    Called as any other solver of Drake:

        result = AigoSolver().Solve(prog)
        result.get_solver_details()      # an `AigoDetails`

    Variables that an equality defines are substituted first (`AigoDetails.substituted`), so that a
    program written with auxiliary variables is searched as one without them.

    Rows that are complementarities, λ s = 0, λ s ≤ 0 or λ s ≤ ε of λ, s ≥ 0, are relaxed at first,
    and met in the answer (`AigoDetails.complementarities`). Such programs, and chains of stages
    that follow from each other by equalities, are searched by ladders of penalties from many
    starts, and by renewing stretches of stages; where complementarities share a λ or s, by interior
    points too. `AigoDetails.repeats` counts the ladders that ended at the answer's cost: a search
    by chance has no better sign that it is over. Then come boxes; where there are stages with
    complementarities, only if that led to no feasible point.

    The mean of f over boxes, or with constraints that of its augmented Lagrangian, is minimized
    in closed form while they shrink (AIGTO Sec. II; Labbe & Del Prete 2025); a local solver then
    improves their centers on the true constraints. An answer is called a solution if its
    constraints hold; that it is the global one is likely, not proven, unless the status says so:
    `AigoOptions.certify` has a lower bound raised until it does (`AigoDetails.lower_bound`).
    Where variables have no bounds, points are polished far out too, and the status and
    `AigoDetails.searched` say how far: `SOLVED_IN_PART`.
    """

    def __init__(self, options: AigoOptions | None = None) -> None:
        """Sets options that SolverOptions of a program or of a call may replace."""
        super().__init__()
        self.options = options or AigoOptions()

    @staticmethod
    def id() -> solvers.SolverId:
        """Returns the solver's id, "AIGO"."""
        return SOLVER_ID

    def solver_id(self) -> solvers.SolverId:
        """Returns the solver's id, "AIGO"."""
        return SOLVER_ID

    def available(self) -> bool:
        """Returns True: nothing else has to be installed."""
        return True

    def enabled(self) -> bool:
        """Returns True: no licence is needed."""
        return True

    def AreProgramAttributesSatisfied(self, prog: solvers.MathematicalProgram) -> bool:
        """Returns whether the kinds of costs, constraints and variables are supported.

        Their formulas are read by `Solve` only, which names those that it can't integrate.
        """
        return prog.required_capabilities() <= _SUPPORTED

    def ExplainUnsatisfiedProgramAttributes(self, prog: solvers.MathematicalProgram) -> str:
        """Returns a sentence that names unsupported kinds, or an empty string."""
        missing = sorted(a.name[1:] for a in prog.required_capabilities() - _SUPPORTED)
        return f"AigoSolver can't solve programs with {', '.join(missing)}." if missing else ""

    def Solve(
        self,
        prog: solvers.MathematicalProgram,
        initial_guess: ArrayLike | None = None,
        solver_options: solvers.SolverOptions | None = None,
        result: solvers.MathematicalProgramResult | None = None,
    ) -> Any:
        """Solves a program.

        Where no feasible point was found, the result is kIterationLimit; kInfeasibleConstraints
        only where bounds or interval arithmetic show that there is none.

        Args:
            prog: the program.
            initial_guess: where the first box is put in variables without two bounds, shape (n,);
                the program's own guess if None. NaN is no guess.
            solver_options: values for the names of `AigoOptions`, and Drake's common ones.
            result: filled if given.

        Returns:
            The result, a MathematicalProgramResult; None if one was given.

        Raises:
            UnsupportedTermError: a cost, constraint or variable that AIGO can't take, by name.
            OptionsError: an unknown option, a bad value, or a guess of another size.
        """
        options, prints = self._merge(prog, solver_options)
        guess = np.array(prog.initial_guess() if initial_guess is None else initial_guess, float)
        if guess.shape != (prog.num_vars(),):
            expected = f"({prog.num_vars()},)"
            raise OptionsError("initial_guess", got=f"shape {guess.shape}", expected=expected)

        def observe(x: Floats, line: str) -> None:
            for callback in prog.visualization_callbacks():
                prog.EvalBinding(callback, x)
            if prints:
                print(line)

        try:
            x, cost, details = Solve(read_program(prog), options, guess, observe).run()
        except ContradictionError:
            x, cost = np.where(np.isfinite(guess), guess, 0.0), np.inf
            status = AigoStatus.CONTRADICTORY_BOUNDS.if_proven(prog)
            details = AigoDetails.of_nothing(status, x, prog)
        filled = AigoProgramResult() if result is None else result
        fill_result(filled, prog, x, cost, details)
        return filled if result is None else None

    def _merge(
        self, prog: solvers.MathematicalProgram, solver_options: solvers.SolverOptions | None
    ) -> tuple[AigoOptions, bool]:
        """Returns the options, those of a call before the program's, and whether to print."""
        values: dict[str, Any] = {}
        common: dict[str, Any] = {}
        for source in (prog.solver_options(), solver_options):
            if source is not None:
                values |= source.options.get(SOLVER_ID.name(), {})
                common |= source.options.get("Drake", {})
        return self.options.with_solver_options(values), bool(common.get("kPrintToConsole", 0))
