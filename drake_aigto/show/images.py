"""The sections of a results page, and its pictures: where they lie, and how it shows them."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Sequence
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


@dataclass(frozen=True)
class Section:
    """What a page says of one kind of study.

    Attributes:
        introduction: before all studies.
        describe: gives Markdown on the study of a file, and draws its figures; raises
            ResultsFileError if the file is damaged.
        conclusion: after all studies.
    """

    introduction: str
    describe: Callable[[Path, Images], Iterable[str]]
    conclusion: str = ""

    def write(self, paths: Sequence[Path], images: Images) -> str:
        """Returns Markdown on the studies of some files.

        Raises:
            ResultsFileError: a file is damaged.
        """
        parts = [part for path in paths for part in self.describe(path, images)]
        return "\n".join([self.introduction, *parts, *filter(None, [self.conclusion])])
