"""Plans for mechanisms between rigid walls, against what impacts and simulations say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from drake_aigto import Plan, Planner, Scenario
from drake_aigto.planning import MechanismSearch, PlanOptions, RigidMechanismTask, lay_out
from drake_aigto.simulation import replay_event_driven
from drake_aigto.transcription import Touch

QUICK = PlanOptions(renewals=8, finalists=2)


@pytest.fixture(scope="module")
def pendulum() -> Planner:
    return Planner(Scenario.named("pendulum/off_the_wall"), QUICK)


@pytest.fixture(scope="module")
def plan(pendulum: Planner) -> Plan:
    return pendulum.plan()


@pytest.fixture(scope="module")
def throw() -> Plan:
    return Planner(Scenario.named("throwing_ball/bounces"), QUICK).plan()


def check_impacts(plan: Plan) -> None:
    """Asserts that the velocity jumps at knots as Newton's impact law has it."""
    world, t = plan.find_world(), plan.trajectory
    e = world.restitutions(plan.scenario)
    hit = np.flatnonzero(t.impulses.any(axis=1))
    assert len(hit) == len(plan.best.contacts)
    for k in hit:
        i = int(np.argmax(t.impulses[k]))
        J = world.calc_contact_jacobian(t.positions[k])[i]
        jump = world.calc_velocity_change(t.positions[k], t.impulses[k])
        assert world.calc_signed_distance(t.positions[k])[i] == pytest.approx(0, abs=1e-9)
        assert J @ t.velocities[k] < 0
        after = J @ (t.velocities[k] + jump)
        assert after == pytest.approx(-e[i] * (J @ t.velocities[k]), abs=1e-9)


@pytest.mark.parametrize("restitution", [0.4, 0.0])
@pytest.mark.parametrize("lasts", [True, False])
def test_contact_is_held_from_an_impact_on_only_where_bodies_do_not_bounce_off(
    pendulum: Planner, restitution: float, lasts: bool
) -> None:
    scenario = dataclasses.replace(pendulum.scenario, restitution=restitution)
    planner, T = Planner(scenario, QUICK), scenario.duration
    task = planner.task
    assert isinstance(task, RigidMechanismTask)
    motion = task.bounce((Touch(0.4 * T, (0.7 if lasts else 0.4) * T, 0),), None)
    replay = replay_event_driven(planner.world, scenario, motion.times, motion.controls)
    is_kept = replay.cost == pytest.approx(motion.cost, rel=1e-3)
    assert is_kept == (restitution == 0 or not lasts)
    assert task.rank(motion)[0] == (not is_kept), "what a simulation breaks ranks after all else"


@pytest.mark.slow
def test_a_bounce_that_leads_to_the_goal_by_itself_is_given_the_time_for_it(
    pendulum: Planner,
) -> None:
    scenario = dataclasses.replace(pendulum.scenario, duration_range=(0.7, 2.5))
    options = dataclasses.replace(QUICK, confirm=False)
    plan = Planner(scenario, options, pendulum.world).plan()
    assert plan.cost < 1e-9
    assert len(plan.best.contacts) == 1
    T = plan.trajectory.times[-1]
    passed = replay_event_driven(pendulum.world, scenario, np.array([0.0, T]), np.zeros((1, 1)))
    assert len(passed.bounce_times) == 1
    np.testing.assert_allclose(passed.positions[-1], scenario.goal_position, atol=1e-5)


def test_the_pendulum_comes_back_off_the_wall(plan: Plan) -> None:
    assert plan.holds
    assert [contact.index for contact in plan.best.contacts] == [0]
    assert plan.best.energy_ratio == pytest.approx(0.8**2, rel=1e-9)
    assert plan.idle is not None
    assert plan.cost < plan.idle.cost / 100
    check_impacts(plan)


@pytest.mark.slow
def test_a_plan_costs_what_it_promises_in_both_simulations(plan: Plan, throw: Plan) -> None:
    for each in (plan, throw):
        assert each.replay.event_driven.cost == pytest.approx(each.cost, rel=1e-6)
        assert each.replay.drake is not None
        assert each.replay.drake.cost == pytest.approx(each.cost, rel=0.02)
        assert max(each.defects.values()) < 1e-9


