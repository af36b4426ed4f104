"""Playback shows motions as they are, the others as ghosts, in what Meshcat sends to a browser."""

from __future__ import annotations

import dataclasses
import re
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from meshcat_pages import BALL, MOTIONS, ball, clips, messages, objects, position
from pydrake.geometry import Meshcat
from space_models import make_scenario

from drake_aigto import Plan, PlanOptions, Scenario, World
from drake_aigto.errors import OptionsError, OutputFileError
from drake_aigto.show import ROOT, Live, Motion, open_meshcat, pack, play, publish
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch

RADIUS = 0.05  # of the shipped ball [m]


def test_motions_play_in_one_place_as_solids_and_ghosts_before_a_wall_that_ends_out_of_sight(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    recording = publish(MOTIONS, meshcat, world, scenario)
    looks = [objects(meshcat)[ball(number)]["materials"][0] for number in (1, 2, 3)]
    assert [look["color"] for look in looks] == [0x0072B2, 0xD55E00, 0x009E73]
    assert [look["opacity"] for look in looks] == [1.0, pytest.approx(0.35), pytest.approx(0.35)]
    assert str(recording) == "solid: plan; ghosts: rigid; Drake"
    # Where surfaces coincide, the plan hides its simulations, and all of them start and goal.
    sent = [m for m in messages(meshcat.StaticHtml()) if "OffsetUnits" in m.get("property", "")]
    depths = {m["path"].split("/")[3]: m["value"] for m in sent if "/ghosts/" not in m["path"]}
    ghosts = {m["path"].split("/")[4]: m["value"] for m in sent if "/ghosts/" in m["path"]}
    assert 0 < depths["2"] < depths["3"] < ghosts["goal"] < ghosts["start"]
    # Until they stand side by side, they have no world, control and contacts of their own.
    sent = [m for m in messages(meshcat.StaticHtml()) if m.get("property") == "visible"]
    hidden = {m["path"] for m in sent if m["value"] is False}
    for name in ("worlds/2", "ghosts/3", "motions/2/control", "motions/3/contacts"):
        assert f"{ROOT}/{name}" in hidden
    assert f"{ROOT}/worlds/1" not in hidden
    recorded = clips(meshcat)
    assert set(recorded) == {ball(number) for number in (1, 2, 3)}
    for number, motion in enumerate(MOTIONS, 1):
        times, places = recorded[ball(number)]
        moving = times <= motion.times[-1]
        np.testing.assert_allclose(times[moving], motion.times, atol=0.5e-3)
        np.testing.assert_allclose(places[moving, 0], motion.positions[:, 0], atol=1e-12)
        np.testing.assert_allclose(places[~moving, 0], motion.positions[-1, 0], atol=1e-12)
        np.testing.assert_allclose(places[:, 1:], 0, atol=1e-12)
    walls = [path for path in objects(meshcat) if "wall_visual" in path]
    assert len(walls) == 3
    for path in walls:
        # The visual wall is 0.08 m thick, and its face is at −0.05 m; of its 0.6 m a quarter
        # of the ball beside it is seen.
        np.testing.assert_allclose(position(meshcat, path), [-0.09, 0, 0], atol=1e-12)
        box = objects(meshcat)[path]["geometries"][0]
        sides = sorted(box[side] for side in ("width", "height", "depth"))
        assert sides == pytest.approx([0.08, 0.15, 0.15])
    publish(MOTIONS[:1], meshcat, world, scenario)
    assert set(clips(meshcat)) == {ball(1)}
    assert ball(1) in objects(meshcat) and ball(2) not in objects(meshcat)


@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_side_by_side_no_motion_covers_another(
    meshcat: Meshcat, world: World, scenario: Scenario, count: int
) -> None:
    beside = publish([MOTIONS[0]] * count, meshcat, world, scenario).beside
    places, (one, both) = np.array(beside["aside"]), np.array(beside["reach"])
    np.testing.assert_allclose(places.mean(axis=0), 0, atol=1e-12)
    np.testing.assert_allclose(places[:, 1], 0, atol=1e-12)  # A level line is seen along y.
    apart = np.abs(places[:, np.newaxis] - places)
    heights = apart[..., 2][~np.eye(count, dtype=bool)]
    assert np.all(heights > 3 * RADIUS)  # Lines that are long stand below each other.
    assert both[0] == one[0] and (both[1] > one[1]) == (count > 1)


def test_a_ball_turns_round_at_the_wall_in_the_frame_of_its_impact(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    # Between frames of 1 ms, and with two rows of one time, as impacts have.
    impact = 0.54985
    motion = Motion(
        "bounce",
        np.array([0.0, impact, impact, 1.0]),
        np.array([[1.0], [0.0], [0.0], [0.7]]),
        np.array([[-1.8], [-1.8], [1.6], [1.6]]),
    )
    publish([motion], meshcat, world, scenario)
    times, places = clips(meshcat)[ball(1)]
    turn = int(np.argmin(places[:, 0]))
    assert times[turn] == pytest.approx(impact, abs=0.5e-3)
    assert places[turn, 0] == pytest.approx(0, abs=1e-12)
    assert np.all(np.diff(times) > 0)


def make_plan() -> Any:
    """Returns what playback needs of a plan: a flight under a control, and its simulation."""
    rows = {
        "times": np.array([0.0, 0.5, 1.0]),
        "positions": np.array([[1.0], [0.7], [0.5]]),
        "velocities": np.array([[-0.6], [-0.5], [-0.3]]),
    }
    control = {"controls": np.array([[0.1], [0.3]]), "forces": np.zeros((2, 1))}
    trajectory = Trajectory(**rows, **control, impulses=np.zeros((3, 1)))
    replay = SimpleNamespace(simulator="drake", bounce_times=(), bounce_contacts=(), **rows)
    scenario = Scenario.named("table1/1")
    return SimpleNamespace(
        trajectory=trajectory,
        replay=[replay, replay],
        scenario=scenario,
        find_world=lambda given: given or World.from_scenario(scenario),
    )


def test_a_plan_is_played_with_its_simulations_and_others(meshcat: Meshcat, world: World) -> None:
    play(make_plan(), meshcat)
    moving = set(clips(meshcat))
    assert {path for path in moving if path.endswith(BALL)} == {ball(lane) for lane in (1, 2, 3)}
    # The simulations are of the plan's control, so that they have its arrow.
    assert {path for path in moving if path.endswith("/arrow")} == {
        f"{ROOT}/motions/{lane}/control/point_mass_and_wall/ball/arrow" for lane in (1, 2, 3)
    }
    recording = play(make_plan(), meshcat, world, beside=MOTIONS[:2])
    assert [label for _, label in recording.beside["motions"]] == [
        "AIGTO: plan (not a simulation)",
        "AIGTO: simulation: compliant (Drake)",
        "plan",
        "rigid",
    ]


def test_what_is_shown_is_explained_with_its_numbers_and_events(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    beside = play(make_plan(), meshcat, world).beside
    texts = [text for _, text in beside["notes"]]
    assert texts == ["where it starts", "goal", "arrow: control, up to 0.3 N"]
    numbers = beside["numbers"]
    assert numbers["names"] == ["x [m]", "control slider [N]"] and beside["events"] == []
    np.testing.assert_allclose(numbers["columns"][0][::399], [1.0, 0.5])
    np.testing.assert_allclose(np.array(numbers["columns"][1])[[0, 100, 300]], [0.1, 0.1, 0.3])
    bounce = dataclasses.replace(MOTIONS[0], impacts=(Touch.bounce(0.5),))
    beside = publish([bounce], meshcat, world, scenario, {0.2: "is kicked"}).beside
    assert [text for _, text in beside["notes"]][-1] == "flash: impact"
    assert beside["events"] == [(0.2, "is kicked", "change"), (0.5, "touches wall", "touch")]


def test_the_camera_sees_all_that_moves_and_its_arrows(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    recording = play(make_plan(), meshcat, world)
    sent = list(messages(meshcat.StaticHtml()))
    (eye,) = (np.array(m["value"]) for m in sent if m.get("property") == "position")
    (target,) = (np.array(m["value"]) for m in sent if m["type"] == "set_target")
    camera = objects(meshcat)["/Cameras/default/rotated"]["object"]
    # In three.js y is up, and z towards the viewer.
    ahead = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0, 1, 0]) - ahead[1] * ahead
    (across, height), _ = recording.beside["reach"]
    half = np.tan(np.deg2rad(camera["fov"] / 2))
    # The ball where it ends and where it starts, and the tip of its longest arrow.
    for x, z in ((0.45, RADIUS), (0.45, -RADIUS), (1.05, RADIUS), (0.7 + 0.15, 0.0)):
        ray = np.array([x, z, -RADIUS]) - eye
        rise = ray @ up / np.linalg.norm(up) / (ray @ ahead)
        assert abs(rise) < half * height and abs(ray[0] / (ray @ ahead)) < half * across
        assert camera["near"] < ray @ ahead < camera["far"]


def room_motion(label: str) -> Motion:
    q = np.array([[0.2, 0.3], [1.0, 0.5], [1.0, 0.5], [0.8, 0.6]])
    times = np.array([0.0, 0.6, 0.6, 1.0])
    return Motion(label, times, q, np.zeros((4, 2)), touches=(Touch.bounce(0.6, 1),))


def test_motions_in_a_plane_stand_side_by_side_farther_apart_than_their_world_is_wide(
    meshcat: Meshcat,
) -> None:
    scenario = Scenario.named("room/two_walls")
    motions = [room_motion(label) for label in ("plan", "rigid", "Drake")]
    recording = publish(motions, meshcat, World.from_scenario(scenario), scenario)
    for i in (1, 2, 3):
        _, places = clips(meshcat)[f"{ROOT}/motions/{i}/room/ball/ball_visual"]
        wall = position(meshcat, f"{ROOT}/worlds/{i}/room/right_wall/right_wall_visual")
        np.testing.assert_allclose(places[0], [0.2, 0.3, 0], atol=1e-12)
        # The wall's face is 0.02 m off the middle of the ball that touches it.
        assert wall[0] - 0.02 == pytest.approx(np.max(places[:, 0]) + 0.02)
    aside = np.array(recording.beside["aside"])
    apart = np.linalg.norm(aside[:, np.newaxis] - aside, axis=-1)
    # Of the room, the 0.34 m that the ball is in and 0.13 m below and above are seen.
    assert np.all(apart[~np.eye(3, dtype=bool)] > 0.6)


def test_a_page_is_written_whole_and_holds_all(
    meshcat: Meshcat, world: World, scenario: Scenario, tmp_path: Path
) -> None:
    recording = publish(MOTIONS, meshcat, world, scenario)
    recording.save(tmp_path / "play.html")
    page = (tmp_path / "play.html").read_text(encoding="utf-8")
    assert pack(meshcat.StaticHtml()) in page and 'type="range"' in page
    assert "<iframe srcdoc=" in recording._repr_html_()  # In a notebook.
    assert [path.name for path in tmp_path.iterdir()] == ["play.html"]
    with pytest.raises(OutputFileError, match=r"can't be written.*a folder that exists"):
        recording.save(tmp_path / "missing" / "play.html")


def test_a_port_in_use_is_refused() -> None:
    with socket.socket() as other:
        other.bind(("0.0.0.0", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(OptionsError, match=rf"port: got {port}, in use.*Name another port"):
            open_meshcat(port)
    assert open_meshcat(0).port() > 0


def test_a_plan_that_is_taken_later_is_not_there_before_and_events_flash(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    late = dataclasses.replace(MOTIONS[1], times=MOTIONS[1].times + 0.4)
    publish([MOTIONS[0], late], meshcat, world, scenario, events={0.4: "is kicked"})
    times, is_shown = clips(meshcat, "visible")[f"{ROOT}/motions/2"]
    assert [bool(is_shown[times <= time][-1]) for time in (0.0, 0.39, 0.41, 1.4)] == [0, 0, 1, 1]
    assert f"{ROOT}/motions/1" not in clips(meshcat, "visible")
    times, sizes = clips(meshcat, "scale")[f"{ROOT}/motions/1/events"]
    assert times[sizes[:, 0] > 2e-3] == pytest.approx([0.4])
    places = clips(meshcat)[ball(1)]
    there = places[1][np.argmin(np.abs(places[0] - 0.4)), 0]
    assert clips(meshcat)[f"{ROOT}/motions/1/events"][1][0, 0] == pytest.approx(there)


GOAL, SPEED, WALL = "goal x [m]", "speed x [m/s]", "wall nearer [m]"
BALL_PATH = f"{ROOT}/candidates/0/point_mass_and_wall/ball/ball_visual"


@pytest.fixture(scope="module")
def live() -> Iterator[Live]:
    live = Live(Scenario.named("table1/1"))
    live.open()
    wait_for(live, lambda: live.plan is not None)
    yield live
    live.stop()


def wait_for(live: Live, is_so: Callable[[], bool]) -> None:
    end = time.monotonic() + 120.0
    while not is_so():
        assert time.monotonic() < end, live.message
        live.look()
        time.sleep(0.005)


def drag(live: Live, slider: str, value: float) -> Plan:
    wait_for(live, lambda: not live.is_searching)
    before = live.plan
    live.meshcat.SetSliderValue(slider, value)
    wait_for(live, lambda: live.plan is not before)
    assert live.plan is not None
    return live.plan


def test_the_plan_follows_from_bounce_to_brake(live: Live) -> None:
    bounces = drag(live, SPEED, -1.8)
    assert len(bounces.best.contacts) == 1 and live.labels[0].endswith("touches wall")
    brakes = drag(live, SPEED, -0.3)
    assert brakes.scenario.initial_velocity[0] == pytest.approx(-0.3, abs=0.02)
    assert brakes.best.contacts == () and np.isfinite(live.latency)
    assert live.labels[0].startswith("plan: cost ") and "touches nothing" in live.labels[0]
    # No cost without what it is worth.
    assert live.labels[1].startswith("plan: simulated ") and live.labels[1].endswith(", energy -")
    assert re.fullmatch(r"plan: defect \de-\d\d, penetration 0 m", live.labels[2])
    assert BALL_PATH in objects(live.meshcat)


def test_a_plan_near_the_last_comes_first_and_the_whole_search_once_sliders_rest(
    live: Live,
) -> None:
    first = drag(live, GOAL, 0.62)
    assert live.is_searching and first.options is not None
    live.look()
    assert live.labels[-1] == "searching: a better plan may follow"
    wait_for(live, lambda: not live.is_searching)
    live.look()
    best = live.plan
    assert best is not None and best is not first and best.options != first.options
    assert best.scenario.goal_position == first.scenario.goal_position
    assert best.cost <= 1.001 * first.cost
    assert not any("searching" in label for label in live.labels)


@pytest.mark.slow
def test_another_question_ends_the_search_for_the_one_before() -> None:
    live = Live(Scenario.named("room/two_walls"))
    live.open()
    wait_for(live, lambda: live.plan is not None)
    weight = "control weight × 10^"
    drag(live, weight, 0.3)
    wait_for(live, lambda: live.is_searching)
    asked, seen = drag(live, weight, 0.0).scenario.control_weight, set[float]()

    def is_over() -> bool:
        assert live.plan is not None
        seen.add(live.plan.scenario.control_weight)
        return not live.is_searching

    wait_for(live, is_over)
    live.stop()
    assert seen == {asked} and asked == pytest.approx(live.planner.scenario.control_weight)


@pytest.mark.slow
def test_a_mechanism_s_first_plan_is_of_few_starts_beside_the_last_motion() -> None:
    live = Live(dataclasses.replace(Scenario.named("table1/1"), control_upper=[2.0]))
    live.open()
    wait_for(live, lambda: live.plan is not None)
    first = drag(live, GOAL, 0.7)
    live.stop()
    assert isinstance(first.options, PlanOptions)
    assert (first.options.starts, first.options.renewals, first.stats.searches < 20) == (1, 0, True)


def test_a_goal_inside_a_wall_is_told_and_the_plan_stands(live: Live) -> None:
    before = drag(live, GOAL, 0.7)
    live.meshcat.SetSliderValue(GOAL, -0.07)
    wait_for(live, lambda: bool(live.message))
    assert live.plan is before and live.message.startswith("goal_position is inside")
    assert live.labels[-1] == f"no plan: {live.message}"
    assert drag(live, GOAL, 0.5) is not before and live.message == ""


def test_a_kick_plans_on_from_where_the_motion_is_and_sliders_bring_it_back(live: Live) -> None:
    before = drag(live, GOAL, 0.6)
    live.kick()
    wait_for(live, lambda: live.plan is not before)
    kicked = live.plan
    assert kicked is not None and kicked.scenario.goal_position[0] == pytest.approx(0.6, abs=0.01)
    assert kicked.scenario.initial_velocity[0] != before.scenario.initial_velocity[0]
    assert (
        drag(live, GOAL, 0.65).scenario.initial_position[0] == before.scenario.initial_position[0]
    )


def test_a_wall_is_drawn_where_the_plan_has_it(live: Live) -> None:
    drag(live, SPEED, -1.8)
    drawn = f"{ROOT}/world/point_mass_and_wall/wall/wall_visual"
    before = position(live.meshcat, drawn)
    near = drag(live, WALL, 0.2)
    at = np.interp(
        near.best.contacts[0].time, near.trajectory.times, near.trajectory.positions[:, 0]
    )
    assert at == pytest.approx(live.meshcat.GetSliderValue(WALL), abs=1e-3)
    moved = position(live.meshcat, drawn) - before
    np.testing.assert_allclose(moved, [live.meshcat.GetSliderValue(WALL), 0, 0], atol=1e-12)
    assert near.find_world(live.planner.world).calc_signed_distance(np.array([0.2]))[0] < 0.01
    wait_for(live, lambda: not live.is_searching)
    assert live.plan is not None and live.plan.replayed().holds  # Drake's wall stands there, too.
    assert drag(live, WALL, 0.0).cost != near.cost


def test_weights_are_powers_of_ten_of_the_scenarios(live: Live) -> None:
    before = live.planner.scenario
    planned = drag(live, "control weight × 10^", 1.0).scenario
    assert planned.control_weight == pytest.approx(10 * before.control_weight)
    assert planned.goal_weight == before.goal_weight
    drag(live, "control weight × 10^", 0.0)


def test_a_scene_that_is_closed_or_has_no_port_says_so(in_background: Live) -> None:
    port = int(in_background.url.rpartition(":")[2])
    with pytest.raises(OptionsError, match=f"port: got {port}, in use"):
        Live(in_background.planner.scenario, port=port).start()
    in_background.stop()
    assert in_background._repr_html_() == "<p>The live scene is closed.</p>"
    with pytest.raises(OptionsError, match="live scene: got closed, expected a new `Live`"):
        in_background.start()
    assert "call start()" in Live(in_background.planner.scenario)._repr_html_()


def test_in_a_notebook_it_plays_in_the_background(in_background: Live) -> None:
    shown = in_background._repr_html_()
    assert (
        shown.startswith(f'<iframe src="{in_background.url}"') and "localhost" in in_background.url
    )


@pytest.fixture
def in_background() -> Iterator[Live]:
    live = Live(Scenario.named("table1/1")).start()
    yield live
    live.stop()


def test_bodies_that_float_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OptionsError, match="got bodies that float, expected coordinates that"):
        Live(make_scenario(tmp_path))
