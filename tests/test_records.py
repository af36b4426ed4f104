"""README and docs quote what benchmarks printed, and nothing else."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks import records


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
