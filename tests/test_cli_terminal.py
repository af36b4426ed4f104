"""The command line on a terminal and in a pipe: progress, the log, and errors."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import logging
import os
import pty
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

import numba
import pytest

from drake_aigto.cli import BAD_INPUT, FAULT, FINE, INTERRUPTED, NOTHING_HOLDS, main
from drake_aigto.errors import AigtoError
from drake_aigto.planning import Plan, Planner, PlanningError, Search
from drake_aigto.progress import Count, Notice

# Quick to plan: far from the wall.
FLIGHT = [
    *("plan", "table1/1", "--initial-position", "1.2", "--initial-velocity", "0"),
    *("--goal-position", "1.3", "--time-step", "0.02", "--aigo-steps", "20"),
]
ESCAPE = "\033"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True

    def shown(self) -> list[str]:
        """Returns all lines that could be seen at some time, without colours."""
        text = re.sub(r"\033\[[\d;]*m", "", self.getvalue())
        return [re.sub(r"\033\[\d*[A-Z]", "", line) for line in re.split(r"[\r\n]+", text)]


def open_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    stream = Terminal()
    monkeypatch.setattr(sys, "stderr", stream)
    for name, value in {"COLUMNS": "60", "LINES": "20", "TERM": "xterm"}.items():
        monkeypatch.setenv(name, value)
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "TTY_INTERACTIVE"):
        monkeypatch.delenv(name, raising=False)
    return stream


@pytest.fixture
def telling(monkeypatch: pytest.MonkeyPatch, plan_file: Path) -> Callable[..., None]:
    """Has a planner tell some lines, and then find the plan of the file."""

    def tell(*lines: str) -> None:
        def plan(planner: Planner, progress: Callable[[str], None] | None = None) -> Plan:
            for line in lines:
                if progress:
                    progress(line)
            return Plan.load(plan_file)

        monkeypatch.setattr(Planner, "plan", plan)

    return tell


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    def fail(planner: Planner, **keywords: Any) -> None:
        raise error

    monkeypatch.setattr(Planner, "plan", fail)


def test_progress_is_one_line_of_the_terminals_width_and_quiet_shows_none(
    telling: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    terminal = open_terminal(monkeypatch)
    telling("[bold]AIGO 1 of 5" + "x" * 300)
    assert main(["plan", "table1/1"]) == FINE
    shown = terminal.shown()
    assert shown[0] == "loading Drake …"
    assert any("transcribing" in line for line in shown)
    assert any("0:00:00 [bold]AIGO 1 of 5xxx" in line and "…" in line for line in shown)
    assert max(map(len, shown)) <= 60
    # Up to the line and clear it: nothing is left. And the cursor was never hidden.
    assert terminal.getvalue().endswith("\033[1A\033[2K")
    assert "\033[?25l" not in terminal.getvalue()
    printed = capsys.readouterr().out
    assert printed.startswith("verdict ") and ESCAPE not in printed
    terminal = open_terminal(monkeypatch)
    telling("AIGO 1 of 5")
    assert main(["--quiet", "plan", "table1/1"]) == FINE
    assert not terminal.getvalue()


def test_what_is_counted_has_a_bar_without_colour_where_there_is_to_be_none(
    telling: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = open_terminal(monkeypatch)
    telling("getting ready", Count(1, 4, "cells done"), Count(3, 4, "cells done"))
    assert main(["plan", "table1/1"]) == FINE
    last = terminal.getvalue().split("\r")[-2]
    assert "3 of 4 cells done" in last
    assert len(re.findall("[━╸╺]", last)) == 20
    filled = re.search(r"\033\[91m(━+)", last)
    assert filled and len(filled[1]) == 15
    assert re.search(r"0:00:0\d ━.* left; 3 of 4", terminal.shown()[-2])
    terminal = open_terminal(monkeypatch)
    monkeypatch.setenv("NO_COLOR", "1")
    telling(Count(1, 4, "cells done"))
    assert main(["plan", "table1/1"]) == FINE
    assert any("1 of 4 cells done" in line for line in terminal.shown())
    assert not re.search(r"\033\[[\d;]*3\d", terminal.getvalue())


KEPT = Notice("compiling machine code")


def test_a_notice_stays_on_the_terminal_above_the_line(
    telling: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = open_terminal(monkeypatch)
    telling("AIGO 1 of 5", KEPT, "AIGO 2 of 5")
    assert main(["plan", "table1/1"]) == FINE
    written = terminal.getvalue()
    assert written.count(KEPT) == written.count(f"drake-aigto: {KEPT}\n") == 1
    # The bar is drawn below it, and cleared at the end; it is not.
    assert "AIGO 2 of 5" in written.split(KEPT)[-1]
    assert written.endswith("\033[1A\033[2K") and "\033[2A" not in written


def test_a_file_gets_a_notice_alone_and_quiet_none(
    telling: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    telling("AIGO 1 of 5", KEPT, "AIGO 2 of 5")
    assert main(["plan", "table1/1"]) == FINE
    assert capsys.readouterr().err == f"drake-aigto: {KEPT}\n"
    for words in (["--quiet"], ["--verbose"]):  # Verbose has it in the log, with its time.
        assert main([*words, "plan", "table1/1"]) == FINE
        assert KEPT not in capsys.readouterr().err


def test_the_search_says_once_that_it_compiles(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    tell = Search.tell

    def compile_meanwhile(search: Search, line: str) -> None:
        tell(search, line)
        if line.startswith("AIGO"):
            numba.njit(lambda x: x + 1.0)(1.0)  # A new function: no cache has it.

    assert main([*FLIGHT, "--no-confirm"]) == FINE  # All else is compiled by now.
    capsys.readouterr()
    monkeypatch.setattr(Search, "tell", compile_meanwhile)
    assert main([*FLIGHT, "--no-confirm"]) == FINE
    told = (
        "drake-aigto: compiling machine code, up to a minute or so (Ctrl-C waits for that); "
        "it can be kept nowhere: NUMBA_CACHE_DIR may name a folder\n"
    )
    assert capsys.readouterr().err == told
    monkeypatch.setattr(Search, "tell", tell)
    assert main([*FLIGHT, "--no-confirm", "-v"]) == FINE
    assert "compiling" not in capsys.readouterr().err


def test_verbose_tells_what_the_planner_does_and_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    logger = logging.getLogger("drake_aigto")
    before = logger.level, list(logger.handlers), logger.propagate
    shown_again = logging.StreamHandler(sys.stderr)  # As Drake gives the root one when it warns.
    monkeypatch.setattr(logging.getLogger(), "handlers", [shown_again])
    assert main(FLIGHT) == FINE  # All is compiled by now, which the log would tell too.
    quiet = capsys.readouterr()
    assert main([*FLIGHT, "-v"]) == FINE
    assert (logger.level, logger.handlers, logger.propagate) == before
    printed = capsys.readouterr()
    log = re.sub(r"^ +\d+\.\d\d s  ", "", printed.err, flags=re.MULTILINE)
    for told in (
        r"^boxes: banded LDLᵀ, \d+ unknowns, half bandwidth \d+\n"
        r"AIGO 1 of 5: annealing from temperature 3; ",
        r"\n  converged after \d+ inner steps; contact sequences: \d\n",
        r"\n  free flight: cost \d\.\d{3}e.*, replayed .*, largest defect .*, in 50 steps\n",
        r"\n\d candidates; improving number 1\n",
        r"\n\d+ iterations of AIGO; seconds: build .*, aigo .*, polish .*, replay \d+\.\d\d\n$",
    ):
        assert re.search(told, log), f"{told} in\n{log}"
    assert log.count("iterations of AIGO; seconds: ") == 1

    def without_seconds(text: str) -> str:
        return re.sub(r"\nseconds .*", "", text)

    assert without_seconds(quiet.out) == without_seconds(printed.out)


def test_the_log_moves_progress_aside(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = open_terminal(monkeypatch)
    assert main([*FLIGHT, "-v"]) == FINE
    shown = terminal.shown()
    assert any(re.match(r" +\d+\.\d\d s  boxes: banded", line) for line in shown)
    assert max(map(len, shown)) <= 60


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (AigtoError("the wall", got="rubber"), BAD_INPUT, "the wall: got rubber."),
        (PlanningError("nothing holds"), NOTHING_HOLDS, "nothing holds."),
        (MemoryError("Unable to allocate 45 GiB"), BAD_INPUT, "Unable to allocate 45 GiB."),
        (
            ZeroDivisionError("division by zero"),
            FAULT,
            "ZeroDivisionError: division by zero. This is a fault of drake-aigto: "
            "please report it with the output of -v.",
        ),
    ],
)
def test_only_verbose_shows_where_an_error_came_from(
    error: Exception,
    status: int,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    failing(monkeypatch, error)
    assert main(["plan", "table1/1"]) == status
    assert capsys.readouterr().err == f"drake-aigto: {message}\n"
    assert main(["-v", "plan", "table1/1"]) == status
    told = capsys.readouterr().err
    assert "\nTraceback (most recent call last):\n" in f"\n{told}" and ", in fail\n" in told
    assert told.endswith(f"\ndrake-aigto: {message}\n")


def test_an_error_clears_progress_first(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = open_terminal(monkeypatch)
    failing(monkeypatch, AigtoError("the wall"))
    assert main(["plan", "table1/1"]) == BAD_INPUT
    assert terminal.getvalue().endswith("\033[1A\033[2Kdrake-aigto: the wall.\n")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux has it")
def test_a_full_disk_is_told(
    telling: Callable[..., None],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    telling()
    with open("/dev/full", "w", encoding="utf-8") as full:
        monkeypatch.setattr(sys, "stdout", full)
        assert main(["plan", "table1/1"]) == BAD_INPUT
    assert capsys.readouterr().err == "drake-aigto: [Errno 28] No space left on device.\n"


def test_a_folder_that_can_not_be_written_to_is_told_before_any_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(path: Path) -> NoReturn:
        raise PermissionError(13, "Permission denied", str(path))

    failing(monkeypatch, AssertionError("work was begun"))
    monkeypatch.setattr(Path, "touch", refuse)  # Permissions do not stop root.
    out = tmp_path / "plan.json"
    assert main(["plan", "table1/1", "--json", str(out)]) == BAD_INPUT
    assert f"drake-aigto: {out} can't be written: got Permission denied." in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_play_waits_for_ctrl_c_where_nobody_can_press_enter(
    plan_file: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Interrupted(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            raise KeyboardInterrupt

    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    monkeypatch.setattr("drake_aigto.cli.play.threading.Event", Interrupted)
    assert main(["play", str(plan_file), "--port", "0"]) == INTERRUPTED
    printed = capsys.readouterr()
    assert printed.out.endswith("; press Ctrl-C to stop.\n")
    assert printed.err == "drake-aigto: interrupted\n"


@pytest.mark.slow
def test_ctrl_c_on_a_terminal_leaves_nothing_behind(tmp_path: Path) -> None:
    out = tmp_path / "table.json"
    command = [sys.executable, "-m", "drake_aigto", "table1", "--json", str(out)]
    ours, theirs = pty.openpty()
    with subprocess.Popen(
        command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True
    ) as process:
        os.close(theirs)
        shown = b""
        while b"first cells" not in shown:
            shown += os.read(ours, 1 << 16)
        # The pseudoterminal is nobody's controlling one: what Ctrl-C would do there.
        os.killpg(process.pid, 2)
        while chunk := _read(ours):
            shown += chunk
    os.close(ours)
    assert process.returncode == INTERRUPTED
    assert shown.endswith(b"\x1b[1A\x1b[2Kdrake-aigto: interrupted\r\n")
    assert b"\x1b[?25l" not in shown
    assert not out.exists()


def _read(descriptor: int) -> bytes:
    try:
        return os.read(descriptor, 1 << 16)
    except OSError:
        return b""


POLISHING = "drake-aigto: stopping: polishing the best so far; again to drop it\n"
KEEPING = "drake-aigto: stopping: showing what happened so far; again to drop it\n"


def test_ctrl_c_is_answered_once_and_the_next_one_is_heard_as_usual(
    monkeypatch: pytest.MonkeyPatch, plan_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def plan(planner: Planner, progress: Callable[[str], None] | None = None) -> Plan:
        for _ in range(2):
            with contextlib.suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        return dataclasses.replace(Plan.load(plan_file), is_interrupted=True)

    monkeypatch.setattr(Planner, "plan", plan)
    assert main(FLIGHT) == INTERRUPTED
    assert capsys.readouterr().err == POLISHING
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.set_wakeup_fd(-1) == -1


def test_ctrl_c_is_answered_while_compiled_code_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python's handler waits until that returns."""
    seen, is_busy = list[bool](), threading.Event()

    class Watched(io.StringIO):
        def write(self, text: str) -> int:
            seen.append(is_busy.is_set())
            return super().write(text)

    def plan(*_: object, **__: object) -> NoReturn:
        is_busy.set()
        threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
        try:
            hashlib.pbkdf2_hmac("sha256", b"", b"", 1_000_000)  # Half a second.
        finally:
            is_busy.clear()
        raise AssertionError("Ctrl-C was not heard")

    stream = Watched()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(Planner, "plan", plan)
    assert main(FLIGHT) == INTERRUPTED
    assert stream.getvalue() == f"{POLISHING}drake-aigto: interrupted\n" and seen[0]


