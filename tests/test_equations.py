"""The equations of motion: one source for expressions, functions, and the constant special case."""

from __future__ import annotations

import dataclasses
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from world_models import RELATIVE, VARIANTS, ModelWriter, evaluate, make_world

from drake_aigto import ModelError, Scenario, World
from drake_aigto.dynamics import Contact

Array = np.ndarray[Any, np.dtype[np.float64]]

MANY = (4, 3)  # States at once, in two axes.
SHIPPED = ("room_with_block/around", "two_masses/apart")


def bend(world: World) -> World:
    """Returns equations as those of no plant here: M, h and J vary with everything."""
    (x, y), (v, w) = world.positions, world.velocities
    M = np.array([[x**2 + 3.0, x * y], [x * y, y**2 + 2.0]])
    distance = x**2 * y - 0.3 * y
    J = np.array([distance.Differentiate(each) for each in world.positions])
    contacts = (*world.contacts, Contact("bent", distance, J, len(world.solids)))
    bias = np.array([x * v**2 - w, y * v * w + 3.0])
    return dataclasses.replace(world, mass_matrix=M, bias=bias, contacts=contacts)


@cache
def read(name: str) -> World:
    if name in SHIPPED:
        return World.from_scenario(Scenario.named(name))
    if name == "bent":
        return bend(read("cart"))
    with tempfile.TemporaryDirectory() as directory:
        return make_world(ModelWriter(Path(directory)), name, mass=2.5)


@pytest.fixture(params=[*VARIANTS, *SHIPPED, "bent"])
def world(request: pytest.FixtureRequest) -> World:
    return read(request.param)


@pytest.fixture(params=[*VARIANTS, *SHIPPED])
def straight(request: pytest.FixtureRequest) -> World:
    """M and J are constant."""
    return read(request.param)


def agree(got: Any, expected: Any, where: str = "") -> None:
    """Checks numbers that a few operations on others of size one make."""
    np.testing.assert_allclose(got, expected, RELATIVE, 20 * RELATIVE, err_msg=where)


def draw(world: World, *axes: int) -> tuple[Array, Array, Array, Array]:
    """Returns positions, velocities, controls and impulses by chance."""
    rng = np.random.default_rng(5)
    sizes = world.num_positions, world.num_velocities, world.num_actuators, world.num_contacts
    q, v, u, p = (rng.uniform(-1.0, 1.0, (*axes, size)) for size in sizes)
    return q, v, u, p


def test_functions_compute_what_the_expressions_say(world: World) -> None:
    n = world.num_positions
    q, v, u, p = draw(world)
    state = np.concatenate([world.positions, world.velocities]), np.concatenate([q, v])
    M = evaluate(world.mass_matrix, *state).reshape(n, n)
    h = evaluate(world.bias, *state)
    J = np.array([evaluate(contact.jacobian, *state) for contact in world.contacts])
    distances = [contact.signed_distance for contact in world.contacts]
    agree(world.calc_mass_matrix(q), M)
    agree(world.calc_bias(q, v), h)
    agree(world.calc_signed_distance(q), evaluate(distances, *state))
    agree(world.calc_contact_jacobian(q), J)
    acceleration, kick = world.calc_acceleration(q, v, u), world.calc_velocity_change(q, p)
    agree(M @ acceleration, world.actuation @ u - h)
    agree(M @ kick, J.T @ p)
    agree(world.calc_kinetic_energy(q, v), v @ M @ v / 2)
    # At other expressions: of the same variables, and numbers.
    elsewhere = world.express_bias(np.array([2.0 * each for each in world.positions]), 1.0 - v)
    there = world.calc_bias(2.0 * q, 1.0 - v)
    agree(evaluate(elsewhere, *state), there)


