"""Whole plans in worlds of several contacts, against their optima; the steps that lead there."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from phase_solutions import free_flight_cost
from pydrake.solvers import MathematicalProgram
from replay_worlds import make_diagram, make_scenario, shipped_world

from benchmarks import certificates
from benchmarks.optima import line_optimum as optima
from benchmarks.optima import masses_optimum, walls_optimum
from benchmarks.study import ScenarioQuestion
from benchmarks.worlds import WORLDS, load_unequal
from drake_aigto import PlanOptions, Scenario, World, plan, scenario_names
from drake_aigto.certify import Line, PlanBound, Wall, bound_line, bound_plans, fold, out_of_reach
from drake_aigto.errors import OptionsError, ScenarioError, TrajectoryError
from drake_aigto.paper import (
    LITERAL_LADDER,
    AlgorithmName,
    LiteralOptions,
    LiteralTask,
    LiteralTranscription,
    plan_literal,
    rigid_optimum,
)
from drake_aigto.planning import (
    BallSearch,
    LocalSolverName,
    Origin,
    PhaseProblem,
    Plan,
    Planner,
    PlanningError,
    ProgramSolution,
    SearchOptions,
    find_grazes,
    find_other_sides,
    make_ball_task,
)
from drake_aigto.show import format_plan
from drake_aigto.simulation import find_contacts, replay_event_driven
from drake_aigto.terms import TermBlock, parse_costs
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import OpenProgram, RigidTranscription, Touch

QUICK = PlanOptions(confirm=False)
NEW = [name for name in scenario_names() if name.partition("/")[0] in WORLDS]
FIRST = ("corridor/lossy", "two_masses/apart")


def ask_masses(
    position: list[float], velocity: list[float], goal: list[float], **fields: Any
) -> Scenario:
    return Scenario(
        model="package://drake_aigto_models/two_masses.sdf",
        initial_position=position,
        initial_velocity=velocity,
        goal_position=goal,
        duration=1.5,
        time_step=0.03,
        **fields,
    )


MEETING = ask_masses(
    [0.55107892, 0.69078449], [0.89713715, 0.45929500], [0.18767313, 0.46760809], restitution=0.8
)


@cache
def world_of(model: str) -> World:
    (scenario,) = WORLDS[model].draw(1, seed=0)
    return World.from_scenario(scenario)


@pytest.mark.parametrize("name", [*FIRST, *slow(*(name for name in NEW if name not in FIRST))])
def test_shipped_scenarios_have_plans_that_drake_confirms(name: str) -> None:
    scenario = Scenario.named(name)
    found = plan(scenario)
    assert found.holds
    replay = found.replay.event_driven
    assert replay.max_penetration < 1e-9
    assert replay.energy_ratio is None or replay.energy_ratio < 1 + 1e-9
    planned = [contact.index for contact in found.best.contacts]
    assert len(planned) == len(replay.bounce_contacts)
    assert sorted(planned) == sorted(replay.bounce_contacts)
    # The search does not follow chatter, touch after touch.
    for candidate in found.candidates:
        touches = [(c.index, c.time) for c in candidate.contacts]
        for contact, time in touches:
            at_once = [t for i, t in touches if i == contact and 0 <= t - time < 0.02]
            assert len(at_once) <= 3


@pytest.mark.parametrize("model", ["corridor", *slow("floor", "room")])
def test_plans_are_optimal(model: str) -> None:
    world = world_of(model)
    for scenario in WORLDS[model].draw(2, seed=40):
        found = plan(scenario, QUICK, world)
        optimum = walls_optimum(world, scenario)
        assert found.replay.event_driven.cost <= 1.01 * optimum.cost + 1e-7
        assert found.cost >= (1 - 1e-6) * optimum.cost - 1e-9


def test_a_fast_ball_bounces_as_often_as_by_itself() -> None:
    times, shipped = 3, Scenario.named("corridor/six_bounces")
    T = shipped.duration * times
    scenario = dataclasses.replace(shipped, duration=T, time_step=shipped.time_step * times)
    world = World.from_scenario(scenario)
    found = plan(scenario, QUICK, world)
    # Elastic walls reflect what control adds: of a free flight, d short of the goal in the end,
    # least w d² + 3 R m² (d₀ − d)²/T³.
    idle = replay_event_driven(world, scenario, [0.0, T], [[0.0]])
    d, m = idle.goal_error, world.calc_mass_matrix(scenario.initial_position)[0, 0]
    w, R = scenario.goal_weight, scenario.control_weight
    assert len(found.best.contacts) == 6 * times
    assert found.cost == pytest.approx(d**2 / (1 / w + T**3 / (3 * R * m**2)), rel=1e-4)


@pytest.mark.slow
def test_contacts_of_unequal_masses_that_nothing_but_the_motion_without_control_has_are_found() -> (
    None
):
    scenario = ask_masses(
        [0.19434618, 0.55799003], [0.18030109, -0.89792862], [0.62395172, 0.74167857]
    )
    world = load_unequal(scenario, 5.0)
    found = plan(scenario, QUICK, world)
    # By `masses_optimum` with up to four meetings; doing nothing costs 154 times as much.
    assert found.replay.event_driven.cost == pytest.approx(5.6154e-06, rel=1e-2)


@pytest.mark.slow
def test_masses_that_meet_in_front_of_a_wall_may_hit_it_first() -> None:
    scenario = ask_masses([0.13597, 0.788208], [1.224014, 0.220224], [0.262026, 0.80505])
    found = plan(scenario, QUICK, load_unequal(scenario, 3.0))
    # Wall, mass, wall; mass, wall, mass cost 12 % more, all three at one moment.
    assert [each.index for each in found.best.contacts] == [2, 1, 2]
    assert found.cost == pytest.approx(2.639e-4, rel=1e-3)


def test_long_polishes_are_left_out_where_shorter_ones_lead_to_plans() -> None:
    found = plan(MEETING, QUICK, load_unequal(MEETING, 1.5))
    # With the long ones, which took seven times as long, its neighbors were never tried: 7.886e-4.
    assert [each.index for each in found.best.contacts] == [2, 1, 2]
    assert found.cost == pytest.approx(4.905e-4, rel=1e-3)


def test_a_search_without_a_plan_repeats_long_polishes_and_an_exhaustive_one_leaves_none_out() -> (
    None
):
    world = load_unequal(MEETING, 1.5)
    task = make_ball_task(world, MEETING, QUICK)
    ends = np.array([0.0, MEETING.duration]), np.array([[0.55, 0.69], [0.19, 0.47]])
    touches = tuple(Touch.bounce(time, 0) for time in (0.3, 0.6, 0.9))
    with pytest.raises(TrajectoryError, match="no motion in 60 steps"):
        task.in_turn().polish_along(ends, touches)
    patient = task.in_turn().patient
    assert patient is not None
    assert patient.polish_along(ends, touches).cost == task.polish_along(ends, touches).cost
    thorough = make_ball_task(world, MEETING, EXHAUSTIVE)
    assert thorough.in_turn() is thorough


@pytest.mark.slow
def test_a_block_that_the_motion_without_control_bounces_off_may_be_passed() -> None:
    scenario = next(islice(WORLDS["room_with_block"].draw(16, seed=0), 15, None))
    coarse = dataclasses.replace(scenario, time_step=0.03)
    found = plan(coarse, QUICK, world_of("room_with_block"))
    # By `block_optimum`: one wall, instead of that wall and a face of the block.
    assert found.replay.event_driven.cost == pytest.approx(9.06e-5, rel=0.02)


@pytest.mark.slow
def test_a_block_is_passed_where_the_straight_way_goes_through_its_middle() -> None:
    shipped = Scenario.named("room_with_block/around")
    scenario = dataclasses.replace(shipped, mass=7.5, restitution=0.4)
    assert (
        scenario.initial_position[1] == scenario.goal_position[1] == 0.5
    )  # As the block's middle.
    found = plan(scenario, QUICK)
    assert not found.best.contacts and not found.best.is_idle
    assert found.cost < 0.0374  # By cross-entropy; 0.107 where no flight had a side to pass on.


def test_a_block_is_passed_on_the_side_that_costs_less() -> None:
    shipped = Scenario.named("room_with_block/around")
    scenario = dataclasses.replace(
        shipped, initial_velocity=[0.3, 0.4], goal_position=[0.84, 0.43], restitution=0.86
    )
    world = World.from_scenario(scenario)
    problem = make_ball_task(world, scenario, QUICK)
    low = problem.polish(problem.box.center, ())
    (path,) = find_other_sides(low)
    high = problem.polish_along(path, ())
    front, back = (
        {world.contacts[facing.contact].name for facing in motion.facings} for motion in (low, high)
    )
    assert front ^ back == {"ball against block, -y face", "ball against block, +y face"}
    (returned,) = find_other_sides(high)
    assert problem.polish_along(returned, ()).cost == pytest.approx(low.cost, rel=0.01)
    assert plan(scenario, QUICK).cost <= 1.01 * high.cost < 0.5 * low.cost


def search_of(name: str, **changes: float) -> BallSearch:
    scenario = dataclasses.replace(Scenario.named(name), **changes)  # type: ignore[arg-type]
    problem = make_ball_task(World.from_scenario(scenario), scenario, QUICK)
    return BallSearch(problem)


def test_touches_that_no_motion_has_are_refused_once_and_stop_nothing() -> None:
    search = search_of("corridor/three_bounces")
    center = search.task.box.center
    at_once = (Touch.bounce(0.5, 0), Touch.bounce(0.5, 1))
    search.add(Origin("by hand"), center, at_once)
    assert not search.by_sequence
    assert search.is_known(at_once)
    search.add(Origin("by hand"), center, (Touch.bounce(0.5, 1),))
    assert search.by_sequence


def test_a_touch_too_many_is_dropped() -> None:
    scenario = Scenario.named("corridor/three_bounces")
    optimum = walls_optimum(World.from_scenario(scenario), scenario)
    search = search_of("corridor/three_bounces")
    times = np.linspace(0, scenario.duration, len(optimum.contacts) + 3)[1:-1]
    more = (*optimum.contacts, 1 - optimum.contacts[-1])
    search.add(Origin("by hand"), search.task.box.center, tuple(map(Touch.bounce, times, more)))
    for wave in search.vary():
        search.close(wave)
    best = search.ranked()[0]
    assert [contact.index for contact in best.contacts] == list(optimum.contacts)
    assert best.replay.cost <= 1.01 * optimum.cost + 1e-7
    assert {change.kind for change in best.origin.changes} == {"dropped"}
    assert len(best.origin.changes[0].of) == len(more)
    assert str(best.origin) == "by hand; a touch dropped"


def test_bounces_in_the_wrong_order_change_places() -> None:
    scenario = Scenario.named("room/two_walls")
    optimum = walls_optimum(World.from_scenario(scenario), scenario)
    touches = [Touch.bounce(touch.start, touch.contact) for touch in optimum.touches]
    J = World.from_scenario(scenario).calc_contact_jacobian(np.full(2, 0.5))
    place = next(
        k
        for k, (one, other) in enumerate(pairwise(touches))
        if J[one.contact] @ J[other.contact] == 0
    )
    first, second = touches[place : place + 2]
    touches[place : place + 2] = [
        Touch.bounce(first.start, second.contact),
        Touch.bounce(second.start, first.contact),
    ]
    search = search_of("room/two_walls")
    search.add(Origin("by hand"), search.task.box.center, tuple(touches))
    best = search.ranked()[0]
    assert [contact.index for contact in best.contacts] == list(optimum.contacts)
    assert best.replay.cost <= 1.01 * optimum.cost + 1e-7


def test_a_guess_falls_from_stop_to_stop_as_gravity_has_it() -> None:
    scenario = Scenario.named("floor/rebound")
    world = World.from_scenario(scenario)
    phases = PhaseProblem(world, scenario, [Touch.bounce(0.4 * scenario.duration)])
    guess = phases.guess()
    t, q, v = guess.times, guess.positions[:, 0], guess.velocities[:, 0]
    g = -float(world.calc_acceleration(np.zeros(1), np.zeros(1), np.zeros(1))[0])
    knot = int(np.argmin(np.abs(t - 0.4 * scenario.duration)))
    assert q[0] == scenario.initial_position[0]
    assert q[knot] == pytest.approx(0.0, abs=1e-12)
    assert q[-1] == pytest.approx(scenario.goal_position[0])
    for part in (slice(0, knot + 1), slice(knot, None)):
        s = t[part] - t[part][0]
        launch = (q[part][-1] - q[part][0]) / s[-1] + g * s[-1] / 2
        np.testing.assert_allclose(q[part], q[part][0] + launch * s - g * s**2 / 2, atol=1e-12)
        np.testing.assert_allclose(v[part][1:], launch - g * s[1:], atol=1e-12)


def test_a_motion_that_keeps_off_a_wall_by_control_grazes_it() -> None:
    scenario = dataclasses.replace(
        Scenario.named("corridor/three_bounces"),
        initial_position=0.3,
        initial_velocity=-2.0,
        goal_position=0.4,
        time_step=0.025,
    )
    world = World.from_scenario(scenario)
    problem = make_ball_task(world, scenario, QUICK)
    flight = problem.polish(problem.box.center, ())
    (graze,) = find_grazes(flight)
    assert graze.contact == 0
    nearest = np.argmin(flight.distances[:, 0])
    assert graze.start == pytest.approx(flight.trajectory.times[nearest], abs=0.1)
    # Where it bounces, it does not keep off.
    bounce = problem.polish(problem.box.center, (graze,))
    assert [other.contact for other in find_grazes(bounce)] in ([], [1])


UNCONFIRMED = PlanOptions(confirm=False)
# Planning again runs the boxes that a new planner's first plan runs, too.
EXHAUSTIVE = PlanOptions(confirm=False, exhaustive=True)
CHANGING = (
    *("initial_position", "initial_velocity", "goal_position"),
    *("control_weight", "goal_weight", "duration"),
)


def changes(scenario: Scenario) -> dict[str, Any]:
    """Returns what `Planner.plan` is to be given to plan for a scenario."""
    return {name: getattr(scenario, name) for name in CHANGING}


def assert_same(one: Plan, other: Plan) -> None:
    assert one.scenario == other.scenario
    assert len(one.candidates) == len(other.candidates)
    for mine, yours in zip(one.candidates, other.candidates, strict=True):
        assert mine.trajectory == yours.trajectory
        assert mine.origin == yours.origin
        assert (mine.cost, mine.defects) == (yours.cost, yours.defects)


def draw(world: str, count: int, seed: int) -> list[Scenario]:
    if world == "point mass":
        found = list(ScenarioQuestion(count=count, seed=seed, num_steps=50).scenarios())
    else:
        found = list(WORLDS[world].draw(count, seed))
    return [dataclasses.replace(s, restitution=0.8, time_step=s.duration / 50) for s in found]


# Corridors and rooms have a floor's kind of walls; rooms with a block have a pair, as two masses.
@pytest.mark.parametrize("world", ["point mass", *slow("floor", "two_masses")])
def test_a_changed_scenario_is_planned_as_by_a_new_planner_to_the_last_bit(world: str) -> None:
    first, *others = draw(world, 2, seed=5)
    planner = Planner(first, EXHAUSTIVE)
    for scenario in others:
        assert_same(planner.plan(**changes(scenario)), Planner(scenario, EXHAUSTIVE).plan())
    *before, last = planner.plans()
    assert before and all(plan.holds and plan.cost >= last.cost for plan in before)
    assert_same(last, Planner(first, EXHAUSTIVE).plan())


@pytest.mark.slow
@pytest.mark.parametrize(
    "changed",
    [{"control_weight": 3e-3}, {"duration": 0.8, "goal_weight": 0.2, "goal_position": 0.6}],
)
def test_weights_and_duration_change_as_ends_do(changed: dict[str, Any]) -> None:
    # Of a spring, as its bias reads the time step.
    world = World.from_diagram(make_diagram(spring=3.0))
    scenario = Scenario(
        initial_position=0.5, initial_velocity=-1.0, goal_position=0.9, time_step=0.02
    )
    found = Planner(scenario, EXHAUSTIVE, world).plan(**changed)
    after = dataclasses.replace(scenario, **changed)
    assert_same(found, Planner(after, EXHAUSTIVE, world).plan())


def test_a_goal_that_costs_nothing_at_first_counts_once_it_is_given_a_weight() -> None:
    scenario = Scenario(
        initial_position=0.5, initial_velocity=-1.0, goal_position=0.9, goal_weight=0.0
    )
    found = Planner(scenario, EXHAUSTIVE, shipped_world()).plan(goal_weight=1.0)
    after = dataclasses.replace(scenario, goal_weight=1.0)
    assert_same(found, Planner(after, EXHAUSTIVE, shipped_world()).plan())


def running_cost(program: RigidTranscription) -> None:
    q, v = np.split(program.state(), 2)
    program.AddRunningCost(1e-3 * (q[0] ** 2 + v[0] ** 2))


def cost_at_a_knot(program: RigidTranscription) -> None:
    program.prog().AddQuadraticCost(1e-2 * (program.state(20)[0] - 0.4) ** 2)


def bounds_on_the_control(program: RigidTranscription) -> None:
    program.AddConstraintToAllKnotPoints(program.input()[0] <= 8.0)


def sum_at_two_knots(program: RigidTranscription) -> None:
    program.prog().AddConstraint(program.state(15)[0] + program.state(30)[0] >= 0.7)


@pytest.mark.parametrize(
    "add", [*slow(running_cost, cost_at_a_knot, bounds_on_the_control), sum_at_two_knots]
)
def test_what_users_added_counts_as_much_when_a_planner_plans_again(
    add: Callable[[OpenProgram], None],
) -> None:
    scenario = Scenario(
        initial_position=0.5, initial_velocity=-2.0, goal_position=0.8, time_step=0.02
    )
    after = dataclasses.replace(
        scenario, initial_position=0.6, initial_velocity=-2.2, goal_position=0.9
    )
    planner, new = (Planner(each, UNCONFIRMED, shipped_world()) for each in (scenario, after))
    for each in (planner, new):
        add(each.transcription)
    first, found = planner.plan(), planner.plan(**changes(after))
    assert_same(found, new.plan())
    assert found.additions == first.additions != ()
    assert found.cost != Planner(after, UNCONFIRMED, shipped_world()).plan().cost


def test_programs_are_compiled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    parsed: list[int] = []

    def count(prog: MathematicalProgram) -> tuple[TermBlock, ...]:
        parsed.append(prog.num_vars())
        return parse_costs(prog)

    monkeypatch.setattr("drake_aigto.planning.programs.parse_costs", count)
    first, *others = draw("point mass", 6, seed=3)
    planner = Planner(first, dataclasses.replace(EXHAUSTIVE, aigo_steps=10))
    for scenario in (first, *others, first):
        planner.plan(**changes(scenario))
    assert len(parsed) == len(set(parsed)), "once for each number of steps"
    # Three steps to the wall are finer than the first plan's.
    near: dict[str, Any] = {"initial_position": 0.1, "initial_velocity": -2.0}
    planner.plan(**near)
    planner.plan(**near, goal_position=0.7)
    assert len(parsed) == len(set(parsed)) >= 2


@pytest.mark.parametrize("world", ["corridor", "room"])
def test_boxes_know_what_walls_return_and_where_they_stand(world: str) -> None:
    scenario = draw(world, 1, seed=5)[0]
    here = World.from_scenario(scenario)
    problem = make_ball_task(here, scenario, UNCONFIRMED)
    there = here.with_walls_nearer(np.linspace(0.02, -0.01, here.num_contacts))
    after = dataclasses.replace(scenario, restitution=0.7)
    again, new = problem.in_world(there).again(after), make_ball_task(there, after, UNCONFIRMED)
    rng = np.random.default_rng(3)
    box = rng.normal(size=problem.box.center.size), rng.uniform(size=problem.box.center.size)
    assert again.polynomial.mean(*box) == pytest.approx(new.polynomial.mean(*box), rel=1e-12)
    assert problem.polynomial.mean(*box) != pytest.approx(new.polynomial.mean(*box), rel=1e-3)
    np.testing.assert_array_equal(again.box.half_width, new.box.half_width)


def test_what_does_not_fit_is_refused_by_name() -> None:
    planner = Planner(draw("point mass", 1, seed=3)[0], UNCONFIRMED)
    refused: list[tuple[dict[str, Any], str]] = [
        ({"duration": 1.005}, "duration"),
        ({"goal_weight": -1.0}, "goal_weight"),
        ({"goal_position": -0.3}, "goal_position is inside"),
    ]
    for changed, message in refused:
        with pytest.raises(ScenarioError, match=message):
            planner.plan(**changed)
    with pytest.raises(OptionsError, match="got model, expected one of initial_position"):
        next(planner.plans(model="other.sdf"))


# Coarse, and with two rungs, so that a plan takes a fraction of a second.
QUICK_LITERAL = LiteralOptions(ladder=LITERAL_LADDER[2:4], confirm=False)
BOUNCE = Scenario(initial_position=0.4, initial_velocity=-1.2, goal_position=1.0, time_step=0.02)
# Far from the wall and with next to no contact force: linear dynamics, quadratic cost.
FLIGHT = Scenario(
    initial_position=1.0, initial_velocity=-0.3, goal_position=1.2, time_step=0.02, epsilon=1e-9
)


@pytest.mark.parametrize("solver", ["newton", "snopt", "ipopt"])
def test_a_flight_costs_the_linear_quadratic_optimum(solver: LocalSolverName) -> None:
    options = dataclasses.replace(
        QUICK_LITERAL, local_solver=solver, ladder=QUICK_LITERAL.ladder[:1], confirm=True
    )
    found = plan_literal(FLIGHT, options)
    assert found.cost == pytest.approx(free_flight_cost(FLIGHT, acts=1.0), rel=1e-6)
    assert max(found.defects.values()) < 1e-8
    assert not found.best.contacts
    # Euler's error is of the order of the time step, so the exact replay differs by that.
    assert found.replay.event_driven.cost == pytest.approx(found.cost, rel=0.1)
    assert found.replay.drake is not None
    assert found.replay.drake.cost == pytest.approx(found.replay.event_driven.cost, rel=1e-3)


@pytest.fixture(scope="module")
def found() -> Plan:
    return plan_literal(BOUNCE, QUICK_LITERAL)


def test_every_candidate_comes_from_a_rung_and_the_best_is_chosen(found: Plan) -> None:
    for candidate in found.candidates:
        if candidate.is_idle:
            continue
        assert candidate.origin.proposer == "annealing"
        assert candidate.origin.rung in QUICK_LITERAL.ladder
        assert {change.kind for change in candidate.origin.changes} <= {"moved"}
    assert found.cost == min(c.cost for c in found.candidates if c.max_defect <= 1e-6)
    assert found.best is found.candidates[0]
    assert found.trajectory is found.best.trajectory


@pytest.mark.parametrize("algorithm", ["full gradient", *slow("alternating")])
def test_the_papers_algorithms_plan_too(algorithm: AlgorithmName) -> None:
    options = dataclasses.replace(
        QUICK_LITERAL, algorithm=algorithm, ladder=QUICK_LITERAL.ladder[:1]
    )
    found = plan_literal(BOUNCE, options)
    assert max(found.defects.values()) < 1e-8
    assert found.best.origin.proposer == algorithm


def test_costs_and_bounds_of_a_user_count() -> None:
    world = World.from_scenario(BOUNCE)
    transcription = LiteralTranscription(world, BOUNCE)
    (u,), (_, v) = transcription.input(), transcription.state()
    transcription.AddFinalCost(1.0 * v**2, "stop")
    transcription.AddConstraintToAllKnotPoints(u <= 2.0)
    transcription.AddConstraintToAllKnotPoints(u >= -2.0)
    problem = LiteralTask(transcription, QUICK_LITERAL)
    result = problem.run_aigo(QUICK_LITERAL.ladder[0])
    knots = problem.find_sequences(result, QUICK_LITERAL.ladder[0])[0]
    x = problem.polish(result.box.center, knots).x
    assert max(transcription.defects(x).values()) < 1e-8
    _, velocities, controls = transcription.split(x)
    assert np.max(np.abs(controls)) <= 2.0 + 1e-8
    assert abs(velocities[-1, 0]) < 0.5


def test_nothing_feasible_is_an_error_that_says_what_was_tried(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unpolished(problem: LiteralTask, center: Any, knots: Any) -> Any:
        return ProgramSolution.of(problem.transcription, center)

    monkeypatch.setattr(LiteralTask, "polish", unpolished)
    message = r"no candidate meets .* got \d+ candidates from 2 rungs, the smallest defect"
    with pytest.raises(PlanningError, match=message):
        plan_literal(BOUNCE, QUICK_LITERAL)


@pytest.mark.parametrize(
    ("kind", "options", "message"),
    [
        (LiteralOptions, {"algorithm": "luck"}, "algorithm: got 'luck', expected one of annealing"),
        (PlanOptions, {"local_solver": "mosek"}, "local_solver: got 'mosek', expected one of newt"),
        (LiteralOptions, {"ladder": ()}, "ladder: got no rung, expected at least one"),
        (PlanOptions, {"threads": 0}, "threads: got 0, expected 1 or more, or None"),
        (PlanOptions, {"threads": -1}, "threads: got -1, expected 1 or more, or None"),
    ],
)
def test_unknown_options_are_refused(
    kind: type[SearchOptions], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(OptionsError, match=message):
        kind(**options)


@pytest.mark.parametrize("name", ["room/bank_shot", *slow("two_masses/handed_on")])
def test_without_rungs_no_boxes_are_compiled_and_a_guess_leads_to_its_plan(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario, options = Scenario.named(name), PlanOptions(confirm=False)
    known = Planner(scenario, options).plan()
    goal = scenario.goal_position + 0.01
    expected = Planner(scenario, options).plan(goal_position=goal)
    monkeypatch.delattr("drake_aigto.planning.programs.parse_costs")
    planner = Planner(scenario, PlanOptions(confirm=False, ladder=(), branches=0))
    plan = planner.plan(goal_position=goal, initial_guess=known.trajectory)
    assert plan.cost == pytest.approx(expected.cost, rel=1e-6) and plan.holds


def test_contacts_are_read_off_impulses() -> None:
    world = World.from_scenario(BOUNCE)
    times = np.linspace(0, 1, 11)
    velocities = np.full((11, 1), -1.0)
    velocities[4:] = 0.5
    velocities[9:] = 0.7
    impulses = np.full((11, 1), 1e-3)
    impulses[3], impulses[8] = 1.5, 0.2
    zeros = np.zeros((10, 1))
    trajectory = Trajectory(times, np.ones((11, 1)), velocities, zeros, impulses, zeros)
    first, second = find_contacts(world, trajectory)
    assert (first.time, first.velocity_change) == pytest.approx((0.3, 1.5))
    assert first.energy_ratio == pytest.approx(0.25)
    assert second.time == pytest.approx(0.8)
    assert second.energy_ratio == pytest.approx(0.49 / 0.25)


def test_options_of_another_transcription_are_refused_before_any_work() -> None:
    options: Any = LiteralOptions()
    with pytest.raises(OptionsError, match=r"got LiteralOptions, expected PlanOptions.*plan_lit"):
        Planner(Scenario.named("table1/1"), options)


def known(bound: PlanBound, cost: float) -> tuple[float, float]:
    gap = bound.gap(cost)
    assert bound.lower_bound is not None
    assert gap is not None
    return bound.lower_bound, gap


def test_one_wall_is_bounded_by_the_exact_optimum_for_every_restitution() -> None:
    rng = np.random.default_rng(0)
    world = World.from_scenario(Scenario.named("table1/1"))
    for e in (1.0, 0.9, 0.5, 0.1, 0.0) * 4:
        scenario = make_scenario(
            rng.uniform(0.05, 1.5), rng.uniform(-4.0, 1.0), rng.uniform(0.05, 1.5), restitution=e
        )
        least = rigid_optimum(world, scenario).cost
        bound = bound_plans(world, scenario, 1.5 * least)
        low, gap = known(bound, least)
        assert low <= least
        assert gap <= 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "seed", "change"),
    [
        ("corridor", 3, {}),
        # Four touches, and hundreds of thousands of flights between their cells.
        ("corridor", 0, {"restitution": 0.8}),
        ("corridor", 3, {"restitution": 0.5}),
        ("room", 3, {}),
        ("floor", 3, {}),
    ],
)
def test_several_walls_are_bounded_by_the_exact_optimum(
    name: str, seed: int, change: dict[str, Any]
) -> None:
    count = 1 if name == "floor" or "restitution" in change else 3
    for drawn in WORLDS[name].draw(count, seed):
        scenario = dataclasses.replace(drawn, **change)
        world = World.from_scenario(scenario)
        least = walls_optimum(world, scenario).cost
        bound = bound_plans(world, scenario, 1.02 * least + 1e-6)
        low, gap = known(bound, least)
        assert low <= least * (1 + 1e-9)
        assert gap <= 1e-2


def test_the_benchmark_counts_no_bound_of_nothing_as_near(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(certificates, "bound_plans", lambda *_: PlanBound(0.0, "", 1.0))
    assert "0 of 3 within" in certificates.one_wall(3)[0]


@pytest.mark.slow
def test_like_masses_that_touch_are_bounded_by_the_exact_optimum() -> None:
    for scenario in WORLDS["two_masses"].draw(40, 0):
        world = World.from_scenario(scenario)
        least = masses_optimum(world, scenario).cost
        low, gap = known(bound_plans(world, scenario, 1.5 * least + 1e-6), least)
        assert low <= least * (1 + 1e-9)
        assert gap <= 1e-6


@pytest.mark.parametrize(
    ("name", "restitution", "reason"),
    [("two_masses", 0.8, "touches take energy away"), ("room_with_block", 1.0, "a block")],
)
def test_what_couples_the_axes_may_have_no_bound(
    name: str, restitution: float, reason: str
) -> None:
    scenario = dataclasses.replace(next(WORLDS[name].draw(1, 0)), restitution=restitution)
    bound = bound_plans(World.from_scenario(scenario), scenario, 1.0)
    assert bound.lower_bound is None
    assert reason in bound.reason


def test_a_place_is_folded_into_a_room_of_mirrors() -> None:
    """Any triangle of 45°, 45° and 90°: what two of its images have in common is folded alike."""
    normals, offsets = np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, -1.0]]), np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(1)
    for _ in range(30):
        place = np.sort(rng.uniform(size=2))
        image = place
        for turn in rng.integers(0, 3, 20):
            n, d = normals[turn], offsets[turn]
            image = image - 2.0 * (n @ image + d) / (n @ n) * n
        folded = fold(image, normals, offsets)
        assert folded is not None
        assert np.allclose(folded, place, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("restitution", [0.0, 1.0])
def test_a_force_between_two_walls_is_bounded(restitution: float) -> None:
    places, line = (0.0, 1.0), {"position": 0.4, "velocity": -2.0, "goal": 0.7, "weight": 20.0}
    walls = [(place, side, restitution) for place, side in zip(places, (1, -1), strict=True)]
    known = optima.Line(**line, gravity=6.0, walls=tuple(optima.Wall(*wall) for wall in walls))
    least = known.optimum(3).cost
    asked = Line(**line, price=1.0, drift=-6.0, walls=tuple(Wall(*wall) for wall in walls))
    bound = bound_line(asked, 1.01 * least)
    assert 0.98 * least <= bound <= least


def test_controls_that_are_held_cost_no_less_than_the_bound(tmp_path: Path) -> None:
    scenario = dataclasses.replace(Scenario.named("table1/1"), restitution=0.8, time_step=0.05)
    plan = Planner(scenario, PlanOptions(certify=True, confirm=False)).plan()
    assert plan.bound is not None
    low, gap = known(plan.bound, cost := plan.replay.event_driven.cost)
    assert 0.0 < low <= cost
    assert (plan.lower_bound, plan.gap) == (low, gap)
    assert gap <= 0.05
    assert "% above any plan" in " ".join(format_plan(plan).split())
    plan.save(tmp_path / "plan.json")
    assert Plan.load(tmp_path / "plan.json").bound == plan.bound


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"contact": "compliant"}, "compliant walls"),
        ({"velocity_weight": 1e-3}, "more than effort and goal: velocity_weight"),
    ],
)
def test_where_there_is_no_bound_it_says_why(change: dict[str, Any], reason: str) -> None:
    scenario = dataclasses.replace(Scenario.named("table1/1"), **change)
    bound = bound_plans(World.from_scenario(scenario), scenario, 1.0)
    assert bound.lower_bound is None
    assert reason in bound.reason


@pytest.mark.parametrize(
    "change",
    [
        {"restitution": 0.207},  # √(0.81/18.81) = 0.2075 is enough for the height, but for rounding
        {"duration": 0.8, "goal_position": [4.0, 0.5]},  # 9 · 0.8²/2 = 2.88 m
    ],
)
def test_a_throw_that_no_control_is_enough_for_is_refused_before_a_search(
    change: dict[str, Any],
) -> None:
    scenario = dataclasses.replace(Scenario.named("throwing_ball/bounces"), **change)
    with pytest.raises(PlanningError, match="proven that no motion meets the hard goal") as caught:
        Planner(scenario).plan()
    assert caught.value.is_proven


def test_a_block_that_nothing_lifts_off_a_floor_with_friction_is_refused_above_it() -> None:
    scenario = Scenario.named("sliding_block/to_rest")
    lifted = dataclasses.replace(scenario, goal_position=[1.0, 0.19])
    with pytest.raises(PlanningError, match=r"0\.19 m, and no control .* but to 0\.15 m"):
        Planner(lifted).plan()
    # On the floor, 1 mm above it, as near as simulations have to come, and far along it.
    for goal in ([1.0, 0.15], [1.0, 0.151], [90.0, 0.15]):
        other = dataclasses.replace(scenario, goal_position=goal)
        assert not out_of_reach(World.from_scenario(other), other)


def test_what_may_be_in_reach_is_not_refused() -> None:
    scenario = Scenario.named("throwing_ball/bounces")
    for change in ({}, {"restitution": 0.208}, {"duration": 1.0}, {"hard_goal": False}):
        change = {**change, "goal_weight": 1.0} if "hard_goal" in change else change
        other = dataclasses.replace(scenario, **change)
        assert not out_of_reach(World.from_scenario(other), other)
