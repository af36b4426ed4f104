"""What users add to a mechanism's program counts in shooting, or is refused by name."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest

from drake_aigto import ModelPredictiveController, Plan, Planner, PlanOptions
from drake_aigto.errors import ControlError, ProgramError, UnsupportedTermError
from drake_aigto.planning import PlanningError
from drake_aigto.transcription import OpenProgram
from drake_aigto.world import Scenario

QUICK = PlanOptions(renewals=0, starts=12, finalists=1)
SOFT, RIGID = "cart_pole/soft_06", "cart_pole/rigid_06"
FASTEST = np.array([3.0, 5.0])  # of cart and pole [m/s, rad/s]


def make_planner(name: str, seed: int = 0, **changes: Any) -> Planner:
    options = dataclasses.replace(QUICK, seed=seed)
    return Planner(dataclasses.replace(Scenario.named(name), **changes), options)


@cache
def plan_plain(name: str) -> Plan:
    return make_planner(name).plan()


def bound_velocities(program: OpenProgram) -> None:
    for v, fastest in zip(program.state()[2:], FASTEST, strict=True):
        program.AddConstraintToAllKnotPoints([v <= fastest, v >= -fastest], "slow")


EITHER = pytest.mark.parametrize("name", [SOFT, RIGID])


@pytest.mark.slow
@pytest.mark.parametrize("name", [SOFT, RIGID])
def test_constraints_of_every_knot_are_met_as_the_scenarios_bounds_are(name: str) -> None:
    # A dozen searches end in one of several optima, here in the same.
    bounded = make_planner(name, 1, velocity_lower=-FASTEST, velocity_upper=FASTEST).plan()
    planner = make_planner(name, 1)
    bound_velocities(planner.transcription)
    found = planner.plan()
    assert np.any(np.abs(plan_plain(name).trajectory.velocities) > 1.2 * FASTEST)
    assert np.all(np.abs(found.trajectory.velocities) <= FASTEST + 1e-3)
    assert found.holds and found.additions == ("slow",)
    assert [replay.violations["slow"] <= 2e-3 for replay in found.replay] == [True, True]
    assert found.cost == pytest.approx(bounded.cost, rel=2e-2)


@pytest.mark.slow
@EITHER
def test_a_running_cost_of_control_counts_as_its_weight_does(name: str) -> None:
    weight = Scenario.named(name).control_weight
    planner = make_planner(name)
    program = planner.transcription
    program.AddRunningCost(weight * program.input()[0] ** 2, "more effort")
    found, weighed = planner.plan(), make_planner(name, control_weight=2 * weight).plan()
    assert found.cost == pytest.approx(weighed.cost, rel=2e-2)
    motion = found.trajectory
    effort = weight * np.diff(motion.times) @ motion.controls[:, 0] ** 2
    assert found.best.added_costs == pytest.approx({"more effort": effort}, rel=1e-6)
    assert found.holds and len(list(found.replay)) == 2
    for replay in found.replay:
        assert replay.cost == pytest.approx(found.cost, rel=1e-2)
        assert replay.added_costs == pytest.approx(found.best.added_costs, rel=1e-6)


@pytest.mark.slow
def test_a_final_cost_and_a_bound_of_the_last_knot_count_between_rigid_walls() -> None:
    planner, plain = make_planner(RIGID), plan_plain(RIGID).trajectory
    program = planner.transcription
    program.AddFinalCost(50 * program.state()[2] ** 2, "slow cart")
    program.prog().AddBoundingBoxConstraint(-0.005, 0.005, program.final_state()[0])
    found = planner.plan()
    end = found.trajectory.positions[-1], found.trajectory.velocities[-1]
    assert found.holds
    assert abs(end[0][0]) <= 0.006 < abs(plain.positions[-1, 0])
    assert abs(end[1][0]) < 0.5 * abs(plain.velocities[-1, 0])
    assert found.best.added_costs == pytest.approx({"slow cart": 50 * end[1][0] ** 2}, abs=1e-6)


def test_a_waypoint_is_met_between_soft_walls() -> None:
    planner = make_planner(SOFT)
    program = planner.transcription
    at = program.state(program.knot_at(0.75))
    program.prog().AddConstraint(at[0] == 0.0).evaluator().set_description("waypoint")
    found = planner.plan()
    assert found.holds
    for motion in (found.trajectory, *found.replay):
        row = int(np.argmin(np.abs(motion.times - 0.75)))
        assert motion.positions[row, 0] == pytest.approx(0.0, abs=2e-3)


def add_waypoint(program: OpenProgram) -> None:
    program.prog().AddConstraint(program.state(20)[0] == 0.0).evaluator().set_description("way")


def add_root(program: OpenProgram) -> None:
    q = program.state()
    program.AddRunningCost(q[0] * q[1] ** 0.5, "root")


def add_step(program: OpenProgram) -> None:
    program.prog().AddConstraint(program.state(3)[0] == program.state(2)[0] + 0.1)


@pytest.mark.parametrize(
    ("name", "add", "error", "message"),
    [
        (RIGID, add_waypoint, ProgramError, r"'way' can't be planned: .* phases of free durations"),
        (SOFT, add_root, UnsupportedTermError, "'root' .* exponent .* is not a whole number"),
        (SOFT, add_step, ProgramError, "variables of knots 2, 3, expected those of one knot"),
    ],
)
def test_what_cannot_be_planned_is_refused_by_name(
    name: str, add: Any, error: type[Exception], message: str
) -> None:
    planner = make_planner(name)
    add(planner.transcription)
    with pytest.raises(error, match=message):
        planner.plan()


@pytest.mark.slow
def test_a_constraint_that_nothing_meets_is_named() -> None:
    planner = make_planner(SOFT)
    program = planner.transcription
    program.prog().AddConstraint(program.final_state()[0] >= 40.0).evaluator().set_description(
        "far"
    )
    with pytest.raises(PlanningError, match=r"there it breaks .*'far'"):
        planner.plan()


def test_controllers_that_plan_again_refuse_what_was_added() -> None:
    planner = make_planner(SOFT)
    bound_velocities(planner.transcription)
    with pytest.raises(ControlError, match="costs or constraints that were added"):
        ModelPredictiveController(planner, 0.025)
