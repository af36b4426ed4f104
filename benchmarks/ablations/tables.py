"""Studies of variants of the planner as text, at most 100 columns wide, and as Markdown."""

from __future__ import annotations

import math

from benchmarks.ablations.ablations import VARIANTS, count_lost_bounces
from benchmarks.study.page import markdown_table
from benchmarks.study.scenario_study import ScenarioStudy, count_right_boxes, summarize
from benchmarks.study.scenario_tables import failures, ratio_text

_LEGEND = """\
optimal   replayed on a rigid wall, costs at most 1.01 J* + 1e-7 J; J* is exact
cost / J* the median, where J* > 1e-7 J; none: most found nothing
seconds   of one core, the median
boxes     have as many contacts as the optimum, before any polish: those of the best rung, of any
lost      of all boxes of scenarios whose optimum has a bounce, those that show no contact
bare      only rungs around the straight line, and no neighbours of candidates"""
_HEADS = ("optimal", "cost / J*", "seconds", "best rung", "any rung", "lost")


def format_ablations(study: ScenarioStudy) -> str:
    """Returns a study's table, a line for each variant, and what failed."""
    bounces = sum(result.contacts > 0 for result in study.results)
    head = f"{len(study.results)} scenarios, of which {bounces} have a bounce in the optimum"
    lines = [head, _line("", ("", "", "", "boxes", "", "")), _line("variant", _HEADS)]
    group = None
    for variant in study.question.methods:
        if VARIANTS[variant].group != group:
            group = VARIANTS[variant].group
            lines.append("")
        lines.append(_line(variant, _cells(study, variant)))
    return "\n".join([*lines, "", _LEGEND, *failures(study)])


def markdown_ablations(study: ScenarioStudy) -> str:
    """Returns the same numbers as a Markdown table."""
    heads = ("varied", "variant", *_HEADS[:3], "boxes right: best rung", "any rung", "bounces lost")
    return markdown_table(
        heads,
        (
            [VARIANTS[variant].group, variant, *_cells(study, variant)]
            for variant in study.question.methods
        ),
    )


def _line(name: str, cells: tuple[str, ...]) -> str:
    widths = (10, 12, 9, 12, 12, 8)
    texts = [cell.rjust(width) for cell, width in zip(cells, widths, strict=True)]
    return (name.ljust(30) + "".join(texts)).rstrip()


def _cells(study: ScenarioStudy, variant: str) -> tuple[str, ...]:
    summary = summarize(study, study.results, variant)
    each, either, count = count_right_boxes(study.results, variant)
    lost, boxes = count_lost_bounces(study.results, variant)
    return (
        _share(summary.num_optimal[-1], summary.num_scenarios),
        ratio_text(summary.median_ratio),
        "-" if math.isnan(summary.median_seconds) else f"{summary.median_seconds:.2f}",
        _share(max(each, default=0), count),
        _share(either, count),
        _share(lost, boxes),
    )


def _share(part: int, whole: int) -> str:
    return f"{100 * part / whole:.0f} %" if whole else "-"
