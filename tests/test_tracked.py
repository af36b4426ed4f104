"""Unstable motions: how errors grow along them, and verdicts with their own feedback."""

from __future__ import annotations

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import scipy

from drake_aigto import Plan, PlanOptions, Scenario, World, plan
from drake_aigto.arrays import Floats
from drake_aigto.control import TrackingController
from drake_aigto.planning import calc_divergence, needs_feedback
from drake_aigto.show import format_plan
from drake_aigto.simulation import MOST_GROWTH, NOTHING, calc_growth

# A pole of 1 kg at the end of a rod of 1 m without mass, which a motor turns at its foot.
POLE = """<robot name="pole">
  <link name="pole">
    <inertial>
      <origin xyz="0 0 1"/> <mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>
    </inertial>
  </link>
  <joint name="foot" type="continuous">
    <parent link="world"/> <child link="pole"/> <axis xyz="0 1 0"/>
  </joint>
  <transmission>
    <type>transmission_interface/SimpleTransmission</type>
    <joint name="foot"/>
    <actuator name="motor"/>
  </transmission>
</robot>"""
INERTIA, GRAVITY = 1.01, 9.81
PACE = np.sqrt(GRAVITY / INERTIA)  # λ of errors upright, e^(λ t) [1/s].


def linear(pace: float, step: float) -> Floats:
    return np.asarray(scipy.linalg.expm(step * np.array([[0.0, 1.0], [pace**2, 0.0]])))


@pytest.mark.parametrize("count", [5, 200])
def test_errors_grow_as_the_exact_flow_says_from_any_time_to_any_other(count: int) -> None:
    pace, step = 3.0, 4.0 / count
    grow, scales = linear(pace, step), np.array([1.0, pace])
    found = calc_growth(np.array([grow] * count), scales)
    assert found.factor == pytest.approx(np.exp(pace * 4.0), rel=1e-9)
    # Along the direction that grows: v = λ q, in units of the scales.
    assert np.abs(found.worst) == pytest.approx(np.array([1.0, pace]) / np.sqrt(2), rel=1e-6)
    # What shrinks before, and after, changes nothing.
    shrink = np.linalg.inv(grow)
    around = np.array([*[shrink] * count, *[grow] * count, *[shrink] * count])
    parts = calc_growth(around, scales)
    assert parts.factor == pytest.approx(found.factor, rel=0.3)


def test_errors_of_a_motion_that_runs_away_grow_beyond_all_numbers() -> None:
    assert calc_growth(np.full((400, 2, 2), 1e10), np.ones(2)).factor == np.inf


def ask(folder: Path, duration: float, start: float = 0.3) -> Scenario:
    path = folder / "pole.urdf"
    path.write_text(POLE)
    return Scenario(
        model=str(path),
        initial_position=[start],
        initial_velocity=[0.0],
        goal_position=[0.0],
        goal_velocity=[0.0],
        duration=duration,
        time_step=0.1,
        control_weight=0.01,
        position_weight=[0.1],
        goal_weight=10.0,
        goal_velocity_weight=1.0,
        contact="compliant",
    )


def bound_growth(duration: float) -> float:
    """Returns how errors grow upright all the time, with velocities in parts of 1 rad in T."""
    turn = PACE * duration
    return float(np.sinh(turn) * max(turn, 1 / turn))


@cache
def balance(folder: Path) -> Plan:
    return plan(ask(folder, 7.0), PlanOptions(renewals=0, starts=4))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pole")


def test_a_pole_that_balances_for_long_is_judged_with_its_own_feedback(folder: Path) -> None:
    found = balance(folder)
    growth = found.best.growth
    assert growth is not None
    # Beyond what the control alone could hold.
    assert MOST_GROWTH < growth.factor == pytest.approx(bound_growth(7.0), rel=0.1)
    assert needs_feedback(growth)
    assert found.holds
    assert found.best.gains
    assert not any(map(found.best.is_confirmed_by, found.replay.alone[:1]))
    for replay in found.replay:
        assert replay.feedback is not None
        assert replay.cost == pytest.approx(found.cost, rel=1e-3)
        assert replay.goal_error <= NOTHING
    assert len(found.replay.perturbed) == 2
    for replay in found.replay.perturbed:
        assert (replay.feedback or 0.0) > (found.replay.event_driven.feedback or 0.0)
        assert np.abs(replay.positions[0] - found.replay.event_driven.positions[0]) <= 1e-3


def test_a_plan_file_has_the_gains_and_replays_to_the_same_bits(folder: Path) -> None:
    found, path = balance(folder), folder / "plan.json"
    found.save(path)
    loaded = Plan.load(path)
    assert loaded.best.gains == found.best.gains
    again = loaded.replayed(confirm=False)
    assert again.replay.event_driven == found.replay.event_driven
    assert again.replay.perturbed == found.replay.perturbed
    assert again.holds
    # Who tracks it samples more often, and has gains of shorter holds.
    (phase,) = TrackingController(loaded).feedback.phases
    step = loaded.scenario.time_step / 5
    np.testing.assert_allclose(np.diff(phase.times), step, rtol=1e-6)


def test_what_judges_is_said_first_and_the_control_alone_is_reported(folder: Path) -> None:
    text = format_plan(balance(folder))
    assert text.startswith("verdict     holds: the control with its feedback keeps the plan's")
    assert "growth      errors grow" in text
    assert "its own feedback judges it, not the control alone" in " ".join(text.split())
    assert "alone       by integration: contradicts the plan" in text
    assert "perturbed   from starts 1e-3 of the scales off" in text
    assert "with feedback: errors grow" in repr(balance(folder))


def test_a_short_balance_is_judged_by_its_control_alone(folder: Path) -> None:
    found = plan(ask(folder, 1.0), PlanOptions(renewals=0, starts=2))
    growth = found.best.growth
    assert growth is not None
    assert 1.0 < growth.factor == pytest.approx(bound_growth(1.0), rel=0.1)
    assert not found.best.gains
    assert all(replay.feedback is None for replay in found.replay)
    assert "the control alone keeps the plan's promise" in format_plan(found)


def test_a_goal_that_is_an_unstable_equilibrium_is_named_with_its_pace(folder: Path) -> None:
    scenario = ask(folder, 1.0)
    world = World.from_scenario(scenario)
    assert calc_divergence(world, scenario) == pytest.approx(PACE, rel=1e-6)
    hanging = dataclasses.replace(scenario, goal_position=[np.pi])
    assert calc_divergence(world, hanging) == 0.0
    passing = dataclasses.replace(scenario, goal_velocity=[1.0])
    assert calc_divergence(world, passing) == 0.0
    # The motor holds it anywhere, and errors grow where it leans upwards.
    leaning = dataclasses.replace(scenario, goal_position=[0.5])
    assert calc_divergence(world, leaning) == pytest.approx(PACE * np.sqrt(np.cos(0.5)), rel=1e-6)
    text = " ".join(format_plan(balance(folder)).split())
    assert (
        "the goal, q = (0), is at an unstable equilibrium, where errors grow e-fold in 0.32 s"
        in text
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "duration", "time_step", "most"),
    [("acrobot/swing_up", 6.0, 0.05, 95.0), ("cart_pole/rigid_06", 4.5, 0.0375, 82.0)],
)
def test_a_longer_horizon_is_no_worse(
    name: str, duration: float, time_step: float, most: float
) -> None:
    scenario = dataclasses.replace(Scenario.named(name), duration=duration, time_step=time_step)
    found = plan(scenario)
    assert found.holds
    assert found.cost < most
    for replay in found.replay:
        assert replay.cost == pytest.approx(found.cost, rel=1e-3)
