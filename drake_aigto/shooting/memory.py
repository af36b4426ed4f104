"""Room for a solver to work in."""

from __future__ import annotations

import numpy as np

from drake_aigto.shooting.mechanics import make_mechanics_memory
from drake_aigto.shooting.tables import (
    Expansion,
    FlowMemory,
    Memory,
    ModeMemory,
    Program,
    SweepMemory,
)


def make_memory(program: Program, num_stages: int, nz: int) -> Memory:
    """Returns room for a problem of so many stages, with nz values of state."""
    nu = program.task.control.size
    return Memory(
        flow=_make_flow_memory(program, nz + nu),
        modes=_make_mode_memory(program),
        expansion=Expansion(
            F=np.zeros((num_stages, nz, nz + nu)),
            l1=np.zeros((num_stages + 1, nz + nu)),
            l2=np.zeros((num_stages + 1, nz + nu, nz + nu)),
            gaps=np.zeros((num_stages, nz)),
        ),
        sweep=_make_sweep_memory(num_stages, nz, nu),
        states=np.zeros((num_stages + 1, nz)),
        controls=np.zeros((num_stages, nu)),
    )


def _make_flow_memory(program: Program, columns: int) -> FlowMemory:
    nx = 2 * program.mechanics.actuation.shape[0]
    return FlowMemory(
        mechanics=make_mechanics_memory(program.mechanics),
        points=np.zeros((7, nx)),
        by_column=np.zeros(columns),
        slopes=np.zeros((4, nx, columns)),
    )


def _make_mode_memory(program: Program) -> ModeMemory:
    n, nu = program.mechanics.actuation.shape
    m = len(program.mechanics.contacts)
    return ModeMemory(
        values=np.zeros((m, 3)),
        slopes=np.zeros((m, 3, 2 * n + nu)),
        weights=np.zeros((m, 3)),
        after=np.zeros(2 * n),
    )


def _make_sweep_memory(num_stages: int, nz: int, nu: int) -> SweepMemory:
    return SweepMemory(
        feedforward=np.zeros((num_stages, nu)),
        gains=np.zeros((num_stages, nu, nz)),
        V1=np.zeros(nz),
        V2=np.zeros((nz, nz)),
        v1=np.zeros(nz),
        VF=np.zeros((nz, nz + nu)),
        Q1=np.zeros(nz + nu),
        Q2=np.zeros((nz + nu, nz + nu)),
        H=np.zeros((nu, nu)),
        factor=np.zeros((nu, nu)),
        is_free=np.zeros(nu, dtype=np.int64),
        room=np.zeros((6, nu)),
    )
