"""States as polynomials of the controls: equal to simulation, equal optima, and how they grow."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from math import comb
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from box_programs import compile_program, mean_by_block
from hypothesis import given
from hypothesis import strategies as st
from replay_worlds import make_diagram, make_scenario, shipped_world
from rigid_worlds import AXIS, indices, write_model

from benchmarks.equal_widths import EqualWidths
from drake_aigto import Scenario, World
from drake_aigto.aigo import Annealing, Box, minimize
from drake_aigto.errors import OptionsError, UnsupportedTermError
from drake_aigto.paper import (
    LiteralOptions,
    LiteralSearch,
    LiteralTask,
    LiteralTranscription,
    LiteralWithForces,
    PolynomialLaw,
    RigidWithForces,
    SingleShooting,
    count_terms,
    rigid_optimum,
)
from drake_aigto.planning import BALL_LADDER, BallSearch, BallTask, PlanOptions, Rung, run_search
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import RigidTranscription, Transcription

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


KINDS: dict[str, Callable[[World, Scenario], Transcription]] = {
    "literal": LiteralTranscription,
    "rigid": RigidTranscription,
    "literal, forces": LiteralWithForces,
    "rigid, forces": RigidWithForces,
}
PLANTS: list[dict[str, Any]] = [
    {},
    {"num_joints": 2},
    {"num_joints": 2, "rail": (0.0, 1.0)},
    {"num_joints": 2, "num_actuators": 1},
]


@pytest.fixture(scope="module", params=PLANTS, ids=["one", "two", "apart", "underactuated"])
def plant(request: pytest.FixtureRequest) -> tuple[World, Scenario]:
    world = World.from_diagram(make_diagram(**request.param))
    start = ([0.3, 0.6], [-0.4, -1.0]) if world.num_positions == 2 else (0.9, -1.4)
    return world, make_scenario(*start, time_step=0.1)


@pytest.fixture(params=KINDS)
def transcription(request: pytest.FixtureRequest, plant: tuple[World, Scenario]) -> Transcription:
    return KINDS[request.param](*plant)


def make_trajectory(transcription: Transcription, seed: int = 0) -> Trajectory:
    """Returns numbers by chance, all different, where the transcription has variables for them."""
    world, rng = transcription.world, np.random.default_rng(seed)
    N = transcription.num_samples() - 1
    q, v = rng.normal(size=(2, N + 1, world.num_positions))
    u = rng.normal(size=(N, world.num_actuators))
    none = np.zeros((N + 1, 1))
    return Trajectory(transcription.GetSampleTimes(), q, v, u, none, none[1:])


def test_vector_undoes_trajectory(transcription: Transcription) -> None:
    planned = make_trajectory(transcription)
    x = transcription.vector(planned)
    q, v, u = transcription.split(x)
    np.testing.assert_array_equal(q, planned.positions)
    np.testing.assert_array_equal(v, planned.velocities)
    np.testing.assert_array_equal(u, planned.controls)
    again = transcription.trajectory(x)
    np.testing.assert_array_equal(transcription.vector(again), x)
    np.testing.assert_allclose(again.times, planned.times, atol=1e-15)
    # Each knot's variables are the program's own.
    for k in (0, 3, 10):
        places = transcription.prog().FindDecisionVariableIndices(transcription.state(k))
        np.testing.assert_array_equal(x[places], np.concatenate([q[k], v[k]]))


def test_clearances_are_the_signed_distances(transcription: Transcription) -> None:
    x = transcription.vector(make_trajectory(transcription))
    rows = [
        binding
        for binding in transcription.prog().GetAllConstraints()
        if binding.evaluator().get_description() == "clearance"
    ]
    reads_two = len(transcription.world.contacts[0].signed_distance.GetVariables()) == 2
    assert len(rows) == (transcription.num_samples() if reads_two else 0)
    for binding in rows:
        assert transcription.prog().EvalBinding(binding, x) == pytest.approx(0, abs=1e-14)


def test_the_elimination_order_counts_all_variables_stage_by_stage(
    transcription: Transcription,
) -> None:
    order = transcription.elimination_order()
    np.testing.assert_array_equal(np.sort(order), np.arange(transcription.prog().num_vars()))
    prog, place = transcription.prog(), np.argsort(order)
    rank = [place[prog.FindDecisionVariableIndices(transcription.state(k))] for k in range(11)]
    assert all(np.max(a) < np.min(b) for a, b in pairwise(rank))
    # Whatever one row reads is near each other.
    spread = [
        np.ptp(place[prog.FindDecisionVariableIndices(binding.variables())])
        for binding in prog.GetAllConstraints()
        if binding.evaluator().get_description() not in ("initial state", "duration", "")
    ]
    assert max(spread) <= 2 * prog.num_vars() / 11 + 2


@pytest.mark.parametrize("kind", ["literal", "rigid"])
def test_the_first_box_holds_the_start_the_straight_way_and_bounds(
    kind: str, plant: tuple[World, Scenario]
) -> None:
    world, scenario = plant
    transcription = KINDS[kind](world, scenario)
    transcription.AddConstraintToAllKnotPoints(transcription.input()[0] <= 0.5)
    center, half_width = transcription.initial_box()
    low, high = center - half_width, center + half_width
    q, _, u, s = indices(transcription)
    nq = world.num_positions
    way = np.linspace(scenario.initial_position, scenario.goal_position, 11)
    assert np.all(low[q].reshape(11, nq) <= way + 1e-15)
    assert np.all(way <= high[q].reshape(11, nq) + 1e-15)
    start = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    places = transcription.prog().FindDecisionVariableIndices(transcription.state(0))
    np.testing.assert_array_equal(low[places], start)
    np.testing.assert_array_equal(high[places], start)
    assert high[u].reshape(10, -1)[:, 0] == pytest.approx(0.5)
    assert np.all(half_width[np.setdiff1d(np.arange(center.size), places)] > 0)
    # It ends at the wall, in those variables that say where that is.
    if s.size:
        distances = way @ world.calc_contact_jacobian(way[0])[0]
        assert np.all(low[s] <= distances)
        assert np.all(distances <= high[s])
        assert np.max(np.abs(low[s][1:])) < 1e-15
    else:
        assert np.max(np.abs(low[q].reshape(11, nq)[1:, -1])) < 1e-15


# The optimum bounces, and boxes of the hot rung find it without forces as variables.
BOUNCE = dataclasses.replace(Scenario.named("table1/3"), time_step=0.02)
HOT = BALL_LADDER[0]


@pytest.mark.parametrize("relaxation", [0.0, 0.3])
def test_the_mean_of_the_contact_row_is_that_of_fig_1_and_least_at_zero(relaxation: float) -> None:
    # Two steps: the only products are φ_1 p_1, and p_0 for the start. The mass is 1 kg.
    scenario = make_scenario(1.0, -2.0, time_step=0.5)
    transcription = RigidWithForces(shipped_world(), scenario, relaxation)
    f = compile_program(transcription.penalized(), transcription.elimination_order())
    center, half_width = np.zeros((2, f.num_variables))
    q1 = transcription.prog().FindDecisionVariableIndex(transcription.state(1)[0])
    p1 = transcription.impulse_indices()[1]
    L, w_q, w_p = transcription.length_scale(), 0.7, 1.3
    half_width[[q1, p1]] = w_q, w_p
    pushed = scenario.time_step * relaxation * L**2 / scenario.duration**2
    means = {}
    for phi in (-0.5, 0.0, 0.2, 0.9):
        for p in (-1.0, 0.0, 0.4, 2.0):
            center[[q1, p1]] = phi, p
            means[phi, p] = mean_by_block(f, center, half_width)["contact"]
            closed = (phi**2 + w_q**2 / 3) * (p**2 + w_p**2 / 3) - 2 * pushed * phi * p + pushed**2
            unit = scenario.num_steps * (scenario.duration / L**2) ** 2
            assert means[phi, p] == pytest.approx(closed * unit, rel=1e-12)
    assert relaxation or min(means, key=lambda at: means[at]) == (0.0, 0.0)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_the_first_box_is_as_wide_as_asked_and_holds_no_pull(share: float) -> None:
    transcription = RigidWithForces(shipped_world(), BOUNCE, impulse_width=share)
    center, half_width = transcription.initial_box()
    turned = 4 * transcription.length_scale() / BOUNCE.duration
    where = transcription.impulse_indices()
    np.testing.assert_allclose((center + half_width)[where[1:]], share * turned)
    np.testing.assert_allclose((center - half_width)[where], 0.0, atol=1e-12)
    q, v, _ = transcription.split(center)
    grown, late = (transcription.box_around(q, v, share=0.7), where[5:])
    growth = (np.arange(5, len(where)) / len(where)) ** 2
    np.testing.assert_allclose(np.add(*grown)[late], 0.7 * share * turned * growth, rtol=1e-12)


def read(transcription: RigidTranscription, rung: Rung) -> tuple[int, float]:
    """Returns how many contacts the last box shows, and its largest impulse.

    Annealed slowly, so that what is seen is the transcription's doing.
    """
    problem = BallTask(transcription)
    start = rung.temperature * transcription.cost_scale()
    slowly = Annealing(initial_temperature=start, final_temperature=1e-7 * start)
    result = problem.run_aigo(rung, algorithm=slowly)
    impulses = transcription.impulses(result.box.center)
    return len(problem.find_sequences(result, rung)[0]), float(np.max(impulses))


@pytest.mark.parametrize("row", [1, 4])
def test_plans_collapse_where_those_without_forces_bounce(row: int) -> None:
    world = shipped_world()
    scenario = dataclasses.replace(Scenario.named(f"table1/{row}"), time_step=0.02)
    assert len(rigid_optimum(world, scenario).bounce_times) == 1
    contacts, largest = read(RigidTranscription(world, scenario), HOT)
    assert contacts == 1
    for impulse_width in (0.01, 1.0):
        collapsed = RigidWithForces(world, scenario, impulse_width=impulse_width)
        found, remaining = read(collapsed, HOT)
        assert found == 0
        assert remaining < 0.05 * largest


def test_they_do_not_always_collapse() -> None:
    light = {"dynamics": 30.0, "contact": 30.0, "restitution": 0.02}
    rung = dataclasses.replace(HOT, weights={**HOT.weights, **light})
    assert read(RigidWithForces(shipped_world(), BOUNCE), rung)[0] == 1


def test_a_plan_with_forces_is_polished_like_any_other() -> None:
    search = BallSearch(
        BallTask(RigidWithForces(shipped_world(), BOUNCE), PlanOptions(exhaustive=True))
    )
    found = run_search(search, BOUNCE)
    exact = rigid_optimum(shipped_world(), BOUNCE).cost
    assert found.replay.event_driven.cost == pytest.approx(exact, rel=1e-3)
    # The boxes around the coasting motion start in the bounce; those around the line lose it.
    assert found.stats.box_contacts == (0, 0, 0, 1, 1)


def test_literal_plans_with_forces_keep_the_penalty_of_their_row() -> None:
    ladder = (Rung(1e-4, {"contact": 1e4, "kinematics": 1e3, "dynamics": 1e-2}),)
    options = LiteralOptions(ladder=ladder, knot_steps=())
    search = LiteralSearch(LiteralTask(LiteralWithForces(shipped_world(), BOUNCE), options))
    search.run()
    best = search.find_feasible()[0]
    assert max(best.defects.values()) < 1e-6
    assert {"dynamics", "kinematics"} < set(best.defects)


@pytest.mark.parametrize("transcribe", [RigidWithForces, LiteralWithForces])
@pytest.mark.parametrize("width", [0.0, -1.0, np.inf, np.nan])
def test_widths_that_are_none_are_refused(transcribe: Any, width: float) -> None:
    with pytest.raises(OptionsError, match=r"impulse_width: got .*, expected a number above 0"):
        transcribe(shipped_world(), BOUNCE, impulse_width=width)


def test_weights_of_impulse_rows_need_impulses_as_variables() -> None:
    options = PlanOptions(ladder=(Rung(1.0, {"push": 1.0}),))
    BallTask(RigidWithForces(shipped_world(), BOUNCE), options)
    with pytest.raises(OptionsError, match="got a weight for 'push', expected names of rows: fli"):
        BallTask(RigidTranscription(shipped_world(), BOUNCE), options)


@pytest.mark.parametrize("kind", ["rigid", "rigid, forces"])
def test_what_users_add_is_kept_along_another_path(kind: str) -> None:
    transcription: Any = KINDS[kind](shipped_world(), BOUNCE)
    transcription.impulse_width = 0.3
    (u,) = transcription.input()
    transcription.AddRunningCost(1.0 * u**2, "again")
    other = transcription.again(BOUNCE, np.ones((BOUNCE.num_steps + 1, 1)))
    named = {cost.evaluator().get_description() for cost in other.prog().GetAllCosts()}
    assert "again" in named
    assert type(other) is type(transcription)
    assert getattr(other, "impulse_width", 0.3) == 0.3
