"""One self-contained HTML page: headings, tables, figures, and recordings, which are made here."""

from __future__ import annotations

import base64
import gzip
import html
import io
import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from os.path import commonprefix
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from pydrake.geometry import Meshcat

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.plain import write_text
from drake_aigto.show.film import ASPECT_RATIO
from drake_aigto.show.motion import Motion
from drake_aigto.show.shapes import coordinate_names, read_coordinates
from drake_aigto.show.words import touch_names
from drake_aigto.world import Scenario, World, list_units, name_controls

# The same figure gives the same bytes, and looks the same whatever fonts a reader has.
_SVG: dict[Any, Any] = {"svg.hashsalt": "drake_aigto", "svg.fonttype": "path"}
_LONG = re.compile(r"(\d\d\.\d\d)\d+")  # what is drawn to a millionth of a point
# A URL in an attribute: a quarter shorter than Base64.
_IN_URL = str.maketrans({"%": "%25", "#": "%23", "&": "&amp;", '"': "'", "\n": " "})
_HEIGHT = 680  # of the frame in a notebook [px]
_DPI = 120  # of what is no lines: landscapes of many colors

# `Meshcat.StaticHtml()`, and what the player says beside it (`Playback`).
Scene = tuple[str, Mapping[str, Any]]

_common_start = commonprefix  # Of any texts: it compares letter by letter.


class Page:
    """A page that grows from top to bottom. What is added is text, and is escaped here."""

    def __init__(self, title: str) -> None:
        """Begins with a title."""
        self._title = title
        self._parts = [f"<h1>{html.escape(title)}</h1>"]

    def heading(self, text: str) -> None:
        """Adds a heading of a part."""
        self._parts.append(f"<h2>{html.escape(text)}</h2>")

    def paragraph(self, text: str) -> None:
        """Adds a paragraph."""
        self._parts.append(f"<p>{html.escape(text)}</p>")

    def verdict(self, text: str, holds: bool) -> None:
        """Adds the sentence that a reader must not miss."""
        kind, sign = ("holds", "✓") if holds else ("fails", "✗")
        words = html.escape(f"{text[0].upper()}{text[1:]}.".replace("\u00a0", " "))
        self._parts.append(f'<p class="verdict {kind}">{sign} {words}</p>')

    def code(self, text: str) -> None:
        """Adds lines that keep their form."""
        self._parts.append(f"<pre>{html.escape(text)}</pre>")

    def table(self, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """Adds a table whose first column names its rows."""
        head = "".join(f"<th>{html.escape(cell)}</th>" for cell in header)
        body = "".join(
            f"<tr><th>{html.escape(name)}</th>"
            + "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
            + "</tr>"
            for name, *cells in rows
        )
        self._parts.append(
            f'<div class="wide"><table><thead><tr>{head}</tr></thead>'
            f"<tbody>{body}</tbody></table></div>"
        )

    def facts(self, facts: Iterable[tuple[str, str]]) -> None:
        """Adds labels and texts as a table."""
        self.table(("", ""), [(label, text.replace("\u00a0", " ")) for label, text in facts])

    def figure(self, figure: Figure, caption: str, is_folded: bool = False) -> None:
        """Adds a figure as an inline SVG; the caption is also its text for screen readers.

        Of a folded one, a click on the caption shows it.
        """
        written = io.BytesIO()
        with mpl.rc_context(_SVG):
            figure.savefig(
                written, format="svg", dpi=_DPI, metadata={"Date": None, "Creator": None}
            )
        content = _LONG.sub(r"\1", written.getvalue().decode()).translate(_IN_URL)
        text = html.escape(caption)
        cursors = "".join(_find_plots(figure))
        drawn = (
            f'<div class="drawn"><img alt="{text}" '
            f'src="data:image/svg+xml,{content}">{cursors}</div>'
        )
        shown = f"{drawn}<figcaption>{text}</figcaption>"
        if is_folded:
            shown = f"<details><summary>{text}</summary>{drawn}</details>"
        self._parts.append(f"<figure>{shown}</figure>")

    def scenes(self, scenes: Mapping[str, Scene]) -> None:
        """Adds recordings by their titles; once in a page."""
        self._parts.append(embed_scenes(scenes))

    def to_html(self) -> str:
        """Returns the page. It needs no network, and may not use it."""
        title, body = html.escape(self._title), "\n".join(self._parts)
        return _asset("page.html").format(title=title, style=_asset("page.css"), body=body)

    def _repr_html_(self) -> str:
        """Returns the page in a frame, for a notebook."""
        look = f"width: 100%; height: {_HEIGHT}px; border: 0"
        return f'<iframe srcdoc="{html.escape(self.to_html())}" style="{look}"></iframe>'

    def to_fragment(self) -> str:
        """Returns what was added, without a page around it, in a notebook's own style."""
        return "\n".join(self._parts[1:])


def _find_plots(figure: Figure) -> Iterator[str]:
    """Yields where a drawn figure has axes over time, from when to when: for a player's cursor."""
    over_time = [axes for axes in figure.axes if axes.get_xlabel().startswith("time t")]
    for axes in figure.axes:
        if any(axes.get_shared_x_axes().joined(axes, other) for other in over_time):
            (left, bottom), (right, top) = axes.get_position().get_points()
            place = f"left:{left:.4%};top:{1 - top:.4%};width:{right - left:.4%}"
            first, last = axes.get_xlim()
            yield (
                f'<div class="plot" data-first="{first:.6g}" data-last="{last:.6g}" '
                f'style="{place};height:{top - bottom:.4%}"><i></i></div>'
            )


def embed_scenes(scenes: Mapping[str, Scene]) -> str:
    """Returns HTML that shows Meshcat's pages in a frame, with a button for each and a slider.

    Nothing is fetched from anywhere: a script unpacks the chosen page as it is first shown. The
    library that the pages share, by far the most of them, is there once. Of scenes there is at
    least one.
    """
    stored = "\n".join(
        f'<script type="text/plain" id="scene-{name}">{pack(text)}</script>'
        for name, text in _share([text for text, _ in scenes.values()]).items()
    )
    buttons = "".join(
        f'<button type="button" data-scene="{i}">{html.escape(title)}</button>'
        for i, title in enumerate(scenes)
    )
    player = _asset("player.html").format(buttons=buttons)
    beside = json.dumps([dict(each) for _, each in scenes.values()]).replace("<", "\\u003c")
    told = f'<script type="application/json" id="player-beside">{beside}</script>'
    return f"{player}{stored}{told}<script>\n{_asset('player.js')}</script>\n"


def _asset(name: str) -> str:
    return resources.files(__package__).joinpath(name).read_text("utf-8")


def _share(pages: Sequence[str]) -> dict[str, str]:
    """Returns the start and the end that pages share, and by number what each has in between."""
    several = pages if len(pages) > 1 else []
    start = _common_start(several)
    end = _common_start([page[len(start) :][::-1] for page in several])[::-1]
    middles = {str(i): page[len(start) : len(page) - len(end)] for i, page in enumerate(pages)}
    return {"start": start, "end": end, **middles}


def pack(text: str) -> str:
    """Returns text compressed, in Base64."""
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")


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
