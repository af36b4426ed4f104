"""Sphinx: pages in Markdown, notebooks, and the API from the docstrings.

sphinx-build -W -b html -D nb_execution_mode=force docs build/docs

Without the mode it takes seconds, and notebooks have no results; with it they are executed, and one
that fails ends the build.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import drake_aigto

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "drake_aigto"
author = "The drake_aigto developers"
release = drake_aigto.__version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
]
exclude_patterns = ["images", "results"]
smartquotes_action = "qe"  # Flags of the command line keep their two hyphens.
html_theme = "furo"
html_title = "drake_aigto"
html_static_path = ["static"]
html_css_files = ["wide.css"]
html_show_copyright = False  # LICENSE says whose it is.
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3

nb_execution_mode = "off"
nb_execution_raise_on_error = True
nb_execution_timeout = 600  # [s] for a cell
nb_merge_streams = True

# Of what docstrings write in backquotes, public names become links.
default_role = "autolink"
autodoc_default_options = {"members": True}
autodoc_member_order = "bysource"
napoleon_use_ivar = True

_FIELDS = re.compile(r"\s*[A-Z][a-z]+:$")  # Args:, Returns:, ...


def _read_formulas(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Keeps the lines of indented formulas apart, and |x| as it is written."""
    told: list[str] = []
    indent, is_formula = 0, False
    for line in lines:
        depth = len(line) - len(line.lstrip())
        if line.strip():
            starts = bool(told) and not told[-1].strip() and depth > indent
            if starts and not is_formula and not _FIELDS.match(told[-2]):
                told += [" " * indent + "::", ""]
                is_formula = True
            elif depth <= indent:
                is_formula = False
            if not is_formula:
                indent = depth
        told.append(line if is_formula else line.replace("|", r"\|"))
    lines[:] = told


def setup(app: Sphinx) -> None:
    """Connects the reader of docstrings, to run before napoleon's."""
    app.connect("autodoc-process-docstring", _read_formulas, priority=400)
