"""Touches of a plan that may still come: none is lost, and the likelier ones are tried first."""

from __future__ import annotations

import numpy as np
import pytest

from drake_aigto.control import PlannedMotion, choose, find_left
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch

PERIOD, LEFT = 0.01, 1.0
PLAN = (Touch.bounce(0.5), Touch.bounce(0.8, 1))
COMES, LEAVES = np.array([-1.0, 1.0]), np.array([1.0, -1.0])


def contacts(now: float, rates: np.ndarray, bounced: int | None = None) -> list[tuple[int, ...]]:
    found = find_left(PLAN, now, LEFT, PERIOD, rates, bounced)
    return [tuple(touch.contact for touch in touches) for touches in found]


def test_far_from_a_touch_only_what_leaves_its_wall_may_have_been_there() -> None:
    assert contacts(0.2, COMES) == [(0, 1)]
    assert contacts(0.2, LEAVES) == [(0, 1), (1,)]


def test_near_a_touch_the_speed_tells_what_is_likelier() -> None:
    assert contacts(0.49, COMES) == [(0, 1), (1,)]
    assert contacts(0.49, LEAVES) == [(1,), (0, 1)]
    # One that was just seen is near, however late it was planned; one that is over may be late.
    assert contacts(0.2, LEAVES, bounced=0) == [(1,), (0, 1)]
    assert contacts(0.51, COMES)[0] == (0, 1)
    assert contacts(0.51, LEAVES) == [(1,)]


@pytest.mark.parametrize("now", [0.0, 0.4999, 0.51, 0.799])
def test_touches_are_in_order_and_within_what_is_left(now: float) -> None:
    for touches in find_left(PLAN, now, LEFT - now, PERIOD, COMES):
        times = [0.0, *(touch.start for touch in touches), LEFT - now]
        assert np.all(np.diff(times) > 0)


HOLDS = (Touch(0.1, 0.4, 0, 1), Touch(0.2, 1.0, 1), Touch(0.4, 1.0, 0, 0))
STILL = np.zeros(2)


def hold(now: float, rates: np.ndarray = STILL, **slips: int) -> list[tuple[float, ...]]:
    """Returns the likeliest touches left as start, end, contact and mode; slips by contact."""
    lying = {int(name[1:]): slip for name, slip in slips.items()}
    touches = find_left(HOLDS, now, LEFT - now, PERIOD, rates, None, lying)[0]
    return [(touch.start, touch.end, touch.contact, touch.mode) for touch in touches]


def test_what_lasts_overlaps_goes_on_in_another_mode_and_to_the_end() -> None:
    expected = [(0.1, 0.4, 0, 1), (0.2, 1.0, 1, 0), (0.4, 1.0, 0, 0)]
    np.testing.assert_allclose(hold(0.0), expected, atol=1e-12)
    # Both have begun, and lie: they last from now on.
    expected = [(0.0, 0.1, 0, 1), (0.0, 0.7, 1, 0), (0.1, 0.7, 0, 0)]
    np.testing.assert_allclose(hold(0.3, c0=1, c1=0), expected, atol=1e-12)


def test_what_is_late_to_lie_comes_at_once_and_what_slips_otherwise_does_so_first() -> None:
    late = hold(0.3, COMES, c1=0)
    assert late[0][0] > 0 and late[1][0] == 0
    slips = hold(0.3, c0=-1, c1=0)
    assert [(row[2], row[3]) for row in slips] == [(0, -1), (0, 1), (1, 0), (0, 0)]
    assert slips[0][1] == slips[1][0] == PERIOD
    # It lies there early: a period before it was to.
    assert hold(0.1 - PERIOD, c0=1)[0][0] == 0


def test_the_first_motion_that_is_not_dearer_is_taken_or_else_the_cheapest() -> None:
    def motion(cost: float) -> PlannedMotion:
        row = np.zeros((2, 1))
        still = Trajectory(np.array([0.0, 1.0]), row, row, row[:1], row, row[:1])
        return PlannedMotion(still, cost, ())

    same, cheap, dear = motion(1.01), motion(0.5), motion(2.0)
    assert choose([None, dear, same, cheap], 1.0) is same
    assert choose([dear, None, motion(3.0)], 1.0) is dear
    assert choose([None], 1.0) is None
