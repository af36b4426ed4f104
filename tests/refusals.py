"""What every command does with bad input."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import pytest

from drake_aigto.cli import BAD_INPUT, main


def check_refused(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    main: Callable[[Sequence[str]], int] = main,
) -> None:
    """Checks that a command ends with status 2 and prints one line of error, and nothing else."""
    assert main(arguments) == BAD_INPUT
    captured = capsys.readouterr()
    assert captured.err.startswith("drake-aigto: "), captured.err
    assert message in captured.err, captured.err
    assert captured.err.count("\n") == 1, captured.err
    assert not captured.out, captured.out


def refuse_work(*arguments: Any, **keywords: Any) -> None:
    """Stands for what must not be called."""
    raise AssertionError("work was begun")
