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
from meshcat_pages import BALL, MOTIONS, ball, clips, messages, objects, position
from pydrake.geometry import Meshcat

from drake_aigto import Scenario, World
from drake_aigto.errors import OptionsError, OutputFileError
from drake_aigto.show import ROOT, Board, Motion, open_meshcat, pack, play, publish, save_html
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch

RADIUS = 0.05  # of the shipped ball [m]


@pytest.fixture(scope="module")
def meshcat() -> Meshcat:
    return Meshcat()


@pytest.fixture
def painted(monkeypatch: pytest.MonkeyPatch) -> list[Board]:
    """Returns the boards that are painted from now on."""
    boards: list[Board] = []
    paint = Board.paint

    def remember(board: Board) -> Figure:
        boards.append(board)
        return paint(board)

    monkeypatch.setattr(Board, "paint", remember)
    return boards


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
    heights = []
    for lane, motion in enumerate(MOTIONS, 1):
        times, places = recorded[ball(lane)]
        moving = times <= motion.times[-1]
        np.testing.assert_allclose(times[moving], motion.times, atol=0.5e-3)
        np.testing.assert_allclose(places[moving, 0], motion.positions[:, 0], atol=1e-12)
        np.testing.assert_allclose(places[~moving, 0], motion.positions[-1, 0], atol=1e-12)
        np.testing.assert_allclose(places[:, 1], 0, atol=1e-12)
        assert np.ptp(places[:, 2]) == 0
        heights.append(places[0, 2])
    # The first is the highest, none covers another, and the middle one is where its world is.
    assert np.all(np.diff(heights) <= -4 * RADIUS)
    assert heights[1] == pytest.approx(0)


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


