"""A plan survives its file, knows how and where it was made, and takes no other world for that."""

from __future__ import annotations

import dataclasses
import html
import json
import math
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.geometry import Meshcat
from replay_worlds import make_diagram
from rigid_worlds import write_model

from drake_aigto import Plan, Planner, PlanOptions, Scenario, World
from drake_aigto.cli import BAD_INPUT, FINE, main
from drake_aigto.errors import (
    DamagedDataError,
    ModelError,
    OptionsError,
    OutputFileError,
    PlanFileError,
)
from drake_aigto.paper import LITERAL_LADDER, LiteralOptions, plan_literal
from drake_aigto.plain import LEFT_OUT, from_plain, to_plain
from drake_aigto.planning import BALL_LADDER
from drake_aigto.show import format_plan, play, play_boxes, report_plan, run_boxes

QUICK = PlanOptions(aigo_steps=20, finalists=1, ladder=BALL_LADDER[:2])
LITERAL = LiteralOptions(ladder=LITERAL_LADDER[2:3], knot_steps=(2,), finalists=1)
FLIGHT = Scenario(
    initial_position=1.0, initial_velocity=-0.3, goal_position=1.2, time_step=0.02, epsilon=1e-9
)


@pytest.fixture(scope="module", params=["rigid", "literal"])
def found(request: pytest.FixtureRequest) -> Plan:
    rigid = request.param == "rigid"
    return Planner(FLIGHT, QUICK).plan() if rigid else plan_literal(FLIGHT, LITERAL)


@pytest.fixture(scope="module")
def rigid() -> Plan:
    return Planner(FLIGHT, QUICK).plan()


@pytest.fixture(scope="module")
def own() -> Plan:
    """Returns a plan of a diagram made in code, whose scenario names the shipped model."""
    return Planner(FLIGHT, QUICK, World.from_diagram(make_diagram(gravity=1.0))).plan()


def rewrite(plan: Plan, path: Path, **changes: Any) -> None:
    """Saves a plan with some fields of its file changed."""
    plan.save(path)
    data = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**data, **changes}), encoding="utf-8")


def test_a_plan_file_reads_back_to_the_same_plan(found: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.json"
    found.save(path)
    loaded = Plan.load(path)
    assert loaded == found
    assert type(loaded.options) is type(found.options)
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]
    written = path.read_bytes()
    loaded.save(path)
    assert path.read_bytes() == written


def test_a_plan_is_shown_as_a_line_that_tells_whether_it_holds(found: Plan) -> None:
    for plan in (found, dataclasses.replace(found, is_interrupted=True)):
        shown = repr(plan)
        assert "\n" not in shown and len(shown) < 400
        for replay in plan.replay:
            assert f"{replay.simulator}={replay.cost:.4g}" in shown
        for name in (f"cost={plan.cost:.4g}", f"holds={plan.holds}", "defect", "penetration"):
            assert name in shown
        assert ("interrupted" in shown) == plan.is_interrupted


def test_a_plan_without_confirmation_reads_back_too(rigid: Plan, tmp_path: Path) -> None:
    bare = dataclasses.replace(rigid, replay=dataclasses.replace(rigid.replay, drake=None))
    bare.save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json").replay.drake is None


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.999])
def test_a_plan_file_cut_short_is_refused(rigid: Plan, tmp_path: Path, kept: float) -> None:
    path = tmp_path / "plan.json"
    rigid.save(path)
    text = path.read_text(encoding="utf-8").rstrip()
    path.write_text(text[: int(kept * len(text))], encoding="utf-8")
    with pytest.raises(PlanFileError, match=r"plan\.json is cut short or no JSON"):
        Plan.load(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 99}, r"version 99, expected version 4\. Plan again"),
        ({"version": 3}, r"version 3, expected version 4\. Plan again"),
        ({"format": "poem"}, "is not a plan file: expected an object with the format 'drake_aig"),
        ({"candidates": []}, "is damaged: got plan: got candidates: got none"),
        ({"candidates": 3}, r"is damaged: got plan\.candidates"),
        ({"replay": {}}, r"is damaged: got plan\.replay\.event_driven: got nothing, expected a v"),
        ({"stats": {"pace": 3}}, r"is damaged: got plan\.stats\.aigo_steps: got nothing"),
        ({"scenario": {"initial_position": 1}}, r"is damaged: got plan\.scenario: got missing"),
        ({"transcription": 3}, r"is damaged: got plan\.transcription: got 3, expected text"),
        ({"transcription": "prose"}, "is damaged: got transcription: got 'prose', expected one"),
        ({"options": {"finalists": "3"}}, r"is damaged: got plan\.options\.finalists: got '3'"),
        ({"made_in": {}}, r"is damaged: got plan\.made_in\.model: got nothing"),
    ],
)
def test_a_damaged_plan_file_is_refused(
    rigid: Plan, tmp_path: Path, change: dict[str, Any], message: str
) -> None:
    rewrite(rigid, tmp_path / "plan.json", **change)
    with pytest.raises(PlanFileError, match=message):
        Plan.load(tmp_path / "plan.json")


