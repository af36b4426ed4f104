"""Boards behind motions: panels side by side, with labels, ways, starts and goals."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from pydrake.geometry import Mesh

from drake_aigto.arrays import Floats
from drake_aigto.show.film import ASPECT_RATIO, make_mesh
from drake_aigto.show.motion import DOT_SECONDS, Motion, color_of, find_legs
from drake_aigto.show.shapes import find_goal, has_goal
from drake_aigto.show.stage import Stage
from drake_aigto.show.text import touch_names
from drake_aigto.world import Scenario, World

_PIXELS = 3072  # of the longer side
_INCHES = 6.0  # of figure for a panel's size, so that lines have usual widths
_INK = "#222222"
# Of a panel's color: as a tint on white for the panel, and darkened for its label.
_TINT, _SHADE = 0.15, 0.6

# The height of letters, as a part of a panel's size, of its width, and of its height.
_LETTER, _OF_WIDTH, _OF_HEIGHT = 0.058, 1 / 18, 1 / 6
# In heights of letters: between panels, from texts to what they name, the strip for the scale.
_GAP, _SPACE, _BOTTOM = 1.05, 0.2, 1.55
_NARROWEST = 0.62  # width of a panel, as a part of its size
# What is this part of its depth below what stands in front is hidden, up to this part of the size.
_HIDDEN, _MOST_HIDDEN = 0.5, 0.06
_LINE = 1.3  # from line to line, in heights of letters
_BOLD_WIDTH = 0.67  # of a letter on average, as a part of the font's size

_MOST_NAMES = 6  # of contacts on a panel: more would cover each other
# In heights of what moves along a line: the first leg of its way above its middle, from leg to leg
# at most, and all of them.
_FIRST_LEG, _NEXT_LEG, _ALL_LEGS = 0.8, 0.4, 1.0


class Panel(NamedTuple):
    """Places of one motion in the board's plane, without the offset of its panel."""

    label: str
    ways: Sequence[Floats]  # of its bodies, shape (K, 2) each [m]
    dots: Floats  # where its bodies are every few moments, shape (d, 2) [m]
    touches: Floats  # where it plans to touch something, shape (t, 2) [m]
    touch_names: Sequence[str]  # of each of these


