"""Figures of studies of variants of the planner: functions of axes and data.

The part of the results page on variants of the planner.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from benchmarks.ablations.ablations import VARIANTS, AblationStudy, markdown_ablations
from benchmarks.study.page import add_figure
from benchmarks.study.scenario_question import command_of
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


_INTRODUCTION = """\
## What finds the bounce

The planner with one thing changed at a time, on random scenarios like those above. The default gets
at a contact sequence in three ways: AIGO's boxes around the straight line from start to goal; boxes
around the motion without control, which a simulation has taken to the wall; and *neighbours*, a
candidate's sequence with a bounce more or less, polished. *Bare* variants have the first way only.
All run every rung of the ladder, while the planner leaves out those that can tell nothing new.

*Optimal* is judged as above. *Boxes right*: the last boxes, before any polish, show as many
contacts as the optimum has; those of the best rung, and those of any rung of the ladder. *Bounces
lost*: of all boxes of scenarios whose optimum has a bounce, those that show no contact.
"""
_CONCLUSION = """\
### What to make of it

- *At one wall, success as such proves nothing about boxes.* Flight and one bounce, listed and
  polished, do as well as the planner, and faster. With three ways to a bounce, almost any part can
  be left out: without boxes, points from the simulated motion are still in the bounce, and rung 3
  alone, whose boxes lose nearly all bounces, gets them back from its neighbours.
- *The bare rows tell what boxes do.* Points that start on the straight line mostly end in the free
  flight, and raising the penalties further brings no bounce back. Boxes of optimised widths find
  the bounces from the same start, without any simulation. Boxes of equal widths find fewer: centers
  and widths should be optimised together, as the paper says.
- *No temperature is right for all.* The hottest rung sees bounces also where the flight is best,
  the coldest one loses them. The ladder proposes both, and the polish decides.
- *Algorithm 1*, as printed, does the converse of points: its boxes show a contact nearly
  everywhere, so that on its own it misses flights. So does the alternating algorithm, though less
  often; it takes many times as long.
- *The polish finds the optimum, not the bounce.* What boxes hold has the right contacts, but
  replayed as it is, most of it costs more than the optimum by far; raised penalties help some.
- *The restitution row tells a bounce from a crowd.* Without it, bare boxes show several contacts
  everywhere. That bounces survive this is owed to reading a crowd as one; flights do not.
"""


def describe_ablations(paths: Sequence[Path], page: Path) -> Iterator[str]:
    """Yields the part of a page on variants of the planner, and draws its figure."""
    yield _INTRODUCTION
    for path in paths:
        study = AblationStudy.load(path)
        bounces = sum(result.contacts > 0 for result in study.results)
        yield f"    {command_of(study.question)}\n"
        head = f"{len(study.results)} scenarios of seed {study.question.seed}, of which {bounces}"
        yield f"{head} have a bounce in the optimum.\n"
        yield f"{markdown_ablations(study)}\n"
        text = "Share of optima, and of boxes with as many contacts as the optimum, by variant"
        yield add_figure(page, f"{path.stem}_variants", draw_variants(study), text)
    yield _CONCLUSION


def draw_variants(study: ScenarioStudy) -> Figure:
    """Returns bars of all variants."""
    count = len(study.question.methods)
    figure = Figure(figsize=(7.2, 0.22 * count + 1.6), layout="constrained")
    axes = figure.subplots()
    plot_variants(axes, study)
    labels = axes.get_legend_handles_labels()
    figure.legend(*labels, loc="outside upper left", frameon=False, fontsize="small")
    return figure
