"""What a model has wrong, estimated: from motions of known truth, in Diagrams, and in the loop."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from loops import set_start
from marks import slow
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto import (
    ModelPredictiveController,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
    World,
)
from drake_aigto.arrays import Floats
from drake_aigto.contact import TapeBuilder
from drake_aigto.control import (
    Disturbance,
    Model,
    ModelEstimate,
    ModelEstimator,
    SeenBounces,
    run_in_loop,
)
from drake_aigto.errors import ControlError
from drake_aigto.simulation import EVENT_DRIVEN, HeldControl
from drake_aigto.world import find_model, package_map

BALL, POLE = Scenario.named("table1/1"), Scenario.named("cart_pole/soft_06")
SPINNER = Scenario.named("spinner/two_radians")
NOISE = 1e-3  # [m, rad], and ten times as much of velocities


def watch(
    known: ModelEstimate, truth: tuple[World, Scenario], noise: float = 0.0, count: int = 36
) -> ModelEstimate:
    world, scenario = truth
    rng, n, period = np.random.default_rng(0), world.num_positions, 0.025
    x = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    seen, scales = x, noise * np.repeat([1.0, 10.0], n)
    for _ in range(count):
        u = 2.0 * rng.normal(size=world.num_actuators)
        held = HeldControl(np.array([0.0, period]), u[np.newaxis])
        judge: Any = EVENT_DRIVEN
        end = judge.simulate(world, scenario, held, state=np.split(x, 2))
        x = np.concatenate([end.positions[-1], end.velocities[-1]])
        after = x + scales * rng.normal(size=2 * n)
        known, seen = known.watch((seen, after), held), after
    return known


@pytest.mark.parametrize("name", ["cart_pole/soft_06", "cart_pole/rigid_06", "spinner/two_radians"])
def test_what_is_predicted_without_its_way_ends_as_a_simulation_does(name: str) -> None:
    scenario = Scenario.named(name)
    world, rng = World.from_scenario(scenario), np.random.default_rng(3)
    scenario = world.place(scenario)
    times = np.linspace(0.0, 0.6, 13)
    held = HeldControl(times, rng.normal(size=(12, world.num_actuators)))
    x, model = scenario.initial_state, Model(world, scenario)
    replay = EVENT_DRIVEN.simulate(world, scenario, held, state=world.split(x))
    found = model.find_end(x, held)
    assert found is not None
    # Flight between rigid walls has an integrator of its own.
    near = 1e-10 if scenario.contact == "rigid" else 0.0
    end = [*replay.positions[-1], *replay.velocities[-1]]
    np.testing.assert_allclose(found, end, rtol=near, atol=near)
    np.testing.assert_array_equal(model.find_end(x, held), found)  # And leaves nothing behind.


def check(known: ModelEstimate, truth: Any) -> None:
    """Checks that values are as near to the truth as they are said to be."""
    assert np.all(np.abs(known.values - truth) < 2 * known.deviations), (known.values, truth)


def test_masses_stiffness_and_walls_that_differ_from_the_model_are_found() -> None:
    world = World.from_scenario(POLE)
    wrong = {"mass_factor": 1.2, "wall_shift": 0.03}
    known = ModelEstimate.of(world, POLE, ["mass", "walls"])
    known = watch(known, Disturbance(**wrong).apply(world, POLE))  # type: ignore[arg-type]
    assert [name.partition(" of")[0] for name in known.names] == ["mass", "wall", "wall"]
    check(known, [1.2, 0.0, 0.03])
    # One of both walls is hit, and of the other nothing is known.
    assert known.values[1] == 0.0
    assert known.deviations[2] < 0.1 * known.deviations[1]
    assert known.deviations[0] < 0.1
    truth = Disturbance(stiffness_factor=1.5).apply(world, POLE)
    known = watch(ModelEstimate.of(world, POLE, ["mass", "stiffness"]), truth)
    check(known, [1.0, 1.5])
    assert known.deviations[1] < 0.1
    # No small change of where the model has it would be touched, too.
    truth = Disturbance(wall_shift=0.15).apply(world, POLE)
    for count, found in ((15, 0.0), (16, 0.15)):
        known = watch(ModelEstimate.of(world, POLE, ["walls"]), truth, count=count)
        np.testing.assert_allclose(known.values, [0.0, found], atol=2e-3)


@pytest.mark.parametrize("scenario", [BALL, *slow(Scenario.named("pendulum/off_the_wall"))])
@pytest.mark.parametrize("shift", [0.03, *slow(-0.03)])
def test_a_rigid_wall_is_as_near_as_it_is_said_to_be(scenario: Scenario, shift: float) -> None:
    world = World.from_scenario(scenario)
    truth = Disturbance(mass_factor=1.2, wall_shift=shift).apply(world, scenario)
    known = watch(ModelEstimate.of(world, scenario, ["mass", "walls"]), truth, count=60)
    check(known, [1.2, shift])


@pytest.mark.slow
def test_noise_does_not_pass_for_another_model() -> None:
    world = World.from_scenario(POLE)
    known = watch(ModelEstimate.of(world, POLE, ["mass"]), (world, POLE), NOISE)
    assert known.values[0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("count", [2, 10])
def test_more_noise_than_is_thought_of_makes_doubts_larger(count: int) -> None:
    world = World.from_scenario(POLE)
    known = ModelEstimate.of(world, POLE, ["mass"])
    check(watch(known, (world, POLE), 5 * NOISE, count), [1.0])


@pytest.mark.slow
def test_friction_is_found_where_something_slides() -> None:
    world = World.from_scenario(dry := Scenario.named("cart_pole/dry"))
    truth = Disturbance(friction_factor=1.5).apply(world, dry)
    known = watch(ModelEstimate.of(world, dry, ["friction"]), truth, count=30)
    check(known, [1.5])
    assert known.deviations[0] < 0.15


def test_an_impact_does_not_tell_friction_from_what_slides_after_it() -> None:
    # How hard a finger hits a block depends on friction steeply, and not for long.
    block = Scenario.named("pushed_block/slide")
    world = World.from_scenario(block)
    known = ModelEstimate.of(world, block, ["mass", "friction"])
    truth = Disturbance(mass_factor=0.8, friction_factor=0.8).apply(world, block)
    held, judge = HeldControl(np.array([0.0, 0.02]), np.array([[4.0]])), EVENT_DRIVEN
    x = np.concatenate([block.initial_position, block.initial_velocity])
    for _ in range(30):
        end = judge.simulate(*truth, held, state=world.split(x))
        after = np.concatenate([end.positions[-1], end.velocities[-1]])
        known, x = known.watch((x, after), held), after
    check(known, [0.8, 0.8])
    np.testing.assert_allclose(known.values, 0.8, atol=0.01)


def test_a_kick_passes_for_no_mass() -> None:
    world = World.from_scenario(BALL)
    known = ModelEstimate.of(world, BALL, ["mass"])
    held = HeldControl(np.array([0.0, 0.02]), np.array([[1.0]]))
    for k in range(30):
        x = np.array([1.0, 0.0])
        after = np.array([1.0 + 2e-4, 0.02 + (3.0 if k == 20 else 0.0)])
        known = known.watch((x, after), held)
    assert known.values[0] == pytest.approx(1.0, abs=0.05)
    before = known
    assert before.watch((x, np.full(2, np.nan)), held) is before


def test_a_system_in_a_diagram_finds_the_mass_of_its_plant_and_what_pushes_it() -> None:
    world, mass, force = World.from_scenario(POLE), 1.2, np.array([1.5, 0.3])
    estimator = ModelEstimator(world, POLE, ["mass", "force"], period=0.01)
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    parser = Parser(plant)
    parser.package_map().AddMap(package_map())
    parser.AddModelsFromString(find_model(POLE.model).read_text(encoding="utf-8"), "sdf")
    plant.Finalize()
    builder.AddSystem(estimator)
    rng, times = np.random.default_rng(0), 0.01 * np.arange(100)
    held = PiecewisePolynomial.ZeroOrderHold(times, 5.0 * rng.normal(size=(1, 100)))
    command = builder.AddSystem(TrajectorySource(held)).get_output_port()
    push = builder.AddSystem(ConstantVectorSource(force)).get_output_port()
    builder.Connect(push, plant.get_applied_generalized_force_input_port())
    builder.Connect(command, plant.get_actuation_input_port())
    builder.Connect(command, estimator.GetInputPort("control"))
    builder.Connect(plant.get_state_output_port(), estimator.GetInputPort("estimated_state"))
    simulator = Simulator(builder.Build())
    context = set_start(plant, simulator.get_mutable_context(), POLE)
    for name in ("cart", "pole"):
        body = plant.GetBodyByName(name)
        body.SetMass(context, mass * body.get_mass(context))
    simulator.AdvanceTo(0.6)
    own = estimator.GetMyContextFromRoot(simulator.get_context())
    values, deviations = (
        estimator.GetOutputPort(name).Eval(own) for name in ("values", "deviations")
    )
    np.testing.assert_allclose(values, [mass, *force], atol=0.3)
    assert np.all(np.abs(values - [mass, *force]) < 2 * deviations)


@cache
def make_planner() -> Planner:
    return Planner(POLE, PlanOptions(renewals=8, threads=1))


@cache
def stand_up(mass: float, *estimate: Any, is_known: bool = False) -> float:
    """Returns how far from upright a pole of another mass ends (norm of m and rad)."""
    wrong, planner = Disturbance(mass_factor=mass), make_planner()
    if is_known:
        world, scenario = wrong.apply(planner.world, POLE)
        planner = Planner(scenario, planner.options, world)
    controller = ModelPredictiveController(
        planner, 0.02, "shrinking", surprise=np.inf, estimate=estimate
    )
    run = run_in_loop(controller, POLE, make_planner().world, wrong)
    assert not estimate or run.ticks[-1].estimated == pytest.approx([mass], abs=0.01)
    return float(np.linalg.norm(run.replay.positions[-1] - POLE.goal_position))


@pytest.mark.slow
def test_a_pole_of_another_mass_ends_as_near_as_one_that_is_known() -> None:
    known = stand_up(1.3, is_known=True)
    assert stand_up(1.3, "mass") < 1.2 * known < 0.3 * stand_up(1.3)


@pytest.mark.slow
def test_a_heavier_finger_is_kept_near_its_plan_by_laws_for_which_controls_cost_little() -> None:
    plan = Planner(SPINNER, PlanOptions(threads=1)).plan()
    controller = TrackingController(plan, period=0.01, estimate=["mass"])
    run = run_in_loop(controller, plan.scenario, disturbance=Disturbance(mass_factor=1.2))
    assert run.cost < 2 * plan.cost


@pytest.mark.parametrize(
    ("scenario", "unknown", "message"),
    [
        (BALL, ["friction"], "^friction_factor: got no friction, expected friction in joints"),
        (
            BALL,
            ["length"],
            "^estimate: got length, expected some of mass, friction, stiffness, walls, force",
        ),
        (BALL, ["stiffness"], "^estimate: got no compliant wall"),
        (BALL, "mass", "^estimate: got 'mass', expected a list of different names"),
        (BALL, 5, "^estimate: got 5, expected a list"),
        (BALL, ["mass", "mass"], r"^estimate: got \['mass', 'mass'\], expected a list"),
        (Scenario.named("acrobot/swing_up"), ["walls"], "^estimate: got no wall of one face"),
    ],
)
def test_what_a_model_has_nothing_of_is_refused(
    scenario: Scenario, unknown: Any, message: str
) -> None:
    with pytest.raises(ControlError, match=message):
        ModelEstimate.of(World.from_scenario(scenario), scenario, unknown)


def apply(world: World, scenario: Scenario, known: ModelEstimate, values: Any) -> Model:
    pairs = list(zip(known.parameters, values, strict=True))
    factors = {f"{each.kind}_factor": value for each, value in pairs if each.usual == 1.0}
    world, scenario = Disturbance(**factors).apply(world, scenario)
    for each, value in pairs:
        if each.kind == "walls":
            world = world.with_wall_moved(each.which, value)
        elif each.kind == "force":
            with np.errstate(invalid="ignore"):
                one = np.eye(1, world.num_velocities, each.which)[0]
                world = dataclasses.replace(world, bias=world.bias - value * one)
    return Model(world, scenario)


@pytest.mark.parametrize(
    ("name", "unknown"),
    [
        ("cart_pole/soft_06", ["mass", "stiffness", "walls", "force"]),
        *slow(("cart_pole/rigid_06", ["mass", "walls", "force"])),
        *slow(("cart_pole/dry", ["mass", "friction", "force"])),
        *slow(("hopper/hop", ["mass", "friction", "stiffness", "walls"])),
        *slow(("pushed_block/slide", ["mass", "walls", "friction"])),
        ("table1/1", ["mass", "walls"]),
        ("payload/transport", ["mass"]),
    ],
)
def test_other_models_are_those_that_would_be_read(
    name: str, unknown: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where they were read, a tick in which an estimate left its model took 50 times the usual."""
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    scenario, rng = world.place(scenario), np.random.default_rng(4)
    known = ModelEstimate.of(world, scenario, unknown)
    x, controls = scenario.initial_state, rng.normal(size=(20, world.num_actuators))
    held = HeldControl(np.linspace(0.0, 0.4, 21), controls)

    def lead(model: Model) -> Any:
        return model.find_end(x, held)

    tried = [known.values + 0.1 * rng.normal(size=len(known.values)) * known._units for _ in "12"]
    tried.append(np.where(np.array(known.names) == "friction", 1.0, tried[0]))
    expected = [lead(apply(world, scenario, known, values)) for values in tried]
    assert len(list(map(lead, known.models))) == 1 + 2 * len(known.values)  # Compiles once.

    def refuse(*given: Any, **options: Any) -> Any:
        raise AssertionError("something is read or compiled")

    monkeypatch.setattr(World, "from_diagram", refuse)
    monkeypatch.setattr(TapeBuilder, "build", refuse)
    for values, end in zip(tried, expected, strict=True):
        ends = list(map(lead, dataclasses.replace(known, values=values).build().models))
        np.testing.assert_allclose(ends[0], end, rtol=1e-8, atol=1e-9)
        assert not np.array_equal(ends[1], end)


