"""What contacts push with: impulses, or the springs that Drake's plant has."""

from __future__ import annotations

import dataclasses
import pickle
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from marks import slow
from matplotlib.figure import Figure
from mechanisms import (
    DOUBLE_PENDULUM,
    MATERIAL,
    MECHANISMS,
    ask_robot,
    build,
    build_world,
    joint,
    link,
)
from rubbing_worlds import accelerate, calc_drag
from shooting_problems import differ
from world_models import make_scenario

from drake_aigto import Planner, Scenario, World
from drake_aigto.contact import (
    CompliantLaw,
    Mechanism,
    RigidLaw,
    calc_pushes,
    calc_start_speed,
    contact_law,
)
from drake_aigto.dynamics import calc_friction_share
from drake_aigto.errors import ModelError, ProgramError, ScenarioError
from drake_aigto.planning import MechanismTask, PlanOptions, steady
from drake_aigto.shooting import ShootingProblem
from drake_aigto.show import Motion, plot_friction
from drake_aigto.simulation import replay_drake, replay_event_driven

COMPLIANT = make_scenario(contact="compliant")


def material(*values: str) -> str:
    """Returns a frictionless material with more elements."""
    end = "</drake:proximity_properties>"
    return MATERIAL.replace(end, f"{''.join(values)}{end}")


def stiffness(value: float) -> str:
    return f"<drake:point_contact_stiffness>{value}</drake:point_contact_stiffness>"


def dissipation(value: float) -> str:
    return f"<drake:hunt_crossley_dissipation>{value}</drake:hunt_crossley_dissipation>"


def build_soft(name: str) -> World:
    """Returns a mechanism whose tip is of 300 N/m, 0.2 s/m, and whose walls are of 600 and 0.7."""
    tip, walls = (material(stiffness(k), dissipation(d)) for k, d in ((300.0, 0.2), (600.0, 0.7)))
    return build_world(MECHANISMS[name].replace(MATERIAL, tip, 1).replace(MATERIAL, walls))


def accelerate_by_law(world: World, law: CompliantLaw, q: Any, v: Any) -> Any:
    """Returns v̇ = M⁻¹ (Jᵀ f − h) with the law's f."""
    x = np.maximum(0.0, -world.calc_signed_distance(q))
    J = world.calc_contact_jacobian(q)
    f = law.stiffness * x * np.maximum(0.0, 1 - law.dissipation * (J @ v))
    still = world.calc_acceleration(q, v, np.zeros(world.num_actuators))
    return still + world.calc_velocity_change(q, f)


@pytest.mark.parametrize("name", ["pendulum", "cart-pole", "arm with a slider"])
def test_the_compliant_law_is_what_drakes_plant_feels(name: str) -> None:
    world = build_soft(name)
    law = contact_law(world, COMPLIANT)
    assert isinstance(law, CompliantLaw)
    np.testing.assert_allclose(law.stiffness, 200.0, rtol=1e-15)
    np.testing.assert_allclose(law.dissipation, (600 * 0.2 + 300 * 0.7) / 900, rtol=1e-15)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.get_actuation_input_port().FixValue(context, np.zeros(world.num_actuators))
    rng = np.random.default_rng(5)
    touched = 0
    for q, v in rng.uniform(-2.0, 2.0, (300, 2, world.num_positions)):
        if -0.5 < world.calc_signed_distance(q).min() < 0:
            touched += 1
            world.plant.SetPositions(context, q)
            world.plant.SetVelocities(context, v)
            expected = world.plant.EvalTimeDerivatives(context).CopyToVector()[len(q) :]
            np.testing.assert_allclose(accelerate_by_law(world, law, q, v), expected, rtol=1e-9)
    assert touched >= 5


