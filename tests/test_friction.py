"""Friction of a model, which no plan knows: refused where it acts, or left out when asked."""

from __future__ import annotations

import dataclasses
import math
import re
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy
from pydrake.geometry import HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction
from pydrake.multibody.tree import PrismaticJoint, RevoluteJoint, SpatialInertia, UnitInertia
from pydrake.systems.framework import Diagram, DiagramBuilder
from refusals import refuse_work
from replay_worlds import make_scenario
from rubbing_worlds import make_discs

from drake_aigto import Planner, PlanOptions, Scenario, World, plan
from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    Impulse,
    Mobility,
    Mode,
    Touching,
    calc_impulse,
    calc_slips,
    contact_law,
    find_modes,
    list_modes,
)
from drake_aigto.dynamics import calc_friction_share
from drake_aigto.errors import FrictionError, ModelError, OptionsError, ScenarioError
from drake_aigto.paper import plan_literal
from drake_aigto.show import format_plan
from drake_aigto.simulation import replay_drake, replay_event_driven
from drake_aigto.world import models_directory

Y = [0.0, 1.0, 0.0]


def material(friction: float | None) -> ProximityProperties:
    properties = ProximityProperties()
    if friction is not None:
        properties.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
    return properties


def make_diagram(
    frictions: tuple[float | None, float | None], along: bool = False, spins: bool = False
) -> Diagram:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    inertia = SpatialInertia(1.0, np.zeros(3), UnitInertia.SolidSphere(0.1))
    lift = plant.AddRigidBody("lift", SpatialInertia.Zero())
    ball = plant.AddRigidBody("ball", inertia)
    rise = PrismaticJoint("rise", plant.world_frame(), lift.body_frame(), [0.0, 0.0, 1.0])
    plant.AddJointActuator("rise", plant.AddJoint(rise))
    frames = lift.body_frame(), ball.body_frame()
    if spins:
        plant.AddJoint(RevoluteJoint("turn", *frames, Y))
    elif along:
        plant.AddJoint(PrismaticJoint("move", *frames, Y))
    else:
        plant.WeldFrames(*frames)
    shapes = (ball, Sphere(0.1), "ball"), (plant.world_body(), HalfSpace(), "ground")
    for (body, shape, name), friction in zip(shapes, frictions, strict=True):
        plant.RegisterCollisionGeometry(body, RigidTransform(), shape, name, material(friction))
    plant.Finalize()
    plant.SetDefaultPositions(np.ones(plant.num_positions()))
    return builder.Build()


@pytest.mark.parametrize(
    ("frictions", "expected"),
    [
        ((0.3, 0.6), 2 * 0.3 * 0.6 / 0.9),
        ((0.0, 0.6), 0.0),
        ((None, None), 0.5),  # Drake's default, of which only contexts know.
        ((None, 1.0), 2 / 3),
    ],
)
def test_friction_is_what_drake_makes_of_both_shapes(
    frictions: tuple[float | None, float | None], expected: float
) -> None:
    world = World.from_diagram(make_diagram(frictions, along=True))
    assert sum(world.frictions.values()) == pytest.approx(expected, rel=1e-12)


def test_friction_acts_on_what_slides_or_spins_and_grows_smoothly_from_rest() -> None:
    rough, rubbing = (1.0, 1.0), {"ball against ground": 1.0}
    assert World.from_diagram(make_diagram(rough)).frictions == {}
    assert World.from_diagram(make_diagram(rough, along=True)).frictions == rubbing
    assert World.from_diagram(make_diagram(rough, spins=True)).frictions == rubbing
    speeds = np.array([-3.0, -1.0, -0.5, 0.0, 0.25, 1.0, 7.0])
    x = 0.25
    expected = [-1, -1, -0.5, 0, 10 * x**3 - 15 * x**4 + 6 * x**5, 1, 1]
    np.testing.assert_allclose(calc_friction_share(0.01 * speeds, 0.01), expected, atol=1e-15)


