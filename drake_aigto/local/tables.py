"""Many `TermBlock`s as one set of flat arrays, so that one call of a kernel walks them all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drake_aigto.box import Term, TermBlock
from drake_aigto.local.kernels import Tables

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def stack_tables(blocks: Sequence[TermBlock]) -> Tables:
    """The arrays that the kernels walk, described there; blocks of equal terms share one table."""
    table_of: dict[tuple[Term, ...], int] = {}
    for block in blocks:
        table_of.setdefault(block.terms, len(table_of))
    flat = {block.terms: block.kernel_arguments[2:] for block in blocks}
    parts = [flat[terms] for terms in table_of]
    copies = [len(block.variables) for block in blocks]
    return (
        np.repeat(np.array([table_of[b.terms] for b in blocks], dtype=np.int64), copies),
        _offsets(np.repeat(_integers([b.variables.shape[1] for b in blocks]), copies)),
        _join_ints([b.variables.ravel() for b in blocks]),
        _offsets(_integers([variable.size for variable, *_ in parts])),
        _offsets(_integers([coefficients.size for *_, coefficients, _, _ in parts])),
        _join_ints([variable for variable, *_ in parts]),
        _join_ints([kind for _, kind, *_ in parts]),
        _join_ints([exponent for _, _, exponent, *_ in parts]),
        _join_floats([scale for _, _, _, scale, *_ in parts]),
        _join_floats([offset for *_, offset, _, _, _ in parts]),
        _join_floats([coefficients for *_, coefficients, _, _ in parts]),
        _offsets(_join_ints([np.diff(starts) for *_, starts, _ in parts])),
        _join_ints([members for *_, members in parts]),
    )


def _integers(values: Sequence[int]) -> Ints:
    return np.array(values, dtype=np.int64)


def _join_ints(parts: Sequence[Ints]) -> Ints:
    return np.concatenate([np.empty(0, dtype=np.int64), *parts])


def _join_floats(parts: Sequence[Floats]) -> Floats:
    return np.concatenate([np.empty(0), *parts])


def _offsets(lengths: Ints) -> Ints:
    """Where each of these lengths starts in their concatenation, and where the last ends."""
    return np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(lengths)])
