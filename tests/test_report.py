"""A report in a real browser: it needs no network, and its 3-D scene moves as the numbers say."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import Page, find_chromium, start_browser
from numpy.typing import NDArray

from drake_aigto import Plan

pytestmark = pytest.mark.skipif(
    find_chromium() is None,
    reason="no Chromium: install Debian's chromium, or name one in $CHROMIUM",
)

FRAME, SLIDER, TOGGLE = "#player-frame", "#player-slider", "#player-toggle"
VIEWER = f"document.querySelector('{FRAME}').contentWindow.viewer"
FIT = f"[document.querySelector('{FRAME}').clientHeight, {VIEWER}.camera.zoom]"
ASIDE = "document.querySelector('#player-aside')"


pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def path(report: tuple[str, list[str]], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("report") / "report.html"
    path.write_text(report[0], encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def page(path: Path) -> Iterator[Page]:
    with start_browser(path.parent / "profile") as page:
        open_report(page, path)
        yield page


def open_report(page: Page, path: Path) -> None:
    page.open(path)
    page.wait_for(f"!document.querySelector('{SLIDER}').disabled")


def show(page: Page, seconds: float) -> NDArray[np.float64]:
    """Moves the slider as a user would, and returns what the scene shows then."""
    page.evaluate(
        f"(slider => {{ slider.value = {seconds}; slider.dispatchEvent(new Event('input')); }})"
        f"(document.querySelector('{SLIDER}'))"
    )
    return page.take_picture(FRAME)


def is_blue(picture: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Returns where the plan's color is, shape (height, width)."""
    red, _, blue = np.moveaxis(picture, -1, 0)
    return (blue > 0.5) & (blue - red > 0.35)


def shown_time(page: Page) -> float:
    return float(page.evaluate(f"Number(document.querySelector('{SLIDER}').value)"))


def test_the_ball_is_where_the_plan_has_it(page: Page, plan: Plan) -> None:
    bounce = plan.best.contacts[0].time
    times = np.array([0.0, bounce / 2, bounce, (bounce + 1) / 2, 1.0])
    blue = [is_blue(show(page, seconds)) for seconds in times]
    # Above its way, which is a line of its color.
    way = np.flatnonzero(np.logical_and.reduce(blue).any(axis=1)).min()
    edges = [np.flatnonzero(each[: way - 1].any(axis=0))[[0, -1]] for each in blue]
    centers = np.mean(edges, axis=1)
    trajectory = plan.trajectory
    q = np.interp(times, trajectory.times, trajectory.positions[:, 0])
    # The line is parallel to the window, so that pixels are linear in metres.
    slope, offset = np.polyfit(q, centers, 1)
    assert slope > 100
    np.testing.assert_allclose(centers, slope * q + offset, atol=0.04 * slope)


