"""The results page: Markdown and figures, made of files of results and nothing else."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from drake_aigto.errors import ResultsFileError
from drake_aigto.show.images import Images, Section
from drake_aigto.show.scenario_page import SCENARIOS
from drake_aigto.study.results_file import read_results
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.world.files import check_writable, write_text

# Kind of results → what the page says of them, in its order.
Sections = Mapping[str, Section]
SECTIONS: Sections = {ScenarioQuestion.kind: SCENARIOS}


def write_results_page(
    files: Iterable[str | Path],
    page: str | Path,
    sections: Sections = SECTIONS,
    command: str = "drake-aigto bench page",
) -> None:
    """Writes a page on results of any kinds, and its pictures into a folder `images` beside it.

    The page is Markdown, says which command made it, and has one of the sections for each kind.

    Raises:
        OutputFileError: the page, or the folder of images, can't be written.
        ResultsFileError: a file can't be read, or is of a kind that this page knows nothing of.
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
    write_text(page, "\n".join([_head(command, by_kind.values()), *texts]))


def _head(command: str, files: Iterable[Sequence[Path]]) -> str:
    names = ", ".join(f"`{path.name}`" for paths in files for path in paths)
    return f"""\
# Results

Made by `{command}` of saved results: {names}.
To change it, measure again and make it again.
"""