def test_many_states_at_once_are_each_on_its_own(world: World) -> None:
    q, v, u, p = draw(world, *MANY)
    for function, arguments in (
        (world.calc_mass_matrix, (q,)),
        (world.calc_bias, (q, v)),
        (world.calc_signed_distance, (q,)),
        (world.calc_clearance, (q,)),
        (world.calc_contact_jacobian, (q,)),
        (world.calc_acceleration, (q, v, u)),
        (world.calc_velocity_change, (q, p)),
        (world.calc_kinetic_energy, (q, v)),
    ):
        places = [[tuple(each[i, j] for each in arguments) for j in range(3)] for i in range(4)]
        alone = [[function(*place) for place in row] for row in places]
        agree(function(*arguments), alone, str(function))
    # One state goes with many controls, and with many impulses.
    still, moving = np.broadcast_to(q[0, 0], q.shape), np.broadcast_to(v[0, 0], v.shape)
    agree(world.calc_acceleration(q[0, 0], v[0, 0], u), world.calc_acceleration(still, moving, u))
    agree(world.calc_velocity_change(q[0, 0], p), world.calc_velocity_change(still, p))


# The constant special case.


def test_what_is_constant_is_what_the_functions_say_anywhere(straight: World) -> None:
    inertia = straight.constant_inertia
    q, v, u, p = draw(straight, *MANY)
    agree(straight.calc_mass_matrix(q)[1, 2], inertia.mass_matrix)
    agree(straight.calc_contact_jacobian(q)[3, 0], inertia.jacobian)
    distances = q @ inertia.jacobian.T + inertia.offset
    agree(straight.calc_signed_distance(q), distances)
    agree(straight.calc_velocity_change(q, p), p @ inertia.kicks)
    # What control adds is the same anywhere, whatever else accelerates.
    added = straight.calc_acceleration(q, v, u) - straight.calc_acceleration(q, v, 0.0 * u)
    agree(added, u @ inertia.gain.T)
    assert inertia.solids == straight.solids


def test_a_lift_changes_its_own_speed_by_one_and_costs_what_the_mass_is(straight: World) -> None:
    inertia = straight.constant_inertia
    M, J, lifts = inertia.mass_matrix, inertia.jacobian, inertia.lifts
    agree(np.sum(J * lifts, axis=1), 1.0)
    # Of all changes that do so it takes the least energy, ½ m: it is along M⁻¹ Jᵀ.
    agree(M @ lifts.T, J.T * inertia.masses)
    agree(np.sum(lifts @ M * lifts, axis=1), inertia.masses)


def test_dynamics_are_constant_where_a_held_control_flies_parabolas(world: World) -> None:
    q, v, u, _ = draw(world, *MANY)
    accelerations = world.calc_acceleration(q, v, u[0, 0])
    is_same = np.allclose(accelerations, accelerations[0, 0], rtol=1e-9, atol=1e-9)
    assert world.has_constant_dynamics == is_same
    if is_same:
        dynamics = world.constant_dynamics
        assert world.constant_inertia is dynamics
        expected = dynamics.gain @ u[0, 0] + dynamics.drift
        agree(accelerations[1, 1], expected)
    else:
        with pytest.raises(ModelError, match="expected a constant"):
            _ = world.constant_dynamics


def test_what_varies_is_refused_by_name() -> None:
    straight, bent, springy = map(read, ("cart", "bent", "spring"))
    for varied, message in (
        ({"mass_matrix": bent.mass_matrix}, r"the mass matrix M\(q\): got \(3 \+ pow"),
        ({"contacts": bent.contacts}, r"∂φ/∂q of bent: got \(2 \* "),
    ):
        with pytest.raises(ModelError, match=message) as error:
            _ = dataclasses.replace(straight, **varied).constant_inertia
        assert str(error.value).endswith("expected a constant. Use the literal transcription.")
    with pytest.raises(ModelError) as error:
        _ = springy.constant_dynamics
    assert str(error.value) == (
        f"the bias h(q, v): got {springy.bias[0]}, expected a constant. Exact optima and sampling "
        "over controls need flight in parabolas; plans, replays and gradient solvers do not."
    )
    assert springy.constant_inertia.mass_matrix.tolist() == [[2.5]]


def test_what_is_shared_is_read_only() -> None:
    inertia = read("as shipped").constant_dynamics
    given = ("mass_matrix", "actuation", "jacobian", "offset", "bias")
    derived = ("inverse_mass", "kicks", "masses", "lifts", "gain", "drift")
    for array in (getattr(inertia, name) for name in given + derived):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = array[0]
