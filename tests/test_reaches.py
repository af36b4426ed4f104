"""Hands that push at once, and reach anew where they can't follow the object."""

from __future__ import annotations

from itertools import combinations, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from space_models import SPHERE, ball_and_finger, collision, link, make_scenario, slider

from benchmarks.space import count_held
from drake_aigto import Planner, PlanOptions, Scenario, World, scenario_names
from drake_aigto.arrays import Floats, Ints
from drake_aigto.contact import CompliantLaw, contact_law
from drake_aigto.errors import OptionsError
from drake_aigto.planning import Aim, MechanismTask, Reaches
from drake_aigto.shooting import limit_states
from drake_aigto.simulation import replay_drake, replay_event_driven
from drake_aigto.world import SpaceWorld, TaskCost

SECOND = (
    link("other", 0.1, collision("end", SPHERE))
    + link("along2", 0.01, "")
    + link("across2", 0.01, "")
    + slider("x2", "world", "along2", "1 0 0")
    + slider("y2", "along2", "across2", "0 1 0")
    + slider("z2", "across2", "other", "0 0 1")
)
# Two fingers that a palm carries, which slides along x, y and z; they slide along x.
GRIPPER = (
    link("palm", 0.05, "")
    + link("other", 0.1, collision("end", SPHERE))
    + slider("left", "palm", "finger", "1 0 0")
    + slider("right", "palm", "other", "-1 0 0")
)
# A jaw that slides on the finger, which stands still on its palm.
JAW = link("other", 0.1, collision("end", SPHERE)) + slider("jaw", "finger", "other", "-1 0 0")
MOST = 0.07  # that fingers move along y [m]


class Fingers(NamedTuple):
    """Two fingers beside a ball that has to turn, and what finds where they push."""

    world: SpaceWorld
    start: Floats
    sliders: Ints  # their velocities, x, y and z of each, shape (2, 3)
    reaches: Reaches


@pytest.fixture(scope="module")
def fingers(tmp_path_factory: pytest.TempPathFactory) -> Fingers:
    """Returns two fingers that touch a ball from both sides; its goal is turned by 120°."""
    turned = {"xyz": [0.0, 0.0, 0.0493], "rpy_deg": [0.0, 0.0, 120.0]}
    scenario = make_scenario(
        tmp_path_factory.mktemp("fingers"),
        ball_and_finger(more=SECOND),
        initial_position={
            "thing": {"xyz": [0, 0, 0.0493]}, "x": -0.1, "z": 0.0493, "x2": 0.1, "z2": 0.0493,
        },
        initial_velocity=[0.0] * 12,
        goal_position={"thing": turned},
        goal_weight={"thing": {"xyz": 10.0, "turn": 1.0}},
    )  # fmt: skip
    world = World.from_scenario(scenario)
    assert isinstance(world, SpaceWorld)
    scenario = world.place(scenario)
    law = contact_law(world, scenario)
    assert isinstance(law, CompliantLaw)
    names = (("x", "y", "z"), ("x2", "y2", "z2"))
    sliders = [[world.plant.GetJointByName(n).velocity_start() for n in each] for each in names]
    limits = limit_states(world, world.bounds(scenario))[:, :12]
    limits[:, np.array(sliders)[:, 1]] = [[-MOST], [MOST]]
    reaches = Reaches(world, law, TaskCost.of(world, scenario), np.full(12, 0.1), limits, 1.0)
    return Fingers(world, np.array(scenario.initial_position), np.array(sliders), reaches)


