"""A plan survives its file, knows how and where it was made, and takes no other world for that."""

from __future__ import annotations

import copy
import dataclasses
import html
import json
import math
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from pydrake.geometry import Meshcat
from replay_worlds import make_diagram, make_scenario
from rigid_worlds import write_model

from drake_aigto import Plan, Planner, PlanOptions, Scenario, World
from drake_aigto.cli import BAD_INPUT, FINE, main
from drake_aigto.errors import (
    DamagedDataError,
    ModelError,
    OptionsError,
    OutputFileError,
    PlanFileError,
    TrajectoryError,
)
from drake_aigto.paper import LITERAL_LADDER, LiteralOptions, plan_literal
from drake_aigto.plain import LEFT_OUT, from_plain, to_plain
from drake_aigto.planning import BALL_LADDER, Arcs, PhaseProblem
from drake_aigto.show import (
    PALETTE,
    PLAN_LABEL,
    Motion,
    color_of,
    format_plan,
    motions_of_plan,
    play,
    play_boxes,
    report_plan,
    run_boxes,
)
from drake_aigto.simulation import Replay, replay_drake, replay_event_driven
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch

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


def make_fields(**changes: Any) -> dict[str, Any]:
    fields = {
        "times": [0.0, 0.2, 0.5, 0.8],
        "positions": [[1.0], [0.6], [0.0], [0.6 + 0.045]],
        "velocities": [[-2.0], [-2.0], [-2.0], [2.3]],
        "controls": [[0.0], [0.0], [1.0]],
        "impulses": [[0.0], [0.0], [4.0], [0.0]],
        "forces": [[0.0], [0.0], [0.0]],
    }
    return {**fields, **changes}


@st.composite
def trajectories(draw: st.DrawFn, largest: float = 1.7e308) -> Trajectory:
    n, nq, nu, m = (draw(st.integers(1, 4)) for _ in range(4))
    finite = st.floats(-largest, largest)
    rows = {
        "positions": (n + 1, nq),
        "velocities": (n + 1, nq),
        "controls": (n, nu),
        "impulses": (n + 1, m),
        "forces": (n, m),
    }
    times = sorted(draw(st.sets(finite, min_size=n + 1, max_size=n + 1)))
    arrays = {name: draw(hnp.arrays(float, shape, elements=finite)) for name, shape in rows.items()}
    return Trajectory(times=np.array(times), **arrays)


@given(trajectories())
def test_json_and_pickle_lose_nothing(trajectory: Trajectory) -> None:
    read = from_plain(Trajectory, json.loads(json.dumps(to_plain(trajectory))))
    for other in (read, pickle.loads(pickle.dumps(trajectory)), copy.deepcopy(trajectory)):
        assert other == trajectory
        assert hash(other) == hash(trajectory)
        for name in make_fields():
            array = getattr(other, name)
            assert array.tobytes() == getattr(trajectory, name).tobytes()
            assert not array.flags.writeable


