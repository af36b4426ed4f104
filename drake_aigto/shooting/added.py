"""Costs and constraints of users, at knots of a motion."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.arrays import Floats, Ints, read_only
from drake_aigto.contact import Sum, SumTape, TapeBuilder, evaluate_tape
from drake_aigto.dynamics import Coordinates, EquationsOfMotion
from drake_aigto.errors import ProgramError
from drake_aigto.shooting.tables import FLOW, Added
from drake_aigto.simulation import CLEARANCE
from drake_aigto.terms import parse_costs, parse_rows
from drake_aigto.transcription import Addition, Additions

# Knots of functions that are not bound to a time.
EVERYWHERE, AT_END = -1.0, float(np.inf)
_NO_PAIRS = read_only(np.empty(0), np.int64)


class AddedFunction(NamedTuple):
    """A function f(q, v, u) of a user: a cost, or a row of a constraint."""

    name: str  # of its cost or constraint
    is_cost: bool  # whether it is a cost, not a constraint
    is_running: bool  # whether the cost of each knot is multiplied by the time until the next one
    lower: float  # bound of a constraint
    upper: float  # the same
    time: float  # of the knot at which it counts [s], EVERYWHERE or AT_END
    reads_control: bool  # whether it reads any control


# The distance of a pair of shapes that are kept apart: compiled code measures it.
_APART = AddedFunction(CLEARANCE, False, False, -np.inf, np.inf, EVERYWHERE, False)


@dataclass(frozen=True, eq=False)
class AddedTerms:
    """Additions of users to a task, compiled once for any problem of the mechanism.

        J + Σ_{k<N} h_k g(x_k, u_k) + e(x_N) + c(x_j, u_j),    lower ≤ f(x_k, u_k) ≤ upper

    Functions are sums of products of powers, sin and cos; x_k is the state at knot k, (q, v), at an
    impact the one after it, and constraints without controls count before it as well. Costs have
    exact gradients, and exact Hessians without negative eigenvalues; constraints have multipliers
    like bounds. Derivatives by q are those along q ⊕ δ.

    Attributes:
        rows: description of each function, R of them.
        tape: of values, slopes, and curvatures of costs, by (δ, v, u); see `tables.Added`.
        coordinates: of the state.
        pairs: of shapes in space whose distances are functions, too, the last ones, shape (P,).
    """

    rows: tuple[AddedFunction, ...]
    tape: SumTape
    coordinates: Coordinates
    pairs: Ints

    @classmethod
    def of(
        cls, world: EquationsOfMotion, additions: Additions, pairs: Ints = _NO_PAIRS
    ) -> AddedTerms:
        """Returns the functions of a world's state and control from additions to its task.

        Args:
            world: the mechanism.
            additions: to the task.
            pairs: of shapes in space that are kept apart, shape (P,).

        Raises:
            ProgramError: one reads variables of several knots, or angles that no sum moves along.
            UnsupportedTermError: one has a factor that is no power, sin or cos.
        """
        builder = TapeBuilder([*world.positions, *world.velocities, *world.controls])
        found: list[tuple[AddedFunction, Sum]] = [*_read_all(builder, world, additions)]
        found += [(_APART, {})] * len(pairs)
        size = len(world.rates) + len(builder.variables) - world.num_positions
        functions, derivatives, bends = list[Sum](), list[Sum](), list[Sum]()
        for row, function in found:
            slopes = _differentiate(builder, world, function)
            if any(map(np.isnan, [c for slope in slopes for c in slope.values()])):
                raise ProgramError(
                    f"'{row.name}' can't be planned",
                    got="a function of roll, pitch and yaw of a ball joint",
                    expected="one of other coordinates, or a free body's quaternion",
                )
            functions.append(function)
            derivatives += slopes
            twice = [_differentiate(builder, world, s if row.is_cost else {}) for s in slopes]
            bends += [
                _average(twice[c][d], twice[d][c]) for c in range(size) for d in range(c, size)
            ]
        tape = builder.build(functions, [*derivatives, *bends])
        return cls(tuple(row for row, _ in found), tape, world, pairs)

    def measure_units(self, scales: Floats, length: float) -> Floats:
        """Returns Σ_i |∂f/∂x_i| s_i of each function, the largest about 0 and ±s; 1 where it is 0.

        Args:
            scales: s, of (δ, v, u).
            length: unit of distances [m].
        """
        count, tape, coordinates = len(self.rows), self.tape, self.coordinates
        units, n = np.zeros(count), coordinates.num_velocities
        if not count:
            return units
        code, numbers = np.array(tape.code), np.array(tape.numbers)
        for sign in (-1.0, 0.0, 1.0):
            moved, sums = sign * scales, tape.constants.copy()
            x = np.concatenate([coordinates.add(coordinates.origin, moved[:n]), moved[n:]])
            values = np.zeros(1 + len(x) + 2 * code[0] + code[1])
            evaluate_tape(code, numbers, x, values, sums)
            slopes = sums[count:][: count * len(scales)].reshape(count, len(scales))
            units = np.maximum(units, np.abs(slopes) @ scales)
        units[count - len(self.pairs) :] = length
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

    def lay_out(
        self, kinds: Ints, shares: Floats, times: Floats | None, least_distances: Floats | None
    ) -> tuple[Added, Floats]:
        """Returns the tables of costs for kernels, and bounds at knots, shape (2, K + 1, R).

        Args:
            kinds: of the K stages, see `Program`.
            shares: their lengths, see `Program`.
            times: of the knots [s]; None: phases have free durations.
            least_distances: of all pairs of shapes [m].

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
        if least_distances is not None:
            lower[len(lower) - len(self.pairs) :] = least_distances[self.pairs]
        bounds = np.where(places, lower, -np.inf), np.where(places, upper, np.inf)
        return Added(*self.tape, is_running, factors, np.array(self.pairs)), np.stack(bounds)


def _differentiate(builder: TapeBuilder, world: Coordinates, function: Sum) -> list[Sum]:
    """Returns the derivatives of a sum over (q, v, u) along (δ, v, u)."""
    moves = [builder.differentiate_along(function, rates) for rates in world.rates]
    others = range(world.num_positions, len(builder.variables))
    return [*moves, *(builder.differentiate(function, c) for c in others)]


def _average(one: Sum, other: Sum) -> Sum:
    return {each: (one.get(each, 0.0) + other.get(each, 0.0)) / 2 for each in {**one, **other}}


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


_NOTHING = Coordinates(np.zeros(0, dtype=np.bool_), *(np.zeros(0, dtype=object),) * 2)
NO_TERMS = AddedTerms((), TapeBuilder([]).build([], []), _NOTHING, _NO_PAIRS)


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
    first = {"q": 0, "v": n, "u": n + world.num_velocities}
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
