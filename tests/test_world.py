"""The world: what is read off a plant agrees with Drake's own numbers."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from pydrake.geometry import SceneGraph
from pydrake.symbolic import Expression, Variable, cos, sin
from pydrake.systems.framework import Context
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
from drake_aigto.errors import ModelError
from drake_aigto.world import models_directory


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
RADIUS = {"corridor": 0.05, "floor": 0.05, "room": 0.02, "room_with_block": 0.02}
HALF_SPACES = (
    "Rigid (non-deformable) half spaces are not currently supported for deformable contact; "
    "registration is allowed, but no contact data will be reported."
)
NAMES = [*RADIUS, "two_masses", "table1"]


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
def test_a_shipped_world_is_what_its_brief_says(name: str) -> None:
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
def test_a_face_is_as_far_as_drake_says_where_the_centre_projects_onto_it(name: str) -> None:
    world = load(name)
    seen = np.zeros(world.num_contacts, dtype=bool)
    for q, distances in sample(world, seed=1):
        got = world.calc_signed_distance(q)
        # Drake measures to the nearest face: from behind a box's face that is another one.
        behind = [contact.name.endswith("face") for contact in world.contacts] & (
            got < -RADIUS.get(name, 0.0)
        )
        compared = world.is_on_face(q) & ~behind
        np.testing.assert_allclose(got[compared], np.array(distances)[compared], atol=RELATIVE)
        seen |= compared
    assert np.all(seen)


@pytest.mark.parametrize("name", NAMES)
def test_clearance_tells_outside_from_inside_as_drake_does(name: str) -> None:
    world = load(name)
    solids = [contact.solid for contact in world.contacts]
    for q, distances in sample(world, seed=2):
        drake = np.array([distances[solids.index(solid)] for solid in range(world.num_solids)])
        got = world.calc_clearance(q)
        assert np.all(got <= drake + RELATIVE)  # Corners are sharp: never farther than it is.
        corner = (np.abs(q - 0.5) > 0.08).all() and (np.abs(q - 0.5) < 0.1).all()
        if not corner:
            np.testing.assert_array_equal(got >= 0, drake >= 0)


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_material_is_stiff_elastic_and_frictionless(name: str) -> None:
    world = load(name)
    inspector = world.scene_graph.model_inspector()
    for shape in {shape for pair in world.shapes for shape in pair}:
        material = inspector.GetProximityProperties(shape)
        assert material.GetProperty("material", "point_contact_stiffness") == 2e9
        assert material.GetProperty("material", "hunt_crossley_dissipation") == 0.0
        friction = material.GetProperty("material", "coulomb_friction")
        assert friction.static_friction() == friction.dynamic_friction() == 0.0


FIRST = {name.partition("/")[0]: name for name in reversed(scenario_names())}.values()
OTHERS = [name for name in scenario_names() if name not in FIRST]


@pytest.mark.parametrize("name", [*FIRST, *slow(*OTHERS)])
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
