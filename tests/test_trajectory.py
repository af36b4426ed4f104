"""Trajectories: checks, JSON without loss, and curves with jumps."""

from __future__ import annotations

import copy
import json
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from drake_aigto import TrajectoryError
from drake_aigto.errors import DamagedDataError
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.trajectory import Trajectory


def make_fields(**changes: Any) -> dict[str, Any]:
    """Returns a ball that flies in at −2 m/s, bounces at 0.5 s, and is pushed until 0.8 s."""
    fields = {
        "times": [0.0, 0.2, 0.5, 0.8],
        "positions": [[1.0], [0.6], [0.0], [0.6 + 0.045]],
        "velocities": [[-2.0], [-2.0], [-2.0], [2.3]],
        "controls": [[0.0], [0.0], [1.0]],
        "impulses": [[0.0], [0.0], [4.0], [0.0]],
        "forces": [[0.0], [0.0], [0.0]],
    }
    return {**fields, **changes}


@st.composite
def trajectories(draw: st.DrawFn, largest: float = 1.7e308) -> Trajectory:
    n, nq, nu, m = (draw(st.integers(1, 4)) for _ in range(4))
    finite = st.floats(-largest, largest)
    rows = {
        "positions": (n + 1, nq),
        "velocities": (n + 1, nq),
        "controls": (n, nu),
        "impulses": (n + 1, m),
        "forces": (n, m),
    }
    times = sorted(draw(st.sets(finite, min_size=n + 1, max_size=n + 1)))
    arrays = {name: draw(hnp.arrays(float, shape, elements=finite)) for name, shape in rows.items()}
    return Trajectory(times=np.array(times), **arrays)


@given(trajectories())
def test_json_and_pickle_lose_nothing(trajectory: Trajectory) -> None:
    read = from_plain(Trajectory, json.loads(json.dumps(to_plain(trajectory))))
    for other in (read, pickle.loads(pickle.dumps(trajectory)), copy.deepcopy(trajectory)):
        assert other == trajectory
        assert hash(other) == hash(trajectory)
        for name in make_fields():
            array = getattr(other, name)
            assert array.tobytes() == getattr(trajectory, name).tobytes()
            assert not array.flags.writeable


def test_a_trajectory_keeps_nothing_of_what_it_was_made_of() -> None:
    positions = np.array(make_fields()["positions"])
    trajectory = Trajectory(**make_fields(positions=positions))
    positions[0] = 7.0
    assert trajectory.positions[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        trajectory.positions[0] = 7.0
    assert trajectory != Trajectory(**make_fields(controls=[[0.0], [0.0], [2.0]]))
    assert trajectory != "a trajectory"


NAN = float("nan")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": [0.0]}, r"times: got shape \(1,\), expected \(N\+1,\) with N ≥ 1\."),
        ({"times": 1.0}, r"times: got shape \(\)"),
        (
            {"times": [0.0, 0.5, 0.5, 0.8]},
            r"times: got 0\.5 s, then 0\.5 s \(knots 1 and 2\), expected strictly increasing times",
        ),
        ({"times": [0.0, 0.2, float("inf"), 0.8]}, r"times: got inf at index \(2,\), expected fin"),
        ({"times": "soon"}, r"times: got could not convert .*expected an array of numbers"),
        ({"controls": [[0.0], [0.0]]}, r"controls: got shape \(2, 1\), expected 3 rows, one for e"),
        ({"controls": [0.0, 0.0, 1.0]}, r"controls: got shape \(3,\), expected 3 rows"),
        ({"controls": [[0.0], [NAN], [1.0]]}, r"controls: got nan at index \(1, 0\)"),
        ({"positions": [[1.0]] * 3}, r"positions: got shape \(3, 1\), expected 4 rows, one for ea"),
        ({"velocities": [[1.0, 2.0]] * 4}, r"velocities: got shape \(4, 2\), expected that of pos"),
        ({"impulses": [[0.0], [0.0, 1.0], [0.0], [0.0]]}, r"impulses: got .*inhomogeneous"),
    ],
)
def test_numbers_that_do_not_fit_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(TrajectoryError, match=message):
        Trajectory(**make_fields(**changes))


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], "Trajectory: got .list. object has no"),
        ({"times": [0.0, 1.0]}, r"Trajectory\.positions: got nothing, expected a value"),
        (make_fields(speed=1.0), "Trajectory: got unknown speed, expected fields of Trajectory"),
        (make_fields(times=[0.0, 1.0]), r"Trajectory: got controls: got shape \(3, "),
        (make_fields(times=[None] * 4), "Trajectory: got times: got nan at"),
        (make_fields(times=["now"]), r"Trajectory\.times: got could not convert"),
    ],
)
def test_a_damaged_file_is_refused(data: object, message: str) -> None:
    with pytest.raises(DamagedDataError, match=message):
        from_plain(Trajectory, data)


def test_the_state_curve_is_the_flight_and_jumps_at_the_impulse() -> None:
    state, _ = Trajectory(**make_fields()).to_piecewise()
    assert (state.rows(), state.cols()) == (2, 1)
    for t in np.linspace(0.0, 0.5, 23)[:-1]:
        np.testing.assert_allclose(state.value(t)[:, 0], [1.0 - 2.0 * t, -2.0], atol=1e-14)
    for s in np.linspace(0.0, 0.3, 23):
        flight = [2.0 * s + s**2 / 2, 2.0 + s]
        np.testing.assert_allclose(state.value(0.5 + s)[:, 0], flight, atol=1e-14)


def test_without_impulses_the_state_curve_is_smooth() -> None:
    times = np.array([0.0, 0.1, 0.25, 0.3])
    wave = np.column_stack([np.sin(times)]), np.column_stack([np.cos(times)])
    zeros = {name: np.zeros((3, 1)) for name in ("controls", "forces")}
    zeros["impulses"] = np.zeros((4, 1))
    state, _ = Trajectory(times, *wave, **zeros).to_piecewise()
    for k, t in enumerate(times[1:-1], 1):
        before, after = state.value(np.nextafter(t, 0)), state.value(t)
        np.testing.assert_allclose(before, after, atol=1e-14)
        np.testing.assert_allclose(after[:, 0], [wave[0][k, 0], wave[1][k, 0]], atol=1e-14)
    # Cubics through values and slopes: h⁴/384 off at most.
    assert abs(state.value(0.175)[0, 0] - np.sin(0.175)) < 0.15**4 / 384


@given(trajectories(largest=1e3))
def test_the_control_curve_is_held_on_each_interval_and_at_the_end(trajectory: Trajectory) -> None:
    assume(np.all(np.diff(trajectory.times) > 1e-9))
    _, control = trajectory.to_piecewise()
    for k, u in enumerate(trajectory.controls):
        start, end = trajectory.times[k : k + 2]
        for t in {start, start / 2 + end / 2, np.nextafter(end, start)}:
            if start <= t < end:
                assert control.value(t)[:, 0].tolist() == u.tolist()
    assert control.value(trajectory.times[-1])[:, 0].tolist() == trajectory.controls[-1].tolist()


def test_a_motion_goes_on_later_as_it_was() -> None:
    trajectory = Trajectory(**make_fields())
    later = trajectory.later(0.25)
    np.testing.assert_array_equal(later.times, trajectory.times + 0.25)
    assert later.later(-0.25) == trajectory
    with pytest.raises(TrajectoryError, match="strictly increasing"):
        trajectory.later(1e17)
