"""Checks that constraints of users are consistent, before long work starts."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from functools import partial

import numpy as np
from pydrake.solvers import Binding, ClpSolver, MathematicalProgram, SolutionResult

from drake_aigto.arrays import Floats
from drake_aigto.errors import ProgramError
from drake_aigto.transcription.additions import SLACK, Additions


def check_bounds_of(additions: Additions) -> None:
    """Refuses constraints that no number satisfies.

    Raises:
        ProgramError: a lower bound above its upper one, or one that is NaN.
    """
    for each in additions.constraints:
        bounds = each.evaluator.lower_bound(), each.evaluator.upper_bound()
        for lower, upper in zip(*bounds, strict=True):
            if not lower <= upper or lower == np.inf or upper == -np.inf:
                raise ProgramError(
                    f"the bounds of the constraint '{each.name}'",
                    got=f"[{lower:g}, {upper:g}]",
                    expected="lower ≤ upper",
                )


def check_start(additions: Additions, q: Floats, v: Floats) -> None:
    """Refuses constraints on the initial state alone, shapes (nq,), (nv,), that it does not meet.

    Raises:
        ProgramError: there is one.
    """
    for each in additions.constraints:
        if each.is_of_start and (missed := additions.miss_at_start(each, q, v)):
            raise ProgramError(
                f"the constraint '{each.name}'",
                got=f"an initial state that misses it by {missed:.1g} of the task's scales",
                expected="one that the scenario's start meets",
                remedy="Leave out the first knot, or start elsewhere.",
            )


def check_linear(prog: MathematicalProgram, names: Collection[str]) -> None:
    """Refuses bounds and linear constraints of these descriptions that contradict each other."""
    linear = (
        *prog.bounding_box_constraints(),
        *prog.linear_constraints(),
        *prog.linear_equality_constraints(),
    )
    kept = [each for each in linear if each.evaluator().get_description() in names]
    check_together(kept, partial(_is_feasible, prog))


def check_together(
    constraints: Sequence[Binding],
    may_be_feasible: Callable[[Sequence[Binding]], bool],
    explain: Callable[[Sequence[Binding]], str] = lambda _: "",
) -> None:
    """Refuses constraints that are known to be infeasible.

    Args:
        constraints: all of them.
        may_be_feasible: whether some of them may be met.
        explain: says with numbers why some can't be.

    Raises:
        ProgramError: they leave none; the message has few that contradict each other.
    """
    if may_be_feasible(constraints):
        return
    kept = list(constraints)
    for each in constraints:  # The remaining set is contradictory, and minimal.
        others = [other for other in kept if other is not each]
        if not may_be_feasible(others):
            kept = others
    raise ProgramError(
        "constraints contradict each other",
        got=_describe(kept),
        expected="some motion that meets all of them",
        remedy="\n".join(filter(None, ["Relax or leave out one.", explain(kept)])),
    )


def _is_feasible(prog: MathematicalProgram, constraints: Sequence[Binding]) -> bool:
    linear = MathematicalProgram()
    linear.AddDecisionVariables(prog.decision_variables())
    for each in constraints:
        linear.AddConstraint(each.evaluator(), vars=each.variables())
    status = ClpSolver().Solve(linear).get_solution_result()
    return bool(status != SolutionResult.kInfeasibleConstraints)


def _describe(constraints: Iterable[Binding]) -> str:
    """Returns the names of constraints, each with the variables that users know."""
    reads: dict[str, dict[str, None]] = {}
    for each in constraints:
        variables = (str(variable) for variable in each.variables())
        known = (name for name in variables if not name.startswith(SLACK))
        reads.setdefault(each.evaluator().get_description(), {}).update(dict.fromkeys(known))
    return "; ".join(f"'{name}' on {', '.join(known)}" for name, known in reads.items())
