"""What contacts push with: impulses, or the springs that Drake's plant has."""

from __future__ import annotations

import dataclasses
import pickle
from functools import partial
from typing import Any

import numpy as np
import pytest
from mechanisms import (
    DOUBLE_PENDULUM,
    MATERIAL,
    MECHANISMS,
    ask_robot,
    build,
    build_world,
    joint,
    link,
)
from world_models import make_scenario

from drake_aigto import World
from drake_aigto.contact import CompliantLaw, RigidLaw, calc_pushes, contact_law
from drake_aigto.errors import ModelError, ScenarioError

COMPLIANT = make_scenario(contact="compliant")


def material(*values: str) -> str:
    """Returns a frictionless material with more elements."""
    end = "</drake:proximity_properties>"
    return MATERIAL.replace(end, f"{''.join(values)}{end}")


def stiffness(value: float) -> str:
    return f"<drake:point_contact_stiffness>{value}</drake:point_contact_stiffness>"


def dissipation(value: float) -> str:
    return f"<drake:hunt_crossley_dissipation>{value}</drake:hunt_crossley_dissipation>"


def build_soft(name: str) -> World:
    """Returns a mechanism whose tip is of 300 N/m, 0.2 s/m, and whose walls are of 600 and 0.7."""
    tip, walls = (material(stiffness(k), dissipation(d)) for k, d in ((300.0, 0.2), (600.0, 0.7)))
    return build_world(MECHANISMS[name].replace(MATERIAL, tip, 1).replace(MATERIAL, walls))


def accelerate(world: World, law: CompliantLaw, q: Any, v: Any) -> Any:
    """Returns v̇ = M⁻¹ (Jᵀ f − h) with the law's f."""
    x = np.maximum(0.0, -world.calc_signed_distance(q))
    J = world.calc_contact_jacobian(q)
    f = law.stiffness * x * np.maximum(0.0, 1 - law.dissipation * (J @ v))
    still = world.calc_acceleration(q, v, np.zeros(world.num_actuators))
    return still + world.calc_velocity_change(q, f)


@pytest.mark.parametrize("name", ["pendulum", "cart-pole", "arm with a slider"])
def test_the_compliant_law_is_what_drakes_plant_feels(name: str) -> None:
    world = build_soft(name)
    law = contact_law(world, COMPLIANT)
    assert isinstance(law, CompliantLaw)
    np.testing.assert_allclose(law.stiffness, 200.0, rtol=1e-15)
    np.testing.assert_allclose(law.dissipation, (600 * 0.2 + 300 * 0.7) / 900, rtol=1e-15)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.get_actuation_input_port().FixValue(context, np.zeros(world.num_actuators))
    rng = np.random.default_rng(5)
    touched = 0
    for q, v in rng.uniform(-2.0, 2.0, (300, 2, world.num_positions)):
        if -0.5 < world.calc_signed_distance(q).min() < 0:
            touched += 1
            world.plant.SetPositions(context, q)
            world.plant.SetVelocities(context, v)
            expected = world.plant.EvalTimeDerivatives(context).CopyToVector()[len(q) :]
            np.testing.assert_allclose(accelerate(world, law, q, v), expected, rtol=1e-9)
    assert touched >= 5


def test_soft_discs_push_each_other_from_center_to_center_as_in_drakes_plant() -> None:
    world, rng = build_soft("two discs"), np.random.default_rng(3)
    law = contact_law(world, COMPLIANT)
    assert isinstance(law, CompliantLaw)
    root = world.create_context()
    context = world.plant.GetMyMutableContextFromRoot(root)
    world.plant.get_actuation_input_port().FixValue(context, np.zeros(world.num_actuators))
    (i,), touched = np.flatnonzero(law.reaches), 0
    for q, v in rng.uniform(-1.0, 1.0, (80, 2, world.num_positions)):
        pushes = calc_pushes(world, law, q, v)
        touched += bool(pushes[i] > 0.0)
        got = world.calc_acceleration(q, v, np.zeros(world.num_actuators), pushes)
        world.plant.SetPositions(context, q)
        world.plant.SetVelocities(context, v)
        expected = world.plant.EvalTimeDerivatives(context).CopyToVector()[len(q) :]
        np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-9)
    assert 5 <= touched < 80


def test_the_rigid_law_is_the_restitution_and_needs_no_stiffness() -> None:
    law = contact_law(build("cart-pole"), make_scenario(restitution=0.4))
    assert isinstance(law, RigidLaw)
    np.testing.assert_array_equal(law.restitution, [0.4, 0.4])


