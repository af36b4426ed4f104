"""The documentation has a page for everything that is public."""

from __future__ import annotations

import importlib
import pkgutil
import re
from pathlib import Path
from typing import get_origin

import pytest

import drake_aigto

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
