"""Worlds in space: read at once; judged by us and by Drake; shown."""

from __future__ import annotations

import dataclasses
import logging
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from meshcat_pages import clips
from pydrake.geometry import Meshcat
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.multibody.tree import JacobianWrtVariable
from space_models import BOX, SPHERE, ball_and_finger, build, collision, link, make_scenario
from trees import make_zoo, sample_state

from drake_aigto import (
    ModelPredictiveController,
    Plan,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
    World,
    plan,
)
from drake_aigto.cli import FINE, main
from drake_aigto.control import Disturbance, run_in_loop
from drake_aigto.dynamics import Tree
from drake_aigto.errors import ModelError, ProgramError, ScenarioError
from drake_aigto.planning import Feedback, FeedbackPhase
from drake_aigto.show import (
    ROOT,
    Motion,
    Stage,
    draw_mechanism,
    motions_of_plan,
    plot_motions,
    publish,
    task_items,
)
from drake_aigto.simulation import (
    CLEARANCE,
    Arrival,
    replay_drake,
    replay_event_driven,
    tangent_scales,
)
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch
from drake_aigto.world import FrameGoal, FrameGoals, Pose, PoseParts, SpaceWorld, TaskCost


def test_distances_and_their_slopes_are_those_of_the_manifold(tmp_path: Path) -> None:
    world, scenario = build(make_scenario(tmp_path))
    rng, h = np.random.default_rng(0), 1e-6
    q = world.tree.add(scenario.initial_position, rng.normal(size=9))
    J = world.calc_contact_jacobian(q)
    for j, step in enumerate(h * np.eye(9)):
        ends = [world.calc_signed_distance(world.tree.add(q, s * step)) for s in (1, -1)]
        np.testing.assert_allclose(J[:, j], (ends[0] - ends[1]) / (2 * h), rtol=0, atol=1e-8)


def test_distances_with_their_slopes_are_those_of_each_alone_and_last(tmp_path: Path) -> None:
    world, scenario = build(make_scenario(tmp_path))
    assert isinstance(world, SpaceWorld)
    others = world.tree.add(scenario.initial_position, np.random.default_rng(0).normal(size=(8, 9)))
    with ThreadPoolExecutor(4) as pool:
        found = [
            (q, *both)
            for q, both in zip(others, pool.map(world.measure_contacts, others), strict=True)
        ]
    for q, distances, slopes in found:
        np.testing.assert_array_equal(distances, world.calc_signed_distance(q))
        np.testing.assert_array_equal(slopes, world.calc_contact_jacobian(q))


def test_a_push_leads_to_the_same_end_here_and_in_drake(tmp_path: Path) -> None:
    by_name = make_scenario(tmp_path)
    world, scenario = build(by_name)
    times, controls = np.linspace(0, 1, 51), np.zeros((50, 3))
    controls[:, 2] = 0.12 * 9.81
    controls[:20, 0], controls[20:35, 0] = 0.4, -0.4
    ours = replay_event_driven(world, by_name, times, controls)
    drake = replay_drake(world, scenario, times, controls)
    assert ours.bounce_times
    assert ours.positions[-1, 7] - scenario.initial_position[7] > 0.05  # The ball rolled.
    # Drake's steps miss 1e-10 each where contact has no kinks.
    np.testing.assert_allclose(ours.positions[-1], drake.positions[-1], rtol=0, atol=1e-6)
    assert ours.cost == pytest.approx(drake.cost, rel=1e-5)
    assert ours.compliance_error < 1e-5


def test_bodies_slide_by_the_velocities_of_their_material(tmp_path: Path) -> None:
    world, scenario = build(make_scenario(tmp_path))
    rng, plant = np.random.default_rng(1), world.plant
    q, v = world.add(scenario.initial_position, 0.1 * rng.normal(size=9)), rng.normal(size=9)
    context, frame = plant.CreateDefaultContext(), plant.world_frame()
    plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
    inspector = world.scene_graph.model_inspector()
    for contact, slide in enumerate(world.calc_slides(q, v)):
        place, normal = world.find_touch(contact, q)
        rates = []
        for shape in world.shapes[contact]:
            body = plant.GetBodyFromFrameId(inspector.GetFrameId(shape))
            at = body.EvalPoseInWorld(context).inverse().multiply(place)
            J = plant.CalcJacobianTranslationalVelocity(
                context, JacobianWrtVariable.kV, body.body_frame(), at, frame, frame
            )
            rates.append(J @ v)
        rate = rates[0] - rates[1]
        np.testing.assert_allclose(slide, rate - normal * (normal @ rate), atol=1e-12)
        assert normal @ rate == pytest.approx(world.calc_contact_rate(q, v)[contact], abs=1e-12)


