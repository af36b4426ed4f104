"""The part of the results page on random scenarios."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.study.page import Images, Section
from benchmarks.study.scenario_figures import plot_costs, plot_map, plot_success_over_time
from benchmarks.study.scenario_question import ScenarioQuestion
from benchmarks.study.scenario_runs import PLANNER
from benchmarks.study.scenario_study import ScenarioResult, ScenarioStudy
from benchmarks.study.scenario_tables import describe_unit, markdown_study
from benchmarks.study.study import command_of

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


def _describe(path: Path, images: Images) -> Iterator[str]:
    study = ScenarioStudy.load(path)
    question = study.question
    has_rivals = any(method != PLANNER for method in question.methods)
    title = "The planner against others" if has_rivals else "The planner"
    yield f"### {title}: {question.count:,} scenarios, seed {question.seed}\n"
    yield f"    {command_of(question)}\n"
    yield (
        f"p₀ {_span(question, 'start')} m, v₀ {_span(question, 'velocity')} m/s, "
        f"p_f {_span(question, 'goal')} m, e {_span(question, 'restitution')}, "
        f"mass {_span(question, 'mass')} kg, T {_span(question, 'duration')} s, "
        f"N = {question.num_steps}. The unit of time, 1×, is {describe_unit(study)}.\n"
    )
    yield f"{markdown_study(study)}\n"
    if not study.is_complete:
        yield "Not all of these scenarios are done with all methods.\n"
    for kind in _FIGURES if has_rivals else ("map",):
        draw, caption = _FIGURES[kind]
        yield images.add(f"{path.stem}_{kind}", draw(study), caption)


SCENARIOS = Section(_INTRODUCTION, _describe)


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


def draw_costs(study: ScenarioStudy) -> Figure:
    """Returns bars of cost classes: a row for each restitution, a column for each budget."""
    groups, budgets = study.groups(), study.question.budgets
    height = 0.24 * len(study.question.methods) + 0.5
    width = max(_LEGEND_WIDTH, 2.6 * len(budgets) + 1.8)
    figure = Figure(figsize=(width, height * len(groups) + 0.6), layout="constrained")
    grid = figure.subplots(len(groups), len(budgets), sharex=True, sharey=True, squeeze=False)
    for row, (name, results) in zip(grid, groups.items(), strict=True):
        for axes, budget in zip(row, budgets, strict=True):
            plot_costs(axes, study, results, budget)
            axes.set_title(f"{name}, {budget:g}×", fontsize="medium")
    # Shared, the axis has been turned over once for each panel.
    grid[0, 0].set_ylim(len(study.question.methods) - 0.5, -0.5)
    labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(*labels, loc="outside lower center", ncols=len(labels[0]), frameon=False)
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
    "costs": (
        draw_costs,
        "How far above the exact optimum each method ends: shares of scenarios, after each budget",
    ),
    "map": (
        draw_map,
        "Scenarios over initial velocity and goal: which mode is optimal, and which are missed",
    ),
}


def _span(question: ScenarioQuestion, name: str) -> str:
    """Returns a spread in words: of one value, of several, or of a range."""
    spread = getattr(question, name)
    values = [f"{value:g}".replace("-", "−") for value in spread.values]
    if spread.is_range:
        return f"∈ [{', '.join(values)}]"
    return f"= {values[0]}" if len(values) == 1 else f"∈ {{{', '.join(values)}}}"
