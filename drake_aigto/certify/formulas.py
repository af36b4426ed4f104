"""A MathematicalProgram as formulas: summands of its cost, rows, and rows at prices."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake import solvers
from pydrake.symbolic import Expression, ExpressionKind

from drake_aigto import terms
from drake_aigto.arrays import Bools, Floats
from drake_aigto.certify import tape as tapes
from drake_aigto.certify.enclosures import GRADIENT, VALUE, enclose_all
from drake_aigto.errors import UnsupportedTermError

# Evaluators that give their formulas back, what they are called, and the remedy for others.
_COSTS = (
    (solvers.LinearCost, solvers.QuadraticCost, solvers.ExpressionCost, *terms.NORM_COSTS),
    "a LinearCost, a QuadraticCost, an ExpressionCost or a norm",
    "Add it as `c = ExpressionCost(expression); prog.AddCost(c, vars=c.vars())`.",
)
_ROWS = (
    (
        solvers.LinearConstraint,
        solvers.QuadraticConstraint,
        solvers.ExpressionConstraint,
        *terms.CONES,
    ),
    "bounds, a cone, or a linear, quadratic or expression constraint",
    "Write it symbolically.",
)

# A row or a variable is at its bound where it is this near, relative to its size.
_NEAR = 1e-5


@dataclass(frozen=True, eq=False)
class Summand:
    """factor · (formula − target): a summand of the cost, or a row at a price."""

    binding: solvers.Binding  # the cost that it came from; of a row, the constraint
    expression: Expression  # its formula
    index: tapes.Index  # of its variables
    variables: tuple[int, ...]  # indices of those that it reads, rising
    factor: float = 1.0  # as above
    target: float = 0.0  # as above

    def parts(self, factor: float = 1.0, target: float = 0.0) -> list[Summand]:
        """Returns factor · (formula − target) as the summands that the formula adds up."""
        e, binding, index = self.expression, self.binding, self.index
        found = terms.operands(e) if e.get_kind() == ExpressionKind.Add else [e]
        return [
            Summand(binding, part, index, _read(part, index), factor, 0.0 if i else target)
            for i, part in enumerate(found)
        ]


@dataclass(frozen=True, eq=False)
class BoundedFormula(Summand):
    """lower ≤ formula ≤ upper."""

    lower: float = -math.inf
    upper: float = math.inf


@dataclass(frozen=True, eq=False)
class Formulas:
    """A program as a sum of formulas, rows and bounds."""

    names: tuple[str, ...]  # of the variables (n,)
    summands: tuple[Summand, ...]  # of the cost; those of one binding follow each other
    rows: tuple[BoundedFormula, ...]  # all constraints but bounds
    lower: Floats  # bounds of x (n,)
    upper: Floats  # shape (n,)

    @property
    def row_bounds(self) -> tuple[Floats, Floats]:
        """Lower and upper bounds of the rows (R,)."""
        low, high = ([getattr(row, side) for row in self.rows] for side in ("lower", "upper"))
        return np.array(low, dtype=float), np.array(high, dtype=float)

    def groups(self) -> dict[tuple[int, ...], list[Summand]]:
        """Returns the summands by the variables that they read."""
        found: dict[tuple[int, ...], list[Summand]] = {}
        for each in self.summands:
            found.setdefault(each.variables, []).append(each)
        return found


def read_formulas(prog: solvers.MathematicalProgram) -> Formulas:
    """Returns the formulas of a program.

    Raises:
        UnsupportedTermError: a cost or a row has no formula that Drake gives back, a variable is
            not continuous, or a bound is NaN.
    """
    terms.check_continuous(prog)
    index = {variable.get_id(): i for i, variable in enumerate(prog.decision_variables())}
    lower, upper = terms.read_bounds(prog)
    summands: list[Summand] = []
    rows: list[BoundedFormula] = []
    for binding in prog.GetAllCosts():
        (total,), own = _expressions(binding, index, *_COSTS)
        summands += Summand(binding, total, own, ()).parts()
    for binding in prog.GetAllConstraints():
        evaluator = binding.evaluator()
        bounds = evaluator.lower_bound(), evaluator.upper_bound()
        if isinstance(evaluator, solvers.BoundingBoxConstraint):
            continue
        formulas, own = _expressions(binding, index, *_ROWS)
        for formula, low, high in zip(formulas, *(b.tolist() for b in bounds), strict=True):
            read = _read(formula, own)
            rows.append(BoundedFormula(binding, formula, own, read, lower=low, upper=high))
    names = tuple(variable.get_name() for variable in prog.decision_variables())
    of_variables = zip(names, lower.tolist(), upper.tolist(), strict=True)
    of_rows = ((terms.evaluator_label(row.binding), row.lower, row.upper) for row in rows)
    for name, low, high in itertools.chain(of_variables, of_rows):
        if math.isnan(low) or math.isnan(high):
            raise UnsupportedTermError(
                f"{name} can't be bounded",
                got=f"the bounds [{low:g}, {high:g}]",
                expected="numbers",
                remedy="Look for a parameter that was not set.",
            )
    return Formulas(names, tuple(summands), tuple(rows), lower, upper)


def _expressions(
    binding: solvers.Binding, index: tapes.Index, kinds: tuple[Any, ...], expected: str, remedy: str
) -> tuple[Any, tapes.Index]:
    """Returns the formulas of a cost or constraint, and the indices of their variables."""
    evaluator, variables = binding.evaluator(), binding.variables()
    if not isinstance(evaluator, kinds):
        raise UnsupportedTermError(
            f"{terms.evaluator_label(binding)} can't be bounded",
            got=f"a {terms.evaluator_kind(evaluator)}, whose formula Drake does not give back",
            expected=expected,
            remedy=remedy,
        )
    if not variables.size:  # Drake takes no variables for numbers with derivatives.
        return list(map(Expression, evaluator.Eval(np.zeros(0)))), index
    if not isinstance(evaluator, (solvers.ExpressionCost, solvers.ExpressionConstraint)):
        return evaluator.Eval(variables), index
    own = {
        local.get_id(): index[bound.get_id()]
        for local, bound in zip(evaluator.vars(), variables, strict=True)
    }
    is_cost = isinstance(evaluator, solvers.ExpressionCost)
    return [evaluator.expression()] if is_cost else evaluator.expressions(), own


def _read(e: Expression, index: tapes.Index) -> tuple[int, ...]:
    return tuple(sorted({index[variable.get_id()] for variable in e.GetVariables()}))


def formula_of(parts: Sequence[Summand], variables: Sequence[int]) -> list[tapes.Entry]:
    """Returns the sum of some summands as a formula over some of the program's variables.

    Raises:
        UnsupportedTermError: one has a function without an enclosure, by name.
    """
    formula = tapes.Formula()
    places = {variable: k for k, variable in enumerate(variables)}
    return formula.entries(_enter_sum(formula, parts, places))


def tape_of(sums: Iterable[Sequence[Summand]], num_variables: int) -> tapes.Tape:
    """Returns sums of summands as formulas over all n variables; raises as `formula_of` does."""
    return tapes.make_tape(formula_of(parts, range(num_variables)) for parts in sums)


def join(
    sums: Iterable[Sequence[Summand]], num_variables: int, is_nested: bool = True
) -> tapes.JointTape:
    """Returns sums of summands as formulas that share their entries; raises as `formula_of` does.

    If they are nested, powers of one variable are written as Horner does.
    """
    formula, places = tapes.Formula(is_nested), {i: i for i in range(num_variables)}
    for i in range(num_variables):
        formula.put(tapes.Operation.VARIABLE, i)
    roots = [_enter_sum(formula, parts, places) for parts in sums]
    return tapes.JointTape(tapes.make_tape([formula.entries()]), np.array(roots, dtype=np.int64))


def _enter_sum(formula: tapes.Formula, parts: Sequence[Summand], places: tapes.Index) -> int:
    """Adds summands; index of a variable in the program ↦ its place among the formula's."""
    found = -1
    # Summands of one binding are added again, as powers of one variable are bounded together.
    for _, alike in itertools.groupby(
        parts, lambda part: id(part if part.target or part.factor != 1.0 else part.binding)
    ):
        first, *others = alike
        total = sum((part.expression for part in others), first.expression)
        own = {i: places[j] for i, j in first.index.items() if j in places}
        try:
            place = formula.enter(own, total, first.factor, first.target)
        except tapes.NoEnclosureError as error:
            raise UnsupportedTermError(
                f"{terms.evaluator_label(first.binding)} can't be bounded",
                got=f"{error} in {terms.shown(total)}",
                expected="sums, products, quotients, powers, roots, exp, log, sin, cos, tan, "
                "tan⁻¹, tanh, |x|, max and min",
            ) from None
        found = place if found < 0 else formula.put(tapes.Operation.ADD, found, place)
    return formula.put(tapes.Operation.NUMBER) if found < 0 else found