def is_yellow(picture: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Returns where an impact flashes, shape (height, width)."""
    red, green, blue = np.moveaxis(picture, -1, 0)
    # Green differs from blue by 0.46 at least in most of a flash, and by 0.28 at most where a thin
    # orange line is blended with its lane.
    return (red > 0.7) & (green > 0.6) & (green - blue > 0.4)


def test_a_wall_is_drawn_and_an_impact_flashes_for_a_moment(page: Page, plan: Plan) -> None:
    picture = show(page, plan.best.contacts[0].time + 0.02)
    red, _, blue = np.moveaxis(picture, -1, 0)
    wall = (np.abs(red - 0.3) < 0.15) & (blue - red > 0.08) & (blue < 0.6)
    assert wall.sum() > 600
    assert is_yellow(picture).sum() > 10 * is_yellow(show(page, 1.0)).sum() + 100


def test_the_clock_ends_with_the_plan_and_nothing_of_meshcats_lies_over_the_scene(
    page: Page, plan: Plan
) -> None:
    show(page, 9.9)
    shown = page.evaluate("document.querySelector('#player-time').textContent")
    assert shown == "1.00 s of 1.00 s" and plan.trajectory.times[-1] == 1.0
    show(page, 0.0)
    bar = f"document.querySelector('{FRAME}').contentDocument.querySelector('.dg')"
    assert page.evaluate(f"{bar}.offsetParent") is None and page.evaluate(f"{bar} !== null")


def test_the_view_does_not_depend_on_when_meshes_come(page: Page) -> None:
    before = page.evaluate(FIT)
    ball = f"{VIEWER}.scene_tree.find(['drake_aigto', 'motions', '1']).object"
    page.evaluate(f"{{ window.taken = [...{ball}.children]; {ball}.remove(...taken); 0 }}")
    frames = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))"
    page.evaluate(f"{frames}.then(() => dispatchEvent(new Event('resize')))")
    assert page.evaluate(FIT) == before
    page.evaluate(f"{{ {ball}.add(...taken); 0 }}")


def test_simulations_stand_beside_the_plan_at_a_press_and_the_view_holds_them_all(
    page: Page,
) -> None:
    before = page.evaluate(FIT)
    assert page.evaluate(f"{ASIDE}.hidden") is False
    page.evaluate(f"{ASIDE}.click()")
    picture = show(page, 0.2)
    assert page.evaluate(FIT)[1] < before[1]
    red, green, _ = np.moveaxis(picture, -1, 0)
    is_orange = (red - green > 0.15) & (red > 0.6)  # of the first ghost, now on white
    assert is_orange.sum() > 100 and is_blue(picture).sum() > 100
    rows = [np.flatnonzero(each.any(axis=1)) for each in (is_blue(picture), is_orange)]
    assert np.median(rows[0]) < rows[1].min()
    page.evaluate(f"{ASIDE}.click()")
    assert page.evaluate(FIT) == before


def press(page: Page, key: str, shift: bool = False) -> None:
    page.evaluate(
        "document.querySelector('.player').dispatchEvent(new KeyboardEvent('keydown', "
        f"{{key: '{key}', shiftKey: {str(shift).lower()}, bubbles: true}}))"
    )


def test_keys_step_frames_and_leap_between_events_which_are_on_the_slider(
    page: Page, plan: Plan
) -> None:
    bounce = plan.best.contacts[0].time
    show(page, 0.2)
    press(page, "ArrowRight")
    assert shown_time(page) == pytest.approx(0.21)
    press(page, "ArrowRight", shift=True)
    assert shown_time(page) == pytest.approx(bounce, abs=1e-3)
    press(page, "ArrowRight", shift=True)
    assert shown_time(page) == pytest.approx(1.0)
    press(page, "Home")
    assert shown_time(page) == 0.0
    titles = "[...document.querySelectorAll('#player-marks i')].map(mark => mark.title)"
    assert page.evaluate(titles) == [f"{bounce:.2f} s: touches wall"]
    page.evaluate("document.querySelector('#player-events button').click()")
    assert shown_time(page) == pytest.approx(bounce, abs=1e-3)


def test_a_cursor_in_figures_and_numbers_follow_the_slider_and_a_figure_leads_it(
    page: Page, plan: Plan
) -> None:
    show(page, 0.25)
    first = "document.querySelector('.plot')"
    span = f"[Number({first}.dataset.first), Number({first}.dataset.last)]"
    begin, end = page.evaluate(span)
    left = page.evaluate(f"parseFloat({first}.firstElementChild.style.left) / 100")
    assert begin + left * (end - begin) == pytest.approx(0.25, abs=1e-3)
    q = np.interp(0.25, plan.trajectory.times, plan.trajectory.positions[:, 0])
    told = page.evaluate("document.querySelector('#player-numbers td').textContent")
    assert float(told) == pytest.approx(q, abs=0.02)
    page.evaluate(
        f"(plot => {{ const {{left, width}} = plot.getBoundingClientRect(); plot.onpointerdown("
        f"{{clientX: left + width * {(0.5 - begin) / (end - begin)}}}); }})({first})"
    )
    assert shown_time(page) == pytest.approx(0.5, abs=0.01)


def test_the_scene_fills_its_frame_at_any_width(page: Page, path: Path) -> None:
    for width in (390, 1280):
        page.open(path, width, 800)
        page.wait_for(f"!document.querySelector('{SLIDER}').disabled")
        picture = show(page, 0.3)
        columns = np.flatnonzero((picture.min(axis=2) < 0.9).any(axis=0))
        assert np.ptp(columns) > 0.6 * picture.shape[1]
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    open_report(page, path)


def test_nothing_that_moves_is_ever_cut_off(page: Page) -> None:
    # The window changes while nothing reaches far.
    show(page, 1.0)
    page.evaluate("dispatchEvent(new Event('resize'))")
    for seconds in (0.0, 0.25, 0.5, 1.5):
        picture = show(page, seconds)
        sides = picture[50:, 0], picture[50:, -1], picture[-1]  # Below Meshcat's own controls.
        assert min(side.min() for side in sides) > 0.9, seconds


def test_a_slow_browser_shows_the_scene_at_the_same_size(page: Page, path: Path) -> None:
    with start_browser(path.parent / "slow") as slow:
        slow.call("Emulation.setCPUThrottlingRate", rate=4)
        open_report(slow, path)
        np.testing.assert_allclose(slow.evaluate(FIT), page.evaluate(FIT), rtol=1e-9)


def test_the_recording_plays_and_pauses(page: Page) -> None:
    before = show(page, 0.2)
    page.evaluate(f"document.querySelector('{TOGGLE}').click()")
    page.wait_for(f"Number(document.querySelector('{SLIDER}').value) != 0.2")
    page.wait_for(f"document.querySelector('{TOGGLE}').textContent == '❚❚'")
    page.evaluate(f"document.querySelector('{TOGGLE}').click()")
    paused = shown_time(page)
    picture = page.take_picture(FRAME)
    assert np.mean(np.abs(picture - before) > 0.1) > 1e-3
    time.sleep(0.3)
    assert shown_time(page) == paused
    np.testing.assert_array_equal(page.take_picture(FRAME), picture)


def test_the_boxes_shrink(page: Page) -> None:
    page.evaluate("document.querySelector('[data-scene=\"1\"]').click()")
    page.wait_for(f"document.querySelector('{SLIDER}').disabled")
    page.wait_for(f"!document.querySelector('{SLIDER}').disabled")
    end = float(page.evaluate(f"Number(document.querySelector('{SLIDER}').max)"))
    first, last = (int(is_blue(show(page, at)).sum()) for at in (0.0, end))
    assert first > 3 * last > 0


# Last: by now everything has been shown.
def test_nothing_is_fetched_and_nothing_is_complained_of(page: Page) -> None:
    assert page.complaints == []
    schemes = {request.split(":", 1)[0] for request in page.requests}
    assert schemes <= {"file", "data", "blob", "about"}
    assert len({request for request in page.requests if request.startswith("file")}) == 1


def test_figures_and_numbers_can_be_seen(page: Page, plan: Plan) -> None:
    widths: Any = page.evaluate("[...document.images].map(image => image.naturalWidth)")
    # Motions, costs of one touch, boxes, and the phase portrait behind a click.
    assert len(widths) == 4 and min(widths) > 300
    wide = "document.documentElement.scrollWidth <= innerWidth"
    assert page.evaluate(wide), "nothing is beside the window"
    text = page.evaluate("document.body.innerText")
    for number in (f"{plan.cost:.3e}", f"{plan.replay.event_driven.cost:.3e}", "0.1.0"):
        assert number in text