def test_soft_discs_push_each_other_from_center_to_center_as_in_drakes_plant() -> None:
    world, rng = build_soft("two discs"), np.random.default_rng(3)
    law = contact_law(world, COMPLIANT)
    assert isinstance(law, CompliantLaw)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.get_actuation_input_port().FixValue(context, np.zeros(world.num_actuators))
    (i,), touched = np.flatnonzero(law.reaches), 0
    for q, v in rng.uniform(-1.0, 1.0, (80, 2, world.num_positions)):
        pushes = calc_pushes(world, law, q, v)
        touched += bool(pushes[i] > 0.0)
        got = world.calc_acceleration(q, v, np.zeros(world.num_actuators), pushes)
        world.plant.SetPositions(context, q)
        world.plant.SetVelocities(context, v)
        expected = world.plant.EvalTimeDerivatives(context).CopyToVector()[len(q) :]
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)
    assert 5 <= touched < 80


def test_the_rigid_law_is_the_restitution_and_needs_no_stiffness() -> None:
    law = contact_law(build("cart-pole"), make_scenario(restitution=0.4))
    assert isinstance(law, RigidLaw)
    np.testing.assert_array_equal(law.restitution, [0.4, 0.4])


@pytest.mark.parametrize("contact", ["rigid", "compliant"])
def test_a_law_is_pickled_whole_and_read_only(contact: str) -> None:
    law = contact_law(build_soft("cart-pole"), make_scenario(contact=contact))
    assert pickle.loads(pickle.dumps(law)) == law
    for name in vars(law):
        with pytest.raises(ValueError, match="read-only"):
            getattr(law, name)[0] = 1.0


HYDROELASTIC = """<drake:compliant_hydroelastic/><drake:hydroelastic_modulus>1e6
  </drake:hydroelastic_modulus><drake:mesh_resolution_hint>0.05</drake:mesh_resolution_hint>"""
