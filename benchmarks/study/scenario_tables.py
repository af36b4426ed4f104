"""Studies of random scenarios as Markdown, and as text about what it means."""

from __future__ import annotations

import math
from collections.abc import Iterator

from benchmarks.study.page import markdown_table
from benchmarks.study.scenario_question import PLANNER
from benchmarks.study.scenario_study import (
    MethodSummary,
    ScenarioStudy,
    count_right_boxes,
    summarize,
)
from drake_aigto.show import WIDTH, task_items

_LEGEND = """\
optimal   the best control so far, replayed on a rigid wall, costs at most 1.01 J* + 1e-7 J; J* is
          exact, and no method knows it; × is one unit of time: {unit}
cost / J* in the end, where J* > 1e-7 J; methods other than aigto end as soon as they are optimal
seconds   of one core, the median"""


def format_study(study: ScenarioStudy) -> str:
    """Returns a study's table, what it means, and what failed."""
    legend = _LEGEND.format(unit=describe_unit(study))
    return "\n".join([markdown_study(study), "", legend, *_notes(study)])


def markdown_study(study: ScenarioStudy) -> str:
    """Returns shares of success, ratios and seconds as a Markdown table."""
    budgets = [f"optimal at {budget:g}×" for budget in _shown_budgets(study)]
    last = "median cost / J*", "worst", "seconds", "failed"
    head = ["e", "method", "scenarios", *budgets, *last]
    rows = []
    for name, results in study.groups().items():
        for method in study.question.methods:
            summary = summarize(study, results, method)
            label, count = name.removeprefix("e = "), str(summary.num_scenarios)
            rows.append([label, method, count, *_cells(study, summary)])
    return markdown_table(head, rows)


def describe_unit(study: ScenarioStudy) -> str:
    """Returns what the budgets are multiples of."""
    seconds = study.question.seconds_per_unit
    return f"{seconds:g} s" if seconds else f"what {PLANNER} took on the same scenario"


def ratio_text(ratio: float) -> str:
    """Returns a ratio of costs as text."""
    if math.isnan(ratio):
        return "-"
    if math.isinf(ratio):
        return "none"
    if ratio < 1.1:
        return f"{ratio:.6f}"
    return f"{ratio:.2f}" if ratio < 1000 else f"{ratio:.0e}"


def _shown_budgets(study: ScenarioStudy) -> tuple[float, ...]:
    """Returns the budgets, if any method but the planner has them."""
    budgets = study.question.budgets
    return budgets[:1] if study.question.methods == (PLANNER,) else budgets


def _cells(study: ScenarioStudy, summary: MethodSummary) -> list[str]:
    """Returns one method's shares of success, ratios and seconds."""
    count = summary.num_scenarios
    shares = [f"{100 * optimal / count:.1f} %" for optimal in summary.num_optimal if count]
    shares += [""] * (len(_shown_budgets(study)) - len(shares))
    return [
        *shares,
        ratio_text(summary.median_ratio),
        ratio_text(summary.worst_ratio),
        f"{summary.median_seconds:.2f}" if count else "-",
        str(summary.num_errors or ""),
    ]


def failures(study: ScenarioStudy) -> Iterator[str]:
    """Yields what is not done, and a line for each different error of each method."""
    if not study.is_complete:
        yield f"Not done: {study.num_asked - study.num_runs} runs."
    for method in study.question.methods:
        for error in summarize(study, study.results, method).errors:
            text = " ".join(f"{method} failed: {error}".split())
            yield text if len(text) <= WIDTH else f"{text[: WIDTH - 1]}…"


def _notes(study: ScenarioStudy) -> Iterator[str]:
    """Yields what the boxes say, what is not done, and what failed."""
    yield from _box_lines(study)
    if PLANNER in study.question.methods:
        yield from _misses(study)
    yield from failures(study)


def _box_lines(study: ScenarioStudy) -> Iterator[str]:
    each, either, count = count_right_boxes(study.results)
    if count:
        yield (
            f"Boxes alone, before any polish, have the optimum's number of contacts in {either} of "
            f"{count}:"
        )
        yield f"by rung {', '.join(map(str, each))}."


def _misses(study: ScenarioStudy) -> Iterator[str]:
    for result in study.of_method(PLANNER):
        if not study.succeeds(result, PLANNER, 1.0):
            items = ", ".join(task_items(study.question.scenario(result.number)))
            ratio = ratio_text(result.runs[PLANNER].cost / result.optimum)
            told = f"{items}, e = {result.restitution:g}; cost / J* {ratio}"
            yield f"{PLANNER} missed scenario {result.number}: {told}"
