"""The judge of the robots' benchmark is right, and so are the best costs that it knows."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.local_peers import casadi
from benchmarks.robots.compare import Comparison, Outcome, RobotStudy, Row, Step, run_method
from benchmarks.robots.ipopt import IPOPT_STEPS
from benchmarks.robots.judge import Control, judge
from benchmarks.robots.known import Known, load_known
from benchmarks.robots.mechanics import find_gaps
from benchmarks.robots.methods import (
    bounces,
    ipopt_multistart,
    listed_sequences,
    random_control,
    shooting_multistart,
    snopt_multistart,
)
from benchmarks.robots.shooting import world_of
from benchmarks.robots.table import find_figures, format_results
from benchmarks.robots.worlds import (
    DEEPEST,
    SPOT_STARTS,
    WORLDS,
    Question,
    make_questions,
    scenario_of,
    setting_of,
)
from drake_aigto.errors import OptionsError
from drake_aigto.simulation import replay_drake, replay_event_driven

# Kernels that only the benchmark has take twenty seconds to compile.
pytestmark = pytest.mark.slow

NEAR, DURATION = "cart_pole/soft_06", 1.5
SOFT = (NEAR, "cart_pole/soft_10")
PENDULUM, SWING_UP = "pendulum/off_the_wall", "acrobot/swing_up"


def push(question: Question, values: np.ndarray) -> Control:
    return Control.even(np.reshape(values, (len(values), -1)), scenario_of(question).duration)


def integrate(question: Question, wall: float, controls: np.ndarray) -> float:
    """Returns J of the cart-pole by SciPy, from the mass matrix."""
    mass, tip, length, gravity, stiffness = 1.0, 0.1, 0.8, 9.8, 200.0

    def slope(t: float, x: np.ndarray, u: float) -> np.ndarray:
        a, v, th, w, _ = x
        p = a + length * np.sin(th)
        f = stiffness * (max(0.0, -wall - p) - max(0.0, p - wall))
        coupling = tip * length * np.cos(th)
        inertia = [[mass + tip, coupling], [coupling, tip * length**2]]
        force = [
            u + f + tip * length * np.sin(th) * w**2,
            length * np.cos(th) * f - tip * gravity * length * np.sin(th),
        ]
        dv, dw = np.linalg.solve(inertia, force)
        running = 20 * a**2 + 40 * (1 + np.cos(th)) + 0.05 * w**2 + 0.05 * u**2
        return np.array([v, dv, w, dw, running])

    a, th, v, w = setting_of(question).start
    x = np.array([a, v, th, w, 0.0])
    for u in controls:
        span = (0.0, DURATION / controls.size)
        x = solve_ivp(slope, span, x, "DOP853", args=(u,), rtol=1e-9, atol=1e-9).y[:, -1]
    return float(x[4] + 10 * x[0] ** 2 + 20 * (1 + np.cos(x[2])) + 0.025 * x[3] ** 2)


@pytest.mark.parametrize("wall", [0.6, 1.0])
def test_the_judge_agrees_with_another_integration_of_the_mass_matrix(wall: float) -> None:
    question = Question(f"cart_pole/soft_{10 * wall:02.0f}", 12)
    controls = 12.0 * np.sin(np.linspace(0.0, 9.0, 30))
    cost = judge(question, push(question, controls)).cost
    assert cost == pytest.approx(integrate(question, wall, controls), rel=1e-6)


@pytest.mark.parametrize("world", WORLDS)
def test_the_judge_agrees_with_the_event_driven_replay(world: str) -> None:
    question, rng = Question(world, 1, is_tuning=True), np.random.default_rng(4)
    control = push(question, random_control(question, rng, np.linspace(0.0, 1.0, 40)))
    replay = replay_event_driven(world_of(world), scenario_of(question), *control)
    assert judge(question, control).cost == pytest.approx(replay.cost, rel=1e-5)


def test_the_judge_lets_carts_push_each_other_and_part_again() -> None:
    question = Question("three_carts/apart", 1)
    control = push(question, np.repeat([10.0, -9.0], [7, 13]))
    judgment = judge(question, control)
    replay = replay_event_driven(world_of(question.world), scenario_of(question), *control)
    assert judgment.touches == len(replay.bounce_times) == 2
    assert judgment.cost == pytest.approx(replay.cost, rel=1e-8)


def test_the_judge_sees_a_bounce_that_is_shorter_than_its_steps() -> None:
    """The weakest torque that touches the wall at all is the same for the replay."""
    question = Question(PENDULUM, 2, is_tuning=True)

    def push_with(torque: float) -> Control:
        return push(question, np.full((1, 1), torque))

    misses, touches = 8.0, -8.0
    for _ in range(27):
        middle = (misses + touches) / 2
        is_touched = judge(question, push_with(middle)).touches > 0
        misses, touches = (misses, middle) if is_touched else (middle, touches)
    for torque, is_touched in (misses, False), (touches, True):
        control = push_with(torque)
        replay = replay_event_driven(world_of(question.world), scenario_of(question), *control)
        assert (len(replay.bounce_times) > 0) == is_touched


def test_the_judge_agrees_with_drake() -> None:
    question = Question(NEAR, 12)  # Three touches: unstable.
    control = load_known()[NEAR][12].control(question)
    replay = replay_drake(world_of(NEAR), scenario_of(question), *control)
    assert replay.cost == pytest.approx(judge(question, control).cost, rel=1e-5)


def test_the_judge_clips_forces_and_refuses_a_cart_that_leaves_its_range() -> None:
    question = Question(NEAR, 6)
    most = judge(question, push(question, np.full(10, 20.0)))
    assert judge(question, push(question, np.full(10, 90.0))) == most
    assert most.excess > 0.5
    assert math.isinf(most.score)


def test_a_control_that_ends_early_or_late_costs_the_whole_duration() -> None:
    question = Question(NEAR, 6)
    held = push(question, np.ones(10))
    for end in (1.4, 1.6):
        off = held._replace(times=np.append(held.times[:-1], end))
        assert judge(question, off) == judge(question, held)


def test_a_throw_that_misses_its_goal_is_no_solution() -> None:
    question = Question("throwing_ball/bounces", 0)
    judgment = judge(question, push(question, np.zeros((10, 2))))
    assert judgment.excess == pytest.approx(4.0)
    assert math.isinf(judgment.score)


@pytest.mark.parametrize("world", SOFT)
def test_random_starts_are_not_deep_and_the_first_ten_are_spots(world: str) -> None:
    questions = make_questions(world, 40)
    starts = [setting_of(question).start[[0, 2, 1, 3]] for question in questions[:10]]
    assert np.array_equal(starts, SPOT_STARTS)
    assert not any(question.is_deep for question in questions[10:])
    mechanism = WORLDS[world].mechanism
    gaps = [find_gaps(mechanism, setting_of(each).start).min() for each in questions[10:]]
    assert -DEEPEST <= min(gaps) < 0


@pytest.mark.parametrize("world", [name for name in WORLDS if name not in SOFT])
def test_nothing_starts_in_a_rigid_wall_and_no_tuning_start_is_reported(world: str) -> None:
    reported, tuning = (make_questions(world, 12, is_tuning) for is_tuning in (False, True))
    starts = [setting_of(each).start for each in reported]
    gaps = [find_gaps(WORLDS[world].mechanism, start) for start in starts]
    assert np.min(gaps, initial=0.0) == 0.0
    assert not any(np.array_equal(setting_of(each).start, starts) for each in tuning)
    assert len({start.tobytes() for start in starts}) == 12


def test_best_known_costs_are_those_of_their_controls() -> None:
    for section, row in load_known().items():
        world, _, is_tuning = section.partition(", ")
        for number in list(row)[:: max(1, len(row) // 5)]:
            question = Question(world, number, bool(is_tuning))
            score = judge(question, row[number].control(question)).score
            assert score == pytest.approx(row[number].cost, rel=1e-9), question


def test_what_is_known_is_replaced_by_what_is_better_alone() -> None:
    question = Question(NEAR, 6)
    nothing = push(question, np.zeros(4))
    known = Known().offered(question, "nothing", nothing)
    worse = known.offered(question, "too far", push(question, np.full(4, 20.0)))
    better = Known(cost=1e9, found_by="a guess").offered(question, "nothing", nothing)
    assert (worse, better) == (known, known)


@pytest.mark.parametrize("world", [NEAR, SWING_UP])
def test_what_random_shooting_promises_is_what_the_judge_finds(world: str) -> None:
    question = Question(world, 20)
    attempt = next(shooting_multistart(question))
    assert len(attempt.control.values) == scenario_of(question).num_steps
    assert judge(question, attempt.control).score == pytest.approx(attempt.promised, rel=1e-4)


def test_what_listed_touches_promise_is_what_the_judge_finds() -> None:
    question = Question(PENDULUM, 1)
    best = min(itertools.islice(listed_sequences(question), 8), key=lambda each: each.promised)
    assert judge(question, best.control).score == pytest.approx(best.promised, rel=1e-3)


# Another search found these optima: Pontryagin's principle leaves u(0) and u̇(0), gridded, polished.
@pytest.mark.parametrize(
    ("number", "by_principle"), [(12, 0.0020460108962915436), (3, 0.1904961066732006)]
)
def test_the_search_over_bounce_times_finds_known_optima(number: int, by_principle: float) -> None:
    question = Question(PENDULUM, number)
    *_, by_times = bounces(question)
    assert by_times.promised == pytest.approx(by_principle, rel=2e-3)
    assert judge(question, by_times.control).score == pytest.approx(by_times.promised, rel=2e-3)


def test_the_search_over_bounce_times_finds_optima_that_graze_the_wall() -> None:
    question = Question(PENDULUM, 6)
    *_, grazing = bounces(question)
    judgment = judge(question, grazing.control)
    assert judgment.touches == 0
    free = Control.even(np.zeros((1, 1)), scenario_of(question).duration)
    assert judge(question, free).touches > 0  # Else it would not have to keep off.
    listed = min(each.promised for each in itertools.islice(listed_sequences(question), 12))
    assert judgment.score < listed


@pytest.mark.skipif(casadi is None, reason="CasADi is not installed")
@pytest.mark.parametrize("world", [NEAR, SWING_UP])
def test_what_the_gradient_peer_promises_is_nearly_what_the_judge_finds(world: str) -> None:
    question = Question(world, 20)
    attempt = next(each for each in ipopt_multistart(question) if math.isfinite(each.promised))
    assert attempt.control.values.shape == (2 * IPOPT_STEPS, 1)
    assert judge(question, attempt.control).score == pytest.approx(attempt.promised, rel=5e-3)


@pytest.mark.skipif(casadi is None, reason="CasADi is not installed")
@pytest.mark.parametrize("question", [Question(PENDULUM, 41), Question("paddle/bat", 0)])
def test_what_the_gradient_peer_promises_between_rigid_walls_is_what_the_judge_finds(
    question: Question,
) -> None:
    attempt = next(each for each in ipopt_multistart(question) if math.isfinite(each.promised))
    judgment = judge(question, attempt.control)
    assert judgment.touches > 0
    assert judgment.score == pytest.approx(attempt.promised, rel=2e-3)


@pytest.mark.parametrize("world", [NEAR, SWING_UP])
def test_what_snopt_promises_on_our_transcription_is_nearly_what_the_judge_finds(
    world: str,
) -> None:
    question = Question(world, 20)
    attempt = next(each for each in snopt_multistart(question) if math.isfinite(each.promised))
    assert len(attempt.control.values) == scenario_of(question).num_steps
    assert judge(question, attempt.control).score == pytest.approx(attempt.promised, rel=2e-3)


def row(cost: float, known: float, method: str = "shooting") -> Row:
    outcome = Outcome(method, (Step(0.1, math.inf), Step(0.5, cost)), 1.0, 2.0, 7, cost, cost)
    return Row(NEAR, round(10 * cost), False, known, (outcome,))


def test_the_table_counts_what_is_near_the_best_known_and_below_it() -> None:
    rows = (row(10.0, 10.0), row(10.3, 10.0), row(9.0, 10.0), row(20.0, 10.0))
    comparison = Comparison((NEAR,), 4, ("shooting",), 1.0)
    line = format_results(RobotStudy(comparison, rows)).splitlines()[-1]
    assert " ".join(line.split()).startswith(
        "shooting 50.0 % 75.0 % 25.0 % 1.00 1.00 2.00 2.00 0.50 "
    )


def test_figures_are_of_plans_that_are_off_the_best_known() -> None:
    rows = (row(10.0, 10.0, "plan"), row(10.3, 10.0, "plan"))
    figures = list(find_figures(RobotStudy(Comparison((NEAR,), 2, ("plan",)), rows)))
    assert [(value, most) for _, value, most in figures] == [(0.5, 0.05), (1.0, 1.0), (0.0, 0.01)]


def test_a_plan_is_judged_to_cost_what_it_promises_and_drake_agrees() -> None:
    outcome = run_method("plan", Question(NEAR, 20), math.inf).outcome
    assert outcome.attempts == 1
    assert outcome.cost == pytest.approx(outcome.promised, rel=1e-4)
    assert outcome.drake == pytest.approx(outcome.cost, rel=1e-4)


def test_bad_comparisons_are_refused_by_name() -> None:
    with pytest.raises(OptionsError, match="methods: got guessing"):
        Comparison(methods=("guessing",))
    with pytest.raises(OptionsError, match="seconds: got none"):
        Comparison(methods=("shooting",))
