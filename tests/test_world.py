"""The world: what is read off a plant agrees with Drake's own numbers."""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from mechanisms import build
from pydrake.geometry import Box, Cylinder, HalfSpace, ProximityProperties, SceneGraph, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    LinearSpringDamper,
    PrismaticJoint,
    PrismaticSpring,
    SpatialInertia,
    UnitInertia,
)
from pydrake.symbolic import Expression, Variable, cos, sin
from pydrake.systems.framework import Context, Diagram, DiagramBuilder
from world_models import (
    RELATIVE,
    SHIPPED,
    VARIANTS,
    ModelWriter,
    differs_by_zero,
    evaluate,
    make_scenario,
    make_world,
)

from drake_aigto import Scenario, World, scenario_names
from drake_aigto.dynamics import SumMap, tidy
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.paper import LiteralTranscription
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.world import Fingerprint, models_directory


def test_the_worlds_parts_are_read_only() -> None:
    world = World.from_scenario(Scenario.named("table1/1"))
    with pytest.raises(dataclasses.FrozenInstanceError):
        world.mass = 2.0  # type: ignore[misc]
    names = ("positions", "velocities", "controls", "mass_matrix", "bias", "actuation")
    arrays = [getattr(world, name) for name in names]
    for array in [*arrays, world.contacts[0].jacobian]:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[0]


@pytest.mark.parametrize("mass", [None, 2.5])
@pytest.mark.parametrize("name", VARIANTS)
def test_mass_and_acceleration_are_the_plants(
    write_model: ModelWriter, name: str, mass: float
) -> None:
    world = make_world(write_model, name, mass)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    generator = np.random.default_rng(1)
    n = world.num_positions
    for _ in range(5):
        q = generator.uniform(0.6, 2.0, n)  # Away from contact.
        v = generator.uniform(-3.0, 3.0, n)
        u = generator.uniform(-5.0, 5.0, world.num_actuators)
        world.plant.SetPositions(context, q)
        world.plant.SetVelocities(context, v)
        world.plant.get_actuation_input_port().FixValue(context, u)
        expected = world.plant.EvalTimeDerivatives(context).CopyToVector()[n:]
        got, M = world.calc_acceleration(q, v, u), world.plant.CalcMassMatrix(context)
        np.testing.assert_allclose(got, expected, rtol=RELATIVE, atol=10 * RELATIVE)
        np.testing.assert_allclose(world.calc_mass_matrix(q), M, rtol=RELATIVE, atol=RELATIVE)


@pytest.mark.parametrize("name", VARIANTS)
def test_signed_distance_is_that_of_the_geometry_and_the_jacobian_its_derivative(
    write_model: ModelWriter, name: str
) -> None:
    world = make_world(write_model, name)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    ((sphere, wall),) = world.scene_graph.model_inspector().GetCollisionCandidates()
    generator = np.random.default_rng(3)
    previous = None
    for _ in range(5):
        # "turned wall" shows the ball a face 0.3 m across; stay in front of it.
        q = generator.uniform(0.5, 0.6, world.num_positions)
        world.plant.SetPositions(context, q)
        query = world.scene_graph.get_query_output_port().Eval(
            world.scene_graph.GetMyContextFromRoot(root)
        )
        expected = query.ComputeSignedDistancePairClosestPoints(sphere, wall).distance
        (got,) = world.calc_signed_distance(q)
        assert got == pytest.approx(expected, abs=RELATIVE)
        if previous is not None:  # φ is linear here, so a difference is a derivative.
            J = evaluate(world.contacts[0].jacobian, world.positions, q)
            assert J @ (q - previous[0]) == pytest.approx(got - previous[1], abs=RELATIVE)
        previous = q, got


def test_replacing_the_mass_edits_neither_the_plant_nor_the_inertias_shape() -> None:
    world = World.from_scenario(make_scenario(mass=4.0))
    ball = world.plant.GetBodyByName("ball")
    assert ball.default_mass() == 1.0
    context = world.plant.GetMyContextFromRoot(world.create_context())
    assert ball.get_mass(context) == 4.0
    moments = ball.CalcSpatialInertiaInBodyFrame(context).CalcRotationalInertia().get_moments()
    np.testing.assert_allclose(moments, 4.0 * 0.001, rtol=RELATIVE)  # 2/5 m r²