@dataclass(frozen=True, eq=False)
class Board:
    """Panels side by side, one for each motion, in a plane that is looked at from the front.

    In the board's frame x is to the right and y up. A motion's place in it is that of the world,
    moved aside by its panel's offset.

    Attributes:
        panels: of the motions.
        low: lower left corner of all that is shown of the world, shape (2,) [m].
        high: upper right corner [m].
        depth: how far shapes reach towards the viewer [m].
        radius: of what moves [m].
        names: of k bodies; "" of an only one.
        starts: where bodies start, shape (k, 2) [m].
        goals: where they should end [m]; NaN where no place is asked for.
        notes: explanations of what is shown.
        columns: how many panels are side by side.
        has_lanes: whether titles are in the panels, below motions along level lines.
    """

    panels: Sequence[Panel]
    low: Floats
    high: Floats
    depth: float
    radius: float
    names: Sequence[str]
    starts: Floats
    goals: Floats
    notes: Sequence[str]
    columns: int
    has_lanes: bool

    @property
    def size(self) -> float:
        """The longer side of what is shown of the world [m]."""
        return float(np.max(self.high - self.low))

    @property
    def space(self) -> float:
        """Between texts and what they name [m]."""
        return _SPACE * self.letter

    @cached_property
    def letter(self) -> float:
        """The height of letters [m]."""
        width, height = np.subtract(*self.panel[::-1])
        return float(min(_LETTER * self.size, _OF_WIDTH * width, _OF_HEIGHT * height))

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
        around = _GAP * self.letter
        above = self._top + _LINE * self.letter * len(self._note_lines) + self.space
        lower = np.array([left - around, bottom - _BOTTOM * self.letter])
        return low + lower, high + np.array([right + around, top + above])

    def offset(self, index: int) -> Floats:
        """Returns where a panel's motion is moved to, x, y and z, shape (3,) [m]."""
        size = self.panel[1] - self.panel[0]
        pitch = size + np.array([_GAP * self.letter, _GAP * self.letter + self._top])
        row, column = divmod(index, self.columns)
        middle = (self.columns - 1) / 2, (len(self.panels) - 1) // self.columns / 2
        aside = np.array([column - middle[0], middle[1] - row]) * pitch
        return np.append(aside, 0.0)

    @property
    def _ends(self) -> tuple[Floats, Floats]:
        """Offsets of the first panel and of the place in the last row and column, (2,) each [m]."""
        first = self.offset(0)[:2]
        return first, -first

    @cached_property
    def _titles(self) -> list[str]:
        """Labels, in two lines where one of them would be wider than the panel."""
        texts = [panel.label for panel in self.panels]
        (left, _), (right, _) = self.panel
        if max(map(len, texts)) * _BOLD_WIDTH * self.letter <= right - left:
            return texts
        texts = [text.replace(": ", ":\n", 1) for text in texts]
        return [text if "\n" in text else text.replace(" (", "\n(") for text in texts]

    @property
    def _rise(self) -> float:
        """From a panel to its title: what stands in the panel hides what is just above it [m]."""
        return min(_HIDDEN * self.depth, _MOST_HIDDEN * self.size) + self.space

    @property
    def _top(self) -> float:
        """The height of the strip above a panel, which has its title if that is not inside [m]."""
        if self.has_lanes:
            return 0.0
        return self._rise + _LINE * self.letter * (1 + ("\n" in "".join(self._titles)))

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
        for index, panel in enumerate(self.panels):
            aside, color = self.offset(index)[:2], np.array(to_rgb(color_of(index)))
            start, end = (corner + aside for corner in self.panel)
            tint, size = 1 - _TINT * (1 - color), (end - start).tolist()
            axes.add_patch(Rectangle(start.tolist(), *size, facecolor=tint))
            for way in panel.ways:
                axes.plot(*(way + aside).T, color=color, linewidth=3, alpha=0.7, zorder=2)
            axes.plot(*(panel.dots + aside).T, "o", color=color, markersize=7, zorder=2)
            self._paint_marks(axes, index, [self._paint_title(axes, index)])
            if index + self.columns >= len(self.panels):
                self._paint_scale(axes, start, end, aside)
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

    def _paint_title(self, axes: Axes, index: int) -> Floats:
        """Writes a panel's title, and returns the corners of where it is, shape (2, 2)."""
        low, high = (corner + self.offset(index)[:2] for corner in self.panel)
        title, middle = self._titles[index], (low + high)[0] / 2
        width = _BOLD_WIDTH * self.letter * max(map(len, title.split("\n")))
        size = self.letter * min(1.0, (high - low)[0] / width)
        bottom = low[1] + self.space if self.has_lanes else high[1] + self._rise
        look = {"color": _SHADE * np.array(to_rgb(color_of(index))), "ha": "center", "va": "bottom"}
        self._write(axes, middle, bottom, title, size=self._font_size(size), **look)
        return np.array([[middle - width / 2, bottom], [middle + width / 2, bottom + self.letter]])

    def _paint_marks(self, axes: Axes, index: int, taken: list[Floats]) -> None:
        """Draws starts, goals and touches, with names where these cover nothing."""
        panel, aside = self.panels[index], self.offset(index)[:2]
        color = np.array(to_rgb(color_of(index)))
        starts, goals, touches = self.starts + aside, self.goals + aside, panel.touches + aside
        axes.plot(*starts.T, "s", color=_INK, markersize=10, zorder=3)
        axes.plot(*goals.T, "*", color=_INK, markersize=22, zorder=3)
        look: dict[str, Any] = {"color": color, "markerfacecolor": "white", "markeredgewidth": 2.5}
        axes.plot(*touches.T, "o", markersize=12, zorder=4, **look)
        is_one = np.linalg.norm(goals - starts, axis=1) < self.space
        ends = [("start, goal" if each else "start") for each in is_one]
        named: list[tuple[str, Floats, Any]] = [
            (f"{name} {end}".strip(), place, _INK)
            for name, end, place in zip(self.names, ends, starts, strict=True)
        ]
        named += [
            (f"{name} goal".strip(), place, _INK)
            for name, place, is_there in zip(self.names, goals, is_one, strict=True)
            if np.isfinite(place[0]) and not is_there
        ]
        names = zip(panel.touch_names, touches, strict=True)
        named += [(name, place, _SHADE * color) for name, place in names]
        marks, dots = (
            [np.array([place - self.space, place + self.space]) for place in places]
            for places in (np.vstack([starts, goals, touches]), panel.dots + aside)
        )
        for name, place, ink in named:
            # Beside all that is drawn if there is room, or on dots, or even on marks.
            for others in ([*marks, *dots], marks, []):
                if found := self._find_room(place, name, [*taken, *others], aside):
                    text, box = found
                    taken.append(box)
                    x, y = box.mean(axis=0)
                    self._write(axes, x, y, text, color=ink, ha="center", va="center", zorder=4)
                    break

    def _find_room(
        self, place: Floats, name: str, taken: Sequence[Floats], aside: Floats
    ) -> tuple[str, Floats] | None:
        """Returns a name, in lines, and corners (2, 2) beside a place that cover nothing taken.

        They are inside of the panel, and as near as can be, on the side that has more room.
        """
        low, high = (corner + aside for corner in self.panel)
        side = -1 if place[0] > (low + high)[0] / 2 + self.space else 1
        for text in dict.fromkeys((name, name.replace(", ", "\n"))):
            lines = text.split("\n")
            size = self.letter * np.array([_BOLD_WIDTH * max(map(len, lines)), _LINE * len(lines)])
            rises = (self.space / 4 + size[1] / 2) * np.array([1, -1, 2.2, -2.2, 3.4, -3.4])
            beside = self.radius + self.space + size / 2
            steps = [(way * beside[0], rise) for rise in rises for way in (side, -side)]
            steps[4:4] = [(0.0, -beside[1]), (0.0, beside[1])]
            for step in steps:
                middle = np.add(place, step)
                box = np.array([middle - size / 2, middle + size / 2])
                is_inside = np.all(box[0] >= low) and np.all(box[1] <= high)
                covers = (np.all(box[0] < each[1]) and np.all(each[0] < box[1]) for each in taken)
                if is_inside and not any(covers):
                    return text, box
        return None

    def _paint_scale(self, axes: Axes, low: Floats, high: Floats, aside: Floats) -> None:
        """Draws ticks in meters below a panel; numbers are whole, or not there."""
        ends, ticks = (low[0] - aside[0], high[0] - aside[0]), np.empty(0)
        for count in (4, 6, 8):  # More if fewer than two were between the ends.
            if np.sum((ends[0] <= ticks) & (ticks <= ends[1])) < 2:
                ticks = np.array(MaxNLocator(nbins=count, steps=[1, 2, 5, 10]).tick_values(*ends))
        look = {"color": _INK, "ha": "center", "va": "top"}
        for x in ticks.tolist():
            at, text = x + aside[0], f"{x:.12g} m"
            half = len(text) * self.letter * _BOLD_WIDTH / 2
            room = min(at - low[0], high[0] - at)  # Half of the gap to the next panel is its own.
            if room >= 0 and room + _GAP * self.letter / 2 >= half:
                axes.plot([at, at], [low[1], low[1] - self.space], color=_INK, linewidth=2)
                self._write(axes, at, low[1] - 1.5 * self.space, text, **look)

    def _write(self, axes: Axes, x: float, y: float, text: str, **look: Any) -> None:
        size = self._font_size(self.letter)
        axes.text(x, y, text, **{"size": size, "weight": "bold", "linespacing": 1.0, **look})

    def _font_size(self, height: float) -> float:
        """Returns the size in points of letters of a height [m]."""
        return 72 * _INCHES * height / self.size


