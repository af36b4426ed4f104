"""Studies of scenarios: their verdicts, files, command line and page; variants of the planner."""

from __future__ import annotations

import dataclasses
import math
import re
import shlex
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_worlds import shipped_world
from scenario_studies import TOYS, Inline, coast_or_turn, made_up_study

from benchmarks import __main__ as command
from benchmarks.__main__ import main
from benchmarks.ablations.ablations import (
    VARIANTS,
    AblationQuestion,
    AblationStudy,
    Variant,
    count_lost_bounces,
    format_ablations,
    run_variant,
)
from benchmarks.baselines import registry
from benchmarks.study import scenario_question, scenario_study
from benchmarks.study.scenario_question import (
    Job,
    MethodRun,
    ScenarioQuestion,
    command_of,
    round_to,
    run_job,
)
from benchmarks.study.scenario_study import ScenarioStudy, answer, calc_good_enough
from drake_aigto import PlanOptions, Scenario, jobs
from drake_aigto.cli import BAD_INPUT, FINE
from drake_aigto.errors import AigtoError, PlanFileError, ResultsFileError
from drake_aigto.paper import rigid_optimum
from drake_aigto.planning import BALL_LADDER, Planner, Rung
from drake_aigto.show import WIDTH

QUICK = ScenarioQuestion(count=4, methods=("coast", "crash"), seconds_per_unit=0.5, num_steps=20)
PLANNED = dataclasses.replace(
    QUICK, count=2, methods=("coast", "aigto"), seconds_per_unit=None, budgets=(1.0, 100.0)
)


@pytest.fixture(autouse=True)
def toys(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "BASELINES", TOYS)
    monkeypatch.setattr(jobs, "open_workers", Inline)
    scenario_question._warm_up.cache_clear()


@pytest.fixture
def coasting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ScenarioQuestion, "scenario", coast_or_turn)


def run_study(question: ScenarioQuestion) -> ScenarioStudy:
    return ScenarioStudy(question, tuple(answer((question, i)) for i in range(question.count)))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study.json"


@pytest.mark.usefixtures("coasting")
def test_a_study_knows_who_succeeds_and_who_fails_and_survives_its_file(path: Path) -> None:
    study = run_study(QUICK)
    assert study.is_complete
    easy, hard, *_ = study.results
    assert easy.optimum == pytest.approx(0.0, abs=1e-12)
    assert easy.good_enough == calc_good_enough(easy.optimum) == pytest.approx(1e-7)
    assert easy.runs["coast"].evaluations == 2
    assert study.succeeds(easy, "coast", 1.0)
    # Coasting ends 0.7 m off the goal.
    assert study.cost(hard, "coast", 100.0) == pytest.approx(0.49)
    assert 0.0 < hard.optimum < 0.49
    assert not study.succeeds(hard, "coast", 100.0)
    for result in study.results:
        assert result.runs["crash"].error == "ZeroDivisionError: no way\nat all"
        assert result.runs["crash"].cost == math.inf
        assert not study.succeeds(result, "crash", 100.0)
    study.save(path)
    assert ScenarioStudy.load(path) == study


@pytest.mark.usefixtures("coasting")
def test_the_planner_goes_first_and_its_time_is_the_unit(monkeypatch: pytest.MonkeyPatch) -> None:
    jobs: list[Job] = []

    def run(job: Job) -> MethodRun:
        jobs.append(job)
        return run_job(job)

    monkeypatch.setattr(scenario_study, "run_job", run)
    study = run_study(PLANNED)
    assert [job.method for job in jobs] == ["aigto", "coast"] * 2
    for result, job in zip(study.results, jobs[1::2], strict=True):
        assert job.seconds == pytest.approx(100.0 * result.runs["aigto"].seconds, rel=1e-3)
        assert job.good_enough == result.good_enough
        assert study.succeeds(result, "aigto", 1.0)
        assert study.unit(result) == result.runs["aigto"].seconds > 0.0


