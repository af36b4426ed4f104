"""The study of robustness as a table, at most 100 columns wide, and as a figure.

The part of the results page on robustness.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import numpy as np
from matplotlib.figure import Figure

from benchmarks.robustness.question import QUANTITIES, RANDOM
from benchmarks.robustness.study import (
    DRAKE,
    FEEDBACK,
    GRADIENT,
    OPEN_LOOP,
    OURS,
    Outcome,
    PlanResult,
    RobustnessStudy,
    TaskResult,
)
from benchmarks.study.page import Images, Section, markdown_table
from benchmarks.study.study import command_of
from drake_aigto.show import WIDTH, length_text, task_items

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_T = TypeVar("_T")

_NAME = 22
_GROUP = (("median", 8), ("worst", 8), ("miss", 8), ("same", 6))
_COLUMNS = (*_GROUP, *_GROUP, ("worst", 8), ("possible", 9))
_LEGEND = """\
ours, gradient  the planner's plan, and what IPOPT makes of flight that touches nothing
start … random  one quantity at a time, more and less, and all at once: start and wall by parts of
                the first distance from the wall, others by parts of themselves; e at most 1
median, worst   J of the control that was applied, on an exactly rigid wall
miss            the largest goal error
same            how often the contacts were those of the plan
LQR             feedback from bounce to bounce, by Riccati's equation
Drake           with this feedback on Drake's plant, its compliant wall
possible        the median of the exact optima, for who knows of the perturbation beforehand"""
# The way a plan is carried out: marker, and how far from the middle of its task.
_MARKS = {OPEN_LOOP: ("x", -0.12), FEEDBACK: ("o", 0.12)}
_COLORS = {OURS: "tab:blue", GRADIENT: "tab:orange"}
_APART = {OURS: -0.2, GRADIENT: 0.2}


def format_robustness(study: RobustnessStudy) -> str:
    """Returns the study: what each plan costs under perturbations, and all of it in short."""
    size = f"± {study.question.percent:g} %"
    blocks = [line for result in study.results for line in _block(result, size)]
    return "\n".join([*blocks, "", _LEGEND, "", *_summary_lines(study)])


def _block(result: TaskResult, size: str) -> Iterator[str]:
    """Yields the lines of one task."""
    yield ""
    yield f"{result.name}: {', '.join(task_items(result.scenario))}; optimum {result.optimum:.2e}"
    middle, sides = sum(width for _, width in _GROUP), "-"
    groups = [f" {name} ".center(middle, sides)[1:] for name in (OPEN_LOOP, FEEDBACK)]
    yield f"{'':{_NAME}} {groups[0]} {groups[1]}   Drake"
    yield _join("", (name for name, _ in _COLUMNS))
    for plan in result.plans:
        yield from _plan_lines(result, plan, size)


def _plan_lines(result: TaskResult, plan: PlanResult, size: str) -> Iterator[str]:
    if plan.error is not None:
        yield f"  {plan.method}: {plan.error}"[:WIDTH]
        return
    bounces = ", ".join(f"{time:.3f} s" for time in plan.bounce_times)
    yield (
        f"  {plan.method}: {plan.cost:.2e}, {length_text(plan.goal_error)} off the goal, "
        f"{f'bounce at {bounces}' if bounces else 'no bounce'} "
    ).ljust(WIDTH, "-")
    for kind in (*QUANTITIES, RANDOM):
        if kind in result.kinds:
            cells = [
                *_group(_select(result, plan, OPEN_LOOP, kind)),
                *_group(_select(result, plan, FEEDBACK, kind)),
                _worst(_select(result, plan, DRAKE, kind)),
                f"{_median(_of_kind(result, result.optima, kind)):.1e}",
            ]
            yield _join(f"    {kind} {size}", cells)


def _group(outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    kept = sum(outcome.keeps_contacts for outcome in outcomes)
    return (
        f"{_median(outcome.cost for outcome in outcomes):.1e}",
        _worst(outcomes),
        length_text(max(outcome.goal_error for outcome in outcomes)),
        f"{kept}/{len(outcomes)}",
    )


def _worst(outcomes: Sequence[Outcome]) -> str:
    return f"{max(outcome.cost for outcome in outcomes):.1e}" if outcomes else "-"


def _join(name: str, cells: Iterable[str]) -> str:
    texts = (cell.rjust(width) for cell, (_, width) in zip(cells, _COLUMNS, strict=True))
    return (name.ljust(_NAME) + "".join(texts)).rstrip()


def _select(result: TaskResult, plan: PlanResult, way: str, kind: str) -> list[Outcome]:
    """Returns the outcomes under perturbations of one kind; none of a way that was not tried."""
    return _of_kind(result, plan.outcomes[way], kind) if way in plan.outcomes else []


def _of_kind(result: TaskResult, values: Sequence[_T], kind: str) -> list[_T]:
    return [value for value, each in zip(values, result.kinds, strict=True) if each == kind]


def _median(values: Iterable[float]) -> float:
    return float(np.median(list(values)))


class Summary(NamedTuple):
    """All random perturbations of all tasks, for one way to carry out one method's plans."""

    name: str
    ratio: float  # J / the exact optimum under the perturbation: the median
    above: tuple[float, float]  # J − J of the plan unperturbed: median and largest
    miss: tuple[float, float]  # goal error: median and largest [m]
    kept: int  # how often contacts were as planned,
    total: int  # of so many times


