"""LDLᵀ of symmetric indefinite band matrices: solutions and inertia.

LAPACK has no such factorization that keeps the band: its symmetric indefinite routines fill it, and
its banded LU does not tell how many eigenvalues are negative. This one eliminates unknowns in order
from a small dense front, like a multifrontal method on a chain (Duff & Reid 1983, "The multifrontal
solution of indefinite sparse symmetric linear equations", ACM TOMS 9:302-325): an unknown may be
eliminated once every unknown it is coupled to has entered the front; 1×1 and 2×2 pivots must pass a
threshold test against the whole front, and wait until one does.

Shape letters: size unknowns, half bandwidth b, front capacity F.
"""

from __future__ import annotations

from typing import NamedTuple

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import kernel

# Relative size that a pivot must have. Small, since the matrices of an interior point method are
# badly scaled on purpose; refinement makes up for it.
_THRESHOLD = 1e-8


class Columns(NamedTuple):
    """L and D in the order of elimination: room for them, filled by `factorize`.

    Attributes:
        pivots: The unknowns (size,); the first of a 2×2 pivot is stored as −1 − unknown.
        inverses: Inverses of the pivots (size, 2): (1/d, ·), or the two rows of 2×2.
        starts: Pivot k's column of L is starts[k]:starts[k + 1] (size + 1,).
        indices: That column's unknowns.
        entries: Its entries, pairs of them for the first of a 2×2 pivot.
    """

    pivots: Ints
    inverses: Floats
    starts: Ints
    indices: Ints
    entries: Floats


@kernel
def _swap(front: Floats, active: Ints, i: int, j: int, count: int) -> None:
    """Exchanges two unknowns of the front."""
    if i == j:
        return
    active[i], active[j] = active[j], active[i]
    for k in range(count):
        front[i, k], front[j, k] = front[j, k], front[i, k]
    for k in range(count):
        front[k, i], front[k, j] = front[k, j], front[k, i]


@kernel
def _largest(front: Floats, i: int, without: int, count: int) -> float:
    """Returns the largest entry of row i in absolute value, but for columns i and `without`."""
    largest = 0.0
    for k in range(count):
        if k not in (i, without):
            largest = max(largest, abs(front[i, k]))
    return largest


@kernel
def _is_pair_stable(front: Floats, i: int, j: int, count: int) -> bool:
    """Tests a 2×2 pivot: whether |P⁻¹| times its rows' largest entries is at most 1/u."""
    a, b, c = abs(front[i, i]), abs(front[i, j]), abs(front[j, j])
    determinant = abs(front[i, i] * front[j, j] - front[i, j] * front[i, j])
    if not determinant > 1e-14 * b * b:
        return False
    rest_i, rest_j = _largest(front, i, j, count), _largest(front, j, i, count)
    growth = max(c * rest_i + b * rest_j, a * rest_j + b * rest_i)
    return _THRESHOLD * growth <= determinant


@kernel
def _choose_pivot(front: Floats, active: Ints, count: int, summed: int) -> tuple[int, int]:
    """Returns the first pivot that passes, of those `summed`: (i, −1), (i, j) or (−1, −1)."""
    for i in range(count):
        if active[i] >= summed:
            continue
        partner, nearest, largest = -1, 0.0, 0.0
        for k in range(count):
            entry = abs(front[i, k])
            if k == i:
                continue
            largest = max(largest, entry)
            if active[k] < summed and entry > nearest:
                partner, nearest = k, entry
        if front[i, i] != 0.0 and abs(front[i, i]) >= _THRESHOLD * largest:
            return i, -1
        if partner >= 0 and _is_pair_stable(front, i, partner, count):
            return i, partner
    return -1, -1


@kernel
def _force_pivot(front: Floats, active: Ints, count: int, summed: int) -> int:
    """Returns the largest diagonal entry among unknowns below `summed`, −1 if all are 0."""
    chosen, largest = -1, 0.0
    for i in range(count):
        if active[i] < summed and abs(front[i, i]) > largest:
            chosen, largest = i, abs(front[i, i])
    return chosen


@kernel
def _enter(band: Floats, front: Floats, active: Ints, count: int, unknown: int) -> None:
    """Puts an unknown's row into the front, as its last."""
    bandwidth = band.shape[0] - 1
    for k in range(count):
        distance = unknown - active[k]
        entry = band[distance, active[k]] if distance <= bandwidth else 0.0
        front[count, k] = front[k, count] = entry
    front[count, count] = band[0, unknown]
    active[count] = unknown


