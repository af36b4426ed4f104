"""Pictures that lie in a Meshcat scene."""

from __future__ import annotations

import base64
import io
import json
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from PIL import Image
from pydrake.common import MemoryFile
from pydrake.geometry import InMemoryMesh, Mesh

from drake_aigto.arrays import Floats

_COLORS = 256


def make_mesh(figure: Figure, low: npt.ArrayLike, high: npt.ArrayLike) -> Mesh:
    """Returns a flat shape with a figure on it, in a frame's x and y.

    Args:
        figure: its picture is this rectangle's.
        low: its lower left corner, shape (2,) [m].
        high: its upper right corner [m].
    """
    (left, bottom), (right, top) = np.array([low, high])
    corners = np.array([(left, bottom), (right, bottom), (right, top), (left, top)])
    gltf = _textured_quad(corners, _draw(figure))
    return Mesh(InMemoryMesh(mesh_file=MemoryFile(json.dumps(gltf), ".gltf", "picture")))


def _draw(figure: Figure) -> bytes:
    """Returns a figure as a PNG of few colors, a third as large as one of all."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    pixels = Image.open(drawn)
    # Of Pillow's methods the one that keeps transparency.
    picture = pixels.quantize(_COLORS, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    written = io.BytesIO()
    picture.save(written, format="png", optimize=True)
    return written.getvalue()


def _textured_quad(corners: Floats, png: bytes) -> dict[str, Any]:
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