def test_a_world_in_space_with_one_contact_is_shown() -> None:
    planner = Planner(Scenario.named("puck/spin"))
    scenario, world = planner.scenario, planner.world
    ends = np.array([scenario.initial_position, scenario.goal_position])
    states = np.hstack([ends, np.zeros((2, world.num_velocities))])
    motion = Motion.from_path("plan", world, np.array([0.0, scenario.duration]), states)
    touch = Touch.bounce(scenario.duration / 2, 0)
    motion = dataclasses.replace(motion, touches=(touch,), impacts=(touch,))
    shown = publish([motion], Meshcat(), world, scenario)
    assert "puck with pusher" in str(shown.scene)
    assert shown.beside["title"] == "puck/spin"


def test_a_body_that_turns_is_shown_between_knots_and_across_its_way(tmp_path: Path) -> None:
    world, scenario = build(make_scenario(tmp_path))
    first = world.plant.GetJointByName("thing").velocity_start()
    start, v, times = scenario.initial_position, np.zeros(9), np.array([0.0, 0.1, 0.2])
    v[first + 2], v[first + 4] = 3.0, 1.0  # [rad/s] around z, [m/s] along y
    path = world.add(start, np.outer(times, v))
    states = np.hstack([path, np.tile(v, (3, 1))])
    motion = Motion.from_path("plan", world, times, states)
    assert len(motion.times) == 21
    expected = world.add(start, np.outer(motion.times, v))
    np.testing.assert_allclose(motion.positions, expected, atol=1e-12)
    np.testing.assert_allclose(motion.velocities, np.tile(v, (21, 1)), atol=1e-12)
    stage = Stage(world, motion.positions)
    x, _, towards = stage.X_WT.rotation().matrix().T
    np.testing.assert_allclose(x, [0, 1, 0], atol=1e-3)
    assert not stage.is_flat and 0.3 < towards[2] < 0.6
    named = {world.plant.get_body(body).name() for body, _ in stage.tracers}
    assert named == {"finger", "thing"}
    numbers = publish([motion], meshcat := Meshcat(), world, scenario).beside["numbers"]
    assert len(numbers["names"]) == len(numbers["columns"]) and "thing turn z [rad]" in " ".join(
        numbers["names"]
    )
    _, turns = clips(meshcat, "quaternion")[f"{ROOT}/motions/1/m/thing/ball"]
    np.testing.assert_allclose(np.abs(turns[-1]), [0, 0, np.sin(0.3), np.cos(0.3)], atol=1e-6)
    captions = [caption for _, caption in draw_mechanism([motion], world, scenario)]
    assert captions[0].startswith("Links at evenly spaced times")


def test_drake_does_not_warn_of_half_spaces(caplog: pytest.LogCaptureFixture) -> None:
    world, scenario = build(Scenario.named("finger_and_box/push"))
    assert world.calc_solid_distances(scenario.initial_position[np.newaxis]).shape[0] == 1
    assert "half space" not in caplog.text


def test_contacts_in_space_are_named_by_models_once_and_names_keep_apart() -> None:
    world, scenario = build(Scenario.named("finger_and_box/push"))
    touches = tuple(Touch(0.01 * i, 0.5 + 0.01 * i, i) for i in range(world.num_contacts))
    q = np.array([scenario.initial_position, scenario.initial_position])
    motion = Motion("plan", np.array([0.0, 1.0]), q, np.zeros((2, world.num_velocities)))
    grid = Figure().subplots(2, 1)
    plot_motions(grid, [dataclasses.replace(motion, touches=touches)], world, scenario, [2])
    named = [(text.get_va(), float(text.xy[0])) for text in grid[0].texts]
    assert {text.get_text() for text in grid[0].texts} <= {"finger with ground", "box with finger"}
    for side in ("top", "bottom"):
        assert all(np.diff([time for at, time in named if at == side]) > 0.05)
    assert named


_NO_EFFORT = "<limit><effort>0</effort></limit>"
_ACROSS = "<axis><xyz>0 1 0</xyz>"
_CONSTRAINT = """<drake:ball_constraint>
  <drake:ball_constraint_body_A>finger</drake:ball_constraint_body_A>
  <drake:ball_constraint_body_B>thing</drake:ball_constraint_body_B>
  <drake:ball_constraint_p_AP>0 0 0</drake:ball_constraint_p_AP>
  <drake:ball_constraint_p_BQ>0 0 0</drake:ball_constraint_p_BQ></drake:ball_constraint>"""
_LOOP = "".join(
    f'<joint name="{parent}s" type="revolute"><parent>{parent}</parent><child>thing</child>'
    "<axis><xyz>0 0 1</xyz></axis></joint>"
    for parent in ("finger", "along")
)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (
            ball_and_finger().replace(_ACROSS, f'{_ACROSS}<mimic joint="x"/>'),
            r"<mimic> of joint 'y' \(a joint that follows another one\)",
        ),
        (ball_and_finger(more=_CONSTRAINT), "got 1 constraint beside joints, expected a tree"),
        (ball_and_finger(more=_LOOP), "got a loop of joints in .*, expected a tree"),
        (
            ball_and_finger().replace("</dynamics>", f"</dynamics>{_NO_EFFORT}"),
            "the model lacks an actuator: got limits of effort of 0 at x, y, z",
        ),
    ],
    ids=["mimic", "constraint", "loop", "no actuator"],
)
def test_what_is_no_driven_tree_is_refused_by_name(tmp_path: Path, text: str, match: str) -> None:
    with pytest.raises(ModelError, match=match):
        World.from_scenario(make_scenario(tmp_path, text))


