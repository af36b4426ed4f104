"""The shipped worlds: what each is, and that φ is Drake's own signed distance."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pydrake.geometry import SceneGraph
from world_models import RELATIVE, differs_by_zero

from drake_aigto import Scenario, World, scenario_names

NUM_POINTS = 40
RADIUS = {"corridor": 0.05, "floor": 0.05, "room": 0.02, "room_with_block": 0.02}
HALF_SPACES = (
    "Rigid (non-deformable) half spaces are not currently supported for deformable contact; "
    "registration is allowed, but no contact data will be reported."
)
NAMES = [*RADIUS, "two_masses"]


def load(name: str) -> World:
    """Returns a shipped world, by one of its scenarios."""
    first = next(each for each in scenario_names() if each.startswith(f"{name}/"))
    return World.from_scenario(Scenario.named(first))


def measure(world: World, q: np.ndarray, root: Any) -> dict[Any, float]:
    """Returns Drake's signed distance of each pair of shapes that may collide."""
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
    if world.plant.HasModelInstanceNamed("floor"):
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
    nq = world.num_positions
    np.testing.assert_array_equal(world.constant_inertia.mass_matrix, np.eye(nq))
    np.testing.assert_array_equal(world.actuation, np.eye(nq))
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


@pytest.mark.parametrize("name", [*NAMES, "table1"])
def test_a_shipped_material_is_stiff_elastic_and_frictionless(name: str) -> None:
    world = load(name)
    inspector = world.scene_graph.model_inspector()
    for shape in {shape for pair in world.shapes for shape in pair}:
        material = inspector.GetProximityProperties(shape)
        assert material.GetProperty("material", "point_contact_stiffness") == 2e9
        assert material.GetProperty("material", "hunt_crossley_dissipation") == 0.0
        friction = material.GetProperty("material", "coulomb_friction")
        assert friction.static_friction() == friction.dynamic_friction() == 0.0


@pytest.mark.parametrize("name", NAMES)
def test_shipped_joints_have_motors_and_no_stops(name: str) -> None:
    plant = load(name).plant
    assert plant.num_actuators() == plant.num_positions()
    assert np.all(np.isinf(plant.GetPositionLowerLimits()))
    assert np.all(np.isinf(plant.GetPositionUpperLimits()))


@pytest.mark.parametrize("name", scenario_names())
def test_a_shipped_scenario_fits_its_world(name: str) -> None:
    scenario = Scenario.named(name)
    World.from_scenario(scenario).check(scenario)


def test_what_drake_says_of_deformable_bodies_is_not_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    logger = logging.getLogger("drake")

    class Noisy:
        def CreateDefaultContext(self) -> None:
            logger.warning(HALF_SPACES)
            logger.warning("other")

    diagram: Any = Noisy()
    dataclasses.replace(load("floor"), diagram=diagram).create_context()
    diagram.CreateDefaultContext()
    assert caplog.messages == ["other", HALF_SPACES, "other"]
