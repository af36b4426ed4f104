"""What files import, by Python's own parser."""

from __future__ import annotations

import ast
import functools
from pathlib import Path


@functools.cache
def statements(source: str) -> tuple[ast.Import | ast.ImportFrom | ast.ClassDef, ...]:
    """Returns the imports and classes of a file, wherever they are."""
    kinds = ast.Import, ast.ImportFrom, ast.ClassDef
    return tuple(node for node in ast.walk(ast.parse(source)) if isinstance(node, kinds))


@functools.cache
def imported_modules(source: str, package: str) -> tuple[str, ...]:
    """Returns the dotted names of all that a file of the package imports, wherever it does."""
    names: list[str] = []
    for node in statements(source):
        if isinstance(node, ast.Import):
            names += (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*(parents if node.level else []), *filter(None, [node.module])])
            names += (f"{base}.{alias.name}" for alias in node.names)
    return tuple(names)


def import_graph(root: Path) -> dict[str, set[str]]:
    """Returns the modules that each module of a package imports, for type checkers alone too.

    A package's door is a module of its own, with what its stub imports. That of the package itself
    is left out, as it passes on names of all.
    """
    graph: dict[str, set[str]] = {}
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.pyi")]):
        parts = path.relative_to(root.parent).with_suffix("").parts
        module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        source = path.read_text(encoding="utf-8")
        graph.setdefault(module, set()).update(imported_modules(source, ".".join(parts[:-1])))
    del graph[root.name]
    return {
        module: {found for name in names for found in [_module_of(name, graph)] if found}
        for module, names in graph.items()
    }


def _module_of(name: str, modules: dict[str, set[str]]) -> str | None:
    """Returns the module that a dotted name is, or is in."""
    while name and name not in modules:
        name = name.rpartition(".")[0]
    return name or None
