"""Dataclasses survive JSON to the last bit, and what does not fit is named by its place."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drake_aigto.errors import DamagedDataError, OptionsError
from drake_aigto.plain import LEFT_OUT, from_plain, to_plain


@dataclass(frozen=True)
class Leaf:
    size: float
    color: Literal["green", "red"] = "green"
    age: int | None = None

    def __post_init__(self) -> None:
        if self.size == 7.0:
            raise OptionsError("size", got=7, expected="another")


@dataclass(frozen=True, eq=False)
class Tree:
    leaves: tuple[Leaf, ...]
    span: tuple[float, float]
    names: Mapping[str, tuple[bool, ...]]
    rings: npt.NDArray[np.float64]
    sap: object = field(default=None, metadata=LEFT_OUT)


def plant(**changes: Any) -> dict[str, Any]:
    tree = Tree((Leaf(1.0), Leaf(0.5, "red", 3)), (0.0, 1.0), {"oak": (True,)}, np.eye(2), "sweet")
    return {**json.loads(json.dumps(to_plain(tree))), **changes}


@given(st.lists(st.floats(allow_nan=False), min_size=1), st.floats(allow_nan=False))
def test_floats_read_back_to_the_same_bits(numbers: list[float], low: float) -> None:
    tree = Tree((), (low, math.nan), {}, np.array(numbers))
    read = from_plain(Tree, json.loads(json.dumps(to_plain(tree))))
    assert read.rings.tobytes() == tree.rings.tobytes()
    assert np.array(read.span[0]).tobytes() == np.array(low).tobytes()
    assert math.isnan(read.span[1])


def test_types_come_back_and_what_is_left_out_does_not() -> None:
    read = from_plain(Tree, plant())
    assert read.leaves == (Leaf(1.0), Leaf(0.5, "red", 3))
    assert (read.span, read.names, read.sap) == ((0.0, 1.0), {"oak": (True,)}, None)
    assert "sap" not in plant()
    assert from_plain(Leaf, {"size": 3}) == Leaf(3.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"leaves": [{"size": "1.0"}]}, r"Tree\.leaves\[0\]\.size: got '1\.0', expected a number"),
        ({"leaves": [{"size": True}]}, r"Tree\.leaves\[0\]\.size: got True, expected a number\."),
        ({"leaves": [{"size": 7}]}, r"Tree\.leaves\[0\]: got size: got 7, expected another"),
        ({"leaves": [{"size": 1, "color": "blue"}]}, r"color: got 'blue', expected one of 'green'"),
        ({"leaves": [{"size": 1, "age": 0.5}]}, r"age: got 0\.5, expected a whole number"),
        ({"leaves": [{"color": "red"}]}, r"Tree\.leaves\[0\]\.size: got nothing, expected a value"),
        ({"leaves": 3}, r"Tree\.leaves: got 'int' object is not iterable"),
        ({"span": [1.0]}, r"Tree\.span: got Not enough values in \[1\.0\]"),
        ({"names": {"oak": [1]}}, r"Tree\.names\['oak'\]\[0\]: got 1, expected true or false"),
        ({"rings": [[1.0], [2.0, 3.0]]}, r"Tree\.rings: got .*inhomogeneous"),
        ({"roots": 3}, "Tree: got unknown roots, expected fields of Tree"),
        ({"sap": "sweet"}, "Tree: got unknown sap"),
    ],
)
def test_what_does_not_fit_is_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(DamagedDataError, match=message):
        from_plain(Tree, plant(**change))
