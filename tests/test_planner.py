"""The whole road: plans that follow the physics, keep their candidates, and survive a file."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from marks import slow
from phase_solutions import free_flight_cost

from drake_aigto import Plan, Scenario
from drake_aigto.errors import OptionsError
from drake_aigto.paper import (
    LITERAL_LADDER,
    AlgorithmName,
    LiteralOptions,
    LiteralTask,
    LiteralTranscription,
    plan_literal,
)
from drake_aigto.planning import (
    LocalSolverName,
    Planner,
    PlanningError,
    PlanOptions,
    ProgramSolution,
    SearchOptions,
)
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
