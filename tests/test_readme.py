"""README and the page of models tell the truth: examples print it, commands are those of CI."""

from __future__ import annotations

import contextlib
import dataclasses
import io
import re
import shlex
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from drake_aigto import ModelError, Planner, Scenario, World
from drake_aigto.cli import load_scenario, make_parser

CHECKOUT = Path(__file__).parents[1]
README = (CHECKOUT / "README.md").read_text(encoding="utf-8")
MODELS_PAGE = (CHECKOUT / "docs" / "your_own_model.md").read_text(encoding="utf-8")
TASKS_PAGE = (CHECKOUT / "docs" / "tasks.md").read_text(encoding="utf-8")
LOOP_PAGE = (CHECKOUT / "docs" / "in_the_loop.md").read_text(encoding="utf-8")
CERTIFICATES_PAGE = (CHECKOUT / "docs" / "certificates.md").read_text(encoding="utf-8")

# Fields that are told where models and transcriptions are.
_PHYSICS = (
    *("model", "initial_position", "initial_velocity", "ignored_shapes"),
    *("epsilon", "delta", "restitution", "mass", "friction"),
)
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


@pytest.mark.parametrize(
    ("code", "promised"),
    [
        example
        for page in (README, MODELS_PAGE, TASKS_PAGE, LOOP_PAGE, CERTIFICATES_PAGE)
        for example in examples(page)
    ],
)
def test_an_example_prints_what_is_promised(
    code: str, promised: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # For files that it writes, and the model that the page shows.
    (tmp_path / "ball.urdf").write_text(shown_models()[0], encoding="utf-8")
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


def shown_models() -> list[str]:
    """Returns the URDF of the page of models, and the properties in SDF."""
    return [match[2] for match in FENCED.finditer(MODELS_PAGE) if match[1] == "xml"]


def test_the_properties_that_are_shown_in_sdf_are_read(tmp_path: Path) -> None:
    shipped = (CHECKOUT / "models" / "room.sdf").read_text(encoding="utf-8")
    _, properties = shown_models()
    element = re.compile(
        r"<drake:proximity_properties>.*?</drake:proximity_properties>\n", re.DOTALL
    )
    start: dict[str, Any] = {
        "initial_position": [0.5] * 2,
        "initial_velocity": [1, 0],
        "goal_position": [0.4] * 2,
    }
    model = tmp_path / "room.sdf"
    model.write_text(element.sub("", shipped), encoding="utf-8")
    scenario = Scenario(model=str(model), **start)
    assert set(World.from_scenario(scenario).frictions.values()) == {1.0}
    with pytest.raises(ModelError, match="no stiffness"):
        Planner(scenario)
    model.write_text(element.sub(properties, shipped), encoding="utf-8")
    assert Planner(scenario).world.frictions == {}


def test_the_page_of_tasks_has_every_field_and_what_it_shows_is_understood() -> None:
    blocks = {match[1]: match[2] for match in FENCED.finditer(TASKS_PAGE)}
    shipped = Scenario.named("cart_pole/soft_06")
    assert Scenario.from_plain(yaml.safe_load(blocks["yaml"])) == shipped
    for line in blocks["sh"].splitlines():
        words = shlex.split(line)[1:]
        asked = load_scenario(make_parser(words).parse_args(words))
        assert asked != shipped
        World.from_scenario(asked)
    task = [field.name for field in dataclasses.fields(Scenario) if field.name not in _PHYSICS]
    assert [name for name in task if f"`{name}`" not in TASKS_PAGE] == []


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
