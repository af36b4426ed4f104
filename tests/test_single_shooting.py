"""States as polynomials of the controls: equal to simulation, equal optima, and how they grow."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from math import comb
from pathlib import Path

import numpy as np
import pytest
from box_programs import compile_program
from hypothesis import given
from hypothesis import strategies as st
from replay_worlds import make_scenario, shipped_world
from rigid_worlds import AXIS, write_model

from benchmarks.equal_widths import EqualWidths
from drake_aigto import Scenario, World
from drake_aigto.aigo import Annealing, Box, minimize
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.paper import (
    LiteralTask,
    LiteralTranscription,
    LiteralWithForces,
    PolynomialLaw,
    SingleShooting,
    count_terms,
)

# A wall that is felt from afar, so that a law of degree 2 is not too far from ε/(φ + δ).
SOFT = make_scenario(1.0, -3.0, epsilon=1.0, delta=0.2, time_step=1 / 8)
HARD = dataclasses.replace(SOFT, delta=0.0)
LAW = PolynomialLaw.fit(SOFT, degree=2, reach=1.0)
POINTS = EqualWidths(first_share=0.0, final_share=0.0, max_newton_steps=200, tolerance=1e-12)


def steps(scenario: Scenario, number: int) -> Scenario:
    return dataclasses.replace(scenario, time_step=scenario.duration / number)


def euler_cost(scenario: Scenario, law: PolynomialLaw, controls: list[float]) -> float:
    """Returns J of the paper's explicit Euler for 1 kg, with another law of the force."""
    dt, (q,), (v,) = scenario.time_step, scenario.initial_position, scenario.initial_velocity
    for u in controls:
        force = sum(c * q**j for j, c in enumerate(law.coefficients))
        q, v = q + dt * v, v + dt * (u + force)
    effort = scenario.control_weight * dt * sum(u**2 for u in controls)
    return effort + scenario.goal_weight * (q - scenario.goal_position[0]) ** 2


@given(controls=st.lists(st.floats(-5, 5), min_size=6, max_size=6), degree=st.integers(0, 3))
def test_the_polynomial_is_the_cost_of_the_simulation(controls: list[float], degree: int) -> None:
    scenario = steps(SOFT, 6)
    law = PolynomialLaw.fit(scenario, degree, reach=1.0)
    transcription = SingleShooting(shipped_world(), scenario, law)
    cost = euler_cost(scenario, law, controls)
    x = np.array(controls)
    assert transcription.scenario_cost(x) == pytest.approx(cost, rel=1e-12)
    # Sums of powers up to 16 of numbers up to 5 cancel: far more than machine precision is lost.
    assert compile_program(transcription.prog())(x) == pytest.approx(cost, rel=1e-6, abs=1e-6)


def test_states_are_those_of_the_rows_with_states_as_variables(tmp_path: Path) -> None:
    sprung = (
        f"{AXIS}<dynamics><damping>0.7</damping><spring_stiffness>30</spring_stiffness>"
        "<spring_reference>0.4</spring_reference></dynamics>"
    )
    scenario = dataclasses.replace(SOFT, model=write_model(tmp_path, AXIS, sprung))
    world = World.from_scenario(scenario)
    transcription = SingleShooting(world, scenario, LAW)
    controls = np.linspace(-2.0, 3.0, SOFT.num_steps)
    x = transcription.vector(controls)
    rows = transcription.multiple_shooting
    assert max(rows.defects(x).values()) < 1e-12
    papers = LiteralTranscription(world, scenario, nonpenetration=False)
    assert papers.defects(x)["dynamics"] > 1e-2
    for kind in (LiteralTranscription, LiteralWithForces):
        same = kind(world, scenario, nonpenetration=False, law=LAW)
        rows_hold = same.prog().CheckSatisfied
        assert rows_hold(same.prog().GetAllConstraints(), same.vector_of(*rows.split(x)), 1e-12)
    table = dict(zip(np.ravel([transcription.input(k) for k in range(8)]), controls, strict=True))
    trajectory = transcription.trajectory(controls)
    for k in range(transcription.num_samples()):
        q, v = (entry.Evaluate(table) for entry in transcription.state(k))
        assert q == pytest.approx(trajectory.positions[k, 0], abs=1e-9)
        assert v == pytest.approx(trajectory.velocities[k, 0], abs=1e-9)
    np.testing.assert_allclose(
        trajectory.impulses[:-1, 0], SOFT.time_step * LAW(trajectory.positions[:-1, 0])
    )


@pytest.mark.parametrize("law", [None, LAW])
@pytest.mark.parametrize("velocity", [-3.0, -1.0])
def test_aigo_and_polish_reach_the_optimum_of_multiple_shooting(
    law: PolynomialLaw | None, velocity: float
) -> None:
    scenario = dataclasses.replace(SOFT, initial_velocity=velocity)
    transcription = SingleShooting(shipped_world(), scenario, law)
    f = compile_program(transcription.prog())
    boxes = minimize(f, Box(*transcription.initial_box()), Annealing(initial_temperature=1e-2))
    assert boxes.is_converged
    found = minimize(f, Box(boxes.box.center, 1.0), POINTS).box.center  # type: ignore[arg-type]
    rows = transcription.multiple_shooting
    problem = LiteralTask(rows)
    x = problem.solve_locally(rows.initial_box()[0])
    assert max(rows.defects(x).values()) < 1e-9
    assert transcription.scenario_cost(found) == pytest.approx(rows.scenario_cost(x), rel=1e-9)
    np.testing.assert_allclose(
        transcription.trajectory(found).controls, rows.split(x)[2], atol=1e-5
    )