RIGID = "<drake:rigid_hydroelastic/>"
SOFT = stiffness(400.0) + dissipation(0.0)
REFUSED: dict[str, tuple[str, str]] = {
    "no stiffness": (
        MECHANISMS["pendulum"],
        "shape 'mechanism::tip' of 'mechanism::rod': got no stiffness, so Dr",
    ),
    "no dissipation": (
        MECHANISMS["pendulum"].replace(MATERIAL, material(stiffness(400.0))),
        r"'mechanism::tip' of .*: got no dissipation, so Drake's default, 50 s/m, .*<drake:hunt",
    ),
    "box": (MECHANISMS["paddle"], "of ball against paddle: got a box of which several faces"),
    "hydroelastic": (
        MECHANISMS["pendulum"]
        .replace(MATERIAL, material(SOFT, HYDROELASTIC), 1)
        .replace(MATERIAL, material(SOFT, RIGID)),
        "compliant contact of rod against wall: got hydroelastic shapes",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_spring_that_drake_would_not_have_is_refused_by_name(name: str) -> None:
    parts, message = REFUSED[name]
    world = build_world(parts)
    task: dict[str, Any] = {
        "initial_position": np.zeros(world.num_positions),
        "initial_velocity": np.zeros(world.num_positions),
        "goal_position": np.zeros(world.num_positions),
        "goal_weight": np.ones(world.num_positions),
        "control_weight": np.ones(world.num_actuators),
    }
    for refuse in (partial(contact_law, world), world.check):
        with pytest.raises(ModelError, match=message):
            refuse(make_scenario(contact="compliant", **task))
    contact_law(world, make_scenario())


def test_a_soft_wall_may_be_entered_at_the_start_as_long_as_its_side_is_known() -> None:
    inside = dataclasses.replace(
        ask_robot("cart_pole_soft_06"), initial_position=[0.8, 0.3], contact="compliant"
    )
    world = World.from_scenario(inside)
    assert world.calc_signed_distance(inside.initial_position)[1] < -0.4
    with pytest.raises(ScenarioError, match=r"initial_position is inside or behind .*pole against"):
        world.check(dataclasses.replace(inside, contact="rigid"))
    carts = dataclasses.replace(ask_robot("three_carts"), contact="compliant")
    world = World.from_scenario(carts)  # Of 1 m radius: half of one is in the other, or more.
    world.check(dataclasses.replace(carts, initial_position=[-1.5, 0.0, 3.0]))
    with pytest.raises(ScenarioError, match=r"initial_position is inside or behind .*left_cart ag"):
        world.check(dataclasses.replace(carts, initial_position=[-0.9, 0.0, 3.0]))


def test_a_world_without_contact_has_shapes_of_none() -> None:
    world = build_world(DOUBLE_PENDULUM)
    assert (world.num_contacts, world.num_solids) == (0, 0)
    q, u = np.zeros((4, 3, 2)), np.zeros((4, 3, 1))
    assert world.calc_signed_distance(q).shape == world.calc_clearance(q).shape == (4, 3, 0)
    assert world.calc_contact_jacobian(q).shape == (4, 3, 0, 2)
    np.testing.assert_array_equal(world.calc_velocity_change(q, np.zeros((4, 3, 0))), 0 * q)
    assert np.isfinite(world.calc_acceleration(q, q, u)).all()
    assert world.is_on_face(q[0, 0]).shape == world.stiffness.shape == (0,)
    assert world.are_of_one_solid.shape == (0, 0)
    scenario = make_scenario(size=2)
    for contact in ("rigid", "compliant"):
        law = contact_law(world, dataclasses.replace(scenario, contact=contact))
        assert {len(each) for each in vars(law).values()} == {0}
    world.check(scenario)
    assert world.fingerprint.contacts == ()
    free = build_world(
        link("cart", 1.0, ">0 0 0 0 0 0") + joint("prismatic", "world", "cart", "1 0 0")
    )
    assert free.constant_inertia.jacobian.shape == (0, 1)


def test_angles_are_told_from_lengths() -> None:
    np.testing.assert_array_equal(build("cart-pole").is_hinge, [False, True])
    discs = build("two discs")
    start = discs.plant.GetJointByName("one_joint").position_start()
    np.testing.assert_array_equal(np.flatnonzero(discs.is_hinge), [start + 2])


@cache
def ask() -> Scenario:
    return dataclasses.replace(
        Scenario.named("spinning_ball/off_the_wall"),
        initial_velocity=[0.1, -1.0, 20.0],
        initial_position=[0.4, 0.2, 0.0],
        duration=0.5,
        stiction_speed=0.05,
    )


@cache
def read() -> World:
    return World.from_scenario(ask())


def test_both_replays_agree_on_a_ball_that_spins_off_a_wall() -> None:
    times, controls = np.array([0.0, 0.2, 0.5]), np.array([[1.0, 0.05], [-1.0, 0.0]])
    own = replay_event_driven(read(), ask(), times, controls)
    drake = replay_drake(read(), ask(), times, controls)
    np.testing.assert_allclose(own.velocities[-1], drake.velocities[-1], atol=1e-6)
    assert own.velocities[-1, 0] < -0.5
    # What friction gives along the wall, it takes from the spin at the arm at which it acts.
    momentum, spin = own.velocities[-1, 0] - 0.1, 0.004 * (own.velocities[-1, 2] - 20.0) - 0.01
    assert 0.05 < spin / momentum < 0.1
    smooth = dataclasses.replace(ask(), friction=0.0)
    without = replay_drake(read(), smooth, times, controls)
    assert without.velocities[-1, 0] == pytest.approx(0.1, abs=1e-9)
    assert without.velocities[-1, 2] == pytest.approx(20.0 + 0.01 / 0.004, abs=1e-6)


@pytest.mark.parametrize("stiffness", [1e6, *slow(1e8)])
def test_both_replays_agree_where_a_ball_sticks_to_a_stiff_wall(stiffness: float) -> None:
    changes: dict[str, Any] = {"material": {"*": {"stiffness": stiffness}}, "stiction_speed": 1e-3}
    scenario = dataclasses.replace(ask(), initial_velocity=[0.1, -1.0, 2.0], **changes)
    world, times, controls = World.from_scenario(scenario), np.array([0.0, 0.5]), np.zeros((1, 2))
    own = replay_event_driven(world, scenario, times, controls)
    drake = replay_drake(world, scenario, times, controls)
    np.testing.assert_allclose(own.velocities[-1], drake.velocities[-1], atol=1e-6)
    x, _, spin = own.velocities[-1]
    assert abs(x + 0.1 * spin) < 1e-3, "it rolls as it leaves"


def test_friction_is_mu_times_the_push_and_turns_with_the_slip() -> None:
    world, law = read(), contact_law(read(), ask())
    q = np.array([0.8, 0.06, 0.3])
    for v in (np.array([2.0, 0.1, 0.0]), np.array([0.0, 0.1, 0.1])):
        forces = calc_pushes(world, law, q, v)
        drag = calc_drag(world, law, q, v, forces)
        arm = 0.1 - 0.04 / 2
        slip = v[0] + arm * v[2]
        share = calc_friction_share(np.array(slip), 0.05)
        expected = -0.4 * 400.0 * 0.04 * share * np.array([1.0, 0.0, arm])
        np.testing.assert_allclose(drag, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "changes", "least_touches"),
    [
        ("cart_pole/soft_06", {}, 10),
        ("cart_pole/dry", {"contact": "compliant", "dry_friction": [2.0, 0.3]}, 0),
        ("hopper/hop", {}, 10),
        ("pushed_block/slide", {}, 10),
        ("spinner/two_radians", {}, 10),
        ("spinning_ball/off_the_wall", {}, 10),
    ],
)
def test_compiled_rates_are_those_of_the_world_and_their_slopes_those_of_differences(
    name: str, changes: dict[str, Any], least_touches: int
) -> None:
    scenario = dataclasses.replace(Scenario.named(name), **changes)
    world, rng = World.from_scenario(scenario), np.random.default_rng(0)
    law, n, touched = contact_law(world, scenario), world.num_positions, 0
    mechanism = Mechanism.of(world, law)
    for i in range(200):
        q = scenario.initial_position + rng.uniform(-0.6, 0.6, n)
        v, u = 10 ** rng.uniform(-3, 0) * rng.normal(size=n), rng.normal(size=world.num_actuators)
        touched += int(calc_pushes(world, law, q, v).any())
        expected = accelerate(world, law, q, v, u)
        z = np.concatenate([q, v, u])
        got, slopes = mechanism.calc_acceleration(z[: 2 * n], z[2 * n :])
        np.testing.assert_allclose(got, expected, atol=1e-12 * np.abs(expected).max())
        if i % 10 == 0:
            differences = differ(
                lambda y: mechanism.calc_acceleration(y[: 2 * n], y[2 * n :])[0], z, 1e-7
            )
            np.testing.assert_allclose(slopes, differences, atol=1e-6 * np.abs(slopes).max())
    assert touched >= least_touches


def test_a_replay_on_the_way_is_that_of_the_controls_that_were_held() -> None:
    scenario = dataclasses.replace(ask(), duration=0.3, time_step=0.05)
    problem = MechanismTask(read(), scenario, PlanOptions())
    found = problem.shooting(6).simulate(np.tile([1.0, 0.05], (6, 1)), 4)
    steadied = steady(read(), scenario, problem.shooting(6), found)
    assert np.abs(steadied.controls - found.controls).max() > 1e-9
    again = replay_event_driven(read(), scenario, steadied.times, steadied.controls)
    assert steadied.replay == again and steadied.exact_cost == again.cost != found.exact_cost
    np.testing.assert_array_equal(steadied.states[-1, :3], again.positions[-1])
    # A kink between knots is a knot of a plan's replay, which this one lacks.
    path = np.tile(scenario.initial_position, (3, 1))
    kinked = dataclasses.replace(
        scenario,
        reference_times=[0.0, 0.12, 0.3],
        reference_positions=path,
        position_weight=[1.0, 1.0, 0.0],
    )
    assert steady(read(), kinked, problem.shooting(6), found).replay is None


def test_controls_whose_gains_exceed_all_numbers_are_replayed_as_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = dataclasses.replace(ask(), duration=0.3, time_step=0.05)
    problem = MechanismTask(read(), scenario, PlanOptions()).shooting(6)
    found = problem.simulate(np.tile([1.0, 0.05], (6, 1)), 4)

    def overflow(*_: object) -> None:
        raise ProgramError("controls", got="nan")

    monkeypatch.setattr(ShootingProblem, "linearize", overflow)
    kept = steady(read(), scenario, problem, found)
    np.testing.assert_array_equal(kept.controls, found.controls)
    again = replay_event_driven(read(), scenario, found.times, found.controls)
    assert kept.exact_cost == again.cost


def test_spheres_that_move_about_each_other_rub_as_in_drakes_plant() -> None:
    scenario = Scenario.named("spinner/two_radians")
    world, rng = World.from_scenario(scenario), np.random.default_rng(0)
    law = contact_law(world, scenario)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.get_actuation_input_port().FixValue(context, np.zeros(2))
    touched = 0
    for _ in range(400):
        q = scenario.initial_position + rng.uniform(-0.6, 0.6, 3)
        if not -0.04 < world.calc_signed_distance(q)[0] < 0:
            continue
        touched += 1
        v = 10 ** rng.uniform(-2, 0) * rng.uniform(-1.0, 1.0, 3)
        own = accelerate(world, law, q, v, np.zeros(2))
        world.plant.SetPositions(context, q)
        world.plant.SetVelocities(context, v)
        drake = world.plant.EvalTimeDerivatives(context).CopyToVector()[3:]
        # To rounding, however deep: the arm is that of the middle of the overlap.
        assert np.abs(own - drake).max() <= 1e-10 * np.abs(drake).max()
    assert touched >= 4


def test_a_clone_of_a_diagram_has_its_spheres_where_they_were() -> None:
    world = World.from_scenario(Scenario.named("push_circle/round_it"))
    clone = world.of_diagram(world.diagram.Clone())
    q = np.array([-0.2, 0.1, 0.05, -0.1])
    np.testing.assert_array_equal(clone.calc_signed_distance(q), world.calc_signed_distance(q))


def test_a_figure_tells_stick_from_slip_by_its_marks_and_has_friction_within_its_cone() -> None:
    times, q = np.linspace(0.0, 1.0, 3), np.tile([0.8, 0.06, 0.0], (3, 1))
    v = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [2.0, 0.0, 0.0]])
    plot_friction(axes := Figure().subplots(), Motion("plan", times, q, v), read(), ask())
    line, rings, crosses = axes.lines
    np.testing.assert_array_equal(rings.get_xdata(), times[:2])
    np.testing.assert_array_equal(crosses.get_xdata(), times[2:])
    # μ k x = 0.4 · 400 N/m · 0.04 m, along a direction T that the world chose, against sliding.
    against = -np.sign(read().rubbing.calc_tangent_jacobian(q[0])[2, 0])
    friction = against * np.asarray(line.get_ydata())
    assert friction[2] == pytest.approx(6.4)
    assert 0.0 < friction[1] < 6.4


