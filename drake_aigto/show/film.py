"""Recordings in Drake's Meshcat: what is keyed, the shapes that are drawn, and the camera."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import resources

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from PIL import Image
from pydrake.common import MemoryFile
from pydrake.geometry import (
    Cylinder,
    InMemoryMesh,
    Mesh,
    Meshcat,
    MeshcatAnimation,
    MeshcatCone,
    MeshcatParams,
    Rgba,
    Shape,
)
from pydrake.math import RigidTransform, RotationMatrix

from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError

# All that is drawn lies below this path.
ROOT = "/drake_aigto"

# The end is held for a moment [s], then all parts start again, together; the page's player counts
# no seconds of that (`player.js`).
HOLD = 0.5
_REPETITIONS = 10_000
# Scale of what is not to be seen: at 0 a transform has no inverse, of which browsers complain.
GONE = 1e-3
_PORTS = 1024, 65535  # That any user may listen at.

# Seen in a window of this width to height, and this much farther back.
ASPECT_RATIO, _SLACK = 1.4, 1.08

# As parts of the window's size: the longest arrow, the radius of the largest arc, from a cone's tip
# to its rim.
LONGEST, _ARC, _CONE = 0.15, 0.085, 0.14
# Of the longest arrow: its head, its head's and its shaft's radius.
_POINT, _POINT_RADIUS, _SHAFT_RADIUS = 0.32, 0.1, 0.04
# Of an arc with radius 1: half the thickness of its ring, the radius and the length of its head.
_RING, _HEAD, _HEAD_LENGTH = 0.07, 0.22, 0.55
_TURN = np.deg2rad(250.0)  # that an arc takes
_SECTIONS, _SIDES = 36, 8  # of the ring that an arc is made of
_RIBS = 4  # of an open cone
_RIB, _WIDEST = 0.018, 0.12  # Half their thickness, of its length; of its radius at most.
# Of what is hidden by another shape in its place, a layer: in steps of the depth buffer, 3e-5 each
# of the window's size for cameras as of `look_at`.
_UNITS = 40.0
_FILLED = 0.4  # how much a filled cone covers of what is behind it

# Of a picture: colors; a color that is off by more than this is another one; as a part of the
# pixels, how many may be.
_COLORS, _LOST, _MOST_LOST = 256, 64, 0.01


def open_meshcat(port: int | None = None) -> Meshcat:
    """Returns a Meshcat that browsers of this machine can open (`Meshcat.web_url`).

    Args:
        port: where it listens: any free one if 0, the first free one from 7000 to 7999 if None.

    Raises:
        OptionsError: the port is in use, or no user may listen there.
    """
    got = "none of 7000 to 7999 that is free" if port is None else f"{port}"
    # Drake ends the process below, and takes the port's last 16 bits above.
    if not port or _PORTS[0] <= port <= _PORTS[1]:
        with suppress(RuntimeError):
            return Meshcat(MeshcatParams(port=port, show_stats_plot=False))
        got += ", in use" if port else ""
    raise OptionsError(
        "Meshcat's port",
        got=got,
        expected=f"a free one, {_PORTS[0]} to {_PORTS[1]}",
        remedy="Name another port, or 0 for any that is free.",
    )


class Film:
    """A recording in the making, whose parts all have one length, so that they repeat together.

    How something looks when it is first keyed is also how it looks before the film is played.

    Attributes:
        meshcat: where it is shown.
        rate: frames per second.
        last_frame: that all parts end with.
    """

    def __init__(self, meshcat: Meshcat, begin: float, end: float, rate: int) -> None:
        """Begins with a frame at one time, and ends with one at another, held for a moment [s].

        What was shown below `ROOT` before is gone; Meshcat's grid, axes and background are hidden.
        """
        self.meshcat, self.rate, self._begin = meshcat, rate, begin
        self.last_frame = self.frame(end + HOLD)
        self._animation, self._keyed = MeshcatAnimation(rate), set[tuple[str, str]]()
        meshcat.Delete(ROOT)
        for path in ("/Background", "/Grid", "/Axes"):
            meshcat.SetProperty(path, "visible", False)

    def frame(self, time: float) -> int:
        """Returns the frame of a time [s]."""
        return round((time - self._begin) * self.rate)

    def move(self, frame: int, path: str, pose: RigidTransform) -> None:
        """Puts an object somewhere at a frame."""
        if (path, "") not in self._keyed:
            self._keyed.add((path, ""))
            self.meshcat.SetTransform(path, pose)
        self._animation.SetTransform(frame, path, pose)

    def change(self, frame: int, path: str, name: str, value: bool | list[float]) -> None:
        """Gives a property of an object a value at a frame."""
        if (path, name) not in self._keyed:
            self._keyed.add((path, name))
            self.meshcat.SetProperty(path, name, value)
        self._animation.SetProperty(frame, path, name, value)

    def show_between(self, path: str, first: int, end: int) -> None:
        """Makes an object visible from a frame until another."""
        for frame in sorted({0, first, end, self.last_frame}):
            if frame <= self.last_frame:
                self.change(frame, path, "visible", first <= frame < end)

    def ride(self, path: str, frames: Sequence[int], places: Floats, vectors: Floats) -> None:
        """Moves an object to places (K, 3) at frames, its z along vectors (K, 3), sized by these.

        Where vectors are zero for long no frames are keyed.
        """
        direction = np.array([0.0, 0.0, 1.0])
        sizes = np.linalg.norm(vectors, axis=1)
        seen = np.convolve(sizes > GONE, np.ones(3))[1:-1] > 0  # the rows beside those, too
        seen[0] = True
        for row in np.flatnonzero(seen).tolist():
            direction = vectors[row] / sizes[row] if sizes[row] > GONE else direction
            turned = RotationMatrix.MakeFromOneVector(direction, 2)
            self.move(frames[row], path, RigidTransform(turned, places[row]))
            self.change(frames[row], path, "scale", [max(sizes[row], GONE)] * 3)
        for frame in (frames[-1] + 1, self.last_frame):
            self.change(frame, path, "scale", [GONE] * 3)

    def moments(
        self, times: Iterable[float], shown: Mapping[int, bool]
    ) -> list[tuple[int, int, bool]]:
        """Returns frames, the number of a moment [s], and whether it is seen there.

        Each is seen or not a number of frames after it, until the next one begins.
        """
        keys: dict[int, tuple[int, bool]] = {}
        for number, time in enumerate(times):
            frame = self.frame(time)
            keys = {f: key for f, key in keys.items() if f < frame - 1}
            keys |= {max(frame + after, 0): (number, seen) for after, seen in shown.items()}
        return [(frame, *keys[frame]) for frame in sorted(keys)]

    def play(self) -> None:
        """Plays it again and again."""
        self._animation.set_loop_mode(MeshcatAnimation.LoopMode.kLoopRepeat)
        self._animation.set_repetitions(_REPETITIONS)
        self.meshcat.SetAnimation(self._animation)


def look_at(
    meshcat: Meshcat,
    X_WP: RigidTransform,
    corners: tuple[Floats, Floats],
    angles: tuple[float, float, float],
) -> float:
    """Has the camera see all of a rectangle in a frame P's x and y, from P's z.

    Corners are lower left and upper right, (2,) each [m]; angles the vertical field of view, and
    from how far above, and from how far right [rad]. P's y is up in the window. Returns half the
    height of what is seen there [m].
    """
    (low, high), (view, up, right) = corners, angles
    distance = _SLACK * float(np.max((high - low) / [ASPECT_RATIO, 1.0])) / 2 / np.tan(view / 2)
    middle = np.append((low + high) / 2, 0.0)
    back = np.array([np.sin(right) * np.cos(up), np.sin(up), np.cos(right) * np.cos(up)])
    near, far = distance / 100, 2 * distance
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=np.rad2deg(view), near=near, far=far))
    eye = middle + distance * back
    meshcat.SetCameraPose(X_WP.multiply(eye), X_WP.multiply(middle))
    return distance * float(np.tan(view / 2))


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


def put_in_front(path: str, shape: Shape, meshcat: Meshcat, color: Rgba) -> None:
    """Puts a shape that nothing hides: it is drawn over all that is there before."""
    meshcat.SetObject(path, shape, color)
    _draw_last(path, meshcat)


def put_behind(path: str, meshcat: Meshcat, layer: int) -> None:
    """Has a shape hidden by those of lower layers in the same place, or a thousandth in front."""
    for name, value in (("", True), ("Factor", 2.0 * layer), ("Units", _UNITS * layer)):
        meshcat.SetProperty(f"{path}/<object>", f"material.polygonOffset{name}", value)


def _draw_last(path: str, meshcat: Meshcat) -> None:
    meshcat.SetProperty(f"{path}/<object>", "material.depthTest", False)
    meshcat.SetProperty(f"{path}/<object>", "renderOrder", 1.0)


def shape_arrow(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the longest arrow along z, for a window of a size [m]."""
    length = LONGEST * size
    shaft, head = (1 - _POINT) * length, _POINT * length
    put_in_front(f"{path}/shaft", Cylinder(_SHAFT_RADIUS * length, shaft), meshcat, color)
    meshcat.SetTransform(f"{path}/shaft", RigidTransform([0, 0, shaft / 2]))
    # Meshcat's cones stand on their tips.
    cone = MeshcatCone(head, *[_POINT_RADIUS * length] * 2)
    put_in_front(f"{path}/head", cone, meshcat, color)
    tip = RigidTransform(RotationMatrix.MakeXRotation(np.pi), [0, 0, length])
    meshcat.SetTransform(f"{path}/head", tip)