def test_a_hand_reaches_where_it_pushes_the_object_along_and_sticks_to_it(tmp_path: Path) -> None:
    world = World.from_scenario(scenario := make_scenario(tmp_path))
    assert isinstance(world, SpaceWorld)
    scenario = world.place(scenario)
    cost, start = TaskCost.of(world, scenario), scenario.initial_position
    law = contact_law(world, scenario)
    assert isinstance(law, CompliantLaw)
    limits = limit_states(world, world.bounds(scenario))[:, :9]
    reaches = Reaches(world, law, cost, np.full(9, 0.3), limits, 1.0)
    assert [world.contacts[i].name for i in reaches.contacts] == ["m::ball with m::tip"]
    times = np.linspace(0.0, 1.0, 51)
    path, contacts, end = reaches.find_stroke(start, 50, 0.4, np.random.default_rng(0))
    pushed = np.array([bool(each) for each in contacts] + [False])
    assert 25 <= end <= 50 and 0.55 * end <= np.count_nonzero(pushed) <= 0.65 * end + 1
    assert np.all(np.abs(world.calc_signed_distance(path)[pushed, reaches.contacts]) < 2e-3)
    (ball,) = (world.plant.GetJointByName("thing").position_start() + 4,)
    between = path[:, ball : ball + 3] - path[:, :3]
    assert np.all(np.ptp(between[pushed], axis=0) < 2e-3)  # It sticks,
    assert np.mean(between[pushed, 0]) > 0.95 * 0.1  # behind the ball, whose way is along x.
    np.testing.assert_allclose(world.subtract(path[-1], scenario.goal_position)[6:], 0, atol=1e-9)
    bounds, state = np.array([[-10.0] * 3, [10.0] * 3]), (start, scenario.initial_velocity)
    controls, known = reaches.push(times, state, 0.4, bounds, np.random.default_rng(0))
    replay = replay_event_driven(world, scenario, times, controls)
    assert replay.positions[-1, ball] > 0.1  # Contact does the rest.
    assert known is not None  # Nothing is carried that could be lost.
    np.testing.assert_allclose(known, np.hstack(replay.states_at(times)), atol=1e-3)


def test_two_hands_turn_an_object_without_moving_it_and_one_can_not(fingers: Fingers) -> None:
    first = fingers.world.plant.GetJointByName("thing").velocity_start()
    wanted = np.zeros(12)
    wanted[first + 2] = 0.01  # [N m], about z.
    one, other = fingers.reaches.contacts.tolist()
    both, off = fingers.reaches.calc_push(fingers.start, wanted, (one, other))
    np.testing.assert_allclose(both[first : first + 6], wanted[first : first + 6], atol=1e-9)
    assert off < 1e-9
    # Each presses, with at least what friction needs: 0.1 N for each, at 0.05 m, of 0.5 of these.
    press = np.abs(both[fingers.sliders[:, 0]])
    assert np.all(press > 0.1 / 0.5)
    for each in (one, other):
        assert fingers.reaches.calc_push(fingers.start, wanted, (each,))[1] > 0.1


