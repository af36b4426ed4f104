"""Variants of the planner: what each leaves out, what it finds then, and how it is told."""

from __future__ import annotations

import dataclasses
import re
import shlex
from pathlib import Path

import pytest
from replay_worlds import shipped_world
from scenario_studies import Inline, made_up_study

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
from benchmarks.study.scenario_question import Job, MethodRun, ScenarioQuestion
from benchmarks.study.scenario_study import ScenarioStudy, calc_good_enough
from drake_aigto import PlanOptions, Scenario, jobs
from drake_aigto.cli import FINE
from drake_aigto.paper import rigid_optimum
from drake_aigto.planning import BALL_LADDER, Rung
from drake_aigto.show import WIDTH

BARE = VARIANTS["bare"].options
# A bounce is optimal, and the boxes of the default rungs find it.
BOUNCE = dataclasses.replace(Scenario.named("table1/3"), time_step=0.02)


@pytest.fixture(autouse=True)
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jobs, "open_workers", Inline)


# The last one of these has a bounce; coasting is optimal in the first.
QUICK = AblationQuestion(count=2, methods=("default", "bare, no boxes"), num_steps=20)


def differences(one: Variant, other: Variant) -> set[str]:
    """Returns the names of what differs, options and all else."""
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


def make_study() -> ScenarioStudy:
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


def test_a_study_survives_its_file(tmp_path: Path) -> None:
    path = tmp_path / "study.json"
    words = ["ablations", "--count", "2", "--steps", "20", "--variants", *QUICK.methods]
    assert main([*words, "--json", str(path)]) == FINE
    study = AblationStudy.load(path)
    assert study.question == QUICK and study.is_complete
    for result in study.results:
        assert study.succeeds(result, "default", 1.0)
        assert len(result.runs["default"].boxes) == len(BALL_LADDER)
        usual = ScenarioQuestion(num_steps=20).scenario(result.number)
        assert study.question.scenario(result.number) == usual


def test_lost_bounces_are_counted_over_all_boxes_where_one_is_optimal() -> None:
    study = make_study()
    assert count_lost_bounces(study.results, "default") == (2, 4)
    assert count_lost_bounces(study.results, "no boxes") == (4, 4)
    assert count_lost_bounces(study.results, "no polish") == (0, 0)


def test_a_table_has_a_line_for_each_variant() -> None:
    text = format_ablations(make_study())
    assert max(map(len, text.splitlines())) <= WIDTH
    rows = {line[:30].strip(): line[30:].split() for line in text.splitlines()}
    assert rows["default"] == ["100", "%", "1.001000", "0.50", "100", "%", "100", "%", "50", "%"]
    assert rows["no boxes"] == ["50", "%", "1.001000", "0.25", "50", "%", "50", "%", "100", "%"]
    assert rows["no polish"] == ["0", "%", "none", "0.10", "-", "-", "-"]
    assert "no polish failed: ValueError: no" in text
    assert "4 scenarios, of which 2 have a bounce in the optimum" in text


def test_the_page_has_the_table_the_figure_and_what_to_make_of_it(tmp_path: Path) -> None:
    make_study().save(tmp_path / "parts.json")
    page = tmp_path / "results.md"
    assert main(["page", str(tmp_path / "parts.json"), "--out", str(page)]) == FINE
    text = page.read_text(encoding="utf-8")
    assert "| boxes | no boxes | 50 % | 1.001000 | 0.25 | 50 % | 50 % | 100 % |" in text
    (link,) = re.findall(r"!\[.+\]\((.+)\)", text)
    assert (tmp_path / link).read_bytes().startswith(b"\x89PNG")
    (command,) = re.findall(r"^    (python .+)$", text, re.MULTILINE)
    assert shlex.split(command)[1:4] == ["-m", "benchmarks", "ablations"]
    assert "'no boxes'" in command