def test_a_plan_with_an_option_of_another_version_is_read_and_that_is_told(
    rigid: Plan, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rewrite(rigid, tmp_path / "plan.json", options={**to_plain(rigid.options), "repeats": 9})
    assert Plan.load(tmp_path / "plan.json") == rigid
    assert caplog.messages == ["options of another version of drake_aigto are left out: repeats"]


def test_files_that_cannot_be_read_or_written_are_named(rigid: Plan, tmp_path: Path) -> None:
    with pytest.raises(PlanFileError, match=r"nowhere\.json can't be read"):
        Plan.load(tmp_path / "nowhere.json")
    with pytest.raises(OutputFileError, match=r"can't be written.*a folder that exists"):
        rigid.save(tmp_path / "no folder" / "plan.json")
    (tmp_path / "list.json").write_text("[1, 2]", encoding="utf-8")
    with pytest.raises(PlanFileError, match=r"list\.json is not a plan file: expected an object"):
        Plan.load(tmp_path / "list.json")


def test_a_plan_of_unknown_options_says_so(
    rigid: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plan.json"
    rewrite(rigid, path, options=None)
    unknown = Plan.load(path)
    assert unknown.options is None
    assert main(["play", str(path), "--optimization", "--html", str(tmp_path / "p.html")]) == (
        BAD_INPUT
    )
    assert "got a plan that names no options" in capsys.readouterr().err
    corridor = World.from_scenario(Scenario.named("corridor/three_bounces"))
    with pytest.raises(ModelError, match=r"Give the world that the plan was made in"):
        unknown.replayed(corridor)


def test_a_plan_keeps_its_world_but_takes_it_nowhere(rigid: Plan) -> None:
    assert rigid.find_world() is rigid.world
    sent = pickle.loads(pickle.dumps(rigid))
    assert sent == rigid
    assert sent.world is None
    assert sent.find_world().fingerprint == rigid.made_in


@pytest.mark.slow
def test_a_plan_of_ones_own_diagram_is_shown_without_more_words(own: Plan) -> None:
    meshcat = Meshcat()
    play(own, meshcat)
    play_boxes(own, meshcat)
    assert own.replayed().replay == own.replay
    assert "holds" in format_plan(own)
    page = html.unescape(report_plan(own))
    assert "a diagram of one's own" in page
    assert "World.from_diagram(diagram)" in page


def test_a_file_of_a_plan_of_ones_own_diagram_takes_that_and_no_other(
    own: Plan, tmp_path: Path
) -> None:
    own.save(tmp_path / "own.json")
    loaded = Plan.load(tmp_path / "own.json")
    assert loaded == own
    for use in (Plan.replayed, run_boxes, report_plan, format_plan):
        with pytest.raises(ModelError, match=r"a diagram of one's own: .*world=World\.from_diag"):
            use(loaded)
        with pytest.raises(ModelError, match=r"got accelerations .*Give the world that"):
            use(loaded, World.from_diagram(make_diagram(gravity=1.1)))
    again = World.from_diagram(make_diagram(gravity=1.0))
    replayed = loaded.replayed(again)
    assert replayed.replay == own.replay
    assert replayed.world is again
    assert run_boxes(loaded, again).rung in QUICK.ball_ladder


@pytest.mark.parametrize("command", ["replay", "play", "report"])
def test_the_command_line_says_that_it_has_no_diagram(
    command: str, own: Plan, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    own.save(tmp_path / "own.json")
    page = [] if command == "replay" else ["--html", str(tmp_path / "page.html")]
    assert main([command, str(tmp_path / "own.json"), *page]) == BAD_INPUT
    assert capsys.readouterr().err == (
        "drake-aigto: the plan was made in a diagram of one's own: expected that diagram, which "
        "no file has. In Python, load the plan, and give world=World.from_diagram(diagram).\n"
    )
    assert not (tmp_path / "page.html").exists()


def test_a_model_that_was_changed_since_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mass = "<mass>1.0</mass>"
    model, path = write_model(tmp_path, mass, mass), tmp_path / "plan.json"
    Planner(dataclasses.replace(FLIGHT, model=model), QUICK).plan().save(path)
    assert main(["replay", str(path), "--quiet"]) == FINE
    write_model(tmp_path, mass, "<mass>1.1</mass>")
    capsys.readouterr()
    assert main(["replay", str(path), "--quiet"]) == BAD_INPUT
    told = capsys.readouterr().err
    assert "the world has changed: got accelerations" in told
    assert f"Plan again: {model} is not as it was when the plan was made." in told


@dataclass(frozen=True)
class Leaf:
    size: float
    color: Literal["green", "red"] = "green"
    age: int | None = None

    def __post_init__(self) -> None:
        if self.size == 7.0:
            raise OptionsError("size", got=7, expected="another")


@dataclass(frozen=True, eq=False)
class Tree:
    leaves: tuple[Leaf, ...]
    span: tuple[float, float]
    names: Mapping[str, tuple[bool, ...]]
    rings: npt.NDArray[np.float64]
    sap: object = field(default=None, metadata=LEFT_OUT)


def plant(**changes: Any) -> dict[str, Any]:
    tree = Tree((Leaf(1.0), Leaf(0.5, "red", 3)), (0.0, 1.0), {"oak": (True,)}, np.eye(2), "sweet")
    return {**json.loads(json.dumps(to_plain(tree))), **changes}


@given(st.lists(st.floats(allow_nan=False), min_size=1), st.floats(allow_nan=False))
def test_floats_read_back_to_the_same_bits(numbers: list[float], low: float) -> None:
    tree = Tree((), (low, math.nan), {}, np.array(numbers))
    read = from_plain(Tree, json.loads(json.dumps(to_plain(tree))))
    assert read.rings.tobytes() == tree.rings.tobytes()
    assert np.array(read.span[0]).tobytes() == np.array(low).tobytes()
    assert math.isnan(read.span[1])


def test_types_come_back_and_what_is_left_out_does_not() -> None:
    read = from_plain(Tree, plant())
    assert read.leaves == (Leaf(1.0), Leaf(0.5, "red", 3))
    assert (read.span, read.names, read.sap) == ((0.0, 1.0), {"oak": (True,)}, None)
    assert "sap" not in plant()
    assert from_plain(Leaf, {"size": 3}) == Leaf(3.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"leaves": [{"size": "1.0"}]}, r"Tree\.leaves\[0\]\.size: got '1\.0', expected a number"),
        ({"leaves": [{"size": True}]}, r"Tree\.leaves\[0\]\.size: got True, expected a number\."),
        ({"leaves": [{"size": 7}]}, r"Tree\.leaves\[0\]: got size: got 7, expected another"),
        ({"leaves": [{"size": 1, "color": "blue"}]}, r"color: got 'blue', expected one of 'green'"),
        ({"leaves": [{"size": 1, "age": 0.5}]}, r"age: got 0\.5, expected a whole number"),
        ({"leaves": [{"color": "red"}]}, r"Tree\.leaves\[0\]\.size: got nothing, expected a value"),
        ({"leaves": 3}, r"Tree\.leaves: got 'int' object is not iterable"),
        ({"span": [1.0]}, r"Tree\.span: got Not enough values in \[1\.0\]"),
        ({"names": {"oak": [1]}}, r"Tree\.names\['oak'\]\[0\]: got 1, expected true or false"),
        ({"rings": [[1.0], [2.0, 3.0]]}, r"Tree\.rings: got .*inhomogeneous"),
        ({"roots": 3}, "Tree: got unknown roots, expected fields of Tree"),
        ({"sap": "sweet"}, "Tree: got unknown sap"),
    ],
)
def test_what_does_not_fit_is_named(change: dict[str, Any], message: str) -> None:
    with pytest.raises(DamagedDataError, match=message):
        from_plain(Tree, plant(**change))
