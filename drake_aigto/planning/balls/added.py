"""Costs and constraints of users in programs of arcs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.arrays import Floats, Ints
from drake_aigto.local import NlpBuilder
from drake_aigto.terms import (
    Factor,
    FunctionKind,
    Sum,
    Term,
    evaluate,
    from_terms,
    parse_costs,
    parse_rows,
)
from drake_aigto.transcription import Addition, Additions, Part


class AddedSums:
    """Additions of users as sums of a program.

    Inequalities lower ≤ y ≤ upper that are not about one unknown have a slack s each: y − s = 0
    with lower ≤ s ≤ upper. Rows are in units of the task (`Additions.units`).
    """

    def __init__(self, builder: NlpBuilder) -> None:
        """Starts with none."""
        self._builder = builder
        # Slacks (K,), y, and the unknowns that it reads, shape (K, L).
        self._slacks: list[tuple[Ints, Sum, Ints]] = []

    def complete(self, x: Floats) -> Floats:
        """Returns a point (n,) with the slacks of its other unknowns."""
        for slacks, y, read in self._slacks:
            x[slacks] = evaluate(y, x[read])
        return x

    def add(
        self,
        additions: Additions,
        unknowns: Mapping[Part, Ints],
        steps: Ints,
        at: Mapping[int, int],
    ) -> None:
        """Adds costs and rows.

        Args:
            additions: of users.
            unknowns: q and v at each joint, u of each arc from one to the next.
            steps: the arcs' durations, shape (J,).
            at: the joint at the time of each knot that additions are about.
        """

        def read(addition: Addition) -> Ints:
            knots = addition.knots(len(steps))
            return np.array([addition.read(unknowns, j, at.__getitem__) for j in knots])

        for each in additions.running:
            self._add_cost(each, read(each)[: len(steps)], steps)
        for each in (*additions.final, *(each for each in additions.at_knots if each.is_cost)):
            self._add_cost(each, read(each)[-1:])
        for each in additions.constraints:
            self._add_rows(each, read(each), additions.units(each).tolist())

    def _add_cost(self, addition: Addition, copies: Ints, steps: Ints | None = None) -> None:
        """Adds copies (K, L) of a cost, times steps (K,) if given."""
        scratch = MathematicalProgram()
        x = scratch.NewContinuousVariables(copies.shape[1], "x")
        scratch.AddCost(addition.evaluator, vars=x)
        for block in parse_costs(scratch):
            for places in block.variables:
                terms, chosen = block.terms, copies[:, places]
                if steps is not None:
                    step, chosen = _power(len(places)), np.column_stack([chosen, steps])
                    terms = tuple(Term(t.coefficient, (*t.factors, step)) for t in terms)
                self._builder.add_cost(addition.name, terms, chosen)

    def _add_rows(self, addition: Addition, copies: Ints, units: list[float]) -> None:
        """Adds copies (K, L) of the rows of a constraint, in these units."""
        builder, label, size = (
            self._builder,
            f"the constraint '{addition.name}'",
            np.max(copies) + 1,
        )
        for parsed in parse_rows(label, addition.evaluator, copies.tolist()):
            assert parsed.origin is not None
            row = parsed.divided(units[parsed.origin[1]])
            terms, variables = row.block.terms, row.block.variables
            lower, upper = np.full(size, -np.inf), np.full(size, np.inf)
            if row.tighten(lower, upper):
                builder.bound(np.arange(size), lower, upper)
            elif row.is_equality:
                builder.add_row(addition.name, [*terms, Term(-row.lower, ())], variables)
            elif not row.is_free:
                slacks = builder.new(len(variables))
                builder.bound(slacks, row.lower, row.upper)
                minus = Term(-1.0, (_power(variables.shape[1]),))
                both = np.column_stack([variables, slacks])
                builder.add_row(addition.name, [*terms, minus], both)
                self._slacks.append((slacks, from_terms(terms), variables))


def _power(place: int) -> Factor:
    return Factor(place, FunctionKind.POWER)