def test_tidying_drops_rounding_and_what_cancels_and_keeps_physics() -> None:
    x, y = Variable("x"), Variable("y")
    first, second = tidy(np.array([2.0 * (x + 1e-9 * y) + 6e-17 * x * y, Expression(0.0)]))
    assert differs_by_zero(first, 2.0 * x + 2e-9 * y)
    assert second.EqualTo(Expression(0.0))
    one, double = tidy(np.array([sin(x) ** 2 + cos(x) ** 2, 2.0 * sin(x) * cos(x) - sin(2.0 * x)]))
    assert one.EqualTo(Expression(1.0))
    assert double.EqualTo(Expression(0.0))


def test_compiled_sums_agree_with_drakes_expressions() -> None:
    x, y = Variable("x"), Variable("y")
    wave = x * sin(x) ** 2 * cos(x - 2.0 * y) + x * y**2
    cubic = 3.0 * x**3 * y - y + 2.0
    expressions = np.array([wave, cubic, x + y, Expression(0.0), Expression(4.0)])
    for first in range(4):  # With waves, cubic, affine, constant.
        some = expressions[first:]
        compiled = SumMap(some, np.array([x, y]))
        for point in np.random.default_rng(4).uniform(-2.0, 2.0, (5, 2)):
            np.testing.assert_allclose(
                compiled(point), evaluate(some, (x, y), point), rtol=RELATIVE, atol=RELATIVE
            )