def test_numbers_of_a_quaternion_have_no_unit(tmp_path: Path) -> None:
    world, scenario = build(make_scenario(tmp_path))
    first = world.plant.GetJointByName("thing").position_start()
    assert world.units_of_positions[first : first + 7] == ("", "", "", "", "m", "m", "m")
    (start, *_) = task_items(scenario, world)
    assert "1, 0, 0, 0, 0 m, 0 m, 0.0493 m" in start and "rad" not in start


def make_arm(folder: Path, count: int) -> Scenario:
    """Returns a reach of an arm without shapes, of this many hinges about y and x in turn."""
    links, joints = "", ""
    for k in range(count):
        links += link(f"l{k}", 1.0, "").replace(">", f"><pose>0 0 {-0.2 * k} 0 0 0</pose>", 1)
        joints += (
            f'<joint name="j{k}" type="revolute"><parent>{f"l{k - 1}" if k else "world"}</parent>'
            f"<child>l{k}</child><axis><xyz>{'0 1 0' if k % 2 else '1 0 0'}</xyz>"
            "<dynamics><damping>0.5</damping></dynamics></axis></joint>"
        )
    text = f'<sdf version="1.9"><model name="arm">{links}{joints}</model></sdf>'
    still = [0.0] * count
    return make_scenario(
        folder,
        text,
        initial_position=[0.1] * count,
        initial_velocity=still,
        goal_position=[0.4] * count,
        goal_weight=10.0,
        goal_velocity_weight=1.0,
        control_weight=1e-3,
    )


@pytest.mark.slow
def test_an_arm_of_many_hinges_that_touches_nothing_is_a_world_in_space_and_reaches_its_goal(
    tmp_path: Path,
) -> None:
    world = World.from_scenario(make_arm(tmp_path, 6))
    assert isinstance(world, SpaceWorld) and not world.contacts
    assert world.calc_contact_jacobian(np.zeros((3, 6))).shape == (3, 0, 6)
    assert world.calc_signed_distance(np.zeros((3, 6))).shape == (3, 0)
    scenario = make_arm(tmp_path, 6)
    plan = Planner(scenario, PlanOptions(renewals=8, finalists=1)).plan()
    idle = plan.idle
    assert plan.holds and plan.reached and idle is not None and plan.cost < 0.1 * idle.cost
    assert [replay.cost for replay in plan.replay] == pytest.approx([plan.cost] * 2, rel=1e-3)


@pytest.mark.slow  # Shooting over trees is compiled.
def test_a_push_lasts_as_long_as_is_best_if_its_duration_is_free(tmp_path: Path) -> None:
    """With more time it needs less force, until it has all the time that it may take."""
    options = PlanOptions(renewals=8, finalists=1)
    short = Planner(make_scenario(tmp_path, duration=0.6), options).plan()
    free = Planner(make_scenario(tmp_path, duration=0.6, duration_range=[0.5, 1.0]), options).plan()
    assert free.holds and free.cost < short.cost
    assert free.trajectory.times[-1] == pytest.approx(1.0, rel=0.02)
    assert [replay.cost for replay in free.replay] == pytest.approx([free.cost] * 2, rel=1e-3)


@pytest.mark.slow  # Shooting over trees is compiled.
def test_a_ball_is_pushed_to_its_goal_by_a_plan_that_both_replays_confirm(tmp_path: Path) -> None:
    scenario = make_scenario(tmp_path)
    plan = Planner(scenario, PlanOptions(renewals=16, finalists=1)).plan()
    idle = plan.idle
    assert plan.holds and idle is not None and plan.cost < 1e-2 * idle.cost
    start, end = plan.trajectory.positions[[0, -1]]
    world, placed = build(scenario)
    first = world.plant.GetJointByName("thing").position_start()
    assert np.linalg.norm((end - placed.goal_position)[first + 4 : first + 7]) < 0.01
    assert end[first + 4] - start[first + 4] > 0.25
    np.testing.assert_allclose(
        np.linalg.norm(plan.trajectory.positions[:, first : first + 4], axis=1), 1
    )
    replays = list(plan.replay)
    assert len(replays) == 2
    for replay in replays:
        assert replay.cost == pytest.approx(plan.cost, rel=1e-3)
    path = tmp_path / "plan.json"
    plan.save(path)
    assert Plan.load(path) == plan
    assert main(["replay", str(path), "--quiet"]) == FINE
    assert len(motions_of_plan(plan)) == 3
    # The ball lies 2 mm to the side: its plan's control alone pushes it farther off.
    asked, off = plan.scenario, np.zeros(9)
    off[world.plant.GetJointByName("thing").velocity_start() + 4] = 0.002
    moved = dataclasses.replace(asked, initial_position=world.add(placed.initial_position, off))
    motion = plan.trajectory
    alone = replay_drake(world, moved, motion.times, motion.controls).positions[-1]
    planner = Planner(asked, PlanOptions(renewals=4, finalists=1), world)
    replans = ModelPredictiveController(
        planner, 0.1, horizon="shrinking", plan=plan, feedback_period=asked.time_step
    )
    for controller in (TrackingController(plan), replans):
        run = run_in_loop(controller, asked, world, Disturbance(start_offset=off))
        misses = np.array([run.replay.positions[-1], alone]) - placed.goal_position
        missed = np.linalg.norm(misses[:, first + 4 : first + 6], axis=1)
        assert missed[0] < 0.5 * missed[1]


