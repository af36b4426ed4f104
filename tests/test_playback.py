"""Playback shows motions beside each other as they are, in what Meshcat sends to a browser."""

from __future__ import annotations

import dataclasses
import socket
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from meshcat_pages import BALL, MOTIONS, ball, clips, messages, objects, position, recording
from pydrake.geometry import Meshcat

from drake_aigto import OptionsError, OutputFileError, Scenario, World
from drake_aigto.show.motion import Motion
from drake_aigto.show.page import pack
from drake_aigto.show.playback import open_meshcat, play, publish, save_html
from drake_aigto.show.scene import ROOT
from drake_aigto.show.track import Track
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch

RADIUS = 0.05  # of the shipped ball [m]
WALL = f"{ROOT}/world/point_mass_and_wall/wall/wall_visual"


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return Meshcat()


@pytest.fixture
def painted(monkeypatch: pytest.MonkeyPatch) -> list[Track]:
    """Returns the tracks that are painted from now on."""
    tracks: list[Track] = []
    paint = Track.paint

    def remember(track: Track) -> Figure:
        tracks.append(track)
        return paint(track)

    monkeypatch.setattr(Track, "paint", remember)
    return tracks


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario.named("table1/1")


@pytest.fixture(scope="module")
def world(scenario: Scenario) -> World:
    return World.from_scenario(scenario)


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


def paths_of(meshcat: Meshcat, name: str) -> set[str]:
    """Returns what moves and has this name at the end of its path."""
    return {path for path in clips(meshcat) if path.endswith(name)}


def test_a_plan_is_played_beside_its_simulations(meshcat: Meshcat) -> None:
    play(make_plan(), meshcat)
    assert paths_of(meshcat, BALL) == {ball(lane) for lane in (1, 2, 3)}
    # The simulations are of the plan's control, so that they have its arrow.
    assert paths_of(meshcat, "/control") == {f"{ball(lane)}/control" for lane in (1, 2, 3)}


def test_a_plan_is_played_beside_others(
    meshcat: Meshcat, world: World, painted: list[Track]
) -> None:
    play(make_plan(), meshcat, world, beside=MOTIONS[:2])
    assert paths_of(meshcat, BALL) == {ball(lane) for lane in (1, 2, 3, 4)}
    assert painted[-1].labels == [
        "AIGTO: plan (not a simulation)",
        "AIGTO: simulation: compliant (Drake)",
        "plan",
        "rigid",
    ]


def test_what_is_shown_is_explained(
    meshcat: Meshcat, world: World, scenario: Scenario, painted: list[Track]
) -> None:
    play(make_plan(), meshcat, world)
    assert painted[-1].notes == ["dots: every 0.05 s", "arrow: control, up to 0.3 N"]
    bounce = dataclasses.replace(MOTIONS[0], impacts=(Touch.bounce(0.5),))
    publish([bounce], meshcat, world, scenario)
    assert painted[-1].notes == ["dots: every 0.05 s", "yellow flash: impact"]


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
    outer = (lanes / 2 + 0.7 + 0.24) * 4 * RADIUS  # A strip has the scale, and a line of notes.
    for side in (-outer, outer):
        ray = target + np.array([0, 0, side]) - eye
        rise = np.arctan(ray @ up / np.linalg.norm(up) / (ray @ ahead))
        assert abs(np.rad2deg(rise)) < camera["fov"] / 2
        assert ray @ ahead < camera["far"]


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


def test_two_masses_have_two_goals(meshcat: Meshcat, painted: list[Track]) -> None:
    scenario = Scenario.named("two_masses/handed_on")
    q = np.array([scenario.initial_position, scenario.goal_position])
    motion = Motion("plan", np.array([0.0, 1.0]), q, np.zeros((2, 2)))
    publish([motion], meshcat, World.from_scenario(scenario), scenario)
    # The right ball's middle is at q₂ + 1/8 m.
    expected = {"left start": 0.2, "right start": 0.625, "left goal": 0.5, "right goal": 1.025}
    assert painted[-1].marks == pytest.approx(expected)
    assert {path.split("/")[-1] for path in clips(meshcat)} == {
        "left_ball_visual",
        "right_ball_visual",
    }


def test_a_page_is_written_whole_and_holds_all(
    meshcat: Meshcat, world: World, scenario: Scenario, tmp_path: Path
) -> None:
    publish(MOTIONS, meshcat, world, scenario)
    save_html(meshcat, tmp_path / "play.html")
    page = (tmp_path / "play.html").read_text(encoding="utf-8")
    assert pack(meshcat.StaticHtml()) in page and 'type="range"' in page
    assert [path.name for path in tmp_path.iterdir()] == ["play.html"]


def test_a_page_in_a_missing_folder_is_refused(meshcat: Meshcat, tmp_path: Path) -> None:
    with pytest.raises(OutputFileError, match=r"can't be written.*a folder that exists"):
        save_html(meshcat, tmp_path / "missing" / "play.html")


def test_a_port_in_use_is_refused() -> None:
    with socket.socket() as other:
        other.bind(("0.0.0.0", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(OptionsError, match=rf"port: got {port}, in use.*Name another port"):
            open_meshcat(port)
    assert open_meshcat(0).port() > 0
