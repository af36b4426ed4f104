"""Figures of studies of random scenarios: functions of axes and data.

Ours is vermilion and heavy, rivals are cool and light. The colors are Okabe and Ito's, made to be
told apart with any color vision; dashes and markers say the same once more.

The part of the results page on random scenarios.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import cycle, product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator, PercentFormatter

from benchmarks.study.page import add_figure
from benchmarks.study.scenario_question import PLANNER, RANGES, RESTITUTIONS, command_of
from benchmarks.study.scenario_study import ScenarioResult, ScenarioStudy
from benchmarks.study.scenario_tables import describe_unit, markdown_study

_OURS: dict[str, Any] = {"color": "#D55E00", "linewidth": 3.2, "zorder": 3}
_RIVAL_COLORS = ("#0072B2", "#56B4E9", "#009E73", "#CC79A7", "#555555")
_RIVAL_DASHES = ("-", (0, (5, 2)), (0, (1, 1.3)))
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


def _line_styles(methods: Iterable[str]) -> Iterable[tuple[str, dict[str, Any]]]:
    rivals = cycle(product(_RIVAL_DASHES, _RIVAL_COLORS))
    for method in methods:
        if method == PLANNER:
            yield method, _OURS
        else:
            dashes, color = next(rivals)
            yield method, {"color": color, "linestyle": dashes, "linewidth": 1.6}


_INTRODUCTION = """\
## Random scenarios

A point mass before a wall is to end at its goal, with little control. The exact optimum J* of each
scenario is computed by algebra (`paper.rigid_optimum`), which no method knows. A method succeeds
if the control that it offers, replayed event-driven on a rigid wall, costs at most 1.01 J* + 10⁻⁷.
Time is CPU time of one core, libraries and kernels loaded. Methods other than `aigto`, the planner,
end as soon as they succeed, or with their last budget.
"""
# For a legend above or below all panels, in inches.
_LEGEND_WIDTH = 8.7


def describe_scenarios(paths: Sequence[Path], page: Path) -> Iterator[str]:
    """Yields the part of a page on studies of random scenarios, and draws their figures."""
    yield _INTRODUCTION
    for path in paths:
        yield from _describe(path, page)


def _describe(path: Path, page: Path) -> Iterator[str]:
    study = ScenarioStudy.load(path)
    question = study.question
    has_rivals = any(method != PLANNER for method in question.methods)
    title = "The planner against others" if has_rivals else "The planner"
    yield f"### {title}: {question.count:,} scenarios, seed {question.seed}\n"
    yield f"    {command_of(question)}\n"
    (start, velocity, goal), e = RANGES.values(), ", ".join(f"{each:g}" for each in RESTITUTIONS)
    yield (
        f"p₀ ∈ {_span(start)} m, v₀ ∈ {_span(velocity)} m/s, p_f ∈ {_span(goal)} m, e ∈ {{{e}}}, "
        f"mass = 1 kg, T = 1 s, N = {question.num_steps}. "
        f"The unit of time, 1×, is {describe_unit(study)}.\n"
    )
    yield f"{markdown_study(study)}\n"
    if not study.is_complete:
        yield "Not all of these scenarios are done with all methods.\n"
    for kind in _FIGURES if has_rivals else ("map",):
        draw, caption = _FIGURES[kind]
        yield add_figure(page, f"{path.stem}_{kind}", draw(study), caption)


def draw_success(study: ScenarioStudy) -> Figure:
    """Returns success against time, a panel for each restitution."""
    groups = study.groups()
    figure = Figure(figsize=(3.1 * len(groups) + 2.2, 3.6), layout="constrained")
    row: list[Axes] = list(figure.subplots(1, len(groups), sharey=True, squeeze=False)[0])
    for axes, (name, results) in zip(row, groups.items(), strict=True):
        plot_success_over_time(axes, study, results)
        axes.set_title(f"{name} ({len(results)} scenarios)", fontsize="medium")
    row[0].set_ylabel("scenarios solved")
    figure.legend(*row[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
    return figure


def draw_map(study: ScenarioStudy) -> Figure:
    """Returns maps over (v₀, p_f), one for each method; of one method, one for each restitution."""
    panels = _map_panels(study)
    columns = min(len(panels), 4 if len(panels) > 6 else 3)
    rows = math.ceil(len(panels) / columns)
    width = max(_LEGEND_WIDTH, 2.7 * columns + 0.6)
    figure = Figure(figsize=(width, 2.5 * rows + 0.7), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, (prefix, method, results) in zip(grid.flat, panels, strict=False):
        plot_map(axes, study, results, method)
        axes.set_title(f"{prefix}{axes.get_title()}", fontsize="medium")
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    for axes in grid.flat[len(panels) - columns : len(panels)]:
        axes.tick_params(labelbottom=True)  # Nothing is below.
    figure.supxlabel("initial velocity v₀ [m/s]")
    figure.supylabel("goal p_f [m]")
    labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside upper center", ncols=4, frameon=False)
    return figure


def _map_panels(study: ScenarioStudy) -> list[tuple[str, str, tuple[ScenarioResult, ...]]]:
    """Returns what each map's title starts with, whose it is, and its results."""
    methods, groups = study.question.methods, study.groups()
    if len(methods) > 1:
        return [("", method, study.results) for method in methods]
    return [(f"{name}, ", methods[0], results) for name, results in groups.items()]


# Name → what draws it, and its caption; of the planner alone there is the map.
_FIGURES: dict[str, tuple[Callable[[ScenarioStudy], Figure], str]] = {
    "success": (draw_success, "Share of scenarios solved over time, a panel for each restitution"),
    "map": (
        draw_map,
        "Scenarios over initial velocity and goal: which mode is optimal, and which are missed",
    ),
}


def _span(ends: tuple[float, float]) -> str:
    return f"[{ends[0]:g}, {ends[1]:g}]".replace("-", "−")
