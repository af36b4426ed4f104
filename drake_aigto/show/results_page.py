"""The results page: Markdown and figures, made of files of results and nothing else."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from drake_aigto.errors import ResultsFileError
from drake_aigto.show.ablation_page import write_ablations
from drake_aigto.show.images import Images
from drake_aigto.show.robustness_page import write_robustness
from drake_aigto.show.scenario_page import write_scenarios
from drake_aigto.study import robustness_results
from drake_aigto.study.ablations import AblationQuestion
from drake_aigto.study.results_file import read_results
from drake_aigto.study.scenario_question import ScenarioQuestion
from drake_aigto.world.files import check_writable, write_text

# Kind of results → what makes Markdown and images of its files, in the order of the page.
_SECTIONS: Mapping[str, Callable[[Sequence[Path], Images], str]] = {
    ScenarioQuestion.kind: write_scenarios,
    AblationQuestion.kind: write_ablations,
    robustness_results.KIND: write_robustness,
}


def write_results_page(files: Iterable[str | Path], page: str | Path) -> None:
    """Writes a page on all results, and its pictures into a folder `images` beside it.

    Args:
        files: of results, of any kinds.
        page: the Markdown file.

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
        if kind not in _SECTIONS:
            raise ResultsFileError(
                f"results file {file}",
                got=f"kind {kind!r}",
                expected=f"one of {', '.join(map(repr, _SECTIONS))}",
            )
        by_kind[kind].append(file)
    images.folder.mkdir(exist_ok=True)
    sections = [write(by_kind[kind], images) for kind, write in _SECTIONS.items() if by_kind[kind]]
    write_text(page, "\n".join([_head(by_kind.values()), *sections]))


def _head(files: Iterable[Sequence[Path]]) -> str:
    names = ", ".join(f"`{path.name}`" for paths in files for path in paths)
    return f"""\
# Results

Made by `drake-aigto bench page` of saved results: {names}.
To change it, measure again and make it again.
"""
