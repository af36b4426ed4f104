"""A wall that is moved: what is read, and what Drake simulates, is the same world elsewhere."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from replay_worlds import hold, make_diagram, make_scenario, shipped_world

from drake_aigto import ModelError, Scenario, World
from drake_aigto.simulation import replay_drake, replay_event_driven


@pytest.mark.parametrize("distance", [0.013, -0.2])
@pytest.mark.parametrize("e", [1.0, 0.7])
def test_moving_the_wall_is_moving_start_and_goal_the_other_way(distance: float, e: float) -> None:
    scenario = make_scenario(restitution=e)
    shifted = dataclasses.replace(
        scenario,
        initial_position=scenario.initial_position - distance,
        goal_position=scenario.goal_position - distance,
    )
    world = shipped_world()
    moved = world.with_wall_moved(0, distance)
    for replay in (replay_event_driven, replay_drake):
        there, here = replay(moved, scenario, *hold(0.4)), replay(world, shifted, *hold(0.4))
        # Drake's steps differ in their last bits, within its accuracy.
        close = 1e-12 if replay is replay_event_driven else 1e-7
        assert len(there.bounce_times) == 1
        assert there.bounce_times == pytest.approx(here.bounce_times, abs=close)
        assert there.cost == pytest.approx(here.cost, abs=close)
        assert there.positions[-1] - distance == pytest.approx(here.positions[-1], abs=close)


@pytest.mark.parametrize("name", ["room_with_block/around", "corridor/lossy"])
def test_a_moved_shape_is_where_drakes_geometry_sees_it(name: str) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    q, distance = scenario.initial_position, 0.03
    J = world.calc_contact_jacobian(q)
    for i, shapes in enumerate(world.shapes):
        moved = world.with_wall_moved(i, distance)
        beside = [j for j, pair in enumerate(moved.shapes) if pair == shapes]
        expected = world.calc_signed_distance(q)
        expected[beside] -= distance * J[beside] @ J[i]  # The normals are of unit length here.
        after = moved.calc_signed_distance(q)
        np.testing.assert_allclose(after, expected, rtol=0, atol=1e-12)
        root = moved.create_context()
        context = moved.plant.GetMyMutableContextFromRoot(root)
        moved.plant.SetPositions(context, q)
        query = moved.plant.get_geometry_query_input_port().Eval(context)
        seen = query.ComputeSignedDistancePairClosestPoints(*shapes).distance
        assert seen == pytest.approx(max(after[beside]), abs=1e-12)


@pytest.mark.parametrize("name", ["corridor/lossy", "two_masses/apart"])
def test_a_world_that_is_only_planned_for_has_the_numbers_of_one_that_is_moved(name: str) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    distances = np.zeros(world.num_contacts)
    distances[0] = 0.03
    moved, nearer = world.with_wall_moved(0, 0.03), world.with_walls_nearer(distances)
    for read in (moved, nearer):
        read.check(scenario)
    q, inertia = scenario.initial_position, world.constant_inertia
    np.testing.assert_allclose(
        nearer.calc_signed_distance(q), moved.calc_signed_distance(q), rtol=0, atol=1e-15
    )
    for field in dataclasses.fields(inertia):
        mine, true = (getattr(each.constant_inertia, field.name) for each in (nearer, moved))
        np.testing.assert_allclose(mine, true, rtol=0, atol=1e-15)
    assert world.constant_inertia.offset[0] == pytest.approx(
        nearer.constant_inertia.offset[0] + 0.03
    )


def test_the_world_itself_stays() -> None:
    world = shipped_world(2.0)
    before = world.calc_signed_distance(np.ones(1))
    moved = world.with_wall_moved(0, 0.1)
    assert moved.mass == world.sphere_mass == moved.sphere_mass == 2.0
    assert world.calc_signed_distance(np.ones(1)) == before
    back = moved.with_wall_moved(0, -0.1)
    assert back.calc_signed_distance(np.ones(1)) == pytest.approx(before, abs=1e-15)


def test_the_mass_of_the_model_is_read() -> None:
    assert shipped_world().sphere_mass == 1.0
    assert World.from_diagram(make_diagram(density=3.0)).sphere_mass == pytest.approx(4.5)


def test_a_wall_on_a_link_that_moves_is_refused() -> None:
    world = World.from_scenario(Scenario.named("two_masses/apart"))
    between = next(i for i, c in enumerate(world.contacts) if "wall" not in c.name)
    with pytest.raises(ModelError, match="which moves, expected one that stands still"):
        world.with_wall_moved(between, 0.1)


class _Uncopied(LeafSystem):
    """A system written in Python, as users write them: Drake can't copy it."""


def test_a_diagram_that_drake_cannot_copy_is_refused() -> None:
    builder = DiagramBuilder()
    builder.AddSystem(make_diagram())
    builder.AddSystem(_Uncopied())
    world = World.from_diagram(builder.Build())
    with pytest.raises(ModelError, match=r"(?s)can't be copied.*systems that Drake can clone"):
        world.with_wall_moved(0, 0.1)
