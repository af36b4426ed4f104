"""Figures of studies of variants of the planner: functions of axes and data."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import PercentFormatter

from benchmarks.ablations.ablations import VARIANTS
from benchmarks.study.scenario_study import ScenarioStudy, count_right_boxes, summarize

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Of Okabe and Ito's colours: the default is ours, as in the other figures.
_BASES = {"default": "#D55E00", "bare": "#E69F00"}
_OTHERS, _BOXES = "#56B4E9", "black"
# Between groups, in rows.
_GAP = 0.6


def plot_variants(axes: Axes, study: ScenarioStudy) -> None:
    """Draws a bar for each variant: which share of the optima it has, and its boxes alone.

    Args:
        axes: to draw in.
        study: of variants.
    """
    rows = _rows(study.question.methods)
    names = list(rows)
    shares = [_share_optimal(study, name) for name in names]
    places = np.array([rows[name] for name in names])
    colors = [_BASES.get(name, _OTHERS) for name in names]
    axes.barh(places, shares, height=0.75, color=colors, label="optimal, polished and replayed")
    read = {name: count_right_boxes(study.results, name) for name in names}
    boxes = {name: max(each) / count for name, (each, _, count) in read.items() if count}
    axes.scatter(
        list(boxes.values()),
        [rows[name] for name in boxes],
        marker="|",
        s=70,
        linewidths=1.8,
        color=_BOXES,
        zorder=3,
        clip_on=False,
        label="boxes alone have as many contacts as the optimum, in the best rung",
    )
    axes.set_yticks(places, names, fontsize="small")
    axes.set_ylim(places[-1] + 0.7, -0.7)
    axes.set_xlim(0.0, 1.0)
    axes.xaxis.set_major_formatter(PercentFormatter(1.0))
    axes.grid(axis="x", alpha=0.25)
    axes.set_axisbelow(True)
    axes.set_xlabel("share of scenarios")


def _rows(variants: tuple[str, ...]) -> dict[str, float]:
    """Returns where each variant's bar is, groups apart."""
    groups = groupby(variants, key=lambda name: VARIANTS[name].group)
    apart = [(name, number) for number, (_, names) in enumerate(groups) for name in names]
    return {name: place + _GAP * group for place, (name, group) in enumerate(apart)}


def _share_optimal(study: ScenarioStudy, name: str) -> float:
    summary = summarize(study, study.results, name)
    return summary.num_optimal[-1] / max(1, summary.num_scenarios)
