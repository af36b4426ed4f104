"""Costs and constraints of users, at knots of a motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import Sum, SumTape, TapeBuilder, evaluate_tape
from drake_aigto.dynamics import EquationsOfMotion
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.tables import FLOW, Added
from drake_aigto.terms import parse_costs, parse_rows
from drake_aigto.transcription import Addition, Additions

# Knots of functions that are not bound to a time.
EVERYWHERE, AT_END = -1.0, float(np.inf)


class AddedFunction(NamedTuple):
    """A function f(q, v, u) of a user: a cost, or a row of a constraint.

    Attributes:
        name: of its cost or constraint.
        is_cost: whether it is a cost, not a constraint.
        is_running: whether the cost of each knot is multiplied by the time until the next one.
        lower: bound of a constraint.
        upper: the same.
        time: of the knot at which it counts [s], EVERYWHERE or AT_END.
        reads_control: whether it reads any control.
    """

    name: str
    is_cost: bool
    is_running: bool
    lower: float
    upper: float
    time: float
    reads_control: bool


@dataclass(frozen=True, eq=False)
class AddedTerms:
    """Additions of users to a task, compiled once for any problem of the mechanism.

        J + Σ_{k<N} h_k g(x_k, u_k) + e(x_N) + c(x_j, u_j),    lower ≤ f(x_k, u_k) ≤ upper

    Functions are sums of products of powers, sin and cos; x_k is the state at knot k, (q, v), at an
    impact the one after it, and constraints without controls count before it as well. Costs have
    exact gradients, and exact Hessians without negative eigenvalues; constraints have multipliers
    like bounds.

    Attributes:
        rows: description of each function.
        tape: of values, slopes, and curvatures of costs, by (q, v, u); see `tables.Added`.
    """

    rows: tuple[AddedFunction, ...]
    tape: SumTape

    @classmethod
    def of(cls, world: EquationsOfMotion, additions: Additions) -> AddedTerms:
        """Returns the functions of a world's state and control from additions to its task.

        Raises:
            ProgramError: one reads variables of several knots.
            UnsupportedTermError: one has a factor that is no power, sin or cos.
        """
        builder = TapeBuilder([*world.positions, *world.velocities, *world.controls])
        found = list(_read_all(builder, world, additions))
        size, functions = len(builder.variables), [function for _, function in found]
        differentiate = builder.differentiate
        slopes = [[differentiate(f, c) for c in range(size)] for f in functions]
        bends: list[Sum] = []
        for (row, _), by_column in zip(found, slopes, strict=True):
            pairs = ((c, d) for c in range(size) for d in range(c, size))
            bends += [
                builder.differentiate(by_column[c], d) if row.is_cost else {} for c, d in pairs
            ]
        derivatives = [*(slope for each in slopes for slope in each), *bends]
        return cls(tuple(row for row, _ in found), builder.build(functions, derivatives))

    def measure_units(self, scales: Floats) -> Floats:
        """Returns Σ_i |∂f/∂x_i| s_i of each function, the largest about 0 and ±s; 1 where it is 0.

        Args:
            scales: s, of (q, v, u).
        """
        units, tape, shape = np.zeros(len(self.rows)), self.tape, (len(self.rows), len(scales))
        if not self.rows:
            return units
        code, numbers = np.array(tape.code), np.array(tape.numbers)
        values = np.zeros(1 + len(scales) + 2 * tape.code[0] + tape.code[1])
        for sign in (-1.0, 0.0, 1.0):
            sums = tape.constants.copy()
            evaluate_tape(code, numbers, sign * scales, values, sums)
            slopes = sums[len(units) :][: len(units) * len(scales)].reshape(shape)
            units = np.maximum(units, np.abs(slopes) @ scales)
        return np.where(np.isfinite(units) & (units > 0), units, 1.0)

    def check_untimed(self) -> None:
        """Refuses functions of one time, as phases of free durations have no knot there.

        Raises:
            ProgramError: there is one.
        """
        for row in self.rows:
            if row.time not in (EVERYWHERE, AT_END):
                raise ProgramError(
                    f"'{row.name}' can't be planned",
                    got=f"a function of the knot at {row.time:g} s, and phases of free durations",
                    expected="one of every knot, or of the last",
                    remedy="Use AddConstraintToAllKnotPoints, AddRunningCost or AddFinalCost.",
                )

    def lay_out(self, kinds: Ints, shares: Floats, times: Floats | None) -> tuple[Added, Floats]:
        """Returns the tables of costs for kernels, and bounds at knots, shape (2, K + 1, R).

        Args:
            kinds: of the K stages, see `Program`.
            shares: their lengths, see `Program`.
            times: of the knots [s]; None: phases have free durations.

        Raises:
            ProgramError: a function is bound to a time, and knots are free to move.
        """
        if times is None:
            self.check_untimed()
        places = np.zeros((len(kinds) + 1, len(self.rows)), dtype=np.bool_)
        for r, row in enumerate(self.rows):
            places[_find_stages(row, kinds, times), r] = True
        factors = np.where([row.is_cost for row in self.rows], places, 0.0)
        is_running = np.array([row.is_running for row in self.rows], dtype=np.bool_)
        factors[:-1, is_running] *= shares[:, np.newaxis]
        lower, upper = ([getattr(row, end) for row in self.rows] for end in ("lower", "upper"))
        bounds = np.where(places, lower, -np.inf), np.where(places, upper, np.inf)
        return Added(*self.tape, is_running, factors), np.stack(bounds)


def _find_stages(row: AddedFunction, kinds: Ints, times: Floats | None) -> Ints:
    """Returns the stages at the start of which a function counts, K for the end."""
    flights = np.append(np.flatnonzero(kinds == FLOW), len(kinds))
    if row.time == AT_END:
        return flights[-1:]
    if row.time == EVERYWHERE and (row.is_cost or row.reads_control):
        return flights[:-1]
    if row.time == EVERYWHERE:
        return np.flatnonzero(np.concatenate([[0], np.cumsum(kinds == FLOW)]))
    assert times is not None
    return flights[[np.argmin(np.abs(times - row.time))]]


NO_TERMS = AddedTerms((), TapeBuilder([]).build([], []))


def _read_all(
    builder: TapeBuilder, world: EquationsOfMotion, additions: Additions
) -> Iterator[tuple[AddedFunction, Sum]]:
    """Yields each function with its description."""
    for each in additions.running:
        yield from _read(builder, world, each, EVERYWHERE, is_running=True)
    for each in additions.final:
        yield from _read(builder, world, each, AT_END)
    for each in additions.everywhere:
        yield from _read(builder, world, each, EVERYWHERE)
    for each in additions.at_knots:
        knots = {place.knot for place in each.places}
        if len(knots) > 1:
            raise ProgramError(
                f"'{each.name}' can't be planned for a mechanism",
                got=f"variables of knots {', '.join(map(str, sorted(knots, key=str)))}",
                expected="those of one knot",
                remedy="Shooting goes from knot to knot: split it, or bound each by itself.",
            )
        (knot,) = knots
        is_last = knot == len(additions.times) - 1
        if not each.is_of_start:
            yield from _read(
                builder, world, each, AT_END if is_last else float(additions.times[knot or 0])
            )


def _read(
    builder: TapeBuilder,
    world: EquationsOfMotion,
    addition: Addition,
    time: float,
    is_running: bool = False,
) -> Iterator[tuple[AddedFunction, Sum]]:
    """Yields the functions of one addition over (q, v, u)."""
    n, label = world.num_positions, f"'{addition.name}' can't be planned for a mechanism"
    first = {"q": 0, "v": n, "u": 2 * n}
    variables = [first[place.part] + place.coordinate for place in addition.places]
    row = AddedFunction(
        addition.name, True, is_running, -np.inf, np.inf, time, addition.reads_control
    )
    if addition.is_cost:
        scratch = MathematicalProgram()
        scratch.AddDecisionVariables(builder.variables)
        scratch.AddCost(addition.evaluator, vars=[builder.variables[i] for i in variables])
        total: Sum = {}
        for block in parse_costs(scratch):
            for copy in block.variables.tolist():
                for product, coefficient in builder.collect(label, block.terms, copy).items():
                    total[product] = total.get(product, 0.0) + coefficient
        yield row, total
        return
    for each in parse_rows(label, addition.evaluator, [variables]):
        (copy,) = each.block.variables.tolist()
        bounded = row._replace(is_cost=False, lower=each.lower, upper=each.upper)
        yield bounded, builder.collect(label, each.block.terms, copy)
