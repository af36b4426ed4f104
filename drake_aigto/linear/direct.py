"""Small dense systems, and LDLᵀ of bands, positive definite or indefinite, for kernels to call.

LAPACK has no factorization of symmetric indefinite bands that keeps the band and has the inertia:
its symmetric indefinite routines fill it, and its banded LU does not count negative eigenvalues.
`factorize_indefinite` eliminates unknowns in order from a small dense front, like a multifrontal
method on a chain (Duff & Reid 1983, "The multifrontal solution of indefinite sparse symmetric
linear equations", ACM TOMS 9:302-325): an unknown may be eliminated once every unknown it is
coupled to has entered the front; 1×1 and 2×2 pivots must pass a threshold test against the whole
front, and wait until one does.

Shape letters there: size unknowns, half bandwidth b, front capacity F.
"""

from __future__ import annotations

from drake_aigto.arrays import Floats, Ints
from drake_aigto.kernels import borrowing, kernel, njit


@borrowing
def solve_factored(size: int, L: Floats, y: Floats) -> None:
    """Overwrites the first entries of y by (L Lᵀ)⁻¹ y, L being of this size."""
    for i in range(size):
        for k in range(i):
            y[i] -= L[i, k] * y[k]
        y[i] /= L[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            y[i] -= L[k, i] * y[k]
        y[i] /= L[i, i]


@borrowing
def add_rows(
    scale: float, factors: Floats, column: int, rows: Floats, count: int, out: Floats
) -> None:
    """Adds scale Σ_k factors[k, column] rows[k], of the first rows, to a vector.

    Sums are those of one row at a time, to the last bit: four of them are read and written as one.
    """
    for block in range(count // 4):
        k = 4 * block
        a, b = scale * factors[k, column], scale * factors[k + 1, column]
        c, d = scale * factors[k + 2, column], scale * factors[k + 3, column]
        w, x, y, z = rows[k], rows[k + 1], rows[k + 2], rows[k + 3]
        for i in range(out.size):
            out[i] = out[i] + a * w[i] + b * x[i] + c * y[i] + d * z[i]
    for k in range(count - count % 4, count):
        a, w = scale * factors[k, column], rows[k]
        for i in range(out.size):
            out[i] += a * w[i]


@borrowing
def factor_in_place(size: int, least: float, A: Floats) -> None:
    """Overwrites the first rows of A by L and R with A = L R, of which L has ones on its diagonal.

    Rows keep their order: A is nearly symmetric and positive. Pivots are at least a part `least` of
    the diagonal in size.
    """
    for i in range(size):
        floor = least * abs(A[i, i])
        for j in range(size):
            for k in range(min(i, j)):
                A[i, j] -= A[i, k] * A[k, j]
            if j < i:
                A[i, j] /= A[j, j]
        if abs(A[i, i]) < floor:
            A[i, i] = floor


@borrowing
def solve_factors(size: int, A: Floats, y: Floats) -> None:
    """Overwrites the first entries of y by (L R)⁻¹ y, with both in A (`factor_in_place`)."""
    for i in range(size):
        for k in range(i):
            y[i] -= A[i, k] * y[k]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            y[i] -= A[i, k] * y[k]
        y[i] /= A[i, i]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def factorize_band(band: Floats) -> bool:
    """Overwrites a matrix with its LDLᵀ factors, L and in place of its ones D⁻¹.

    For half bandwidths up to some 50 this is quicker than LAPACK's `dpbtrf`, which calls BLAS for
    every column, on a few numbers; beyond some 60 it is slower. Zeros within the band, of which
    chains of stages have many, are passed over.

    Args:
        band: In LAPACK's lower band storage, transposed: entry (i, j), i ≥ j, at [j, i − j].

    Returns:
        Whether it is positive definite; if not, it is spoilt.
    """
    size, width = band.shape
    for j in range(size):
        if not band[j, 0] > 0.0:
            return False
        inverse = 1.0 / band[j, 0]
        below = min(width, size - j)
        while below > 1 and band[j, below - 1] == 0.0:
            below -= 1
        for a in range(1, below):
            if band[j, a] == 0.0:
                continue
            factor = inverse * band[j, a]
            for d in range(below - a):
                band[j + a, d] -= factor * band[j, a + d]
        for a in range(1, below):
            band[j, a] *= inverse
        band[j, 0] = inverse
    return True


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def solve_band(factors: Floats, x: Floats) -> None:
    """Overwrites a right-hand side (size,) with the solution."""
    size, width = factors.shape
    for j in range(size):
        for a in range(1, min(width, size - j)):
            x[j + a] -= factors[j, a] * x[j]
    for j in range(size - 1, -1, -1):
        value = factors[j, 0] * x[j]
        for a in range(1, min(width, size - j)):
            value -= factors[j, a] * x[j + a]
        x[j] = value


# Relative size that a pivot must have. Small, since the matrices of an interior point method are
# badly scaled on purpose; refinement makes up for it.
_THRESHOLD = 1e-8


@borrowing
def _swap(front: Floats, active: Ints, i: int, j: int, count: int) -> None:
    """Exchanges two unknowns of the front."""
    if i == j:
        return
    active[i], active[j] = active[j], active[i]
    for k in range(count):
        front[i, k], front[j, k] = front[j, k], front[i, k]
    for k in range(count):
        front[k, i], front[k, j] = front[k, j], front[k, i]


@borrowing
def _largest(front: Floats, i: int, without: int, count: int) -> float:
    """Returns the largest entry of row i in absolute value, but for columns i and `without`."""
    largest = 0.0
    for k in range(count):
        if k not in (i, without):
            largest = max(largest, abs(front[i, k]))
    return largest


@borrowing
def _is_pair_stable(front: Floats, i: int, j: int, count: int) -> bool:
    """Tests a 2×2 pivot: whether |P⁻¹| times its rows' largest entries is at most 1/u."""
    a, b, c = abs(front[i, i]), abs(front[i, j]), abs(front[j, j])
    determinant = abs(front[i, i] * front[j, j] - front[i, j] * front[i, j])
    if not determinant > 1e-14 * b * b:
        return False
    rest_i, rest_j = _largest(front, i, j, count), _largest(front, j, i, count)
    growth = max(c * rest_i + b * rest_j, a * rest_j + b * rest_i)
    return _THRESHOLD * growth <= determinant


@borrowing
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


@borrowing
def _force_pivot(front: Floats, active: Ints, count: int, summed: int) -> int:
    """Returns the largest diagonal entry among unknowns below `summed`, −1 if all are 0."""
    chosen, largest = -1, 0.0
    for i in range(count):
        if active[i] < summed and abs(front[i, i]) > largest:
            chosen, largest = i, abs(front[i, i])
    return chosen


@borrowing
def _enter(band: Floats, front: Floats, active: Ints, count: int, unknown: int) -> None:
    """Puts an unknown's row into the front, as its last."""
    bandwidth = band.shape[1] - 1
    for k in range(count):
        distance = unknown - active[k]
        entry = band[active[k], distance] if distance <= bandwidth else 0.0
        front[count, k] = front[k, count] = entry
    front[count, count] = band[unknown, 0]
    active[count] = unknown


@borrowing
def _eliminate_one(
    front: Floats, active: Ints, count: int, indices: Ints, entries: Floats, fill: int
) -> int:
    """Takes unknown `count` out, appends its column of L, and returns the new fill."""
    pivot = front[count, count]
    for k in range(count):
        factor = front[count, k] / pivot
        if factor == 0.0:
            continue
        indices[fill], entries[fill] = active[k], factor
        fill += 1
        for j in range(count):
            front[k, j] -= factor * front[count, j]
    return fill


@borrowing
def _eliminate_pair(
    front: Floats, active: Ints, count: int, indices: Ints, entries: Floats, fill: int
) -> int:
    """Takes unknowns `count` and `count` + 1 out together, as `_eliminate_one` does with one."""
    a, b, c = front[count, count], front[count, count + 1], front[count + 1, count + 1]
    determinant = a * c - b * b
    for k in range(count):
        first, second = front[count, k], front[count + 1, k]
        if first == 0.0 and second == 0.0:
            continue
        factor_1 = (c * first - b * second) / determinant
        factor_2 = (a * second - b * first) / determinant
        indices[fill], entries[fill], entries[fill + 1] = active[k], factor_1, factor_2
        fill += 2
        for j in range(count):
            front[k, j] -= factor_1 * front[count, j] + factor_2 * front[count + 1, j]
    return fill


@kernel
def factorize_indefinite(
    band: Floats,
    front: Floats,
    active: Ints,
    pivots: Ints,
    inverses: Floats,
    starts: Ints,
    indices: Ints,
    entries: Floats,
) -> int:
    """Factorizes; returns the number of negative eigenvalues, −1 if singular.

    Args:
        band: Lower band storage, transposed (size, b + 1).
        front: Work space (F, F).
        active: Work space (F,): the unknowns in the front.
        pivots: Filled with the unknowns in order of elimination (size,); the first of a 2×2 pivot
            is stored as −1 − unknown.
        inverses: Filled with the pivots' inverses (size, 2): (1/d, ·), or the two rows of 2×2.
        starts: Filled so that pivot k's column of L is starts[k]:starts[k + 1] (size + 1,).
        indices: Filled with that column's unknowns.
        entries: Filled with its entries, pairs of them for the first of a 2×2 pivot.
    """
    size, bandwidth = band.shape[0], band.shape[1] - 1
    count = entered = done = fill = negative = 0
    while done < size:
        summed = size if entered == size else entered - bandwidth
        p, q = _choose_pivot(front, active, count, summed)
        if p < 0 and entered < size and count < active.size:
            _enter(band, front, active, count, entered)
            count, entered = count + 1, entered + 1
            continue
        if p < 0:
            p = _force_pivot(front, active, count, summed)
            if p < 0:
                return -1
        starts[done] = fill
        if q < 0:
            count -= 1
            _swap(front, active, p, count, count + 1)
            pivots[done], inverses[done, 0] = active[count], 1.0 / front[count, count]
            negative += front[count, count] < 0.0
            fill = _eliminate_one(front, active, count, indices, entries, fill)
            done += 1
            continue
        count -= 2
        _swap(front, active, max(p, q), count + 1, count + 2)
        _swap(front, active, min(p, q), count, count + 2)
        a, b, c = front[count, count], front[count, count + 1], front[count + 1, count + 1]
        determinant = a * c - b * b
        pivots[done], pivots[done + 1] = -1 - active[count], active[count + 1]
        inverses[done, 0], inverses[done, 1] = c / determinant, -b / determinant
        inverses[done + 1, 0], inverses[done + 1, 1] = -b / determinant, a / determinant
        negative += 1 if determinant < 0.0 else (2 if a < 0.0 else 0)
        fill = _eliminate_pair(front, active, count, indices, entries, fill)
        starts[done + 1] = fill
        done += 2
    starts[size] = fill
    return negative


@kernel
def solve_indefinite(
    pivots: Ints, inverses: Floats, starts: Ints, indices: Ints, entries: Floats, x: Floats
) -> None:
    """Overwrites a right-hand side (size,) with the solution; see `factorize_indefinite`."""
    size, k = pivots.size, 0
    while k < size:
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
    k = size - 1
    while k >= 0:
        if k == 0 or pivots[k - 1] >= 0:
            for e in range(starts[k], starts[k + 1]):
                x[pivots[k]] -= entries[e] * x[indices[e]]
            k -= 1
        else:
            k -= 1
            for e in range(starts[k], starts[k + 1], 2):
                x[-1 - pivots[k]] -= entries[e] * x[indices[e]]
                x[pivots[k + 1]] -= entries[e + 1] * x[indices[e]]
            k -= 1