@pytest.mark.parametrize("name", ["cart_pole/soft_06", "cart_pole/rigid_06"])
def test_a_sample_that_fits_is_predicted_once_by_each_model(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Far from walls no simulation looks for impacts, which took 7 of 10 parts of a tick."""
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    known = ModelEstimate.of(world, scenario, ["mass", "walls"])
    x, held = scenario.initial_state, HeldControl(np.array([0.0, 0.02]), np.array([[1.0]]))
    after, led, find_end = known.models[0].find_end(x, held), list[Model](), Model.find_end
    assert after is not None

    def count(model: Model, *given: Any) -> Any:
        led.append(model)
        return find_end(model, *given)

    def refuse(*given: Any) -> Any:
        raise AssertionError("impacts are looked for")

    monkeypatch.setattr(Model, "find_end", count)
    monkeypatch.setattr(Model, "predict", refuse)
    known.watch((x, after), held)
    assert led == list(known.models)


CORRIDOR = Scenario.named("corridor/three_bounces")
OFF, WEIGHT = 0.05, 1e-9  # [m], [m²/s²]


@cache
def make_world() -> World:
    return World.from_scenario(CORRIDOR)


def fly(x: float, v: float, a: float, t: float) -> tuple[float, float]:
    return x + t * v + t * t * a / 2, v + t * a


def bounce(
    rng: np.random.Generator, e: float
) -> tuple[tuple[Floats, Floats], float, Floats, tuple[int, float]]:
    """Returns samples about a bounce off a wall that is nearer or not, h, u, which, by how much."""
    world = make_world()
    u, side = rng.uniform(-1, 1, 1), rng.integers(2)
    v = -world.calc_contact_jacobian(CORRIDOR.initial_position)[side] * rng.uniform(0.5, 2)
    (a,) = world.calc_acceleration(CORRIDOR.initial_position, v, u)
    before, after = rng.uniform(0.001, 0.01, 2)
    nearer = rng.uniform(-0.02, 0.02)
    wall = CORRIDOR.initial_position + v / np.abs(v) * (
        world.calc_signed_distance(CORRIDOR.initial_position)[side] - nearer
    )
    early = np.array(fly(wall[0], v[0], a, -before))
    late = np.array(fly(wall[0], -e * v[0], a, after))
    return (early, late), before + after, u, (int(side), nearer)


def test_what_a_wall_returns_and_where_it_stands_is_learned() -> None:
    rng = np.random.default_rng(2026)
    for e in rng.uniform(0.1, 1.0, 20):
        seen = SeenBounces()
        for _ in range(3):
            samples, elapsed, control, (side, nearer) = bounce(rng, e)
            seen = seen.watch(make_world(), samples, elapsed, control, OFF)
            assert seen.latest == side
            # Both flights are straight lines in t, which misses a h².
            assert seen.nearer[side] == pytest.approx(nearer, abs=1e-4)
        assert seen.find_restitution(0.5, WEIGHT) == pytest.approx(e, abs=1e-3)


def test_a_kick_in_mid_air_is_no_bounce_and_a_slow_one_tells_little() -> None:
    x = np.concatenate([CORRIDOR.initial_position, [0.7]])
    kicked = x + 0.01 * x[1] + np.array([0.0, -1.2])
    seen = SeenBounces().watch(make_world(), (x, kicked), 0.01, np.zeros(1), OFF)
    assert seen == SeenBounces() and seen.find_restitution(0.8, WEIGHT) == 0.8
    # Nor is one beside a wall that leaves it faster than it came.
    x[0] -= (
        make_world().calc_signed_distance(x[:1])[1]
        * make_world().calc_contact_jacobian(x[:1])[1, 0]
    )
    for faster, latest in ((-1.6, None), (-1.2, 1)):
        kicked = x + np.array([0.0, faster])
        assert (
            SeenBounces().watch(make_world(), (x, kicked), 0.01, np.zeros(1), OFF).latest == latest
        )
    assert SeenBounces(1e-4, 0.2e-4).find_restitution(0.8, 1e-2) == pytest.approx(0.8, abs=0.01)
    assert SeenBounces(1.0, 1.3).find_restitution(0.8, 0.0) == 1.0


def test_a_wall_that_a_ball_is_deep_inside_of_is_farther_and_no_other() -> None:
    world, off = make_world(), 0.1
    q = CORRIDOR.initial_position
    q = q - world.calc_contact_jacobian(q)[0] * (world.calc_signed_distance(q)[0] + 0.05)
    seen = SeenBounces().pass_walls(world, q, off)
    assert 0 < world.calc_signed_distance(q)[0] - seen.nearer[0] <= 0.1 * off
    assert seen.nearer[1] == 0
    # What is touched, or much deeper than walls are off, tells of none.
    for depth in (0.001, 0.06):
        touching = q - world.calc_contact_jacobian(q)[0] * (depth - 0.05)
        assert SeenBounces().pass_walls(world, touching, 0.05) == SeenBounces()


@pytest.mark.slow
def test_a_controller_that_learns_loses_less_between_walls_that_return_less() -> None:
    truth = Disturbance(
        restitution_factor=0.9, wall_shift=-0.02, kick=np.array([0.4]), kick_time=0.3
    )
    planner = Planner(CORRIDOR, PlanOptions(branches=0, finalists=1, threads=1), make_world())
    learned, held = (
        run_in_loop(
            ModelPredictiveController(planner, 0.02, "shrinking", learns=learns),
            CORRIDOR,
            make_world(),
            truth,
        )
        for learns in (True, False)
    )
    assert learned.cost < 0.6 * held.cost
    e = [run.ticks[-1].restitution for run in (learned, held)]
    assert e == pytest.approx([0.9 * CORRIDOR.restitution, CORRIDOR.restitution], abs=3e-3)
    assert learned.ticks[-1].nearer == pytest.approx((-0.02, -0.02), abs=1e-3)
    assert held.ticks[-1].nearer == ()


BALL, POLE = Scenario.named("table1/1"), Scenario.named("cart_pole/soft_06")
