"""Contact in space: forces of pairs as Drake's plant has them, and exact derivatives."""

from __future__ import annotations

import dataclasses
import itertools
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    Capsule,
    Convex,
    Cylinder,
    HalfSpace,
    ProximityProperties,
    Shape,
    Sphere,
)
from pydrake.math import RigidTransform, RollPitchYaw
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph, CoulombFriction, MultibodyPlant
from pydrake.multibody.tree import (
    BodyIndex,
    JacobianWrtVariable,
    ModelInstanceIndex,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.framework import Context, DiagramBuilder
from scipy.optimize import nnls
from scipy.spatial import ConvexHull
from space_models import BOX, GROUND, SPHERE, ball_and_finger, build, collision, make_scenario

from drake_aigto import Scenario, World, geometry
from drake_aigto.arrays import Floats
from drake_aigto.contact import SLOWING, TouchRoom, TouchTable, make_touch_room, push
from drake_aigto.errors import ModelError, ScenarioError, TrajectoryError
from drake_aigto.geometry import BALL, CAPSULE, CYLINDER, HALF_SPACE, HULL, Shapes
from drake_aigto.kernels import borrow, kernel
from drake_aigto.show import question_facts
from drake_aigto.simulation import (
    EDGES,
    calc_edge_overlap,
    calc_lacks,
    find_touch_error,
    replay_drake,
    replay_event_driven,
)
from drake_aigto.world import SpaceWorld

CORNERS = 0.12 * np.random.default_rng(3).normal(size=(14, 3))
CORNERS /= np.maximum(1.0, np.linalg.norm(CORNERS, axis=1, keepdims=True) / 0.2)
SHAPES: dict[str, tuple[int, Shape, list[float], float]] = {
    "ball": (BALL, Sphere(0.1), [0.1, 0, 0], 0.1),
    "capsule": (CAPSULE, Capsule(0.06, 0.3), [0.06, 0.15, 0], 0.21),
    "box": (geometry.BOX, Box(0.2, 0.3, 0.25), [0.1, 0.15, 0.125], 0.25),
    "cylinder": (CYLINDER, Cylinder(0.1, 0.3), [0.1, 0.15, 0], 0.19),
    "hull": (HULL, Convex(CORNERS.T, "hull"), [0, 0, 0], 0.2),
    "ground": (HALF_SPACE, HalfSpace(), [0, 0, 0], 0.0),
}
STICTION = 0.2  # [m/s]: many states stick.
# Stiffness [N/m], dissipation [s/m] and friction of both shapes.
MATERIALS = (2000.0, 0.3, 0.6), (5000.0, 0.1, 0.8)
_X_BG = RigidTransform(RollPitchYaw(0.3, 0.2, -0.4), [0.02, -0.03, 0.01])


class Bodies(NamedTuple):
    plant: MultibodyPlant
    diagram: Any
    root: Context
    context: Context
    table: TouchTable
    room: TouchRoom

    @classmethod
    def of(cls, *kinds: str) -> Bodies:
        builder = DiagramBuilder()
        plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
        of_shapes = []
        for name, kind, material in zip("ab", kinds, MATERIALS, strict=True):
            body = plant.world_body()
            if kind != "ground":
                inertia = SpatialInertia(1.3, np.zeros(3), UnitInertia(0.02, 0.03, 0.025))
                body = plant.AddRigidBody(name, inertia)
            properties, (k, d, mu) = ProximityProperties(), material
            AddContactMaterial(d, k, CoulombFriction(mu, mu), properties)
            shape = SHAPES[kind][1]
            plant.RegisterCollisionGeometry(body, _X_BG, shape, name, properties)
            of_shapes.append((int(body.index()) - 1, *SHAPES[kind]))
        plant.Finalize()
        plant.set_stiction_tolerance(STICTION)
        diagram = builder.Build()
        root = diagram.CreateDefaultContext()
        table = _make_table(of_shapes, plant.num_velocities())
        context = plant.GetMyMutableContextFromRoot(root)
        return cls(plant, diagram, root, context, table, make_touch_room(table))

    def place(self, q: Floats) -> tuple[Floats, Floats]:
        """Returns poses (B, 12) and motions (n, 6) of bodies at positions."""
        plant, poses = self.plant, []
        plant.SetPositions(self.context, q)
        motions = np.zeros((plant.num_velocities(), 6))
        for body in self.bodies:
            X = plant.EvalBodyPoseInWorld(self.context, body)
            poses.append([*X.rotation().matrix().ravel(), *X.translation()])
            world, first = plant.world_frame(), body.floating_velocities_start_in_v()
            origin = X.inverse().translation()
            J = plant.CalcJacobianSpatialVelocity(
                self.context, JacobianWrtVariable.kV, body.body_frame(), origin, world, world
            )
            motions[first : first + 6] = J[:, first : first + 6].T
        return np.array(poses), motions

    @property
    def bodies(self) -> list[Any]:
        return [self.plant.get_body(BodyIndex(i)) for i in range(1, self.plant.num_bodies())]

    def push(self, q: Floats, v: Floats, eps: float = 0.0) -> tuple[Floats, Floats]:
        n = len(v)
        force, slopes = np.zeros(n), np.zeros((n, 2 * n))
        _push(self.table, *self.place(q), v, eps, self.room, force, slopes)
        return force, slopes

    def draw(self, rng: np.random.Generator) -> tuple[Floats, Floats]:
        q = self.plant.GetPositions(self.context).copy()
        for body in self.bodies:
            first = body.floating_positions_start()
            turn = rng.normal(size=4)
            q[first : first + 4] = turn / np.linalg.norm(turn)
            q[first + 4 : first + 7] = rng.uniform(-0.22, 0.22, 3)
        return q, 0.3 * rng.normal(size=self.plant.num_velocities())

    def moved(self, q: Floats, delta: Floats) -> Floats:
        self.plant.SetPositions(self.context, q)
        return q + self.plant.MapVelocityToQDot(self.context, delta)


def find_faces() -> Floats:
    """Returns triangles of the hull, three corners and the normal outward, shape (T, 4, 3)."""
    hull = ConvexHull(CORNERS)
    faces = np.concatenate([CORNERS[hull.simplices], hull.equations[:, np.newaxis, :3]], axis=1)
    a, b, c, n = np.moveaxis(faces, 1, 0)
    turns = np.sum(np.cross(b - a, c - a) * n, axis=1) < 0
    faces[turns, 1:3] = faces[turns, 2:0:-1]
    return faces


def _make_table(of_shapes: list[Any], num_velocities: int) -> TouchTable:
    (k1, d1, mu1), (k2, d2, mu2) = MATERIALS
    law = [k1 * k2 / (k1 + k2), (k2 * d1 + k1 * d2) / (k1 + k2), 2 * mu1 * mu2 / (mu1 + mu2)]
    bodies, kinds, _, sizes, bounds = zip(*of_shapes, strict=True)
    moving = [body for body in bodies if body >= 0]
    carries = np.zeros((num_velocities, num_velocities), dtype=bool)
    for body in moving:  # Drake has turns first: translations carry them.
        carries[6 * body + 3 : 6 * body + 6, 6 * body : 6 * body + 3] = True
    return TouchTable(
        Shapes(
            np.array(bodies),
            np.array(kinds),
            np.tile(_X_BG.rotation().matrix(), (2, 1, 1)),
            np.tile(_X_BG.translation(), (2, 1)),
            np.array(sizes, dtype=float),
            np.array(bounds),
            np.cumsum([0, *(len(find_faces()) * (kind == HULL) for kind in kinds)]),
            find_faces(),
        ),
        pairs=np.array([[0, 1]]),
        law=np.array([[*law, STICTION, 1.0, 0.006, 0.0]]),
        couples=np.array([0]),
        starts=np.array([0, 6 * len(moving)]),
        chain=np.concatenate([6 * body + np.arange(6) for body in moving]),
        signs=np.repeat([1.0, -1.0][: len(moving)], 6),
        carries=carries,
    )


@kernel
def _push(
    table: TouchTable, poses: Floats, S: Floats, v: Floats,
    eps: float, room: TouchRoom, force: Floats, slopes: Floats,
) -> None:  # fmt: skip
    table, poses, S, v, room = borrow(table), borrow(poses), borrow(S), borrow(v), borrow(room)
    push(table, poses, S, v, eps, 1.0, True, room, borrow(force), borrow(slopes))


# Drake finds how deep these are in each other in closed form; of two capsules, and of a ball and a
# hull, by an iteration that misses it by up to their own size.
PAIRS = [
    *(("ball", each) for each in ("ball", "capsule", "box", "cylinder", "ground")),
    *((each, "ground") for each in ("capsule", "box", "cylinder", "hull")),
]
DEEPEST = 0.05  # [m]
_RODS = (0.03, 0.031), (0.04, 0.18)  # Radius and length [m].


def touching(bodies: Bodies, count: int) -> list[tuple[Floats, Floats]]:
    rng, found = np.random.default_rng(0), list[tuple[Floats, Floats]]()
    while len(found) < count:
        q, v = bodies.draw(rng)
        force, _ = bodies.push(q, v)
        if force.any() and bodies.room.found[0, 0] > -DEEPEST:
            found.append((q, v))
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kinds", PAIRS, ids="-".join)
def test_contact_forces_are_those_of_drakes_continuous_plant(kinds: tuple[str, str]) -> None:
    bodies = Bodies.of(*kinds)
    instance = bodies.bodies[0].model_instance()
    assert instance == ModelInstanceIndex(1)
    port = bodies.plant.get_generalized_contact_forces_output_port(instance)
    for q, v in touching(bodies, 20):
        force, _ = bodies.push(q, v)
        bodies.plant.SetVelocities(bodies.context, v)
        expected = port.Eval(bodies.context)
        # Rounding of forces and levers below 100 N and 1 m.
        np.testing.assert_allclose(force, expected, rtol=0, atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize(("eps", "slowing"), [(0.0, 0.0), (0.02, 0.0), (0.02, 5e-3)])
@pytest.mark.parametrize(
    "kinds", [*PAIRS, ("capsule", "capsule"), ("capsule", "box"), ("ball", "hull")], ids="-".join
)
def test_derivatives_of_forces_are_exact(
    kinds: tuple[str, str], eps: float, slowing: float
) -> None:
    bodies, h = Bodies.of(*kinds), 1e-6
    bodies.table.law[:, SLOWING] = slowing
    for q, v in touching(bodies, 10):
        _, slopes = bodies.push(q, v, eps)
        n = len(v)
        for j in range(n):
            step = h * np.eye(n)[j]
            by_q = [bodies.push(bodies.moved(q, s * step), v, eps)[0] for s in (1, -1)]
            by_v = [bodies.push(q, v + s * step, eps)[0] for s in (1, -1)]
            differences = np.column_stack([(a - b) / (2 * h) for a, b in (by_q, by_v)])
            # Central differences of forces that bend over a centimeter, and rounding of 100 N / h.
            size = max(1.0, float(np.max(np.abs(differences))))
            assert np.max(np.abs(slopes[:, [j, n + j]] - differences)) <= 1e-5 * size


@pytest.mark.slow
def test_two_capsules_are_as_far_apart_as_the_nearest_balls_on_their_axes() -> None:
    bodies, rng = Bodies.of("capsule", "capsule"), np.random.default_rng(1)
    along = np.linspace(-0.15, 0.15, 301)
    for _ in range(20):
        q, v = bodies.draw(rng)
        bodies.push(q, v, eps=0.1)  # So wide that all are near.
        axes, centers = bodies.room.rotations[:, :, 2], bodies.room.places
        one, other = (c + along[:, np.newaxis] * a for c, a in zip(centers, axes, strict=True))
        gaps = np.linalg.norm(one[:, np.newaxis] - other, axis=2)
        nearest, half_step = float(gaps.min()), 0.5 * (along[1] - along[0])
        distance = bodies.room.closest.distance[0] + 0.12
        assert distance <= nearest + 1e-12
        assert nearest <= np.hypot(distance, 2 * half_step) + 1e-12


@pytest.mark.slow
def test_a_capsule_is_as_far_from_a_box_as_their_difference_is_from_zero() -> None:
    """That is the convex hull of corners less ends of the axis, by which both part the soonest."""
    bodies, rng, pierced = Bodies.of("capsule", "box"), np.random.default_rng(1), 0
    ends = np.array([[0, 0, -0.15], [0, 0, 0.15]])
    corners = np.array(list(itertools.product((-0.1, 0.1), (-0.15, 0.15), (-0.125, 0.125))))
    for _ in range(150):
        q, v = bodies.draw(rng)
        bodies.push(q, v, eps=0.1)  # So wide that all are near.
        (axis, box), (p, center) = bodies.room.rotations, bodies.room.places
        points = (p + ends @ axis.T)[:, np.newaxis] - (center + corners @ box.T)
        points = points.reshape(-1, 3)
        distance = bodies.room.closest.distance[0] + 0.06
        depth = np.max(ConvexHull(points).equations[:, 3])
        if depth <= 0.0:
            pierced += 1
            assert distance == pytest.approx(depth, abs=1e-10)
        else:
            assert distance == pytest.approx(find_nearest(points), abs=1e-6)
    assert 20 < pierced < 80


def find_nearest(points: Floats) -> float:
    # Σ w = 1 counts as a row with a large weight.
    rows = np.vstack([points.T, np.full(len(points), 1e4)])
    weights, _ = nnls(rows, [0.0, 0.0, 0.0, 1e4])
    return float(np.linalg.norm(points.T @ weights))


@pytest.mark.slow
def test_a_ball_is_as_far_from_a_hull_as_the_nearest_mixture_of_its_corners() -> None:
    bodies, rng, insides = Bodies.of("ball", "hull"), np.random.default_rng(1), 0
    for _ in range(60):
        q, v = bodies.draw(rng)
        bodies.push(q, v, eps=0.1)  # So wide that all are near.
        (c, p), R = bodies.room.places, bodies.room.rotations[1]
        distance, x = bodies.room.closest.distance[0] + 0.1, R.T @ (c - p)
        a, n = find_faces()[:, 0], find_faces()[:, 3]
        if (depth := np.max(np.sum(n * (x - a), axis=1))) <= 0:
            insides += 1
            assert distance == pytest.approx(depth, abs=1e-12)
            continue
        assert distance == pytest.approx(find_nearest(CORNERS - x), abs=1e-6)
    assert 0 < insides < 30


def write_mesh(path: Path, corners: Floats) -> str:
    rows = [f"v {x} {y} {z}" for x, y, z in corners]
    rows += [f"f {a} {b} {c}" for a, b, c in 1 + ConvexHull(corners).simplices]
    path.write_text("\n".join(rows), encoding="utf-8")
    return f"<mesh><uri>{path}</uri></mesh>"


def test_a_mesh_touches_what_its_convex_hull_touches(tmp_path: Path) -> None:
    corners = np.array(list(itertools.product((-0.05, 0.05), repeat=3)))
    pierced = np.vstack([corners, [[0.01, 0.0, 0.02]]])  # The hull has no corner within it.
    shapes = BOX, write_mesh(tmp_path / "cube.obj", pierced)
    up = {"thing": {"xyz": [0, 0, 0.2]}, "x": -0.15, "z": 0.07}
    found = []
    for shape in shapes:
        text = ball_and_finger(shapes=collision("thing", shape))
        world = World.from_scenario(make_scenario(tmp_path, text, initial_position=up))
        rng, q = np.random.default_rng(0), world.plant.GetDefaultPositions()
        assert isinstance(world, SpaceWorld)
        states = np.array([world.tree.add(q, rng.normal(size=9) * 0.2) for _ in range(50)])
        found.append((world.calc_signed_distance(states), world.calc_contact_jacobian(states)))
    for of_box, of_mesh in zip(*found, strict=True):
        np.testing.assert_allclose(of_mesh[:, :2], of_box[:, :2], atol=1e-12)
    of_box, of_mesh = (np.sort(distances[:, 2:], axis=1) for distances, _ in found)
    np.testing.assert_allclose(of_mesh, of_box, atol=1e-6)  # Corners, in any order.


TABLE = "<box><size>1 1 0.1</size></box>"


CAN = "<cylinder><radius>0.05</radius><length>0.1</length></cylinder>"


@pytest.mark.parametrize(("kind", "on_table"), [("box", True), ("mesh", False), ("can", False)])
def test_what_stands_on_a_face_stays_there(tmp_path: Path, kind: str, on_table: bool) -> None:
    """Drake's own touch, the lowest corner, is another one all the time: no motion can be found."""
    corners = np.array(list(itertools.product((-0.05, 0.05), repeat=3)))
    shapes = {"box": BOX, "mesh": write_mesh(tmp_path / "cube.obj", corners), "can": CAN}
    text = ball_and_finger(shapes=collision("cube", shapes[kind]))
    under = 16 if kind == "can" else 4
    if on_table:
        table = collision("floor", TABLE, "0 0 -0.05 0 0 0")
        text = text.replace(collision("floor", GROUND), table)
    sunk = 0.3 * 9.81 / under / 1000  # Corners, each of two shapes' 2000 N/m.
    pose = {"xyz": [0, 0, 0.05 - sunk], "rpy": [0.0, 0.0, 0.4]}
    scenario = make_scenario(tmp_path, text, initial_position={"thing": pose, "x": -0.3, "z": 0.3})
    world = World.from_scenario(scenario)
    scenario = world.place(scenario)
    times = np.linspace(0.0, 1.0, 51)
    controls = np.tile([0.0, 0.0, 0.1 * 9.81], (50, 1))  # The finger stays up.
    for replay in (
        replay_event_driven(world, scenario, times, controls),
        replay_drake(world, scenario, times, controls),
    ):
        moved = world.subtract(replay.positions[-1], scenario.initial_position)
        assert np.max(np.abs(moved)) < 1e-4
    assert isinstance(world, SpaceWorld)
    assert np.sum(world.calc_signed_distance(scenario.initial_position) < 0) == under
    listed = " ".join(dict(question_facts(scenario, world))["pairs"].split())
    assert "m::cube corners with ground::floor" in listed and listed.count("–") == 1 + on_table
    apart = Scenario(**(scenario.to_plain() | {"clearance": {"m::cube with ground::floor": 0.01}}))
    assert np.sum(world.least_distances(apart) == 0.01) == (16 if on_table else 2 * under)
    told = "of m::cube, 16 points at each rim touch half spaces"
    assert [told in note for note in world.notes] == [True] * (kind == "can")


def test_boxes_that_just_touch_are_zero_apart(tmp_path: Path) -> None:
    """Drake asserts there that nearest points coincide: pydrake left the process."""
    cube = collision("cube", "<box><size>0.06 0.06 0.06</size></box>")
    head, models = ball_and_finger(cube).split('<model name="m">')
    models, ground = models.split('<model name="ground">')
    ground, tail = ground.replace(GROUND, "<box><size>4 4 1</size></box>").split("</model>")
    text = f'{head}<model name="ground">{ground}</model><model name="m">{models}{tail}'
    text = text.replace('name="floor"><pose>0 0 0 ', 'name="floor"><pose>0 0 -0.5 ')
    for height in np.linspace(0.0, 1e-13, 5):
        pose = {"xyz": [0.0, 0.0, 0.03 + height]}
        asked = make_scenario(tmp_path, text, initial_position={"thing": pose, "z": 0.5})
        world, asked = build(asked)
        distances = world.calc_solid_distances(asked.initial_position[np.newaxis])
        np.testing.assert_allclose(distances, height, atol=1e-14)


def test_edges_that_cross_are_no_touch_and_said_to_be_so(tmp_path: Path) -> None:
    """Boxes meet with their corners, and here edges alone cross at right angles."""
    text = ball_and_finger(shapes=collision("cube", BOX)).replace(
        collision("floor", GROUND), collision("floor", TABLE, "0 0 0 0.7853981633974483 0 0")
    )
    top, half = (0.5 + 0.05) * np.sqrt(0.5), 0.05 * np.sqrt(2)
    depth = 0.004
    for above in (depth, -depth):
        pose = {"xyz": [0, 0.45 * np.sqrt(0.5), top + half - above], "rpy": [0.0, np.pi / 4, 0.0]}
        start = {"thing": pose, "x": -0.3, "z": 1.3}
        scenario = make_scenario(tmp_path, text, initial_position=start)
        world = World.from_scenario(scenario)
        scenario = world.place(scenario)
        q = scenario.initial_position
        assert np.all(world.calc_signed_distance(q)[1:] > 0)
        assert calc_edge_overlap(world, np.array([q])) == pytest.approx(max(above, 0.0), abs=1e-9)
        replay = replay_drake(world, scenario, [0.0, 1e-3], np.zeros((1, 3)))
        assert (EDGES in replay.broken) == (above > 0)
        apart = Scenario(**(scenario.to_plain() | {"clearance": {"m::cube with ground::*": 0.01}}))
        lacks = calc_lacks(world, apart, np.array([q]))
        assert np.max(lacks) == pytest.approx(0.01 + above, abs=1e-9)
        with pytest.raises(ScenarioError, match=r"too near \(ground::floor with m::cube\)"):
            world.check(apart)


def test_a_motion_that_ends_early_may_be_due_to_edges_that_touch_at_a_point(tmp_path: Path) -> None:
    text = ball_and_finger(shapes=collision("can", CAN))
    place = {"thing": {"xyz": [0, 0, 0.0493]}, "x": -0.3, "z": 0.3}
    scenario = make_scenario(tmp_path, text, initial_position=place)
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, 0.0)
    Parser(plant).AddModels(scenario.model)
    plant.Finalize()
    world = SpaceWorld.from_diagram(builder.Build())  # Its shapes are left as they are.
    assert world.notes[-1].startswith("of m::can with ground::floor, only the lowest point touches")
    with pytest.raises(TrajectoryError, match=r"Of m::can with ground::floor, only the lowest"):
        replay_event_driven(world, world.place(scenario), [0.0, 1.0], np.full((1, 3), 1e200))


def test_a_mesh_of_too_many_corners_is_refused_with_what_to_do(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(80, 3))
    points *= 0.05 / np.linalg.norm(points, axis=1, keepdims=True)
    text = ball_and_finger(shapes=collision("thing", write_mesh(tmp_path / "round.obj", points)))
    with pytest.raises(ModelError, match=r"m::thing: got .* 80 corners, expected 64 .*Simplify"):
        World.from_scenario(make_scenario(tmp_path, text))


def test_touches_of_capsules_in_drake_are_compared_with_the_exact_ones(tmp_path: Path) -> None:
    rods = [
        f"<capsule><radius>{r}</radius><length>{length}</length></capsule>" for r, length in _RODS
    ]
    text = ball_and_finger(collision("ball", rods[1]))
    exact = World.from_scenario(make_scenario(tmp_path))
    text = text.replace(collision("tip", SPHERE), collision("tip", rods[0]))
    up = {"thing": {"xyz": [0, 0, 0.5]}, "x": -0.5, "z": 0.5}
    off = World.from_scenario(scenario := make_scenario(tmp_path, text, initial_position=up))
    assert isinstance(off, SpaceWorld) and isinstance(exact, SpaceWorld)
    rng, q = np.random.default_rng(0), off.place(scenario).initial_position
    turns = np.zeros((300, 9))
    turns[:, 4] = rng.uniform(-3.0, 3.0, 300)  # In the plane, where bodies of a plane meet.
    near = np.array([off.tree.add(q, turn) for turn in turns])
    near[:, off.plant.GetJointByName("x").position_start()] = rng.uniform(-0.06, 0.06, 300)
    assert find_touch_error(off, near) > 1e-4
    assert find_touch_error(exact, near) == 0.0  # It has no capsules.
    scenario = dataclasses.replace(
        off.place(scenario), initial_position=max(near, key=lambda q: find_touch_error(off, [q]))
    )
    held = [0.0, 1e-3], np.zeros((1, off.num_actuators))
    assert replay_drake(off, scenario, *held).touch_error > 1e-4
    assert replay_event_driven(off, scenario, *held).touch_error == 0.0


@pytest.mark.slow
def test_smoothed_contact_pushes_from_afar_and_ends_at_the_law() -> None:
    bodies = Bodies.of("ball", "ground")
    for q, v in touching(bodies, 5):
        exact, _ = bodies.push(q, v)
        off = [np.linalg.norm(bodies.push(q, v, eps)[0] - exact) for eps in (1e-2, 1e-3, 1e-5)]
        assert all(a >= b for a, b in itertools.pairwise(off))
        assert off[-1] <= 1e-3 * np.linalg.norm(exact)
        away = q + np.concatenate([np.zeros(4), 0.1 * bodies.room.closest.n])
        assert not bodies.push(away, v)[0].any()
        assert np.any(bodies.push(away, 0 * v, eps=0.05)[0])