def test_the_first_box_has_the_controls_of_multiple_shooting() -> None:
    transcription = SingleShooting(shipped_world(), SOFT, LAW)
    center, half_width = transcription.initial_box()
    np.testing.assert_array_equal(center, np.zeros(8))
    L = transcription.multiple_shooting.length_scale()
    np.testing.assert_allclose(half_width, np.full(8, 4 * L))


def test_without_contact_the_cost_is_quadratic() -> None:
    for number in (5, 20):
        transcription = SingleShooting(shipped_world(), steps(SOFT, number))
        f = compile_program(transcription.prog())
        # u_{N−1} is too late to move q_N by explicit Euler; the squares of the effort are apart.
        assert f.num_terms == comb(number + 1, 2) + number
        degrees = {
            sum(factor.exponent for factor in term.factors)
            for block in f.blocks
            for term in block.terms
        }
        assert degrees <= {0, 1, 2}
        assert transcription.num_terms(number) == number + 1
    assert count_terms(shipped_world(), steps(SOFT, 20)) == list(range(2, 22))


def test_forces_of_all_walls_count_so_that_the_squares_of_two_opposite_ones_cancel() -> None:
    scenario = steps(Scenario.named("corridor/three_bounces"), 6)
    world = World.from_scenario(scenario)
    assert world.num_contacts == 2 and len(LAW.coefficients) == 3
    assert count_terms(world, scenario, LAW) == list(range(2, 8))
    assert count_terms(shipped_world(), steps(SOFT, 6), LAW)[-1] > 7  # Off one wall, they do not.


def test_terms_explode_with_a_laws_degree() -> None:
    world, scenario = shipped_world(), steps(SOFT, 50)
    growth = {
        degree: count_terms(world, scenario, PolynomialLaw.fit(scenario, degree, 1.0))
        for degree in (1, 2, 3)
    }
    assert growth[1] == list(range(2, 52))
    assert growth[2] == [2, 3, 5, 8, 16, 32, 88, 240, 968]
    assert len(growth[3]) < len(growth[2])
    # Two steps later there are about the square of them.
    for before, after in zip(growth[3][3:], growth[3][5:], strict=False):
        assert before**1.5 < after <= before**3


@pytest.mark.parametrize("max_terms", [1, 10, 500])
def test_no_state_has_more_terms_than_allowed(max_terms: int) -> None:
    scenario = steps(SOFT, 12)
    counts = count_terms(shipped_world(), scenario, LAW, max_terms)
    assert all(count <= max_terms for count in counts)
    assert counts == count_terms(shipped_world(), scenario, LAW)[: len(counts)]
    transcription = SingleShooting(shipped_world(), SOFT, LAW)
    assert [transcription.num_terms(k) for k in range(1, 9)] == [2, 3, 5, 8, 16, 32, 88, 240]


def test_too_many_terms_are_refused_with_their_number_before_they_are_made() -> None:
    message = (
        r"the state after 10 of 200 steps has too many terms for single shooting: got up to "
        r"[\d,]{6,}, products of states of 968 terms, expected at most 25,000\. Take fewer steps"
    )
    with pytest.raises(UnsupportedTermError, match=message):
        SingleShooting(shipped_world(), steps(SOFT, 200), LAW)
    message = r"the cost 'goal' of 9 steps has too many terms .* got up to \d{2,3},\d{3}, products"
    with pytest.raises(UnsupportedTermError, match=message):
        SingleShooting(shipped_world(), steps(SOFT, 9), LAW)


def test_a_law_meets_the_papers_in_as_many_places_as_it_has_coefficients() -> None:
    grid = np.linspace(0.0, 1.0, 4001)
    for degree in (1, 2, 5):
        law = PolynomialLaw.fit(SOFT, degree, reach=1.0)
        off = law(grid) - SOFT.epsilon / (grid + SOFT.delta)
        assert np.count_nonzero(np.diff(np.sign(off))) == degree + 1
    assert PolynomialLaw((3.0,))(0.5) == 3.0


def test_laws_come_nearer_by_the_factor_that_delta_allows() -> None:
    r = SOFT.delta
    factor = 1 + 2 * r + 2 * np.sqrt(r**2 + r)
    grid = np.linspace(0.0, 1.0, 40001)
    paper = SOFT.epsilon / (grid + SOFT.delta)
    laws = (PolynomialLaw.fit(SOFT, degree, 1.0) for degree in (4, 10))
    errors = [np.max(np.abs(law(grid) - paper)) for law in laws]
    assert (errors[0] / errors[1]) ** (1 / 6) == pytest.approx(factor, rel=0.05)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PolynomialLaw.fit(SOFT, -1, 1.0), "degree: got -1, expected 0 or more"),
        (lambda: PolynomialLaw.fit(SOFT, 2, 0.0), "reach: got 0 m, expected a number above 0"),
        (lambda: PolynomialLaw.fit(SOFT, 2, np.inf), "reach: got inf m"),
        (lambda: PolynomialLaw.fit(HARD, 2, 1.0), "delta: got 0 m, expected more than 0 m. ε/φ"),
        (lambda: PolynomialLaw(()), r"coefficients: got \(\), expected finite numbers"),
        (lambda: PolynomialLaw((1.0, np.nan)), "coefficients: got .*, expected finite numbers"),
    ],
)
def test_laws_that_can_not_be_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(OptionsError, match=message):
        make()
