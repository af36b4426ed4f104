"""Plans for mechanisms: what shooting makes of boxes, against simulations and other methods."""

from __future__ import annotations

import dataclasses
import gc
import threading
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from marks import slow
from pydrake.geometry import AddContactMaterial, HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import FixedOffsetFrame, RevoluteJoint, SpatialInertia
from pydrake.systems.framework import DiagramBuilder

from drake_aigto import Plan, Planner, PlanningError, Scenario, World
from drake_aigto.errors import ModelError, OptionsError
from drake_aigto.planning import (
    BALL_LADDER,
    Aim,
    Candidate,
    Guess,
    MechanismSearch,
    MechanismTask,
    PlanOptions,
    PlanStats,
    Proposal,
    Replays,
    RigidMechanismTask,
    lay_out,
    make_mechanism_task,
)
from drake_aigto.shooting import ShootingProblem, ShootingResult
from drake_aigto.simulation import replay_event_driven
from drake_aigto.transcription import Touch

QUICK = PlanOptions(renewals=16, finalists=1)


@pytest.fixture(scope="module")
def cart_pole() -> Planner:
    return Planner(Scenario.named("cart_pole/soft_06"), QUICK)


@pytest.fixture(scope="module")
def plan(cart_pole: Planner) -> Plan:
    return Planner(cart_pole.scenario, PlanOptions(), cart_pole.world).plan()


@pytest.mark.parametrize("name", ["cart_pole/soft_06", *slow("puck/spin")])
def test_contact_that_steps_cannot_resolve_is_refused_with_the_stiffness_that_they_can(
    name: str,
) -> None:
    material: Any = {"*": {"stiffness": 2e9}}
    scenario = Scenario.named(name)
    stiff = dataclasses.replace(scenario, material=material, duration=10 * scenario.time_step)
    with pytest.raises(ModelError, match=r"a stiffness of 1e\+09 N/m.*at most") as refused:
        Planner(stiff, QUICK).plan()
    assert refused.value.remedy is not None and "contact: rigid" in refused.value.remedy
    # What is said to be possible is searched.
    most = float(str(refused.value.expected).split()[2])
    material = {"*": {"stiffness": 2 * most}}
    soft = dataclasses.replace(stiff, material=material)
    task = Planner(soft, QUICK).task
    assert isinstance(task, MechanismTask)
    none = np.zeros((1, task.world.num_actuators))
    assert np.isfinite(task.close(Guess(np.array([0.0, soft.duration]), none), Aim()).cost)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        (7, "found 7 times in 60 searches"),
        (1, "found once in 60 searches: more renewals"),
        (0, "found in none of 60 other searches: more renewals"),
    ],
)
def test_a_plan_says_how_often_it_was_found(found: int, words: str) -> None:
    assert str(PlanStats(0, 1, {}, searches=60, found=found)).startswith(words)


def test_the_pole_pushes_off_a_wall_to_stand_up_in_both_simulations(plan: Plan) -> None:
    assert plan.holds
    assert plan.best.contacts
    # No motion that 300 starts of shooting, or 60 of IPOPT, lead to costs less than 80.0.
    assert plan.cost < 80.1
    assert plan.replay.drake is not None
    assert plan.replay.drake.cost == pytest.approx(plan.replay.event_driven.cost, rel=1e-6)
    assert plan.cost == pytest.approx(plan.replay.event_driven.cost, rel=1e-3)
    assert plan.defects["integration"] < 1e-6
    assert np.all(np.abs(plan.trajectory.controls) <= 20.0)


def test_bounds_hold_in_both_simulations(cart_pole: Planner) -> None:
    scenario = dataclasses.replace(cart_pole.scenario, position_lower=[-0.2, -np.inf])
    bounded = Planner(scenario, QUICK, cart_pole.world).plan()
    for replay in bounded.replay:
        assert replay.violations["bounds"] < 1e-3
        assert np.min(replay.positions[:, 0]) > -0.202
    assert bounded.additions == ()


def test_what_nothing_controls_costs_what_its_simulation_does_whatever_shorter_steps_say(
    cart_pole: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ShootingProblem, "refine_cost", None)
    idle = cart_pole.task.idle_candidate()
    assert (idle.cost, idle.cost_error) == (idle.replay.cost, None)


