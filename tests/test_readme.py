"""README tells the truth: its examples print what it says, and its commands are those of CI."""

from __future__ import annotations

import contextlib
import io
import re
import subprocess
from pathlib import Path

import pytest

CHECKOUT = Path(__file__).parents[1]
README = (CHECKOUT / "README.md").read_text(encoding="utf-8")

FENCED = re.compile(r"^```(\w+)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d*)?(?:e[-+]?\d+)?(?![\w.]*\w)")

# Optima differ in their last digits between machines and versions of the solvers.
RELATIVE_TOLERANCE = 0.02


def examples(markdown: str) -> list[tuple[str, str]]:
    """Returns every Python block with the text block next after it: what it prints, or nothing."""
    blocks = [(match[1], match[2]) for match in FENCED.finditer(markdown)]
    return [
        (code, following[1] if following[0] == "text" else "")
        for (language, code), following in zip(blocks, [*blocks[1:], ("", "")], strict=True)
        if language == "python"
    ]


def assert_same_output(printed: str, promised: str) -> None:
    """Compares words exactly, and numbers up to a tolerance."""
    assert NUMBER.sub("#", printed).split() == NUMBER.sub("#", promised).split()
    got, expected = (
        [float(number.replace("−", "-")) for number in NUMBER.findall(text)]
        for text in (printed, promised)
    )
    assert got == pytest.approx(expected, rel=RELATIVE_TOLERANCE)


@pytest.mark.parametrize(("code", "promised"), examples(README))
def test_an_example_prints_what_readme_says(
    code: str, promised: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # For files that it writes.
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {"__name__": "__main__"})
    assert_same_output(printed.getvalue(), promised)


def test_examples_are_found_with_their_output() -> None:
    markdown = "```python\na\n```\ngives\n```text\n1\n```\n```python\nb\n```\n```sh\nc\n```\n"
    assert examples(markdown) == [("a\n", "1\n"), ("b\n", "")]


@pytest.mark.parametrize(
    "printed", ["cost 1.20e-5 m at row1", "cost 1.21e-05 m  at row1\n", "cost 1.19e-5 m at row1"]
)
def test_output_may_differ_in_the_last_digits(printed: str) -> None:
    assert_same_output(printed, "cost 1.20e-5 m at row1")


@pytest.mark.parametrize(
    "printed",
    [
        "cost 1.30e-5 m at row1",
        "cost −1.20e-5 m at row1",
        "cost 1.20e-5 s at row1",
        "cost 1.20e-5 m at row2",
        "cost 1.20e-5 m at row1 2",
        "cost",
    ],
)
def test_output_may_not_differ_otherwise(printed: str) -> None:
    with pytest.raises(AssertionError):
        assert_same_output(printed, "cost 1.20e-5 m at row1")


def commands() -> dict[str, str]:
    """Returns README's marked commands by their marks."""
    pattern = r"^<!-- command: (\w+) -->\n```sh\n(.*?)\n```$"
    return dict(re.findall(pattern, README, re.DOTALL | re.MULTILINE))


def test_each_command_is_one_line_with_its_own_environment() -> None:
    environments = []
    for command in commands().values():
        assert "\n" not in command
        match = re.fullmatch(r"python3 -m venv (\S+) && \1/bin/pip .* && \1/bin/.*", command)
        assert match, f"not three steps in one environment: {command}"
        environments.append(match[1])
    assert environments == [".venv", ".venv-dev"]


def test_ci_reads_the_test_command_out_of_readme() -> None:
    script = (CHECKOUT / ".ci" / "run").read_text(encoding="utf-8")
    function = re.search(r"^command_of_readme\(\) \{.*?^\}$", script, re.DOTALL | re.MULTILINE)
    assert function
    result = subprocess.run(
        ["bash", "-c", f"{function[0]}\ncommand_of_readme tests"],
        cwd=CHECKOUT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout.strip() == commands()["tests"]
