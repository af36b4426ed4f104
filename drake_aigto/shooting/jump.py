"""Where a phase starts: an impact on rigid walls, and the phase's duration."""

from __future__ import annotations

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.jit import inner
from drake_aigto.shooting.flow import clear
from drake_aigto.shooting.mechanism import factor_mass
from drake_aigto.shooting.strike import strike
from drake_aigto.shooting.tape import run_tape


@inner
def jump(
    code: Ints,
    numbers: Floats,
    rubs: Floats,
    closed: Bools,
    leans: Floats,
    restitution: float,
    nx: int,
    z: Floats,
    duration: float,
    has_slopes: bool,
    values: Floats,
    sums: Floats,
    factor: Floats,
    slopes: Floats,
    support: Floats,
    grip: Floats,
    by_force: Floats,
    after: Floats,
    F: Floats,
    l1: Floats,
    l2: Floats,
) -> None:
    """Computes the state (q, v⁺, τ, t) after the start of a phase; with derivatives if asked.

    Contacts that are struck change the velocity (`strike`): the one that is hit, if any, and all
    that are held from then on. The duration, a control, becomes τ.
    """
    nz = z.size
    for i in range(nz):
        after[i] = z[i]
    after[nx] = duration
    if has_slopes:
        clear(l1, l2)
        clear(l1, F)
        for i in range(nz):
            F[i, i] = 1.0
        F[nx, nx], F[nx, nz] = 0.0, 1.0
    if not closed.any():
        return
    n = nx // 2
    run_tape(code, numbers, z[:nx], has_slopes, values, sums)
    factor_mass(n, sums, factor)
    strike(
        closed,
        leans,
        restitution,
        z,
        has_slopes,
        rubs,
        sums,
        factor,
        support,
        grip,
        by_force,
        after,
        slopes,
    )
    if has_slopes:
        for i in range(n):
            for c in range(2 * n):
                F[n + i, c] += slopes[c, i]
