"""`python -m benchmarks scenarios`: what it prints, keeps, and refuses.

The results page says what the files of results say, and shows what it draws.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest
from scenario_studies import TOYS, Inline, coast_or_turn, made_up_study

from benchmarks import __main__ as command
from benchmarks.__main__ import main
from benchmarks.baselines import registry
from benchmarks.study import scenario_question
from benchmarks.study.scenario_question import MethodRun, ScenarioQuestion, command_of
from benchmarks.study.scenario_study import ScenarioStudy
from drake_aigto import jobs
from drake_aigto.cli import BAD_INPUT, FINE
from drake_aigto.errors import AigtoError, PlanFileError
from drake_aigto.planning import Planner

SCENARIOS = ["scenarios", "--steps", "20"]
TOY_METHODS = ["--methods", "coast", "crash", "--seconds-per-unit", "0.5"]


@pytest.fixture(autouse=True)
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "BASELINES", TOYS)
    monkeypatch.setattr(jobs, "open_workers", Inline)
    scenario_question._warm_up.cache_clear()


@pytest.fixture
def coasting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ScenarioQuestion, "scenario", coast_or_turn)


def test_every_methods_success_is_printed_for_each_restitution(
    capsys: pytest.CaptureFixture[str], coasting: None
) -> None:
    arguments = [*SCENARIOS, "--count", "6", *TOY_METHODS]
    assert main(arguments) == FINE
    printed = capsys.readouterr().out
    rows = [line.split(" | ") for line in printed.splitlines()]
    # Half of each coast to their goals.
    assert [row[2:4] for row in rows if row[1:2] == ["coast"]] == [["2", "50.0 %"]] * 3
    assert [row[6:8] for row in rows if row[1:2] == ["crash"]] == [["none", "none"]] * 3
    assert "crash failed: ZeroDivisionError: no way at all\n" in printed
    assert "× is one unit of time: 0.5 s\n" in printed


def test_a_plan_that_misses_is_named(
    capsys: pytest.CaptureFixture[str], coasting: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(planner: Planner) -> None:
        raise PlanFileError("no plan today")

    arguments = [*SCENARIOS, "--count", "2"]
    monkeypatch.setattr(Planner, "plan", fail)
    assert main(arguments) == FINE
    printed = capsys.readouterr().out
    missed = "aigto missed scenario 1: q(0) = 1 m, v(0) = 0.2 m/s, goal 0.5 m, e = 0.8; cost / J* "
    assert f"{missed}none\n" in printed
    assert "aigto failed: PlanFileError: no plan today.\n" in printed


def test_what_boxes_say_is_printed_if_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [*SCENARIOS, "--count", "1", "--read-boxes"]
    assert main(arguments) == FINE
    printed = capsys.readouterr().out
    assert "have the optimum's number of contacts in 1 of 1:\nby rung " in printed


def test_all_stands_for_every_method(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "BASELINES", {"coast": TOYS["coast"]})
    path = tmp_path / "study.json"
    assert main([*SCENARIOS, "--methods", "all", "--count", "1", "--json", str(path)]) == FINE
    assert ScenarioStudy.load(path).question.methods == ("aigto", "coast")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("scenarios --count 0", "count: got 0, expected a whole number, 1 or more"),
        ("scenarios --methods aigto cost", "unknown baseline 'cost': expected aigto, the planner,"),
        ("scenarios --json no/folder/x.json", "no/folder/x.json can't be written"),
        ("ablations --variants luck", "variants: got 'luck', expected some of 'default'"),
    ],
)
def test_bad_input_is_refused_before_any_work(
    words: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "run_all", None)
    with pytest.raises(AigtoError, match=re.escape(message)):
        main(words.split())


def test_no_command_is_answered_with_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["weather"]) == BAD_INPUT
    assert "expected one of scenarios, ablations, page" in capsys.readouterr().err


PNG = b"\x89PNG\r\n"


def make_study() -> ScenarioStudy:
    """Returns a study of four scenarios: all are planned; one is found by the rival, late."""
    question = ScenarioQuestion(count=4, methods=("aigto", "coast"), budgets=(1.0, 10.0))
    rivals = (
        MethodRun(((0.2, 5.0), (1.5, 1.0)), 1.5),  # optimal after 3 units
        MethodRun(((0.2, 5.0), (4.0, 1.5)), 5.0),
        MethodRun(((0.2, 1.05),), 5.0),
        MethodRun((), 5.0, error="ValueError: no"),
    )
    planned = MethodRun(((0.5, 1.001),), 0.5, 3)
    return made_up_study(question, [{"aigto": planned, "coast": rival} for rival in rivals])


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of one study, whose results lie beside it."""
    folder = tmp_path_factory.mktemp("page")
    make_study().save(folder / "rivals.json")
    page = folder / "results.md"
    assert main(["page", str(folder / "rivals.json"), "--out", str(page)]) == FINE
    return page


