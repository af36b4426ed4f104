"""The track under the moving bodies in Meshcat: lanes with labels, start, goal, and a scale."""

from __future__ import annotations

import base64
import io
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.patheffects import withStroke
from matplotlib.ticker import MaxNLocator
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh

from drake_aigto.show.motion import color_of

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy.typing as npt
    from matplotlib.axes import Axes

_PIXELS = 2048  # along the track
_INCHES = 10.0  # of figure for each metre of track, so that lines have usual widths
_INK = "#222222"
# Of a lane's color: as a tint on white for the lane, and darkened for its label.
_TINT, _SHADE = 0.2, 0.6

# As parts of a lane's width: the size of labels, and where they stand in their lane …
_LABEL_HEIGHT, _LABEL_INSET, _LABEL_RISE = 0.25, 0.5, 0.1
# … the size of the scale's numbers, and the strip for them along either side.
_SCALE_HEIGHT, _MARGIN = 0.22, 0.7
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
    """

    labels: Sequence[str]
    start: float
    end: float
    lane_width: float
    marks: Mapping[str, float]

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
        """Width of the strips on both sides, for scale and marks [m]."""
        return _MARGIN * self.lane_width

    def lane_center(self, lane: int) -> float:
        """Returns the y of a lane's middle [m]."""
        return self.half_width - (lane + 0.5) * self.lane_width

    def mesh(self) -> Mesh:
        """Returns a flat shape with `paint` on it, in the track's frame."""
        side = self.half_width + self.margin
        corners = [(self.start, -side), (self.end, -side), (self.end, side), (self.start, side)]
        picture = io.BytesIO()
        self.paint().savefig(picture, format="png")
        gltf = _textured_quad(np.array(corners), picture.getvalue())
        return Mesh(InMemoryMesh(mesh_file=MemoryFile(json.dumps(gltf), ".gltf", "track")))

    def paint(self) -> Figure:
        """Returns the picture, in metres of the track's frame."""
        side = self.half_width + self.margin
        size = (_INCHES * self.length, _INCHES * 2 * side)
        figure = Figure(figsize=size, dpi=_PIXELS / size[0], facecolor="none")
        axes = figure.add_axes((0, 0, 1, 1), xlim=(self.start, self.end), ylim=(-side, side))
        axes.set_axis_off()
        for lane, label in enumerate(self.labels):
            self._paint_lane(axes, lane, label)
        self._paint_scale(axes)
        self._paint_marks(axes)
        return figure

    def _paint_lane(self, axes: Axes, lane: int, label: str) -> None:
        low = self.lane_center(lane) - self.lane_width / 2
        strip = (self.start, low), self.length, self.lane_width
        color = np.array(to_rgb(color_of(lane)))
        tint = 1 - _TINT * (1 - color)
        axes.add_patch(Rectangle(*strip, facecolor=tint, edgecolor="white", linewidth=6))
        axes.text(
            self.start + _LABEL_INSET * self.lane_width,
            low + _LABEL_RISE * self.lane_width,
            label,
            color=_SHADE * color,
            size=self._font_size(_LABEL_HEIGHT),
            weight="bold",
        )

    def _paint_scale(self, axes: Axes) -> None:
        """Draws ticks in metres on the viewer's side."""
        edge = -self.half_width
        for x in MaxNLocator(nbins=7, steps=[1, 2, 5, 10]).tick_values(self.start, self.end):
            text = f"{x:.12g} m"
            if x == self._move_inside(x, text):  # Numbers are whole, and in place, or not there.
                axes.plot([x, x], [edge, edge - 0.12 * self.margin], color=_INK, linewidth=3)
                self._write(axes, x, edge - 0.2 * self.margin, text, va="top")

    def _paint_marks(self, axes: Axes) -> None:
        """Draws lines across all lanes, and their names far enough off to stand clear of a ball."""
        edge = self.half_width + 0.45 * self.margin
        names: dict[float, str] = {}
        for name, x in self.marks.items():
            axes.plot([x, x], [-self.half_width, edge], "--", color=_INK, linewidth=3)
            # Names that would overlap are written as one.
            place = next((other for other in names if abs(other - x) < self.lane_width), x)
            names[place] = f"{names[place]}, {name}" if place in names else name
        for x, name in names.items():
            x = self._move_inside(x, name)
            self._write(axes, x, edge + 0.1 * self.margin, name, va="bottom")

    def _move_inside(self, x: float, text: str) -> float:
        """Returns the nearest place to x where a text over it is whole."""
        half_width = len(text) * _BOLD_WIDTH * _SCALE_HEIGHT * self.lane_width / 2
        return min(max(x, self.start + half_width), self.end - half_width)

    def _write(self, axes: Axes, x: float, y: float, text: str, va: str) -> None:
        """Writes a text over x, below or above y."""
        size = self._font_size(_SCALE_HEIGHT)
        outline = withStroke(foreground="white", linewidth=size / 5)  # Before a dark wall, too.
        axes.text(
            *(x, y, text),
            color=_INK,
            size=size,
            weight="bold",
            ha="center",
            va=va,
            path_effects=[outline],
        )

    def _font_size(self, height: float) -> float:
        """Returns the size in points for a height as a part of a lane's width."""
        return 72 * _INCHES * height * self.lane_width


def _textured_quad(corners: npt.NDArray[np.float64], png: bytes) -> dict[str, Any]:
    """Returns a glTF of a quad with a picture on it, which no light shades.

    Args:
        corners: x and y, counter-clockwise from the picture's lower left, shape (4, 2) [m].
        png: the picture.
    """
    # glTF is y-up, which Drake turns to z-up: (x, y, z) → (x, −z, y).
    positions = np.column_stack([corners[:, 0], np.zeros(4), -corners[:, 1]]).astype(np.float32)
    texture = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype=np.float32)
    triangles = np.array([0, 1, 2, 0, 2, 3], dtype=np.uint16)
    parts = [array.tobytes() for array in (positions, texture, triangles)]
    starts = np.cumsum([0, *map(len, parts)]).tolist()
    bounds = {"min": positions.min(axis=0).tolist(), "max": positions.max(axis=0).tolist()}
    float_type, short_type = 5126, 5123
    return {
        "asset": {"version": "2.0"},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [
            {
                "primitives": [
                    {
                        "attributes": {"POSITION": 0, "TEXCOORD_0": 1},
                        "indices": 2,
                        "material": 0,
                    }
                ]
            }
        ],
        "materials": [
            {
                "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0},
                "alphaMode": "BLEND",
                "doubleSided": True,
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "textures": [{"source": 0}],
        "images": [{"uri": _data_uri("image/png", png)}],
        "buffers": [
            {
                "uri": _data_uri("application/octet-stream", b"".join(parts)),
                "byteLength": starts[-1],
            }
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": start, "byteLength": len(part)}
            for start, part in zip(starts, parts, strict=False)
        ],
        "accessors": [
            {"bufferView": 0, "componentType": float_type, "count": 4, "type": "VEC3", **bounds},
            {"bufferView": 1, "componentType": float_type, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": short_type, "count": 6, "type": "SCALAR"},
        ],
    }


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"