def test_replays_agree_on_spheres_that_sink_deep_into_each_other() -> None:
    """As drawn springs of 20 N/m a pair are entered by half a radius."""
    fields: dict[str, Any] = {"material": {"*": {"stiffness": 40.0}}}
    soft = dataclasses.replace(Scenario.named("spinner/two_radians"), **fields)
    times = np.linspace(0.0, 2.0, 5)
    pushes = 0.3 * np.random.default_rng(8).normal(size=(4, 2))
    world = World.from_scenario(soft)
    own, drake = (
        replay(world, soft, times, pushes) for replay in (replay_event_driven, replay_drake)
    )
    assert own.max_penetration > 0.02
    assert own.cost == pytest.approx(drake.cost, rel=1e-7)


def test_finalists_have_steps_of_one_length_however_many_knots_there_are() -> None:
    scenario = Scenario.named("push_circle/round_it")
    world, steps = World.from_scenario(scenario), []
    for times in (1, 2):
        asked = dataclasses.replace(scenario, time_step=times * scenario.time_step)
        task = MechanismTask(world, asked, PlanOptions())
        steps.append(task.scenario.num_steps * task.tighten(task.coast).substeps)
    assert steps[0] == steps[1]


@pytest.mark.slow
def test_the_ball_spins_against_a_wall_to_go_where_nothing_drives_it() -> None:
    scenario = Scenario.named("spinning_ball/off_the_wall")
    plan = Planner(scenario, PlanOptions(renewals=24)).plan()
    assert plan.holds
    assert plan.best.contacts
    for replay in plan.replay:
        np.testing.assert_allclose(replay.positions[-1, :2], [1.0, 0.5], atol=0.02)
        assert replay.cost == pytest.approx(plan.cost, rel=1e-3)
    # Ten times as many renewals end at 0.03314.
    assert plan.cost < 0.0335


