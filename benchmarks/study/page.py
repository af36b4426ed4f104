"""The results page: Markdown and figures, made of files of results and nothing else."""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from matplotlib.figure import Figure

from benchmarks.study.scenario_study import read_results
from drake_aigto.errors import ResultsFileError
from drake_aigto.plain import check_writable, write_bytes, write_text

# Of files of one kind, and the page: Markdown in parts.
Section: TypeAlias = Callable[[Sequence[Path], Path], Iterable[str]]


def add_figure(page: Path, name: str, figure: Figure, text: str) -> str:
    """Writes a figure as PNG beside a page, and returns Markdown that shows it.

    Raises:
        OutputFileError: it can't be written.
    """
    path, data = page.parent / "images" / f"{page.stem}_{name}.png", io.BytesIO()
    figure.savefig(data, format="png", dpi=150)
    write_bytes(path, data.getvalue())
    return f"![{text}]({path.relative_to(page.parent).as_posix()})\n"


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
    (page.parent / "images").mkdir(exist_ok=True)
    parts = [
        part for kind in sections if by_kind[kind] for part in sections[kind](by_kind[kind], page)
    ]
    names = ", ".join(f"`{path.name}`" for paths in by_kind.values() for path in paths)
    head = f"""\
# Results

Made by `python -m benchmarks page` of saved results: {names}.
To change it, measure again and make it again.
"""
    write_text(page, "\n".join([head, *parts]))