@pytest.mark.parametrize("place", ["drake_aigto/models", "models"])
def test_the_models_are_found_in_a_wheel_and_in_a_checkout_or_reported(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drake_aigto.world.files.resources.files", lambda name: tmp_path / name)
    with pytest.raises(ModelError, match=r"shipped models are missing.*Install drake_aigto again"):
        models_directory()
    (tmp_path / place).mkdir(parents=True)
    (tmp_path / place / "package.xml").write_text(
        (SHIPPED.parent / "package.xml").read_text(encoding="utf-8"), encoding="utf-8"
    )
    assert models_directory() == tmp_path / place


NUM_POINTS = 40
RADII = {"corridor": 0.05, "floor": 0.05, "room": 0.02, "room_with_block": 0.02}
HALF_SPACES = (
    "Rigid (non-deformable) half spaces are not currently supported for deformable contact; "
    "registration is allowed, but no contact data will be reported."
)
NAMES = [*RADII, "two_masses", "table1"]


def load(name: str) -> World:
    first = next(each for each in scenario_names() if each.startswith(f"{name}/"))
    return World.from_scenario(Scenario.named(first))


def measure(world: World, q: np.ndarray, root: Any) -> dict[Any, float]:
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.SetPositions(context, q)
    scene_graph: SceneGraph = world.scene_graph
    query = scene_graph.get_query_output_port().Eval(scene_graph.GetMyContextFromRoot(root))
    pairs = query.ComputeSignedDistancePairwiseClosestPoints(10.0)
    return {frozenset((pair.id_A, pair.id_B)): pair.distance for pair in pairs}


def sample(world: World, seed: int) -> Iterator[tuple[np.ndarray, list[float]]]:
    """Yields positions in and around the unit cube, and Drake's distance for each contact."""
    root = world.create_context()
    for q in np.random.default_rng(seed).uniform(-0.1, 1.1, (NUM_POINTS, world.num_positions)):
        if world.plant.HasModelInstanceNamed("two_masses"):
            q = np.sort(q) - [0.0, 0.05]  # One is inside the other, but none has gone through.
        distances = measure(world, q, root)
        yield q, [distances[frozenset(shapes)] for shapes in world.shapes]


def unbounded(world: World) -> list[Any]:
    """Returns φ of each shipped world's walls, by hand."""
    q = world.positions
    if world.plant.HasModelInstanceNamed("two_masses"):
        return [q[0], q[1] - q[0], 1 - q[1]]
    if any(map(world.plant.HasModelInstanceNamed, ("floor", "point_mass_and_wall"))):
        return [q[0]]
    return [distance for x in q for distance in (x, 1 - x)]


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_world_is_of_what_its_brief_says(name: str) -> None:
    world = load(name)
    walls = unbounded(world)
    blocks = 4 if name == "room_with_block" else 0
    assert world.num_contacts == len(walls) + blocks
    assert [contact.solid for contact in world.contacts] == [*range(len(walls))] + [
        len(walls)
    ] * blocks
    for contact, distance in zip(world.contacts, walls, strict=False):
        assert differs_by_zero(contact.signed_distance, distance)
        for slope, x in zip(contact.jacobian, world.positions, strict=True):
            assert differs_by_zero(slope, (1.0 * distance).Differentiate(x))
    nq = world.num_positions
    np.testing.assert_array_equal(world.constant_inertia.mass_matrix, np.eye(nq))
    np.testing.assert_array_equal(world.actuation, np.eye(nq))
    assert np.all(np.isinf(world.limits.position))
    weight = 9.81 if name == "floor" else 0.0
    for entry in world.bias:
        assert differs_by_zero(entry, weight)
    inspector = world.scene_graph.model_inspector()
    for shape in {shape for pair in world.shapes for shape in pair}:
        material = inspector.GetProximityProperties(shape)
        assert material.GetProperty("material", "point_contact_stiffness") == 2e9
        assert material.GetProperty("material", "hunt_crossley_dissipation") == 0.0
        friction = material.GetProperty("material", "coulomb_friction")
        assert friction.static_friction() == friction.dynamic_friction() == 0.0


def test_the_block_keeps_the_balls_centre_out_of_a_square() -> None:
    world = load("room_with_block")
    for q, clearance in (
        ([0.39, 0.5], 0.01),
        ([0.61, 0.5], 0.01),
        ([0.5, 0.7], 0.1),
        ([0.5, 0.45], -0.05),
        ([0.3, 0.8], 0.2),
    ):
        assert world.calc_clearance(np.array(q))[-1] == pytest.approx(clearance, abs=RELATIVE)


@pytest.mark.parametrize("name", NAMES)
def test_faces_are_as_far_and_clearance_has_the_sign_that_drake_says(name: str) -> None:
    world = load(name)
    seen = np.zeros(world.num_contacts, dtype=bool)
    for q, distances in sample(world, seed=1):
        got = world.calc_signed_distance(q)
        # Drake measures to the nearest face: from behind a box's face that is another one.
        behind = [contact.name.endswith("face") for contact in world.contacts] & (
            got < -RADII.get(name, 0.0)
        )
        compared = world.is_on_face(q) & ~behind
        np.testing.assert_allclose(got[compared], np.array(distances)[compared], atol=RELATIVE)
        seen |= compared
    assert np.all(seen)
    solids = [contact.solid for contact in world.contacts]
    for q, distances in sample(world, seed=2):
        drake = np.array([distances[solids.index(solid)] for solid in range(world.num_solids)])
        got = world.calc_clearance(q)
        assert np.all(got <= drake + RELATIVE)  # Corners are sharp: never farther than it is.
        corner = (np.abs(q - 0.5) > 0.08).all() and (np.abs(q - 0.5) < 0.1).all()
        if not corner:
            np.testing.assert_array_equal(got >= 0, drake >= 0)


FIRST = {name.partition("/")[0]: name for name in reversed(scenario_names())}.values()
OTHER_NAMES = [name for name in scenario_names() if name not in FIRST]


@pytest.mark.parametrize("name", [*FIRST, *slow(*OTHER_NAMES)])
def test_a_shipped_scenario_fits_its_world(name: str) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    world.check(world.place(scenario))


def test_what_drake_says_of_deformable_bodies_is_not_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    logger, world = logging.getLogger("drake"), load("floor")

    class Noisy:
        def CreateDefaultContext(self) -> Context:
            logger.warning(HALF_SPACES)
            logger.warning("other")
            return world.diagram.CreateDefaultContext()

    diagram: Any = Noisy()
    dataclasses.replace(world, diagram=diagram).create_context()
    diagram.CreateDefaultContext()
    assert caplog.messages == ["other", HALF_SPACES, "other"]


RADIUS = 0.125
AXES = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1], "askew": [0.6, 0.8, 0]}
Shapes = Sequence[tuple[str, Any, Sequence[float]]]


