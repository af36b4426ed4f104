"""The program of a mechanism's motion, which boxes are of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from box_programs import mean_by_block
from mechanism_tasks import DURATION, N, drop_ball, make_boxes, make_cost, make_ends, make_law, read
from mechanisms import (
    LEFT,
    MECHANISMS,
    PASSIVE,
    build_world,
    joint,
    link,
    plane,
    sphere,
    wall,
)

from drake_aigto.box import BoxPolynomial, ParametricPolynomial
from drake_aigto.contact import CompliantLaw, RigidLaw
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.planning import MechanismBoxes, MechanismRung
from drake_aigto.terms import MAX_TERMS
from drake_aigto.transcription import COST, DISTANCES, GOAL, ROWS, Ends, MechanismProgram, soften
from drake_aigto.world import World

DT = DURATION / N
WORLDS = ("pendulum", "cart-pole", "double pendulum", "springs and dampers", "paddle", "two discs")


def draw_motion(world: World, ends: Ends, rng: np.random.Generator) -> Any:
    """Returns positions at the knots, far from each other, so that walls push at some."""
    q = 1.5 * rng.normal(size=(N + 2, world.num_positions))
    q[0] = ends.position
    return q


def transcribe(
    world: World, contacts: Any, law: CompliantLaw, ends: Ends, q: Any
) -> tuple[float, Any]:
    """Returns J and p_k by the textbook: numbers of the world, differences, and loops."""
    cost, forces = ends.cost, []
    total: Any = 0.0
    before = np.vstack([q[1] - 2 * DT * ends.velocity, q[:-2]])
    for k in range(N + 1):
        v, a = (q[k + 1] - before[k]) / (2 * DT), (q[k + 1] - 2 * q[k] + before[k]) / DT**2
        p = world.calc_mass_matrix(q[k]) @ a + world.calc_bias(q[k], v)
        J, phi = world.calc_contact_jacobian(q[k]), world.calc_signed_distance(q[k])
        sides = world.calc_signed_distance(np.array([before[k], q[k + 1]]))
        for i in contacts:
            rate = (sides[1, i] - sides[0, i]) / (2 * DT) if k else J[i] @ v
            push = law.stiffness[i] * max(0.0, -phi[i]) * (1 - law.dissipation[i] * rate)
            p = p - J[i] * push
        u = np.linalg.pinv(world.actuation) @ p
        total += DT * (1.0 if 0 < k < N else 0.5) * cost.running(k * DT, q[k], v, u)
        forces.append(p)
    return float(total + cost.final(q[N], v)), np.array(forces)


@pytest.mark.parametrize("dissipation", [0.0, 0.2])
@pytest.mark.parametrize("name", WORLDS)
def test_points_cost_what_the_worlds_numbers_say(name: str, dissipation: float) -> None:
    world, rng, law = read(name), np.random.default_rng(0), make_law(read(name), dissipation)
    ends = make_ends(world, rng)
    boxes = make_boxes(world, ends, law)
    program = boxes.program
    q = draw_motion(world, ends, rng)
    means = mean_by_block(boxes.polynomial, program.calc_variables(q, ends), 0.0)
    J, forces = transcribe(world, program.coordinates.contacts, law, ends, q)
    assert means[COST] == pytest.approx(J, rel=1e-9)
    assert means.get(DISTANCES, 0.0) == pytest.approx(0.0, abs=1e-6)
    weights = np.full(N + 1, DT) * ([0.5] + N * [1.0])
    is_unmoved = ~np.any(world.actuation, axis=1)  # By any actuator, each of which moves one joint.
    inertia = np.diag(world.calc_mass_matrix(world.plant.GetDefaultPositions()))[is_unmoved]
    residuals = forces[:, is_unmoved] / inertia
    assert means.get(ROWS, 0.0) == pytest.approx(weights @ np.sum(residuals**2, axis=1), rel=1e-9)


def test_a_reference_is_followed_at_every_knot() -> None:
    world, rng = read("cart-pole"), np.random.default_rng(1)
    path = {"times": np.array([0.0, 0.5, 1.0]), "velocities": rng.normal(size=(3, 2))}
    ends = make_ends(world, rng, positions=rng.normal(size=(3, 2)), **path)
    law = make_law(world)
    boxes = make_boxes(world, ends, law)
    q = draw_motion(world, ends, rng)
    z = boxes.program.calc_variables(q, ends)
    got = mean_by_block(boxes.polynomial, z, 0.0)[COST]
    J, _ = transcribe(world, boxes.program.coordinates.contacts, law, ends, q)
    assert got == pytest.approx(J, rel=1e-9)


def test_ends_are_parameters_of_one_program() -> None:
    world, rng, law = read("cart-pole"), np.random.default_rng(2), make_law(read("cart-pole"))
    boxes = make_boxes(world, make_ends(world, rng), law)
    for _ in range(2):
        ends = make_ends(world, rng)
        q = draw_motion(world, ends, rng)
        z = boxes.program.calc_variables(q, ends)
        got = mean_by_block(boxes.start(ends).polynomial, z, 0.0)[COST]
        assert got == pytest.approx(transcribe(world, (0, 1), law, ends, q)[0], rel=1e-9)


def test_a_hard_goal_is_a_penalty_of_what_has_to_reach_it() -> None:
    world, rng = read("cart-pole"), np.random.default_rng(8)
    ends = make_ends(world, rng)
    is_hard = np.array([True, False, False, True])
    program = MechanismProgram(world, ends.cost, make_law(world), DURATION, N, is_hard)
    polynomial = ParametricPolynomial(program.num_variables, program.num_parameters, program.blocks)
    q = draw_motion(world, ends, rng)
    f = polynomial.at(program.parameters(ends))
    got = mean_by_block(f, program.calc_variables(q, ends), 0.0)[GOAL]
    way, turning = q[N, 0] - ends.cost.goal[0], (q[N + 1, 1] - q[N - 1, 1]) / (2 * DT) - 0.3
    expected = (way / ends.cost.goal[0]) ** 2 + (turning * DURATION) ** 2
    assert got == pytest.approx(expected, rel=1e-9)


def test_boxes_come_nearer_to_a_hard_goal_than_to_one_without_weight() -> None:
    world, goal, none = read("pendulum"), np.array([0.5]), np.zeros((1, 1))
    cost = make_cost(world, goal, QT=none, QTv=none, Q=np.zeros(1), Qv=np.zeros(1))
    ends, bounds = Ends(np.zeros(1), np.zeros(1), cost), np.array([[-np.inf], [np.inf]])
    errors = []
    for is_hard in (None, np.array([True, True])):
        program = MechanismProgram(world, cost, make_law(world), DURATION, 20, is_hard)
        started = MechanismBoxes(program, bounds, ends)
        center = started.run(MechanismRung(temperature=0.01), started.rest())
        errors.append(abs(center.positions[-2, 0] - 0.5))
    assert errors[1] < 0.5 * errors[0]


def test_turns_that_do_not_count_cost_nothing() -> None:
    world = read("pendulum")
    modulo = {"is_modulo": np.array([True]), "is_chordal": np.array([False])}
    found = []
    for turns in (0, 1, -3):
        start = np.array([0.2 + 2 * np.pi * turns])
        ends = Ends(start, np.zeros(1), make_cost(world, np.array([2.0]), **modulo))
        boxes = make_boxes(world, ends, make_law(world))
        q = start + np.linspace(0, 4.0, N + 2)[:, np.newaxis]
        z = boxes.program.calc_variables(q, ends)
        found.append(mean_by_block(boxes.polynomial, z, 0.0)[COST])
    np.testing.assert_allclose(found, found[0], rtol=1e-9)


def differentiate(f: BoxPolynomial, center: Any, half_width: Any, e: Any) -> tuple[float, float]:
    """Returns central differences of the mean along e, in c and in z = log w."""
    h = 1e-5
    moved = [f.mean(center + s * h * e, half_width) for s in (1, -1)]
    wider = [f.mean(center, half_width * np.exp(s * h * e)) for s in (1, -1)]
    return (moved[0] - moved[1]) / (2 * h), (wider[0] - wider[1]) / (2 * h)


@pytest.mark.parametrize("name", ["pendulum", "cart-pole", "double pendulum"])
def test_gradient_and_curvature_of_the_mean_are_those_of_differences(name: str) -> None:
    world, rng = read(name), np.random.default_rng(4)
    ends = make_ends(world, rng)
    f = make_boxes(world, ends, make_law(world, 0.1)).polynomial
    center = 0.5 * rng.normal(size=f.num_variables)
    half_width = rng.uniform(0.2, 0.5, f.num_variables)
    e = rng.normal(size=f.num_variables)
    _, by_center, by_width = f.gradient(center, half_width)
    found = differentiate(f, center, half_width, e)
    np.testing.assert_allclose([by_center @ e, by_width @ e], found, rtol=1e-5)
    h, system = 1e-5, f.newton_system(center, half_width, centers_only=True)
    slopes = [f.gradient(center + s * h * e, half_width)[1] for s in (1, -1)]
    hessian = unband(system.band)
    np.testing.assert_allclose(
        hessian @ e[f.order],
        ((slopes[0] - slopes[1]) / (2 * h))[f.order],
        rtol=1e-4,
        atol=1e-6 * np.abs(hessian).max(),
    )


def unband(band: Any) -> Any:
    """Returns the matrix of a lower band."""
    lower = sum(np.diag(row[: band.shape[1] - d], -d) for d, row in enumerate(band))
    return lower + np.tril(lower, -1).T


def test_walls_that_face_each_other_are_read_off_one_variable() -> None:
    coordinates = make_program("cart-pole").coordinates
    assert [each.variable for each in coordinates.readings] == [0, 0]
    assert not coordinates.distances


def test_a_distance_that_no_slider_moves_alone_has_a_variable_of_its_own() -> None:
    for name in ("pendulum", "double pendulum", "two discs"):
        coordinates = make_program(name).coordinates
        (reading,) = coordinates.readings
        assert reading.variable == coordinates.num_positions


def test_positions_are_found_again_from_the_variables_of_boxes() -> None:
    for name in WORLDS:
        world, program = read(name), make_program(name)
        q = np.random.default_rng(5).normal(size=(4, world.num_positions))
        z = program.coordinates.calc_variables(world, q)
        np.testing.assert_allclose(program.coordinates.calc_positions(z), q, atol=1e-14)


def make_program(name: str) -> MechanismProgram:
    world = read(name)
    ends = make_ends(world, np.random.default_rng(0))
    return MechanismProgram(world, ends.cost, make_law(world), DURATION, N)


def test_the_control_moves_the_mechanism_as_its_positions_say() -> None:
    world, rng = read("springs and dampers"), np.random.default_rng(6)
    ends, law = make_ends(world, rng), make_law(world, 0.1)
    program = MechanismProgram(world, ends.cost, law, DURATION, N)
    q, v, a = program.calc_motion(draw_motion(world, ends, rng), ends)
    u = program.calc_controls(np.vstack([q, q[-1:]]), ends)[:-1]
    q, v, a = q[:-1], v[:-1], a[:-1]
    J, phi = world.calc_contact_jacobian(q), world.calc_signed_distance(q)
    rate = np.einsum("kij,kj->ki", J, v)
    push = law.stiffness * np.maximum(0.0, -phi) * (1 - law.dissipation * rate)
    pushed = world.calc_velocity_change(q, push)
    assert np.any(push > 0)
    np.testing.assert_allclose(world.calc_acceleration(q, v, u) + pushed, a, atol=1e-9)


def test_the_order_of_coordinates_does_not_matter() -> None:
    rods = [
        link(name, mass, ">0 0 0 0 0 0", "0 0 -0.7", shape)
        + joint("revolute", "world", name, "0 1 0", limit=limit)
        for name, mass, shape, limit in (
            ("one", 1.3, sphere("tip", "0 0 -0.8"), ""),
            ("two", 0.7, "", PASSIVE),
        )
    ]
    walls = wall(plane("left", LEFT))
    worlds = [build_world("".join(rods[::side]) + walls) for side in (1, -1)]
    names = [list(world.plant.GetPositionNames()) for world in worlds]
    assert names[0] == names[1][::-1]
    rng = np.random.default_rng(7)
    (q0, v0, goal), q = rng.normal(size=(3, 2)), rng.normal(size=(N + 2, 2))
    means = []
    for world, side in zip(worlds, (1, -1), strict=True):
        weights = {"Q": np.ones(2), "Qv": np.ones(2), "QT": np.eye(2)}
        ends = Ends(q0[::side], v0[::side], make_cost(world, goal[::side], **weights))
        boxes = make_boxes(world, ends, make_law(world))
        z = boxes.program.calc_variables(q[:, ::side], ends)
        wide = np.where(boxes.program.is_free, 0.3, 0.0)
        means.append(mean_by_block(boxes.polynomial, z, wide))
    assert means[0] == pytest.approx(means[1], rel=1e-9)


def test_mechanisms_of_too_many_terms_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_TERMS == 1_000_000
    monkeypatch.setattr("drake_aigto.terms.products.MAX_TERMS", 1000)
    with pytest.raises(UnsupportedTermError, match=r"motion has too many terms: got .* when multi"):
        make_program("arm with a slider")


def test_springs_in_place_of_rigid_walls_return_what_these_do_at_one_speed() -> None:
    world = drop_ball()
    law = soften(world, RigidLaw(np.array([0.6])), 0.02, 1.5)
    assert law.stiffness[0] == pytest.approx(2.0 / 0.02**2)
    depth, speed, h = 0.0, 1.5, 1e-5  # Of its motion into the spring, without gravity.
    while depth >= 0.0:
        depth += h * speed
        push = law.stiffness[0] * depth * (1 + law.dissipation[0] * speed)
        speed -= h * push / 2.0
    assert speed == pytest.approx(-0.6 * 1.5, rel=1e-3)


def test_a_wall_below_a_rod_that_hangs_has_a_finite_spring_in_its_place() -> None:
    world = build_world(MECHANISMS["pendulum"].replace(LEFT, "0 0 -0.9 0 0 0"))
    assert not np.any(world.calc_contact_jacobian(np.zeros(1)))
    law = soften(world, RigidLaw(np.ones(1)), 0.02, 1.5)
    assert np.all(np.isfinite(law.stiffness)) and np.all(law.stiffness > 0)