@pytest.mark.slow  # 20 CPU s each, compiled.
@pytest.mark.parametrize("name", ["puck/spin", "push_tee/to_pose"])
def test_what_a_disc_pushes_comes_to_its_goal_and_both_replays_confirm_it(name: str) -> None:
    plan = Planner(Scenario.named(name), PlanOptions(renewals=32, finalists=1)).plan()
    assert plan.holds and plan.reached
    replays, arrival = list(plan.replay), plan.find_arrival()
    assert len(replays) == 2
    for replay in replays:
        assert replay.cost == pytest.approx(plan.cost, rel=0.02)
    assert arrival.distance is not None and arrival.distance < 0.01
    assert arrival.angle is not None and arrival.angle < 0.02


def test_feedback_answers_turns_along_the_manifold_whatever_the_sign_of_a_quaternion(
    tmp_path: Path,
) -> None:
    world, scenario = build(make_scenario(tmp_path))
    rng, n, m = np.random.default_rng(2), world.num_velocities, world.num_contacts
    turned = 0.3 * rng.normal(size=n)
    path = world.add(np.tile(scenario.initial_position, (3, 1)), np.outer([0, 1, 2], turned))
    times, v, u = np.array([0.0, 0.1, 0.2]), np.zeros((3, n)), rng.normal(size=(2, 3))
    plan = Trajectory(times, path, v, u, np.zeros((3, m)), np.zeros((2, m)))
    gains = 0.1 * rng.normal(size=(2, 3, 2 * n))
    phase = FeedbackPhase(times, np.hstack([path, v]), u, gains)
    feedback, delta = Feedback(world, scenario, plan, [phase]), rng.normal(size=2 * n)
    q, first = world.add(path[1], delta[:n]), world.plant.GetJointByName("thing").position_start()
    expected = np.clip(u[1] + gains[1] @ delta, *world.bounds(scenario).control)
    for sign in (1.0, -1.0):
        q[first : first + 4] *= sign
        got = feedback.sample(0.1, np.concatenate([q, delta[n:]]), ()).control
        np.testing.assert_allclose(got, expected, atol=1e-9)
        off = world.calc_error(np.concatenate([q, delta[n:]]), phase.states[1])
        np.testing.assert_allclose(off, delta, atol=1e-9)
        nearest = world.take_nearest(q, path[1])
        assert nearest[first : first + 4] @ path[1, first : first + 4] > 0
        np.testing.assert_allclose(world.subtract(nearest, q), 0.0, atol=1e-12)


def test_errors_grow_as_simulations_say_where_stiff_friction_holds_a_body(tmp_path: Path) -> None:
    # Its slip decays within 0.1 ms; in eight steps a knot, errors grew by 5e157.
    start = {"thing": {"xyz": [0.3, 0, 0.0493]}, "z": 0.05}
    changes: dict[str, Any] = {"stiction_speed": 0.005, "duration": 0.4}
    world, scenario = build(make_scenario(tmp_path, initial_position=start, **changes))
    times, n, m = np.linspace(0, 0.4, 21), world.num_velocities, world.num_contacts
    u = np.tile([1.0, 0.5, -10.0], (20, 1))
    q, v = replay_event_driven(world, scenario, times, u).states_at(times)
    plan = Trajectory(times, q, v, u, np.zeros((21, m)), np.zeros((20, m)))
    growth, units = Feedback(world, scenario, plan).growth, tangent_scales(world, scenario)
    off = 1e-5 * growth.worst
    moved = dataclasses.replace(
        scenario,
        initial_position=world.add(scenario.initial_position, off[:n]),
        initial_velocity=scenario.initial_velocity + off[n:],
    )
    later, faster = replay_event_driven(world, moved, times, u).states_at(times)
    apart = np.hstack([world.subtract(later, q), faster - v]) / units
    assert np.max(np.linalg.norm(apart, axis=1)) / 1e-5 == pytest.approx(growth.factor, rel=0.01)