def material(restitution: object = None, friction: float = 0.0) -> ProximityProperties:
    properties = ProximityProperties()
    properties.AddProperty("material", "coulomb_friction", CoulombFriction(friction, friction))
    if restitution is not None:
        properties.AddProperty("material", "restitution", restitution)
    return properties


def add_ball(plant: MultibodyPlant, name: str, axes: Sequence[str], actuated: bool = True) -> None:
    """Adds a ball of 2 kg on a chain of prismatic joints, its carriages without mass."""
    parent = plant.world_frame()
    inertia = SpatialInertia(2.0, np.zeros(3), UnitInertia.SolidSphere(RADIUS))
    for axis in axes:
        is_last = axis == axes[-1]
        body = plant.AddRigidBody(
            name if is_last else f"{name} {axis}", inertia if is_last else SpatialInertia.Zero()
        )
        joint = PrismaticJoint(f"{name} {axis}", parent, body.body_frame(), AXES[axis])
        plant.AddJoint(joint)
        if actuated or axis != axes[-1]:
            plant.AddJointActuator(f"{name} {axis}", plant.GetJointByName(joint.name()))
        parent = body.body_frame()
    plant.RegisterCollisionGeometry(
        plant.GetBodyByName(name), RigidTransform(), Sphere(RADIUS), f"{name} shape", material()
    )


def make_diagram(
    axes: Sequence[str], walls: Shapes, start: Any, restitution: object = None, balls: int = 1
) -> Diagram:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    for number in range(balls):
        add_ball(plant, "ball" if number == 0 else f"ball {number}", axes)
    for name, shape, place in walls:
        plant.RegisterCollisionGeometry(
            plant.world_body(), RigidTransform(place), shape, name, material(restitution)
        )
    plant.Finalize()
    plant.SetDefaultPositions(np.ravel(start))
    return builder.Build()


def pose_world(axes: Sequence[str], walls: Shapes, start: Any, **fields: Any) -> World:
    return World.from_diagram(make_diagram(axes, walls, start, **fields))


BLOCK = ("block", Box(0.5, 0.75, 1.0), [1.0, 0.0, 0.0])
GROUND = ("ground", HalfSpace(), [0.0, 0.0, -5.0])


def names_of(world: World) -> list[str]:
    return [contact.name for contact in world.contacts]


@pytest.mark.parametrize(
    ("start", "distance"), [(0.0, lambda q: 0.625 - q), (2.0, lambda q: q - 1.375)]
)
def test_a_ball_on_a_line_meets_the_face_that_it_faces(start: float, distance: Any) -> None:
    world = pose_world("x", [BLOCK], start)
    assert names_of(world) == ["ball against block"]
    assert differs_by_zero(world.contacts[0].signed_distance, distance(world.positions[0]))


def test_a_ball_may_meet_every_side_of_a_block_on_a_plane_and_in_space() -> None:
    world = pose_world("xy", [BLOCK], [0.0, 0.0])
    x, y = world.positions
    expected = {"+x": x - 1.375, "-x": 0.625 - x, "+y": y - 0.5, "-y": -0.5 - y}
    assert names_of(world) == [f"ball against block, {face} face" for face in expected]
    for contact, distance in zip(world.contacts, expected.values(), strict=True):
        assert differs_by_zero(contact.signed_distance, distance)
    assert (world.num_contacts, world.num_solids) == (4, 1)
    assert {contact.solid for contact in world.contacts} == {0}
    assert pose_world("xyz", [BLOCK], np.zeros(3)).num_contacts == 6