def test_hands_stay_within_limits_and_stick_until_they_reach_anew(fingers: Fingers) -> None:
    world, rng, q, total = fingers.world, np.random.default_rng(0), fingers.start, 0.0
    turn, count = world.plant.GetJointByName("thing").velocity_start() + 2, 0
    while total < np.deg2rad(100.0):
        count += 1
        path, contacts, end = fingers.reaches.find_stroke(q, 100, 0.3, rng)
        across = world.in_tangent(path, np.zeros(1))[:, fingers.sliders[:, 1]]
        assert np.all(np.abs(across) <= MOST + 1e-12)
        for k, (each, then) in enumerate(pairwise(contacts)):
            way = world.subtract(path[k + 1], path[k])
            total += way[turn]
            if each and each == then:
                slips = world.relate(path[k])[2][list(each)] @ way
                assert np.all(np.linalg.norm(slips, axis=1) < 0.3 * 0.05 * abs(way[turn]) + 1e-3)
        np.testing.assert_allclose(path[end:], np.tile(path[end], (101 - end, 1)), atol=1e-12)
        q = path[end]
    assert 1 < count < 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "at"),
    [
        (ball_and_finger(more=SECOND), {"x": -0.12, "z": 0.0493, "x2": 0.12, "z2": 0.0493}),
        (
            ball_and_finger(more=GRIPPER).replace("<child>finger<", "<child>palm<", 1),
            {"z": 0.0493, "left": -0.12, "right": -0.12},
        ),
        (ball_and_finger(more=JAW), {"x": -0.12, "z": 0.0493, "jaw": -0.24}),
    ],
    ids=["two hands", "one gripper", "one jaw"],
)
def test_hands_lift_an_object_that_would_fall_and_hold_it(
    tmp_path: Path, text: str, at: dict[str, float]
) -> None:
    scenario = make_scenario(
        tmp_path,
        text,
        initial_position={"thing": {"xyz": [0, 0, 0.0493]}} | at,
        initial_velocity={},
        goal_position={"thing": {"xyz": [0.0, 0.0, 0.11]}},
        stiction_speed=0.01,
        goal_weight={"thing": {"xyz": 10.0}},
    )
    task = Planner(scenario).task
    assert isinstance(task, MechanismTask) and isinstance(task.law, CompliantLaw)
    world, scenario = task.world, task.scenario
    assert isinstance(world, SpaceWorld)
    n, cost = world.num_velocities, TaskCost.of(world, scenario)
    limits = limit_states(world, task.bounds)[:, :n]
    reaches = Reaches(world, task.law, cost, np.full(n, 0.1), limits, 1.0)
    q = scenario.initial_position
    (height,) = (world.plant.GetJointByName("thing").position_start() + 6,)
    assert not reaches.is_carried(q)
    assert reaches.is_carried(q + 0.01 * np.eye(len(q))[height])
    bounds = np.array([[-20.0] * (n - 6), [20.0] * (n - 6)])
    times, ends = np.linspace(0.0, 1.0, 51), list[float]()
    for seed in range(6):
        state, rng = (q, np.zeros(n)), np.random.default_rng(seed)
        controls, _ = reaches.push(times, state, 0.3, bounds, rng)
        ends.append(replay_event_driven(world, scenario, times, controls).positions[-1, height])
    assert np.median(ends) > 0.1  # One that is let go lies at 0.05.


def make_far_turn() -> MechanismTask:
    """Returns the task of three fingertips that lift a cube and turn it by 1.9 rad."""
    plain = Scenario.named("three_fingers/lift").to_plain()
    tips = dict.fromkeys(("left_z", "right_z", "back_z"), 0.03)
    tips |= {"left_x": -0.1, "right_x": 0.1, "back_y": 0.1}
    start = {"cube": {"xyz": [0.0, 0.0, 0.02975], "rpy_deg": [0.0, 0.0, 25.0]}}
    goal = {"cube": {"xyz": [0.04, 0.02, 0.08], "rpy_deg": [20.0, 30.0, 130.0]}}
    plain |= {"initial_position": start | tips, "goal_position": goal, "duration": 3.0}
    task = Planner(Scenario.from_plain(plain)).task
    assert isinstance(task, MechanismTask)
    return task


