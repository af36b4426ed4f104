"""Files of results are of one kind and of one question, and nobody's are written over."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.study.study import (
    read_results,
    round_to,
)
from drake_aigto.errors import ResultsFileError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "results.json"
    path.write_text(json.dumps({"kind": "fruit", "apples": 3}), encoding="utf-8")
    return path


def test_what_was_written_is_read(file: Path) -> None:
    assert read_results(file) == read_results(file, "fruit") == {"kind": "fruit", "apples": 3}


def test_another_kind_is_refused(file: Path) -> None:
    with pytest.raises(ResultsFileError, match=r"json: got kind 'fruit', expected kind 'nuts'"):
        read_results(file, "nuts")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"kind": "fru', r"results file .*json is cut short or no JSON: got Unterminated string"),
        ("[1, 2]", r'got kind None, expected an object with a field "kind"'),
        ('{"kind": 3}', r"got kind 3, expected an object"),
    ],
)
def test_what_is_no_results_file_is_refused(file: Path, text: str, message: str) -> None:
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ResultsFileError, match=message):
        read_results(file)


def test_a_file_that_is_missing_is_refused_where_it_is_read(tmp_path: Path) -> None:
    with pytest.raises(ResultsFileError, match=r"none\.json can't be read: got .*No such file"):
        read_results(tmp_path / "none.json")


@pytest.mark.parametrize(
    ("value", "digits", "nearest", "down"),
    [
        (123.456, 3, 123.0, 123.0),
        (1.23556e-9, 4, 1.236e-9, 1.235e-9),
        (-0.0019996, 4, -0.002, -0.001999),
        (0.0, 3, 0.0, 0.0),
    ],
)
def test_numbers_are_rounded_to_significant_digits(
    value: float, digits: int, nearest: float, down: float
) -> None:
    assert round_to(value, digits) == nearest
    assert round_to(nearest, digits) == nearest
    assert round_to(value, digits, down=True) == down
    assert round_to(down, digits, down=True) == down
