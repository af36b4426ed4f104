"""The track under bodies on a line: what is painted is where it belongs, and can be read."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.text import Text

from drake_aigto.show.motion import PALETTE
from drake_aigto.show.track import Track, wrap_notes


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
    node = gltf["nodes"][gltf["scenes"][0]["nodes"][0]]
    corners = positions.reshape(4, 3) * node["scale"] + node["translation"]
    x, up, towards_viewer = corners.T
    across, down = texture.reshape(4, 2).T
    side = track.half_width + track.margin
    np.testing.assert_allclose(x, track.start + track.length * across, atol=1e-6)
    np.testing.assert_allclose(-towards_viewer, side * (1 - 2 * down), atol=1e-6)
    np.testing.assert_array_equal(up, 0)
    assert sorted(set(triangles.tolist())) == [0, 1, 2, 3]


@pytest.mark.parametrize("end", [1.0, 0.0])
def test_all_that_is_written_fits_on_the_track(end: float) -> None:
    labels = ["SNOPT from a random guess: plan (not a simulation)", "simulation: compliant"]
    marks = {"start": end, "goal": end}
    notes = ["dots: every 0.05 s", "arrow: control, up to 0.4 N", "yellow flash: impact"]
    track = Track(labels, start=-0.05, end=1.05, lane_width=0.2, marks=marks, notes=notes)
    figure = track.paint()
    (axes,) = figure.axes
    for text in axes.texts:
        box = text.get_window_extent().transformed(axes.transData.inverted())
        assert box.x0 >= -0.05 and box.x1 <= 1.05, text
        assert abs(box.y0) <= track.half_width + track.margin >= abs(box.y1)


def test_a_trace_has_a_leg_beside_a_leg_from_impact_to_impact() -> None:
    legs = [np.array([1.0, 0.5, 0.0]), np.array([0.0, 0.4])]
    track = Track(["plan", "rigid"], -0.05, 1.05, 0.2, marks={}, traces=[[], [legs]])
    (axes,) = track.paint().axes
    (dots,) = (line for line in axes.lines if line.get_marker() == "o")
    x, y = np.asarray(dots.get_xydata()).T
    np.testing.assert_array_equal(x, [1.0, 0.5, 0.0, 0.0, 0.4])
    assert len(set(y[:3])) == len(set(y[3:])) == 1 and y[3] < y[0]
    assert np.all(np.abs(y - track.lane_center(1)) < 0.1)


def test_notes_are_broken_between_notes() -> None:
    notes = ["dots: every 0.05 s", "arrow: control", "yellow flash: impact"]
    assert wrap_notes(notes, 40) == ["dots: every 0.05 s; arrow: control", "yellow flash: impact"]
    assert wrap_notes(notes, 100) == ["; ".join(notes)]
    assert wrap_notes([], 40) == []