def test_a_trajectory_keeps_nothing_of_what_it_was_made_of() -> None:
    positions = np.array(make_fields()["positions"])
    trajectory = Trajectory(**make_fields(positions=positions))
    positions[0] = 7.0
    assert trajectory.positions[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        trajectory.positions[0] = 7.0
    assert trajectory != Trajectory(**make_fields(controls=[[0.0], [0.0], [2.0]]))
    assert trajectory != "a trajectory"


NAN = float("nan")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": [0.0]}, r"times: got shape \(1,\), expected \(N\+1,\) with N ≥ 1\."),
        ({"times": 1.0}, r"times: got shape \(\)"),
        (
            {"times": [0.0, 0.5, 0.5, 0.8]},
            r"times: got 0\.5 s, then 0\.5 s \(knots 1 and 2\), expected strictly increasing times",
        ),
        ({"times": [0.0, 0.2, float("inf"), 0.8]}, r"times: got inf at index \(2,\), expected fin"),
        ({"times": "soon"}, r"times: got could not convert .*expected an array of numbers"),
        ({"controls": [[0.0], [0.0]]}, r"controls: got shape \(2, 1\), expected 3 rows, one for e"),
        ({"controls": [0.0, 0.0, 1.0]}, r"controls: got shape \(3,\), expected 3 rows"),
        ({"controls": [[0.0], [NAN], [1.0]]}, r"controls: got nan at index \(1, 0\)"),
        ({"positions": [[1.0]] * 3}, r"positions: got shape \(3, 1\), expected 4 rows, one for ea"),
        ({"velocities": [[1.0, 2.0]] * 4}, r"velocities: got shape \(4, 2\), expected that of pos"),
        ({"impulses": [[0.0], [0.0, 1.0], [0.0], [0.0]]}, r"impulses: got .*inhomogeneous"),
    ],
)
def test_numbers_that_do_not_fit_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(**make_fields(**changes))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], "Trajectory: got .list. object has no"),
        ({"times": [0.0, 1.0]}, r"Trajectory\.positions: got nothing, expected a value"),
        (make_fields(speed=1.0), "Trajectory: got unknown speed, expected fields of Trajectory"),
        (make_fields(times=[0.0, 1.0]), r"Trajectory: got controls: got shape \(3, "),
        (make_fields(times=[None] * 4), "Trajectory: got times: got nan at"),
        (make_fields(times=["now"]), r"Trajectory\.times: got could not convert"),
    ],
)
def test_a_damaged_file_is_refused(data: object, message: str) -> None:
    with pytest.raises(DamagedDataError, match=message):
        from_plain(Trajectory, data)


def test_the_state_curve_is_the_flight_and_jumps_at_the_impulse() -> None:
    state, _ = Trajectory(**make_fields()).to_piecewise()
    assert (state.rows(), state.cols()) == (2, 1)
    for t in np.linspace(0.0, 0.5, 23)[:-1]:
        np.testing.assert_allclose(state.value(t)[:, 0], [1.0 - 2.0 * t, -2.0], atol=1e-14)
    for s in np.linspace(0.0, 0.3, 23):
        flight = [2.0 * s + s**2 / 2, 2.0 + s]
        np.testing.assert_allclose(state.value(0.5 + s)[:, 0], flight, atol=1e-14)


def test_without_impulses_the_state_curve_is_smooth() -> None:
    times = np.array([0.0, 0.1, 0.25, 0.3])
    wave = np.column_stack([np.sin(times)]), np.column_stack([np.cos(times)])
    zeros = {name: np.zeros((3, 1)) for name in ("controls", "forces")}
    zeros["impulses"] = np.zeros((4, 1))
    state, _ = Trajectory(times, *wave, **zeros).to_piecewise()
    for k, t in enumerate(times[1:-1], 1):
        before, after = state.value(np.nextafter(t, 0)), state.value(t)
        np.testing.assert_allclose(before, after, atol=1e-14)
        np.testing.assert_allclose(after[:, 0], [wave[0][k, 0], wave[1][k, 0]], atol=1e-14)
    # Cubics through values and slopes: h⁴/384 off at most.
    assert abs(state.value(0.175)[0, 0] - np.sin(0.175)) < 0.15**4 / 384


@pytest.mark.parametrize(("nq", "nv"), [(2, 2), (7, 6)])
def test_a_state_is_read_as_from_the_piecewise_polynomial(nq: int, nv: int) -> None:
    # With as many positions as velocities cubics, of which some bounce; with a quaternion lines.
    rng = np.random.default_rng(nq)
    times = np.cumsum(rng.uniform(0.1, 0.5, 6))
    impulses = rng.normal(size=(6, 1)) * np.array([0, 1, 0, 0, 1, 0])[:, np.newaxis]
    q, v = rng.normal(size=(6, nq)), rng.normal(size=(6, nv))
    motion = Trajectory(times, q, v, np.zeros((5, 1)), impulses, np.zeros((5, 1)))
    state, _ = motion.to_piecewise()
    for time in [times[0] - 1, *times, *rng.uniform(times[0], times[-1], 50), times[-1] + 1]:
        expected = state.value(np.clip(time, times[0], times[-1]))[:, 0]
        np.testing.assert_allclose(motion.calc_state(time), expected, rtol=0, atol=1e-12)


