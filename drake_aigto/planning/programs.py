"""Penalized programs, compiled once, their solutions, and a check of rows of users."""

from __future__ import annotations

import logging
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from pydrake.solvers import Binding, MathematicalProgram

from drake_aigto.arrays import Floats
from drake_aigto.box import BoxPolynomial, ParametricPolynomial
from drake_aigto.certify import explain_infeasibility, is_infeasible
from drake_aigto.terms import parse_costs
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Additions, Bounds, Transcription, check_together

_LOG = logging.getLogger(__name__)

# Programs that are kept, at most: motions past a block have its faces at different knots.
_MOST_KEPT = 32
_CELLS = 1000  # of a proof that what users added contradicts itself


@dataclass(frozen=True, eq=False)
class CompiledProgram:
    """The penalized program of all transcriptions of one structure."""

    polynomial: ParametricPolynomial  # its costs, for any parameters
    bounds: Bounds  # of its variables
    row_names: tuple[str, ...]  # of the rows that penalties stand for

    @classmethod
    def of(cls, transcription: Transcription) -> CompiledProgram:
        """Compiles."""
        twin, order = transcription.twin(), transcription.elimination_order()
        blocks = parse_costs(twin.penalized())
        num_parameters = transcription.parameters.vector().size
        polynomial = ParametricPolynomial(order.size, num_parameters, blocks, order)
        _LOG.info("boxes: %s", polynomial.storage)
        rows = {row.evaluator().get_description() for row in twin.prog().GetAllConstraints()}
        names = tuple(sorted(rows & {block.name for block in blocks}))
        lower, upper = (bound[: order.size] for bound in twin.bounds())
        return cls(polynomial, (lower, upper), names)

    def at(self, transcription: Transcription) -> BoxPolynomial:
        """Returns the penalized cost of a transcription."""
        return self.polynomial.at(transcription.parameters.vector())


class CompiledPrograms:
    """The programs of one world with its additions of users, by structure."""

    def __init__(self) -> None:
        """Starts with none."""
        self._kept: dict[Hashable, CompiledProgram] = {}

    def compile(self, transcription: Transcription) -> CompiledProgram:
        """Returns a transcription's program, whose bounds it takes.

        Raises:
            UnsupportedTermError: a cost or constraint that has no mean in closed form.
        """
        key = transcription.structure
        if key not in self._kept:
            if len(self._kept) >= _MOST_KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = CompiledProgram.of(transcription)
        transcription.take_bounds(self._kept[key].bounds)
        return self._kept[key]


class Solution(Protocol):
    """A motion that solves a program."""

    @property
    def trajectory(self) -> Trajectory:
        """The motion at its knots."""

    @property
    def defects(self) -> Mapping[str, float]:
        """The largest violation of each kind of row, in its unit (m, m/s)."""


@dataclass(frozen=True, eq=False)
class ProgramSolution:
    """A motion of decision variables x (n,) of a transcription (`Solution`)."""

    x: Floats
    trajectory: Trajectory
    defects: Mapping[str, float]

    @classmethod
    def of(cls, transcription: Transcription, x: Floats) -> ProgramSolution:
        """Returns the motion of all decision variables."""
        return cls(x, transcription.trajectory(x), transcription.defects(x))


def check_added_rows(prog: MathematicalProgram, additions: Additions) -> None:
    """Refuses what users added if it is proven that it contradicts itself or bounds.

    The program's own rows are left out: they couple all knots, which a proof makes little of.
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

    def program(constraints: Sequence[Binding]) -> MathematicalProgram:
        some = MathematicalProgram()
        own = {variable.get_id(): variable for each in constraints for variable in each.variables()}
        some.AddDecisionVariables([*own.values()])
        for each in constraints:
            some.AddConstraint(each.evaluator(), each.variables())
        return some

    check_together(
        [*rows, *bounds],
        lambda some: not is_infeasible(program(some), _CELLS),
        lambda some: explain_infeasibility(program(some), _CELLS),
    )
