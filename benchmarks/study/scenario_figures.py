"""Figures of studies of random scenarios: functions of axes and data.

Ours is vermilion and heavy, rivals are cool and light. The colors are Okabe and Ito's, made to be
told apart with any color vision; dashes and markers say the same once more.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import cycle, product
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator, PercentFormatter

from benchmarks.study.scenario_runs import PLANNER
from benchmarks.study.scenario_study import ScenarioResult, ScenarioStudy

_OURS: dict[str, Any] = {"color": "#D55E00", "linewidth": 3.2, "zorder": 3}
_RIVAL_COLORS = ("#0072B2", "#56B4E9", "#009E73", "#CC79A7", "#555555")
_RIVAL_DASHES = ("-", (0, (5, 2)), (0, (1, 1.3)))
# Classes of cost / J*, the last with more than that. The first is success.
_RATIOS = (1.1, 2.0, 10.0)
COST_CLASSES = (
    "optimal",
    *(f"up to {ratio:g} J*" for ratio in _RATIOS),
    f"above {_RATIOS[-1]:g} J*",
    "nothing found",
)
# Shares below this have no room for their number.
_WRITTEN_SHARE = 0.08
# Number of contacts of the optimum → what it is called, and how it looks where it is found.
_MODES: dict[int, tuple[str, dict[str, Any]]] = {
    0: ("flight", {"marker": "o", "color": "#56B4E9", "s": 16}),
    1: ("bounce", {"marker": "^", "color": "#E69F00", "s": 24}),
}
_MISSED: dict[str, Any] = {"color": "black", "zorder": 3}


def plot_success_over_time(
    axes: Axes, study: ScenarioStudy, results: Sequence[ScenarioResult]
) -> None:
    """Draws which share of results each method has solved by when, in units of time."""
    budgets = study.question.budgets
    first, last = 0.1 * budgets[0], budgets[-1]
    for method, style in _line_styles(study.question.methods):
        done = [result for result in results if method in result.runs]
        times = np.sort([_solving_time(study, result, method) for result in done])
        reached = times[times <= last]
        shares = np.arange(len(reached) + 1) / max(1, len(done))
        ends = [first, *np.maximum(reached, first), last]
        axes.step(ends, [*shares, shares[-1]], where="post", label=method, **style)
    _scale_shares(axes, budgets)


def _scale_shares(axes: Axes, budgets: Sequence[float]) -> None:
    first, last = 0.1 * budgets[0], budgets[-1]
    for budget in budgets:
        axes.axvline(budget, color="0.85", linewidth=0.8, zorder=0)
    axes.set(xscale="log", xlim=(first, last), ylim=(-0.02, 1.03))
    axes.xaxis.set_major_locator(FixedLocator([first, *budgets]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}×"))
    axes.yaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(axis="y", alpha=0.25)
    axes.set_xlabel("time on one core, in units")


def plot_costs(
    axes: Axes, study: ScenarioStudy, results: Sequence[ScenarioResult], budget: float
) -> None:
    """Draws a bar for each method: how far above the optimum it is after so many units of time."""
    methods = study.question.methods
    shares = np.array([_class_shares(study, results, method, budget) for method in methods])
    # Darkest is best; the optimum has our own color.
    shades = ["#D55E00", *map(tuple, colormaps["cividis"](np.linspace(0.15, 1.0, 4))), "white"]
    for number, (label, shade) in enumerate(zip(COST_CLASSES, shades, strict=True)):
        part, left = shares[:, number], shares[:, :number].sum(axis=1)
        edge: dict[str, Any] = {"edgecolor": "0.5", "linewidth": 0.5}
        bars = axes.barh(methods, part, left=left, color=shade, label=label, **edge)
        texts = [f"{100 * share:.0f}" if share >= _WRITTEN_SHARE else "" for share in part]
        ink = "white" if number < 3 else "black"
        axes.bar_label(bars, texts, label_type="center", color=ink, fontsize="x-small")
    axes.invert_yaxis()
    axes.set_xlim(0.0, 1.0)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))


def plot_map(
    axes: Axes, study: ScenarioStudy, results: Iterable[ScenarioResult], method: str
) -> None:
    """Draws results over (v₀, p_f): which mode is optimal, and where a method misses it.

    Those that the method is not done with are left out.
    """
    last = study.question.budgets[-1]
    done = [result for result in results if method in result.runs]
    missed = [result for result in done if not study.succeeds(result, method, last)]
    for contacts, (mode, style) in _MODES.items():
        for some, label, changes in ((done, "is optimal", {}), (missed, "is missed", _MISSED)):
            shown = [result for result in some if result.contacts == contacts]
            places = [each.velocity for each in shown], [each.goal for each in shown]
            axes.scatter(*places, linewidths=0, label=f"{mode} {label}", **{**style, **changes})
    axes.set_title(f"{method}: {len(done) - len(missed)} of {len(done)}", fontsize="medium")


def _solving_time(study: ScenarioStudy, result: ScenarioResult, method: str) -> float:
    """Returns when a method had the optimum, in units of time; infinity for never."""
    run, unit = result.runs[method], study.unit(result)
    if run.cost > result.good_enough or not unit:
        return np.inf
    return next(at for at, cost in run.improvements if cost <= result.good_enough) / unit


def _class_shares(
    study: ScenarioStudy, results: Iterable[ScenarioResult], method: str, budget: float
) -> list[float]:
    """Returns which share of scenarios is in each of the classes of costs."""
    counts = [0] * len(COST_CLASSES)
    for result in results:
        if method in result.runs:
            cost = study.cost(result, method, budget)
            bounds = [result.good_enough, *(ratio * result.optimum for ratio in _RATIOS)]
            above = sum(cost > bound for bound in np.maximum.accumulate(bounds))
            counts[above if np.isfinite(cost) else -1] += 1
    return [count / max(1, sum(counts)) for count in counts]


def _line_styles(methods: Iterable[str]) -> Iterable[tuple[str, dict[str, Any]]]:
    rivals = cycle(product(_RIVAL_DASHES, _RIVAL_COLORS))
    for method in methods:
        if method == PLANNER:
            yield method, _OURS
        else:
            dashes, color = next(rivals)
            yield method, {"color": color, "linestyle": dashes, "linewidth": 1.6}