def test_what_passes_its_bounds_between_knots_has_narrower_ones_there(cart_pole: Planner) -> None:
    scenario = dataclasses.replace(cart_pole.scenario, velocity_upper=[np.inf, 3.5])
    problem = MechanismTask(cart_pole.world, scenario, QUICK)
    motion, candidate = problem.coast, problem.idle_candidate()
    fastest = float(np.max(candidate.replay.velocities[:, 1]))
    assert fastest > 3.6
    narrowed = problem.narrowed(motion, candidate)
    assert narrowed is not None
    within = narrowed.bounds.velocity
    np.testing.assert_allclose(within[1], [np.inf, 7.0 - fastest])
    np.testing.assert_array_equal(within[0], [-np.inf, -np.inf])
    problem.lead = np.full(4, 1e-3)  # It stays where bounds alone are narrowed.
    other = problem.narrowed(motion, candidate)
    assert other is not None and np.array_equal(other.lead, problem.lead)
    # The cart's bounds are narrower, too, and can't hold at the first knots; they end the updates.
    slow = narrowed.tighten(motion)
    assert np.max(slow.states[1:, 3]) < 7.0 - fastest + 1e-2


@pytest.mark.slow
def test_what_passes_its_bounds_from_starts_that_are_off_is_polished_within_narrower_ones(
    cart_pole: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, leftmost = MechanismTask.judge, list[float]()

    def exceed_at_first(problem: MechanismTask, *motion: Any) -> Candidate:
        found = judge(problem, *motion)
        replay, is_first = found.replay, not leftmost
        if found.is_idle:
            return found
        leftmost.append(float(np.min(replay.positions[:, 0])))
        positions = replay.positions - [0.01, 0.0]
        off = dataclasses.replace(replay, positions=positions, violations={"bounds": 0.01})
        return dataclasses.replace(found, perturbed=(replay, off)) if is_first else found

    monkeypatch.setattr(MechanismTask, "judge", exceed_at_first)
    scenario = dataclasses.replace(cart_pole.scenario, position_lower=[-0.2, -np.inf])
    assert Planner(scenario, QUICK, cart_pole.world).plan().holds
    assert -0.202 < leftmost[0] < -0.199 and leftmost[1] > -0.192


@pytest.mark.slow
def test_what_ends_beside_a_hard_goal_is_polished_to_end_on_its_other_side(
    cart_pole: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, ends, beside = MechanismTask.judge, list[Any](), np.array([2e-3, -1e-3])

    def miss_at_first(problem: MechanismTask, *motion: Any) -> Candidate:
        found = judge(problem, *motion)
        if found.is_idle:
            return found
        ends.append(found.trajectory.positions[-1])
        positions = found.replay.positions + beside
        off = dataclasses.replace(found.replay, positions=positions, violations={"hard goal": 0.01})
        return dataclasses.replace(found, replay=off) if len(ends) == 1 else found

    monkeypatch.setattr(MechanismTask, "judge", miss_at_first)
    goal = np.array([0.05, np.pi])
    scenario = dataclasses.replace(cart_pole.scenario, hard_goal=True, goal_position=goal)
    Planner(scenario, QUICK, cart_pole.world).plan()
    np.testing.assert_allclose(ends[0], goal, atol=1e-4)
    np.testing.assert_allclose(ends[1], goal - beside, atol=1e-4)


@pytest.mark.slow
def test_what_simulations_contradict_gives_way_to_what_was_left_out_for_it(
    cart_pole: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    # One finalist is asked for. The first is contradicted; the next is polished then, and chosen.
    first, seen = cart_pole.plan(), list[Candidate]()
    assert len(first.candidates) == 2 and first.candidates[1].is_idle

    def contradict_the_first(problem: MechanismTask, candidate: Candidate) -> Replays:
        seen.append(candidate)
        replay = candidate.replay
        worse = dataclasses.replace(replay, simulator="drake", cost=2 * replay.cost)
        return Replays(replay, worse if candidate is seen[0] else None)

    monkeypatch.setattr(MechanismTask, "confirm", contradict_the_first)
    other = cart_pole.plan()
    assert other.best is seen[1] and other.holds and not other.best.is_idle
    assert other.cost > first.cost
    (veto,) = other.vetoes
    assert veto.candidate.cost == first.cost


@pytest.mark.slow
def test_a_finalist_whose_simulation_costs_far_more_lets_the_next_one_have_its_turn(
    cart_pole: Planner, monkeypatch: pytest.MonkeyPatch
) -> None:
    judge, judged = MechanismTask.judge, list[float]()

    def wreck_the_first(*arguments: Any) -> Candidate:
        found = judge(*arguments)
        if found.is_idle:
            return found
        judged.append(found.replay.cost)
        times = 3 if len(judged) == 1 else 1
        replay = dataclasses.replace(found.replay, cost=times * found.replay.cost)
        return dataclasses.replace(found, cost=times * found.cost, replay=replay)

    monkeypatch.setattr(MechanismTask, "judge", wreck_the_first)
    plan = cart_pole.plan()
    assert len(judged) == 2
    assert plan.best.replay.cost == judged[1] < 3 * judged[0]


def test_a_hard_goal_is_met_in_both_simulations() -> None:
    scenario = Scenario.named("acrobot/swing_up")
    scenario = dataclasses.replace(scenario, hard_goal=True, goal_velocity=[0.0, 0.0])
    for replay in Planner(scenario, QUICK).plan().replay:
        assert replay.violations["hard goal"] < 1e-3
        np.testing.assert_allclose(replay.positions[-1], [np.pi, 0.0], atol=1e-3)


@pytest.mark.slow
def test_what_misses_a_hard_goal_is_no_plan(cart_pole: Planner) -> None:
    scenario = dataclasses.replace(cart_pole.scenario, hard_goal=True, control_upper=0.1)
    options = dataclasses.replace(QUICK, renewals=0, starts=3)
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
    options = PlanOptions(threads=1)
    other = Planner(cart_pole.scenario, options, cart_pole.world).plan()
    np.testing.assert_array_equal(other.trajectory.controls, plan.trajectory.controls)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        *slow(("cart_pole/soft_06", PlanOptions(renewals=0, starts=4, confirm=False, threads=2))),
        ("room/bank_shot", PlanOptions(confirm=False, threads=2)),
    ],
)
def test_garbage_is_collected_in_the_main_thread_while_a_search_has_others(
    name: str, options: PlanOptions
) -> None:
    """Drake ends the process where another thread frees a Meshcat, which Diagrams hold."""
    collecting: set[threading.Thread] = set()

    def see(*_: Any) -> None:
        collecting.add(threading.current_thread())

    usual = gc.get_threshold()
    gc.callbacks.append(see)
    gc.set_threshold(20)
    try:
        Planner(Scenario.named(name), options).plan()
    finally:
        gc.set_threshold(*usual)
        gc.callbacks.remove(see)
    assert collecting == {threading.main_thread()}


@pytest.mark.slow
def test_plans_on_the_way_hold_and_the_last_one_is_that_of_planning_anew(
    cart_pole: Planner,
) -> None:
    *before, again = cart_pole.plans(initial_position=[0.2, 0.1])
    assert before and all(each.holds for each in before)
    assert all(later.cost < 0.99 * each.cost for each, later in pairwise(before))
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


def make_light_arm() -> World:
    """Returns rods that hang from each other's ends before a wall; the second one is passive."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    yields = ProximityProperties()
    AddContactMaterial(0.0, 400.0, CoulombFriction(0.0, 0.0), yields)
    parent, below = plant.world_body(), RigidTransform()
    for number, length in enumerate((0.4, 0.3, 0.2)):
        rod = SpatialInertia.ThinRodWithMassAboutEnd(0.5, length, [0.0, 0.0, -1.0])
        child = plant.AddRigidBody(f"link{number}", rod)
        hinge = plant.AddJoint(
            RevoluteJoint(
                f"hinge{number}",
                plant.AddFrame(FixedOffsetFrame(f"pin{number}", parent.body_frame(), below)),
                child.body_frame(),
                [0.0, -1.0, 0.0],
            )
        )
        if number != 1:
            plant.AddJointActuator(f"motor{number}", hinge)
        parent, below = child, RigidTransform([0.0, 0.0, -length])
    plant.RegisterCollisionGeometry(parent, below, Sphere(0.03), "tip", yields)
    wall = RigidTransform(RotationMatrix.MakeYRotation(-np.pi / 2), [0.5, 0.0, 0.0])
    plant.RegisterCollisionGeometry(plant.world_body(), wall, HalfSpace(), "wall", yields)
    plant.Finalize()
    return World.from_diagram(builder.Build())


@pytest.mark.slow
def test_light_links_that_cheap_controls_fling_about_are_led_to_the_goal_with_care() -> None:
    scenario = Scenario(
        model="arm",
        initial_position=np.zeros(3),
        initial_velocity=np.zeros(3),
        goal_position=[0.9, 0.0, 0.0],
        goal_velocity_weight=1.0,
        goal_weight=100.0,
        control_weight=0.01,
        duration=1.5,
        time_step=0.025,
        contact="compliant",
    )
    problem = MechanismTask(make_light_arm(), scenario, PlanOptions())
    guesses, rng = problem.guesses, np.random.default_rng(0)
    centers = [guesses.draw(start, rng) for start in guesses.starts for _ in range(2)]
    rough = [problem.close(center, Aim(is_patient=False)) for center in centers]
    careful = [problem.close(center, Aim()) for center in centers]
    # Without control it costs 81.
    assert min(motion.cost for motion in careful) < 2.0
    for one, other in zip(rough, careful, strict=True):
        assert not problem.rank(one) < problem.rank(other)
        assert one == other or not problem.is_of_use(one)
    assert sum(map(problem.is_of_use, rough)) < sum(map(problem.is_of_use, careful))


@pytest.mark.slow
def test_what_is_near_a_motion_that_a_simulation_contradicts_is_judged_too() -> None:
    class Watched(MechanismTask):
        judged: ClassVar[list[ShootingResult]] = []

        def judge(self, *args: Any) -> Candidate:
            candidate, wrong = super().judge(*args), not self.judged
            self.judged.append(args[1])
            replay = dataclasses.replace(candidate.replay, cost=2 * candidate.replay.cost)
            return dataclasses.replace(candidate, replay=replay) if wrong else candidate

    scenario = Scenario.named("cart_pole/soft_06")
    options = dataclasses.replace(QUICK, renewals=0)
    search = MechanismSearch(Watched(World.from_scenario(scenario), scenario, options))
    search.explore()
    best = search.motions[0]
    search.motions = [dataclasses.replace(best) for _ in range(3)]
    search.judge()
    assert len(Watched.judged) == 2  # The third one is near one that holds.
    assert [each.is_confirmed for each in search.candidates] == [False, True]


def test_a_search_ends_once_its_patience_would_find_less_than_one_better_motion() -> None:
    class Watched(MechanismSearch):
        def vary(self) -> Iterator[Sequence[Proposal]]:
            for wave in super().vary():
                chances.append(self.chance)
                yield wave
            chances.append(self.chance)

    chances: list[float] = []
    scenario, options = Scenario.named("acrobot/swing_up"), PlanOptions(patience=192)
    search = Watched(MechanismTask(World.from_scenario(scenario), scenario, options))
    search.explore()
    assert 1 < len(chances) < options.renewals / 8
    assert chances[-1] < 1 / options.patience <= min(chances[:-1])


def find_again(name: str, count: int) -> Iterator[MechanismSearch]:
    """Yields a search after each time that it closed its first proposal."""
    scenario = Scenario.named(name)
    search = MechanismSearch(MechanismTask(World.from_scenario(scenario), scenario, QUICK))
    first, *_ = next(search.propose())
    for _ in range(count):
        search.close([first])
        yield search


def test_the_chance_of_a_better_motion_falls_with_every_time_that_the_best_is_found() -> None:
    for count, search in enumerate(find_again("cart_pole/soft_06", 4), 1):
        assert search.found == search.searches == count
        assert search.chance == pytest.approx((1.5 if count == 1 else 0.5) / (count * (count + 1)))


def test_how_often_a_motion_is_found_tells_nothing_while_it_saves_less_than_half() -> None:
    *_, search = find_again("spinner/two_radians", 8)
    best, idle = search.motions[0], search.task.coast.cost
    for part, chance in ((0.45, 0.5 / (8 * 9)), (0.55, 1.0)):
        search.motions = [dataclasses.replace(best, rank=(False, part * idle))]
        assert search.found == 8 and search.chance == pytest.approx(chance)


@pytest.mark.slow
def test_a_motion_without_control_that_misses_a_hard_goal_is_no_better_one() -> None:
    scenario = Scenario.named("sliding_block/to_rest")
    task = make_mechanism_task(World.from_scenario(scenario), scenario, QUICK)
    search = MechanismSearch(task)
    waves = search.propose()
    search.close(next(waves))
    assert task.price(task.coast) < search.promise
    assert search.chance < 1.0


@pytest.mark.slow
def test_a_search_that_found_nothing_but_the_motion_without_control_goes_on() -> None:
    *_, search = find_again("push_circle/round_it", 8)
    assert search.found == 8 and search.promise >= 0.99 * search.task.coast.cost
    assert search.chance == 1.0


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("cart_pole/soft_06", {"aigo_steps": 9}, "aigo_steps: got 9 for a mechanism, expected the"),
        ("cart_pole/soft_06", {"ladder": BALL_LADDER}, "ladder: got .*only for balls between"),
        ("cart_pole/rigid_06", {"local_solver": "ipopt"}, "local_solver: got ipopt"),
        ("table1/1", {"renewals": 9}, "renewals: got 9 for balls between"),
        ("table1/1", {"seed": 1}, "seed: got 1 for balls .*It counts only for a mechanism"),
        ("table1/1", {"starts": 3}, "starts: got 3 for balls .*only for a mechanism"),
    ],
)
def test_options_that_would_not_count_are_refused(
    name: str, given: dict[str, Any], message: str
) -> None:
    with pytest.raises(OptionsError, match=message):
        Planner(Scenario.named(name), PlanOptions(**given))


QUICKER = PlanOptions(renewals=8, finalists=2)


@pytest.fixture(scope="module")
def pendulum() -> Planner:
    return Planner(Scenario.named("pendulum/off_the_wall"), QUICKER)


@pytest.fixture(scope="module")
def swing(pendulum: Planner) -> Plan:
    return pendulum.plan()


@pytest.fixture(scope="module")
def throw() -> Plan:
    return Planner(Scenario.named("throwing_ball/bounces"), QUICKER).plan()


def check_impacts(swing: Plan) -> None:
    """Asserts that the velocity jumps at knots as Newton's impact law has it."""
    world, t = swing.find_world(), swing.trajectory
    e = world.restitutions(swing.scenario)
    hit = np.flatnonzero(t.impulses.any(axis=1))
    assert len(hit) == len(swing.best.contacts)
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
    planner, T = Planner(scenario, QUICKER), scenario.duration
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
    options = dataclasses.replace(QUICKER, confirm=False)
    swing = Planner(scenario, options, pendulum.world).plan()
    assert swing.cost < 1e-9
    assert len(swing.best.contacts) == 1
    T = swing.trajectory.times[-1]
    passed = replay_event_driven(pendulum.world, scenario, np.array([0.0, T]), np.zeros((1, 1)))
    assert len(passed.bounce_times) == 1
    np.testing.assert_allclose(passed.positions[-1], scenario.goal_position, atol=1e-5)


def test_the_pendulum_comes_back_off_the_wall(swing: Plan) -> None:
    assert swing.holds
    assert [contact.index for contact in swing.best.contacts] == [0]
    assert swing.best.energy_ratio == pytest.approx(0.8**2, rel=1e-9)
    assert swing.idle is not None
    assert swing.cost < swing.idle.cost / 100
    check_impacts(swing)


@pytest.mark.slow
def test_a_plan_costs_what_it_promises_in_both_simulations(swing: Plan, throw: Plan) -> None:
    for each in (swing, throw):
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


def test_who_needs_no_wall_touches_none(pendulum: Planner) -> None:
    free = pendulum.plan(initial_velocity=[0.0], duration=0.3)
    assert free.holds
    assert not free.best.contacts
    assert free.replay.event_driven.max_penetration == 0


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
def test_a_wall_that_would_be_grazed_is_passed_at_a_distance() -> None:
    scenario = Scenario.named("cart_pole/rigid_06")
    swing = Planner(dataclasses.replace(scenario, restitution=0.5), QUICKER).plan()
    assert swing.holds
    assert swing.replay.event_driven.cost == pytest.approx(swing.cost, rel=1e-4)
    assert swing.cost < 80.6
    check_impacts(swing)


@pytest.mark.parametrize("times", [[], [0.0, 0.0, 0.0], [1.0, 1.0], [0.1, 0.5, 0.50001, 0.99]])
def test_knots_are_at_touches_and_rise_however_crowded_these_are(times: list[float]) -> None:
    touches = tuple(Touch.bounce(time) for time in times)
    knots, phases = lay_out(touches, 6, 1.0, (1.0, 1.0), 1)
    assert knots[0] == 0.0
    assert knots[-1] == 1.0
    assert np.all(np.diff(knots) > 0)
    assert np.all((phases.knots > 0) & (phases.knots < 6))
    np.testing.assert_allclose(knots[phases.knots], np.cumsum(phases.durations)[:-1])
