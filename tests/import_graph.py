"""What files import, by Python's own parser."""

from __future__ import annotations

import ast
from collections.abc import Iterator


def imported_modules(source: str, package: str) -> Iterator[str]:
    """Yields the dotted names of all that a file of the package imports, wherever it does."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*(parents if node.level else []), *filter(None, [node.module])])
            yield from (f"{base}.{alias.name}" for alias in node.names)