def test_errors_do_not_grow_by_springs_that_are_stiff_for_a_plans_steps(tmp_path: Path) -> None:
    # Together, springs of four corners turn a box at rest by 2.3 rad in an eighth of a step.
    text = ball_and_finger(collision("box", BOX))
    start = {"thing": {"xyz": [0.3, 0, 0.0493]}, "z": 0.5}
    changes: dict[str, Any] = {"initial_position": start, "duration": 0.4, "time_step": 0.1}
    world, scenario = build(make_scenario(tmp_path, text, **changes))
    times, m = np.linspace(0, 0.4, 5), world.num_contacts
    u = np.tile(world.calc_bias(scenario.initial_position, np.zeros(9))[6:], (4, 1))
    q, v = replay_event_driven(world, scenario, times, u).states_at(times)
    plan = Trajectory(times, q, v, u, np.zeros((5, m)), np.zeros((4, m)))
    assert Feedback(world, scenario, plan).growth.factor < 30  # In eight steps it was 1e12.


def test_what_is_not_planned_for_in_space_is_refused_by_name(tmp_path: Path) -> None:
    wrist = '<joint name="wrist" type="ball"><parent>finger</parent><child>paw</child></joint>'
    text = ball_and_finger(more=link("paw", 0.1, "") + wrist)
    planner = Planner(make_scenario(tmp_path, text, initial_velocity=np.zeros(12)))
    yaw = planner.world.positions[5]
    planner.transcription.AddFinalCost(yaw**2, "yaw")
    with pytest.raises(ProgramError, match="'yaw' can't be planned: got a function of roll, pitch"):
        planner.plan()


def test_rigid_contact_in_space_is_refused_by_name(tmp_path: Path) -> None:
    world, scenario = build(make_scenario(tmp_path))
    rigid = Scenario(**(scenario.to_plain() | {"contact": "rigid"}))
    with pytest.raises(ScenarioError, match="contact: got 'rigid', of bodies in space"):
        world.check(rigid)


def test_pairs_without_a_distance_are_listed_at_once(tmp_path: Path) -> None:
    mesh = collision("hull", BOX) + collision("top", "<ellipsoid><radii>1 1 2</radii></ellipsoid>")
    text = ball_and_finger(shapes=mesh).replace(SPHERE, BOX)
    with pytest.raises(ModelError, match=r"Ellipsoid against.*expected Sphere against"):
        World.from_scenario(make_scenario(tmp_path, text))
    scenario = make_scenario(tmp_path, text, allow_ignored=["pairs"])
    world = World.from_scenario(scenario)
    corners = {
        frozenset((f"m::{box} corner {k + 1}", other))
        for box, met in (("hull", "tip"), ("tip", "hull"))
        for k in range(8)
        for other in ("ground::floor", f"m::{met}")
    }
    assert {frozenset(contact.name.split(" with ")) for contact in world.contacts} == corners
    assert "contact of" in " ".join(world.ignored)


def test_goals_by_a_shift_are_so_far_from_the_start_and_keep_its_attitude(tmp_path: Path) -> None:
    begin = {"thing": {"xyz": [0.1, 0.2, 0.5], "rpy_deg": [10, 20, 30]}, "x": 0.3, "z": 1.0}
    goal = {"thing": {"by": [0.4, 0, -0.1]}, "x": {"by": 0.2}}
    asked = make_scenario(tmp_path, initial_position=begin, goal_position=goal)
    assert Scenario.from_plain(asked.to_plain()) == asked
    world, scenario = build(asked)
    moved = scenario.goal_position - scenario.initial_position
    expected = np.zeros(world.num_positions)
    expected[world.plant.GetJointByName("thing").position_start() + np.arange(4, 7)] = 0.4, 0, -0.1
    expected[world.plant.GetJointByName("x").position_start()] = 0.2
    np.testing.assert_allclose(moved, expected, atol=1e-15)


def test_poses_are_written_in_degrees_radians_or_quaternions(tmp_path: Path) -> None:
    turns: list[dict[str, Any]] = [
        {"rpy_deg": [0, 0, 90]},
        {"rpy": [0, 0, np.pi / 2]},
        {"quaternion": [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]},
    ]
    for turn in turns:
        goal = {"thing": {"xyz": [0.3, 0, 0.05], **turn}}
        weight = {"thing": {"xyz": 10.0, "turn": 1.0}, "x": 2.0}
        asked = make_scenario(tmp_path, goal_position=goal, goal_weight=weight)
        assert Scenario.from_plain(asked.to_plain()) == asked
        world, scenario = build(asked)
        cost = TaskCost.of(world, scenario)
        error = cost.goal_errors(scenario.initial_position)
        start = world.plant.GetJointByName("thing").velocity_start()
        along = [0, 0, -np.pi / 2, -0.3, 0, -0.0007]
        np.testing.assert_allclose(error[start : start + 6], along, atol=1e-12)
        assert sorted(cost.QT.diagonal()) == [0, 0, 1, 1, 1, 2, 10, 10, 10]
        # By angle: q and −q are the same turn.
        other = np.array(scenario.goal_position)
        first = world.plant.GetJointByName("thing").position_start()
        other[first : first + 4] *= -1
        assert cost.goal_error(other) == pytest.approx(0.0, abs=1e-12)


