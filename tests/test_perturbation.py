"""Perturbations of the true world: what they change, by how much, and what is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from replay_worlds import make_scenario, shipped_world
from several_walls import make_task, shipped

from benchmarks.robustness.question import (
    QUANTITIES,
    RANDOM,
    Perturbation,
    perturb_at_random,
    perturb_one_at_a_time,
)
from drake_aigto import ModelError
from drake_aigto.errors import ScenarioError


def test_lengths_are_parts_of_the_first_clearance() -> None:
    world = shipped("room")
    scenario = make_task("room", [0.3, 0.9], [1.0, -2.0], restitution=0.5)
    (nearest,) = np.flatnonzero(world.calc_signed_distance(scenario.initial_position) < 0.15)
    near = world.calc_signed_distance(scenario.initial_position)[nearest]
    for name, sign in (("start", 1), ("wall", -1)):
        perturbation = Perturbation(name, **{name: 0.1})
        true_world, true_scenario = perturbation.apply(world, scenario)
        distances = true_world.calc_signed_distance(true_scenario.initial_position)
        assert distances[nearest] == pytest.approx(near * (1 + sign * 0.1), abs=1e-12)
        assert sum(distances) == pytest.approx(2.0 if name == "start" else 2.0 - 0.1 * near)


def test_other_quantities_are_parts_of_themselves() -> None:
    perturbation = Perturbation(RANDOM, velocity=0.1, mass=-0.2, restitution=0.05)
    world, scenario = perturbation.apply(shipped_world(2.0), make_scenario(mass=2, restitution=0.8))
    assert scenario.initial_velocity == pytest.approx([-2.2])
    assert scenario.mass == world.mass == pytest.approx(1.6)
    assert world.constant_inertia.mass_matrix == pytest.approx(np.array([[1.6]]))
    assert scenario.restitution == pytest.approx(0.84)
    assert scenario.initial_position == make_scenario().initial_position


def test_no_wall_returns_more_than_it_gets() -> None:
    kinds = {e: perturb_one_at_a_time(0.01, make_scenario(restitution=e)) for e in (1.0, 0.5, 0.0)}
    assert [len(found) for found in kinds.values()] == [9, 10, 8]
    assert [each.restitution for each in kinds[1.0] if each.kind == "restitution"] == [-0.01]
    more = Perturbation(RANDOM, restitution=0.01)
    assert more.apply(shipped_world(), make_scenario(restitution=1.0))[1].restitution == 1.0


def test_random_perturbations_come_from_the_seed_alone() -> None:
    few, many, other = (
        perturb_at_random(0.01, n, seed) for n, seed in ((3, 1), (100, 1), (100, 2))
    )
    assert many[:3] == few and many != other
    parts = np.array([[getattr(each, name) for name in QUANTITIES] for each in many])
    assert np.all(np.abs(parts) <= 0.01)
    assert np.all(np.max(parts, axis=0) > 0.009) and np.all(np.min(parts, axis=0) < -0.009)
    assert np.max(np.abs(np.corrcoef(parts.T) - np.eye(5))) < 0.4


def test_a_restitution_that_is_the_models_own_is_refused() -> None:
    world = shipped_world()
    contacts = tuple(dataclasses.replace(each, restitution=0.5) for each in world.contacts)
    own = dataclasses.replace(world, contacts=contacts)
    with pytest.raises(ModelError, match=r"got 0\.5, the model's own, expected the scenario's"):
        Perturbation("restitution", restitution=0.01).apply(own, make_scenario())


def test_a_start_in_the_wall_is_refused() -> None:
    with pytest.raises(ScenarioError, match="initial_position is inside"):
        Perturbation(RANDOM, start=-0.5, wall=0.6).apply(shipped_world(), make_scenario())
