"""`drake-aigto report` and `table1 --html`: one page, whole or not at all."""

from __future__ import annotations

from pathlib import Path

import pytest
from refusals import check_refused, refuse_work

from drake_aigto.cli import BAD_INPUT, FINE, INTERRUPTED, main
from drake_aigto.paper import Table1


def test_report_writes_a_page_without_a_display(
    plan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.setenv("MPLBACKEND", "TkAgg")
    page = tmp_path / "report.html"
    assert main(["report", str(plan_file), "--html", str(page)]) == FINE
    assert page.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
    printed = capsys.readouterr().out
    assert printed.startswith(f"wrote {page}, 1.") and printed.endswith(" MB\n")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize(
    ("arguments", "begins"),
    [
        (["report", "PLAN"], "drake_aigto.planning.Plan.load"),
        (["table1"], "drake_aigto.cli.plan.run_table1"),
    ],
)
def test_a_page_that_could_not_be_written_is_refused_before_any_work(
    arguments: list[str],
    begins: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(begins, refuse_work)
    page = tmp_path / "no" / "page.html"
    message = "can't be written: got no folder"
    check_refused([*arguments, "--html", str(page)], message, capsys)


def test_a_plan_cut_short_leaves_no_page(
    plan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cut = tmp_path / "cut.json"
    cut.write_text(plan_file.read_text(encoding="utf-8")[:-50], encoding="utf-8")
    page = tmp_path / "page.html"
    assert main(["report", str(cut), "--html", str(page)]) == BAD_INPUT
    assert "is cut short or no JSON" in capsys.readouterr().err
    assert not page.exists()


@pytest.mark.parametrize(("rows", "status"), [((), FINE), ((4,), INTERRUPTED)])
def test_table1_writes_a_page_and_tells_an_interruption(
    rows: tuple[int, ...],
    status: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = Table1((), (), rows)  # Of row 4, nothing is done.
    monkeypatch.setattr("drake_aigto.cli.plan.run_table1", lambda **keywords: table)
    monkeypatch.setattr("drake_aigto.show.report_table1", lambda got: f"page {got}")
    page = tmp_path / "table1.html"
    assert main(["table1", "--html", str(page)]) == status
    assert page.read_text(encoding="utf-8") == f"page {table}"
    assert ("Interrupted: 3 of 3 cells" in capsys.readouterr().out) == (status == INTERRUPTED)