@pytest.mark.parametrize(
    ("words", "called", "answer"),
    [
        (["table1"], "drake_aigto.cli.plan.run_table1", KEEPING),
        (["plan-many", "table1/1"], "drake_aigto.jobs.plan_many", "drake-aigto: stopping: plans"),
        (["control", "table1/1"], "drake_aigto.cli.play.run_in_loop", KEEPING),
        (["control", "table1/1"], "drake_aigto.cli.play._make_controller", POLISHING),
        (["live", "table1/1"], "drake_aigto.show.Live.run", "drake-aigto: stopping: the scene is"),
    ],
)
def test_every_long_command_answers_ctrl_c(
    words: list[str],
    called: str,
    answer: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(called, lambda *_, **__: signal.raise_signal(signal.SIGINT))
    assert main(words) == INTERRUPTED
    shown = capsys.readouterr().err
    assert shown.startswith(answer) and shown.endswith("drake-aigto: interrupted\n")


def test_verdicts_have_colors_on_a_terminal_alone(
    monkeypatch: pytest.MonkeyPatch, plan_file: Path, telling: Callable[..., None]
) -> None:
    telling()
    open_terminal(monkeypatch)
    texts = []
    for stream in (Terminal(), io.StringIO()):
        monkeypatch.setattr(sys, "stdout", stream)
        assert main([*FLIGHT, "--quiet"]) == FINE
        texts.append(stream.getvalue())
    assert texts[0].startswith(f"{ESCAPE}[1;32mverdict     holds{ESCAPE}[0m: ")
    assert texts[1].startswith("verdict     holds: ") and ESCAPE not in texts[1]


@pytest.mark.parametrize("command", ["plan", "control", "live", "look"])
def test_help_fits_on_a_screen_and_the_whole_explains_every_flag(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    texts = []
    for flag in ("--help", "--help-all"):
        with pytest.raises(SystemExit):
            main([command, flag])
        texts.append(capsys.readouterr().out)
    assert len(texts[0].splitlines()) <= 60
    about = "where it starts" if "where it starts" in texts[1] else "--goal-position X [X ...]"
    assert "--goal-position" in texts[0] and about in texts[1] and about not in texts[0]


@pytest.mark.parametrize(
    ("words", "meant"),
    [(["plan", "table1/1", "--time-stp", "0.1"], "--time-step"), (["contrl"], "control")],
)
def test_what_was_probably_meant_is_said_first(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(words)
    assert capsys.readouterr().err.startswith(f"drake-aigto: Did you mean {meant}? ")
