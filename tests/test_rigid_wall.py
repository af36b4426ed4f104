"""The event-driven rigid wall, judged by exact mathematics."""

from __future__ import annotations

import math

import exact_wall
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from replay_worlds import hold, make_diagram, make_scenario, shipped_world

from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import World

# What the event-driven wall promises; it mostly is a thousand times better.
EXACT = 1e-8
# Of numbers near 1 [m].
ROUNDING = 1e-15

RESTITUTIONS = [1.0, 0.8, 0.5, 0.2, 0.0]
# Of knots from a bounce [s]: none, or down to the rounding of times.
SHIFTS = st.floats(-1e-6, 1e-6) | st.sampled_from(
    [0.0, *(sign * 10.0**-n for n in range(9, 17) for sign in (1, -1))]
)


@given(
    st.floats(0.1, 1.5),
    st.floats(-3, -0.5),
    st.lists(SHIFTS, min_size=1, max_size=5, unique=True),
    st.sampled_from(RESTITUTIONS),
)
def test_a_bounce_on_a_knot_or_where_knots_crowd_happens_once(
    q: float, v: float, shifts: list[float], e: float
) -> None:
    impact = -q / v
    times = np.array([0.0, *(impact + np.sort(shifts)), impact + 0.5])
    assume(np.all(np.diff(times) > 0))
    forces = [0.0, *(5.0 * (-1) ** k for k in range(len(shifts)))]
    exact = exact_wall.run(q, v, times.tolist(), forces, e)
    scenario = make_scenario(q, v, restitution=e)
    replay = replay_event_driven(shipped_world(), scenario, times, np.c_[forces])
    assert replay.bounce_times[0] == pytest.approx(exact.impact_times[0], abs=1e-13)
    assert replay.positions[-1, 0] == pytest.approx(exact.position, abs=EXACT)
    # Without rebound, pushes of a microsecond between knots lift it, and it falls once more.
    assert sum(time < impact + 0.02 for time in replay.bounce_times) == 1 or not e


@pytest.mark.parametrize("e", RESTITUTIONS)
@pytest.mark.parametrize("v", [-1.0, -1e-9, 0.0, 1e-9, 1e-3, 1.0])
@pytest.mark.parametrize("push", [-3.0, 0.0, 3.0])
def test_a_start_at_the_wall(e: float, v: float, push: float) -> None:
    times, forces = [0.0, 0.3, 0.6, 1.0], [push, 1.0, -2.0]
    replay = replay_event_driven(
        shipped_world(), make_scenario(0.0, v, restitution=e), times, np.c_[forces]
    )
    assert replay.max_penetration <= ROUNDING
    if e < 1 or abs(v) > 1e-6 or push >= 0:  # Else the exact solution hops 400 million times.
        exact = exact_wall.run(0.0, v, times, forces, e)
        # 450 elastic hops of a third of a micrometer end 3e-8 m off.
        assert replay.positions[-1, 0] == pytest.approx(exact.position, abs=10 * EXACT)


def test_an_end_at_the_wall_counts_its_bounce() -> None:
    replay = replay_event_driven(shipped_world(), make_scenario(2.0, -2.0), *hold(0.0))
    assert replay.bounce_times == pytest.approx([1.0], abs=1e-14)
    assert replay.positions[-1, 0] == pytest.approx(0.0, abs=1e-12)
    assert replay.velocities[-2:, 0].tolist() == pytest.approx([2.0, 2.0])


@pytest.mark.parametrize("steps", [1, 2, 3, 7, 200])
@pytest.mark.parametrize("e", RESTITUTIONS)
def test_a_graze_changes_nothing(e: float, steps: int) -> None:
    # q(t) = (t − 1)²/2 touches the wall at t = 1 with no speed.
    scenario = make_scenario(0.5, -1.0, restitution=e)
    replay = replay_event_driven(shipped_world(), scenario, *hold(1.0, 2.0, steps))
    assert replay.positions[-1, 0] == pytest.approx(0.5, abs=1e-6)
    assert replay.max_penetration <= ROUNDING