# A ball that a soft wall throws off at 13 m/s, where a length per duration is 1 m/s.
THROWN = dataclasses.replace(
    Scenario.named("spinning_ball/off_the_wall"),
    initial_position=[1.08, -0.576, 0.68],
    initial_velocity=[0.07, -0.87, 0.16],
)


def test_the_speed_of_a_start_is_what_springs_make_of_it() -> None:
    world, times = World.from_scenario(THROWN), np.linspace(0.0, 0.3, 31)
    thrown = replay_event_driven(world, THROWN, times, np.zeros((30, 2)))
    fastest = np.max(np.abs(thrown.velocities[:, 1]))
    assert calc_start_speed(world, THROWN) == pytest.approx(fastest, rel=1e-6)
    assert calc_start_speed(world, dataclasses.replace(THROWN, contact="rigid")) == 0.0


@pytest.mark.slow
def test_errors_of_a_motion_that_is_thrown_off_with_friction_do_not_seem_to_grow() -> None:
    found = Planner(THROWN, PlanOptions(renewals=24, confirm=False)).plan()
    # As errors seemed to grow 1e40 times in steps too long for such friction, feedback judged
    # motions and wrecked them: doing nothing, for 11, was the plan, or at best one for 0.43.
    assert found.best.growth is not None
    assert found.best.growth.factor < 1e4
    assert found.cost < 0.216


