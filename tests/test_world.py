"""The world: what is read off a plant agrees with Drake's own numbers."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from pydrake.symbolic import Expression, Variable, cos, sin
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

from drake_aigto import ModelError, Scenario, World
from drake_aigto.dynamics import SumMap, tidy
from drake_aigto.world import models_directory

# What the shipped world is.


def test_the_shipped_world_is_a_unit_mass_whose_signed_distance_is_its_position() -> None:
    world = World.from_scenario(Scenario.named("table1/1"))
    (q,) = world.positions
    assert world.mass_matrix.shape == (1, 1)
    assert world.mass_matrix[0, 0].EqualTo(Expression(1.0))
    assert world.bias[0].EqualTo(Expression(0.0))
    np.testing.assert_array_equal(world.actuation, [[1.0]])
    (contact,) = world.contacts
    assert contact.name == "ball against wall"
    assert contact.signed_distance.EqualTo(Expression(q))
    assert contact.jacobian[0].EqualTo(Expression(1.0))
    sizes = (world.num_positions, world.num_velocities, world.num_actuators, world.num_contacts)
    assert sizes == (1, 1, 1, 1)


def test_the_worlds_parts_are_read_only() -> None:
    world = World.from_scenario(Scenario.named("table1/1"))
    with pytest.raises(dataclasses.FrozenInstanceError):
        world.mass = 2.0  # type: ignore[misc]
    names = ("positions", "velocities", "controls", "mass_matrix", "bias", "actuation")
    arrays = [getattr(world, name) for name in names]
    for array in [*arrays, world.contacts[0].jacobian]:
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[0]


# Physics: a changed model changes what is read.


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


def test_from_behind_a_thin_wall_its_other_face_counts(write_model: ModelWriter) -> None:
    model = write_model({})
    world = World.from_scenario(make_scenario(model, initial_position=-1.0, goal_position=-0.5))
    # The box is 0.1 m thick and the ball 0.1 m across: contact at q = -0.2.
    np.testing.assert_allclose(world.calc_signed_distance(np.array([-1.0])), [0.8])


def test_a_floor_along_the_motion_is_no_contact(write_model: ModelWriter) -> None:
    floor = """<link name="floor"><pose>0 0 -0.2 0 0 0</pose><collision name="floor_collision">
      <geometry><box><size>9 9 0.1</size></box></geometry></collision></link>
    <joint name="floor_to_world" type="fixed"><parent>world</parent><child>floor</child></joint>
    <link name="wall">"""
    world = World.from_scenario(make_scenario(write_model({'<link name="wall">': floor})))
    assert [contact.name for contact in world.contacts] == ["ball against wall"]


# The parts.


def test_tidying_drops_rounding_and_keeps_physics() -> None:
    x, y = Variable("x"), Variable("y")
    first, second = tidy(np.array([2.0 * (x + 1e-9 * y) + 6e-17 * x * y, Expression(0.0)]))
    assert differs_by_zero(first, 2.0 * x + 2e-9 * y)
    assert second.EqualTo(Expression(0.0))


def test_tidying_finds_what_cancels_among_waves() -> None:
    x = Variable("x")
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
def test_the_models_are_found_in_a_wheel_and_in_a_checkout(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / place).mkdir(parents=True)
    (tmp_path / place / "package.xml").write_text(
        (SHIPPED.parent / "package.xml").read_text(encoding="utf-8"), encoding="utf-8"
    )
    monkeypatch.setattr("drake_aigto.world.files.resources.files", lambda name: tmp_path / name)
    assert models_directory() == tmp_path / place


def test_an_installation_without_models_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drake_aigto.world.files.resources.files", lambda name: tmp_path / name)
    with pytest.raises(ModelError, match=r"shipped models are missing.*Install drake_aigto again"):
        models_directory()
