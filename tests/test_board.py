"""The board behind bodies in a plane: what is painted is where it belongs, and can be read."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from drake_aigto.show.board import Board


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
        dots=[np.array([[0.2, 0.3], [0.6, 0.4], [0.8, 0.6], [0.7, 0.5]])] * 2,
        touches=[np.array([[1.0, 0.5]] * 2), np.empty((0, 2))],
        touch_names=[["right wall, 0.60 s", "right wall, 0.61 s"], []],
    )


def test_a_board_has_the_way_and_the_marks_of_each_panel() -> None:
    board = make_board()
    (axes,) = board.paint().axes
    for i in range(2):
        aside = board.offset(i)[:2]
        drawn = [np.asarray(line.get_xydata()) for line in axes.lines]
        for expected in (board.ways[i][0], board.dots[i], board.starts, board.goals):
            found = [line for line in drawn if line.shape == expected.shape]
            assert any(np.allclose(line, expected + aside) for line in found)
    circles = [line.get_xydata() for line in axes.lines if line.get_marker() == "o"]
    assert [len(np.asarray(each)) for each in circles] == [4, 2, 4, 0]  # dots, touches
    written = [text.get_text() for text in axes.texts]
    assert {"plan\n(not a simulation)", "simulation:\ncompliant (Drake)"} <= set(written)
    # Names of touches at one place would cover each other.
    assert "right wall, 0.60 s" in written and "right wall, 0.61 s" not in written
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
    labels = ["SNOPT from a random guess of the whole box: simulation: exactly rigid", "plan"]
    board = dataclasses.replace(make_board(), labels=labels)
    figure = board.paint()
    (axes,) = figure.axes
    (text,) = (text for text in axes.texts if text.get_text().startswith("SNOPT"))
    box = text.get_window_extent().transformed(axes.transData.inverted())
    assert np.ptp(box.intervalx) <= board.panel[1][0] - board.panel[0][0]
    assert text.get_text().count("\n") == 1
