"""The judge of the robots' benchmark is right, and so are the best costs that it knows."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from scenario_studies import Inline
from scipy.integrate import solve_ivp

from benchmarks.local_peers import casadi
from benchmarks.robots.cart_pole import (
    DEEPEST,
    DURATION,
    SPOT_STARTS,
    WALLS,
    Question,
    judge,
    make_questions,
    tip_of,
)
from benchmarks.robots.compare import run_comparison, run_method
from benchmarks.robots.known import Known, load_known
from benchmarks.robots.methods import IPOPT_STEPS, NUM_STEPS, ipopt_multistart, shooting_multistart
from benchmarks.robots.results import Comparison, Outcome, Results, Row, Step
from benchmarks.robots.table import format_results
from drake_aigto.errors import OptionsError
from drake_aigto.simulation import replay_drake, replay_event_driven
from drake_aigto.world import Scenario, World

NEAR = "cart_pole/soft_06"


def integrate(question: Question, controls: np.ndarray) -> float:
    """Returns J by SciPy, from the mass matrix."""
    mass, tip, length, gravity, stiffness = 1.0, 0.1, 0.8, 9.8, 200.0

    def slope(t: float, x: np.ndarray, u: float) -> np.ndarray:
        a, v, th, w, _ = x
        p = a + length * np.sin(th)
        f = stiffness * (max(0.0, -question.wall - p) - max(0.0, p - question.wall))
        coupling = tip * length * np.cos(th)
        inertia = [[mass + tip, coupling], [coupling, tip * length**2]]
        force = [
            u + f + tip * length * np.sin(th) * w**2,
            length * np.cos(th) * f - tip * gravity * length * np.sin(th),
        ]
        dv, dw = np.linalg.solve(inertia, force)
        running = 20 * a**2 + 40 * (1 + np.cos(th)) + 0.05 * w**2 + 0.05 * u**2
        return np.array([v, dv, w, dw, running])

    x = np.append(question.start, 0.0)
    for u in controls:
        span = (0.0, DURATION / controls.size)
        x = solve_ivp(slope, span, x, "DOP853", args=(u,), rtol=1e-9, atol=1e-9).y[:, -1]
    return float(x[4] + 10 * x[0] ** 2 + 20 * (1 + np.cos(x[2])) + 0.025 * x[3] ** 2)


@pytest.mark.parametrize("scenario", WALLS)
def test_the_judge_agrees_with_another_integration_of_the_mass_matrix(scenario: str) -> None:
    question = make_questions(scenario)[12]
    controls = 12.0 * np.sin(np.linspace(0.0, 9.0, 30))
    assert judge(question, controls).cost == pytest.approx(integrate(question, controls), rel=1e-6)


def test_the_judge_agrees_with_replays_and_with_drake() -> None:
    question = make_questions(NEAR)[12]  # Three touches: unstable.
    controls = np.array(load_known()[NEAR][12].controls)
    cost = judge(question, controls).cost
    start = np.array(question.start)
    scenario = dataclasses.replace(
        Scenario.named(NEAR), initial_position=start[[0, 2]], initial_velocity=start[[1, 3]]
    )
    given = World.from_scenario(scenario), scenario, np.linspace(0.0, DURATION, controls.size + 1)
    for replay in (replay_event_driven, replay_drake):
        assert replay(*given, controls[:, None]).cost == pytest.approx(cost, rel=1e-5)


def test_the_judge_clips_forces_and_refuses_a_cart_that_leaves_its_range() -> None:
    question = make_questions(NEAR)[6]
    most = judge(question, np.full(10, 20.0))
    assert judge(question, np.full(10, 90.0)) == most
    assert most.excess > 0.5
    assert math.isinf(most.score)


@pytest.mark.parametrize("scenario", WALLS)
def test_random_starts_are_not_deep_and_the_first_ten_are_spots(scenario: str) -> None:
    questions = make_questions(scenario, 40)
    assert np.array_equal([question.start for question in questions[:10]], SPOT_STARTS)
    assert not any(question.is_deep for question in questions[10:])
    deepest = max(tip_of(np.array(question.start)) for question in questions[10:])
    assert WALLS[scenario] < deepest <= WALLS[scenario] + DEEPEST
    assert questions[:12] == make_questions(scenario, 12)


def test_best_known_costs_are_those_of_their_controls() -> None:
    for scenario, row in load_known().items():
        questions = make_questions(scenario)
        for number in list(row)[:: max(1, len(row) // 5)]:
            score = judge(questions[number], np.array(row[number].controls)).score
            assert score == pytest.approx(row[number].cost, rel=1e-9), (scenario, number)


def test_what_is_known_is_replaced_by_what_is_better_alone() -> None:
    question = make_questions(NEAR)[6]
    known = Known().offered(question, "nothing", np.zeros(4))
    worse = known.offered(question, "too far", np.full(4, 20.0))
    better = Known(cost=1e9, found_by="a guess").offered(question, "nothing", np.zeros(4))
    assert (worse, better) == (known, known)


def test_what_random_shooting_promises_is_what_the_judge_finds() -> None:
    question = make_questions(NEAR)[20]
    attempt = next(shooting_multistart(question))
    assert attempt.controls.shape == (NUM_STEPS,)
    assert judge(question, attempt.controls).score == pytest.approx(attempt.promised, rel=1e-4)


@pytest.mark.skipif(casadi is None, reason="CasADi is not installed")
def test_what_the_gradient_peer_promises_is_nearly_what_the_judge_finds() -> None:
    question = make_questions(NEAR)[20]
    attempt = next(each for each in ipopt_multistart(question) if math.isfinite(each.promised))
    assert attempt.controls.shape == (2 * IPOPT_STEPS,)
    assert judge(question, attempt.controls).score == pytest.approx(attempt.promised, rel=5e-3)


def row(cost: float, known: float) -> Row:
    outcome = Outcome("shooting", (Step(0.1, math.inf), Step(0.5, cost)), 1.0, 2.0, 7, cost)
    return Row(NEAR, round(10 * cost), False, known, (outcome,))


def test_the_table_counts_what_is_near_the_best_known_and_below_it() -> None:
    rows = (row(10.0, 10.0), row(10.3, 10.0), row(9.0, 10.0), row(20.0, 10.0))
    comparison = Comparison((NEAR,), 4, ("shooting",), 1.0)
    line = format_results(Results(comparison, rows)).splitlines()[-1]
    assert " ".join(line.split()).startswith("shooting 50 % 75 % 25 % 1.00 1.00 2.00 2.00 0.50 ")


def test_a_plan_is_judged_to_cost_what_it_promises_and_drake_agrees() -> None:
    outcome = run_method("plan", make_questions(NEAR)[20], math.inf).outcome
    assert outcome.attempts == 1
    assert outcome.cost == pytest.approx(outcome.promised, rel=1e-4)
    assert outcome.drake == pytest.approx(outcome.cost, rel=1e-4)


def test_bad_comparisons_are_refused_by_name() -> None:
    with pytest.raises(OptionsError, match="methods: got guessing"):
        Comparison(methods=("guessing",))
    with pytest.raises(OptionsError, match="seconds: got none"):
        Comparison(methods=("shooting",))


@pytest.mark.skipif(casadi is None, reason="CasADi is not installed")
def test_a_comparison_goes_on_from_its_file(tmp_path: Path) -> None:
    comparison = Comparison((NEAR,), 2, ("IPOPT",), 0.01)
    whole = run_comparison(comparison, executor=Inline())
    path = tmp_path / "robots.json"
    Results(comparison, whole.rows[1:]).save(path)
    resumed = run_comparison(comparison, path, resume=True, executor=Inline())
    assert resumed.rows[1] == whole.rows[1]  # To the last digit of its seconds.
    assert resumed.rows[0].outcomes[0].promised == whole.rows[0].outcomes[0].promised
    assert Results.load(path) == resumed