def values_at(tape: tapes.Tape, x: Floats, order: int = VALUE) -> Floats:
    """Returns jets (F, J, 2) of all formulas of a tape at a point (n,)."""
    count = tape.starts.size - 1
    points = np.tile(x, (count, 1))
    return enclose_all(tape, np.arange(count), points, points, order)


def with_prices(formulas: Formulas, x: Floats) -> Formulas:
    """Returns a program whose rows are terms of its cost, which is no larger where they hold.

    On all feasible x, f ≥ f + λ_j (r_j − t_j): of an equality with any λ; of an inequality that is
    at its bound t, with λ (r − t) ≤ 0. Least squares make the Lagrangian's slope at x (n,) small.
    """
    rows = formulas.rows
    tape = tape_of([formulas.summands, *((row,) for row in rows)], x.size)
    jets = values_at(tape, x, GRADIENT)
    if not np.all(np.isfinite(jets)):
        return replace(formulas, rows=())
    values, gradients = np.mean(jets[1:, 0], axis=-1), np.mean(jets[:, 1:], axis=-1)
    low, high = formulas.row_bounds
    at_low, at_high = _is_at(values, low), _is_at(values, high)
    active = at_low | at_high
    free = ~(_is_at(x, formulas.lower) | _is_at(x, formulas.upper))
    prices = np.zeros(len(rows))
    while np.any(active) and np.any(free):
        matrix = gradients[1:][np.ix_(active, free)].T
        prices[active] = np.linalg.lstsq(matrix, -gradients[0][free], rcond=None)[0]
        # Of the side that is active: λ ≥ 0 at the upper one, ≤ 0 at the lower one.
        wrong = active & (low != high) & np.where(at_high, prices <= 0.0, prices >= 0.0)
        if not np.any(wrong):
            break
        active &= ~wrong
        prices[~active] = 0.0
    targets = np.where(at_high, high, low).tolist()
    every = zip(rows, prices.tolist(), targets, strict=True)
    priced = (part for row, price, own in every if price for part in row.parts(price, own))
    return replace(formulas, summands=(*formulas.summands, *priced), rows=())


def _is_at(values: Floats, bounds: Floats) -> Bools:
    """Returns which values are next to their bounds, which are finite then."""
    return np.abs(values - bounds) <= _NEAR * np.maximum(1.0, np.abs(values))