def shape_arc(path: str, size: float, meshcat: Meshcat, color: Rgba) -> None:
    """Puts the largest arc around z, its head the way that a right hand's fingers curl."""
    r = _ARC * size
    _shape_ring(f"{path}/ring", r, _RING * r, _TURN, meshcat, color)
    # Meshcat's cones stand on their tips.
    cone = MeshcatCone(_HEAD_LENGTH * r, *[_HEAD * r] * 2)
    put_in_front(f"{path}/head", cone, meshcat, color)
    end, ahead = (np.array([np.cos(a), np.sin(a), 0.0]) for a in (_TURN, _TURN + np.pi / 2))
    turned = RotationMatrix.MakeFromOneVector(-ahead, 2)
    tip = RigidTransform(turned, r * (end + 0.9 * _HEAD_LENGTH * ahead))
    meshcat.SetTransform(f"{path}/head", tip)


def shape_cone(
    path: str, size: float, meshcat: Meshcat, color: Rgba, friction: float, sticks: bool
) -> None:
    """Puts a cone of forces |f_t| ≤ μ f around z, its tip where they act.

    It is translucent and closed where contacts stick, else its ribs and its rim.
    """
    height = _CONE * size / float(np.hypot(1.0, friction))
    radius, length = friction * height, _CONE * size
    if sticks:
        pale = Rgba(color.r(), color.g(), color.b(), _FILLED)
        put_in_front(path, MeshcatCone(height, radius, radius), meshcat, pale)
        return
    thin = min(_RIB * length, _WIDEST * radius)
    for number, angle in enumerate(_around(_RIBS)):
        along = np.array([radius * np.cos(angle), radius * np.sin(angle), height])
        put_in_front(f"{path}/rib_{number}", Cylinder(thin, length), meshcat, color)
        turned = RotationMatrix.MakeFromOneVector(along / length, 2)
        meshcat.SetTransform(f"{path}/rib_{number}", RigidTransform(turned, along / 2))
    _shape_ring(f"{path}/rim", radius, thin, 2 * np.pi, meshcat, color)
    meshcat.SetTransform(f"{path}/rim", RigidTransform([0.0, 0.0, height]))