def test_each_motion_has_a_wall_where_it_is_that_ends_out_of_sight(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    publish(MOTIONS, meshcat, world, scenario)
    walls = [path for path in objects(meshcat) if "wall_visual" in path]
    assert len(walls) == 3
    for lane, path in enumerate(walls, 1):
        # The visual wall is 0.08 m thick, and its face is at −0.05 m; of its 0.6 m a ball's height
        # beside the ball is seen.
        height = position(meshcat, ball(lane))[2]
        np.testing.assert_allclose(position(meshcat, path), [-0.09, 0, height], atol=1e-12)
        box = objects(meshcat)[path]["geometries"][0]
        sides = sorted(box[side] for side in ("width", "height", "depth"))
        assert sides == pytest.approx([0.08, 0.2, 0.2])
    np.testing.assert_allclose(position(meshcat, ball(2)), [1.0, 0, 0], atol=1e-12)
    # The board is behind the balls.
    assert RADIUS > position(meshcat, f"{ROOT}/board")[1] > 0.8 * RADIUS


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


def test_a_plan_is_played_beside_its_simulations_and_others(
    meshcat: Meshcat, world: World, painted: list[Board]
) -> None:
    play(make_plan(), meshcat)
    moving = set(clips(meshcat))
    assert {path for path in moving if path.endswith(BALL)} == {ball(lane) for lane in (1, 2, 3)}
    # The simulations are of the plan's control, so that they have its arrow.
    assert {path for path in moving if path.endswith("/arrow")} == {
        f"{ROOT}/motions/{lane}/control/point_mass_and_wall/ball/arrow" for lane in (1, 2, 3)
    }
    play(make_plan(), meshcat, world, beside=MOTIONS[:2])
    assert [panel.label for panel in painted[-1].panels] == [
        "AIGTO: plan (not a simulation)",
        "AIGTO: simulation: compliant (Drake)",
        "plan",
        "rigid",
    ]


def test_a_way_along_a_line_has_a_leg_beside_a_leg_from_impact_to_impact(
    meshcat: Meshcat, world: World, scenario: Scenario, painted: list[Board]
) -> None:
    bounce = dataclasses.replace(MOTIONS[0], impacts=(Touch.bounce(0.5),))
    publish([bounce], meshcat, world, scenario)
    ((way,),) = (panel.ways for panel in painted[-1].panels)
    turn = int(np.argmin(way[:, 0]))
    assert len(set(way[: turn + 1, 1])) == len(set(way[turn + 1 :, 1])) == 1
    assert way[0, 1] > way[-1, 1]
    assert np.all(way >= painted[-1].low) and np.all(way <= painted[-1].high)


def test_what_is_shown_is_explained(
    meshcat: Meshcat, world: World, scenario: Scenario, painted: list[Board]
) -> None:
    play(make_plan(), meshcat, world)
    assert painted[-1].notes == ["dots: every 0.05 s", "black arrow: control, up to 0.3 N"]
    bounce = dataclasses.replace(MOTIONS[0], impacts=(Touch.bounce(0.5),))
    publish([bounce], meshcat, world, scenario)
    assert painted[-1].notes == ["dots: every 0.05 s", "yellow flash: impact"]


@pytest.mark.parametrize("lanes", [1, 3, 6, 12])
def test_the_camera_sees_all_lanes(
    meshcat: Meshcat, world: World, scenario: Scenario, painted: list[Board], lanes: int
) -> None:
    publish([MOTIONS[0]] * lanes, meshcat, world, scenario)
    sent = list(messages(meshcat.StaticHtml()))
    (eye,) = (np.array(m["value"]) for m in sent if m.get("property") == "position")
    (target,) = (np.array(m["value"]) for m in sent if m["type"] == "set_target")
    camera = objects(meshcat)["/Cameras/default/rotated"]["object"]
    # In three.js y is up, and z towards the viewer.
    ahead = (target - eye) / np.linalg.norm(target - eye)
    up = np.array([0, 1, 0]) - ahead[1] * ahead
    low, high = painted[-1].corners
    for x, z in ((low[0], low[1]), (low[0], high[1]), (high[0], low[1]), (high[0], high[1])):
        ray = np.array([x, z, -RADIUS]) - eye
        rise = np.arctan(ray @ up / np.linalg.norm(up) / (ray @ ahead))
        turn = np.arctan(ray[0] / (ray @ ahead))
        assert abs(np.rad2deg(rise)) < camera["fov"] / 2
        assert abs(np.rad2deg(turn)) < 1.4 * camera["fov"] / 2
        assert camera["near"] < ray @ ahead < camera["far"]


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


def test_two_masses_have_two_goals(meshcat: Meshcat, painted: list[Board]) -> None:
    scenario = Scenario.named("two_masses/handed_on")
    q = np.array([scenario.initial_position, scenario.goal_position])
    motion = Motion("plan", np.array([0.0, 1.0]), q, np.zeros((2, 2)))
    publish([motion], meshcat, World.from_scenario(scenario), scenario)
    (board,) = painted
    assert board.names == ["left", "right"] and board.has_lanes
    # The right ball's middle is at q₂ + 1/8 m.
    np.testing.assert_allclose(board.starts[:, 0], [0.2, 0.625], atol=1e-12)
    np.testing.assert_allclose(board.goals[:, 0], [0.5, 1.025], atol=1e-12)


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


def test_a_plan_that_is_taken_later_is_not_there_before_and_events_flash(
    meshcat: Meshcat, world: World, scenario: Scenario
) -> None:
    late = dataclasses.replace(MOTIONS[1], times=MOTIONS[1].times + 0.4)
    publish([MOTIONS[0], late], meshcat, world, scenario, events=[0.4])
    times, is_shown = clips(meshcat, "visible")[f"{ROOT}/motions/2"]
    assert [bool(is_shown[times <= time][-1]) for time in (0.0, 0.39, 0.41, 1.4)] == [0, 0, 1, 1]
    assert f"{ROOT}/motions/1" not in clips(meshcat, "visible")
    times, sizes = clips(meshcat, "scale")[f"{ROOT}/motions/1/events"]
    assert times[sizes[:, 0] > 2e-3] == pytest.approx([0.4])
    places = clips(meshcat)[ball(1)]
    there = places[1][np.argmin(np.abs(places[0] - 0.4)), 0]
    assert clips(meshcat)[f"{ROOT}/motions/1/events"][1][0, 0] == pytest.approx(there)
