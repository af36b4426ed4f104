"""Plans for mechanisms: what shooting makes of boxes, against simulations and other methods."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from drake_aigto import Plan, Planner, PlanningError, PlanOptions, Scenario
from drake_aigto.errors import OptionsError, ProgramError
from drake_aigto.planning import Center, MechanismOptions, MechanismRung, Renewal
from drake_aigto.planning.mechanism_problem import MechanismProblem
from drake_aigto.shooting import ShootingResult
from drake_aigto.simulation import replay_event_driven

QUICK = MechanismOptions(renewals=16, finalists=1)


@pytest.fixture(scope="module")
def cart_pole() -> Planner:
    return Planner(Scenario.named("cart_pole/soft_06"), QUICK)


@pytest.fixture(scope="module")
def plan(cart_pole: Planner) -> Plan:
    return Planner(cart_pole.scenario, MechanismOptions(), cart_pole.world).plan()


def test_the_pole_pushes_off_a_wall_to_stand_up(plan: Plan) -> None:
    assert plan.holds
    assert plan.best.contacts
    # No motion that 300 starts of shooting, or 60 of IPOPT, lead to costs less than 80.0.
    assert plan.cost < 80.1


def test_both_simulations_agree_to_a_millionth(plan: Plan) -> None:
    assert plan.replay.drake is not None
    assert plan.replay.drake.cost == pytest.approx(plan.replay.event_driven.cost, rel=1e-6)
    assert plan.cost == pytest.approx(plan.replay.event_driven.cost, rel=1e-3)


def test_a_trajectory_obeys_the_equations_of_motion(plan: Plan) -> None:
    assert plan.defects["integration"] < 1e-6
    assert np.all(np.abs(plan.trajectory.controls) <= 20.0)


def test_bounds_hold_in_both_simulations(cart_pole: Planner) -> None:
    scenario = dataclasses.replace(cart_pole.scenario, position_lower=[-0.2, -np.inf])
    bounded = Planner(scenario, QUICK, cart_pole.world).plan()
    for replay in bounded.replay:
        assert replay.violations["bounds"] < 1e-3
        assert np.min(replay.positions[:, 0]) > -0.202
    assert bounded.additions == ()


def test_what_passes_its_bounds_between_knots_has_narrower_ones_there(cart_pole: Planner) -> None:
    scenario = dataclasses.replace(cart_pole.scenario, velocity_upper=[np.inf, 3.5])
    problem = MechanismProblem(cart_pole.world, scenario, QUICK)
    motion = problem.coast
    replay = replay_event_driven(cart_pole.world, scenario, motion.times, motion.controls)
    fastest = float(np.max(replay.velocities[:, 1]))
    assert fastest > 3.6
    narrowed = problem.narrowed(motion, replay)
    within = narrowed.bounds.velocity
    np.testing.assert_allclose(within[1], [np.inf, 7.0 - fastest])
    np.testing.assert_array_equal(within[0], [-np.inf, -np.inf])
    slow = narrowed.tighten(motion)
    assert np.max(slow.states[1:, 3]) < 7.0 - fastest + 1e-3


def test_a_hard_goal_is_met_in_both_simulations() -> None:
    scenario = Scenario.named("acrobot/swing_up")
    scenario = dataclasses.replace(scenario, hard_goal=True, goal_velocity=[0.0, 0.0])
    for replay in Planner(scenario, QUICK).plan().replay:
        assert replay.violations["hard goal"] < 1e-3
        np.testing.assert_allclose(replay.positions[-1], [np.pi, 0.0], atol=1e-3)


@pytest.mark.slow
def test_what_misses_a_hard_goal_is_no_plan(cart_pole: Planner) -> None:
    scenario = dataclasses.replace(cart_pole.scenario, hard_goal=True, control_upper=0.1)
    options = dataclasses.replace(QUICK, renewals=0, ladder=QUICK.ladder[:2])
    with pytest.raises(PlanningError, match=r"there it breaks .*'hard goal'"):
        Planner(scenario, options, cart_pole.world).plan()


def test_forces_give_what_the_momentum_lacks(plan: Plan) -> None:
    """The wall's impulse is the momentum along the cart that the control does not explain."""
    t, world = plan.trajectory, plan.find_world()
    momenta = np.einsum("kij,kj->ki", world.calc_mass_matrix(t.positions), t.velocities)[:, 0]
    h = np.diff(t.times)
    J = world.calc_contact_jacobian(t.positions)[0, :, 0]
    pushed = h @ t.controls[:, 0] + h @ t.forces @ J
    assert momenta[-1] - momenta[0] == pytest.approx(pushed, abs=1e-4)


@pytest.mark.slow
def test_a_plan_is_that_of_any_number_of_threads(cart_pole: Planner, plan: Plan) -> None:
    options = MechanismOptions(threads=1)
    other = Planner(cart_pole.scenario, options, cart_pole.world).plan()
    np.testing.assert_array_equal(other.trajectory.controls, plan.trajectory.controls)


def test_planning_again_is_planning_anew(cart_pole: Planner) -> None:
    again = cart_pole.plan(initial_position=[0.2, 0.1])
    scenario = dataclasses.replace(cart_pole.scenario, initial_position=[0.2, 0.1])
    anew = Planner(scenario, QUICK).plan()
    np.testing.assert_array_equal(again.trajectory.controls, anew.trajectory.controls)
    assert again.cost == anew.cost


def test_a_file_keeps_the_plan(plan: Plan, tmp_path: Path) -> None:
    plan.save(tmp_path / "plan.json")
    loaded = Plan.load(tmp_path / "plan.json")
    assert loaded == plan
    assert loaded.options == plan.options
    assert loaded.best.origin == plan.best.origin
    assert loaded.replayed().holds


def test_what_touches_nothing_swings_up() -> None:
    scenario = Scenario.named("acrobot/swing_up")
    plan = Planner(scenario, QUICK).plan()
    assert plan.holds
    assert not plan.best.contacts
    assert plan.best.goal_error < 0.1


def test_a_search_without_boxes_has_none_in_renewals_either(
    cart_pole: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    widths, draw, run = [], MechanismProblem.renew, MechanismProblem.run_aigo

    def renew(self: MechanismProblem, motion: ShootingResult, renewal: Renewal) -> Center:
        widths.append(renewal.half_width)
        return draw(self, motion, renewal)

    def run_aigo(self: MechanismProblem, rung: MechanismRung) -> Center:
        widths.append(rung.half_width)
        return run(self, rung)

    monkeypatch.setattr(MechanismProblem, "renew", renew)
    monkeypatch.setattr(MechanismProblem, "run_aigo", run_aigo)
    for half_width in (0.0, 0.5):
        rung = MechanismRung(half_width=half_width, num_steps=15)
        options = MechanismOptions(ladder=(rung,), renewals=2, finalists=1, confirm=False)
        Planner(cart_pole.scenario, options, cart_pole.world).plan()
    assert widths[:3] == [0.0, 0.0, 0.0]
    assert min(widths[3:]) > 0


def test_options_of_another_road_are_refused() -> None:
    with pytest.raises(OptionsError, match="got PlanOptions, expected MechanismOptions"):
        Planner(Scenario.named("cart_pole/soft_06"), PlanOptions())
    with pytest.raises(OptionsError, match="got MechanismOptions, expected PlanOptions"):
        Planner(Scenario.named("table1/1"), MechanismOptions())


def test_what_shooting_has_no_room_for_is_refused_by_name(cart_pole: Planner) -> None:
    with pytest.raises(ProgramError, match="the planner's transcription: got a task for shooting"):
        _ = cart_pole.transcription