@pytest.mark.parametrize("contact", ["rigid", "compliant"])
def test_a_law_is_pickled_whole_and_read_only(contact: str) -> None:
    law = contact_law(build_soft("cart-pole"), make_scenario(contact=contact))
    assert pickle.loads(pickle.dumps(law)) == law
    for name in vars(law):
        with pytest.raises(ValueError, match="read-only"):
            getattr(law, name)[0] = 1.0


HYDROELASTIC = """<drake:compliant_hydroelastic/><drake:hydroelastic_modulus>1e6
  </drake:hydroelastic_modulus><drake:mesh_resolution_hint>0.05</drake:mesh_resolution_hint>"""
RIGID = "<drake:rigid_hydroelastic/>"
SOFT = stiffness(400.0) + dissipation(0.0)
REFUSED: dict[str, tuple[str, str]] = {
    "no stiffness": (MECHANISMS["pendulum"], "shape 'mechanism::tip': got no stiffness, so Dr"),
    "no dissipation": (
        MECHANISMS["pendulum"].replace(MATERIAL, material(stiffness(400.0))),
        r"'mechanism::tip': got no dissipation, so Drake's default, 50 s/m, .*<drake:hunt_crossley",
    ),
    "box": (MECHANISMS["paddle"], "of ball against paddle: got a box of which several faces"),
    "hydroelastic": (
        MECHANISMS["pendulum"]
        .replace(MATERIAL, material(SOFT, HYDROELASTIC), 1)
        .replace(MATERIAL, material(SOFT, RIGID)),
        "compliant contact of rod against wall: got hydroelastic shapes",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_spring_that_drake_would_not_have_is_refused_by_name(name: str) -> None:
    parts, message = REFUSED[name]
    world = build_world(parts)
    task: dict[str, Any] = {
        "initial_position": np.zeros(world.num_positions),
        "initial_velocity": np.zeros(world.num_positions),
        "goal_position": np.zeros(world.num_positions),
        "goal_weight": np.ones(world.num_positions),
        "control_weight": np.ones(world.num_actuators),
    }
    for refuse in (partial(contact_law, world), world.check):
        with pytest.raises(ModelError, match=message):
            refuse(make_scenario(contact="compliant", **task))
    contact_law(world, make_scenario())


def test_a_soft_wall_may_be_entered_at_the_start_as_long_as_its_side_is_known() -> None:
    inside = dataclasses.replace(
        ask_robot("cart_pole_soft_06"), initial_position=[0.8, 0.3], contact="compliant"
    )
    world = World.from_scenario(inside)
    assert world.calc_signed_distance(inside.initial_position)[1] < -0.4
    with pytest.raises(ScenarioError, match=r"initial_position is inside or behind .*pole against"):
        world.check(dataclasses.replace(inside, contact="rigid"))
    carts = dataclasses.replace(ask_robot("three_carts"), contact="compliant")
    world = World.from_scenario(carts)  # Of 1 m radius: half of one is in the other, or more.
    world.check(dataclasses.replace(carts, initial_position=[-1.5, 0.0, 3.0]))
    with pytest.raises(ScenarioError, match=r"initial_position is inside or behind .*left_cart ag"):
        world.check(dataclasses.replace(carts, initial_position=[-0.9, 0.0, 3.0]))


def test_a_world_without_contact_has_shapes_of_none() -> None:
    world = build_world(DOUBLE_PENDULUM)
    assert (world.num_contacts, world.num_solids) == (0, 0)
    q, u = np.zeros((4, 3, 2)), np.zeros((4, 3, 1))
    assert world.calc_signed_distance(q).shape == world.calc_clearance(q).shape == (4, 3, 0)
    assert world.calc_contact_jacobian(q).shape == (4, 3, 0, 2)
    np.testing.assert_array_equal(world.calc_velocity_change(q, np.zeros((4, 3, 0))), 0 * q)
    assert np.isfinite(world.calc_acceleration(q, q, u)).all()
    assert world.is_on_face(q[0, 0]).shape == world.stiffness.shape == (0,)
    assert world.are_of_one_solid.shape == (0, 0)
    scenario = make_scenario(size=2)
    for contact in ("rigid", "compliant"):
        law = contact_law(world, dataclasses.replace(scenario, contact=contact))
        assert {len(each) for each in vars(law).values()} == {0}
    world.check(scenario)
    assert world.fingerprint.contacts == ()
    free = build_world(
        link("cart", 1.0, ">0 0 0 0 0 0") + joint("prismatic", "world", "cart", "1 0 0")
    )
    assert free.constant_inertia.jacobian.shape == (0, 1)


def test_angles_are_told_from_lengths() -> None:
    np.testing.assert_array_equal(build("cart-pole").is_hinge, [False, True])
    discs = build("two discs")
    start = discs.plant.GetJointByName("one_joint").position_start()
    np.testing.assert_array_equal(np.flatnonzero(discs.is_hinge), [start + 2])