def summarize(study: RobustnessStudy) -> list[Summary]:
    """Returns the summary of each method's plans and each way to carry them out."""
    found = []
    for method in (OURS, GRADIENT):
        for way in (OPEN_LOOP, FEEDBACK, DRAKE):
            runs = [
                (outcome, plan.cost, optimum)
                for result in study.results
                for plan in result.plans
                if plan.method == method and way in plan.outcomes
                for outcome, optimum in zip(
                    _of_kind(result, plan.outcomes[way], RANDOM),
                    _of_kind(result, result.optima, RANDOM),
                    strict=True,
                )
            ]
            if runs:
                found.append(_summarize(f"{method}, {way}", runs))
    return found


def _summarize(name: str, runs: Sequence[tuple[Outcome, float, float]]) -> Summary:
    above = [outcome.cost - planned for outcome, planned, _ in runs]
    misses = [outcome.goal_error for outcome, _, _ in runs]
    return Summary(
        name,
        _median(outcome.cost / optimum for outcome, _, optimum in runs),
        (_median(above), max(above)),
        (_median(misses), max(misses)),
        sum(outcome.keeps_contacts for outcome, _, _ in runs),
        len(runs),
    )


def _summary_lines(study: RobustnessStudy) -> Iterator[str]:
    yield f"All tasks, everything ± {study.question.percent:g} % at random:"
    yield f"{'':32}{'J / possible':>12}{'J − unperturbed':>20}{'goal error':>20}{'same':>14}"
    yield f"{'':32}{'median':>12}{'median':>10}{'worst':>10}{'median':>10}{'worst':>10}"
    for row in summarize(study):
        above = "".join(f"{cost:>10.1e}" for cost in row.above)
        misses = "".join(f"{length_text(miss):>10}" for miss in row.miss)
        kept = f"{row.kept} of {row.total}"
        yield f"  {row.name:30}{row.ratio:>12.4g}{above}{misses}{kept:>14}"


def markdown_robustness(study: RobustnessStudy) -> str:
    """Returns the summary as a table in Markdown."""
    head = [
        *("plan", "J / possible, median", "J − J unperturbed, median", "worst"),
        *("goal error, median", "worst", "contacts as planned"),
    ]
    rows = (
        [
            row.name,
            f"{row.ratio:.4g}",
            *(f"{cost:.1e}" for cost in row.above),
            *(length_text(miss) for miss in row.miss),
            f"{row.kept} of {row.total}",
        ]
        for row in summarize(study)
    )
    return markdown_table(head, rows)


def plot_robustness(
    axes: Axes, study: RobustnessStudy, results: Sequence[TaskResult] | None = None
) -> None:
    """Draws the costs of every task under random perturbations, open loop and with feedback.

    A dot for each perturbation, on a logarithmic scale; bars where the exact optima under them lie.

    Args:
        axes: to draw in; a place for each task from left to right.
        study: with random perturbations.
        results: those of its tasks that are drawn; all if None.
    """
    results = study.results if results is None else results
    for place, result in enumerate(results):
        optima = _of_kind(result, result.optima, RANDOM)
        if optima:
            axes.vlines(place, min(optima), max(optima), color="black", linewidth=4, alpha=0.4)
        for plan in result.plans:
            for way, (marker, aside) in _MARKS.items():
                costs = [outcome.cost for outcome in _select(result, plan, way, RANDOM)]
                at = np.full(len(costs), place + _APART[plan.method] + aside)
                color = _COLORS[plan.method]
                axes.plot(at, costs, marker, color=color, markersize=4, alpha=0.6)
    axes.plot([], [], color="black", linewidth=4, alpha=0.4, label="possible")
    for method, color in _COLORS.items():
        for way, (marker, _) in _MARKS.items():
            axes.plot([], [], marker, color=color, markersize=4, label=f"{method}, {way}")
    names = [result.name for result in results]
    axes.set_xticks(range(len(names)), names, rotation=30, ha="right")
    axes.set(yscale="log", ylabel=f"cost, all ± {study.question.percent:g} %")
    axes.grid(axis="y", which="both", alpha=0.2)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=5, fontsize="small")


_INTRODUCTION = """\
## Robustness

Plans where the truth is a little other than they were made for: start, velocity, wall, mass and
restitution, all at once and at random. *Ours* is the planner's plan, *gradient* what IPOPT makes of
flight that touches nothing. Open loop the plan's control runs as it is; with LQR, feedback
(gains from Riccati's equation on each flight) tracks the plan and goes on to its next flight when
the ball bounces. *Possible* is the exact optimum under a perturbation that is known beforehand.
"""
_TASKS_A_ROW = 12


def _describe(path: Path, images: Images) -> Iterator[str]:
    study = RobustnessStudy.load(path)
    question = study.question
    yield f"### Everything ± {question.percent:g} %\n"
    yield f"    {command_of(question)}\n"
    yield f"{markdown_robustness(study)}\n"
    if len(study.results) < len(question.tasks()):
        yield "Not all of these tasks are done.\n"
    for result in study.results:
        for plan in result.plans:
            if plan.error is not None:
                yield f"- {result.name}, {plan.method}: {plan.error}\n"
    yield images.add(
        f"{path.stem}_costs",
        draw_robustness(study),
        "Costs under random perturbations of every task: ours and the gradient solver's plan, open "
        "loop and with feedback, and what is possible",
    )


ROBUSTNESS = Section(_INTRODUCTION, _describe)


def draw_robustness(study: RobustnessStudy) -> Figure:
    """Returns the costs of every task under random perturbations, some tasks a row."""
    starts = range(0, len(study.results), _TASKS_A_ROW)
    figure = Figure(figsize=(9.0, 0.6 + 3.0 * len(starts)), layout="constrained")
    column = figure.subplots(len(starts), squeeze=False)[:, 0]
    for axes, start in zip(column, starts, strict=True):
        plot_robustness(axes, study, study.results[start : start + _TASKS_A_ROW])
        if start:
            axes.get_legend().remove()
    return figure
