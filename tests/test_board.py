"""The board behind bodies in a plane: what is painted is where it belongs, and can be read."""

from __future__ import annotations

import base64
import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb

from drake_aigto.show import PALETTE, Board, Panel, wrap_notes


def make_board() -> Board:
    """Returns a board of two rooms, with a bounce in the first."""
    corner, ways = np.zeros(2), [np.array([[0.2, 0.3], [1.0, 0.5], [0.8, 0.6]])]
    dots = np.array([[0.2, 0.3], [0.6, 0.4], [0.8, 0.6], [0.7, 0.5]])
    touches, none = np.array([[1.0, 0.5]] * 2), np.empty((0, 2))
    names = ["right wall, 0.60 s", "right wall, 0.61 s"]
    return Board(
        panels=[
            Panel("plan (not a simulation)", ways, dots, touches, names),
            Panel("simulation: compliant (Drake)", ways, dots, none, []),
        ],
        low=corner,
        high=corner + 1,
        depth=0.1,
        radius=0.02,
        names=[""],
        starts=np.array([[0.2, 0.3]]),
        goals=np.array([[0.8, 0.6]]),
        notes=[],
        columns=2,
        has_lanes=False,
    )


def test_a_board_has_the_way_and_the_marks_of_each_panel() -> None:
    board = make_board()
    (axes,) = board.paint().axes
    for i in range(2):
        aside = board.offset(i)[:2]
        drawn = [np.asarray(line.get_xydata()) for line in axes.lines]
        panel = board.panels[i]
        for expected in (panel.ways[0], panel.dots, board.starts, board.goals):
            found = [line for line in drawn if line.shape == expected.shape]
            assert any(np.allclose(line, expected + aside) for line in found)
    circles = [line.get_xydata() for line in axes.lines if line.get_marker() == "o"]
    assert [len(np.asarray(each)) for each in circles] == [4, 2, 4, 0]  # dots, touches
    written = [text.get_text() for text in axes.texts]
    assert {"plan\n(not a simulation)", "simulation:\ncompliant (Drake)"} <= set(written)
    assert {"right wall\n0.60 s", "right wall\n0.61 s"} <= set(written)
    assert written.count("start") == written.count("goal") == written.count("0.5 m") == 2


@pytest.mark.parametrize("notes", [(), ["dots: every 0.05 s", "arrow: control, up to 2 N"] * 3])
@pytest.mark.parametrize("goal", [[0.8, 0.7], [0.2, 0.3], [0.2, 0.32], [0.22, 0.28]])
def test_all_that_is_written_fits_on_the_board(goal: list[float], notes: list[str]) -> None:
    changes: dict[str, Any] = {
        "goals": np.array([goal]),
        "low": np.array([-1.0, 0.0]),
        "notes": notes,
    }
    board = dataclasses.replace(make_board(), **changes)
    figure = board.paint()
    (axes,) = figure.axes
    low, high = board.corners
    for text in axes.texts:
        box = text.get_window_extent().transformed(axes.transData.inverted())
        assert np.all(box.min >= low) and np.all(box.max <= high), text
    boxes = [text.get_window_extent() for text in axes.texts]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])


def test_long_labels_become_smaller() -> None:
    label, board = (
        "SNOPT from a random guess of the whole box: simulation: exactly rigid",
        make_board(),
    )
    long = board.panels[0]._replace(label=label)
    board = dataclasses.replace(board, panels=[long, board.panels[1]])
    figure = board.paint()
    (axes,) = figure.axes
    (text,) = (text for text in axes.texts if text.get_text().startswith("SNOPT"))
    box = text.get_window_extent().transformed(axes.transData.inverted())
    assert np.ptp(box.intervalx) <= board.panel[1][0] - board.panel[0][0]
    assert text.get_text().count("\n") == 1


def make_lanes(count: int) -> Board:
    """Returns a board of lanes of two bodies, whose starts and goals are near each other."""
    way = np.array([[0.1, 0.06], [0.9, 0.06], [0.5, 0.02]])
    nothing = np.empty((0, 2))
    return dataclasses.replace(
        make_board(),
        panels=[Panel(f"lane {i}", [way], way, nothing, []) for i in range(count)],
        low=np.array([-0.05, -0.1]),
        high=np.array([1.1, 0.1]),
        names=["left", "right"],
        starts=np.array([[0.5, 0.0], [0.6, 0.0]]),
        goals=np.array([[0.52, 0.0], [0.9, 0.0]]),
        columns=1,
        has_lanes=True,
    )


def test_lanes_have_their_titles_inside_and_names_that_do_not_overlap() -> None:
    board = make_lanes(2)
    figure = board.paint()
    (axes,) = figure.axes
    for lane, panel in enumerate(board.panels):
        low, high = (corner + board.offset(lane)[:2] for corner in board.panel)
        (title,) = (text for text in axes.texts if text.get_text() == panel.label)
        assert low[1] < title.get_position()[1] < high[1]
    named = [text for text in axes.texts if text.get_text().split()[-1] in ("start", "goal")]
    assert len(named) == 8
    boxes = [text.get_window_extent() for text in named]
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[:i])
    # The scale is below the last lane only.
    assert [text.get_text() for text in axes.texts].count("0.5 m") == 1


def luminance(color: Any) -> float:
    """Returns WCAG's relative luminance."""
    rgb = np.array(to_rgb(color))
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return float(linear @ [0.2126, 0.7152, 0.0722])


def test_titles_can_be_read_on_every_panel() -> None:
    (axes,) = make_lanes(len(PALETTE)).paint().axes
    titles = [text for text in axes.texts if text.get_text().startswith("lane")]
    for title, panel in zip(titles, axes.patches, strict=True):
        dark, light = luminance(title.get_color()), luminance(panel.get_facecolor())
        assert (light + 0.05) / (dark + 0.05) > 4.5, title  # WCAG's least contrast of text


def test_the_top_of_the_picture_is_the_far_side_of_the_board() -> None:
    board = make_lanes(1)
    gltf = json.loads(board.mesh().source().in_memory().mesh_file.contents())
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
    (left, bottom), (right, top) = board.corners
    np.testing.assert_allclose(x, left + (right - left) * across, atol=1e-6)
    np.testing.assert_allclose(-towards_viewer, top + (bottom - top) * down, atol=1e-6)
    np.testing.assert_array_equal(up, 0)
    assert sorted(set(triangles.tolist())) == [0, 1, 2, 3]


def test_notes_are_broken_between_notes() -> None:
    notes = ["dots: every 0.05 s", "arrow: control", "yellow flash: impact"]
    assert wrap_notes(notes, 40) == ["dots: every 0.05 s; arrow: control", "yellow flash: impact"]
    assert wrap_notes(notes, 100) == ["; ".join(notes)]
    assert wrap_notes([], 40) == []
