"""Several contacts: which faces count, what a solid is, whose mass and restitution it is."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from mechanisms import build
from pydrake.geometry import Box, Cylinder, HalfSpace, ProximityProperties, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    LinearSpringDamper,
    PrismaticJoint,
    PrismaticSpring,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import Diagram, DiagramBuilder
from world_models import RELATIVE, VARIANTS, ModelWriter, differs_by_zero, make_world

from drake_aigto import Scenario, World
from drake_aigto.errors import ModelError, ScenarioError
from drake_aigto.paper import LiteralTranscription
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.world import Fingerprint

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
