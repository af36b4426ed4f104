"""Meshcat's pages inside another page: packed, and what they share only once."""

from __future__ import annotations

import base64
import gzip
import html
import re
from collections.abc import Mapping, Sequence
from importlib import resources

# Base64 of so many letters is packed as the bytes that it stands for, which compress better.
_RUN = re.compile(r"(?<=base64,)[A-Za-z0-9+/]{200,}={0,2}")
_LENGTH_BYTES = 4


def embed_scenes(scenes: Mapping[str, str], height: int = 560) -> str:
    """Returns HTML that shows Meshcat's pages in a frame, with a button for each and a slider.

    Nothing is fetched from anywhere: a script unpacks the chosen page as it is first shown. The
    library that the pages share, by far the most of them, is there once.

    Args:
        scenes: title → `Meshcat.StaticHtml()`; at least one.
        height: of the frame [px].
    """
    stored = "\n".join(
        f'<script type="text/plain" id="scene-{name}">{pack(text)}</script>'
        for name, text in _share(list(scenes.values())).items()
    )
    buttons = "".join(
        f'<button type="button" data-scene="{i}">{html.escape(title)}</button>'
        for i, title in enumerate(scenes)
    )
    player = resources.files("drake_aigto.show").joinpath("player.html").read_text("utf-8")
    return player.format(buttons=buttons, height=height) + stored + _script()


def _share(pages: Sequence[str]) -> dict[str, str]:
    """Returns the start and the end that pages share, and by number what each has in between."""
    start = _common_start(pages) if len(pages) > 1 else ""
    rests = [page[len(start) :][::-1] for page in pages]
    end = _common_start(rests)[::-1] if len(pages) > 1 else ""
    middles = {str(i): page[len(start) : len(page) - len(end)] for i, page in enumerate(pages)}
    return {"start": start, "end": end, **middles}


def _common_start(texts: Sequence[str]) -> str:
    """Returns the longest text that all begin with: that of the first and the last in order."""
    first, last = min(texts), max(texts)
    same = (i for i, (a, b) in enumerate(zip(first, last, strict=False)) if a != b)
    return first[: next(same, min(len(first), len(last)))]


def pack(text: str) -> str:
    """Returns text in Base64, compressed: by turns text and bytes, each after its length."""
    pieces: list[bytes] = []
    done = 0
    for run in _RUN.finditer(text):
        content = _decode(run[0])
        if content is not None:
            pieces += [text[done : run.start()].encode(), content]
            done = run.end()
    pieces.append(text[done:].encode())
    joined = b"".join(len(each).to_bytes(_LENGTH_BYTES, "big") + each for each in pieces)
    return base64.b64encode(gzip.compress(joined, mtime=0)).decode("ascii")


def _decode(run: str) -> bytes | None:
    """Returns the bytes of Base64, if encoding them gives the same letters again."""
    if len(run) % 4:
        return None
    content = base64.b64decode(run)
    return content if base64.b64encode(content).decode("ascii") == run else None


def _script() -> str:
    script = resources.files("drake_aigto.show").joinpath("player.js").read_text("utf-8")
    return f"<script>\n{script}</script>\n"