@pytest.mark.slow
def test_a_thrown_ball_bounces_six_times(throw: Plan) -> None:
    """With five bounces the same task costs 11.3, with seven 7.1."""
    assert throw.holds
    assert len(throw.best.contacts) == 6
    assert throw.cost < 6.31
    assert np.linalg.norm(throw.trajectory.controls, axis=1).max() <= 9 * (1 + 1e-12)
    check_impacts(throw)


@pytest.mark.slow
def test_no_motion_that_misses_much_of_a_hard_goal_is_taken_for_a_cheap_one() -> None:
    """By continuation from the shipped throw, six bounces cost 9.313."""
    scenario = dataclasses.replace(
        Scenario.named("throwing_ball/bounces"),
        initial_position=[0.0, 0.51338337],
        goal_position=[3.86148829, 0.51338337],
        restitution=0.8594073825461525,
    )
    plan = Planner(scenario, dataclasses.replace(QUICK, confirm=False)).plan()
    assert plan.holds
    assert plan.cost < 9.33


def test_who_needs_no_wall_touches_none(pendulum: Planner) -> None:
    free = pendulum.plan(initial_velocity=[0.0], duration=0.3)
    assert free.holds
    assert not free.best.contacts
    assert free.replay.event_driven.max_penetration == 0


@pytest.mark.slow
def test_who_starts_fast_towards_a_wall_hits_it_instead_of_braking() -> None:
    """A search over times and speeds of bounces knows 0.1391; to brake and graze costs 0.387."""
    scenario = dataclasses.replace(
        Scenario.named("pendulum/off_the_wall"),
        initial_position=[0.19013523],
        initial_velocity=[-4.36506404],
        goal_position=[-0.11252498],
        duration=1.04,
        restitution=0.5,
    )
    plan = Planner(scenario, dataclasses.replace(QUICK, renewals=0, confirm=False)).plan()
    assert plan.holds
    assert plan.cost < 0.1395


@pytest.mark.slow
def test_what_costs_more_than_a_finalist_that_holds_is_left_before_it_meets_its_walls() -> None:
    class Task(RigidMechanismTask):
        polish_ratio = np.inf

    planner, options = Planner(Scenario.named("paddle/bat")), PlanOptions(renewals=0, starts=8)
    problem = Task(planner.world, planner.scenario, options)
    search = MechanismSearch(problem)
    search.run()
    (best,) = search.candidates
    motion = search.motions[1].result
    closed, left = problem.polish(motion), problem.polish(motion, most=best.cost)
    assert closed.cost > 1.01 * best.cost
    assert closed.violation < 1e-9 < left.violation


@pytest.mark.slow
def test_a_motion_that_is_best_in_the_steps_of_the_search_is_polished_in_them() -> None:
    """It has fewer of them than the scenario, and so have the distances that it keeps off walls."""
    scenario = dataclasses.replace(
        Scenario.named("cart_pole/rigid_06"),
        goal_position=[0.04490026932956917, 3.224243271730047],
        duration=1.602175676915813,
        time_step=1.602175676915813 / 64,
    )
    plan = Planner(scenario, PlanOptions(renewals=0, seed=1, confirm=False)).plan()
    assert plan.holds
    assert plan.cost < 80


@pytest.mark.slow
def test_a_wall_that_would_be_grazed_is_passed_at_a_distance() -> None:
    scenario = Scenario.named("cart_pole/rigid_06")
    plan = Planner(dataclasses.replace(scenario, restitution=0.5), QUICK).plan()
    assert plan.holds
    assert plan.replay.event_driven.cost == pytest.approx(plan.cost, rel=1e-4)
    assert plan.cost < 80.6
    check_impacts(plan)


@pytest.mark.parametrize("times", [[], [0.0, 0.0, 0.0], [1.0, 1.0], [0.1, 0.5, 0.50001, 0.99]])
def test_knots_are_at_touches_and_rise_however_crowded_these_are(times: list[float]) -> None:
    touches = tuple(Touch.bounce(time) for time in times)
    knots, phases = lay_out(touches, 6, 1.0, (1.0, 1.0), 1)
    assert knots[0] == 0.0
    assert knots[-1] == 1.0
    assert np.all(np.diff(knots) > 0)
    assert np.all((phases.knots > 0) & (phases.knots < 6))
    np.testing.assert_allclose(knots[phases.knots], np.cumsum(phases.durations)[:-1])
