"""`drake-aigto control`: what it writes and shows, and one clear error for each bad input."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from refusals import check_refused

from drake_aigto.cli import FINE, INTERRUPTED, main


def test_control_writes_a_log_and_a_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, page = tmp_path / "run.json", tmp_path / "run.html"
    words = ["control", "table1/1", "--method", "tracking", "--mass-factor", "1.1"]
    assert main([*words, "--json", str(log), "--html", str(page)]) == FINE
    told = capsys.readouterr().out
    assert told.startswith("simulation") and "masses times 1.1" in told
    data = json.loads(log.read_text(encoding="utf-8"))
    assert data["format"] == "drake_aigto closed loop" and data["method"] == "tracking"
    html = page.read_text(encoding="utf-8")
    assert "What moves here is a simulation" in html and "data:image/svg+xml" in html
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.html", "run.json"]
    assert main(["report", str(log), "--html", str(again := tmp_path / "again.html")]) == FINE
    assert "masses times 1.1" in again.read_text(encoding="utf-8")
    capsys.readouterr()
    check_refused(["play", str(log), "--optimization"], "--optimization: got the log", capsys)


def test_control_plans_again_where_it_can_and_shows_it_live(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
    words = ["cart_pole/soft_06", "--seconds", "0.1", "--renewals", "0", "--live", "--port", "0"]
    assert main(["control", *words]) == FINE
    told = capsys.readouterr().out
    assert told.startswith("Meshcat shows it at http://localhost:")
    assert "ModelPredictiveController" in told and "press" in told


def test_control_says_that_it_was_interrupted(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def press(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("drake_aigto.control.loop_recorder.LoopRecorder.kick", press)
    words = ["control", "table1/1", "--method", "tracking", "--kick", "0.1", "--kick-time", "0.2"]
    assert main(words) == INTERRUPTED
    assert "Ctrl-C ended the simulation" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["table1/1", "--kick-time", "0.2"], "--kick-time: got no --kick"),
        (["table1/1", "--noise-seed", "2"], "--noise-seed: got no --noise"),
        (["table1/1", "--renewals", "4"], "renewals: got 4 for balls between rigid walls"),
        (["table1/1", "--port", "0"], "--port: got no --live"),
        (["table1/1", "--method", "tracking", "--search-every", "3"], "--search-every: got"),
        (["table1/1", "--kick", "1", "2"], "kick: got 2 numbers, expected 1"),
    ],
)
def test_what_can_not_be_done_is_refused_by_name(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "run.json"
    check_refused(["control", *words, "--json", str(log)], message, capsys)
    assert not log.exists()
