"""Every shipped plan in the page's player: motions fill the view, and no text covers another."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Page as Tab
from browser import find_chromium, start_browser
from meshcat_pages import messages

from drake_aigto import Planner, Scenario, World
from drake_aigto.show import Motion, Page, Stage, open_meshcat, publish
from drake_aigto.transcription import Touch
from drake_aigto.world import scenario_names

pytestmark = [pytest.mark.slow, pytest.mark.skipif(find_chromium() is None, reason="no Chromium")]

MOTIONS = json.loads(Path(__file__).with_name("shipped_motions.json").read_text("utf-8"))
VIEWER = """<script>
const nothing = () => {}, vector = { set: nothing };
const node = { object: { position: vector, updateMatrix: nothing, visible: true } };
window.viewer = {
  animator: { duration: %f, time: 0, playing: false, actions: [] },
  camera: { get aspect() { return innerWidth / innerHeight; }, zoom: 1 },
  scene_tree: { find: () => node },
};
for (const each of ["play", "pause", "seek", "display_progress"]) viewer.animator[each] = nothing;
for (const each of ["set_property", "set_3d_pane_size", "set_dirty"]) viewer[each] = nothing;
viewer.camera.updateProjectionMatrix = nothing;
</script>"""
CAMERA = "document.querySelector('#player-frame').contentWindow.viewer.camera"
NEXT = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
# Each line of text (nodes of kind 4) in the player with its rectangle, at five times of the motion.
READ = f"""(async () => {{
  const slider = document.querySelector('#player-slider'), seen = [];
  for (const part of [0, 0.25, 0.5, 0.75, 1]) {{
    slider.value = part * slider.max;
    slider.dispatchEvent(new Event('input'));
    await {NEXT};
    const texts = document.createTreeWalker(document.querySelector('.player'), 4);
    const range = document.createRange();
    while (texts.nextNode()) {{
      range.selectNodeContents(texts.currentNode);
      const text = texts.currentNode.textContent.trim();
      for (const {{ left, right, top, bottom }} of text ? range.getClientRects() : [])
        if (right > left) seen.push([part, text, left, right, top, bottom]);
    }}
  }}
  return seen;
}})()"""


def read_motion(name: str, world: World) -> Motion:
    told = MOTIONS[name]
    times, states = np.array(told["times"]), np.array(told["states"])
    motion = Motion.from_path("plan", world, times, states)
    touches = tuple(Touch(*touch) for touch in told["touches"])
    driven = motion.under(np.array(told["control_times"]), np.array(told["controls"]))
    return dataclasses.replace(driven, touches=touches, impacts=touches)


def project(places: np.ndarray, html: str, zoom: float, aspect: float) -> np.ndarray:
    """Returns where places (k, 3) are seen in a window from −1 to 1, shape (k, 2)."""
    sent = list(messages(html))
    (fov,) = (m["object"]["object"]["fov"] for m in sent if "Camera" in str(m.get("object")))
    (target,) = (m["value"] for m in sent if m["type"] == "set_target")
    (eye,) = (m["value"] for m in sent if m.get("property") == "position")
    back = np.subtract(eye, target)
    right = np.cross([0.0, 1.0, 0.0], back)
    axes = np.array([axis / np.linalg.norm(axis) for axis in (right, np.cross(back, right), back)])
    x, y, z = axes @ (places[:, [0, 2, 1]] * [1, 1, -1] - eye).T  # three.js has y up.
    scale = zoom / np.tan(np.deg2rad(fov) / 2) / -z
    return np.column_stack([scale * x / aspect, scale * y])


def find_covered(lines: list[list[Any]], width: int) -> Iterator[str]:
    """Yields the texts that leave a window, or that cover another one at the same time."""
    for _, text, _, right, *_ in lines:
        if right > width:
            yield text
    for (time, text, *one), (time_2, _, *other) in combinations(lines, 2):
        (left, right, top, bottom), (left_2, right_2, top_2, bottom_2) = one, other
        across = min(right, right_2) - max(left, left_2)
        down = min(bottom, bottom_2) - max(top, top_2)
        if time == time_2 and across > 1 and down > 3:  # Boxes are higher than letters.
            yield text


@pytest.fixture
def tab(tmp_path: Path) -> Iterator[Tab]:
    with start_browser(tmp_path / "profile") as tab:
        yield tab


def test_what_moves_fills_the_view_and_no_text_covers_another(tab: Tab, tmp_path: Path) -> None:
    scenes, corners, pages = {}, {}, {}
    for name in scenario_names():
        planner = Planner(Scenario.named(name))  # Its scenario has numbers in place of names.
        motion = read_motion(name, planner.world)
        ghost = dataclasses.replace(motion, label="simulation: compliant (Drake)")
        stage = Stage(planner.world, motion.positions)
        shapes = [actor for actor in stage.actors if actor.moves]
        places = [
            stage.pose(a, q).multiply(a.corners.T).T for a in shapes for q in motion.positions
        ]
        recording = publish([motion, ghost], open_meshcat(0), planner.world, planner.scenario)
        pages[name], beside = recording.scene
        corners[name] = np.vstack(places)
        scenes[name] = VIEWER % (planner.scenario.duration + 0.5), beside
    page = Page("Scenes")
    page.scenes(scenes)
    (tmp_path / "scenes.html").write_text(page.to_html(), encoding="utf-8")
    tab.open(tmp_path / "scenes.html", 1280, 800)
    for number, name in enumerate(scenes):
        tab.evaluate(f"document.querySelector('[data-scene=\"{number}\"]').click()")
        tab.wait_for("!document.querySelector('#player-slider').disabled")
        for width in (1280, 390):
            size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
            tab.call("Emulation.setDeviceMetricsOverride", **size)
            tab.evaluate(f"{NEXT}.then(() => 0)")
            zoom, aspect = tab.evaluate(f"[{CAMERA}.zoom, {CAMERA}.aspect]")
            seen = project(corners[name], pages[name], zoom, aspect)
            assert np.max(np.ptp(seen, axis=0)) / 2 >= 0.6, (name, width)
            assert np.max(np.abs(seen)) < 1.05, (name, width)  # Of boxes around what is round.
            assert not list(find_covered(tab.evaluate(READ), width)), (name, width)
    assert not tab.complaints
