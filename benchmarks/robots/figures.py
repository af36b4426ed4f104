"""The figures that are asked for, of plans."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.robots.compare import RobotStudy
from benchmarks.robots.results import Row
from benchmarks.robots.table import NEAR, find_part
from benchmarks.robots.worlds import WORLDS

_PLAN = "plan"
# Between soft walls: CPU seconds of a plan, and how far off J Drake's replay is, in parts of it.
_SECONDS, _OFF = 1.0, 0.01


def find_figures(results: RobotStudy) -> Iterator[tuple[str, float, float]]:
    """Yields what is measured in each world, how much it is, and at most how much is asked for."""
    for world in results.question.worlds:
        rows = [row for row in results.results if row.world == world]
        if rows and _PLAN in results.question.methods:
            yield from _find_world(world, rows)


def _find_world(world: str, rows: Sequence[Row]) -> Iterator[tuple[str, float, float]]:
    plans = [next(each for each in row.outcomes if each.method == _PLAN) for row in rows]
    off = [not plan.cost <= (1 + NEAR) * row.best for row, plan in zip(rows, plans, strict=True)]
    of = f"{len(rows)} of {WORLDS[world].count} questions"
    yield (
        f"{world}: plans off the best known by more than 1 %, share in {of}",
        float(np.mean(off)),
        WORLDS[world].off,
    )
    if not WORLDS[world].is_soft:
        return
    yield f"{world}: CPU seconds a plan, median", float(np.median([p.cpu for p in plans])), _SECONDS
    drake = [find_part(plan.drake, plan.cost) for plan in plans if plan.drake is not None]
    yield f"{world}: Drake's replay off the cost, median", float(np.median(drake or [np.inf])), _OFF
