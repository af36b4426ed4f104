"""A planner plans again, with what it compiled once, as a new one of the changed scenario would."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydrake.solvers import MathematicalProgram
from replay_worlds import make_diagram, shipped_world

from benchmarks.study import ScenarioQuestion
from benchmarks.worlds import WORLDS
from drake_aigto import Scenario, World
from drake_aigto.errors import OptionsError, ScenarioError
from drake_aigto.planning import Plan, Planner, PlanOptions, make_ball_task
from drake_aigto.terms import TermBlock, parse_costs
from drake_aigto.transcription import OpenProgram, RigidTranscription

UNCONFIRMED = PlanOptions(confirm=False)
CHANGING = (
    *("initial_position", "initial_velocity", "goal_position"),
    *("control_weight", "goal_weight", "duration"),
)


def changes(scenario: Scenario) -> dict[str, Any]:
    """Returns what `Planner.plan` is to be given to plan for a scenario."""
    return {name: getattr(scenario, name) for name in CHANGING}


def assert_same(one: Plan, other: Plan) -> None:
    """Checks that two plans are equal to the last bit, and so are all their candidates."""
    assert one.scenario == other.scenario
    assert len(one.candidates) == len(other.candidates)
    for mine, yours in zip(one.candidates, other.candidates, strict=True):
        assert mine.trajectory == yours.trajectory
        assert mine.origin == yours.origin
        assert (mine.cost, mine.defects) == (yours.cost, yours.defects)


def draw(world: str, count: int, seed: int) -> list[Scenario]:
    """Returns random scenarios with one restitution, coarse ones."""
    if world == "point mass":
        found = list(ScenarioQuestion(count=count, seed=seed, num_steps=50).scenarios())
    else:
        found = list(WORLDS[world].draw(count, seed))
    return [dataclasses.replace(s, restitution=0.8, time_step=s.duration / 50) for s in found]


# Corridors and rooms have a floor's kind of walls; rooms with a block have a pair, as two masses.
@pytest.mark.parametrize("world", ["point mass", "floor", "two_masses"])
def test_a_changed_scenario_is_planned_as_by_a_new_planner_to_the_last_bit(world: str) -> None:
    first, *others = draw(world, 2, seed=5)
    planner = Planner(first, UNCONFIRMED)
    for scenario in others:
        assert_same(planner.plan(**changes(scenario)), Planner(scenario, UNCONFIRMED).plan())
    *before, last = planner.plans()
    assert before and all(plan.holds and plan.cost >= last.cost for plan in before)
    assert_same(last, Planner(first, UNCONFIRMED).plan())


@pytest.mark.parametrize(
    "changed",
    [
        {"duration": 1.4},
        {"control_weight": 3e-3, "goal_weight": 5.0},
        {"duration": 0.8, "goal_weight": 0.2, "goal_position": 0.6},
    ],
)
def test_weights_and_duration_change_as_ends_do(changed: dict[str, Any]) -> None:
    # Of a spring, as its bias reads the time step.
    world = World.from_diagram(make_diagram(spring=3.0))
    scenario = Scenario(
        initial_position=0.5, initial_velocity=-1.0, goal_position=0.9, time_step=0.02
    )
    found = Planner(scenario, UNCONFIRMED, world).plan(**changed)
    after = dataclasses.replace(scenario, **changed)
    assert_same(found, Planner(after, UNCONFIRMED, world).plan())


def test_a_goal_that_costs_nothing_at_first_counts_once_it_is_given_a_weight() -> None:
    scenario = Scenario(
        initial_position=0.5, initial_velocity=-1.0, goal_position=0.9, goal_weight=0.0
    )
    found = Planner(scenario, UNCONFIRMED, shipped_world()).plan(goal_weight=1.0)
    after = dataclasses.replace(scenario, goal_weight=1.0)
    assert_same(found, Planner(after, UNCONFIRMED, shipped_world()).plan())


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
    "add", [running_cost, cost_at_a_knot, bounds_on_the_control, sum_at_two_knots]
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
    planner = Planner(first, dataclasses.replace(UNCONFIRMED, aigo_steps=10))
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
