"""Notebooks are kept as they should be; `.ci/run` runs them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

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
