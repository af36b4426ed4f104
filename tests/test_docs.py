"""The documentation has a page for everything that is public.

Notebooks are kept as they should be; `.ci/run` runs them.

README and docs quote what benchmarks printed, and nothing else.
"""

from __future__ import annotations

import ast
import importlib
import json
import pkgutil
import re
from pathlib import Path
from typing import get_origin

import pytest

import drake_aigto
from benchmarks import records

API = Path(__file__).resolve().parents[1] / "docs" / "api"

# What people import; the others serve these.
INTERNAL = {"arrays", "cli", "kernels", "output", "plain"}


def public_modules() -> list[str]:
    found = {module.name for module in pkgutil.iter_modules(drake_aigto.__path__)}
    return sorted(found - INTERNAL)


def test_every_public_module_has_a_page_and_no_other() -> None:
    pages = sorted(page.stem for page in API.glob("*.md"))
    assert pages == sorted([*public_modules(), "drake_aigto"])


@pytest.mark.parametrize("name", public_modules())
def test_a_page_is_of_its_module(name: str) -> None:
    assert f".. automodule:: drake_aigto.{name}\n" in (API / f"{name}.md").read_text("utf-8")


@pytest.mark.parametrize("name", public_modules())
def test_every_public_name_is_documented(name: str) -> None:
    module = importlib.import_module(f"drake_aigto.{name}")
    assert module.__doc__
    for public in getattr(module, "__all__", ()):
        value = getattr(module, public)
        is_alias = get_origin(value) is not None  # Of types, which Python lets have no docstring.
        assert is_alias or not callable(value) or value.__doc__, public


def test_the_first_page_links_what_the_package_itself_has() -> None:
    text = (API / "drake_aigto.md").read_text("utf-8")
    linked = re.findall(r":py:obj:`~(drake_aigto\.[\w.]+)`", text)
    assert sorted(link.rpartition(".")[2] for link in linked) == drake_aigto.__all__
    for link in linked:
        module, _, name = link.rpartition(".")
        assert getattr(importlib.import_module(module), name) is getattr(drake_aigto, name)


def test_the_index_has_every_page() -> None:
    index = (API.parent / "index.md").read_text("utf-8")
    for page in API.parent.rglob("*.md"):
        if page.stem != "index":
            assert f"\n{page.relative_to(API.parent).with_suffix('')}\n" in index


NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_has_no_outputs(path: Path) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    left = [i for i, cell in enumerate(cells) if cell["outputs"] or cell["execution_count"]]
    assert not left, f"clear all outputs of {path.name}, then save it (code cells {left})"
    assert set(notebook["metadata"]) <= {"kernelspec", "language_info"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_checks_what_it_says(path: Path) -> None:
    assert "assert " in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_what_a_notebook_imports_is_there(path: Path) -> None:
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    lines = "".join(
        line for cell in cells if cell["cell_type"] == "code" for line in ["\n", *cell["source"]]
    )
    imports = [node for node in ast.walk(ast.parse(lines)) if isinstance(node, ast.ImportFrom)]
    ours = [node for node in imports if (node.module or "").startswith("drake_aigto")]
    assert ours
    for node in ours:
        module = importlib.import_module(str(node.module))
        assert not [alias.name for alias in node.names if not hasattr(module, alias.name)]


@pytest.mark.parametrize("page", records.PAGES, ids=lambda page: page.name)
def test_a_page_says_what_the_records_say(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text.count("<!-- figure: ") == len(records.MARKED.findall(text))
    assert records.quote(text) == text, "run: python -m benchmarks.records quote"


def test_all_seconds_and_shares_of_the_measured_page_are_quoted() -> None:
    text = (records.CHECKOUT / "docs" / "measured.md").read_text(encoding="utf-8")
    unquoted = records.MARKED.sub("", re.sub(r"`[^`]*`|^    .*$", "", text, flags=re.MULTILINE))
    assert re.findall(r"[\d.]+ ?(?:ms|s|%|×)(?!\w)", unquoted) == []


@pytest.mark.parametrize("name", records.RECORDS)
def test_a_record_was_made_by_the_command_that_is_shown(name: str) -> None:
    lines = records.path_of(name).read_text(encoding="utf-8").splitlines()
    assert lines[0] == f"# {records.RECORDS[name]}"
    assert re.match(r"# commit \w+, \d{4}-\d\d-\d\d, \d+ s, exit status [01]$", lines[2])


def test_every_record_has_a_file_and_every_file_a_record() -> None:
    assert {path.stem for path in records.FOLDER.glob("*.txt")} == set(records.RECORDS)


def test_a_changed_record_changes_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records, "FOLDER", tmp_path)
    figures = {"ms": records.Figure("speed", r"plan +([\d.]+) ms")}
    monkeypatch.setattr(records, "FIGURES", figures)
    (tmp_path / "speed.txt").write_text("# python -m x\n# machine\n# commit\nplan   12.8 ms\n")
    page = "in <!-- figure: ms -->1<!-- end --> ms"
    assert records.quote(page) == "in <!-- figure: ms -->12.8<!-- end --> ms"
    monkeypatch.setattr(records, "FIGURES", {"ms": records.Figure("speed", r"(?s)\A(.*\S)")})
    (tmp_path / "speed.txt").write_text("# python -m x\nplan\n12.8 ms\n")
    block = "<!-- figure: ms -->\n\n```text\nplan\n12.8 ms\n```\n\n<!-- end -->"
    assert records.quote("<!-- figure: ms -->1<!-- end -->") == block
    monkeypatch.setattr(records, "FIGURES", figures)
    (tmp_path / "speed.txt").write_text("# python -m x\nplan 12.8 seconds\n")
    with pytest.raises(LookupError, match="record 'speed' has nothing like"):
        records.quote(page)


def test_an_unknown_record_is_refused_before_any_runs(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        records.main(["run", "table1", "nonsense"])
    assert "unknown records ['nonsense'], expected some of" in capsys.readouterr().err
