"""Recordings for a page or a notebook: what Meshcat plays, and what is said beside it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydrake.geometry import Meshcat

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.output import write_text
from drake_aigto.show.film import ASPECT_RATIO
from drake_aigto.show.motion import Motion
from drake_aigto.show.page import Page, Scene
from drake_aigto.show.shapes import coordinate_names, read_coordinates
from drake_aigto.show.text import touch_names
from drake_aigto.world import Scenario, World, list_units, name_controls

_APART = 1.06  # from one motion to the next when they stand side by side, in windows
_MOST_NUMBERS = 400  # rows of the table of numbers
_NOTHING = 1e-9  # of a column's largest number: rounding


@dataclass(frozen=True, eq=False)
class Playback:
    """What a Meshcat plays, and what a page says beside it.

    A notebook shows it as a page in a frame, which needs no network.

    Attributes:
        meshcat: that plays it, until something else is published there.
        beside: plain data for the page's player: a title, motions, explanations, events, numbers,
            and how far the scene reaches (`publish`).
    """

    meshcat: Meshcat
    beside: Mapping[str, Any]

    @property
    def scene(self) -> Scene:
        """What a page needs of it."""
        return self.meshcat.StaticHtml(), self.beside

    @property
    def page(self) -> Page:
        """One self-contained page with a player."""
        page = Page(self.beside.get("title", "AIGO's boxes"))
        page.scenes({"Recording": self.scene})
        return page

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes that page, whole or not at all.

        Raises:
            OutputFileError: it can't be written; its folder must exist.
        """
        write_text(path, self.page.to_html())

    def _repr_html_(self) -> str:
        return self.page._repr_html_()

    def __str__(self) -> str:
        """Returns what is solid and what are ghosts."""
        (_, first), *others = self.beside.get("motions", [("", "AIGO's boxes")])
        ghosts = f"; ghosts: {'; '.join(label for _, label in others)}" if others else ""
        return f"solid: {first}{ghosts}"


def stand_side_by_side(size: Floats, count: int) -> Floats:
    """Returns where each of several windows of a size (2,) stands, shape (count, 2) [m].

    They are centered, the first at the upper left, and seen as large as can be.
    """

    def find_scale(columns: int) -> float:
        return float(min(ASPECT_RATIO / columns / size[0], 1 / -(-count // columns) / size[1]))

    columns = max(range(1, count + 1), key=find_scale)
    row, column = np.divmod(np.arange(count), columns)
    middle = (columns - 1) / 2, (-(-count // columns) - 1) / 2
    return _APART * size * np.column_stack([column - middle[0], middle[1] - row])


def list_events(
    motion: Motion, world: World, others: Mapping[float, str]
) -> list[tuple[float, str, str]]:
    """Returns when what happens on a motion, and of which kind that is."""
    names = touch_names(world)
    touches = motion.touches or motion.impacts
    found = [(touch.start, f"touches {names[touch.contact]}", "touch") for touch in touches]
    found += [(time, text, "change") for time, text in others.items()]
    return sorted(dict.fromkeys(found))


def list_numbers(motion: Motion, world: World, scenario: Scenario) -> dict[str, Any]:
    """Returns a motion's coordinates and controls over time, with their names and units."""
    times = np.linspace(motion.times[0], motion.times[-1], _MOST_NUMBERS)
    names = [
        f"{name} [{unit}]" for name, unit in zip(coordinate_names(world), world.units, strict=True)
    ]
    read = read_coordinates(world, scenario, motion.positions)
    columns = list(interpolate(times, motion.times, read).T)
    if motion.controls is not None and motion.control_times is not None:
        held = np.searchsorted(motion.control_times, times, side="right") - 1
        columns += list(motion.controls[np.clip(held, 0, len(motion.controls) - 1)].T)
        count = world.num_actuators
        driven = name_controls(world.plant, count, has_prefix=False)
        names += [
            f"control {name} [{unit}]".replace("_", " ")
            for name, unit in zip(driven, list_units(world.plant, count), strict=True)
        ]
    seen = [np.where(np.abs(c) > _NOTHING * np.max(np.abs(c)), c, 0.0) for c in columns]
    rounded = [[float(f"{value:.4g}") for value in column] for column in seen]
    return {"times": times.round(4).tolist(), "names": names, "columns": rounded}
