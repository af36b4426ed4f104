"""Descents of boxes of a mechanism's motion, and what is read off them."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from mechanism_tasks import DURATION, drop_ball, make_boxes, make_cost, make_law, read

from drake_aigto.contact import RigidLaw
from drake_aigto.planning import MechanismBoxes, MechanismRung, Renewal
from drake_aigto.transcription import ROWS, Ends, MechanismProgram, soften
from drake_aigto.world import World


@cache
def start_cart_pole(num_steps: int = 20) -> MechanismBoxes:
    world = read("cart-pole")
    start, goal = np.array([0.2, 0.3]), np.array([0.0, np.pi])
    ends = Ends(start, np.array([0.5, -1.0]), make_cost(world, goal))
    return make_boxes(world, ends, make_law(world), num_steps)


def test_boxes_shrink_from_the_width_that_is_asked_for_and_the_start_is_held() -> None:
    started = start_cart_pole()
    center = started.run(MechanismRung(half_width=0.7), started.rest())
    first, last = (each.half_width.reshape(22, 2) for each in (center.boxes[0], center.boxes[-1]))
    np.testing.assert_allclose(first[1:], np.tile(0.7 * started.widths, (21, 1)))
    assert np.all(first[0] == 0) and np.all(last[0] == 0)
    assert len(center.boxes) == 4 and center.iterations > 4
    assert np.all(np.diff([box.mean_half_width for box in center.boxes[1:]]) < 0)
    np.testing.assert_allclose(center.positions[0], started.ends.position)
    np.testing.assert_allclose(center.velocities[0], started.ends.velocity)


def test_a_rung_says_what_it_is() -> None:
    text = MechanismRung(start="coast", temperature=0.5, weight=2.0).describe("annealing")
    expected = "annealing from temperature 0.5; around the coast; weight 2; 30 time steps"
    assert text == expected
    assert "annealing of points" in MechanismRung(half_width=0.0).describe("annealing")


def test_where_nothing_has_to_move_units_are_numbers() -> None:
    world, none = read("two discs"), np.zeros(5)
    cost = make_cost(world, none, goal_velocity=none, velocities=np.zeros((1, 5)))
    ends = Ends(none, none, cost)
    started = make_boxes(world, ends, make_law(world))
    for unit in (started.weight_unit, started.temperature_unit, *started.widths):
        assert 0 < unit < np.inf
    center = started.run(MechanismRung(), started.rest())
    assert np.all(np.isfinite(center.positions))


def test_a_line_leads_to_the_nearest_turn_where_turns_do_not_count() -> None:
    world = read("pendulum")
    for is_modulo, end in ((True, 2 * np.pi + 1.0), (False, 1.0)):
        flags = {"is_modulo": np.array([is_modulo]), "is_chordal": np.array([False])}
        ends = Ends(np.array([6.0]), np.zeros(1), make_cost(world, np.array([1.0]), **flags))
        started = make_boxes(world, ends, make_law(world))
        np.testing.assert_allclose(started.line(), [[6.0], [end]])


def test_the_same_rung_gives_the_same_bits() -> None:
    started = start_cart_pole()
    one, other = (started.run(MechanismRung(), started.line()) for _ in range(2))
    np.testing.assert_array_equal(one.positions, other.positions)
    np.testing.assert_array_equal(one.controls, other.controls)


def test_a_box_without_width_is_a_descent_of_points() -> None:
    started = start_cart_pole()
    rung = MechanismRung(half_width=0.0)
    center = started.run(rung, started.rest())
    assert np.all(center.boxes[-1].half_width == 0)
    f = started.polynomial.with_weights({ROWS: rung.weight * started.weight_unit})
    first = started.program.calc_variables(np.tile(started.ends.position, (22, 1)), started.ends)
    assert f(center.boxes[-1].center) < 0.8 * f(first)


def test_controls_keep_their_bounds() -> None:
    started = start_cart_pole()
    center = started.run(MechanismRung(), started.line())
    free = started.program.calc_controls(center.positions, started.ends)
    assert np.max(np.abs(free)) > 3.0
    np.testing.assert_array_equal(center.controls, np.clip(free, -3.0, 3.0))


def test_a_renewal_moves_its_stretch_alone() -> None:
    started = start_cart_pole()
    center = started.run(MechanismRung(), started.rest())
    renewal = Renewal(first=5, count=8, shift=np.array([0.3, -0.5]))
    renewed = started.renew(center.positions, renewal)
    changes = np.any(np.abs(renewed.positions - center.positions) > 1e-12, axis=1)
    np.testing.assert_array_equal(np.flatnonzero(changes), np.arange(5, 13))


def test_renewals_are_drawn_with_a_seed_and_end_within_the_motion() -> None:
    draws = [Renewal.draw(np.random.default_rng(s), 20, 2) for s in (*range(30), 0)]
    assert repr(draws[0]) == repr(draws[-1]) != repr(draws[1])
    assert all(each.first >= 1 and each.first + each.count <= 22 for each in draws)
    assert {each.count for each in draws} == {5, 10, 15, 20}


def test_a_moved_start_shows_another_motion_from_the_same_place() -> None:
    world = read("cart-pole")
    ends = Ends(np.array([0.1, 0.2]), np.zeros(2), make_cost(world, np.array([0.0, np.pi])))
    started = make_boxes(world, ends, make_law(world), 12, np.inf)
    rng = np.random.default_rng(0)
    rung = MechanismRung.draw(rng, 12, world.is_hinge)
    still = started.run(dataclasses.replace(rung, shift=()), started.rest())
    moved = started.run(rung, started.rest())
    np.testing.assert_allclose(moved.positions[0], ends.position)
    assert np.max(np.abs(moved.boxes[0].center - still.boxes[0].center)) > 0.1


def test_what_a_box_shows_is_a_motion_where_every_joint_is_driven() -> None:
    world = read("pendulum")
    n = 60
    cost = make_cost(world, np.array([0.6]), Q=np.zeros(1), QT=100 * np.eye(1))
    ends = Ends(np.array([0.0]), np.array([0.5]), cost)
    started = make_boxes(world, ends, make_law(world), n, np.inf)
    center = started.run(MechanismRung(temperature=1e-3, temperatures=6), started.rest())
    times = np.linspace(0.0, DURATION, n + 1)
    states, controls = center.sample(times)
    np.testing.assert_allclose(states[:, :1], center.positions[:-1], atol=1e-12)
    x = np.concatenate([ends.position, ends.velocity])
    h = DURATION / n / 10
    for u in np.repeat(controls, 10, axis=0):
        x = advance(world, x, u, h)
    assert np.max(world.calc_signed_distance(states[:, :1])) > 0
    np.testing.assert_allclose(x, states[-1], atol=2e-2)


def advance(world: World, x: Any, u: Any, h: float) -> Any:
    """Returns the state after a step of the midpoint rule, without contact."""

    def slope(x: Any) -> Any:
        q, v = np.split(x, 2)
        return np.concatenate([v, world.calc_acceleration(q, v, u)])

    return x + h * slope(x + h / 2 * slope(x))


def test_the_bounce_that_carries_a_ball_back_for_nothing_is_seen_from_standing_still() -> None:
    world, none, n = drop_ball(), np.zeros(1), 20
    falling = np.sqrt(2 * 0.45 / 9.81)
    law = soften(world, RigidLaw(np.ones(1)), 2 * falling / n, 2.0)
    weights = {"R": np.ones(1), "Q": none, "Qv": none, "QT": np.eye(1), "QTv": np.zeros((1, 1))}
    cost, bounds = make_cost(world, none, **weights), np.array([[-np.inf], [np.inf]])
    program = MechanismProgram(world, cost, law, 2 * falling, n)
    started = MechanismBoxes(program, bounds, Ends(none, none, cost))
    center = started.run(MechanismRung(temperatures=5), started.rest())
    phi = world.calc_signed_distance(center.positions[1:-1])
    assert np.min(phi) < 0 and np.all(np.diff(np.flatnonzero(phi < 0)) == 1)
    assert center.times[1 + np.argmin(phi)] == pytest.approx(falling, abs=0.15)
