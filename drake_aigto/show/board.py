"""Boards behind motions: panels side by side, with labels, ways, starts and goals."""

from __future__ import annotations

import base64
import io
import json
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator
from PIL import Image
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh

from drake_aigto.arrays import Floats
from drake_aigto.show.motion import color_of

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

# Of a picture in Meshcat: colors; a color that is off by more than this is another one; as a part
# of the pixels, how many may be.
_COLORS, _LOST, _MOST_LOST = 256, 64, 0.01


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
        named: list[tuple[str, Floats, Any]] = [
            (f"{name} {end}".strip(), place, _INK)
            for end, places in (("start", starts), ("goal", goals))
            for name, place in zip(self.names, places, strict=True)
            if np.isfinite(place[0])
        ]
        names = zip(panel.touch_names, touches, strict=True)
        named += [(name, place, _SHADE * color) for name, place in names]
        dots = [np.array([place - self.space, place + self.space]) for place in panel.dots + aside]
        for name, place, ink in named:
            found = self._find_room(place, name, [*taken, *dots], aside)
            if found := found or self._find_room(place, name, taken, aside):
                text, box = found
                taken.append(box)
                x, y = box.mean(axis=0)
                self._write(axes, x, y, text, color=ink, ha="center", va="center", zorder=4)

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
            for rise, way in ((rise, way) for rise in rises for way in (side, -side)):
                middle = np.add(place, (way * (self.radius + self.space + size[0] / 2), rise))
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


def make_mesh(figure: Figure, low: npt.ArrayLike, high: npt.ArrayLike) -> Mesh:
    """Returns a flat shape with a figure on it, in a frame's x and y.

    It is the rectangle from its lower left to its upper right corner, shape (2,) each [m].
    """
    gltf = json.loads(resources.files(__package__).joinpath("square.gltf").read_text("utf-8"))
    (left, bottom), (width, height) = np.array([low, np.subtract(high, low)]).tolist()
    # glTF is y-up, which Drake turns to z-up: (x, y, z) → (x, −z, y).
    gltf["nodes"][0] |= {"translation": [left, 0, -bottom], "scale": [width, 1, height]}
    picture = base64.b64encode(_draw(figure)).decode("ascii")
    gltf["images"][0]["uri"] = f"data:image/png;base64,{picture}"
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(json.dumps(gltf), ".gltf", "picture")))


def _draw(figure: Figure) -> bytes:
    """Returns a figure as a PNG of few colors, a third as large as one of all."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    pixels = Image.open(drawn)
    # Of Pillow's methods the one that keeps transparency.
    picture = pixels.quantize(_COLORS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    # It loses a color now and then, even that of a large area.
    error = np.asarray(pixels, dtype=np.int16) - np.asarray(picture.convert("RGBA"))
    is_lost = np.abs(error).max(axis=2) > _LOST
    written = io.BytesIO()
    (pixels if np.mean(is_lost) > _MOST_LOST else picture).save(written, "PNG", optimize=True)
    return written.getvalue()