def test_bounds_and_velocities_by_names_are_those_of_their_coordinates(tmp_path: Path) -> None:
    begin = {"thing": {"xyz": [0.1, 0, 0.5]}, "x": -0.3, "z": 0.3}
    given: dict[str, Any] = {
        "initial_velocity": {"thing": {"xyz": [1, 0, -2]}, "x": -0.1},
        "position_lower": {"thing": {"xyz": [-1, -np.inf, 0]}, "x": -0.5},
        "position_upper": {"z": 0.4},
        "velocity_upper": {"thing": {"turn": 3}, "z": 1.0},
        "control_lower": {"x": -2.0},
    }
    asked = make_scenario(tmp_path, initial_position=begin, **given)
    asked.save(tmp_path / "asked.yaml")
    assert Scenario.load(tmp_path / "asked.yaml") == asked
    world, scenario = build(asked)
    joints = {name: world.plant.GetJointByName(name) for name in ("thing", "x", "z")}
    q, v = (
        {n: getattr(j, f"{k}_start")() for n, j in joints.items()} for k in ("position", "velocity")
    )
    sizes = {"position": world.num_positions, "velocity": world.num_velocities, "control": 3}
    named = {
        "initial_velocity": {v["thing"] + 3: 1.0, v["thing"] + 5: -2.0, v["x"]: -0.1},
        "position_lower": {q["thing"] + 4: -1.0, q["thing"] + 6: 0.0, q["x"]: -0.5},
        "position_upper": {q["z"]: 0.4},
        "velocity_upper": {**dict.fromkeys(v["thing"] + np.arange(3), 3.0), v["z"]: 1.0},
        "control_lower": {world.plant.GetJointActuatorByName("x").input_start(): -2.0},
    }
    for name, entries in named.items():
        rest = {"lower": -np.inf, "upper": np.inf}.get(name.split("_")[1], 0.0)
        expected = np.full(sizes.get(name.split("_")[0], world.num_velocities), rest)
        expected[list(entries)] = list(entries.values())
        np.testing.assert_array_equal(getattr(scenario, name), expected)


def test_a_name_comes_before_patterns_and_of_these_the_last_counts(tmp_path: Path) -> None:
    body = {"xyz": [0.1, 0, 0.5]}
    patterns: dict[str, Any] = {
        "initial_position": {"x": -0.3, "?": 0.3, "thing": body},
        "goal_weight": {"z": 4.0, "*": 1.0, "thing": {"xyz": 10.0}, "[x-z]": 2.0},
        "velocity_upper": {"thi*": {"turn": 3}, "[!t]": 1.0},
        "control_lower": {"*": -2.0, "y": -1.0},
    }
    names: dict[str, Any] = {
        "initial_position": {"x": -0.3, "y": 0.3, "z": 0.3, "thing": body},
        "goal_weight": {"x": 2.0, "y": 2.0, "z": 4.0, "thing": {"xyz": 10.0}},
        "velocity_upper": {"thing": {"turn": 3}, "x": 1.0, "y": 1.0, "z": 1.0},
        "control_lower": {"x": -2.0, "y": -1.0, "z": -2.0},
    }
    found, expected = (build(make_scenario(tmp_path, **each))[1] for each in (patterns, names))
    for field in names:
        np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))


def test_a_quaternion_that_is_not_of_unit_length_is_made_one_and_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    pose = {"xyz": [0, 0, 0.05], "quaternion": [0.7, 0, 0, -0.7]}
    asked = make_scenario(tmp_path, initial_position={"thing": pose, "x": -0.2, "z": 0.05})
    with caplog.at_level(logging.WARNING):
        _, scenario = build(asked)
    assert "the quaternion of 'thing' has the length 0.989949" in caplog.text
    assert np.linalg.norm(scenario.initial_position[3:7]) == pytest.approx(1.0, abs=1e-15)


