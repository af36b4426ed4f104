"""The pictures of a page: where they lie, and how the page shows them."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from drake_aigto.world.files import write_bytes


@dataclass(frozen=True)
class Images:
    """A folder beside a page, and what its pictures' names begin with.

    Attributes:
        page: the page's path.
        folder: of the pictures, under the page's own.
    """

    page: Path
    folder: Path

    def add(self, name: str, figure: Figure, text: str) -> str:
        """Writes a figure as PNG; returns Markdown that shows it, or a text to who can't see it.

        Raises:
            OutputFileError: it can't be written.
        """
        path = self.folder / f"{self.page.stem}_{name}.png"
        data = io.BytesIO()
        figure.savefig(data, format="png", dpi=150)
        write_bytes(path, data.getvalue())
        return f"![{text}]({path.relative_to(self.page.parent).as_posix()})\n"
