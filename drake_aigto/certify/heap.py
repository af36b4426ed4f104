"""Open cells of a branch and bound, the lowest bound first."""

from __future__ import annotations

from typing import NamedTuple

from drake_aigto.arrays import Floats, Ints
from drake_aigto.jit import inner, kernel


class Heap(NamedTuple):
    """Open cells.

    Attributes:
        keys: their bounds, in a heap.
        places: where each is in `low` and `high`.
        free: places that hold no cell.
        counts: open cells, free places.
        low: lower ends (C, n).
        high: upper ends (C, n).
    """

    keys: Floats
    places: Ints
    free: Ints
    counts: Ints
    low: Floats
    high: Floats


@inner
def copy(of: Floats, to: Floats) -> None:
    """Copies numbers, which takes Numba less time to compile than a slice."""
    for i in range(to.size):
        to[i] = of[i]


@inner
def copy_pairs(of: Floats, to: Floats) -> None:
    """Copies intervals (K, 2)."""
    for i in range(to.shape[0]):
        to[i, 0], to[i, 1] = of[i, 0], of[i, 1]


@inner
def _sink(heap: Heap, k: int) -> None:
    keys, places, count = heap.keys, heap.places, heap.counts[0]
    while 2 * k + 1 < count:
        child = 2 * k + 1
        if child + 1 < count and keys[child + 1] < keys[child]:
            child += 1
        if keys[k] <= keys[child]:
            return
        keys[k], keys[child] = keys[child], keys[k]
        places[k], places[child] = places[child], places[k]
        k = child


@kernel
def push(heap: Heap, key: float, low: Floats, high: Floats) -> None:
    """Opens a cell."""
    keys, places, free, counts, lows, highs = heap
    counts[1] -= 1
    place, k = free[counts[1]], counts[0]
    copy(low, lows[place])
    copy(high, highs[place])
    keys[k], places[k] = key, place
    counts[0] += 1
    while k > 0 and keys[(k - 1) // 2] > keys[k]:
        above = (k - 1) // 2
        keys[k], keys[above] = keys[above], keys[k]
        places[k], places[above] = places[above], places[k]
        k = above


@inner
def pop(heap: Heap) -> int:
    """Takes the cell of the lowest bound out, and returns its place."""
    keys, places, free, counts, _, _ = heap
    place = places[0]
    counts[0] -= 1
    keys[0], places[0] = keys[counts[0]], places[counts[0]]
    free[counts[1]] = place
    counts[1] += 1
    _sink(heap, 0)
    return place