@pytest.mark.slow
def test_a_pusher_goes_round_a_disc_to_push_it_to_where_it_started() -> None:
    plan = Planner(Scenario.named("push_circle/round_it"), PlanOptions(renewals=24)).plan()
    assert plan.holds
    # Standing still costs 225, and so does all that local solvers find from there.
    assert plan.cost < 0.6
    for replay in plan.replay:
        np.testing.assert_allclose(replay.positions[-1, 2:], -1.5 / np.sqrt(2), atol=0.01)


@pytest.mark.slow
def test_a_finger_turns_a_spinner_that_nothing_else_drives() -> None:
    plan = Planner(Scenario.named("spinner/two_radians"), PlanOptions(renewals=24)).plan()
    assert plan.holds
    assert plan.cost < 3.2
    for replay in plan.replay:
        assert 1.8 < replay.positions[-1, 2] < 2.2


@pytest.mark.slow
def test_a_block_is_pushed_up_to_a_stop_and_slides_on_to_its_goal() -> None:
    scenario = Scenario.named("pushed_block/slide")
    plan = Planner(scenario, PlanOptions(renewals=16)).plan()
    assert plan.holds
    for replay in plan.replay:
        assert replay.positions[-1, 1] == pytest.approx(1.0, abs=0.01)
        slides = (replay.times > 1.0) & (replay.velocities[:, 1] > 0.1)
        times, speeds = replay.times[slides], replay.velocities[slides, 1]
        # It slows down at μ g.
        assert (speeds[0] - speeds[-1]) / (times[-1] - times[0]) == pytest.approx(2.943, rel=1e-3)


@pytest.mark.slow
def test_a_hopper_hops_to_its_goal() -> None:
    plan = Planner(Scenario.named("hopper/hop"), PlanOptions(finalists=1)).plan()
    assert plan.holds
    for replay in plan.replay:
        np.testing.assert_allclose(replay.positions[-1, :2], [0.7, 0.5], atol=0.05)
