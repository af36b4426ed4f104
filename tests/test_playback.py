"""Playback shows motions beside each other as they are, in what Meshcat sends to a browser."""

from __future__ import annotations

import base64
import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgpack
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Text
from pydrake.geometry import Meshcat

from drake_aigto import OutputFileError, Scenario, World
from drake_aigto.show.board import Board
from drake_aigto.show.motion import PALETTE, Motion
from drake_aigto.show.playback import ROOT, play, publish, save_html
from drake_aigto.show.stage import Stage
from drake_aigto.show.track import Track
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch
from drake_aigto.world.files import models_directory

RADIUS = 0.05  # of the shipped ball [m]
BALL = "point_mass_and_wall/ball/ball_visual"
WALL = f"{ROOT}/world/point_mass_and_wall/wall/wall_visual"

AXIS, FACE = "<xyz>1 0 0</xyz>", "<pose>-0.05 0 0 0 0 0</pose>"
# Where the joint points → how the shipped SDF changes, and T's axes then.
DIRECTIONS: dict[str, tuple[dict[str, str], list[list[float]]]] = {
    "as shipped": ({}, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    "against x": (
        {AXIS: "<xyz>-1 0 0</xyz>", FACE: "<pose>0.05 0 0 0 0 3.141592653589793</pose>"},
        [[-1, 0, 0], [0, -1, 0], [0, 0, 1]],
    ),
}


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return Meshcat()


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.named("table1/1")


@pytest.fixture(scope="module")
def world(scenario: Scenario) -> World:
    return World.from_scenario(scenario)


def make_motion(label: str, end: float, duration: float = 1.0) -> Motion:
    """Returns a motion from 1 m to the wall and on to an end, at two speeds."""
    times = np.linspace(0, duration, 21)
    q = np.interp(times, [0, duration / 2, duration], [1.0, 0.0, end])[:, np.newaxis]
    return Motion(label, times, q, np.gradient(q[:, 0], times)[:, np.newaxis])


MOTIONS = [make_motion("plan", 0.73), make_motion("rigid", 0.6), make_motion("Drake", 0.5, 0.8)]


def messages(html: str) -> Iterator[dict[str, Any]]:
    """Yields what a page of Meshcat's shows, message by message."""
    for text in re.findall(r'fetch\("data:application/octet-binary;base64,([^"]+)"\)', html):
        yield msgpack.unpackb(base64.b64decode(text), strict_map_key=False)


def objects(meshcat: Meshcat) -> dict[str, Any]:
    """Returns the objects that are shown, by path."""
    sent = list(messages(meshcat.StaticHtml()))
    return {m["path"]: m["object"] for m in sent if m["type"] == "set_object"}


def position(meshcat: Meshcat, path: str) -> np.ndarray:
    """Returns where an object stands when nothing is played."""
    sent = list(messages(meshcat.StaticHtml()))
    (matrix,) = (m["matrix"] for m in sent if m["type"] == "set_transform" and m["path"] == path)
    return np.array(matrix).reshape(4, 4).T[:3, 3]


def recording(meshcat: Meshcat) -> dict[str, Any]:
    """Returns the recording's one message."""
    (message,) = (m for m in messages(meshcat.StaticHtml()) if m["type"] == "set_animation")
    return message


def clips(meshcat: Meshcat) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Returns the times (F,) [s] and positions (F, 3) [m] of every path that is recorded."""
    result = {}
    for animation in recording(meshcat)["animations"]:
        (track,) = (t for t in animation["clip"]["tracks"] if t["name"] == ".position")
        frames = np.array([key["time"] for key in track["keys"]])
        values = np.array([key["value"] for key in track["keys"]])
        result[animation["path"]] = (frames / animation["clip"]["fps"], values)
    return result


def ball(lane: int) -> str:
    """Returns the ball's path in a lane, counted from 1."""
    return f"{ROOT}/motions/{lane}/{BALL}"


def test_each_motion_plays_at_real_speed_in_its_own_lane(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    publish(MOTIONS, meshcat, world, scenario)
    recorded = clips(meshcat)
    assert set(recorded) == {ball(lane) for lane in (1, 2, 3)}
    sides = []
    for lane, motion in enumerate(MOTIONS, 1):
        times, places = recorded[ball(lane)]
        moving = times <= motion.times[-1]
        np.testing.assert_allclose(times[moving], motion.times, atol=0.5e-3)
        np.testing.assert_allclose(places[moving, 0], motion.positions[:, 0], atol=1e-12)
        np.testing.assert_allclose(places[~moving, 0], motion.positions[-1, 0], atol=1e-12)
        np.testing.assert_allclose(places[:, 2], 0, atol=1e-12)
        assert np.ptp(places[:, 1]) == 0
        sides.append(places[0, 1])
    # The first is the farthest, none covers another, and the middle one is where the wall is.
    assert np.all(np.diff(sides) <= -2 * RADIUS)
    assert sides[1] == pytest.approx(0)


def test_all_motions_repeat_together(meshcat: Meshcat, world: World, scenario: Scenario) -> None:
    publish(MOTIONS, meshcat, world, scenario)
    ends = {times[-1] for times, _ in clips(meshcat).values()}
    assert ends == {1.5}
    loop_repeat = 2201  # three.js
    options = recording(meshcat)["options"]
    assert options["play"] and options["loopMode"] == loop_repeat and options["repetitions"] > 1000


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


def test_what_does_not_move_is_shown_once_where_it_is(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    publish(MOTIONS, meshcat, world, scenario)
    assert [path for path in objects(meshcat) if "wall_visual" in path] == [WALL]
    # The visual wall is 0.08 m thick, and its face is at −0.05 m.
    np.testing.assert_allclose(position(meshcat, WALL), [-0.09, 0, 0])
    np.testing.assert_allclose(position(meshcat, ball(2)), [1.0, 0, 0], atol=1e-12)
    # The balls roll on the track.
    np.testing.assert_allclose(position(meshcat, f"{ROOT}/track"), [0, 0, -RADIUS], atol=1e-12)


def test_lanes_have_the_colors_of_figures(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    publish(MOTIONS, meshcat, world, scenario)
    shown = objects(meshcat)
    colors = [shown[ball(lane)]["materials"][0]["color"] for lane in (1, 2, 3)]
    assert colors == [0x0072B2, 0xD55E00, 0x009E73]


def test_publishing_again_replaces_what_was_shown(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    publish(MOTIONS, meshcat, world, scenario)
    publish(MOTIONS[:1], meshcat, world, scenario)
    assert set(clips(meshcat)) == {ball(1)}
    assert ball(1) in objects(meshcat) and ball(2) not in objects(meshcat)


def test_a_plan_is_played_beside_its_simulations(meshcat: Meshcat, world: World) -> None:
    rows = {
        "times": np.array([0.0, 1.0]),
        "positions": np.array([[1.0], [0.5]]),
        "velocities": np.array([[-0.5], [-0.5]]),
    }
    held = np.zeros((1, 1))
    trajectory = Trajectory(**rows, controls=held, impulses=np.zeros((2, 1)), forces=held)
    replay = SimpleNamespace(simulator="drake", **rows)
    scenario = Scenario.named("table1/1")
    plan: Any = SimpleNamespace(trajectory=trajectory, replay=[replay], scenario=scenario)
    play(plan, meshcat, world)
    assert set(clips(meshcat)) == {ball(1), ball(2)}


@pytest.mark.parametrize("name", DIRECTIONS)
def test_the_track_follows_the_joint_and_counts_its_positions(name: str, tmp_path: Path) -> None:
    text = (models_directory() / "point_mass_and_wall.sdf").read_text(encoding="utf-8")
    replacements, axes = DIRECTIONS[name]
    for old, new in replacements.items():
        assert old in text
        text = text.replace(old, new)
    model = tmp_path / "turned.sdf"
    model.write_text(text, encoding="utf-8")
    ends: dict[str, Any] = {"initial_position": 1.0, "initial_velocity": 0.0, "goal_position": 0.7}
    stage = Stage(World.from_scenario(Scenario(model=str(model), **ends)), np.array([[1.0], [0.7]]))
    np.testing.assert_allclose(stage.X_WT.rotation().matrix().T, axes, atol=1e-12)
    ((wall, side),) = stage.walls()
    assert stage.is_line and (wall, side) == pytest.approx((0, 1))
    assert stage.places(stage.movers[0], np.array([[0.3]]))[0, 0] == pytest.approx(0.3)
    assert (stage.lowest, stage.highest) == pytest.approx((0.7, 1.0))


@pytest.mark.parametrize("lanes", [1, 3, 6, 12])
def test_the_camera_sees_all_lanes(
    meshcat: Meshcat, world: World, scenario: Scenario, lanes: int
) -> None:
    publish([MOTIONS[0]] * lanes, meshcat, world, scenario)
    sent = list(messages(meshcat.StaticHtml()))
    (eye,) = (np.array(m["value"]) for m in sent if m.get("property") == "position")
    (target,) = (np.array(m["value"]) for m in sent if m["type"] == "set_target")
    camera = objects(meshcat)["/Cameras/default/rotated"]["object"]
    # In three.js y is up, and z towards the viewer.
    ahead = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0, 1, 0]) - ahead[1] * ahead
    outer = (lanes / 2 + 0.7) * 4 * RADIUS  # The strip with the scale is 0.7 lanes wide.
    for side in (-outer, outer):
        ray = target + np.array([0, 0, side]) - eye
        rise = np.arctan(ray @ up / np.linalg.norm(up) / (ray @ ahead))
        assert abs(np.rad2deg(rise)) < camera["fov"] / 2
        assert ray @ ahead < camera["far"]


# World → which of T's axes are which of the world's.
PLANES = {
    "room/two_walls": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],  # from above
    "floor/rebound": [[1, 0, 0], [0, 0, 1], [0, -1, 0]],  # from the front
}


@pytest.mark.parametrize("name", PLANES)
def test_a_plane_is_looked_at_with_its_way_up(name: str) -> None:
    scenario = Scenario.named(name)
    stage = Stage(World.from_scenario(scenario), np.array([scenario.initial_position]))
    assert not stage.is_line
    np.testing.assert_allclose(stage.X_WT.rotation().matrix().T, PLANES[name], atol=1e-12)
    height = stage.places(stage.movers[0], np.array([scenario.goal_position]))[0, :2]
    np.testing.assert_allclose(height[-scenario.goal_position.size :], scenario.goal_position)


def room_motion(label: str) -> Motion:
    """Returns a motion in a room, off its right wall."""
    q = np.array([[0.2, 0.3], [1.0, 0.5], [1.0, 0.5], [0.8, 0.6]])
    times = np.array([0.0, 0.6, 0.6, 1.0])
    return Motion(label, times, q, np.zeros((4, 2)), touches=(Touch.bounce(0.6, 1),))


def test_each_motion_in_a_plane_has_a_world_of_its_own(meshcat: Meshcat) -> None:
    scenario = Scenario.named("room/two_walls")
    motions = [room_motion(label) for label in ("plan", "rigid", "Drake")]
    publish(motions, meshcat, World.from_scenario(scenario), scenario)
    recorded = clips(meshcat)
    asides = []
    for i, motion in enumerate(motions, 1):
        _, places = recorded[f"{ROOT}/motions/{i}/room/ball/ball_visual"]
        wall = position(meshcat, f"{ROOT}/worlds/{i}/room/right_wall/right_wall_visual")
        aside = places[0, 0] - 0.2
        asides.append(aside)
        np.testing.assert_allclose(places[0], [0.2 + aside, 0.3, 0], atol=1e-12)
        # The wall's face is 0.02 m off the middle of the ball that touches it.
        assert wall[0] - 0.02 == pytest.approx(np.max(places[:, 0]) + 0.02)
        assert np.ptp(places[:, 0] - aside) == pytest.approx(np.ptp(motion.positions[:, 0]))
    assert asides[1] == pytest.approx(0)
    assert np.all(np.diff(asides) > 1.12)  # The room is as wide with its walls.


def test_two_masses_have_two_goals(meshcat: Meshcat, monkeypatch: pytest.MonkeyPatch) -> None:
    marks: list[Any] = []
    paint = Track.paint

    def remember(track: Track) -> Figure:
        marks.append(track.marks)
        return paint(track)

    monkeypatch.setattr(Track, "paint", remember)
    scenario = Scenario.named("two_masses/handed_on")
    q = np.array([scenario.initial_position, scenario.goal_position])
    motion = Motion("plan", np.array([0.0, 1.0]), q, np.zeros((2, 2)))
    publish([motion], meshcat, World.from_scenario(scenario), scenario)
    # The right ball's middle is at q₂ + 1/8 m.
    expected = {"left start": 0.2, "right start": 0.625, "left goal": 0.5, "right goal": 1.025}
    assert marks[0] == pytest.approx(expected)
    assert {path.split("/")[-1] for path in clips(meshcat)} == {
        "left_ball_visual",
        "right_ball_visual",
    }


def make_board() -> Board:
    """Returns a board of two rooms, with a bounce in the first."""
    corner, ways = np.zeros(2), [[np.array([[0.2, 0.3], [1.0, 0.5], [0.8, 0.6]])]] * 2
    return Board(
        labels=["plan (not a simulation)", "simulation: compliant (Drake)"],
        low=corner,
        high=corner + 1,
        depth=0.1,
        radius=0.02,
        starts=np.array([[0.2, 0.3]]),
        goals=np.array([[0.8, 0.6]]),
        ways=ways,
        touches=[np.array([[1.0, 0.5]] * 2), np.empty((0, 2))],
        touch_names=[["right wall, 0.60 s", "right wall, 0.61 s"], []],
    )


def test_a_board_has_the_way_and_the_marks_of_each_panel() -> None:
    board = make_board()
    (axes,) = board.paint().axes
    for i in range(2):
        aside = board.offset(i)[:2]
        drawn = [np.asarray(line.get_xydata()) for line in axes.lines]
        for expected in (board.ways[i][0], board.starts, board.goals):
            found = [line for line in drawn if line.shape == expected.shape]
            assert any(np.allclose(line, expected + aside) for line in found)
    circles = [line.get_xydata() for line in axes.lines if line.get_marker() == "o"]
    assert [len(np.asarray(each)) for each in circles] == [2, 0]
    written = [text.get_text() for text in axes.texts]
    assert {"plan\n(not a simulation)", "simulation:\ncompliant (Drake)"} <= set(written)
    # Names of touches at one place would cover each other.
    assert "right wall, 0.60 s" in written and "right wall, 0.61 s" not in written
    assert written.count("start") == written.count("goal") == written.count("0.5 m") == 2


@pytest.mark.parametrize("goal", [[0.8, 0.7], [0.2, 0.3], [0.2, 0.32], [0.22, 0.28]])
def test_all_that_is_written_fits_on_the_board(goal: list[float]) -> None:
    board = dataclasses.replace(make_board(), goals=np.array([goal]), low=np.array([-1.0, 0.0]))
    figure = board.paint()
    (axes,) = figure.axes
    low, high = board.corners
    for text in axes.texts:
        box = text.get_window_extent().transformed(axes.transData.inverted())
        assert np.all(box.min >= low) and np.all(box.max <= high), text
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_shapes_for_contact_are_shown_where_none_are_for_show(tmp_path: Path) -> None:
    text = (models_directory() / "point_mass_and_wall.sdf").read_text(encoding="utf-8")
    bare = re.sub(r"<visual.*?</visual>", "", text, flags=re.DOTALL)
    plane = re.sub(
        r"<box>.*?</box>", "<plane><normal>1 0 0</normal></plane>", bare, flags=re.DOTALL
    )
    model = tmp_path / "bare.sdf"
    model.write_text(plane.replace("<pose>-8 0 0 0 0 0</pose>", ""), encoding="utf-8")
    ends: dict[str, Any] = {"initial_position": 1.0, "initial_velocity": 0.0, "goal_position": 0.7}
    stage = Stage(World.from_scenario(Scenario(model=str(model), **ends)), np.array([[1.0]]))
    ball, wall = sorted(stage.actors, key=lambda actor: actor.name)
    assert (ball.moves, wall.moves) == (True, False)
    # Of a half space, a slab whose face is the plane's.
    face = stage.pose(wall, np.array([1.0])).multiply([0, 0, wall.shape.height() / 2])
    np.testing.assert_allclose(face, [-0.05, 0, 0], atol=1e-12)


def texts(track: Track) -> dict[str, Text]:
    """Returns what is written on a track."""
    (axes,) = track.paint().axes
    return {text.get_text(): text for text in axes.texts}


def test_lanes_are_labelled_in_order_and_ends_are_marked() -> None:
    labels = ["plan (not a simulation)", "simulation: compliant (Drake)"]
    track = Track(labels, start=-0.05, end=1.1, lane_width=0.2, marks={"start": 1.0, "goal": 0.73})
    written = texts(track)
    for lane, label in enumerate(labels):
        low = track.lane_center(lane) - 0.1
        assert low < written[label].get_position()[1] < low + 0.2
    assert written["start"].get_position()[0] == 1.0
    assert written["goal"].get_position()[0] == 0.73
    assert written["0.4 m"].get_position()[0] == pytest.approx(0.4)
    assert "0 m" in written and "1 m" in written


def luminance(color: Any) -> float:
    """Returns WCAG's relative luminance."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_labels_can_be_read_on_every_lane() -> None:
    lanes = [f"lane {i}" for i in range(len(PALETTE))]
    track = Track(lanes, start=0, end=1, lane_width=0.2, marks={})
    written = texts(track)
    (axes,) = track.paint().axes
    for label, strip in zip(lanes, axes.patches, strict=True):
        dark, light = luminance(written[label].get_color()), luminance(strip.get_facecolor())
        assert (light + 0.05) / (dark + 0.05) > 4.5, label  # WCAG's least contrast of text


def test_names_of_marks_do_not_overlap() -> None:
    marks = {"left start": 0.5, "left goal": 0.52, "right start": 0.6, "right goal": 0.9}
    track = Track(["plan"], start=0, end=1.2, lane_width=0.2, marks=marks)
    figure = track.paint()
    (axes,) = figure.axes
    boxes = [text.get_window_extent() for text in axes.texts if text.get_text() in marks]
    assert len(boxes) == 4
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    top = max(box.transformed(axes.transData.inverted()).y1 for box in boxes)
    assert top <= track.half_width + track.margin


def test_the_top_of_the_picture_is_the_far_side_of_the_track() -> None:
    track = Track(["plan"], start=-0.1, end=1.0, lane_width=0.2, marks={})
    gltf = json.loads(track.mesh().source().in_memory().mesh_file.contents())
    buffer = base64.b64decode(gltf["buffers"][0]["uri"].split(",")[1])
    positions, texture, triangles = (
        np.frombuffer(buffer, kind, count, view["byteOffset"])
        for kind, count, view in zip(
            (np.float32, np.float32, np.uint16), (12, 8, 6), gltf["bufferViews"], strict=True
        )
    )
    x, up, towards_viewer = positions.reshape(4, 3).T
    across, down = texture.reshape(4, 2).T
    side = track.half_width + track.margin
    np.testing.assert_allclose(x, track.start + track.length * across, atol=1e-6)
    np.testing.assert_allclose(-towards_viewer, side * (1 - 2 * down), atol=1e-6)
    np.testing.assert_array_equal(up, 0)
    assert sorted(set(triangles.tolist())) == [0, 1, 2, 3]


@pytest.mark.parametrize("end", [1.0, 0.0])
def test_all_that_is_written_fits_on_the_track(end: float) -> None:
    labels = ["plan (not a simulation)", "simulation: compliant (Drake)"]
    marks = {"start": end, "goal": end}
    track = Track(labels, start=-0.05, end=1.05, lane_width=0.2, marks=marks)
    figure = track.paint()
    (axes,) = figure.axes
    for text in axes.texts:
        box = text.get_window_extent().transformed(axes.transData.inverted())
        assert box.x0 >= -0.05 and box.x1 <= 1.05, text
        assert abs(box.y0) <= track.half_width + track.margin >= abs(box.y1)


def test_a_page_is_written_whole_and_holds_all(
    meshcat: Meshcat, world: World, scenario: Scenario, tmp_path: Path
) -> None:
    publish(MOTIONS, meshcat, world, scenario)
    save_html(meshcat, tmp_path / "play.html")
    assert (tmp_path / "play.html").read_text(encoding="utf-8") == meshcat.StaticHtml()
    assert [path.name for path in tmp_path.iterdir()] == ["play.html"]


def test_a_page_in_a_missing_folder_is_refused(meshcat: Meshcat, tmp_path: Path) -> None:
    with pytest.raises(OutputFileError, match=r"can't be written.*a folder that exists"):
        save_html(meshcat, tmp_path / "missing" / "play.html")
