"""Files of meshes that Drake reads, and copies of others that it does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

# What Drake reads.
MESHES = (".obj", ".vtk", ".gltf")
# What the extra reads, and the modules that it takes.
_COPIED = {".dae": ("trimesh", "collada"), ".ply": ("trimesh",), ".stl": ("trimesh",)}
_COLORED = (".dae",)  # Of these, copies keep the colors.
_NEED = f"Drake reads {', '.join(MESHES[:-1])} and {MESHES[-1]}"


def is_readable(file: Path, kinds: Sequence[str] = MESHES) -> bool:
    """Returns whether a mesh's file is of these kinds, or can be copied to one (`read_mesh`)."""
    kind = file.suffix.lower()
    found = kind in kinds or (kind in _COPIED and all(map(find_spec, _COPIED[kind])))
    return found and file.is_file()


def read_mesh(file: Path, kinds: Sequence[str] = MESHES) -> Path | None:
    """Returns a mesh's file, or a copy of one of these kinds; None if it can't be read.

    Copies are in meters, without the axis that Collada calls up, as ROS has it. They last as long
    as this process.
    """
    if not is_readable(file, kinds) or file.suffix.lower() in kinds:
        return file if is_readable(file, kinds) else None
    has_color = ".gltf" in kinds and file.suffix.lower() in _COLORED
    return _copy(file.resolve(), file.stat().st_mtime_ns, ".gltf" if has_color else ".obj")


def explain(file: Path, others: int = 0) -> str:
    """Returns why a mesh, and others with it, can't be read, and what to do."""
    kind, name = file.suffix.lower(), file.name + (others > 0) * f" and {others} other meshes"
    if not file.is_file():
        return f"no file {name}" if kind else name
    if kind not in _COPIED:
        return f"{name}: {_NEED}"
    if all(map(find_spec, _COPIED[kind])):
        return f"{name}: it holds no mesh"
    extra = f"pip install 'drake_aigto[meshes]' reads {', '.join(_COPIED)} as well"
    return f"{name}: {_NEED}; {extra}"


@cache
def _folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="drake_aigto_meshes_")


@cache
def _copy(file: Path, _: int, kind: str) -> Path | None:
    """Writes a copy of a mesh, and returns its file; None if it is none.

    Args:
        file: of the mesh.
        _: when it was changed [ns]: another copy is made then.
        kind: of the copy.
    """
    trimesh: Any = import_module("trimesh")
    try:
        scene = trimesh.load_scene(file)
        if not scene.area:
            return None
        scene = scene.convert_units("meters") if scene.units else scene
        copy = Path(_folder().name) / f"{len(list(Path(_folder().name).iterdir()))}{kind}"
        if kind == ".gltf":  # Its y is up, and Drake turns it.
            scene.apply_transform(trimesh.transformations.rotation_matrix(-math.pi / 2, [1, 0, 0]))
            files = trimesh.exchange.gltf.export_gltf(scene, merge_buffers=True, embed_buffers=True)
            copy.write_bytes(files["model.gltf"])
        else:
            look = {"include_color": False, "include_texture": False}
            copy.write_text(scene.to_mesh().export(file_type="obj", **look), encoding="utf-8")
    except Exception:  # What a damaged file raises is for trimesh to choose.
        return None
    return copy