def test_hands_lift_what_they_must_carry_at_once_and_take_it_to_its_goal() -> None:
    task, seen = make_far_turn(), 0
    scenario, world = task.scenario, task.world
    assert isinstance(world, SpaceWorld) and isinstance(task.law, CompliantLaw)
    limits = limit_states(world, task.bounds)[:, : world.num_velocities]
    cost = TaskCost.of(world, scenario)
    reaches = Reaches(world, task.law, cost, task.measures.position, limits, scenario.duration)
    corners = [i for i, each in enumerate(world.contacts) if "corner" in each.name]
    for seed in range(3):
        rng = np.random.default_rng(seed)
        path, contacts, end = reaches.find_stroke(scenario.initial_position, 60, 0.3, rng)
        first = next(k for k, each in enumerate(contacts) if each)
        if cost.goal_error(path[end]) < 0.01 * cost.goal_error(path[0]):
            seen += 1
            then = path[(3 * first + end) // 4 : end + 1]
            assert np.all(world.calc_signed_distance(then)[:, corners] > 0.005)
    assert seen > 0


def test_hands_that_lost_what_they_carry_try_a_grasp_that_differs_from_the_last() -> None:
    task = make_far_turn()
    start, reaches = task.scenario.initial_position, task.guesses._reaches
    ready: list[tuple[float, list[Floats], tuple[int, ...]]] = []
    assert reaches is not None
    rng, unit, grasps = np.random.default_rng(0), task.measures.position, list[Floats]()
    for _ in range(3):
        path, contacts, _ = reaches.find_stroke(start, 60, 0.3, rng, (), ready)
        grasps.append(path[next(k for k, each in enumerate(contacts) if each)])
        assert len(ready) > 0  # They are drawn once.
    for one, other in combinations(grasps, 2):
        assert np.max(np.abs(task.world.subtract(one, other)) / unit) > 0.1


@pytest.mark.slow  # Shooting over trees is compiled.
def test_where_hands_that_carry_were_simulated_to_is_known_and_polished_as_it_is() -> None:
    task = make_far_turn()
    guesses = (task.guesses.draw("push", np.random.default_rng(seed)) for seed in range(12))
    guess = next(each for each in guesses if each.known is not None)
    known, closed = task.read(guess), task.close(guess, Aim())
    assert known is not None and task.is_known(known) and not task.is_known(closed)
    np.testing.assert_array_equal(known.states, guess.known)
    polished = task.polish(known)
    assert polished.exact_cost == pytest.approx(known.cost, rel=0.05)
    np.testing.assert_allclose(polished.states, known.states, atol=0.02)


@pytest.mark.slow
def test_an_object_goes_where_one_hand_can_push_it_and_dampers_let_it(tmp_path: Path) -> None:
    planner = Planner(Scenario.named("push_tee/to_pose"))
    task = planner.task
    assert isinstance(task, MechanismTask) and isinstance(planner.world, SpaceWorld)
    scenario, times = task.scenario, np.linspace(0.0, 2.0, 51)
    task_cost = TaskCost.of(planner.world, scenario)
    limits = limit_states(planner.world, planner.world.bounds(scenario))[:, :5]
    law, start = contact_law(planner.world, scenario), scenario.initial_position
    assert isinstance(law, CompliantLaw)
    T = scenario.duration
    reaches = Reaches(planner.world, law, task_cost, task.measures.position, limits, T)
    bounds = planner.world.bounds(scenario).control
    ends = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        controls, _ = reaches.push(times, (start, 0 * start), 0.3, bounds, rng)
        replay = replay_event_driven(planner.world, scenario, times, controls)
        ends.append(task_cost.goal_error(replay.positions[-1]))
    # Half of them come nearer, the best one by far: shooting begins with these.
    before = task_cost.goal_error(start)
    assert np.median(ends) < 0.8 * before and min(ends) < 0.3 * before


@pytest.mark.slow  # Shooting over trees is compiled.
def test_candidates_have_as_many_substeps_as_are_asked_for(tmp_path: Path) -> None:
    planner = Planner(make_scenario(tmp_path), PlanOptions(search_substeps=9))
    scenario = planner.world.place(planner.scenario)
    plain = MechanismTask(planner.world, scenario, PlanOptions())
    asked = MechanismTask(planner.world, scenario, planner.options, plain._compiled)
    assert asked.tighten(asked.coast).substeps == 9 > plain.tighten(plain.coast).substeps
    with pytest.raises(OptionsError, match="search_substeps: got 0, expected 1 or more"):
        PlanOptions(search_substeps=0)


# 68 and 111 CPU s, with Drake's replay, compiled.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("planar_hand/turn", PlanOptions(renewals=16, finalists=1)),
        ("three_fingers/turn", PlanOptions(renewals=0, finalists=1)),
    ],
)
def test_fingers_turn_an_object_over_several_touches_and_both_replays_confirm_it(
    name: str, options: PlanOptions
) -> None:
    plan = Planner(Scenario.named(name), options).plan()
    assert plan.holds
    replays, arrival = list(plan.replay), plan.find_arrival()
    assert len(replays) == 2
    for replay in replays:
        assert replay.cost == pytest.approx(plan.cost, rel=0.02)
    assert len(plan.best.contacts) > 2
    assert arrival.distance is not None and arrival.distance < 0.05
    assert arrival.angle is not None and arrival.angle < 0.2


