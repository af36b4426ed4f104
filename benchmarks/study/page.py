"""The results page: Markdown and figures, made of files of results and nothing else."""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.study.scenario_study import read_results
from drake_aigto.errors import ResultsFileError
from drake_aigto.output import check_writable, write_bytes, write_text


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
        """Writes a figure as PNG, and returns Markdown that shows it, with an alternative text.

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
    """Part of the page on one kind of study.

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


def markdown_table(head: Sequence[str], rows: Iterable[Iterable[str]]) -> str:
    """Returns a table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def write_results_page(
    files: Iterable[str | Path], page: str | Path, sections: Mapping[str, Section]
) -> None:
    """Writes a page on results of any kinds, and its pictures into a folder `images` beside it.

    The page is Markdown and has one of the sections for each kind, in their order.

    Raises:
        OutputFileError: the page, or the folder of images, can't be written.
        ResultsFileError: a file can't be read, or is of a kind that no section is about.
    """
    page = Path(page)
    images = Images(page, page.parent / "images")
    check_writable(page)
    by_kind = defaultdict(list)
    for file in map(Path, files):
        kind = read_results(file)["kind"]
        if kind not in sections:
            raise ResultsFileError(
                f"results file {file}",
                got=f"kind {kind!r}",
                expected=f"one of {', '.join(map(repr, sections))}",
            )
        by_kind[kind].append(file)
    images.folder.mkdir(exist_ok=True)
    texts = [each.write(by_kind[kind], images) for kind, each in sections.items() if by_kind[kind]]
    names = ", ".join(f"`{path.name}`" for paths in by_kind.values() for path in paths)
    head = f"""\
# Results

Made by `python -m benchmarks page` of saved results: {names}.
To change it, measure again and make it again.
"""
    write_text(page, "\n".join([head, *texts]))
