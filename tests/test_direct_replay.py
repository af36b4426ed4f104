"""The roll-out by roots alone: against integrated motion, against itself, and many at once."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from replay_worlds import hold, make_diagram, make_scenario, shipped, shipped_world

from drake_aigto import Scenario, World
from drake_aigto.contact import RigidLaw, Walls, support
from drake_aigto.errors import ModelError
from drake_aigto.simulation import (
    HeldControl,
    Parabolas,
    Recording,
    RigidMotion,
    replay_drake,
    replay_event_driven,
)

Array = npt.NDArray[np.float64]

WORLDS = ["point mass", "floor", "corridor", "room", "room_with_block", "two_masses"]
RESTITUTIONS = [1.0, 0.8, 0.5, 0.0]


def world_of(name: str) -> World:
    return shipped_world() if name == "point mass" else shipped(name)


def draw_task(name: str, seed: int) -> tuple[tuple[Array, Array], Array, Array]:
    rng, world = np.random.default_rng(seed), world_of(name)
    q = np.sort(rng.uniform(0.05, 0.95, world.num_positions))
    while np.any(world.calc_clearance(q) < 0.01):
        q = np.sort(rng.uniform(0.05, 0.95, world.num_positions))
    v = rng.uniform(-4, 4, world.num_velocities)
    gaps = rng.uniform(0.01, 0.2, rng.integers(1, 12))
    controls = rng.uniform(-20, 20, (len(gaps), world.num_actuators))
    return (q, v), np.concatenate([[0.0], np.cumsum(gaps)]), controls


def roll_out(
    name: str, e: float, start: tuple[Array, Array], times: Array, controls: Array
) -> Recording:
    world = world_of(name)
    restitutions = np.full(world.num_contacts, e)
    return Parabolas(world.constant_dynamics, restitutions, start, times).record(controls)


def follows_chatter(recording: Recording) -> bool:
    """Whether impacts are so many or so slow that rounding decides how many there are."""
    slow = any(impact.speed < 1e-3 for impact in recording.impacts)
    return slow or len(recording.impacts) > 12


@pytest.mark.parametrize("name", WORLDS)
@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1), st.sampled_from(RESTITUTIONS))
def test_integrated_motion_is_the_same(name: str, seed: int, e: float) -> None:
    start, times, controls = draw_task(name, seed)
    direct = roll_out(name, e, start, times, controls)
    assume(not follows_chatter(direct))
    world = world_of(name)
    held = HeldControl(times, controls)
    span = held.start, held.end
    law = RigidLaw(np.full(world.num_contacts, e))
    oracle = RigidMotion(world, law, start, span).run(held)
    assert [i.contact for i in direct.impacts] == [i.contact for i in oracle.impacts]
    np.testing.assert_allclose(direct.times, oracle.times, rtol=0, atol=1e-9)
    np.testing.assert_allclose(direct.positions, oracle.positions, rtol=0, atol=1e-9)
    np.testing.assert_allclose(direct.velocities[-1], oracle.velocities[-1], rtol=0, atol=1e-8)
    for ours, theirs in zip(direct.impacts, oracle.impacts, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-8, atol=1e-8)
    assert direct.max_penetration <= 1e-12


def test_the_road_is_chosen_by_what_the_world_does(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise AssertionError("simulated")

    monkeypatch.setattr(RigidMotion, "run", refuse)
    heavy = World.from_diagram(make_diagram(gravity=3.0))
    springy = World.from_diagram(make_diagram(spring=3.0))
    assert all(world_of(name).has_constant_dynamics for name in WORLDS)
    assert heavy.has_constant_dynamics and not springy.has_constant_dynamics
    assert replay_event_driven(heavy, make_scenario(), *hold(0.0)).bounce_times
    with pytest.raises(AssertionError, match="simulated"):
        replay_event_driven(springy, make_scenario(), *hold(0.0))


@pytest.mark.parametrize("name", WORLDS)
@given(st.integers(0, 2**32 - 1), st.sampled_from(RESTITUTIONS), st.integers(2, 9))
def test_an_interval_cut_in_parts_is_the_same(name: str, seed: int, e: float, parts: int) -> None:
    # Of the block too: a parabola that passes one side far off and comes back onto another.
    start, times, controls = draw_task(name, seed)
    whole = roll_out(name, e, start, times, controls)
    assume(not follows_chatter(whole))
    steps = np.repeat(np.diff(times) / parts, parts)
    fine = np.concatenate([[0.0], np.cumsum(steps)])
    cut = roll_out(name, e, start, fine, np.repeat(controls, parts, axis=0))
    assert [i.contact for i in whole.impacts] == [i.contact for i in cut.impacts]
    np.testing.assert_allclose(cut.positions[-1], whole.positions[-1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(cut.velocities[-1], whole.velocities[-1], rtol=0, atol=1e-8)


def test_a_parabola_over_a_block_comes_down_on_it() -> None:
    # In front of its left side until it is above; x passes that side once, y its top twice.
    world, e = shipped("room_with_block"), np.full(8, 1.0)
    start = np.array([0.3, 0.55]), np.array([0.5, 1.5])
    walls = Parabolas(world.constant_dynamics, e, start, np.array([0.0, 0.5]))
    recording = walls.record(np.array([[0.0, -6.0]]))
    (impact,) = recording.impacts
    assert world.contacts[impact.contact].name.endswith("+y face")
    fall = 0.55 + 1.5 * impact.time - 3 * impact.time**2
    assert fall == pytest.approx(0.6, abs=1e-14) and impact.speed > 0


@pytest.mark.parametrize("name", ["two_masses", "room_with_block"])
def test_ends_of_many_are_those_of_each(name: str) -> None:
    start, times, _ = draw_task(name, 3)
    world, rng = world_of(name), np.random.default_rng(1)
    controls = rng.normal(0, 9, (6, len(times) - 1, world.num_actuators))
    walls = Parabolas(world.constant_dynamics, np.full(world.num_contacts, 0.7), start, times)
    each = [walls.record(control).positions[-1].tolist() for control in controls]
    assert walls.find_ends(controls).tolist() == each
    assert walls.find_ends(controls[:0]).shape == (0, world.num_positions)
    kick = np.array([0.5, -0.25])
    kicked = Parabolas(
        *(world.constant_dynamics, np.full(world.num_contacts, 0.7)),
        *((start[0], start[1] + kick), times),
    )
    ends = walls.find_ends(controls, kicks=np.tile(kick, (len(controls), 1)))
    assert ends.tolist() == kicked.find_ends(controls).tolist()


@settings(max_examples=66)
@given(st.integers(0, 2**32 - 1), st.integers(1, 7), st.integers(1, 4))
def test_support_is_the_nearest_point_of_a_cone(seed: int, m: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    J, root, free = rng.normal(size=(m, n)), rng.normal(size=(n, n)), rng.normal(size=n)
    M = root @ root.T + 0.1 * np.eye(n)
    kicks = np.linalg.solve(M, J.T).T
    lifts = np.divide(kicks, np.sum(J * kicks, axis=1)[:, np.newaxis], order="C")
    walls, held = Walls(J, np.zeros(m), lifts, np.arange(m + 1)), rng.random(m) < 0.8
    x = np.empty(n)
    support(walls, held, free, x)
    assert np.all(J[held] @ x >= -1e-9 * np.linalg.norm(free))
    # Moreau's theorem: x is nearest if and only if the way there is square to it, …
    way = M @ (x - free)
    rounding = 1e-9 * float(np.linalg.norm(M) * (free @ free))
    assert way @ x == pytest.approx(0, abs=rounding)
    # … and no direction of the cone goes against it.
    for _ in range(20):
        direction = np.empty(n)
        support(walls, held, rng.normal(size=n), direction)
        assert way @ direction >= -rounding


@pytest.mark.parametrize(("distance", "e"), [(0.013, 0.7), (-0.2, 1.0)])
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


@pytest.mark.parametrize("name", ["cart_pole/rigid_06", "hopper/hop"])
def test_a_half_space_that_moved_need_not_be_read_again(name: str) -> None:
    scenario, rng = Scenario.named(name), np.random.default_rng(0)
    world = World.from_scenario(scenario)
    q, v = scenario.initial_position, rng.normal(size=world.num_velocities)
    before, u = world.calc_acceleration(q, v, np.ones(world.num_actuators)), world.num_actuators
    for i in range(world.num_contacts):
        moved = world.with_wall_moved(i, 0.03)
        again = moved.of_diagram(moved.diagram)  # Reads all of the plant.
        assert moved.fingerprint == again.fingerprint
        np.testing.assert_allclose(
            moved.calc_signed_distance(q), again.calc_signed_distance(q), rtol=0, atol=1e-14
        )
        assert np.array_equal(moved.calc_acceleration(q, v, np.ones(u)), before)
        assert moved.num_contacts == world.num_contacts


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