@pytest.mark.slow
def test_an_arm_picks_a_cube_up_between_a_fixed_jaw_and_one_that_turns() -> None:
    task = Planner(Scenario.named("arm_and_gripper/pick")).task
    assert isinstance(task, MechanismTask)
    off = list[float]()
    for seed in range(6):
        known = task.guesses.draw("push", np.random.default_rng(seed)).known
        end = task.scenario.initial_position if known is None else known[-1, :7]
        off.append(float(np.max(np.abs(end - task.scenario.goal_position)[4:])))
    assert sorted(off)[3] < 0.01  # [m, rad]; the cube has to rise by 0.08 m


@pytest.mark.slow  # 179 and 94 CPU s, with Drake's replay.
@pytest.mark.parametrize("name", ["three_fingers/flip", "three_fingers/lift"])
def test_fingers_take_a_cube_to_a_pose_in_the_air_and_hold_it(name: str) -> None:
    plan = Planner(Scenario.named(name), PlanOptions(renewals=0, finalists=1)).plan()
    assert plan.holds
    times = plan.trajectory.times
    for motion in (plan.trajectory, *plan.replay):
        rows = np.minimum(np.searchsorted(motion.times, times), len(motion.times) - 1)
        # As many steps as Jin (2024) asks for.
        assert count_held(motion.positions[rows], plan.scenario.goal_position) >= 20


@pytest.mark.slow  # 6 CPU s, compiled.
def test_an_arm_of_seven_joints_pushes_a_box_in_drake_as_the_search_says() -> None:
    planner = Planner(Scenario.named("arm_and_box/push"))
    task, world = planner.task, planner.world
    assert isinstance(task, MechanismTask)
    push = task.guesses.draw("push", np.random.default_rng([18, 0, 0]))
    found = task.close(push, Aim(substeps=32))  # In longer steps, friction creeps.
    scenario = task.scenario
    drake = replay_drake(world, scenario, found.times, found.controls)
    for q in (found.states[-1, : world.num_positions], drake.positions[-1]):
        assert np.linalg.norm((q - scenario.goal_position)[-3:]) < 0.05
    assert np.linalg.norm((scenario.initial_position - scenario.goal_position)[-3:]) > 0.2


@pytest.mark.slow  # 75 CPU s, compiled.
def test_a_ball_that_an_arm_throws_lies_in_a_box_at_the_end_in_drake_too() -> None:
    planner = Planner(
        Scenario.named("throwing_arm/into_the_box"), PlanOptions(renewals=16, finalists=1)
    )
    plan = planner.plan()
    assert plan.holds
    for motion in (plan.trajectory, *plan.replay):
        ball = motion.positions[-1, -3:] - [1.5, 0.5, 0.06]  # Off the box's middle; r = 0.04 m.
        assert np.all(np.abs(ball) < [0.1, 0.1, 0.02])  # Walls are 0.13 m off, and give way.
        assert np.max(motion.positions[:, -1]) > 0.2
        assert np.linalg.norm(motion.velocities[-1, -3:]) < 0.3


@pytest.mark.slow  # 40 CPU s, compiled.
def test_servos_that_follow_a_line_bring_a_quadruped_to_its_feet_in_drake_too() -> None:
    planner = Planner(Scenario.named("quadruped/leap_up"), PlanOptions(search_substeps=16))
    task, world = planner.task, planner.world
    assert isinstance(task, MechanismTask)
    found = task.polish(task.close(task.guesses.plain("line", 0.0, has_states=False), Aim()))
    asked = world, task.scenario, found.times, found.controls
    own, drake = replay_event_driven(*asked), replay_drake(*asked)
    assert drake.cost == pytest.approx(own.cost, rel=1e-5)
    assert drake.goal_error < 0.05  # [m, rad]
    assert task.idle_candidate().replay.goal_error > 1.0