@kernel
def _eliminate_one(
    front: Floats, active: Ints, i: int, count: int, to: Columns, done: int, fill: int
) -> tuple[int, int]:
    """Takes the front's unknown i out, which leaves `count`.

    Returns:
        How far L is filled now, and the number of negative eigenvalues of the pivot.
    """
    _swap(front, active, i, count, count + 1)
    pivot = front[count, count]
    to.pivots[done], to.inverses[done, 0], to.starts[done] = active[count], 1.0 / pivot, fill
    for k in range(count):
        factor = front[count, k] / pivot
        if factor == 0.0:
            continue
        to.indices[fill], to.entries[fill] = active[k], factor
        fill += 1
        for m in range(count):
            front[k, m] -= factor * front[count, m]
    return fill, 1 if pivot < 0.0 else 0


@kernel
def _eliminate_pair(
    front: Floats, active: Ints, i: int, j: int, count: int, to: Columns, done: int, fill: int
) -> tuple[int, int]:
    """Takes unknowns i and j out together, as `_eliminate_one` does with one."""
    _swap(front, active, max(i, j), count + 1, count + 2)
    _swap(front, active, min(i, j), count, count + 2)
    a, b, c = front[count, count], front[count, count + 1], front[count + 1, count + 1]
    determinant = a * c - b * b
    to.pivots[done], to.pivots[done + 1], to.starts[done] = (
        -1 - active[count],
        active[count + 1],
        fill,
    )
    to.inverses[done, 0], to.inverses[done, 1] = c / determinant, -b / determinant
    to.inverses[done + 1, 0], to.inverses[done + 1, 1] = -b / determinant, a / determinant
    for k in range(count):
        first, second = front[count, k], front[count + 1, k]
        if first == 0.0 and second == 0.0:
            continue
        factor_1 = (c * first - b * second) / determinant
        factor_2 = (a * second - b * first) / determinant
        to.indices[fill], to.entries[fill], to.entries[fill + 1] = active[k], factor_1, factor_2
        fill += 2
        for m in range(count):
            front[k, m] -= factor_1 * front[count, m] + factor_2 * front[count + 1, m]
    to.starts[done + 1] = fill
    return fill, 1 if determinant < 0.0 else (2 if a < 0.0 else 0)


@kernel
def factorize(band: Floats, front: Floats, active: Ints, to: Columns) -> int:
    """Returns the number of negative eigenvalues of a matrix, −1 if it is singular.

    Args:
        band: Lower band storage (b + 1, size).
        front: Work space (F, F).
        active: Work space (F,): the unknowns in the front.
        to: Filled.
    """
    bandwidth, size = band.shape[0] - 1, band.shape[1]
    count = entered = done = fill = negative = 0
    while done < size:
        summed = size if entered == size else entered - bandwidth
        i, j = _choose_pivot(front, active, count, summed)
        if i < 0 and entered < size and count < active.size:
            _enter(band, front, active, count, entered)
            count, entered = count + 1, entered + 1
            continue
        if i < 0:
            i = _force_pivot(front, active, count, summed)
            if i < 0:
                return -1
        width = 1 if j < 0 else 2
        count -= width
        if j < 0:
            fill, signs = _eliminate_one(front, active, i, count, to, done, fill)
        else:
            fill, signs = _eliminate_pair(front, active, i, j, count, to, done, fill)
        negative, done = negative + signs, done + width
    to.starts[size] = fill
    return negative


@kernel
def solve(by: Columns, x: Floats) -> None:
    """Overwrites a right-hand side (size,) with the solution."""
    pivots, inverses, starts, indices, entries = by
    k = 0
    while k < pivots.size:
        if pivots[k] >= 0:
            value = x[pivots[k]]
            for e in range(starts[k], starts[k + 1]):
                x[indices[e]] -= entries[e] * value
            x[pivots[k]] = inverses[k, 0] * value
            k += 1
        else:
            i, j = -1 - pivots[k], pivots[k + 1]
            first, second = x[i], x[j]
            for e in range(starts[k], starts[k + 1], 2):
                x[indices[e]] -= entries[e] * first + entries[e + 1] * second
            x[i] = inverses[k, 0] * first + inverses[k, 1] * second
            x[j] = inverses[k + 1, 0] * first + inverses[k + 1, 1] * second
            k += 2
    _substitute(by, x)


@kernel
def _substitute(by: Columns, x: Floats) -> None:
    """Multiplies x (size,) by L⁻ᵀ, from the last pivot back."""
    pivots, _, starts, indices, entries = by
    k = pivots.size - 1
    while k >= 0:
        if k == 0 or pivots[k - 1] >= 0:
            for e in range(starts[k], starts[k + 1]):
                x[pivots[k]] -= entries[e] * x[indices[e]]
            k -= 1
        else:
            for e in range(starts[k - 1], starts[k], 2):
                x[-1 - pivots[k - 1]] -= entries[e] * x[indices[e]]
                x[pivots[k]] -= entries[e + 1] * x[indices[e]]
            k -= 2
