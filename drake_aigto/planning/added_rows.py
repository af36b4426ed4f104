"""Whether nonlinear rows of users leave any motion at all: asked before long work starts."""

from __future__ import annotations

from collections.abc import Sequence

from pydrake.solvers import Binding, MathematicalProgram

from drake_aigto.local import compile_nlp
from drake_aigto.solver import may_be_feasible
from drake_aigto.transcription.additions import Additions
from drake_aigto.transcription.consistency import check_together


def check_added_rows(prog: MathematicalProgram, additions: Additions) -> None:
    """Refuses what users added if intervals show that it contradicts itself or bounds.

    The program's own rows are left out: they couple all knots, which intervals make little of.

    Raises:
        ProgramError: it does.
    """
    names = {each.name for each in additions.constraints}
    rows = [
        each
        for each in (*prog.generic_constraints(), *prog.quadratic_constraints())
        if each.evaluator().get_description() in names
    ]
    if not rows:
        return
    read = {variable.get_id() for each in rows for variable in each.variables()}
    bounds = [
        each
        for each in prog.bounding_box_constraints()
        if read & {variable.get_id() for variable in each.variables()}
    ]

    def leaves_points(constraints: Sequence[Binding]) -> bool:
        some = MathematicalProgram()
        some.AddDecisionVariables(prog.decision_variables())
        for each in constraints:
            some.AddConstraint(each.evaluator(), each.variables())
        return may_be_feasible(compile_nlp(some))

    check_together([*rows, *bounds], leaves_points)