@pytest.mark.parametrize("height", [0.625, 0.9])
@pytest.mark.parametrize(("axes", "start"), [("x", 0.0), ("xy", [0.0, 0.0])])
def test_a_block_that_the_ball_passes_above_or_slides_on_is_no_contact(
    height: float, axes: str, start: Any
) -> None:
    low = ("low", Box(0.4, 0.6, 1.0), [1.0, 0.0, -height])
    world = pose_world(axes, [low, BLOCK], start)
    assert not [name for name in names_of(world) if "low" in name]
    world = pose_world(axes, [low], start)
    assert world.notes == (
        "nothing can touch: no motion brings together any two of 2 collision shapes",
    )


def test_half_spaces_are_solids_of_their_own_in_the_order_of_the_model() -> None:
    second = ("deep", HalfSpace(), [0.0, 0.0, -6.0])
    world = pose_world("xz", [GROUND, BLOCK, second], [0.0, 0.0])
    faces = [f"ball against block, {face} face" for face in ("+x", "-x", "+z", "-z")]
    assert names_of(world) == ["ball against ground", *faces, "ball against deep"]
    assert [contact.solid for contact in world.contacts] == [0, 1, 1, 1, 1, 2]
    q = np.array([0.0, 0.3])
    np.testing.assert_allclose(world.calc_clearance(q), [5.175, 0.625, 6.175], rtol=RELATIVE)
    # Before the left side, and above neither the top nor the bottom.
    expected = [True, True, True, False, False, True]
    np.testing.assert_array_equal(world.is_on_face(q), expected)
    np.testing.assert_array_equal(world.is_on_face(np.array([1.0, 2.0])), [1, 0, 0, 1, 1, 1])


def test_two_balls_on_a_line_meet_on_the_sides_that_face_each_other() -> None:
    world = pose_world("x", [], [1.0, 0.2], balls=2)
    q = world.positions
    assert names_of(world) == ["ball against ball 1"]
    assert differs_by_zero(world.contacts[0].signed_distance, q[0] - q[1] - 2 * RADIUS)
    assert world.is_on_face(np.array([2.0, -1.0])).all()


@pytest.mark.parametrize("apart", [0.0, 1e-12])
def test_two_balls_with_one_centre_are_refused_for_no_side_is_known(apart: float) -> None:
    with pytest.raises(ModelError, match=r"ball against ball 1: got spheres whose centers coinci"):
        pose_world("x", [], [0.3, 0.3 + apart], balls=2)


def test_two_balls_that_leave_their_line_are_round() -> None:
    world = pose_world("xy", [], [0.0, 0.0, 1.0, 0.0], balls=2)
    R = 2 * RADIUS
    q = np.array([0.1, 0.2, 0.1 + 0.6 * R, 0.2 + 0.8 * R])
    np.testing.assert_allclose(world.calc_signed_distance(q), [0.0], atol=RELATIVE)
    normal = [-0.6, -0.8, 0.6, 0.8]
    np.testing.assert_allclose(world.calc_contact_jacobian(q), [normal], atol=RELATIVE)
    assert not world.has_constant_inertia


def test_shapes_masses_and_contacts_that_do_not_fit_are_refused_by_name() -> None:
    post = ("post", Cylinder(0.1, 1.0), [1.0, 0.0, 0.0])
    with pytest.raises(ModelError, match=r"contact of .*got Sphere against Cylinder, expected"):
        pose_world("x", [post], 0.0)
    diagram = make_diagram("x", [BLOCK], [0.0, 0.4], balls=2)
    with pytest.raises(ModelError, match="mass: got links 'ball', 'ball 1', which all carry"):
        World.from_diagram(diagram, mass=3.0)
    scenario = Scenario.named("corridor/lossy")
    message = "is for one contact: got ball against left_wall, ball against right_wall, expected"
    with pytest.raises(ModelError, match=f"the literal transcription {message}"):
        LiteralTranscription(World.from_scenario(scenario), scenario)