@pytest.mark.parametrize("depth", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("steps", [1, 3, 200])
def test_a_dip_within_one_interval_is_seen(depth: float, steps: int) -> None:
    # Free flight would go this deep, and be out again before the interval ends.
    q, v, times = 0.5 - depth, -1.0, np.linspace(0.0, 2.0, steps + 1)
    exact = exact_wall.run(q, v, times.tolist(), [1.0] * steps, 0.5)
    scenario = make_scenario(q, v, restitution=0.5)
    replay = replay_event_driven(shipped_world(), scenario, times, np.ones((steps, 1)))
    assert len(replay.bounce_times) == len(exact.impact_times) == 1
    assert replay.positions[-1, 0] == pytest.approx(exact.position, abs=EXACT)


@pytest.mark.parametrize("e", [1.0, 0.999, 0.9, 0.5, 0.0])
def test_a_ball_that_trembles_under_a_push_does_not_hang(e: float) -> None:
    scenario = make_scenario(1e-7, 0.0, restitution=e)
    replay = replay_event_driven(shipped_world(), scenario, *hold(-1.0, steps=20))
    assert len(replay.bounce_times) <= math.sqrt(2 / 1e-6)
    assert 0 <= replay.positions[-1, 0] <= 1e-7
    assert replay.max_penetration <= ROUNDING


@pytest.mark.parametrize("steps", [1, 10, 200])
def test_a_mass_on_a_spring_swings_as_the_closed_form_says(steps: int) -> None:
    # ω = 10 rad/s about the wall itself: it comes back after half a period, and again: |cos|.
    world = World.from_diagram(make_diagram(spring=150.0))
    replay = replay_event_driven(world, make_scenario(0.4, 0.0), *hold(0.0, steps=steps))
    t = replay.times
    np.testing.assert_allclose(replay.positions[:, 0], 0.4 * np.abs(np.cos(10 * t)), atol=EXACT)
    expected = (np.arange(3) + 0.5) * np.pi / 10
    assert replay.bounce_times == pytest.approx(expected.tolist(), abs=EXACT)
    assert replay.energy_ratio == pytest.approx(1.0, abs=1e-12)


def test_a_dip_that_only_the_spring_makes_is_seen() -> None:
    # ω = 10 rad/s about 0.3 m: 10 µm too wide a swing touches the wall for some 2 ms, which nothing
    # at the start of the only interval foretells.
    world = World.from_diagram(make_diagram(spring=150.0, reference=0.3))
    scenario = make_scenario(0.60001, 0.0, restitution=0.5)
    replay = replay_event_driven(world, scenario, *hold(0.0, duration=0.5, steps=1))
    (bounce,) = replay.bounce_times
    assert bounce == pytest.approx(math.acos(-0.3 / 0.30001) / 10, abs=EXACT)
    speed, phase = 10 * math.sqrt(0.30001**2 - 0.3**2), 10 * (0.5 - bounce)
    end = 0.3 - 0.3 * math.cos(phase) + 0.5 * speed / 10 * math.sin(phase)
    assert replay.positions[-1, 0] == pytest.approx(end, abs=EXACT)


def test_an_impact_moves_all_that_hangs_together_and_rest_slides() -> None:
    world = World.from_diagram(make_diagram(num_joints=2))
    M, J = world.constant_inertia.mass_matrix, world.calc_contact_jacobian(np.zeros(2))[0]
    start, v = np.array([0.2, 0.1]), np.array([0.3, -1.5])
    times = np.linspace(0.0, 1.0, 101)
    scenario = make_scenario(start, v, restitution=0.6)
    replay = replay_event_driven(world, scenario, times, np.zeros((100, 2)))
    after = v - 1.6 * (J @ v) / (J @ np.linalg.solve(M, J)) * np.linalg.solve(M, J)
    (bounce,) = replay.bounce_times
    assert bounce == pytest.approx(-(J @ start) / (J @ v), abs=1e-12)
    end = start + bounce * v + (1 - bounce) * after
    np.testing.assert_allclose(replay.velocities[-1], after, atol=1e-12)
    np.testing.assert_allclose(replay.positions[-1], end, atol=1e-11)
    assert replay.energy_ratios[0] == pytest.approx((after @ M @ after) / (v @ M @ v))
    # Pressed to the wall it slides: along J v = 0, where only the tangential force does work.
    scenario, forces = make_scenario(start, v, restitution=0.0), np.array([1.0, -8.0])
    replay = replay_event_driven(world, scenario, times, np.tile(forces, (100, 1)))
    tangent = np.array([J[1], -J[0]])
    resting = replay.times > replay.times[-1] - 0.3
    np.testing.assert_allclose(replay.positions[resting] @ J, 0.0, atol=1e-11)
    speeds = replay.velocities[resting] @ tangent / (tangent @ tangent)
    slope = tangent @ forces / (tangent @ M @ tangent)
    np.testing.assert_allclose(np.diff(speeds) / np.diff(replay.times[resting]), slope, rtol=1e-9)
