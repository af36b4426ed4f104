"""Motions that a search keeps: the best, no two near each other, and how often each was found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.planning.candidate import HARDLY, Origin
from drake_aigto.planning.search import scaled
from drake_aigto.shooting import ShootingResult

# Motions that are kept, at most, no two near each other; and the least difference of their costs.
MOST_KEPT, _SAME = 8, 1e-3
# Every second renewal is of the best motion, the others are of one of this many.
MOST_RENEWED = 4
# Motions whose positions differ by no more than this, relative to their scales, have one optimum.
_NEAR = 0.05
# Motions that cost at most this times the best are near it, as far as a chance of better ones goes,
# unless they are hardly better than no control.
_NEARLY = 1.1
# Motions that cost more than this times the best are refined only if none of the others holds: in
# space, where costs fall most, refining takes off up to 72 %, and a polish up to a half.
_FAR = 10.0


@dataclass(frozen=True, eq=False)
class KeptMotion:
    """A motion that the search keeps.

    Attributes:
        origin: where it came from.
        result: of shooting.
        rank: whether it violates bounds or a hard goal by much; J, plus a price for violations.
        found: how many searches found it that did not begin with it.
    """

    origin: Origin
    result: ShootingResult
    rank: tuple[bool, float]
    found: int = 1

    @property
    def cost(self) -> float:
        """Its J, plus a price for violations of bounds and a hard goal."""
        return self.rank[1]


def keep(
    motions: Sequence[KeptMotion], found: KeptMotion, parent: KeptMotion | None, scales: Floats
) -> list[KeptMotion]:
    """Returns the motions to keep, the best first, once another one was found.

    Args:
        motions: that are kept.
        found: the other one, which is kept if it is among the best, and no better one is near.
        parent: the motion that its search began with, if any.
        scales: of positions, shape (nq,).
    """
    near = [known for known in motions if are_same(known, found, scales)]
    anew = parent is None or not are_same(parent, found, scales)
    times = near[0].found + anew if near else 1
    if not all(is_better(found, known) for known in near):
        near, found = near[:1], near[0]
    others = [known for known in motions if known not in near]
    return best_of([*others, replace(found, found=times)])


def best_of(motions: Sequence[KeptMotion]) -> list[KeptMotion]:
    """Returns the best motions, the best first."""
    return sorted(motions, key=lambda each: each.rank)[:MOST_KEPT]


def find_limit(motions: Sequence[KeptMotion], count: int) -> float:
    """Returns the highest cost of a count of the best motions; infinite while fewer are kept.

    Motions that violate bounds or a hard goal by much do not count.
    """
    costs = [motion.cost for motion in motions if not motion.rank[0]][:count]
    return costs[-1] if costs and len(motions) >= count else np.inf


def part_far(motions: Sequence[KeptMotion]) -> tuple[list[KeptMotion], list[KeptMotion]]:
    """Returns the motions that may become the best ones, and those that cost far more."""
    most = scaled(_FAR, motions[0].cost) if motions else 0.0
    near = [each for each in motions if each.cost <= most]
    return near, [each for each in motions if each.cost > most]


def calc_chance(motions: Sequence[KeptMotion], searches: int, idle: float) -> float:
    """Returns the estimated chance that the next search finds a motion better than all.

    Of n searches, N came near the best, and s of these found what no other did. So the next
    comes near it with N / n, finds something new there with (s + ½) / N (Good and Turing), and
    any of those N + 1 is as likely to be the best: (s + ½) / (n (N + 1)). While the best is hardly
    better than no control, how often that was found tells nothing, and the chance is 1.

    Args:
        motions: that are kept, the best first.
        searches: n.
        idle: the cost of the uncontrolled motion.
    """
    misses, cost = motions[0].rank
    limit = misses, min(scaled(_NEARLY, cost), idle - HARDLY * abs(idle))
    near = [motion.found for motion in motions if motion.rank <= limit]
    return (near.count(1) + 0.5) / (searches * (sum(near) + 1)) if near else 1.0


def is_better(motion: KeptMotion, known: KeptMotion) -> bool:
    """Returns whether a motion costs less, or as much with fewer touches.

    One optimum has many sequences, with touches that hardly push. Each touch makes it more
    likely that a simulation deviates.
    """
    costs_same = abs(motion.cost - known.cost) <= _SAME * abs(known.cost)
    fewer = len(motion.result.touches) - len(known.result.touches)
    if motion.rank[0] == known.rank[0] and costs_same and fewer:
        return fewer < 0
    return motion.rank < known.rank


def are_same(one: KeptMotion, other: KeptMotion, scales: Floats) -> bool:
    """Returns whether two motions lead to one optimum, by cost or by path.

    Args:
        one: a motion.
        other: another one.
        scales: of positions, shape (nq,).
    """
    if abs(one.cost - other.cost) <= _SAME * abs(one.cost):
        return True
    (mine, yours), n = (one.result, other.result), len(scales)
    path = yours.states[:, :n]
    if not np.array_equal(mine.times, yours.times):
        path = interpolate(mine.times, yours.times, path)
    return bool(np.max(np.abs(mine.states[:, :n] - path) / scales) < _NEAR)