def test_the_shapes_of_a_body_that_has_several_are_told_apart() -> None:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    add_ball(plant, "ball", "z")
    plant.RegisterCollisionGeometry(
        plant.GetBodyByName("ball"), RigidTransform([0.0, 1.0, 0.0]), Sphere(0.2), "ear", material()
    )
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(), HalfSpace(), "ground", material()
    )
    plant.Finalize()
    world = World.from_diagram(builder.Build(), mass=3.0)  # Two spheres, one body.
    assert names_of(world) == ["ball shape against ground", "ear against ground"]
    np.testing.assert_allclose(world.calc_signed_distance(np.ones(1)), [0.875, 0.8])
    assert world.constant_inertia.mass_matrix.tolist() == [[3.0]]
    inspector = world.scene_graph.model_inspector()
    shapes = [[inspector.GetName(shape) for shape in pair] for pair in world.shapes]
    assert [pair[0].split("::")[-1] for pair in shapes] == ["ball shape", "ear"]


@pytest.mark.parametrize(
    ("field", "place", "message"),
    [
        ("initial_position", [0.9, 0.1], r"initial_position is inside.*\(ball against block\): .*"),
        ("goal_position", [0.626, 0.1], r"goal_position is inside.* distance of -0.001 m, .* be o"),
        ("goal_position", [0.0, -5.0], r"goal_position is inside.* \(ball against ground\)"),
    ],
)
def test_a_start_or_goal_inside_a_solid_is_refused(
    field: str, place: list[float], message: str
) -> None:
    world = pose_world("xz", [BLOCK, GROUND], [0.0, 0.0])
    ends: dict[str, Any] = {"initial_position": [0.0, 0.0], "goal_position": [2.0, 0.9]}
    # Past a corner, so beside every face; and against one.
    for fine in (ends, {**ends, "goal_position": [0.625, 0.1]}):
        world.check(Scenario(**fine, initial_velocity=[0.0, 0.0]))
    with pytest.raises(ScenarioError, match=message):
        world.check(Scenario(**{**ends, field: place}, initial_velocity=[0.0, 0.0]))


def test_restitution_is_the_models_own_where_it_has_one() -> None:
    scenario = Scenario(
        initial_position=0.0, initial_velocity=0.0, goal_position=0.0, restitution=0.9
    )
    walls = [BLOCK, ("other", Box(1.0, 1.0, 1.0), [-3.0, 0.0, 0.0])]
    assert pose_world("x", walls, 0.0).restitutions(scenario).tolist() == [0.9, 0.9]
    assert pose_world("x", walls, 0.0, restitution=0.5).restitutions(scenario).tolist() == [0.5] * 2


@pytest.mark.parametrize("value", [1.5, -0.1, float("nan"), "bouncy"])
def test_a_restitution_out_of_range_is_refused_by_the_shapes_name(value: object) -> None:
    with pytest.raises(ModelError, match=r"restitution of collision shape '.*block': got .*0 to 1"):
        pose_world("x", [BLOCK], 0.0, restitution=value)


