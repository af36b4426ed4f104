"""The comparison as a table, at most 100 columns wide.

The figures that are asked for, of plans.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.robots.compare import Outcome, RobotStudy, Row
from benchmarks.robots.worlds import WORLDS

NEAR, WIDE = 0.01, 0.05
_LESS = 1e-3  # what counts as less than what was known

_LEGEND = """\
1 %, 5 %    share of questions within so much of the best known by anything, by the judge's cost
below       share where it is lower than what was known before, by more than 0.1 %
CPU, wall   seconds of all attempts: median, and what nine in ten stay under
hit         CPU seconds until within 1 % of the best known, median of those that come there
off         of its promise from the judge's cost, median and nine in ten; Drake: the same replayed
            there, from the judge's"""
_COLUMNS = {"1 %": 8, "5 %": 8, "below": 8, "CPU": 13, "wall": 13, "hit": 7, "off": 14, "Drake": 14}
_HEAD = " " * 15 + "".join(f"{name:>{width}}" for name, width in _COLUMNS.items())


def format_results(results: RobotStudy) -> str:
    """Returns the table of each world: all questions, and those that start deep apart."""
    lines = [_LEGEND]
    for world in results.question.worlds:
        rows = [row for row in results.results if row.world == world]
        deep = [row for row in rows if row.is_deep]
        shallow = [row for row in rows if not row.is_deep]
        methods = results.question.methods_for(world)
        lines += _section(f"{world}: {len(shallow)} questions", shallow, methods)
        lines += _section(f"{world}, deep in a wall: {len(deep)} questions", deep, methods)
    return "\n".join(lines)


def _section(title: str, rows: Sequence[Row], methods: Sequence[str]) -> Iterator[str]:
    """Yields a table."""
    if not rows:
        return
    yield f"\n{title}"
    yield _HEAD
    for number, name in enumerate(methods):
        yield f"{name:15}" + _figures(rows, [row.outcomes[number] for row in rows])


def _figures(rows: Sequence[Row], outcomes: Sequence[Outcome]) -> str:
    """Returns the figures of one method."""
    pairs = list(zip(rows, outcomes, strict=True))
    shares = [
        np.mean([outcome.cost <= (1 + near) * row.best for row, outcome in pairs])
        for near in (NEAR, WIDE)
    ]
    shares.append(np.mean([outcome.cost < (1 - _LESS) * row.known for row, outcome in pairs]))
    hits = [first for row, outcome in pairs if (first := _first_hit(row, outcome)) is not None]
    off = [find_part(outcome.promised, outcome.cost) for outcome in outcomes if outcome.steps]
    drake = [find_part(each.drake, each.cost) for each in outcomes if each.drake is not None]
    return "".join(
        [
            *(f"{100 * share:6.1f} %" for share in shares),
            *(_pair([getattr(each, kind) for each in outcomes], 2) for kind in ("cpu", "wall")),
            f"{np.median(hits):7.2f}" if hits else f"{'-':>7}",
            *(_pair([100 * part for part in parts], 2, " %") for parts in (off, drake)),
        ]
    )


def _first_hit(row: Row, outcome: Outcome) -> float | None:
    """Returns when a method first came within 1 % of the best known."""
    bound = (1 + NEAR) * row.best
    return next((step.seconds for step in outcome.steps if step.cost <= bound), None)


def find_part(value: float, cost: float) -> float:
    """Returns how far a value is off a cost, in parts of it."""
    return abs(value / cost - 1.0) if math.isfinite(cost) else math.inf


def _pair(values: Sequence[float], digits: int, unit: str = "") -> str:
    """Returns the median and what nine in ten stay under."""
    width = 14 if unit else 13
    if not values:
        return f"{'-':>{width}}"
    middle, most = np.quantile(values, [0.5, 0.9], method="inverted_cdf")
    return f"{f'{middle:.{digits}f} {most:.{digits}f}{unit}':>{width}}"


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
