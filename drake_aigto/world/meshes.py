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
from xml.etree.ElementTree import Element

from pydrake.geometry import Mesh, Shape
from pydrake.multibody.parsing import PackageMap

from drake_aigto.world.files import find_file, package_of

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
    if not is_readable(file, kinds):
        return None
    if file.suffix.lower() in kinds:
        return file
    copy = _copy(file.resolve(), file.stat().st_mtime_ns)
    has_color = ".gltf" in kinds and file.suffix.lower() in _COLORED
    return copy and copy.with_suffix(".gltf" if has_color else ".obj")


def uncolored(shape: Shape) -> Shape:
    """Returns a shape that is drawn in any color: of a copy with colors, the one without."""
    if not isinstance(shape, Mesh) or not shape.source().is_path():
        return shape
    plain = Path(shape.source().path()).with_suffix(".obj")
    is_copy = shape.extension() == ".gltf" and str(plain.parent) == _folder().name
    return Mesh(str(plain), shape.scale3()) if is_copy else shape


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


def find_mesh(shape: Element, path: Path, packages: PackageMap) -> Path | None:
    """Returns the file of a mesh, whose URI becomes absolute; None for any other shape."""
    mesh = shape.find("geometry/mesh")
    if mesh is None:
        return None
    uri = mesh.find("uri")
    text = (mesh.get("filename") if uri is None else uri.text) or ""
    found = find_file(text, path, packages)
    if found is None:
        package = package_of(text)
        return Path(f"in the unknown package {package}: name its folder by packages")
    if found.is_file():
        set_mesh(shape, found)
    return found


def set_mesh(shape: Element, file: Path) -> None:
    """Makes a file that of a shape's mesh."""
    uri = shape.find("geometry/mesh/uri")
    if uri is not None:
        uri.text = file.resolve().as_uri()
    elif (mesh := shape.find("geometry/mesh")) is not None:
        mesh.set("filename", file.resolve().as_uri())


@cache
def _folder() -> TemporaryDirectory[str]:
    return TemporaryDirectory(prefix="drake_aigto_meshes_")


@cache
def _copy(file: Path, _: int) -> Path | None:
    """Writes copies of a mesh, and returns their file but for its kind; None if it is none.

    Args:
        file: of the mesh.
        _: when it was changed [ns]: other copies are made then.
    """
    trimesh: Any = import_module("trimesh")
    try:
        scene = trimesh.load_scene(file)
        if not scene.area:
            return None
        scene = scene.convert_units("meters") if scene.units else scene
        copy = Path(_folder().name) / f"{len(list(Path(_folder().name).iterdir()))}"
        look = {"include_color": False, "include_texture": False}
        plain = scene.to_mesh().export(file_type="obj", **look)
        copy.with_suffix(".obj").write_text(plain, encoding="utf-8")
        if file.suffix.lower() in _COLORED:
            # Of glTF y is up, and Drake turns it.
            scene.apply_transform(trimesh.transformations.rotation_matrix(-math.pi / 2, [1, 0, 0]))
            files = trimesh.exchange.gltf.export_gltf(scene, merge_buffers=True, embed_buffers=True)
            copy.with_suffix(".gltf").write_bytes(files["model.gltf"])
    except Exception:  # What a damaged file raises is for trimesh to choose.
        return None
    return copy