def test_one_bodys_mass_is_replaced_in_all_of_its_contacts() -> None:
    world = World.from_diagram(make_diagram("xz", [BLOCK, GROUND], [0.0, 0.0]), mass=3.0)
    np.testing.assert_array_equal(world.constant_inertia.mass_matrix, 3.0 * np.eye(2))
    assert differs_by_zero(world.bias[1], 3.0 * 9.81)
    kick = world.calc_velocity_change(np.zeros(2), np.array([0.0, 6.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(kick, [-2.0, 0.0], atol=RELATIVE)


def test_a_spring_damper_on_a_joint_without_a_motor_is_read() -> None:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    add_ball(plant, "ball", ["x", "askew"], actuated=False)
    plant.AddForceElement(PrismaticSpring(plant.GetJointByName("ball askew"), 0.2, 30.0))
    plant.GetJointByName("ball askew").set_default_damping(0.7)
    plant.RegisterCollisionGeometry(
        plant.world_body(), RigidTransform(BLOCK[2]), BLOCK[1], "block", material()
    )
    plant.Finalize()
    world = World.from_diagram(builder.Build())
    assert (world.num_positions, world.num_actuators) == (2, 1)
    M = world.constant_inertia.mass_matrix
    np.testing.assert_allclose(M, 2.0 * np.array([[1.0, 0.6], [0.6, 1.0]]))
    assert differs_by_zero(world.bias[0], 0.0)
    spring = 30.0 * (world.positions[1] - 0.2) + 0.7 * world.velocities[1]
    assert differs_by_zero(world.bias[1], spring)


def test_a_spring_damper_between_points_is_refused_with_the_joint_that_does_it() -> None:
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    add_ball(plant, "ball", "x")
    ball, post = plant.GetBodyByName("ball"), plant.world_body()
    plant.AddForceElement(
        LinearSpringDamper(ball, np.zeros(3), post, np.ones(3), 0.3, stiffness=5.0, damping=0.4)
    )
    plant.RegisterCollisionGeometry(post, RigidTransform(BLOCK[2]), BLOCK[1], "block", material())
    plant.Finalize()
    with pytest.raises(ModelError, match=r"joint 'ball x' .*put spring and damping on a joint"):
        World.from_diagram(builder.Build())


# A half space is in front of the ball where the box was: the same equations.
OTHERS = sorted(VARIANTS.keys() - {"as shipped", "half space"})


@pytest.mark.parametrize("name", OTHERS)
def test_a_changed_model_has_another_fingerprint(write_model: ModelWriter, name: str) -> None:
    shipped, changed = (make_world(write_model, each).fingerprint for each in ("as shipped", name))
    again = make_world(write_model, name)
    changed.check(again.fingerprint, "")
    with pytest.raises(ModelError, match=r"the world has changed: got .*, expected .*Look\."):
        shipped.check(again.fingerprint, "Look.")


def test_a_fingerprint_survives_json_and_rounding(write_model: ModelWriter) -> None:
    world = make_world(write_model, "slope")
    read = from_plain(Fingerprint, json.loads(json.dumps(to_plain(world.fingerprint))))
    assert read == world.fingerprint
    rounded = dataclasses.replace(
        read, accelerations=tuple(tuple(row) for row in np.array(read.accelerations) * (1 + 1e-13))
    )
    rounded.check(world.fingerprint, "")


def test_mass_walls_and_restitutions_count() -> None:
    scenario = Scenario.named("room/bank_shot")
    world = World.from_scenario(scenario)
    heavier = World.from_scenario(dataclasses.replace(scenario, mass=1.001))
    for other, what in ((heavier, "accelerations"), (world.with_wall_moved(3, 1e-7), "distances")):
        with pytest.raises(ModelError, match=f"got {what}"):
            world.fingerprint.check(other.fingerprint, "")
    softer = dataclasses.replace(world.fingerprint, restitutions=(None, None, None, 0.5))
    with pytest.raises(ModelError, match="got restitutions"):
        softer.check(world.fingerprint, "")


def test_stiffness_dissipation_and_limits_count_unless_a_file_tells_none() -> None:
    soft, other, free = (
        build(f"cart_pole{kind}").fingerprint for kind in ("_soft_06", "_rigid_06", "")
    )
    rigid = dataclasses.replace(other, coordinates=soft.coordinates, actuators=soft.actuators)
    with pytest.raises(ModelError, match=r"got materials \(\(2000000000\.0, 2000000000\.0, 0\.0,"):
        soft.check(rigid, "")
    unlimited = dataclasses.replace(free, limits=((-np.inf,) * 5, (np.inf,) * 5))
    with pytest.raises(ModelError, match="got limits"):
        free.check(unlimited, "")
    plain = to_plain(soft)
    del plain["materials"], plain["limits"]
    from_plain(Fingerprint, plain).check(rigid, "")


def test_a_world_knows_the_model_that_it_was_built_from(write_model: ModelWriter) -> None:
    world = make_world(write_model, "as shipped")
    assert world.model == str(write_model.path) == world.fingerprint.model
    own = World.from_diagram(world.diagram)
    assert own.model is None
    world.fingerprint.check(own.fingerprint, "")
