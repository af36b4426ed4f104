"""The boards behind bodies that move in a plane: side by side, with label, way, start and goal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from pydrake.geometry import Mesh

from drake_aigto.arrays import Floats
from drake_aigto.show.motion import color_of
from drake_aigto.show.picture import make_mesh
from drake_aigto.show.track import wrap_notes

_PIXELS = 3072  # of the longer side
_INCHES = 6.0  # of figure for a panel's size, so that lines have usual widths
_INK = "#222222"
# Of a panel's color: as a tint on white for the panel, and darkened for its label.
_TINT, _SHADE = 0.15, 0.6

# As parts of a panel's size: between panels, the size of letters, how far they are from what
# they name, strips above and below, the least width.
_GAP, _LETTER, _SPACE = 0.06, 0.058, 0.012
_TOP, _BOTTOM = 0.19, 0.09
_NARROWEST = 0.62
# What is this part of its depth below what stands in front is hidden, up to this part of the size.
_HIDDEN, _MOST_HIDDEN = 0.5, 0.06
_LETTERS = 18  # of a font's size that are as wide as a panel
_LINE = 1.3  # from line to line of the notes, in heights of letters
_BOLD_WIDTH = 0.67  # of a letter on average, as a part of the font's size


@dataclass(frozen=True, eq=False)
class Board:
    """Panels side by side, one for each motion, in a plane that is looked at from the front.

    In the board's frame x is to the right and y up. A motion's place in it is that of the world,
    moved aside by its panel's offset.

    Attributes:
        labels: one for each panel.
        low: lower left corner of all that is shown of the world, shape (2,) [m].
        high: upper right corner [m].
        depth: how far shapes reach towards who looks on [m].
        radius: of what moves [m].
        starts: where bodies start, shape (k, 2) [m].
        goals: where they should end [m]; NaN where no place is asked for.
        ways: of each panel, the ways of its bodies, each of shape (K, 2) [m].
        dots: of each panel, where its bodies are every few moments, shape (d, 2) [m].
        touches: of each panel, where they plan to touch something, shape (t, 2) [m].
        touch_names: of each of these, what and when.
        notes: that explain what is to be seen.
        columns: how many panels are side by side; None: all of them.
    """

    labels: Sequence[str]
    low: Floats
    high: Floats
    depth: float
    radius: float
    starts: Floats
    goals: Floats
    ways: Sequence[Sequence[Floats]]
    dots: Sequence[Floats]
    touches: Sequence[Floats]
    touch_names: Sequence[Sequence[str]]
    notes: Sequence[str] = ()
    columns: int | None = None

    @property
    def size(self) -> float:
        """The longer side of what is shown of the world [m]."""
        return float(np.max(self.high - self.low))

    @property
    def space(self) -> float:
        """Between texts and what they name [m]."""
        return _SPACE * self.size

    @cached_property
    def panel(self) -> tuple[Floats, Floats]:
        """Corners of the panel without offset, lower left and upper right, shape (2,) each [m]."""
        width = (self.high - self.low)[0]
        wider = np.array([max(0.0, _NARROWEST * self.size - width) / 2, 0.0])
        return self.low - wider, self.high + wider

    @property
    def corners(self) -> tuple[Floats, Floats]:
        """Corners of all panels with their labels and scales, shape (2,) each [m]."""
        low, high = self.panel
        (left, top), (right, bottom) = self._ends
        around = _GAP * self.size
        above = _TOP * self.size + _LINE * self.letter * len(self._note_lines) + self.space
        lower = np.array([left - around, bottom - _BOTTOM * self.size])
        return low + lower, high + np.array([right + around, top + above])

    def offset(self, index: int) -> Floats:
        """Returns where a panel's motion is moved to, x, y and z, shape (3,) [m]."""
        size = self.panel[1] - self.panel[0]
        pitch = size + self.size * np.array([_GAP, _TOP + _BOTTOM])
        columns = self.columns or len(self.labels)
        row, column = divmod(index, columns)
        middle = (columns - 1) / 2, (len(self.labels) - 1) // columns / 2
        aside = np.array([column - middle[0], middle[1] - row]) * pitch
        return np.append(aside, 0.0)

    @property
    def _ends(self) -> tuple[Floats, Floats]:
        """Offsets of the first panel and of the place in the last row and column, (2,) each [m]."""
        first = self.offset(0)[:2]
        return first, -first

    def mesh(self) -> Mesh:
        """Returns a flat shape with `paint` on it, in the board's frame."""
        return make_mesh(self.paint(), *self.corners)

    def paint(self) -> Figure:
        """Returns the picture, in meters of the board's frame."""
        low, high = self.corners
        width, height = (_INCHES * (high - low) / self.size).tolist()
        dpi = _PIXELS / max(width, height)
        figure = Figure(figsize=(width, height), dpi=dpi, facecolor="none")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set_axis_off()
        for index in range(len(self.labels)):
            self._paint_panel(axes, index)
        left = self.offset(0)[0] + self.panel[0][0]
        for row, line in enumerate(self._note_lines):
            y = high[1] - self.space - _LINE * self.letter * row
            self._write(axes, left, y, line, color=_INK, va="top", weight="normal")
        return figure

    @cached_property
    def _note_lines(self) -> list[str]:
        """The notes, broken so that they fit above all panels, where nothing hides them."""
        (left, _), (right, _) = self.panel
        first, last = self._ends
        width = right - left + last[0] - first[0]
        return wrap_notes(self.notes, int(width / (_BOLD_WIDTH * self.letter)))

    def _paint_panel(self, axes: Axes, index: int) -> None:
        aside = self.offset(index)[:2]
        low, high = (corner + aside for corner in self.panel)
        color = np.array(to_rgb(color_of(index)))
        (left, bottom), (width, height) = low.tolist(), (high - low).tolist()
        tint = 1 - _TINT * (1 - color)
        axes.add_patch(Rectangle((left, bottom), width, height, facecolor=tint))
        middle = left + width / 2
        lines = self.labels[index].replace(": ", ":\n", 1)
        lines = lines if "\n" in lines else lines.replace(" (", "\n(")
        self._paint_title(axes, middle, high[1], lines, _SHADE * color)
        for way in self.ways[index]:
            axes.plot(*(way + aside).T, color=color, linewidth=3, alpha=0.7, zorder=2)
        axes.plot(*(self.dots[index] + aside).T, "o", color=color, markersize=7, zorder=2)
        self._paint_marks(axes, aside, middle)
        self._paint_touches(axes, index, middle)
        self._paint_scale(axes, low, high, aside)

    def _paint_title(self, axes: Axes, x: float, top: float, lines: str, color: Floats) -> None:
        (left, _), (right, _) = self.panel
        fitting = (right - left) / (_BOLD_WIDTH * max(map(len, lines.split("\n"))))
        look: dict[str, Any] = {"color": color, "ha": "center", "va": "bottom"}
        look["size"] = self._font_size(min(self.letter, fitting))
        rise = min(_HIDDEN * self.depth, _MOST_HIDDEN * self.size) + self.space
        self._write(axes, x, top + rise, lines, **look)

    def _paint_marks(self, axes: Axes, aside: Floats, middle: float) -> None:
        """Draws starts and goals, with their names on the side that has more room."""
        for start, goal in zip(self.starts + aside, self.goals + aside, strict=True):
            axes.plot(*start, "s", color=_INK, markersize=10, zorder=3)
            axes.plot(*goal, "*", color=_INK, markersize=22, zorder=3)
            names = {"start": start, "goal": goal} if np.isfinite(goal[0]) else {"start": start}
            # The upper one's name is above, so that names do not overlap where places are near.
            up = 1 if start[1] >= goal[1] else -1
            for name, (x, y) in names.items():
                above = up if name == "start" else -up
                side, ha = (-1, "right") if x > middle + self.space else (1, "left")
                beside = x + side * (self.radius + self.space)
                va, y = "bottom" if above > 0 else "top", y + above * self.space / 4
                self._write(axes, beside, y, name, color=_INK, ha=ha, va=va, zorder=4)

    def _paint_touches(self, axes: Axes, index: int, middle: float) -> None:
        """Draws where bodies touch something, with names that do not cover each other."""
        named: list[Floats] = []
        touches = self.touches[index] + self.offset(index)[:2]
        color = np.array(to_rgb(color_of(index)))
        look: dict[str, Any] = {"color": color, "markerfacecolor": "white", "markeredgewidth": 2.5}
        axes.plot(*touches.T, "o", markersize=12, zorder=4, **look)
        apart = np.array([self.panel[1][0] - self.panel[0][0], 2.5 * self.letter]) / 2
        for place, name in zip(touches, self.touch_names[index], strict=True):
            if any(np.all(np.abs(place - other) < apart) for other in named):
                continue
            named.append(place)
            side, ha = (-1, "right") if place[0] > middle + self.space else (1, "left")
            x, y = place[0] + side * (self.radius + self.space), place[1] + self.letter
            room = abs(middle + side * apart[0] - x)  # To the panel's edge.
            if len(name) * self.letter * _BOLD_WIDTH > room:
                name, y = name.replace(", ", "\n"), y + self.letter / 2
            self._write(axes, x, y, name, color=_SHADE * color, ha=ha, va="center", zorder=4)

    def _paint_scale(self, axes: Axes, low: Floats, high: Floats, aside: Floats) -> None:
        """Draws ticks in meters below a panel; numbers are whole, or not there."""
        ends = low[0] - aside[0], high[0] - aside[0]
        look = {"color": _INK, "ha": "center", "va": "top"}
        for x in _find_ticks(*ends):
            at, text = x + aside[0], f"{x:.12g} m"
            half = len(text) * self.letter * _BOLD_WIDTH / 2
            room = min(at - low[0], high[0] - at)  # Half of the gap to the next panel is its own.
            if room >= 0 and room + _GAP * self.size / 2 >= half:
                axes.plot([at, at], [low[1], low[1] - self.space], color=_INK, linewidth=2)
                self._write(axes, at, low[1] - 1.5 * self.space, text, **look)

    @property
    def letter(self) -> float:
        """The height of letters [m]."""
        low, high = self.panel
        return min(_LETTER * self.size, (high - low)[0] / _LETTERS)

    def _write(self, axes: Axes, x: float, y: float, text: str, **look: Any) -> None:
        size = self._font_size(self.letter)
        axes.text(x, y, text, **{"size": size, "weight": "bold", "linespacing": 1.0, **look})

    def _font_size(self, height: float) -> float:
        """Returns the size in points of letters of a height [m]."""
        return 72 * _INCHES * height / self.size


def _find_ticks(low: float, high: float) -> list[float]:
    """Returns round numbers, some four, and more if fewer than two were between the ends."""
    found: list[float] = []
    for count in (4, 6, 8):
        ticks = MaxNLocator(nbins=count, steps=[1, 2, 5, 10]).tick_values(low, high)
        found = [float(x) for x in ticks]
        if sum(low <= x <= high for x in found) > 1:
            break
    return found