def _shape_ring(
    path: str, radius: float, thickness: float, turn: float, meshcat: Meshcat, color: Rgba
) -> None:
    """Puts a bent rod around z, half as thick as that all around [m], over a turn [rad]."""
    # Rings of points around the rod, joined by two triangles for each side of each section.
    angles, side = np.linspace(0, turn, _SECTIONS + 1)[:, np.newaxis], _around(_SIDES)
    out, up = radius + thickness * np.cos(side), thickness * np.sin(side)
    rings = [out * np.cos(angles), out * np.sin(angles), np.tile(up, (len(angles), 1))]
    first = np.arange(_SECTIONS * _SIDES)
    beside = first - first % _SIDES + (first + 1) % _SIDES
    triangles = np.hstack(
        [(first, beside, first + _SIDES), (beside, beside + _SIDES, first + _SIDES)]
    )
    vertices = np.array([each.ravel() for each in rings])
    meshcat.SetTriangleMesh(path, vertices, triangles.astype(np.int32), color)
    _draw_last(path, meshcat)


def _around(count: int) -> Floats:
    """Returns the angles of `count` points around a circle [rad]."""
    return 2 * np.pi * np.arange(count) / count


def on_white(color: Rgba) -> tuple[float, float, float]:
    """Returns how a translucent color looks on white."""
    red, green, blue = (1 - color.a() * (1 - part) for part in (color.r(), color.g(), color.b()))
    return red, green, blue