@pytest.mark.slow  # 25 CPU s, compiled.
@pytest.mark.skipif("a1/step_ahead" not in scenario_names(), reason="the extra models")
def test_unitrees_a1_gets_ahead_within_the_limits_of_its_motors() -> None:
    options = PlanOptions(starts=4, renewals=0, finalists=1, search_substeps=32)
    plan = Planner(Scenario.named("a1/step_ahead"), options).plan()
    assert plan.holds and plan.reached
    assert 5.0 < np.max(np.abs(plan.trajectory.controls)) <= 33.5  # [N m]
    for motion in (plan.trajectory, *plan.replay):
        assert motion.positions[-1, 4] == pytest.approx(0.2, abs=0.02)  # [m]
        assert motion.positions[-1, 6] == pytest.approx(0.297, abs=0.01)


@pytest.mark.slow  # 15 CPU s each, compiled.
@pytest.mark.parametrize("way", [(0.3, 0.2), (-0.1, 0.3), (0.15, -0.4)])
def test_a_hopper_hops_to_all_sides_and_stands_upright_in_drake_too(
    way: tuple[float, float],
) -> None:
    plain = Scenario.named("space_hopper/hop").to_plain()
    asked = Scenario.from_plain({**plain, "goal_position": {"body": {"by": [*way, 0.0]}}})
    planner = Planner(asked, PlanOptions(starts=4, renewals=0, finalists=1))
    plan = planner.plan()
    assert plan.holds and plan.reached
    for motion in (plan.trajectory, *plan.replay):
        off = planner.world.subtract(motion.positions[-1], planner.scenario.goal_position)
        assert np.max(np.abs(off)) < 0.02  # [m, rad]
    assert max(planner.world.calc_signed_distance(plan.trajectory.positions)[:, 0]) > 0.02  # [m]


@pytest.mark.slow
def test_what_costs_far_more_than_kept_motions_after_wide_passes_is_left_there() -> None:
    task = Planner(Scenario.named("puck/spin")).task
    assert isinstance(task, MechanismTask)
    guess = task.guesses.plain("line")
    whole, same, dear = (task.close(guess, Aim(most, False)) for most in (np.inf, 1e2, 1e-6))
    assert dear.is_left and not (whole.is_left or same.is_left)
    assert dear.iterations < same.iterations and same.cost == whole.cost < 1e2
    refined, left = task.tighten(whole), task.tighten(whole, least=1e-6)
    assert left.is_left and not refined.is_left and refined.cost < left.cost


def test_a_ball_lies_still_in_a_hand_whose_servos_hold_it_open() -> None:
    scenario = Scenario.named("hand_and_ball/turn")
    world = World.from_scenario(scenario)
    assert isinstance(world, SpaceWorld)
    start = (scenario := world.place(scenario)).initial_position
    palm, *others = world.calc_signed_distance(start)
    assert palm == pytest.approx(-0.05 * 9.81 / 500.0, rel=1e-3) and min(others) > 0.0
    hold = world.inverse_actuation @ world.calc_bias(start, np.zeros(world.num_velocities))
    drake = replay_drake(world, scenario, np.array([0.0, 0.2]), hold[np.newaxis])
    assert drake.positions[-1] == pytest.approx(start, abs=1e-5)


@pytest.mark.slow  # More than 360 CPU s.
def test_a_hand_turns_a_ball_by_a_quarter_turn_and_leaves_it_there_in_drake_too() -> None:
    options = PlanOptions(starts=60, renewals=0, finalists=1)
    planner = Planner(Scenario.named("hand_and_ball/turn"), options)
    plan = planner.plan()
    assert plan.holds
    for motion in (plan.trajectory, *plan.replay):
        q = motion.positions[motion.times >= motion.times[-1] - 1.0]
        goal = np.tile(plan.scenario.goal_position, (len(q), 1))
        off = planner.world.subtract(q, goal)[:, -6:]
        assert np.all(np.linalg.norm(off[:, :3], axis=1) < 0.2)  # [rad]
        assert np.all(np.linalg.norm(off[:, 3:], axis=1) < 0.02)  # [m]