@given(
    st.lists(st.tuples(st.floats(1e-3, 1e3) | st.floats(1.0, 1.01), st.floats(1e-6, 1e6))),
    st.lists(st.floats(1e-3, 1e3) | st.floats(1.0, 1.01), min_size=1, unique=True).map(sorted),
)
def test_thinning_loses_no_budgets_cost(
    offers: list[tuple[float, float]], ends: list[float]
) -> None:
    best: list[tuple[float, float]] = []
    for at, cost in sorted(offers):
        if not best or cost < best[-1][1]:
            best.append((at, cost))
    whole = MethodRun(tuple(best), 1e3)
    thinned = whole.thinned(ends)
    assert len(thinned.improvements) <= len(ends) + 1
    for end in (*ends, math.inf):
        # Costs have seven digits; times four, rounded down.
        assert thinned.cost_within(end) <= whole.cost_within(end) * (1 + 1e-6)
        assert thinned.cost_within(end) >= whole.cost_within(end * 1.001) * (1 - 1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"goal": 0.5', '"goal": 0.6', "got other numbers for scenario 1 than are drawn now"),
        ('"optimum"', '"ideal"', "is damaged: got results.0..optimum: got nothing"),
    ],
)
@pytest.mark.usefixtures("coasting")
def test_a_damaged_file_is_refused(path: Path, old: str, new: str, message: str) -> None:
    run_study(QUICK).save(path)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ResultsFileError, match=message):
        ScenarioStudy.load(path)


@pytest.mark.parametrize(
    ("value", "digits", "nearest", "down"),
    [
        (123.456, 3, 123.0, 123.0),
        (1.23556e-9, 4, 1.236e-9, 1.235e-9),
        (-0.0019996, 4, -0.002, -0.001999),
        (0.0, 3, 0.0, 0.0),
    ],
)
def test_numbers_are_rounded_to_significant_digits(
    value: float, digits: int, nearest: float, down: float
) -> None:
    assert round_to(value, digits) == nearest
    assert round_to(nearest, digits) == nearest
    assert round_to(value, digits, down=True) == down
    assert round_to(down, digits, down=True) == down


SCENARIOS = ["scenarios", "--steps", "20"]
TOY_METHODS = ["--methods", "coast", "crash", "--seconds-per-unit", "0.5"]


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


BARE = VARIANTS["bare"].options
# A bounce is optimal, and the boxes of the default rungs find it.
BOUNCE = dataclasses.replace(Scenario.named("table1/3"), time_step=0.02)


# The last one of these has a bounce; coasting is optimal in the first.
TWO = AblationQuestion(count=2, methods=("default", "bare, no boxes"), num_steps=20)


def differences(one: Variant, other: Variant) -> set[str]:
    fields = {field.name for field in dataclasses.fields(PlanOptions)}
    pairs = [(name, one.options, other.options) for name in fields]
    fields = {field.name for field in dataclasses.fields(Variant)} - {"group", "options"}
    pairs += [(name, one, other) for name in fields]  # type: ignore[misc]
    return {name for name, mine, yours in pairs if getattr(mine, name) != getattr(yours, name)}


@pytest.mark.parametrize("name", VARIANTS)
def test_a_variant_changes_one_thing(name: str) -> None:
    variant = VARIANTS[name]
    base = Variant("", BARE) if name.startswith("bare,") else Variant("")
    # What is not a change of its own, but what makes another change fair.
    beside = {"bare": {"branches"}, "no polish, continued": {"pull"}}.get(
        name, {"pull"} if name.endswith("no boxes, continued") else set()
    )
    changed = differences(variant, base)
    assert beside <= changed
    assert len(changed - beside) == (name != "default")
    assert variant.options.confirm is False


def _rungs(name: str) -> tuple[Rung, ...]:
    return VARIANTS[name].options.ball_ladder


def run(name: str) -> tuple[bool, MethodRun]:
    """Returns whether a variant finds the bounce, and its run."""
    found = run_variant(shipped_world(), Job(BOUNCE, name))
    exact = rigid_optimum(shipped_world(), BOUNCE)
    assert len(exact.bounce_times) == 1
    return found.cost <= calc_good_enough(exact.cost), found