def wrap_notes(notes: Sequence[str], width: int) -> list[str]:
    """Returns notes in lines of a width in letters, broken between notes where that can be."""
    text = "; ".join(note.replace(" ", "\u00a0") for note in notes)
    lines = textwrap.wrap(text, width)
    return [line.replace("\u00a0", " ").removesuffix(";") for line in lines]


def lay_board(
    stage: Stage, motions: Sequence[Motion], world: World, scenario: Scenario, notes: Sequence[str]
) -> Board:
    """Returns the board that the motions need, with the columns at which it is seen largest."""
    end = find_goal(world, scenario, motions[0].positions[-1])
    marks = stage.trace(np.array([scenario.initial_position, end]))[..., :2]
    # A place that a coordinate without weight moves is not asked for.
    free = ~has_goal(world, scenario)
    is_free = [np.any(stage.movers_of(body) & free) for body, _ in stage.tracers]
    marks[is_free, 1] = np.nan
    board = Board(
        panels=[_fill_panel(stage, motion, world) for motion in motions],
        low=stage.low,
        high=stage.high,
        depth=stage.depth,
        radius=stage.radius,
        names=stage.tracer_names,
        starts=marks[:, 0],
        goals=marks[:, 1],
        notes=[f"dots: every {DOT_SECONDS:g} s", *notes],
        columns=1,
        has_lanes=stage.is_line,
    )

    def find_scale(board: Board) -> float:
        """Returns how large a meter is on a board that fills a window, in the window's heights."""
        width, height = np.subtract(*board.corners[::-1])
        return float(min(ASPECT_RATIO / width, 1 / height))

    columns = range(1, len(motions) + 1)
    return max((replace(board, columns=n) for n in columns), key=find_scale)


def _fill_panel(stage: Stage, motion: Motion, world: World) -> Panel:
    """Returns the ways of a motion, of what moves along a line leg beside leg, and its contacts."""
    legs = find_legs(motion, motion.impacts if stage.is_line else ())
    dots = [stage.trace(leg)[..., :2] for leg in legs]
    ways = stage.trace(motion.positions)[..., :2]
    if stage.is_line:
        apart = min(_NEXT_LEG, _ALL_LEGS / len(legs))
        for number, leg in enumerate(dots):
            leg[..., 1] += (_FIRST_LEG - number * apart) * stage.height
        ways = np.concatenate(dots, axis=1)
    touches, names = motion.touches[:_MOST_NAMES], touch_names(world)
    return Panel(
        label=motion.label,
        ways=list(ways),
        dots=np.vstack([places for leg in dots for places in leg]),
        touches=stage.place_touches(motion, touches),
        touch_names=[f"{names[touch.contact]}, {touch.start:.2f} s" for touch in touches],
    )