@pytest.mark.slow
def test_every_picture_of_the_page_is_there(page: Path) -> None:
    links = re.findall(r"!\[(.+)\]\((.+)\)", page.read_text(encoding="utf-8"))
    assert [link for _, link in links] == [
        f"images/results_rivals_{name}.png" for name in ("success", "map")
    ]
    assert {path.name for path in (page.parent / "images").iterdir()} == {
        Path(link).name for _, link in links
    }
    for _, link in links:
        assert (page.parent / link).read_bytes().startswith(PNG)


def test_the_table_says_what_the_study_says(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    cells = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in text.splitlines()
        if line.startswith("|")
    ]
    assert cells[0][:5] == ["e", "method", "scenarios", "optimal at 1×", "optimal at 10×"]
    table = {(row[0], row[1]): row[2:] for row in cells[2:]}
    assert table["1", "aigto"] == ["2", "100.0 %", "", "1.001000", "1.001000", "0.50", ""]
    assert table["1", "coast"] == ["2", "0.0 %", "50.0 %", "1.000000", "none", "3.25", "1"]
    assert table["0.8", "coast"] == ["1", "0.0 %", "0.0 %", "1.50", "1.50", "5.00", ""]
    assert "v₀ ∈ [−3, 0.5] m/s, p_f ∈ [0.2, 1.5] m, e ∈ {1, 0.8, 0.5}, mass = 1 kg" in text
    assert "Not all of these" not in text


@pytest.mark.slow
def test_the_page_is_the_same_again(page: Path, tmp_path: Path) -> None:
    again = tmp_path / page.name
    assert main(["page", str(page.with_name("rivals.json")), "--out", str(again)]) == FINE
    assert again.read_bytes() == page.read_bytes()
    for image in (tmp_path / "images").iterdir():
        assert image.read_bytes() == (page.parent / "images" / image.name).read_bytes()


@pytest.mark.parametrize(
    "question",
    [
        ScenarioQuestion(),
        ScenarioQuestion(
            count=7,
            seed=3,
            num_steps=50,
            methods=("aigto", "coast", "two words"),
            budgets=(1.0, 30.0),
            seconds_per_unit=0.25,
            reads_boxes=True,
        ),
    ],
)
def test_the_command_on_the_page_asks_the_studys_question(
    question: ScenarioQuestion, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[ScenarioQuestion] = []

    def ask(study: ScenarioStudy, options: object) -> ScenarioStudy:
        asked.append(study.question)
        return study

    monkeypatch.setattr(command, "_ask", ask)
    assert main(shlex.split(command_of(question))[3:]) == FINE
    assert asked == [question]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"kind": "weather"}', "got kind 'weather', expected one of 'scenarios', "),
        ('{"kind": "scenarios"}', "is damaged: got no 'question'"),
        ('{"kind": "scenarios", "question": []}', "is damaged: got ScenarioQuestion: got 'list'"),
        ("[]", 'expected an object with a field "kind"'),
        ('{"kind": 3}', "got kind 3, expected an object"),
        ('{"kind": "fru', "is cut short or no JSON: got Unterminated string"),
    ],
)
def test_what_is_no_result_is_refused(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(text, encoding="utf-8")
    page = tmp_path / "results.md"
    with pytest.raises(AigtoError, match=re.escape(message)):
        main(["page", str(path), "--out", str(page)])
    assert not page.exists()
