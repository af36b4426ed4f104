"""`drake-aigto play`: what it shows, and one clear error for each bad input."""

from __future__ import annotations

import io
import json
import socket
from pathlib import Path
from typing import Any

import pytest
from refusals import check_refused, refuse_work

from drake_aigto import Plan
from drake_aigto.cli import BAD_INPUT, FINE, main


@pytest.mark.parametrize("flags", [[], ["--beside", "gradient"], ["--optimization"]])
def test_play_writes_a_page(
    flags: list[str], plan_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "plan.html"
    assert main(["play", str(plan_file), *flags, "--html", str(page)]) == FINE
    assert "<html" in page.read_text(encoding="utf-8")[:2000].lower()
    assert capsys.readouterr().out == f"wrote {page}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["plan.html"]


def test_play_waits_at_a_port(
    plan_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO("\n"))
    assert main(["play", str(plan_file), "--port", "0"]) == FINE
    assert capsys.readouterr().out.startswith("Meshcat plays at http://localhost:")


def test_a_port_in_use_is_told(plan_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as other:
        other.bind(("0.0.0.0", 0))
        other.listen()
        port = other.getsockname()[1]
        assert main(["play", str(plan_file), "--port", str(port)]) == BAD_INPUT
    assert capsys.readouterr().err == (
        f"drake-aigto: Meshcat's port: got {port}, in use, expected a free one, 1024 to 65535. "
        "Name another port, or 0 for any that is free.\n"
    )


@pytest.mark.parametrize("port", ["-1", "80", "65536"])
def test_a_port_that_nobody_may_listen_at_is_told(
    port: str, plan_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["play", str(plan_file), "--port", port]) == BAD_INPUT
    assert f"Meshcat's port: got {port}, expected a free one" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 1}, "got version 1, expected version"),
        ({"candidates": []}, "is damaged: got plan: got candidates: got none"),
        (None, "is cut short or no JSON"),
    ],
)
def test_a_plan_that_can_not_be_read_leaves_no_page(
    change: dict[str, Any] | None,
    message: str,
    plan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = plan_file.read_text(encoding="utf-8")
    bad = tmp_path / "bad.json"
    bad.write_text(text[:500] if change is None else json.dumps({**json.loads(text), **change}))
    page = tmp_path / "out" / "page.html"
    page.parent.mkdir()
    check_refused(["play", str(bad), "--html", str(page)], message, capsys)
    assert not list(page.parent.iterdir())


def test_a_folder_that_is_not_there_is_told_before_any_work(
    plan_file: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Plan, "load", refuse_work)
    assert main(["play", str(plan_file), "--html", str(tmp_path / "no" / "p.html")]) == BAD_INPUT
    assert "got no folder" in capsys.readouterr().err
