"""Impacts on rigid walls in modes that are given: impulses and their derivatives."""

from __future__ import annotations

from drake_aigto.arrays import Bools, Floats
from drake_aigto.jit import inner
from drake_aigto.linear import solve_factors
from drake_aigto.shooting.hold import clasp, turn
from drake_aigto.shooting.layout import find_row, find_slope


@inner
def strike(
    closed: Bools,
    leans: Floats,
    restitution: float,
    z: Floats,
    has_slopes: bool,
    rubs: Floats,
    sums: Floats,
    factor: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    after: Floats,
    slopes: Floats,
) -> None:
    """Computes what an impact does, of contacts that stick or slip in one direction all along.

        v⁺ = v + M⁻¹ Dᵀ p,   J v⁺ = −e J v,   T v⁺ = 0 of what sticks

    With C and D as in `hold`, both v⁺ and p are linear in v. Of one contact that is what Routh's
    construction leads to (`simulation.coulomb`) where Coulomb's inequalities hold (`cones`).

    Args:
        closed: which rows of C count: those of what is hit, and of what is held from then on.
        leans: −μ σ of what slips.
        restitution: e.
        z: the state before, (q, v, …).
        has_slopes: whether derivatives are computed, too.
        rubs: friction.
        sums: of the tape at the state, those of all slopes if derivatives are asked for.
        factor: of M.
        support: room, see `clasp`.
        grip: room; p becomes its last row.
        by_force: becomes the derivative of p by (q, v), transposed, if asked for.
        after: v⁺ becomes its entries n … 2n − 1.
        slopes: becomes the derivative of v⁺ − v by (q, v), transposed, if asked for.
    """
    n, m, w, count = support.shape[1], leans.size, closed.size, rubs.shape[0]
    clasp(closed, leans, n, rubs, sums, factor, support, grip)
    impulses = grip[w]
    for k in range(w):
        impulses[k] = 0.0
        row, gain = find_row(n, m, sums.size, count, k), 1 + restitution if k < m else 1.0
        for i in range(n if closed[k] else 0):
            impulses[k] -= gain * sums[row + i] * z[n + i]
    solve_factors(w, grip, impulses)
    for i in range(n):
        after[n + i] = z[n + i]
        for k in range(w):
            after[n + i] += support[k, i] * impulses[k]
    if has_slopes:
        turn(closed, leans, n, rubs, sums, factor, support, grip)
        _differentiate(
            n, m, closed, restitution, z, after, count, sums, support, grip, by_force, slopes
        )


@inner
def _differentiate(
    n: int,
    m: int,
    closed: Bools,
    restitution: float,
    z: Floats,
    after: Floats,
    count: int,
    sums: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    slopes: Floats,
) -> None:
    """Computes the derivatives of p and of M⁻¹ Dᵀ p by (q, v), transposed."""
    w = closed.size
    for c in range(2 * n):
        for i in range(n):
            slopes[c, i] = support[w + 1 + c, i] if c < n else 0.0
        for k in range(w):
            by_force[c, k] = 0.0
            if not closed[k]:
                continue
            row, e = find_row(n, m, sums.size, count, k), restitution if k < m else 0.0
            if c >= n:
                by_force[c, k] = -(1 + e) * sums[row + c - n]
                continue
            for i in range(n):
                bend = sums[find_slope(n, m, sums.size, count, k, i, c)]
                by_force[c, k] -= bend * (after[n + i] + e * z[n + i])
                by_force[c, k] -= sums[row + i] * slopes[c, i]
        solve_factors(w, grip, by_force[c])
        for k in range(w):
            for i in range(n):
                slopes[c, i] += support[k, i] * by_force[c, k]
