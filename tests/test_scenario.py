"""A scenario is checked when made, never changes, and survives YAML and pickle."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import re
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenario_fields import ALL_FIELDS

from drake_aigto import Scenario, World, scenario_names
from drake_aigto.errors import AigtoError, OutputFileError, ScenarioError
from drake_aigto.plain import write_text
from drake_aigto.world import ModelFields, scenario_summaries

ENDS: dict[str, Any] = {"initial_position": 1.0, "initial_velocity": -2.0, "goal_position": 0.73}

finite = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=0.0, exclude_min=True, allow_infinity=False)
vectors = st.lists(finite, min_size=1, max_size=4)


@st.composite
def scenarios(draw: st.DrawFn) -> Scenario:
    time_step = draw(st.floats(1e-6, 1e3))
    return Scenario(
        model=draw(st.text(min_size=1)),
        initial_position=draw(finite | vectors),
        initial_velocity=draw(finite | vectors),
        goal_position=draw(finite | vectors),
        duration=time_step * draw(st.integers(1, 10_000)),
        time_step=time_step,
        control_weight=draw(positive),
        goal_weight=draw(st.just(0.0) | positive),
        epsilon=draw(positive),
        delta=draw(st.just(0.0) | positive),
        restitution=draw(st.floats(0.0, 1.0)),
        mass=draw(st.none() | positive),
    )


TWO_ENDS: dict[str, Any] = {
    "initial_position": [1.0, 0.2],
    "initial_velocity": [0.0, 0.5],
    "goal_position": [0.0, 3.0],
}

numbers = st.floats(-1e6, 1e6)
weights = st.floats(0.0, 1e6)
pairs = st.lists(numbers, min_size=2, max_size=2)
some = weights.filter(bool) | st.just([0.0, 2.0])

MODEL_FIELDS = [field.name for field in dataclasses.fields(ModelFields)]


@st.composite
def bounds(draw: st.DrawFn, name: str) -> dict[str, Any]:
    lower, width = draw(pairs), draw(st.sampled_from([0.0, 1.0, np.inf]))
    return {
        f"{name}_lower": draw(st.sampled_from([None, -np.inf, min(lower), lower])),
        f"{name}_upper": draw(st.sampled_from([None, np.inf, max(lower) + width])),
    }


@st.composite
def matrices(draw: st.DrawFn) -> list[list[float]]:
    a, b, c = draw(weights), draw(weights), draw(st.floats(-1.0, 1.0))
    coupling = c * np.sqrt(a * b)
    return [[a, coupling], [coupling, b]]


@st.composite
def tasks(draw: st.DrawFn) -> Scenario:
    given: dict[str, Any] = {}
    for name in ("position", "velocity", "control"):
        given |= draw(bounds(name))
    for name in ("goal_weight", "goal_velocity_weight"):
        given[name] = draw(weights | st.lists(weights, min_size=2, max_size=2) | matrices())
    if draw(st.booleans()):
        given |= {
            "reference_times": [0.0, 0.5, 2.0],
            "reference_positions": draw(st.lists(pairs, min_size=3, max_size=3)),
            "position_weight": draw(some),
        }
    return Scenario(
        **TWO_ENDS,
        **given,
        goal_velocity=draw(pairs),
        velocity_weight=draw(some),
        hard_goal=draw(st.booleans()),
        angles=draw(st.sampled_from(["exact", "modulo", "chordal"])),
        contact=draw(st.sampled_from(["rigid", "compliant"])),
        control_norm=draw(st.none() | st.just(9.0)),
        duration_range=draw(st.none() | st.just((0.5, 1.0))),
        control_weight=draw(st.just(0.5) | st.just([0.5, 2.0])),
    )


@settings(max_examples=8)
@given(scenarios() | tasks())
def test_a_task_survives_files_copies_and_pickles(scenario: Scenario) -> None:
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "scenario.yaml"
        scenario.save(path)
        copies = (
            Scenario.load(path),
            Scenario.from_plain(scenario.to_plain()),
            dataclasses.replace(scenario),
            copy.deepcopy(scenario),
            pickle.loads(pickle.dumps(scenario)),
        )
    for other in copies:
        assert other == scenario
        assert hash(other) == hash(scenario)
        for array in (other.goal_position, other.goal_velocity):
            assert array is None or not array.flags.writeable


@pytest.mark.parametrize("field", ALL_FIELDS)
def test_scenarios_that_differ_in_one_field_are_not_equal(field: str) -> None:
    others: dict[str, Any] = {
        "initial_position": [9.0, 8.0],
        "initial_velocity": [9.0, 8.0],
        "goal_position": [9.0, 8.0],
        "restitution": 0.5,
        "position_weight": 7.0,
        "velocity_weight": 7.0,
        "reference_times": [0.0, 2.0],
        "reference_positions": [[0.0, 1.0], [2.0, 0.0]],
    }
    # Compliant walls have no restitution.
    given = ALL_FIELDS | ({"contact": "rigid"} if field == "restitution" else {})
    changed = {name: value for name, value in given.items() if name != field}
    if field in others:
        changed[field] = others[field]
    scenario = Scenario(**given)
    assert Scenario(**changed) != scenario
    assert scenario != "a scenario"


def test_the_defaults_are_those_of_the_architecture() -> None:
    scenario = Scenario(**ENDS)
    assert scenario.num_steps == 200
    assert scenario.to_plain() == {
        "model": "package://drake_aigto_models/point_mass_and_wall.sdf",
        "initial_position": [1.0],
        "initial_velocity": [-2.0],
        "goal_position": [0.73],
        "duration": 1.0,
        "time_step": 0.005,
        "control_weight": 1e-3,
        "goal_weight": 1.0,
        "epsilon": 0.1,
        "delta": 1e-3,
        "restitution": 1.0,
        "mass": None,
        "friction": None,
        "ignored_shapes": [],
    }


def test_a_scenario_owns_its_arrays() -> None:
    start = np.array([1.0, 2.0])
    scenario = Scenario(**{**ENDS, "initial_position": start})
    start[0] = 5.0
    np.testing.assert_array_equal(scenario.initial_position, [1.0, 2.0])
    with pytest.raises(ValueError, match="read-only"):
        scenario.initial_position[0] = 5.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        scenario.initial_position = np.array([5.0])  # type: ignore[misc]


@pytest.mark.parametrize("value", [1, 1.0, [1], (1.0,), np.float32(1), np.array(1), np.ones(1)])
def test_a_scalar_is_taken_for_one_coordinate(value: Any) -> None:
    assert Scenario(**{**ENDS, "goal_position": value}).goal_position.tolist() == [1.0]


@pytest.mark.parametrize(
    ("row", "values"),
    [
        (1, (1.0, -2.0, 0.73, 0.1)),
        (2, (0.4, -1.2, 1.0, 0.1)),
        (3, (0.6, -1.5, 1.0, 0.05)),
        (4, (1.0, -2.0, 1.0, 0.02)),
    ],
)
def test_table_1_is_shipped_as_the_paper_prints_it(
    row: int, values: tuple[float, float, float, float]
) -> None:
    start, velocity, goal, epsilon = values
    assert Scenario.named(f"table1/{row}") == Scenario(
        initial_position=start, initial_velocity=velocity, goal_position=goal, epsilon=epsilon
    )


def test_an_unknown_name_lists_the_known_ones() -> None:
    names = list(scenario_summaries())
    assert names == sorted(names) and set(scenario_names()) <= set(names)
    assert {"table1/1", "table1/2", "table1/3", "table1/4", "corridor/lossy"} < set(names)
    with pytest.raises(ScenarioError) as caught:
        Scenario.named("table/2")
    hint, message = "Did you mean 'table1/2'?", "unknown scenario 'table/2': expected one of"
    assert str(caught.value) == f"{hint} {message} {', '.join(names)}."


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize(
    "field",
    [
        field.name
        for field in dataclasses.fields(Scenario)
        if field.name
        not in ("model", "hard_goal", "angles", "contact", "ignored_shapes", "clearance")
        and field.name not in (*MODEL_FIELDS, "frame_goals", "periodic")
        and not field.name.endswith(("_lower", "_upper"))
    ],
)
def test_a_number_that_is_not_finite_is_refused(field: str, bad: float) -> None:
    with pytest.raises(ScenarioError, match=rf"{field}: got {bad}, expected a finite number"):
        Scenario(**{**ENDS, field: bad})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("duration", 0.0, "duration: got 0 s, expected more than 0 s"),
        ("duration", -1, "duration: got -1 s, expected more than 0 s"),
        ("time_step", 0.0, "time_step: got 0 s, expected more than 0 s"),
        ("control_weight", 0.0, "control_weight: got 0, expected more than 0"),
        ("goal_weight", -1.0, "goal_weight: got -1, expected at least 0"),
        ("epsilon", 0.0, "epsilon: got 0 J, expected more than 0 J"),
        ("delta", -1e-9, "delta: got -1e-09 m, expected at least 0 m"),
        ("restitution", 1.5, "restitution: got 1.5, expected at least 0 and at most 1"),
        ("restitution", -0.1, "restitution: got -0.1, expected at least 0 and at most 1"),
        ("mass", 0.0, "mass: got 0 kg, expected more than 0 kg"),
        ("friction", float("nan"), "friction: got nan, expected a finite number"),
        ("ignored_shapes", "foot", "ignored_shapes: got 'foot', expected a list of names"),
        ("ignored_shapes", ["foot", 3], "ignored_shapes: got ['foot', 3], expected a list of"),
        ("friction", -1.0, "friction: got -1, expected at least 0"),
        ("duration", "1", "duration: got '1' (str), expected a number"),
        ("duration", None, "duration: got None (NoneType), expected a number"),
        ("restitution", True, "restitution: got True (bool), expected a number"),
        ("goal_position", True, "goal_position: got True (bool), expected a number"),
        ("goal_position", [1.0, True], "goal_position: got True (bool), expected a number"),
        ("goal_position", "far", "goal_position: got 'far' (str), expected a number"),
        ("goal_position", [1.0, float("nan")], "goal_position: got nan, expected a finite number"),
        ("goal_position", [], "goal_position: got an array of shape (0,), expected a number, or"),
        ("goal_position", [[1.0], [2.0]], "goal_position: got an array of shape (2, 1), expected"),
        ("duration", 10**400, "duration: got inf, expected a finite number"),
        ("goal_position", 1j, "goal_position: got 1j (complex), expected a number"),
        ("model", "", "model: got '', expected a package:// URI or a path to a file"),
        ("model", 3, "model: got 3, expected a package:// URI or a path to a file"),
    ],
)
def test_a_bad_value_is_refused_by_name(field: str, value: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        Scenario(**{**ENDS, field: value})


@pytest.mark.parametrize(
    ("duration", "time_step", "remedy"),
    [
        (1.0, 0.3, "The nearest that fit: duration 0.9 s or 1.2 s, or time_step 0.333333333333 s"),
        (0.1, 0.3, "The nearest that fit: duration 0.3 s, or time_step 0.1 s."),
        (1e-12, 1.0, "The nearest that fit: duration 1 s, or time_step 1e-12 s."),
    ],
)
def test_a_duration_of_no_whole_number_of_steps_is_refused_with_those_that_fit(
    duration: float, time_step: float, remedy: str
) -> None:
    with pytest.raises(ScenarioError, match=re.escape(remedy)) as caught:
        Scenario(**ENDS, duration=duration, time_step=time_step)
    assert "expected a whole number of time steps" in str(caught.value)
    # What the message offers is accepted.
    durations, time_steps = (
        [float(number) for number in re.findall(r"([\d.e-]+) s\b", part)]
        for part in str(caught.value.remedy).split("time_step")
    )
    for fitting in durations:
        Scenario(**ENDS, duration=fitting, time_step=time_step)
    for fitting in time_steps:
        Scenario(**ENDS, duration=duration, time_step=fitting)


def test_a_time_step_that_vanishes_is_refused() -> None:
    with pytest.raises(ScenarioError, match="expected a number of steps that can be counted"):
        Scenario(**ENDS, duration=1e300, time_step=1e-300)


GOOD = "initial_position: 1.0\ninitial_velocity: [-2.0]\ngoal_position: 0.73\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            GOOD + "goal_wieght: 1\n",
            "unknown key 'goal_wieght': expected one of packages, .*, model, initial_position, .*, "
            "ignored_shapes.",
        ),
        (GOOD + "zzz: 1\n", r"unknown key 'zzz': expected one of .*, ignored_shapes\.$"),
        ("duration: 1\n", r"missing initial_position, goal_position\. These have no defau"),
        ("goal_position: 1\n", r"missing initial_position\. It has no default"),
        (GOOD + "epsilon: 0\n", r"epsilon: got 0 J, expected more than 0 J"),
        (GOOD + "epsilon: tiny\n", r"epsilon: got 'tiny' \(str\), expected a number"),
        (GOOD + "delta: .nan\n", "delta: got nan, expected a finite number"),
        ("[1, 2]", "got list, expected a mapping"),
        ("", "got NoneType, expected a mapping"),
        ("a: [1", "is not valid YAML: got while parsing a flow sequence"),
        ("a: !foo bar", "is not valid YAML: got expected a mapping node"),
    ],
)
def test_a_bad_file_is_refused_by_name(text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=rf"{re.escape(str(path))}.*{message}") as caught:
        Scenario.load(path)
    if "wieght" in text:
        assert str(caught.value).startswith("Did you mean 'goal_weight'? ")


def test_a_file_that_cannot_be_read_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml can't be read: got .*No such file"):
        Scenario.load(tmp_path / "nowhere.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\xff")
    with pytest.raises(ScenarioError, match=r"binary\.yaml can't be read: got .*decode"):
        Scenario.load(tmp_path / "binary.yaml")


def test_a_model_beside_its_scenario_is_found_from_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "task").mkdir()
    path, model = tmp_path / "task" / "scenario.yaml", tmp_path / "task" / "robot.sdf"
    dataclasses.replace(Scenario(**ENDS), model="robot.sdf").save(path)
    monkeypatch.chdir(tmp_path)
    assert Scenario.load(path).model == "robot.sdf"  # There is none: what is given counts.
    model.touch()
    assert Scenario.load(path).model == str(model)
    relative = Scenario.load("task/scenario.yaml")
    assert relative.model == "task/robot.sdf"
    relative.save(path)
    assert Scenario.load(path) == relative


def test_a_number_without_a_point_is_read_as_a_number(tmp_path: Path) -> None:
    # YAML 1.1, which Drake reads, takes 1e-3 for text.
    path = tmp_path / "scenario.yaml"
    path.write_text(GOOD.replace("-2.0", "-2e0") + "epsilon: 1e-3\n", encoding="utf-8")
    scenario = Scenario.load(path)
    assert scenario.epsilon == 1e-3
    assert scenario.initial_velocity.tolist() == [-2.0]


def test_a_failed_write_leaves_the_old_file_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file.txt"
    write_text(path, "old")

    def fail(self: Path, target: Path) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OSError, match="disk full"):
        write_text(path, "new")
    assert [entry.read_text(encoding="utf-8") for entry in tmp_path.iterdir()] == ["old"]


@pytest.mark.parametrize(
    ("parts", "text"),
    [
        ({"what": "the wall is missing"}, "the wall is missing."),
        ({"what": "mass", "got": 0, "expected": "more"}, "mass: got 0, expected more."),
        ({"what": "mass", "expected": "more", "remedy": "Eat."}, "mass: expected more. Eat."),
    ],
)
def test_an_error_reads_as_sentences(parts: dict[str, Any], text: str) -> None:
    error = AigtoError(**parts)
    assert str(error) == text
    assert str(pickle.loads(pickle.dumps(error))) == text


def test_an_error_is_caught_as_what_python_calls_it() -> None:
    with pytest.raises(ValueError, match="mass"):
        raise ScenarioError("mass")
    with pytest.raises(OSError, match=r"can't be written\. Name another\."):
        raise OutputFileError("it can't be written", remedy="Name another.")


@pytest.mark.parametrize("name", ["cart_pole/soft_06", "finger_and_box/push"])
def test_what_starts_at_rest_needs_no_velocity(name: str, tmp_path: Path) -> None:
    asked = Scenario.named(name).to_plain()
    del asked["initial_velocity"]
    resting = Scenario.from_plain(asked)
    resting.save(tmp_path / "resting.yaml")
    world = World.from_scenario(resting)
    for each in (resting, Scenario.load(tmp_path / "resting.yaml")):
        np.testing.assert_array_equal(
            world.place(each).initial_velocity, np.zeros(world.num_velocities)
        )


def test_what_is_made_of_a_world_is_kept_in_steps_of_any_length_until_another_world_asks() -> None:
    scenario, worlds = Scenario(**ENDS), [object(), object()]

    def make(world: object, asked: Scenario) -> tuple[object, float]:
        return world, asked.duration

    first = scenario.derive(worlds[0], make)
    assert scenario.in_steps(7).derive(worlds[0], make) is first
    assert scenario.derive(worlds[1], make) == (worlds[1], scenario.duration)
    longer = dataclasses.replace(scenario, duration=2 * scenario.duration)
    assert longer.derive(worlds[0], make) == (worlds[0], 2 * scenario.duration)


def test_a_row_is_a_vector() -> None:
    assert Scenario(**{**ENDS, "initial_position": [[0.4, 0.5]]}).initial_position.shape == (2,)