@pytest.fixture
def rough_room(tmp_path: Path) -> Path:
    """Returns the shipped room without a word about friction."""
    text = (models_directory() / "room.sdf").read_text(encoding="utf-8")
    path = tmp_path / "rough_room.sdf"
    path.write_text(re.sub(r"<drake:mu_.*>", "", text), encoding="utf-8")
    return path


def test_friction_whose_impacts_are_not_planned_is_refused_before_any_work(
    rough_room: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rough = dataclasses.replace(Scenario.named("room/bank_shot"), model=str(rough_room))
    monkeypatch.setattr("drake_aigto.planning.planner.BallTask", refuse_work)
    pendulum = dataclasses.replace(Scenario.named("pendulum/off_the_wall"), friction=0.2)
    with pytest.raises(ModelError, match=r"got friction 0.2 and a mechanism of one coordinate"):
        Planner(pendulum)
    with pytest.raises(OptionsError, match=r"aigo_steps: got 9 for a mechanism"):
        Planner(rough, PlanOptions(aigo_steps=9))


RAIL = """<link name="rail"><collision name="rail_collision">
      <pose>0 0 -0.049 0 0 0</pose>
      <geometry><plane><normal>0 0 1</normal></plane></geometry>
    </collision></link>
    <joint name="rail_to_world" type="fixed"><parent>world</parent><child>rail</child></joint>
  </model>"""


def slide(directory: Path) -> Scenario:
    """Returns a task in the shipped corridor, with a ball that is 1 mm deep in a rough rail."""
    scenario = Scenario.named("corridor/three_bounces")
    text = (models_directory() / "corridor.sdf").read_text(encoding="utf-8")
    text = re.sub(r"<drake:mu_.*>", "", text)
    path = directory / "rail.sdf"
    path.write_text(text.replace("</model>", RAIL), encoding="utf-8")
    return dataclasses.replace(scenario, model=str(path))


@pytest.mark.slow
def test_friction_of_what_the_ball_always_overlaps_is_refused_or_left_out_as_asked(
    tmp_path: Path,
) -> None:
    rough = slide(tmp_path)
    with pytest.raises(ModelError, match=r"friction of ball against rail: got μ = 1 where .*"):
        World.from_scenario(rough)
    found = plan(dataclasses.replace(rough, friction=0.0))
    assert found.holds
    assert found.best.cost == plan(Scenario.named("corridor/three_bounces")).cost
    assert "left out of the simulation, as asked: the model's, μ = 1" in format_plan(found)


def ask(**changes: Any) -> Scenario:
    fields: dict[str, Any] = {
        "duration": 1.0,
        "initial_position": [1.0, 1.5],
        "initial_velocity": [-1.0, 0.0],
    }
    return dataclasses.replace(Scenario.named("cart_pole/dry"), **{**fields, **changes})


@cache
def read_dry() -> World:
    return World.from_scenario(ask())


def calc_energy(x: Any) -> float:
    q, v = x[:2], x[2:]
    kinetic = float(read_dry().calc_kinetic_energy(q, v))
    return kinetic - 0.1 * 9.81 * float(np.cos(q[1]))


def test_what_slides_loses_the_friction_times_its_way_and_what_rests_stays() -> None:
    world, start = read_dry(), {"initial_position": [0.0, 0.0], "initial_velocity": [3.0, 2.0]}
    times, rest = np.array([0.0, 0.3]), {**start, "initial_velocity": [0.0, 0.0]}
    for replay in (replay_event_driven, replay_drake):
        slid = replay(world, ask(**start), times, np.zeros((1, 1)))
        x = np.hstack([slid.positions, slid.velocities])
        assert x[-1, 2] > 1.0
        lost = calc_energy(x[0]) - calc_energy(x[-1])
        assert lost == pytest.approx(2.0 * (x[-1, 0] - x[0, 0]), rel=1e-7)
        held = replay(world, ask(**rest), times, np.array([[1.8]]))
        assert 0 < held.positions[-1, 0] < 0.3 * world.stiction_speed


def test_both_replays_agree_on_what_rubs() -> None:
    times = np.linspace(0.0, 1.0, 21)
    controls = 6 * np.sin(9 * times[:-1, np.newaxis])
    own, drake = (
        replay(read_dry(), ask(), times, controls) for replay in (replay_event_driven, replay_drake)
    )
    np.testing.assert_allclose(own.positions[-1], drake.positions[-1], atol=1e-6)
    assert own.cost == pytest.approx(drake.cost, rel=1e-7)
    smooth = dataclasses.replace(ask(), dry_friction=None)
    without = replay_drake(World.from_scenario(smooth), smooth, times, controls)
    assert np.abs(without.positions[-1] - drake.positions[-1]).max() > 0.1


def test_a_plan_on_a_dry_rail_holds_in_both_simulations_and_pays_for_the_friction() -> None:
    options = PlanOptions(renewals=0, finalists=1, starts=3)
    plan = Planner(ask(), options).plan()
    assert plan.holds
    for replay in plan.replay:
        assert replay.cost == pytest.approx(plan.cost, rel=1e-3)
    smooth = dataclasses.replace(ask(), dry_friction=None)
    assert Planner(smooth, options).plan().cost < 0.99 * plan.cost


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("dry_friction", [-1.0, 0.0], "dry_friction: got -1, expected at least 0"),
        ("dry_friction", [np.nan, 0.0], "dry_friction: got nan, expected a finite number"),
        ("dry_friction", [1.0], "dry_friction: got 1 value, expected 2, one for each coordinate"),
        ("stiction_speed", 0.0, "stiction_speed: got 0 m/s, expected more than 0 m/s"),
    ],
)
def test_bad_friction_is_refused(field: str, value: Any, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        World.from_scenario(ask(**{field: value}))


def test_a_world_with_other_friction_is_refused() -> None:
    for field, value in (("dry_friction", [1.0, 0.0]), ("stiction_speed", 0.5)):
        with pytest.raises(
            ScenarioError, match=f"{field}: .* Give the scenario the world's {field}"
        ):
            read_dry().check(ask(**{field: value}))
    smooth = World.from_scenario(dataclasses.replace(ask(), dry_friction=None))
    with pytest.raises(ModelError, match="dry_friction: got a diagram in which nothing applies"):
        World.from_diagram(smooth.diagram, dry_friction=np.ones(2))


def draw(rng: np.random.Generator, size: int = 3) -> tuple[Mobility, Floats, Floats, Floats]:
    root = rng.normal(size=(size, size))
    mass_matrix = root @ root.T + 0.1 * np.eye(size)
    normal, tangent = rng.normal(size=(2, size))
    return Mobility.of(normal, tangent, mass_matrix), mass_matrix, normal, tangent


def test_energy_never_grows_and_impulses_stay_in_the_cone() -> None:
    rng = np.random.default_rng(1)
    slowed = 0
    for _ in range(500):
        mobility, M, J, T = draw(rng)
        v, (e, mu) = rng.normal(size=3), rng.uniform(0.0, [1.0, 2.0])
        v = v if J @ v < 0 else -v
        p_n, p_t, mode = calc_impulse(mobility, float(J @ v), float(T @ v), e, mu)
        after = v + np.linalg.solve(M, J * p_n + T * p_t)
        size = v @ M @ v
        assert after @ M @ after <= size * (1 + 1e-12)
        assert abs(p_t) <= mu * p_n * (1 + 1e-12)
        assert -1e-12 <= J @ after <= -e * (J @ v) * (1 + 1e-9) + 1e-12
        slowed += bool(J @ after < -e * (J @ v) * (1 - 1e-9))
        assert (T @ after) * mode >= -1e-12
        assert mode or T @ after == pytest.approx(0.0, abs=1e-12)
    assert slowed  # Where Newton's rule alone would return more than was taken.


def integrate(mobility: Mobility, rate: float, slip: float, e: float, mu: float) -> Floats:
    """Returns p_n and p_t, of Routh's path integrated with a smooth sign of the slip velocity."""
    a, b, c = mobility
    smooth = 1e-7

    def slopes(_: float, y: Floats) -> list[float]:
        share = -mu * math.tanh(y[1] / smooth)
        return [a + b * share, b + c * share, share, y[0]]

    def compressed(_: float, y: Floats) -> float:
        return float(y[0])

    compressed.terminal, compressed.direction = True, 1.0  # type: ignore[attr-defined]
    options = {"method": "Radau", "rtol": 1e-9, "atol": 1e-11}
    far = (0.0, 1e4)
    half = scipy.integrate.solve_ivp(slopes, far, [rate, slip, 0, 0], events=compressed, **options)
    limit = (1 - e**2) * half.y[3, -1]

    def ended(_: float, y: Floats) -> float:
        return float(max(y[0] + e * rate, y[3] - limit))

    ended.terminal, ended.direction = True, 1.0  # type: ignore[attr-defined]
    start = half.y[:, -1]
    whole = scipy.integrate.solve_ivp(slopes, far, start, events=ended, **options)
    return np.array([half.t[-1] + whole.t[-1], whole.y[2, -1]])


def test_the_closed_form_is_the_integral_of_rouths_path() -> None:
    rng = np.random.default_rng(2)
    modes = set()
    for _ in range(12):
        mobility, _, _, _ = draw(rng, 2)
        rate, slip, e, mu = -rng.uniform(0.5, 2.0), rng.normal(), *rng.uniform(0.1, [0.9, 1.0])
        found = calc_impulse(mobility, rate, slip, e, mu)
        modes.add((found.mode, np.sign(slip) == found.mode))
        expected = integrate(mobility, rate, slip, e, mu)
        assert np.array(found[:2]) == pytest.approx(expected, rel=1e-5)
    assert len(modes) > 3  # Stick, slip that goes on, and slip that turns round.


@pytest.mark.parametrize("gyration", [2 / 5, 1 / 2])
@pytest.mark.parametrize("e", [0.0, 0.7, 1.0])
def test_a_round_ball_bounces_as_tables_of_spin_say(gyration: float, e: float) -> None:
    """Of a ball of unit mass and radius, with I = β: it grips where μ (1 + e) |v_n| ≥ |s| β/(1+β).

    Gripped, its spin and its speed along the wall end in rolling; else it loses μ (1 + e) |v_n|.
    """
    mobility = Mobility(1.0, 0.0, 1 + 1 / gyration)
    v_n, v_t, spin, mu = -2.0, 3.0, 1.5, 0.24
    s = v_t - spin
    p_n, p_t, mode = calc_impulse(mobility, v_n, s, e, mu)
    assert p_n == pytest.approx((1 + e) * 2.0)
    grip = abs(s) * gyration / (1 + gyration)
    assert p_t == pytest.approx(-min(grip, mu * p_n))
    assert (mode == Mode.STICK) == (grip <= mu * p_n)


def test_an_impact_whose_slip_turns_round_returns_no_more_work_than_was_taken() -> None:
    """Newton's rule alone would: all numbers are fractions but the root of the energy.

    a, b, c = 2, −1, 1, μ = 1/2, φ̇ = −1, s = 1/4, e = 1: slip lasts for p_n = 1/6, φ̇ rises by 5/2
    a unit; then it turns round, as |b| > μ c, with 3/2 a unit.
    """
    found = calc_impulse(Mobility(2.0, -1.0, 1.0), -1.0, 0.25, 1.0, 0.5)
    now = -1 + 5 / 2 / 6
    taken = now**2 / 3 + (1 - now) / 12
    assert found.mode == Mode.BACKWARD
    rest = (-now + min(1.0, math.sqrt(3 * taken))) / 1.5
    assert found == pytest.approx(Impulse(1 / 6 + rest, -1 / 12 + rest / 2, Mode.BACKWARD))


def read_slip(world: World, q: Floats, v: Floats) -> float:
    """Returns the slip speed of the only contact that Drake sees."""
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.SetPositionsAndVelocities(context, np.concatenate([q, v]))
    results = world.plant.get_contact_results_output_port().Eval(context)
    assert results.num_point_pair_contacts() == 1
    return float(results.point_pair_contact_info(0).slip_speed())


def test_a_ball_slips_on_level_and_on_tilted_ground_as_in_drake() -> None:
    world = World.from_diagram(make_discs(tilts=True, stiffness=300.0))
    rng = np.random.default_rng(1)
    for _ in range(5):
        q, v = rng.uniform(-0.5, 0.5, (2, 4))
        height = world.calc_signed_distance(q)[0]
        q[1] -= (height + 0.01) / np.cos(q[3])  # 1 cm deep.
        slip = read_slip(world, q, v)
        law = contact_law(world, make_scenario(contact="compliant"))
        assert abs(calc_slips(world, law, q, v)) == pytest.approx(slip, rel=1e-12)


def test_two_balls_slip_about_each_other_as_in_drake_where_they_just_touch() -> None:
    world = World.from_diagram(make_discs((0.1, 0.2)))
    (pair,) = (i for i, each in enumerate(world.contacts) if "world" not in each.name)
    rng = np.random.default_rng(2)
    for angle in rng.uniform(0.0, np.pi, 5):
        q, v = np.array([0.0, 1.0, 0.3, 0.0, 1.0, 0.2]), rng.uniform(-1.0, 1.0, 6)
        q[3:5] += (0.3 - 1e-9) * np.array([np.cos(angle), np.sin(angle)])
        slip = read_slip(world, q, v)
        assert abs(world.rubbing.calc_slips(q, v)[pair]) == pytest.approx(slip, rel=1e-7)


def test_the_slip_velocity_changes_as_its_bias_says() -> None:
    world = World.from_diagram(make_discs((0.1, 0.2), tilts=True))
    q, v = np.random.default_rng(3).uniform(-1.0, 1.0, (2, 7))
    step = 1e-6
    ends = [world.rubbing.calc_tangent_jacobian(q + sign * step * v) @ v for sign in (1, -1)]
    change = (ends[0] - ends[1]) / (2 * step)
    assert world.rubbing.calc_tangent_bias(q, v) == pytest.approx(change, rel=1e-8, abs=1e-8)


def read_friction(world: World, friction: float | None) -> tuple[float, float]:
    root = world.create_context()
    world.rubbing.impose(root, friction)
    query: Any = world.scene_graph.get_query_output_port()
    inspector = query.Eval(world.scene_graph.GetMyContextFromRoot(root)).inspector()
    ((_, ground),) = world.shapes
    found = inspector.GetProximityProperties(ground).GetProperty("material", "coulomb_friction")
    return found.static_friction(), found.dynamic_friction()


def drop_onto(friction: float | None = None, num_positions: int = 3) -> Scenario:
    place = np.concatenate([[0.0, 1.0], np.zeros(num_positions - 2)])
    still = np.zeros(num_positions)
    return make_scenario(place, still, place, goal_weight=np.ones(num_positions), friction=friction)


@pytest.mark.parametrize(("asked", "expected"), [(None, 0.4), (0.7, 0.7), (0.0, 0.0)])
def test_of_two_coefficients_the_dynamic_one_counts_unless_the_scenario_has_its_own(
    asked: float | None, expected: float
) -> None:
    world = World.from_diagram(make_discs(friction=CoulombFriction(0.9, 0.4)))
    assert world.friction_coefficients(drop_onto(asked)) == pytest.approx([expected])
    both = read_friction(world, asked)
    assert both == pytest.approx((expected or both[0], expected or both[1]))


def test_what_counts_for_nothing_or_can_not_act_is_refused() -> None:
    world = World.from_scenario(Scenario.named("table1/1"))
    task = dataclasses.replace(Scenario.named("table1/1"), friction=0.2)
    with pytest.raises(ScenarioError, match=r"friction: got 0\.2, in a world where no sphere can"):
        world.check(task)
    rough = World.from_diagram(make_discs(across=True))
    with pytest.raises(ModelError, match=r"ball_0 against world_1: got μ = 0\.3 .* two directions"):
        rough.check(drop_onto(num_positions=4))
    rough.check(drop_onto(0.0, num_positions=4))


@pytest.mark.parametrize("friction", [None, 0.7])
def test_who_plans_without_friction_refuses_it(friction: float | None) -> None:
    world = World.from_diagram(make_discs())
    world.check(task := drop_onto(friction))
    with pytest.raises(ModelError, match=r"friction of ball_0 against world_1: got μ = 0\."):
        plan_literal(task, world=world)


def touch(
    rows: Floats, mass_matrix: Floats, rates: Floats, friction: list[float], slips: list[int]
) -> Touching:
    kicks = np.asarray(np.linalg.solve(mass_matrix, rows.T), dtype=float)
    return Touching(kicks, rows, rates, np.array(friction), slips)


def test_contacts_that_end_a_collapse_together_make_no_energy() -> None:
    """Some way always exists, and it obeys Coulomb's law."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        n, k = int(rng.integers(2, 6)), int(rng.integers(1, 4))
        root, rows = rng.normal(size=(n, n)), rng.normal(size=(2 * k, n))
        M, v = root @ root.T + 0.2 * np.eye(n), rng.normal(size=n)
        friction = rng.uniform(0.0, 1.5, k)
        going = next(list_modes(touch(rows, M, rows @ v, friction.tolist(), [0] * k)))
        after = v + going.change
        normal, tangent = np.split(going.forces, 2)
        rates, slips = np.split(rows @ after, 2)
        assert after @ M @ after <= v @ M @ v * (1 + 1e-9)
        assert np.all(rates >= -1e-9)
        assert np.all(normal >= -1e-9)
        assert np.all(np.abs(tangent) <= friction * normal + 1e-9)
        assert normal @ rates == pytest.approx(0.0, abs=1e-8)
        assert tangent @ slips == pytest.approx(-(friction * normal) @ np.abs(slips), abs=1e-8)


# A rod that touches with its end: a = 1, b = −1, c = 2, so that slip backward at μ > 1 presses it
# down harder than it is pushed up.
ROD = np.array([[1.0, 0.0], [-1.0, 1.0]])


@pytest.mark.parametrize(
    ("push", "message"), [(-1.0, "got none of the ways"), (1.0, "several.*: backward or open")]
)
def test_what_painleve_found_is_refused(push: float, message: str) -> None:
    rates = np.array([push, 0.0])
    with pytest.raises(FrictionError, match=message):
        find_modes(touch(ROD, np.eye(2), rates, [1.5], [-1]))
    assert find_modes(touch(ROD, np.eye(2), rates, [0.5], [-1])).modes == (
        Mode.BACKWARD if push < 0 else Mode.OPEN,
    )


def test_feet_that_hold_each_other_up_without_need_stay_as_long_as_any_forces_hold_them() -> None:
    """A block on two feet, one of which carries next to nothing: the other holds it."""
    rows = np.array([[0.0, 1.0, -1.0], [0.0, 1.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for push, mode in ((0.49, Mode.STICK), (0.51, Mode.FORWARD)):
        rates = rows @ np.array([push, -1.0, 0.98])
        going = find_modes(touch(rows, np.eye(3), rates, [0.5, 0.5], [0, 0]))
        assert going.modes == (mode, mode)
