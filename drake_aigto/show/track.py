"""The track under the moving bodies in Meshcat: lanes with labels, start, goal, and a scale."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from pydrake.geometry import Mesh

from drake_aigto.arrays import Floats
from drake_aigto.show.motion import color_of
from drake_aigto.show.picture import make_mesh

_PIXELS = 2048  # along the track
_INCHES = 10.0  # of figure for each meter of track, so that lines have usual widths
_INK = "#222222"
# Of a lane's color: as a tint on white for the lane, and darkened for its label.
_TINT, _SHADE = 0.2, 0.6

# As parts of a lane's width: the size of labels, and where they stand in their lane …
_LABEL_HEIGHT, _LABEL_INSET, _LABEL_RISE = 0.25, 0.5, 0.1
# … the size of the scale's numbers, and the strip for them along either side.
_SCALE_HEIGHT, _MARGIN = 0.22, 0.7
_ROW_HEIGHT = 0.27  # of names, where several rows are needed
_NOTE_HEIGHT, _NOTE_ROW = 0.18, 0.24  # of the notes' letters, and from line to line
# … from the middle of a lane to the first leg of a trace, how far the next one is at most, and
# what there is for all of them.
_FIRST_LEG, _NEXT_LEG, _ALL_LEGS = 0.4, 0.2, 0.5
_CENTERED: dict[str, Any] = {"ha": "center", "weight": "bold"}
_BOLD_WIDTH = 0.67  # of a letter on average, as a part of the font's size


@dataclass(frozen=True)
class Track:
    """Parallel lanes that are seen from above; the first is the farthest from the viewer.

    In the track's frame x runs along it and y away from the viewer, from the middle of all lanes.

    Attributes:
        labels: one for each lane.
        start: where it begins, x [m].
        end: where it ends, x [m].
        lane_width: [m].
        marks: name of a line across all lanes → its x [m].
        traces: of each lane, its bodies' legs from impact to impact, each the x of a few moments
            [m]. A later leg is drawn nearer to the viewer, as all are on one line.
        notes: that explain what is to be seen.
    """

    labels: Sequence[str]
    start: float
    end: float
    lane_width: float
    marks: Mapping[str, float]
    traces: Sequence[Sequence[Sequence[Floats]]] = ()
    notes: Sequence[str] = ()

    @property
    def length(self) -> float:
        """From end to end [m]."""
        return self.end - self.start

    @property
    def half_width(self) -> float:
        """From the middle to the far edge of the lanes [m]."""
        return len(self.labels) * self.lane_width / 2

    @property
    def margin(self) -> float:
        """Width of the strips on both sides, for scale, notes and marks [m]."""
        far = _MARGIN + _ROW_HEIGHT * (len(self._rows) - 1)
        near = _MARGIN + _NOTE_ROW * len(self._note_lines)
        return max(far, near) * self.lane_width

    def lane_center(self, lane: int) -> float:
        """Returns the y of a lane's middle [m]."""
        return self.half_width - (lane + 0.5) * self.lane_width

    def offset(self, lane: int) -> Floats:
        """Returns where a lane's motion is moved to, x, y and z, shape (3,) [m]."""
        return np.array([0.0, self.lane_center(lane), 0.0])

    def mesh(self) -> Mesh:
        """Returns a flat shape with `paint` on it, in the track's frame."""
        side = self.half_width + self.margin
        return make_mesh(self.paint(), (self.start, -side), (self.end, side))

    def paint(self) -> Figure:
        """Returns the picture, in meters of the track's frame."""
        side = self.half_width + self.margin
        size = (_INCHES * self.length, _INCHES * 2 * side)
        figure = Figure(figsize=size, dpi=_PIXELS / size[0], facecolor="none")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(self.start, self.end), ylim=(-side, side))
        axes.set_axis_off()
        for lane, label in enumerate(self.labels):
            self._paint_lane(axes, lane, label)
        for lane, bodies in enumerate(self.traces):
            for legs in bodies:
                self._paint_trace(axes, lane, legs)
        self._paint_scale(axes)
        self._paint_notes(axes)
        self._paint_marks(axes)
        return figure

    def _paint_lane(self, axes: Axes, lane: int, label: str) -> None:
        low = self.lane_center(lane) - self.lane_width / 2
        strip = (self.start, low), self.length, self.lane_width
        color = np.array(to_rgb(color_of(lane)))
        tint = 1 - _TINT * (1 - color)
        axes.add_patch(Rectangle(*strip, facecolor=tint, edgecolor="white", linewidth=6))
        inset = _LABEL_INSET * self.lane_width
        fitting = (self.length - inset) / (len(label) * _BOLD_WIDTH * self.lane_width)
        size = self._font_size(min(_LABEL_HEIGHT, fitting))
        place = self.start + inset, low + _LABEL_RISE * self.lane_width
        axes.text(*place, label, color=_SHADE * color, size=size, weight="bold")

    def _paint_trace(self, axes: Axes, lane: int, legs: Sequence[Floats]) -> None:
        """Draws where a body was, a dot for each moment, leg beside leg."""
        apart = min(_NEXT_LEG, _ALL_LEGS / len(legs))
        heights = self.lane_center(lane) + self.lane_width * (
            _FIRST_LEG - apart * np.arange(len(legs))
        )
        x = np.concatenate(legs)
        y = np.repeat(heights, [len(leg) for leg in legs])
        color = color_of(lane)
        axes.plot(x, y, "-", color=color, linewidth=3, alpha=0.6)
        axes.plot(x, y, "o", color=color, markersize=11, markeredgewidth=0)

    def _paint_scale(self, axes: Axes) -> None:
        """Draws ticks in meters on the viewer's side."""
        edge = -self.half_width
        for x in MaxNLocator(nbins=7, steps=[1, 2, 5, 10]).tick_values(self.start, self.end):
            text = f"{x:.12g} m"
            if x == self._move_inside(x, text):  # Numbers are whole, and in place, or not there.
                axes.plot([x, x], [edge, edge - 0.08 * self.lane_width], color=_INK, linewidth=3)
                y = edge - 0.14 * self.lane_width
                self._write(axes, x, y, text, _SCALE_HEIGHT, va="top", **_CENTERED)

    def _paint_notes(self, axes: Axes) -> None:
        """Writes the notes below the scale's numbers."""
        top = -self.half_width - (0.14 + 1.6 * _SCALE_HEIGHT) * self.lane_width
        x = self.start + _LABEL_INSET * self.lane_width
        for row, line in enumerate(self._note_lines):
            y = top - row * _NOTE_ROW * self.lane_width
            self._write(axes, x, y, line, _NOTE_HEIGHT, va="top")

    @cached_property
    def _note_lines(self) -> list[str]:
        """The notes, broken so that they fit."""
        room = self.length - _LABEL_INSET * self.lane_width
        width = int(room / (_BOLD_WIDTH * _NOTE_HEIGHT * self.lane_width))
        return wrap_notes(self.notes, width)

    def _paint_marks(self, axes: Axes) -> None:
        """Draws lines across all lanes, and their names far enough off to stand clear of a ball."""
        edge = self.half_width + 0.45 * _MARGIN * self.lane_width
        for x in self.marks.values():
            axes.plot([x, x], [-self.half_width, edge], "--", color=_INK, linewidth=3)
        for row, names in enumerate(self._rows):
            y = edge + (0.07 + row * _ROW_HEIGHT) * self.lane_width
            for name, x in names.items():
                inside = self._move_inside(x, name)
                self._write(axes, inside, y, name, _SCALE_HEIGHT, va="bottom", **_CENTERED)

    @cached_property
    def _rows(self) -> list[dict[str, float]]:
        """The marks, in as many rows as it takes for no name to overlap another."""
        rows: list[dict[str, float]] = []
        for name, x in self.marks.items():
            free = (row for row in rows if all(self._are_apart((name, x), o) for o in row.items()))
            row = next(free, None)
            if row is None:
                rows.append(row := {})
            row[name] = x
        return rows

    def _are_apart(self, *marks: tuple[str, float]) -> bool:
        """Returns whether two names over their places do not overlap."""
        first, second = (self._move_inside(x, name) for name, x in marks)
        widths = [self._text_width(name) for name, _ in marks]
        return abs(first - second) > sum(widths) / 2

    def _move_inside(self, x: float, text: str) -> float:
        """Returns the nearest place to x where a text over it is whole."""
        half_width = self._text_width(text) / 2
        return min(max(x, self.start + half_width), self.end - half_width)

    def _text_width(self, text: str) -> float:
        """Returns how wide a text is at most, of the scale or a mark [m]."""
        return len(text) * _BOLD_WIDTH * _SCALE_HEIGHT * self.lane_width

    def _write(self, axes: Axes, x: float, y: float, text: str, height: float, **look: Any) -> None:
        """Writes a text of a height, outlined so that it is seen before a dark wall, too."""
        size = self._font_size(height)
        outline = withStroke(foreground="white", linewidth=size / 5)
        axes.text(x, y, text, color=_INK, size=size, path_effects=[outline], **look)

    def _font_size(self, height: float) -> float:
        """Returns the size in points for a height as a part of a lane's width."""
        return 72 * _INCHES * height * self.lane_width


def wrap_notes(notes: Sequence[str], width: int) -> list[str]:
    """Returns notes in lines of so many letters, broken between notes where that is possible."""
    text = "; ".join(note.replace(" ", "\u00a0") for note in notes)
    lines = textwrap.wrap(text, width)
    return [line.replace("\u00a0", " ").removesuffix(";") for line in lines]
