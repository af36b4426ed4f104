"""The whole road: plans that follow the physics, keep their candidates, and survive a file."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from phase_solutions import free_flight_cost
from replay_worlds import make_scenario

from benchmarks import certificates
from benchmarks.optima import line_optimum as optima
from benchmarks.optima import masses_optimum, walls_optimum
from benchmarks.worlds import WORLDS
from drake_aigto import Plan, Scenario
from drake_aigto.certify import Line, PlanBound, Wall, bound_line, bound_plans, fold, out_of_reach
from drake_aigto.errors import OptionsError
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
    LocalSolverName,
    Planner,
    PlanningError,
    PlanOptions,
    ProgramSolution,
    SearchOptions,
)
from drake_aigto.show import format_plan
from drake_aigto.simulation import find_contacts
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import World

# Coarse, and with two rungs, so that a plan takes a fraction of a second.
QUICK = LiteralOptions(ladder=LITERAL_LADDER[2:4], confirm=False)
BOUNCE = Scenario(initial_position=0.4, initial_velocity=-1.2, goal_position=1.0, time_step=0.02)
# Far from the wall and with next to no contact force: linear dynamics, quadratic cost.
FLIGHT = Scenario(
    initial_position=1.0, initial_velocity=-0.3, goal_position=1.2, time_step=0.02, epsilon=1e-9
)


@pytest.mark.parametrize("solver", ["newton", "snopt", "ipopt"])
def test_a_flight_costs_the_linear_quadratic_optimum(solver: LocalSolverName) -> None:
    options = dataclasses.replace(QUICK, local_solver=solver, ladder=QUICK.ladder[:1], confirm=True)
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
    return plan_literal(BOUNCE, QUICK)


def test_every_candidate_comes_from_a_rung_and_the_best_is_chosen(found: Plan) -> None:
    for candidate in found.candidates:
        if candidate.is_idle:
            continue
        assert candidate.origin.proposer == "annealing"
        assert candidate.origin.rung in QUICK.ladder
        assert {change.kind for change in candidate.origin.changes} <= {"moved"}
    assert found.cost == min(c.cost for c in found.candidates if c.max_defect <= 1e-6)
    assert found.best is found.candidates[0]
    assert found.trajectory is found.best.trajectory


@pytest.mark.parametrize("algorithm", ["full gradient", *slow("alternating")])
def test_the_papers_algorithms_plan_too(algorithm: AlgorithmName) -> None:
    options = dataclasses.replace(QUICK, algorithm=algorithm, ladder=QUICK.ladder[:1])
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
    problem = LiteralTask(transcription, QUICK)
    result = problem.run_aigo(QUICK.ladder[0])
    knots = problem.find_sequences(result, QUICK.ladder[0])[0]
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
        plan_literal(BOUNCE, QUICK)


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