OVERLAP = {"thing": {"xyz": [0, 0, 0.05]}, "x": -0.08, "z": 0.05}


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        (
            {"goal_position": {"thin": {"xyz": [0, 0, 0]}}},
            r"Did you mean 'thing'\? goal_position\[thin\]: got no joint that moves, and no "
            "floating body, of this name, expected one of thing, x, y, z.$",
        ),
        ({"goal_weight": {"thin_*": 1.0}}, r"goal_weight\[thin_\*\]: got no joint that moves, and"),
        ({"control_upper": {"w*": 1.0}}, r"control_upper\[w\*\]: got no actuator of this name"),
        ({"goal_position": {"thing": {"by": 0.1}}}, r"\[thing\]: got 1 number, expected 3"),
        ({"goal_position": {"thing": {"by": [0, 0, 1], "rpy": [0, 0, 0]}}}, "or by, alone"),
        ({"initial_position": {"x": {"by": 0.1}}}, r"got by \[0.1\].*Only goals are relative"),
        ({"frame_goals": {"thing": {"by": [0, 0, 1], "weight": {"xyz": 1}}}}, "expected a pose"),
        ({"initial_position": [0.0, 0.0], "goal_position": {"x": {"by": 1}}}, "got 2 values"),
        ({"goal_position": {"x": [1, 2]}}, r"goal_position\[x\]: got 2 numbers, expected 1"),
        ({"goal_position": {"x": {"xyz": [1, 2, 3]}}}, "a pose of 'x', which prismatic joint"),
        ({"goal_position": {"thing": {"xyz": [1, 2]}}}, "got 2 and 4 numbers, expected 3 of xyz"),
        (
            {"initial_position": {"thing": {"xyz": [0, 0, 0], "quaternion": [0, 0, 0, 0]}}},
            "the quaternion .0.0, 0.0, 0.0, 0.0. of 'thing', expected one of unit length",
        ),
        ({"initial_position": OVERLAP}, "got bodies that overlap by 0.02 m, expected no more than"),
        ({"mass": 2.0}, "mass: got 2 kg, in space"),
        ({"goal_weight": {"thing": {"xyx": 1.0}}}, "expected xyz and turn"),
        ({"position_lower": {"thing": 0.0}}, r"lower\[thing\]: got \[0.0\].*a bound of xyz alone"),
        ({"position_upper": {"thing": {"turn": 1}}}, "expected a bound of xyz alone.*no bounds"),
        ({"velocity_upper": {"x": {"xyz": 1}}}, "which prismatic joint holds, expected numbers"),
        ({"initial_velocity": {"thing": [1.0, 2.0]}}, "got 2 numbers, expected 6"),
        ({"initial_velocity": {"thing": 1.0}}, "got 1 number, expected 6"),
        ({"control_upper": {"w": 1.0}}, r"control_upper\[w\]: got no actuator of this name"),
        ({"control_upper": {"x": [1.0, 2.0]}}, r"control_upper\[x\]: got 2 numbers, expected 1"),
        (
            {"position_lower": {"x": 0.3}, "position_upper": {"x": 0.2}},
            "position_lower: got 0.3, with position_upper = 0.2",
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_name(
    tmp_path: Path, changes: dict[str, Any], match: str
) -> None:
    with pytest.raises(ScenarioError, match=match):
        World.from_scenario(make_scenario(tmp_path, **changes))


PLACE = [0.3, 0.1, 0.4]  # [m]
GOAL = {"finger": {"xyz": PLACE, "weight": {"xyz": 50.0}}}


def reach(folder: Path, **changes: Any) -> Scenario:
    """Returns a scenario in which the finger has to go to a place, and all else is free."""
    given: dict[str, Any] = {"frame_goals": GOAL, "goal_position": {}, "goal_weight": 0.0} | changes
    return make_scenario(folder, **given)


def test_costs_are_those_of_drakes_poses() -> None:
    plant, rng = make_zoo(0), np.random.default_rng(1)
    tree, context = Tree.of(plant), plant.CreateDefaultContext()
    names = [plant.get_body(i).name() for i in plant.GetFloatingBaseBodies()]
    turn = RollPitchYaw(rng.normal(size=3)).ToQuaternion()
    pose, weight = Pose((0.1, 0.2, 0.3), tuple(turn.wxyz())), PoseParts((1, 2, 3), (5, 5, 5))
    frames = FrameGoals.of(plant, tree, {name: FrameGoal(pose, weight) for name in names})
    assert names and frames is not None
    for _ in range(3):
        q, _, _ = sample_state(plant, rng)
        plant.SetPositions(context, q)
        expected = 0.0
        for name in names:
            X = plant.GetFrameByName(name).CalcPoseInWorld(context)
            angle = (RotationMatrix(turn).inverse() @ X.rotation()).ToAngleAxis().angle()
            off = X.translation() - pose.xyz
            expected += off**2 @ weight.xyz + 5 * (2 * np.sin(angle / 2)) ** 2
        assert frames.cost(q) == pytest.approx(expected, rel=1e-12)
        assert frames.cost(np.array([q, q])) == pytest.approx(expected, rel=1e-12)


def test_joints_that_nothing_names_go_where_the_frame_has_to_be(tmp_path: Path) -> None:
    scenario = reach(tmp_path)
    world = World.from_scenario(scenario)
    placed = world.place(scenario)
    np.testing.assert_allclose(placed.goal_position[:3], PLACE, atol=1e-3)
    np.testing.assert_array_equal(placed.goal_position[3:], placed.initial_position[3:])
    cost = TaskCost.of(world, placed)
    assert not cost.is_asked.any()
    still = np.zeros((2, 9))
    at_goal, at_start = (
        Arrival.of(world, placed, np.array([placed.initial_position, end]), still)
        for end in (placed.goal_position, placed.initial_position)
    )
    assert at_goal.is_reached and not at_start.is_reached
    assert at_start.distance == pytest.approx(float(cost.goal_error(placed.initial_position)))
    assert at_start.angle is None


def test_goals_of_frames_are_saved(tmp_path: Path) -> None:
    reach(tmp_path).save(tmp_path / "s.yaml")
    assert Scenario.load(tmp_path / "s.yaml").frame_goals == reach(tmp_path).frame_goals


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frame_goals": {"fingr": GOAL["finger"]}}, r"Did you mean 'finger'\?"),
        ({"frame_goals": {"floor_link": GOAL["finger"]}}, "no such frame"),
        ({"frame_goals": {"ground": GOAL["finger"]}}, "stands still"),
        ({"frame_goals": {"finger": {"xyz": [0, 0, 1]}}}, "weight"),
        (
            {"frame_goals": {"finger": {"xyz": [0, 0, 1], "weight": {"turn": [1, 2, 3]}}}},
            "one number",
        ),
        ({"frame_goals": {"finger": {"xyz": PLACE, "weight": {"xyz": 0.0}}}}, "above 0"),
        ({"hard_goal": True}, "these are costs"),
    ],
)
def test_goals_that_can_not_be_are_refused(
    tmp_path: Path, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(ScenarioError, match=words):
        World.from_scenario(reach(tmp_path, **changes))


SOFT, RIGID = "cart_pole/soft_06", "cart_pole/rigid_06"
QUICK = PlanOptions(renewals=0, starts=4, finalists=1)
DISTANCE = 0.05


def keep_apart(name: str, clearance: dict[str, float]) -> Scenario:
    changes: Any = {"clearance": clearance}
    return dataclasses.replace(Scenario.named(name), **changes)


@pytest.mark.slow
@pytest.mark.parametrize("name", [SOFT, RIGID])
def test_a_pole_swings_up_at_a_distance_from_its_walls(name: str) -> None:
    scenario = keep_apart(name, {"pole against *": DISTANCE})
    found = plan(scenario, QUICK)
    assert found.holds and not found.best.is_idle and not found.best.contacts
    world = World.from_scenario(scenario)
    for replay in found.replay:
        nearest = world.calc_signed_distance(replay.positions).min()
        assert nearest > DISTANCE - 2e-3 * found.best.scales.length
        assert replay.violations[CLEARANCE] <= 2e-3
    assert not found.additions
    # The pole of the plain plan comes nearer, and its motion breaks what is asked here.
    plain = plan(Scenario.named(name), QUICK).trajectory
    replay = replay_event_driven(world, scenario, plain.times, plain.controls)
    assert CLEARANCE in replay.broken


@pytest.mark.slow  # Shooting over trees is compiled.
def test_a_finger_passes_a_ball_in_space_at_a_distance_and_as_slowly_as_users_ask(
    tmp_path: Path,
) -> None:
    changes: Any = {
        "goal_weight": {"x": 100.0, "y": 100.0, "z": 100.0},
        "clearance": {"*ball*tip*": 0.02},
        "material": {"*": {"friction": 0.0}},
    }
    goal = {"x": 0.15, "y": 0.0, "z": 0.07}
    planner = Planner(make_scenario(tmp_path, goal_position=goal, **changes), QUICK)
    program, world = planner.transcription, planner.world
    *_, z = program.state()[:3]
    vx = program.state()[world.num_positions]
    program.AddConstraintToAllKnotPoints(vx <= 0.4, "slow")
    program.AddFinalCost(100.0 * (z - 0.11) ** 2, "high")
    found = planner.plan()
    assert found.holds and not found.best.is_idle
    near = [contact.name for contact in world.contacts].index("m::ball with m::tip")
    for replay in found.replay:
        assert world.calc_signed_distance(replay.positions)[:, near].min() > 0.0185
        assert not replay.broken and 0.3 < replay.velocities[:, 0].max() < 0.402
        assert replay.positions[-1, 2] == pytest.approx(0.09, abs=2e-3)
    assert found.best.added_costs["high"] == pytest.approx(0.04, rel=0.1)


def test_the_distance_of_two_spheres_is_that_between_their_surfaces() -> None:
    world = World.from_scenario(scenario := keep_apart("two_discs/swap", {"*": 0.3}))
    (reach,) = world.reaches
    q = np.array([0.0, 0.0, reach + 0.3, 0.0])
    np.testing.assert_allclose(world.least_distances(scenario), world.calc_signed_distance(q))


def test_what_is_kept_apart_is_read_back(tmp_path: Any) -> None:
    scenario = keep_apart(SOFT, {"pole against left_wall": DISTANCE})
    scenario.save(tmp_path / "apart.yaml")
    assert Scenario.load(tmp_path / "apart.yaml").clearance == scenario.clearance
    assert "clearance" not in Scenario.named(SOFT).to_plain()


@pytest.mark.parametrize(
    ("name", "clearance", "message"),
    [
        (
            SOFT,
            {"pole against left_wal": 0.1},
            "Did you mean 'pole against left_wall'[?] clearance: 'pole against left_wal': got no "
            "pair of this name that can touch, expected one of pole against left_wall, pole",
        ),
        (SOFT, {"*left*": 0.0}, "0 m, expected more than 0 m"),
        (SOFT, {"*right*": 0.5}, "0.227 m too near .pole against right_wall"),
        ("room_with_block/around", {"*block*": 0.1}, "a box with 4 faces that can be touched"),
    ],
)
def test_a_clearance_that_cannot_be_kept_is_refused(
    name: str, clearance: dict[str, float], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        Planner(keep_apart(name, clearance))
