"""The single road from a plan to its pictures, which are made by a room that this can't import."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

# What shows a plan, by the name of its method; `show` fills it on first use.
VIEWS: dict[str, Callable[..., Any]] = {}


def view(name: str, *arguments: Any, **look: Any) -> Any:
    """Returns what a view makes of a plan."""
    if not VIEWS:
        importlib.import_module("drake_aigto.show").fill_views()
    return VIEWS[name](*arguments, **look)
