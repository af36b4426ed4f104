"""The tapes of many sums as one set of flat arrays, copies side by side, and rows of these tapes.

Functions of rows take no slices and no more arrays than they read (`box.kernels`).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Floats, Ints, Records, locked
from drake_aigto.box.functions import TRANSCENDENTAL, factor_mean, trigonometric_means
from drake_aigto.box.tapes import MEAN, ONES, OPERATION, MeanTape, Order, make_tape
from drake_aigto.kernels import borrowing, inner
from drake_aigto.terms import FACTOR, SUM, FunctionKind, StackedTerms


# Records, so that kernels have few arrays to take and read one place in memory for each.
def _integers(*names: str) -> np.dtype[np.void]:
    return np.dtype([(name, np.int64) for name in names], align=True)


LANE = _integers("copy", "first_variable", "first_coefficient")
ARGUMENT = np.dtype(
    [("variable", np.int64), ("scale", np.float64), ("offset", np.float64)], align=True
)
SLOPE = _integers("row", "variable", "unknown")
CURVATURE = _integers("row", "variable", "unknown", "other_variable", "other_unknown")
TAPE = _integers(
    *("first_lane", "first_operation", "first_slope", "first_curvature"),
    *("first_argument", "first_function", "num_variables", "num_terms"),
)

# Copies that run a tape side by side at most: enough for a processor's vector units, few enough for
# its caches. Tapes of very many rows have fewer, so that lanes hold no more than `_MOST_NUMBERS`.
_MOST_LANES = 64
_MOST_NUMBERS = 2**17
_FEW = 1000  # Tapes of sums with fewer copies and factors are kept.


class Lanes(NamedTuple):
    """Tables of kernels: for each tape its copies, each of which is a lane.

    Entries of a tape end where those of the next one start; a last entry marks the end. All arrays
    are read-only.

    Attributes:
        lanes: The copies in the order of their tapes, with first variable and coefficient (C,).
        copy_variables: Variables of the copies, as in `StackedTerms`.
        coefficients: Of the terms, one sum after the other (M + 1,).
        tapes: First entry of each tape in the arrays here, and its numbers, see `MeanTape`.
        operations, arguments, functions, slopes, curvatures: See `MeanTape`.
        most_lanes: How many lanes run side by side at most.
        most_rows: Largest number of rows that a tape has.
        most_variables: Largest number of local variables that a tape has.
        transcendental: True, or None if no function's kind is among `TRANSCENDENTAL`: of another
            type, so that kernels are compiled without them.
        are_magnitudes: Whether each term is to count as its absolute value, for order MEAN and half
            widths of 0.
    """

    lanes: Records
    copy_variables: Ints
    coefficients: Floats
    tapes: Records
    operations: Records
    arguments: Records
    functions: Records
    slopes: Records
    curvatures: Records
    most_lanes: int
    most_rows: int
    most_variables: int
    transcendental: bool | None
    are_magnitudes: bool


def make_lanes(stacked: StackedTerms, order: Order) -> Lanes:
    """Returns the lanes of some sums, for derivatives of an order."""
    sums = stacked.copies["sum_index"]
    parts = stacked.factors, stacked.members, stacked.terms["first_member"], stacked.sums, sums
    make = _make_and_keep if stacked.members.size + sums.size <= _FEW else _make_tapes
    sum_tapes, tapes = make(order, *(part.tobytes() for part in parts))
    copies = np.lexsort((sums, sum_tapes[sums]))
    lanes = np.empty(copies.size, dtype=LANE)
    lanes["copy"] = copies
    lanes["first_variable"] = stacked.copies["first_variable"][copies]
    lanes["first_coefficient"] = stacked.sums["first_term"][sums[copies]]
    return tapes._replace(
        lanes=locked(lanes),
        copy_variables=stacked.copy_variables,
        coefficients=stacked.coefficients,
    )


def _make_tapes(
    order: Order, factors: bytes, members: bytes, starts: bytes, sums: bytes, sum_of_copy: bytes
) -> tuple[Ints, Lanes]:
    """Returns the tape of each sum, and lanes without copies, for sums as `StackedTerms` has them.

    Arrays are given as bytes, which can be looked up.
    """
    all_factors = np.frombuffer(factors, FACTOR).tolist()
    all_members, first_members = (np.frombuffer(each, int).tolist() for each in (members, starts))
    number_of: dict[MeanTape, int] = {}
    numbers = []
    for (factor, term), (last_factor, last_term) in itertools.pairwise(
        np.frombuffer(sums, SUM).tolist()
    ):
        terms = itertools.pairwise(first_members[term : last_term + 1])
        groups = tuple(tuple(all_members[start:end]) for start, end in terms)
        tape = make_tape(tuple(all_factors[factor:last_factor]), groups, order)
        numbers.append(number_of.setdefault(tape, len(number_of)))
    sum_tapes, tapes = np.array(numbers, dtype=np.int64), tuple(number_of)
    counts = np.bincount(sum_tapes[np.frombuffer(sum_of_copy, int)], minlength=len(tapes))
    most_rows = max((tape.num_rows for tape in tapes), default=1)
    most_lanes = min(_MOST_LANES, _MOST_NUMBERS // most_rows, int(np.max(counts, initial=1)))
    starts_of = np.zeros(6, dtype=np.int64)  # Where the entries of the next tape start.
    records = []
    for tape, count in zip(tapes, counts.tolist(), strict=True):
        records.append((*starts_of.tolist(), tape.num_variables, tape.num_terms))
        parts = tape.operations, tape.slopes, tape.curvatures, tape.arguments, tape.functions
        starts_of += [count, *(len(part) for part in parts)]
    kinds = np.frombuffer(factors, FACTOR)["kind"]
    return sum_tapes, Lanes(
        lanes=np.empty(0, LANE),
        copy_variables=np.empty(0, np.int64),
        coefficients=np.empty(0),
        tapes=locked(np.array([*records, (*starts_of.tolist(), 0, 0)], TAPE)),
        operations=locked(
            np.concatenate([np.empty(0, OPERATION), *(tape.operations for tape in tapes)])
        ),
        arguments=_join((tape.arguments for tape in tapes), ARGUMENT),
        functions=_join((tape.functions for tape in tapes), FACTOR),
        slopes=_join((tape.slopes for tape in tapes), SLOPE),
        curvatures=_join((tape.curvatures for tape in tapes), CURVATURE),
        most_lanes=max(1, most_lanes),
        most_rows=most_rows,
        most_variables=max((tape.num_variables for tape in tapes), default=0),
        transcendental=True if np.any(np.isin(kinds, TRANSCENDENTAL)) else None,
        are_magnitudes=False,
    )


# A polish has the same few sums as the one before, with other coefficients and bounds.
_make_and_keep = lru_cache(maxsize=64)(_make_tapes)


def _join(lists: Iterable[Iterable[Any]], dtype: np.dtype[np.void]) -> Records:
    """Returns the entries of some lists as one array."""
    return locked(np.array(list(itertools.chain(*lists)), dtype))


PARTS = 6  # of a factor's mean: value and derivatives
_COSINE = int(FunctionKind.COSINE)


@borrowing
def load_arguments(
    arguments: Records,
    tape: Any,
    after: Any,
    variables: Ints,
    count: int,
    center: Floats,
    half_width: Floats,
    rows: Floats,
) -> int:
    """Sets the rows of ones and of a tape's arguments; returns the next row."""
    row = MEAN + 1
    for k in range(count):
        rows[ONES, k] = 1.0
    for a in range(tape.first_argument, after.first_argument):
        argument = arguments[a]
        variable, scale, offset = argument.variable, argument.scale, argument.offset
        for k in range(count):
            i = variables[variable, k]
            reach = scale * half_width[i]
            rows[row, k] = scale * center[i] + offset
            rows[row + 1, k] = reach * reach
        row += 2
    return row


