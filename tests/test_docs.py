"""The documentation has a page for everything that is public."""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import importlib
import io
import json
import pkgutil
import re
import shlex
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_origin

import pytest
import yaml
from marks import slow

import drake_aigto
from benchmarks import records
from drake_aigto import Planner, Scenario, World
from drake_aigto.cli import load_scenario, make_parser
from drake_aigto.errors import ModelError
from drake_aigto.world import scenario_seconds, scenario_summaries

API = Path(__file__).resolve().parents[1] / "docs" / "api"

# What people import; the others serve these.
INTERNAL = {"__main__", "arrays", "cli", "code_cache", "kernels", "plain"}


def public_modules() -> list[str]:
    found = {module.name for module in pkgutil.iter_modules(drake_aigto.__path__)}
    return sorted(found - INTERNAL)


def test_every_public_module_has_a_page_and_no_other() -> None:
    pages = sorted(page.stem for page in API.glob("*.md"))
    assert pages == sorted([*public_modules(), "drake_aigto"])


@pytest.mark.parametrize("name", public_modules())
def test_a_page_is_of_its_module_where_every_public_name_is_documented(name: str) -> None:
    assert f".. automodule:: drake_aigto.{name}\n" in (API / f"{name}.md").read_text("utf-8")
    module = importlib.import_module(f"drake_aigto.{name}")
    assert module.__doc__
    for public in getattr(module, "__all__", ()):
        value = getattr(module, public)
        is_alias = get_origin(value) is not None  # Of types, which Python lets have no docstring.
        assert is_alias or not callable(value) or value.__doc__, public


def test_the_first_page_links_what_the_package_itself_has() -> None:
    text = (API / "drake_aigto.md").read_text("utf-8")
    linked = re.findall(r":py:obj:`~(drake_aigto\.[\w.]+)`", text)
    assert sorted(link.rpartition(".")[2] for link in linked) == drake_aigto.__all__
    for link in linked:
        module, _, name = link.rpartition(".")
        assert getattr(importlib.import_module(module), name) is getattr(drake_aigto, name)


def test_the_index_has_every_page() -> None:
    index = (API.parent / "index.md").read_text("utf-8")
    for page in API.parent.rglob("*.md"):
        if page.stem != "index":
            assert f"\n{page.relative_to(API.parent).with_suffix('')}\n" in index


def test_the_first_page_shows_every_plan_with_what_it_is_and_its_seconds() -> None:
    text, seconds = (API.parent / "index.md").read_text("utf-8"), scenario_seconds()
    shown = dict(re.findall(r"^!\[Animation.*?\((\S+)\) \*\*(\S+)\*\* .*$", text, re.MULTILINE))
    assert {*scenario_summaries()} == {*shown.values()}
    for name, told in scenario_summaries().items():
        took = f" {seconds[name]:g}\u00a0s." if name in seconds else ""
        assert f"**{name}** {told}.{took}\n" in text
    for picture in shown:
        assert (API.parent / picture).stat().st_size < 80_000


def test_readme_has_a_strip_of_the_first_page() -> None:
    shown = re.findall(r'<img src="docs/(images/gallery/\w+\.webp)"', README)
    assert len(shown) >= 5 and all((API.parent / picture).exists() for picture in shown)


NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.name)
def test_a_notebook_has_no_outputs_checks_what_it_says_and_imports_what_is_there(
    path: Path,
) -> None:
    notebook = json.loads(path.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    left = [i for i, cell in enumerate(cells) if cell["outputs"] or cell["execution_count"]]
    assert not left, f"clear all outputs of {path.name}, then save it (code cells {left})"
    assert set(notebook["metadata"]) <= {"kernelspec", "language_info"}
    lines = "".join(line for cell in cells for line in ["\n", *cell["source"]])
    assert "assert " in lines
    imports = [node for node in ast.walk(ast.parse(lines)) if isinstance(node, ast.ImportFrom)]
    ours = [node for node in imports if (node.module or "").startswith("drake_aigto")]
    assert ours
    for node in ours:
        module = importlib.import_module(str(node.module))
        assert not [alias.name for alias in node.names if not hasattr(module, alias.name)]


@pytest.mark.parametrize("page", records.PAGES, ids=lambda page: page.name)
def test_a_page_says_what_the_records_say(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert text.count("<!-- figure: ") == len(records.MARKED.findall(text))
    assert records.quote(text) == text, "run: python -m benchmarks.records quote"
    # A comment at the begin of a line ends a paragraph, and what follows it there is no Markdown.
    assert re.findall(r"^[^\n]+\n *<!-- figure: \w+ -->\S.*", text, flags=re.MULTILINE) == []


@pytest.mark.parametrize(
    "page", [page for page in records.PAGES if "measured" in page.stem], ids=lambda page: page.name
)
def test_all_seconds_and_shares_of_measured_pages_are_quoted(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    unquoted = records.MARKED.sub("", re.sub(r"`[^`]*`|^    .*$", "", text, flags=re.MULTILINE))
    assert re.findall(r"[\d.]+ ?(?:ms|s|%|×)(?!\w)", unquoted) == []


@pytest.mark.parametrize("name", records.RECORDS)
def test_a_record_was_made_by_the_command_that_is_shown(name: str) -> None:
    lines = records.path_of(name).read_text(encoding="utf-8").splitlines()
    assert lines[0] == f"# {records.RECORDS[name]}"
    assert re.match(r"# commit \w+, \d{4}-\d\d-\d\d, \d+ s, exit status [01]$", lines[2])


def test_a_page_lists_the_age_of_every_record() -> None:
    rows = [row.split() for row in records.list_ages().splitlines()]
    assert sorted(row[-1] for row in rows) == sorted(records.RECORDS)
    assert [row[0] for row in rows] == sorted(row[0] for row in rows)
    pages = [page.read_text(encoding="utf-8") for page in records.PAGES]
    assert sum(records.list_ages() in page for page in pages) == 1


def test_records_have_files_and_pages_and_unknown_ones_are_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert {path.stem for path in records.FOLDER.glob("*.txt")} == set(records.RECORDS)
    with pytest.raises(SystemExit, match="2"):
        records.main(["run", "table1", "nonsense"])
    assert "unknown records ['nonsense'], expected some of" in capsys.readouterr().err


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


QUICK = [
    each
    for each in examples(README)
    if not re.search("TrackingController|plan_many|plan_literal", each[0])
]
LONG = [
    each
    for page in (README, MODELS_PAGE, TASKS_PAGE, LOOP_PAGE, CERTIFICATES_PAGE)
    for each in examples(page)
    if each not in QUICK
]


@pytest.mark.parametrize(("code", "promised"), [*QUICK, *slow(*LONG)])
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


def test_output_may_differ_in_the_last_digits_alone() -> None:
    promised = "cost 1.20e-5 m at row1"
    for printed in (promised, "cost 1.21e-05 m  at row1\n", "cost 1.19e-5 m at row1"):
        assert_same_output(printed, promised)
    for printed in (
        *("cost 1.30e-5 m at row1", "cost −1.20e-5 m at row1", "cost 1.20e-5 s at row1"),
        *("cost 1.20e-5 m at row2", "cost 1.20e-5 m at row1 2", "cost"),
    ):
        with pytest.raises(AssertionError):
            assert_same_output(printed, promised)


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
    gait, *_ = FENCED.findall(TASKS_PAGE.split("## Motions that repeat")[1])
    assert Planner(Scenario.from_plain(yaml.safe_load(gait[1]))).scenario.periodic
    for line in blocks["sh"].splitlines():
        words = shlex.split(line)[1:]
        asked = load_scenario(make_parser(words).parse_args(words))
        assert asked != shipped
        World.from_scenario(asked)
    task = [field.name for field in dataclasses.fields(Scenario) if field.name not in _PHYSICS]
    assert [name for name in task if f"`{name}`" not in TASKS_PAGE] == []


def commands() -> dict[str, str]:
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


# Words of our own that readers could not make sense of; the field's are in their place.
OLD_WORDS = re.compile(
    r"\b(walls? (that )?(yields?|gives? way)|yielding|rubs?|coast(s|ing)?|had again|so many|"
    r"dearer|told|what lies|who of|(one|numbers?) an? (row|core|coordinate|actuator))\b",
    re.IGNORECASE,
)


def read_prose(path: Path) -> Iterator[str]:
    """Yields what people read in a file: its text, texts of cells, docstrings and messages."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        nodes = ast.walk(ast.parse(text))
        texts = (node.value for node in nodes if isinstance(node, ast.Constant))
        yield from (each for each in texts if isinstance(each, str) and " " in each)
    elif path.suffix == ".ipynb":
        cells = json.loads(text)["cells"]
        yield from ("".join(cell["source"]) for cell in cells if cell["cell_type"] == "markdown")
    else:
        yield re.sub(r"^    .*$", "", text, flags=re.MULTILINE)


def test_people_read_words_of_the_field() -> None:
    paths = [records.CHECKOUT / "README.md", *(records.CHECKOUT / "notebooks").glob("*.ipynb")]
    # The page of results is made of the names in its data.
    paths += [path for path in (records.CHECKOUT / "docs").rglob("*.md") if path.stem != "results"]
    paths += (records.CHECKOUT / "drake_aigto").rglob("*.py")
    found = []
    for path in paths:
        for text in read_prose(path):
            # Code, and names of arguments.
            prose = re.sub(r"```.*?```|`[^`]*`|\n +\w+:", "", text, flags=re.DOTALL)
            found += [
                f"{path.relative_to(records.CHECKOUT)}: {m[0]}" for m in OLD_WORDS.finditer(prose)
            ]
    assert found == []
