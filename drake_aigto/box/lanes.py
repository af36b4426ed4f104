"""The tapes of many sums, and which copies run them side by side, as one set of flat arrays."""

from __future__ import annotations

import itertools
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drake_aigto.arrays import Floats, Ints, Records, locked
from drake_aigto.box.functions import TRANSCENDENTAL
from drake_aigto.box.tapes import OPERATION, Order, Tape, make_tape
from drake_aigto.terms import FACTOR, StackedTerms


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
# its caches. Tapes of very many rows have fewer, so that all of them stay near so many numbers.
_MOST_LANES = 64
_MOST_NUMBERS = 2**17
# Of so few copies and factors stacks are remembered.
_FEW = 1000


class Lanes(NamedTuple):
    """What kernels read: for each tape its copies, each of which is a lane.

    What belongs to a tape ends where that of the next one starts, for which a last entry stands at
    the end. All arrays are read-only.

    Attributes:
        lanes: The copies in the order of their tapes, with first variable and coefficient (C,).
        copy_variables: Variables of the copies, as in `StackedTerms`.
        coefficients: Of the terms, one sum after the other (M + 1,).
        tapes: First entry of each tape in the arrays here, and its numbers, see `Tape`.
        operations, arguments, functions, slopes, curvatures: See `Tape`.
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


class _Bytes(NamedTuple):
    """An array that can be looked up."""

    content: bytes
    dtype: np.dtype[Any]

    def array(self) -> NDArray[Any]:
        """Returns the array again, read-only."""
        return np.frombuffer(self.content, self.dtype)


class _Stacks(NamedTuple):
    """What lanes have of the structure of sums alone.

    Attributes:
        sum_tapes: The tape of each sum.
        sizes: `Lanes.most_lanes`, `most_rows` and `most_variables`.
        transcendental: As `Lanes` has it.
        records: The tapes, operations, arguments, functions, slopes and curvatures, read-only.
    """

    sum_tapes: Ints
    sizes: tuple[int, int, int]
    transcendental: bool | None
    records: tuple[Records, Records, Records, Records, Records, Records]


def make_lanes(stacked: StackedTerms, order: Order) -> Lanes:
    """Returns the lanes of some sums, for derivatives of an order."""
    sums = stacked.copies["sum_index"]
    parts = stacked.factors, stacked.members, stacked.terms["first_member"], stacked.sums, sums
    make = _make_and_keep if stacked.members.size + sums.size <= _FEW else _make_stacks
    stacks = make(order, *(_Bytes(part.tobytes(), part.dtype) for part in parts))
    copies = np.lexsort((sums, stacks.sum_tapes[sums]))
    lanes = np.empty(copies.size, dtype=LANE)
    lanes["copy"] = copies
    lanes["first_variable"] = stacked.copies["first_variable"][copies]
    lanes["first_coefficient"] = stacked.sums["first_term"][sums[copies]]
    return Lanes(
        *(locked(lanes), stacked.copy_variables, stacked.coefficients, *stacks.records),
        *(*stacks.sizes, stacks.transcendental, False),
    )


def _make_stacks(
    order: Order,
    factors: _Bytes,
    members: _Bytes,
    first_members: _Bytes,
    sums: _Bytes,
    sum_of_copy: _Bytes,
) -> _Stacks:
    """Returns the stacks of sums as `StackedTerms` has them."""
    all_factors, all_members = factors.array().tolist(), members.array().tolist()
    starts = first_members.array().tolist()
    number_of: dict[Tape, int] = {}
    numbers = []
    for (factor, term), (last_factor, last_term) in itertools.pairwise(sums.array().tolist()):
        terms = zip(starts[term:last_term], starts[term + 1 : last_term + 1], strict=True)
        groups = tuple(tuple(all_members[start:end]) for start, end in terms)
        tape = make_tape(tuple(all_factors[factor:last_factor]), groups, order)
        numbers.append(number_of.setdefault(tape, len(number_of)))
    sum_tapes, tapes = np.array(numbers, dtype=np.int64), tuple(number_of)
    counts = np.bincount(sum_tapes[sum_of_copy.array()], minlength=len(tapes))
    most_rows = max((tape.num_rows for tape in tapes), default=1)
    most_lanes = min(_MOST_LANES, _MOST_NUMBERS // most_rows, int(np.max(counts, initial=1)))
    most_variables = max((tape.num_variables for tape in tapes), default=0)
    return _Stacks(
        sum_tapes,
        (max(1, most_lanes), most_rows, most_variables),
        True if np.any(np.isin(factors.array()["kind"], TRANSCENDENTAL)) else None,
        _stack(tapes, counts),
    )


# A polish has the same few sums as the one before, with other coefficients and bounds.
_make_and_keep = lru_cache(maxsize=64)(_make_stacks)


def _stack(
    tapes: tuple[Tape, ...], counts: Ints
) -> tuple[Records, Records, Records, Records, Records, Records]:
    """Returns the tapes, operations, arguments, functions, slopes and curvatures."""
    starts = np.zeros(6, dtype=np.int64)
    records = []
    for tape, count in zip(tapes, counts.tolist(), strict=True):
        records.append((*starts.tolist(), tape.num_variables, tape.num_terms))
        parts = tape.operations, tape.slopes, tape.curvatures, tape.arguments, tape.functions
        starts += [count, *(len(part) for part in parts)]
    records.append((*starts.tolist(), 0, 0))
    return (
        locked(np.array(records, dtype=TAPE)),
        locked(np.concatenate([np.empty(0, OPERATION), *(tape.operations for tape in tapes)])),
        locked(np.array([each for tape in tapes for each in tape.arguments], dtype=ARGUMENT)),
        locked(np.array([each for tape in tapes for each in tape.functions], dtype=FACTOR)),
        locked(np.array([each for tape in tapes for each in tape.slopes], dtype=SLOPE)),
        locked(np.array([each for tape in tapes for each in tape.curvatures], dtype=CURVATURE)),
    )