@borrowing
def load_functions(
    functions: Records,
    tape: Any,
    after: Any,
    transcendental: bool | None,
    variables: Ints,
    count: int,
    center: Floats,
    half_width: Floats,
    parts: Floats,
    waves: Floats,
    rows: Floats,
    row: int,
) -> int:
    """Sets the rows of a tape's functions, from `row` on; returns the next row.

    Without derivatives of the tape, those of functions are left out. The last cosine and sine of
    each variable are kept, with scale, offset and exponent behind them (n, 15): copies of a chain
    read those of one stage many times.
    """
    num_needed = PARTS if tape.first_slope < after.first_slope else 1
    for f in range(tape.first_function, after.first_function):
        it = functions[f]
        is_pair = it.kind == _COSINE
        for k in range(count):
            i = variables[it.variable, k]
            if is_pair:
                _keep_waves(it, i, center[i], half_width[i], waves, transcendental)
                for part in range(num_needed):
                    rows[row + part, k] = waves[i, part]
                    rows[row + PARTS + part, k] = waves[i, PARTS + part]
                continue
            box = center[i], half_width[i]
            factor_mean(it.kind, it.exponent, it.scale, it.offset, *box, parts, transcendental)
            for part in range(num_needed):
                rows[row + part, k] = parts[part]
        row += 2 * PARTS if is_pair else PARTS
    return row


@inner
def make_waves(num_variables: int, transcendental: bool | None) -> Floats:
    """Returns room for `_keep_waves`, if that is called, with nothing kept: no scale is 0."""
    if transcendental is None:
        return np.empty((0, 2 * PARTS + 3))
    waves = np.empty((num_variables, 2 * PARTS + 3))
    waves[:, 2 * PARTS] = 0.0
    return waves


@borrowing
def _keep_waves(
    it: Any, i: int, center: float, half_width: float, waves: Floats, transcendental: bool | None
) -> None:
    """Has the means of a variable's cosine and sine in row i of `waves`, with what they are of."""
    end, scale, offset, exponent = 2 * PARTS, it.scale, it.offset, it.exponent
    if waves[i, end] == scale and waves[i, end + 1] == offset and waves[i, end + 2] == exponent:
        return
    if transcendental is not None:  # Else Numba compiles without them.
        trigonometric_means(exponent, scale, offset, center, half_width, waves[i])
    waves[i, end], waves[i, end + 1], waves[i, end + 2] = scale, offset, exponent


@borrowing
def load_coefficients(
    coefficients: Floats,
    num_terms: int,
    lanes: Records,
    chosen: Ints,
    count: int,
    factors: Floats,
    rows: Floats,
    row: int,
) -> int:
    """Sets the rows of a tape's coefficients times factors, from `row` on; returns the next row."""
    first = lanes[chosen[0]].first_coefficient
    last = lanes[chosen[count - 1]].first_coefficient
    for m in range(num_terms):
        if first == last:  # Copies of one sum, as lanes are in the order of sums.
            for k in range(count):
                rows[row + m, k] = factors[k] * coefficients[first + m]
        else:
            for k in range(count):
                own = lanes[chosen[k]].first_coefficient
                rows[row + m, k] = factors[k] * coefficients[own + m]
    return row + num_terms
