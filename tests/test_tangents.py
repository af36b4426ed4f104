"""How contacts slip: T(q) against Drake's own slip speed, and friction of a world by contact."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from pydrake.multibody.plant import CoulombFriction
from rubbing_worlds import make_discs

from drake_aigto import ModelError, Scenario, ScenarioError, World
from drake_aigto.arrays import Floats
from drake_aigto.paper import plan_literal


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
        assert abs(world.rubbing.calc_tangent_jacobian(q, is_compliant=True) @ v) == pytest.approx(
            slip, rel=1e-12
        )


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


def read_friction(world: World, friction: float | None) -> CoulombFriction:
    """Returns what the ground has in a simulation."""
    root = world.create_context()
    world.rubbing.impose(root, friction)
    query: Any = world.scene_graph.get_query_output_port()
    inspector = query.Eval(world.scene_graph.GetMyContextFromRoot(root)).inspector()
    ((_, ground),) = world.shapes
    return inspector.GetProximityProperties(ground).GetProperty("material", "coulomb_friction")


def ask(friction: float | None = None, num_positions: int = 3) -> Scenario:
    """Returns a task of a ball above the ground."""
    place = np.concatenate([[0.0, 1.0], np.zeros(num_positions - 2)])
    still = np.zeros(num_positions)
    return Scenario(
        initial_position=place,
        initial_velocity=still,
        goal_position=place,
        goal_weight=np.ones(num_positions),
        friction=friction,
    )


@pytest.mark.parametrize(("asked", "expected"), [(None, 0.4), (0.7, 0.7), (0.0, 0.0)])
def test_of_two_coefficients_the_dynamic_one_counts_unless_the_scenario_has_its_own(
    asked: float | None, expected: float
) -> None:
    world = World.from_diagram(make_discs(friction=CoulombFriction(0.9, 0.4)))
    assert world.friction_coefficients(ask(asked)) == pytest.approx([expected])
    simulated = read_friction(world, asked)
    both = simulated.static_friction(), simulated.dynamic_friction()
    assert both == pytest.approx((expected or both[0], expected or both[1]))


def test_what_counts_for_nothing_or_can_not_act_is_refused() -> None:
    world = World.from_scenario(Scenario.named("table1/1"))
    task = dataclasses.replace(Scenario.named("table1/1"), friction=0.2)
    with pytest.raises(ScenarioError, match=r"friction: got 0\.2, in a world where no sphere can"):
        world.check(task)
    rough = World.from_diagram(make_discs(across=True))
    with pytest.raises(ModelError, match=r"ball_0 against world_1: got μ = 0\.3 .* two directions"):
        rough.check(ask(num_positions=4))
    rough.check(ask(0.0, num_positions=4))


@pytest.mark.parametrize("friction", [None, 0.7])
def test_who_plans_without_friction_refuses_it(friction: float | None) -> None:
    world = World.from_diagram(make_discs())
    world.check(task := ask(friction))
    with pytest.raises(ModelError, match=r"friction of ball_0 against world_1: got μ = 0\."):
        plan_literal(task, world=world)
