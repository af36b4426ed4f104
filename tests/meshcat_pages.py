"""What Meshcat sends to a browser, read in tests; and motions to be shown."""

from __future__ import annotations

import base64
import re
from collections.abc import Iterator
from typing import Any

import msgpack
import numpy as np
from pydrake.geometry import Meshcat

from drake_aigto.show import ROOT, Motion

BALL = "point_mass_and_wall/ball/ball_visual"


def make_motion(label: str, end: float, duration: float = 1.0) -> Motion:
    """Returns a motion from 1 m to the wall and on to an end, at two speeds."""
    times = np.linspace(0, duration, 21)
    q = np.interp(times, [0, duration / 2, duration], [1.0, 0.0, end])[:, np.newaxis]
    return Motion(label, times, q, np.gradient(q[:, 0], times)[:, np.newaxis])


MOTIONS = [make_motion("plan", 0.73), make_motion("rigid", 0.6), make_motion("Drake", 0.5, 0.8)]


def messages(html: str) -> Iterator[dict[str, Any]]:
    """Yields what a page of Meshcat's shows, message by message."""
    for text in re.findall(r'fetch\("data:application/octet-binary;base64,([^"]+)"\)', html):
        yield msgpack.unpackb(base64.b64decode(text), strict_map_key=False)


def objects(meshcat: Meshcat) -> dict[str, Any]:
    sent = list(messages(meshcat.StaticHtml()))
    return {m["path"]: m["object"] for m in sent if m["type"] == "set_object"}


def position(meshcat: Meshcat, path: str) -> np.ndarray:
    """Returns where an object stands when nothing is played."""
    sent = list(messages(meshcat.StaticHtml()))
    (matrix,) = (m["matrix"] for m in sent if m["type"] == "set_transform" and m["path"] == path)
    return np.array(matrix).reshape(4, 4).T[:3, 3]


def recording(meshcat: Meshcat) -> dict[str, Any]:
    (message,) = (m for m in messages(meshcat.StaticHtml()) if m["type"] == "set_animation")
    return message


def clips(meshcat: Meshcat, name: str = "position") -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Returns the times (F,) [s] and values (F, k) of a property, for all paths that record it."""
    result = {}
    for animation in recording(meshcat)["animations"]:
        for each in animation["clip"]["tracks"]:
            if each["name"] == f".{name}":
                frames = np.array([key["time"] for key in each["keys"]])
                values = np.array([key["value"] for key in each["keys"]])
                result[animation["path"]] = (frames / animation["clip"]["fps"], values)
    return result


def ball(lane: int) -> str:
    """Returns the ball's path in a lane, counted from 1."""
    return f"{ROOT}/motions/{lane}/{BALL}"