@pytest.mark.parametrize("name", ["default", "bare", "coast only", "listed, no AIGO"])
def test_the_bounce_is_found_by_boxes_by_simulation_and_by_listing(name: str) -> None:
    is_found, found = run(name)
    assert is_found
    assert len(found.boxes) == (0 if name.startswith("listed") else len(_rungs(name)))
    assert found.seconds > 0


def test_the_bounce_is_lost_without_boxes() -> None:
    is_found, found = run("bare, no boxes")
    assert not is_found
    assert found.boxes == (0, 0, 0)
    assert found.cost > rigid_optimum(shipped_world(), BOUNCE).cost


def test_boxes_that_are_not_polished_have_the_contact_but_not_the_cost() -> None:
    is_found, found = run("no polish")
    assert 1 in found.boxes
    assert not is_found
    assert found.boxes == run("default")[1].boxes


def make_study_of_variants() -> ScenarioStudy:
    """Returns a study of four scenarios, two of which have a bounce."""
    question = AblationQuestion(count=4, methods=("default", "no boxes", "no polish"))
    cheap, dear = ((0.5, 1.001),), ((0.5, 3.0),)
    return made_up_study(
        question,
        [
            {
                "default": MethodRun(cheap, 0.5, boxes=(number % 2, 0)),
                "no boxes": MethodRun(dear if number % 2 else cheap, 0.25, boxes=(0, 0)),
                "no polish": MethodRun((), 0.1, error="ValueError: no"),
            }
            for number in range(4)
        ],
    )


def test_a_study_of_variants_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "study.json"
    words = ["ablations", "--count", "2", "--steps", "20", "--variants", *TWO.methods]
    assert main([*words, "--json", str(path)]) == FINE
    study = AblationStudy.load(path)
    assert study.question == TWO and study.is_complete
    for result in study.results:
        assert study.succeeds(result, "default", 1.0)
        assert len(result.runs["default"].boxes) == len(BALL_LADDER)
        usual = ScenarioQuestion(num_steps=20).scenario(result.number)
        assert study.question.scenario(result.number) == usual


def test_lost_bounces_are_counted_over_all_boxes_where_one_is_optimal() -> None:
    study = make_study_of_variants()
    assert count_lost_bounces(study.results, "default") == (2, 4)
    assert count_lost_bounces(study.results, "no boxes") == (4, 4)
    assert count_lost_bounces(study.results, "no polish") == (0, 0)


def test_a_table_has_a_line_for_each_variant() -> None:
    text = format_ablations(make_study_of_variants())
    assert max(map(len, text.splitlines())) <= WIDTH
    rows = {line[:30].strip(): line[30:].split() for line in text.splitlines()}
    assert rows["default"] == ["100", "%", "1.001000", "0.50", "100", "%", "100", "%", "50", "%"]
    assert rows["no boxes"] == ["50", "%", "1.001000", "0.25", "50", "%", "50", "%", "100", "%"]
    assert rows["no polish"] == ["0", "%", "none", "0.10", "-", "-", "-"]
    assert "no polish failed: ValueError: no" in text
    assert "4 scenarios, of which 2 have a bounce in the optimum" in text


def test_the_page_has_the_table_the_figure_and_what_to_make_of_it(tmp_path: Path) -> None:
    make_study_of_variants().save(tmp_path / "parts.json")
    page = tmp_path / "results.md"
    assert main(["page", str(tmp_path / "parts.json"), "--out", str(page)]) == FINE
    text = page.read_text(encoding="utf-8")
    assert "| boxes | no boxes | 50 % | 1.001000 | 0.25 | 50 % | 50 % | 100 % |" in text
    (link,) = re.findall(r"!\[.+\]\((.+)\)", text)
    assert (tmp_path / link).read_bytes().startswith(PNG)
    (command,) = re.findall(r"^    (python .+)$", text, re.MULTILINE)
    assert shlex.split(command)[1:4] == ["-m", "benchmarks", "ablations"]
    assert "'no boxes'" in command