@given(trajectories(largest=1e3))
def test_the_control_curve_is_held_on_each_interval_and_at_the_end(trajectory: Trajectory) -> None:
    assume(np.all(np.diff(trajectory.times) > 1e-9))
    _, control = trajectory.to_piecewise()
    for k, u in enumerate(trajectory.controls):
        start, end = trajectory.times[k : k + 2]
        for t in {start, start / 2 + end / 2, np.nextafter(end, start)}:
            if start <= t < end:
                assert control.value(t)[:, 0].tolist() == u.tolist()
    assert control.value(trajectory.times[-1])[:, 0].tolist() == trajectory.controls[-1].tolist()


def test_a_motion_goes_on_later_as_it_was() -> None:
    trajectory = Trajectory(**make_fields())
    later = trajectory.later(0.25)
    np.testing.assert_array_equal(later.times, trajectory.times + 0.25)
    assert later.later(-0.25) == trajectory
    with pytest.raises(TrajectoryError, match="strictly increasing"):
        trajectory.later(1e17)


SIMULATE = (replay_event_driven, replay_drake)

# At −2 m/s from 1 m, without control, the ball is at the wall at 0.5 s.
BOUNCE = Trajectory(
    times=np.array([0.0, 0.5, 1.0]),
    positions=np.array([[1.0], [0.0], [1.0]]),
    velocities=np.array([[-2.0], [-2.0], [2.0]]),
    controls=np.zeros((2, 1)),
    impulses=np.array([[0.0], [4.0], [0.0]]),
    forces=np.zeros((2, 1)),
)


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario(initial_position=1.0, initial_velocity=-2.0, goal_position=1.0)


def replay_of(times: Any, positions: Any, velocities: Any) -> Replay:
    nothing: dict[str, Any] = {
        **dict.fromkeys(("cost", "goal_error", "max_penetration"), 0.0),
        **dict.fromkeys(("compliance_error", "compliance_cost"), 0.0),
        **dict.fromkeys(("bounce_times", "bounce_contacts", "matched_speeds"), ()),
        **dict.fromkeys(("energies_before", "energies_after"), ()),
    }
    rows: dict[str, Any] = {"times": np.array(times), "positions": np.array(positions)}
    rows |= {"velocities": np.array(velocities)}
    return Replay(simulator="event-driven", **rows, **nothing)


coefficients = st.lists(st.floats(-3, 3), min_size=4, max_size=4)
knots = st.lists(st.floats(1e-4, 0.3), min_size=1, max_size=4)


@given(coefficients, knots)
def test_gaps_are_filled_on_the_cubic_of_both_ends(
    world: World, cubic: list[float], steps: list[float]
) -> None:
    times = np.cumsum([0.0, *steps])
    position = np.polynomial.Polynomial(cubic)
    velocity = position.deriv()
    replay = replay_of(times, position(times)[:, None], velocity(times)[:, None])
    motion = Motion.from_replay(replay, world)
    assert np.max(np.diff(motion.times)) < 0.0101
    assert set(times) <= set(motion.times)
    # A rise over the shortest step loses four digits of sixteen.
    np.testing.assert_allclose(motion.positions[:, 0], position(motion.times), atol=1e-12)
    np.testing.assert_allclose(motion.velocities[:, 0], velocity(motion.times), atol=1e-10)


def test_a_planned_impact_is_a_jump_of_velocity_at_one_time(world: World) -> None:
    motion = Motion.from_trajectory(BOUNCE, world)
    np.testing.assert_allclose(motion.positions[:, 0], np.abs(1 - 2 * motion.times), atol=1e-12)
    at_wall = motion.times == 0.5
    assert sorted(set(motion.velocities[at_wall, 0])) == [-2.0, 2.0]
    np.testing.assert_allclose(motion.velocities[motion.times > 0.5], 2.0)
    assert motion.label == PLAN_LABEL == "plan (not a simulation)"
    with pytest.raises(ValueError, match="read-only"):
        motion.positions[0, 0] = 3.0


