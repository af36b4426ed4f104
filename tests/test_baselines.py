"""Baselines: one interface, one verdict, one clock."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from marks import slow
from pydrake.solvers import MathematicalProgram
from replay_worlds import make_diagram, make_scenario
from rubbing_worlds import accelerate

from benchmarks import friction_peer
from benchmarks.baselines import BASELINES, Recorder, run_baseline
from benchmarks.baselines.gradient import GaussianSmoothing, list_sequences
from benchmarks.baselines.sampling import ControlSpace
from benchmarks.collections.peer_programs import payload, push_circle
from benchmarks.friction_peer import FrictionProgram
from benchmarks.friction_worlds import Run, ask_payload, list_circle, list_payload
from benchmarks.local_peers import casadi
from benchmarks.optima import ContactOptimum, block_optimum, masses_optimum, walls_optimum
from benchmarks.rivals import SAMPLERS, ask_rivals, roll_out, sample
from benchmarks.shooting_ipopt import ShootingProgram
from benchmarks.space import count_held, cover, draw_cube, draw_pose
from drake_aigto import Planner, PlanOptions, Scenario, World, replay_event_driven
from drake_aigto.aigo import Box, minimize
from drake_aigto.arrays import Bools, Floats
from drake_aigto.box import BoxPolynomial
from drake_aigto.contact import calc_pushes, contact_law
from drake_aigto.errors import MissingExtraError, ModelError, OptionsError
from drake_aigto.paper import rigid_optimum
from drake_aigto.planning import Aim, MechanismTask, make_mechanism_task
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock

# Readings of the clock in the longest step of any baseline.
MOST_LATE = 10.0
# Of which a single step takes long.
SLOW = ("snopt", "ipopt", "smoothing", "enumeration")


class FakeClock:
    """Seconds that only pass when they are asked for."""

    def __init__(self, tick: float = 1.0) -> None:
        self.now, self._tick = 0.0, tick

    def __call__(self) -> float:
        self.now += self._tick
        return self.now


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario(initial_position=0.3, initial_velocity=0.5, goal_position=0.8, time_step=0.05)


@pytest.fixture(scope="module")
def bounce() -> Scenario:
    return make_scenario(0.5, -1.5, 0.7, restitution=0.8, time_step=0.05)


def test_an_offer_is_replayed_and_only_what_is_cheaper_is_kept(
    world: World, scenario: Scenario
) -> None:
    recorder = Recorder(world, scenario, 100.0, clock=FakeClock())
    costs = [recorder.offer([0.0, 0.5, 1.0], [[u], [0.0]]) for u in (2.0, 3.0, 0.0)]
    assert costs[2] == pytest.approx(0.0, abs=1e-12) and costs[2] < costs[0] < costs[1]
    run = recorder.finish("hand")
    assert [each.cost for each in run.improvements] == [costs[0], costs[2]]
    assert run.evaluations == 3 and run.cost == costs[2]
    assert run.controls is not None and not run.controls.flags.writeable
    np.testing.assert_array_equal(run.controls, [[0.0], [0.0]])


def test_it_is_over_when_time_is_up_or_the_best_is_good_enough(
    world: World, scenario: Scenario
) -> None:
    recorder = Recorder(world, scenario, 2.5, clock=FakeClock())
    assert [recorder.is_over for _ in range(3)] == [False, False, True]
    patient = Recorder(world, scenario, 1e9, good_enough=1e-7, clock=FakeClock())
    assert not patient.is_over
    patient.offer([0.0, 1.0], [[0.0]])
    assert patient.is_over


@pytest.mark.parametrize("seconds", [0.0, -1.0, np.inf, np.nan])
def test_time_has_to_be_a_positive_number(world: World, scenario: Scenario, seconds: float) -> None:
    with pytest.raises(OptionsError, match=r"seconds: got .*, expected a finite number above 0"):
        Recorder(world, scenario, seconds)


RIGID = [name for name in BASELINES if "literal" not in name]
QUICK = [name for name in RIGID if not name.startswith(SLOW)]


@pytest.mark.parametrize("name", [*QUICK, *slow(*(name for name in RIGID if name not in QUICK))])
def test_every_rigid_baseline_finds_that_nothing_is_to_be_done(
    world: World, scenario: Scenario, name: str
) -> None:
    run = run_baseline(name, world, scenario, 1e6, 2, good_enough=1e-7, clock=FakeClock())
    assert run.method == name and run.cost <= 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "ipopt")) for name in BASELINES]
)
def test_offers_depend_on_the_seed_and_end_soon_after_time_is_up(
    world: World, bounce: Scenario, name: str
) -> None:
    # The clock ticks whenever it is asked, so that both runs end after the same work.
    seconds = 3.5 if name.startswith(SLOW) else 20.5
    one, other = (run_baseline(name, world, bounce, seconds, 3, clock=FakeClock()) for _ in "12")
    assert one.improvements == other.improvements and one.evaluations == other.evaluations > 0
    np.testing.assert_array_equal(one.controls, other.controls)
    # One step may be under way when time is up; its offers ask the clock, too.
    assert one.seconds <= seconds + MOST_LATE
    exact = rigid_optimum(world, bounce).cost
    assert all(each.cost >= (1 - 1e-9) * exact for each in one.improvements)
    if name != "enumeration":
        third = run_baseline(name, world, bounce, seconds, 4, clock=FakeClock())
        assert third.improvements[0].cost != one.improvements[0].cost


def test_lists_hold_every_order_of_contacts_once_for_each_set_of_times() -> None:
    corridor = World.from_scenario(Scenario.named("corridor/lossy"))
    listed = list(list_sequences(corridor, 2.0))
    assert len(listed) == len(set(listed)) and listed[0] == ()
    # Two walls take turns, from either: 2 orders of each of 6 lengths, 3 sets of times.
    assert len(listed) == 1 + 2 * 6 * 3
    for sequence in listed:
        times = [touch.start for touch in sequence]
        assert times == sorted(times) and all(0 < t < 2.0 for t in times)


def test_smoothing_ends_at_the_bottom_of_a_bowl() -> None:
    bowl = TermBlock("bowl", (Term(1.0, (Factor(0, FunctionKind.POWER, 2, 1.0, -3.0),)),), [[0]])
    f = BoxPolynomial(2, (bowl,))
    box = Box(np.array([0.0, 7.0]), np.array([2.0, 0.0]))
    smoothing = GaussianSmoothing(seed=1)
    result = minimize(f, box, smoothing)
    # c = 3 but for the last noise, σ D = 0.02; what is held stays.
    assert result.box.center == pytest.approx([3.0, 7.0], abs=0.1)
    assert result.box.half_width == pytest.approx(smoothing.last * box.half_width)
    again = minimize(f, box, smoothing)
    np.testing.assert_array_equal(again.box.center, result.box.center)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.8, 1.0])
def test_a_space_costs_what_replays_do(world: World, restitution: float) -> None:
    scenario = Scenario(
        initial_position=0.3, initial_velocity=-2.0, goal_position=0.7, restitution=restitution
    )
    space = ControlSpace(Recorder(world, scenario, 1.0))
    # Many press the mass to the wall, or bounce more than once.
    points = np.random.default_rng(2).normal(-0.5, 2, (40, space.dimension))
    replays = [
        replay_event_driven(world, scenario, times, controls)
        for times, controls in zip(*space.decode(points), strict=True)
    ]
    assert max(len(replay.bounce_times) for replay in replays) > 1
    expected = [replay.cost for replay in replays]
    np.testing.assert_allclose(space.costs(points), expected, rtol=1e-9)


def test_a_space_offers_its_best_and_not_what_is_hardly_better(
    world: World, bounce: Scenario
) -> None:
    recorder = Recorder(world, bounce, 1.0)
    space = ControlSpace(recorder)
    points = np.random.default_rng(2).normal(0, 0.3, (40, space.dimension))
    costs = space.costs(points)
    assert recorder.run.evaluations == 1 and recorder.cost == pytest.approx(np.min(costs), rel=1e-9)
    space.costs(points)
    assert recorder.run.evaluations == 1


def test_sampling_refuses_flights_that_are_no_parabolas() -> None:
    world = World.from_diagram(make_diagram(spring=150.0))
    with pytest.raises(ModelError, match=r"the bias h\(q, v\): got .*, expected a constant\. Exac"):
        run_baseline("mppi", world, make_scenario(0.4, 0.0), 1.0)


_STEPS = 199


def test_guesses_that_know_no_friction_close_near_a_plan_that_slides_to_its_goal() -> None:
    """As walls are closed, they end at 7.2 and more."""
    scenario = ask_payload(11)
    problem = MechanismTask(World.from_scenario(scenario), scenario, PlanOptions())
    guesses, rng = problem.guesses, np.random.default_rng(0)
    closed = [problem.close(guesses.draw(start, rng), Aim()) for start in 2 * guesses.starts]
    best = min(closed, key=problem.rank)
    assert best.violation == 0
    assert best.cost < 0.55


def plan_of(times: Any, q: Any, v: Any, controls: Any) -> Any:
    motion = SimpleNamespace(times=times, positions=q, velocities=v, controls=controls)
    scenario = SimpleNamespace(time_step=times[1])
    return SimpleNamespace(best=SimpleNamespace(trajectory=motion), scenario=scenario)


def worst_row(rows: Sequence[Any], prog: MathematicalProgram, x: Floats) -> float:
    worst = 0.0
    for row in rows:
        value = prog.EvalBinding(row, x)
        low, high = row.evaluator().lower_bound(), row.evaluator().upper_bound()
        worst = max(worst, float(np.max(low - value)), float(np.max(value - high)))
    return worst


def test_a_cart_that_carries_its_payload_along_is_listed_as_the_authors_rows_have_it() -> None:
    dt, pull = 0.02, 0.3
    steps = np.arange(_STEPS + 2)
    v = pull * dt * steps
    x = 3.0 + dt * np.cumsum(v)  # Euler's semi-implicit steps, that rows are of.
    nothing = np.zeros_like(x)
    plan = plan_of(
        dt * steps,
        np.column_stack([x, 0.5 + nothing]),
        np.column_stack([v, nothing]),
        np.full((_STEPS + 1, 1), 3 * pull),
    )
    prog = payload(np.array([3.5, 3.0, 0.0, 0.0]), np.zeros(4))
    assert worst_row(prog.GetAllConstraints(), prog, list_payload(plan)) == pytest.approx(
        0.0, abs=1e-12
    )


def test_a_disc_that_is_pushed_along_a_line_is_listed_as_the_authors_rows_have_it() -> None:
    dt, pace, grip = 0.05, 0.3, 0.981
    times, begin = dt * np.arange(121), np.full(2, -1.5 / np.sqrt(2))
    toward = np.array([0.6, 0.8])
    way = (pace * times)[:, np.newaxis] * toward
    plan = plan_of(
        times, np.hstack([begin + way, begin + way + 0.3 * toward]), np.zeros((121, 4)), way[1:]
    )
    with np.errstate(invalid="ignore"):
        prog = push_circle()
    # The authors' disc starts elsewhere, which is the one row that is not met.
    rows = [row for row in prog.GetAllConstraints() if row.variables()[0].get_name() != "q(0,0)"]
    assert worst_row(rows, prog, list_circle(plan)) == pytest.approx(0.0, abs=1e-12)
    pushes = list_circle(plan)[-240:-120]
    assert pushes == pytest.approx(grip * pace * np.ones(120))


def test_a_question_without_a_peer_has_dashes() -> None:
    line = str(Run("cart_pole/dry", 654.0, True, 15.7))
    assert "nan" not in line and line.split().count("-") == 4


def test_a_missing_solver_of_binaries_is_named_with_its_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(friction_peer, "pyscipopt", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'drake_aigto\[bench\]'"):
        friction_peer.solve_modes(Scenario.named("sliding_block/to_rest"), 1.0)


@pytest.mark.slow
@pytest.mark.skipif(friction_peer.pyscipopt is None, reason="SCIP is not installed")
def test_binaries_of_stick_and_slip_lead_to_the_closed_form() -> None:
    scenario = Scenario.named("sliding_block/to_rest")
    found = friction_peer.solve_modes(replace(scenario, time_step=0.25), 30.0)
    # Under a push that is free, ∫ (v̇ + μ g)² is 12/s³ + (μ g)² s for a slide of 1 m in a time s.
    # The best is s = √(6 / μ g); 8 steps cost little more.
    grip = 0.3 * 9.81
    duration = np.sqrt(6 / grip)
    free = 12 / duration**3 + grip**2 * duration
    assert free == pytest.approx(16.489, abs=1e-3)
    assert free < found.bound <= found.cost * (1 + 1e-9) < 1.01 * free


@pytest.mark.skipif(casadi is None, reason="CasADi is not installed")
@pytest.mark.parametrize("name", ["hopper/hop", *slow("spinner/two_radians")])
def test_the_gradient_peer_has_the_worlds_equations(name: str) -> None:
    scenario = Scenario.named(name)
    world, rng = World.from_scenario(scenario), np.random.default_rng(0)
    program, law = FrictionProgram(world, scenario), contact_law(world, scenario)
    sizes = world.num_positions, world.num_positions, world.num_actuators, world.num_positions
    z, exact = [casadi.SX.sym("z", size) for size in sizes], casadi.DM([0.0, 0.0])
    balance = casadi.Function("balance", z, [program.balance(z[0], z[1], z[2], z[3], exact)])
    touched = 0
    for _ in range(300):
        q = scenario.initial_position + rng.uniform(-0.6, 0.6, world.num_positions)
        v = 0.1 * rng.normal(size=world.num_positions)
        u = rng.normal(size=world.num_actuators)
        forces = calc_pushes(world, law, q, v)
        touched += int(forces.any())
        rate = accelerate(world, law, q, v, u)
        off = np.array(balance(q, v, u, rate)).ravel()
        assert np.abs(off).max() <= 1e-9 * (1 + np.abs(forces).max())
    assert touched > 5


# Near its rest, where all methods have one optimum.
SWAYING = replace(
    Scenario.named("acrobot/swing_up"),
    duration=0.5,
    time_step=0.05,
    initial_position=[0.3, -0.2],
    goal_position=[0.0, 0.0],
)


@pytest.mark.slow
@pytest.mark.skipif(casadi is None, reason="CasADi is not installed")
def test_ipopt_has_the_optimum_of_our_shooting() -> None:
    world = World.from_scenario(SWAYING)
    problem = make_mechanism_task(world, SWAYING, PlanOptions()).shooting(SWAYING.num_steps)
    controls = np.full((SWAYING.num_steps, 1), 0.1)
    ours = problem.solve(controls, None)
    promised, control = ShootingProgram(problem).solve(
        problem.simulate(controls, 4).states, controls
    )
    assert promised == pytest.approx(ours.cost, rel=1e-4)
    assert control.values == pytest.approx(ours.controls, abs=1e-2 * np.abs(ours.controls).max())


@pytest.mark.parametrize(
    ("name", "optimum"),
    [
        ("room/two_walls", walls_optimum),
        ("two_masses/handed_on", masses_optimum),
        ("room_with_block/off_the_block", block_optimum),
    ],
)
def test_rivals_of_balls_know_the_optimum(
    name: str, optimum: Callable[[World, Scenario], ContactOptimum]
) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    least = ask_rivals(world, scenario, 0.01, np.inf)
    assert least == pytest.approx(optimum(world, scenario).cost)


@pytest.mark.slow
def test_rivals_find_the_optimum_of_an_easy_task_and_no_less() -> None:
    world = World.from_scenario(SWAYING)
    problem = make_mechanism_task(world, SWAYING, PlanOptions()).shooting(SWAYING.num_steps)
    least = problem.solve(np.zeros((SWAYING.num_steps, 1)), None).cost
    assert ask_rivals(world, SWAYING, 0.3, np.inf) == pytest.approx(least, rel=1e-2)


@pytest.mark.parametrize("method", SAMPLERS)
def test_samplers_find_less_from_generation_to_generation(method: str) -> None:
    far = replace(SWAYING, goal_position=[1.0, -0.5])
    world = World.from_scenario(far)
    problem = make_mechanism_task(world, far, PlanOptions()).shooting(far.num_steps)
    least = problem.solve(np.full((far.num_steps, 1), 0.1), None).cost
    generations = sample(problem, lambda each: roll_out(problem, each), method)
    costs = [next(generations)[0] for _ in range(20)]
    assert least < min(costs) < 1.02 * least < costs[0]
    if method == "predictive sampling":  # The mean is one of the samples.
        assert all(np.diff(costs) <= 0)


GOAL = np.array([0.1, -0.2, 0.7])


def is_in_tee(points: Floats, pose: Floats) -> Bools:
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    x, y = ((points - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])).T
    bar = np.maximum(np.abs(x) / 0.06, np.abs(y - 0.02571) / 0.015) <= 1.0
    stem = np.maximum(np.abs(x) / 0.015, np.abs(y + 0.03429) / 0.045) <= 1.0
    return np.logical_or(bar, stem)


@pytest.mark.parametrize(
    "moved",
    [(0.0, 0.0, 0.0), (0.02, -0.03, 1.0), (0.0, 0.0, np.pi), (-0.01, 0.01, 0.2), (1.0, 0.0, 0.0)],
)
def test_what_a_tee_covers_is_the_share_of_points_in_both(moved: tuple[float, ...]) -> None:
    pose = GOAL + np.array(moved)
    points = GOAL[:2] + np.random.default_rng(0).uniform(-0.1, 0.1, (100_000, 2))
    inside = is_in_tee(points, GOAL)
    share = np.sum(inside & is_in_tee(points, pose)) / np.sum(inside)
    assert cover(pose, GOAL) == pytest.approx(share, abs=0.01)
    assert cover(pose + np.array([0.0, 0.0, 2.0 * np.pi]), GOAL) == pytest.approx(cover(pose, GOAL))


def test_poses_are_drawn_where_diffusion_policy_draws_them() -> None:
    scenarios = [draw_pose(seed) for seed in (0, 14)]
    assert scenarios[0].to_plain() == draw_pose(0).to_plain()
    for drawn in scenarios:
        world = World.from_scenario(drawn)
        scenario = world.place(drawn)
        start, goal = scenario.initial_position, scenario.goal_position
        assert np.all((start[3:] >= 0.05) & (start[3:] <= 0.45))
        assert abs(goal[2] - start[2]) <= np.pi
        edge = start[:2] + 0.04071 * np.array([-np.sin(start[2]), np.cos(start[2])])
        assert np.all((edge >= 0.1) & (edge <= 0.4))
        assert np.min(world.calc_signed_distance(start)) > 0.0


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("three_fingers/lift", 0.05, 0.1),
        ("three_fingers/turn", 0.02975, 0.02975),
        *slow(("three_fingers/flip", 0.05, 0.05)),
    ],
)
def test_cubes_start_on_the_ground_and_have_goals_there_or_in_the_air(
    name: str, low: float, high: float
) -> None:
    for seed in range(2):
        world = World.from_scenario(drawn := draw_cube(name, seed))
        scenario = world.place(drawn)
        start, goal = scenario.initial_position, scenario.goal_position
        assert np.all(np.abs(start[-3:-1]) <= 0.025) and np.all(np.abs(goal[-3:-1]) <= 0.1)
        assert np.min(world.calc_signed_distance(start)) > -0.0003  # By its weight.
        assert low <= goal[-1] <= high and start[-5:-3] == pytest.approx([0.0, start[-4]])
        assert drawn.to_plain() == draw_cube(name, seed).to_plain()


def test_a_cube_is_held_where_it_is_near_its_goal_until_the_end() -> None:
    goal = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.1])
    there = np.tile(goal, (30, 1))
    assert count_held(there, goal) == 30
    there[12, -1] = 0.125
    assert count_held(there, goal) == 17
    there[20, :4] = -np.cos(0.15), np.sin(0.15), 0.0, 0.0  # 1 - (q q*)² is 0.022.
    assert count_held(there, goal) == 17
    there[20, :4] = np.cos(0.21), np.sin(0.21), 0.0, 0.0  # 0.043
    assert count_held(there, goal) == 9


@pytest.mark.slow  # 15 to 60 CPU s: which motions a search finds depends on a machine's rounding.
def test_pushes_whose_errors_grow_a_hundred_thousand_times_are_held_by_feedback() -> None:
    plan = Planner(draw_pose(9), PlanOptions(renewals=16)).plan()
    assert plan.holds and plan.reached
    unstable = [each for each in plan.candidates if each.gains and each.growth]
    if not unstable:
        pytest.skip("this machine's rounding leads to stable motions alone")
    assert all(each.growth is not None and each.growth.factor > 1e5 for each in unstable)
    excess = [max(off.cost for off in each.perturbed) / each.cost for each in unstable]
    # Gains that know of contact from 1e-3 of the length on: 98 for the best one, 1.8 at least.
    assert min(excess) < 1.5


@pytest.mark.slow  # 30 CPU s.
def test_a_throw_whose_errors_grow_a_hundred_thousand_times_is_held_by_feedback() -> None:
    options = PlanOptions(starts=4, renewals=0, finalists=1, confirm=False)
    plan = Planner(Scenario.named("throwing_arm/into_the_box"), options).plan()
    assert plan.holds and plan.reached and plan.best.gains
    growth = plan.best.growth
    assert growth is not None and growth.factor > 1e5  # A start 1e-3 off ends 100 lengths off.
    assert len(plan.best.perturbed) == 2
    assert max(off.cost for off in plan.best.perturbed) < 1.5 * plan.cost
