"""Figures of the benchmarks: ours in warm colours and heavy, peers in cool ones and light.

The colours are Okabe and Ito's, made to be told apart with any colour vision; markers and dashes
say the same once more.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from benchmarks.peers import ALONE, OURS

COLORS = {OURS: "#D55E00", ALONE: "#E69F00"}
PEER_COLORS = ("#0072B2", "#56B4E9", "#009E73", "#CC79A7", "#555555")
PEER_MARKERS = ("s", "^", "v", "D", "P", "X", "<", ">", "*")
PEER_DASHES = ("-", "--", ":")
LEAST = 1e-4  # [%] gaps below are drawn here


def draw_gaps(lines: Mapping[str, tuple[Sequence[int], np.ndarray]], path: Path) -> None:
    """Draws gaps [%] over the number of variables: solver → sizes, gaps."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.subplots()
    colors, markers = cycle(PEER_COLORS), cycle(PEER_MARKERS)
    for number, (name, (sizes, gaps)) in enumerate(lines.items()):
        ours = name in COLORS
        axes.plot(
            sizes,
            np.where(np.isfinite(gaps), np.maximum(gaps, LEAST), np.nan),
            color=COLORS[name] if ours else next(colors),
            marker="o" if ours else next(markers),
            linestyle=("-" if name == OURS else "--") if ours else PEER_DASHES[number % 3],
            linewidth=3.0 if ours else 1.2,
            markersize=7.0 if ours else 5.0,
            zorder=3 if ours else 2,
            label=name,
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.xaxis.set_major_locator(
        FixedLocator(sorted({n for sizes, _ in lines.values() for n in sizes}))
    )
    axes.xaxis.set_major_formatter(FuncFormatter(lambda n, _: f"{n:,.0f}"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.tick_params(axis="x", rotation=45)
    axes.yaxis.set_major_formatter(
        FuncFormatter(lambda gap, _: f"≤ {gap:g}" if np.isclose(gap, LEAST) else f"{gap:g}")
    )
    axes.set_ylim(bottom=0.7 * LEAST)
    axes.grid(alpha=0.25)
    axes.set_xlabel("number of variables n")
    axes.set_ylabel("mean gap to the exact optimum [%]")
    axes.set_title("AIGO's own benchmark, equal time on one core: lower is better", fontsize=11)
    axes.legend(frameon=False, fontsize=9, loc="center left", bbox_to_anchor=(1.0, 0.5))
    figure.savefig(path, dpi=150)


def draw_shares(shares: Mapping[str, Mapping[str, float]], path: Path) -> None:
    """Draws solved runs [%], a panel each: measure → solver → share."""
    names = list(next(iter(shares.values())))
    places = np.arange(len(names))
    figure = Figure(figsize=(9.0, 0.36 * len(names) + 1.3), layout="constrained")
    panels = np.atleast_1d(figure.subplots(1, len(shares), sharey=True))
    for axes, (measure, values) in zip(panels, shares.items(), strict=True):
        widths = [100.0 * values[name] for name in names]
        bars = axes.barh(
            places, widths, height=0.7, color=[COLORS.get(name, PEER_COLORS[0]) for name in names]
        )
        axes.bar_label(bars, [f"{width:.1f}" for width in widths], padding=3, fontsize=9)
        axes.set_xlim(0.0, 112.0)
        axes.set_xticks(range(0, 101, 20))
        axes.set_xlabel("solved runs [%]")
        axes.set_title(measure, fontsize=10)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_yticks(places, names)
    panels[0].invert_yaxis()
    figure.suptitle("Test functions of the literature, equal time on one core", fontsize=11)
    figure.savefig(path, dpi=150)