def test_phases_are_drawn_as_a_rigid_wall_plays_them(world: World) -> None:
    # At −2 m/s from 0.6 m it is at the wall at 0.3 s, and at 1 m/s 0.7 s later at the goal.
    scenario = make_scenario(0.6, -2.0, 0.7, time_step=0.1, restitution=0.5)
    phases = PhaseProblem(world, scenario, [Touch.bounce(0.3)])
    arcs = Arcs(phases)
    plan = arcs.trajectory(arcs.vector(phases.guess([[0.0]])))
    assert np.ptp(np.diff(plan.times)) > 0.03  # Knots are not even.
    drawn = Motion.from_trajectory(plan, world)
    played = Motion.from_replay(
        replay_event_driven(world, scenario, plan.times, plan.controls), world
    )
    for motion in (drawn, played):
        t, v = motion.times, motion.velocities[:, 0]
        path = np.maximum(0.6 - 2 * t, t - 0.3)
        np.testing.assert_allclose(motion.positions[:, 0], path, atol=1e-12)
        (jump,) = np.flatnonzero(np.abs(np.diff(v)) > 1e-9)
        assert t[jump] == pytest.approx(0.3) and t[jump + 1] - t[jump] < 1e-12
        np.testing.assert_allclose(v, np.where(np.arange(len(v)) <= jump, -2.0, 1.0))
    (touch,) = drawn.touches
    assert touch.start == touch.end == pytest.approx(0.3)
    assert not np.any(drawn.forces) and played.touches == () and played.forces is None


def test_a_contact_that_lasts_stays_at_the_wall_and_has_a_force(world: World) -> None:
    # It stops at the wall at 0.5 s, is pressed on until 0.9 s, and leaves it.
    rest = Trajectory(
        times=np.array([0.0, 0.5, 0.7, 0.9, 1.3]),
        positions=np.array([[1.0], [0.0], [0.0], [0.0], [0.8]]),
        velocities=np.array([[-2.0], [-2.0], [0.0], [0.0], [4.0]]),
        controls=np.array([[0.0], [-3.0], [-5.0], [10.0]]),
        impulses=np.array([[0.0], [2.0], [0.0], [0.0], [0.0]]),
        forces=np.array([[0.0], [3.0], [5.0], [0.0]]),
    )
    motion = Motion.from_trajectory(rest, world)
    resting = (motion.times > 0.5) & (motion.times < 0.9)
    assert np.count_nonzero(resting) > 35
    assert not np.any(motion.positions[resting]) and not np.any(motion.velocities[resting])
    leaving = motion.times >= 0.9
    np.testing.assert_allclose(
        motion.positions[leaving, 0], 5 * (motion.times[leaving] - 0.9) ** 2, atol=1e-12
    )
    assert motion.touches == (Touch(0.5, 0.9),)
    np.testing.assert_array_equal(motion.forces, rest.forces)


def test_a_heavier_mass_jumps_less(scenario: Scenario) -> None:
    heavy = World.from_diagram(World.from_scenario(scenario).diagram, mass=4.0)
    motion = Motion.from_trajectory(BOUNCE, heavy)
    jumps = motion.velocities[motion.times == 0.5, 0]
    assert np.ptp(jumps) == pytest.approx(4.0 / 4.0)


def test_a_plan_is_shown_with_its_simulations_each_labelled(
    world: World, scenario: Scenario
) -> None:
    control = BOUNCE.times, BOUNCE.controls
    replays = [simulate(world, scenario, *control) for simulate in SIMULATE]
    plan: Any = SimpleNamespace(trajectory=BOUNCE, replay=replays, find_world=lambda given: given)
    motions = motions_of_plan(plan, world)
    assert [motion.label for motion in motions] == [
        "plan (not a simulation)",
        "simulation: exactly rigid",
        "simulation: compliant (Drake)",
    ]
    for motion in motions:
        q = np.interp([0.25, 0.75], motion.times, motion.positions[:, 0])
        # Drake's wall turns the ball round 0.1 ms late.
        np.testing.assert_allclose(q, 0.5, atol=3e-4)
    assert [motion.controls is None for motion in motions] == [False, True, True]


def test_colors_differ_and_repeat_in_the_same_order() -> None:
    assert len(set(PALETTE)) == len(PALETTE) >= 6
    assert [color_of(i) for i in range(2 * len(PALETTE))] == [*PALETTE, *PALETTE]
