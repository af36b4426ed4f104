"""One name, one thing: no two classes of the package share a name, private ones neither."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import drake_aigto

PACKAGE = Path(drake_aigto.__file__).parent


def classes_by_name(root: Path) -> dict[str, list[str]]:
    """Returns the files of a package that define a class, by its name without underscores."""
    found = defaultdict(list)
    for path in sorted(root.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                found[node.name.lstrip("_")].append(str(path.relative_to(root)))
    return found


def test_no_two_classes_share_a_name() -> None:
    shared = {name: files for name, files in classes_by_name(PACKAGE).items() if len(files) > 1}
    assert shared == {}


def test_a_private_class_shares_the_name_of_a_public_one(tmp_path: Path) -> None:
    (tmp_path / "one.py").write_text("class Walls: ...", encoding="utf-8")
    (tmp_path / "other.py").write_text("def f():\n    class _Walls: ...", encoding="utf-8")
    assert classes_by_name(tmp_path) == {"Walls": ["one.py", "other.py"]}
