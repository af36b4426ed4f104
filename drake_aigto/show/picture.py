"""Pictures that lie in a Meshcat scene."""

from __future__ import annotations

import base64
import io
import json
from importlib import resources

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from PIL import Image
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh

_COLORS = 256
# A color that is off by more than this is another one; as a part of the pixels, how many may be.
_LOST, _MOST_LOST = 64, 0.01


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
