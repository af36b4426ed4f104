"""What users add to a program counts wherever the knots of a plan lie, or is refused by name."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from phase_solutions import MET, solve
from pydrake.solvers import LorentzConeConstraint
from pydrake.symbolic import exp, sin
from replay_worlds import make_diagram, make_scenario, shipped_world

from drake_aigto import Plan, Planner, PlanOptions, World
from drake_aigto.cli import main
from drake_aigto.errors import AigtoError, ProgramError, UnsupportedTermError
from drake_aigto.local import InteriorPoint
from drake_aigto.planning import (
    Arcs,
    BallTask,
    PhaseMotion,
    PhaseProblem,
    PlanningError,
    make_ball_task,
    sample,
    solve_in_arcs,
)
from drake_aigto.show import format_plan
from drake_aigto.transcription import RigidTranscription, Samples, Touch, TouchSequence
from drake_aigto.world import Scenario

# 1 m from a wall, towards it at 2 m/s.
SCENARIO = Scenario(initial_position=1.0, initial_velocity=-2.0, goal_position=0.73, time_step=0.05)
BOUNCE = (Touch.bounce(0.55),)


def transcribe() -> RigidTranscription:
    return RigidTranscription(shipped_world(), SCENARIO)


def phases_with(boxes: RigidTranscription, sequence: TouchSequence = BOUNCE) -> Any:
    """Returns the solved phases of a contact sequence, and their motion."""
    phases = PhaseProblem(shipped_world(), SCENARIO, sequence, additions=boxes.additions())
    found = solve(phases)
    return found, sample(found.trajectory)


@pytest.mark.parametrize("sequence", [(), BOUNCE], ids=["flight", "bounce"])
def test_a_state_is_met_at_its_time(sequence: TouchSequence) -> None:
    boxes = transcribe()
    k = boxes.knot_at(0.3)
    boxes.prog().AddConstraint(boxes.state(k)[0] == 0.5)
    boxes.prog().AddBoundingBoxConstraint(-0.1, 0.1, boxes.final_state()[1])
    found, motion = phases_with(boxes, sequence)
    row = int(np.searchsorted(motion.times, 0.3 - 1e-9))
    assert motion.times[row] == pytest.approx(0.3, abs=1e-12)
    assert motion.q[row, 0] == pytest.approx(0.5, abs=MET)
    assert abs(motion.v[-1, 0]) <= 0.1 + MET
    free, _ = phases_with(transcribe(), sequence)
    assert found.cost > 1.5 * free.cost


def test_additions_at_single_knots_need_no_arc_for_each_step() -> None:
    boxes = transcribe()
    boxes.prog().AddConstraint(boxes.state(6)[0] == 0.5)
    boxes.prog().AddBoundingBoxConstraint(1.0, 1.5, boxes.input(4))
    boxes.prog().AddCost((boxes.state(14)[1] - 1.0) ** 2)
    found, motion = phases_with(boxes)
    guess = found.phases.guess()
    long = solve_in_arcs(found.phases, guess, lambda nlp, x: InteriorPoint().solve(nlp, x))
    assert long is not None
    sizes = [Arcs(found.phases, cuts).nlp.num_rows for cuts in ((), range(20))]
    assert sizes[0] < 0.5 * sizes[1]
    costs = [sum(boxes.additions().costs(each).values()) for each in (motion, sample(long))]
    whole = PhaseMotion(found.phases, long).cost + costs[1]
    assert whole == pytest.approx(found.cost + costs[0], rel=1e-7)
    assert max(boxes.additions().violations(sample(long)).values()) <= MET
    boxes.AddRunningCost(boxes.state()[0] ** 2)
    phases = PhaseProblem(shipped_world(), SCENARIO, BOUNCE, additions=boxes.additions())
    assert found.phases.has_long_arcs and not phases.has_long_arcs


def test_a_control_is_held_where_it_is_bound_and_free_elsewhere() -> None:
    boxes = transcribe()
    boxes.prog().AddBoundingBoxConstraint(2.0, 2.0, boxes.input(4))
    _, motion = phases_with(boxes)
    inside = (motion.times[:-1] > 0.2 - 1e-9) & (motion.times[:-1] < 0.25 - 1e-9)
    assert np.count_nonzero(inside) >= 1
    np.testing.assert_allclose(motion.u[inside], 2.0, atol=MET)
    assert np.all(np.abs(motion.u[~inside] - 2.0) > 1e-3)


def test_what_couples_knots_is_carried() -> None:
    boxes = transcribe()
    early, late = boxes.state(4), boxes.state(9)
    boxes.prog().AddConstraint(early[0] + late[0] <= 0.6)
    boxes.prog().AddCost(10.0 * (boxes.input(15)[0] - boxes.input(16)[0] - 1.0) ** 2)
    _, motion = phases_with(boxes)
    q = np.interp([0.2, 0.45], motion.times, motion.q[:, 0])
    assert 0.6 - 1e-6 < q.sum() <= 0.6 + MET
    u = motion.u[np.searchsorted(motion.times, np.array([0.75, 0.8]) - 1e-9), 0]
    assert u[0] - u[1] == pytest.approx(1.0, abs=0.05)


def test_costs_and_violations_are_those_of_the_motion() -> None:
    boxes = transcribe()
    (u,), (q, v) = boxes.input(), boxes.state()
    boxes.AddRunningCost(0.3 * q**2 * u, "mixed")
    boxes.AddFinalCost(v, "end")
    boxes.prog().AddCost(2.0 * boxes.state(3)[0] * boxes.state(5)[1])
    boxes.AddConstraintToAllKnotPoints(u * v <= 0.5, "power")
    boxes.prog().AddConstraint(sin(boxes.state(3)[0]) <= 0.1).evaluator().set_description("wave")
    t = transcribe().GetSampleTimes()
    x = np.random.default_rng(0).normal(size=(20, 3))
    motion = Samples(t, np.append(x[:, :1], [[1.0]], 0), np.append(x[:, 1:2], [[2.0]], 0), x[:, 2:])
    additions = boxes.additions()
    costs = additions.costs(motion)
    assert costs["mixed"] == pytest.approx(0.3 * 0.05 * np.sum(x[:, 0] ** 2 * x[:, 2]))
    assert costs["end"] == 2.0
    (unnamed,) = set(costs) - {"mixed", "end"}
    assert re.fullmatch(r"cost on q\(3\), v\(5\)", unnamed)
    assert costs[unnamed] == pytest.approx(2 * x[3, 0] * x[5, 1])
    # Missed to first order by so many parts of lengths, speeds and forces of the task.
    violations, s = additions.violations(motion), additions.scales
    power = x[:, 1] * x[:, 2] - 0.5
    parts = power / (np.abs(x[:, 1]) * s["u"] + np.abs(x[:, 2]) * s["v"])
    assert violations["power"] == pytest.approx(np.max(parts))
    over = (np.sin(x[3, 0]) - 0.1) / (np.abs(np.cos(x[3, 0])) * s["q"])
    assert violations["wave"] == pytest.approx(max(over, 0.0))


def test_inequalities_of_several_variables_shape_boxes_and_phases() -> None:
    boxes = transcribe()
    (u,), (_, v) = boxes.input(), boxes.state()
    boxes.AddConstraintToAllKnotPoints(-u * v <= 0.4, "braking power")
    boxes.prog().AddConstraint(boxes.state(4)[0] + boxes.input(4)[0] / 10 <= 0.55)
    _, motion = phases_with(boxes)
    assert np.max(-motion.u * motion.v[:-1]) <= 0.4 + MET
    row = int(np.searchsorted(motion.times, 0.2 - 1e-9))
    assert motion.q[row, 0] + motion.u[row, 0] / 10 <= 0.55 + MET
    assert max(boxes.additions().violations(motion).values()) <= MET
    closed = boxes.closed()
    center, half_width = closed.initial_box()
    assert center.size == half_width.size == closed.prog().num_vars()
    assert closed.prog().num_vars() == boxes.prog().num_vars() + 20 + 1
    np.testing.assert_array_equal(
        np.sort(closed.elimination_order()), np.arange(closed.prog().num_vars())
    )


Add = Callable[[RigidTranscription], Any]


def positive_definite(t: RigidTranscription) -> Any:
    x = t.state(3)
    return t.prog().AddPositiveSemidefiniteConstraint(np.array([[x[0], x[1]], [x[1], x[0]]]))


def cone(t: RigidTranscription) -> Any:
    constraint = LorentzConeConstraint(np.eye(2), np.zeros(2))
    constraint.set_description("cone")
    return t.prog().AddConstraint(constraint, vars=t.state(3))


def of_python(t: RigidTranscription) -> Any:
    return t.prog().AddConstraint(lambda x: x, [0.0], [1.0], t.state(3)[:1], "of Python")


def cost_of_python(t: RigidTranscription) -> Any:
    return t.prog().AddCost(lambda x: x[0], t.state(3), "of Python")


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (positive_definite, "got a PositiveSemidefiniteConstraint, whose formula"),
        (cone, "'cone' can't be met: got a LorentzConeConstraint"),
        (of_python, "'of Python' can't be met: got a PyFunctionConstraint"),
        (cost_of_python, "'of Python' of q(3), v(3) can't be integrated"),
    ],
)
def test_kinds_that_cannot_be_carried_are_refused_by_name(add: Add, message: str) -> None:
    transcription = transcribe()
    add(transcription)
    with pytest.raises(UnsupportedTermError, match=re.escape(message)):
        BallTask(transcription)


def slack_of_ones_own(t: RigidTranscription) -> None:
    (s,) = t.prog().NewContinuousVariables(1, "mine")
    t.prog().AddConstraint(t.state(3)[0] == s)


def contradicting(t: RigidTranscription) -> None:
    t.prog().AddConstraint(t.state(3)[0] >= 0.7).evaluator().set_description("far")
    t.prog().AddConstraint(t.state(3)[0] + t.state(3)[1] <= 0.1).evaluator().set_description("sum")
    t.prog().AddConstraint(t.state(3)[1] >= -0.5).evaluator().set_description("slow")


def square(t: RigidTranscription) -> None:
    q = t.state(9)[0]
    t.prog().AddConstraint(q <= 1.0)
    t.prog().AddConstraint(q**2 - q**3 <= -1.0).evaluator().set_description("square")


def beyond_the_disc(t: RigidTranscription) -> None:
    """Ranges of the rows leave boxes; cells of these, and numbers, tell why there is no motion."""
    u = [t.input(k)[0] / 10.0 for k in range(3, 8)]
    ball, wide = sum(each * each for each in u) <= 1.2, exp(sum(u)) >= 12.2
    t.prog().AddConstraint(ball).evaluator().set_description("ball")
    t.prog().AddConstraint(wide).evaluator().set_description("wide")


def changing_bounds(t: RigidTranscription) -> None:
    (bounds,) = (
        each.evaluator()
        for each in t.prog().bounding_box_constraints()
        if t.state(9)[0].get_id() in [variable.get_id() for variable in each.variables()]
    )
    bounds.set_bounds(bounds.lower_bound() + 0.1, bounds.upper_bound())


def removing(t: RigidTranscription) -> None:
    prog = t.prog()
    prog.RemoveConstraint(prog.GetAllConstraints()[0])


@pytest.mark.parametrize(
    ("add", "message"),
    [
        (slack_of_ones_own, "on q(3), mine(0)': got the variable mine(0), expected variables of"),
        (changing_bounds, "own 'nonpenetration': got other bounds or coefficients than it was mad"),
        (removing, "the program's own costs and constraints: got"),
        (
            lambda t: t.prog().AddBoundingBoxConstraint(1.0, 0.5, t.state(3)[0]),
            "the bounds of the constraint 'constraint on q(3)': got [1, 0.5]",
        ),
        (
            lambda t: t.prog().AddBoundingBoxConstraint(1.1, 2.0, t.initial_state()[0]),
            "the constraint 'constraint on q(0)': got an initial state that misses it by 0.1",
        ),
        (
            lambda t: t.AddConstraintToAllKnotPoints(t.state()[1] ** 2 <= 1.0, "slow"),
            "the constraint 'slow': got an initial state that misses it",
        ),
        (contradicting, "contradict each other: got 'sum' on q(3), v(3); 'far' on q(3); 'slow' on"),
        (
            lambda t: t.prog().AddConstraint(t.state(9)[0] <= -0.1),
            "contradict each other: got 'nonpenetration' on q(9); 'constraint on q(9)' on q(9)",
        ),
        (square, "contradict each other: got 'square' on q(9); 'constraint on q(9)' on q(9),"),
        *slow((beyond_the_disc, "'wide' on u(3), u(4), u(5), u(6), u(7); 'ball' on u(3), u(4)")),
        (lambda t: t.state(21), "state(21): got knot 21, expected one of 0 … 20"),
        (lambda t: t.state(-1), "state(-1): got knot -1, expected one of 0 … 20"),
        (lambda t: t.input(20), "input(20): got knot 20, expected one of 0 … 19"),
        (lambda t: t.knot_at(0.31), "time: got 0.31 s, expected a knot's, as 0.3 and 0.35"),
        (
            lambda t: t.AddRunningCost(t.state(2)[0] ** 2, "one"),
            "the cost 'one': got the variable q(2), expected the placeholders state()",
        ),
        (lambda t: t.AddFinalCost(t.input()[0] ** 2, "end"), "the cost 'end': got the variable"),
    ],
)
def test_what_cannot_be_met_is_one_clear_error(add: Add, message: str) -> None:
    transcription = transcribe()
    with pytest.raises(ProgramError, match=re.escape(message)) as caught:
        add(transcription)
        BallTask(transcription)
    assert isinstance(caught.value, AigtoError)


# 1 m from a wall, towards it at 2 m/s. Free plans bounce at 0.55 s and end at 0.7 m/s.
STEADY = Scenario(initial_position=1.0, initial_velocity=-2.0, goal_position=0.73, time_step=0.02)


def planner(confirm: bool = False) -> Planner:
    return Planner(STEADY, PlanOptions(confirm=confirm))


@cache
def free_plan() -> Plan:
    return planner().plan()


@cache
def through_waypoint() -> tuple[Planner, Plan]:
    """Returns a plan that is at 0.6 m at 0.3 s, ends slowly, and pays for its way."""
    found = planner(confirm=True)
    program = found.transcription
    q, v = program.state()
    program.AddRunningCost(1e-2 * q**2, "near the wall")
    program.AddFinalCost(1e-2 * v**2, "slow end")
    at = program.state(program.knot_at(0.3))
    program.prog().AddConstraint(at[0] == 0.6).evaluator().set_description("waypoint")
    return found, found.plan()


def test_a_waypoint_is_met_and_its_way_paid_for_by_the_plan_and_in_both_simulations() -> None:
    _, found = through_waypoint()
    assert found.holds and found.replay.drake is not None
    for times, positions in [
        (found.trajectory.times, found.trajectory.positions),
        *((replay.times, replay.positions) for replay in found.replay),
    ]:
        row = int(np.argmin(np.abs(times - 0.3)))
        assert times[row] == pytest.approx(0.3, abs=1e-9)
        assert positions[row, 0] == pytest.approx(0.6, abs=1e-6)
    before = np.interp(0.3, free_plan().trajectory.times, free_plan().trajectory.positions[:, 0])
    assert abs(before - 0.6) > 0.1
    motion, scenario = found.trajectory, found.scenario
    steps = np.diff(motion.times)
    effort = scenario.control_weight * steps @ np.sum(motion.controls**2, axis=1)
    missed = scenario.goal_weight * found.best.goal_error**2
    added = {
        "near the wall": 1e-2 * steps @ motion.positions[:-1, 0] ** 2,
        "slow end": 1e-2 * motion.velocities[-1, 0] ** 2,
    }
    assert found.best.added_costs == pytest.approx(added)
    assert found.cost == pytest.approx(effort + missed + sum(added.values()))
    assert motion.velocities[-1, 0] < 0.9 * free_plan().trajectory.velocities[-1, 0]
    for replay in found.replay:
        assert replay.cost == pytest.approx(found.cost, rel=0.02)
        assert replay.added_costs == pytest.approx(added, rel=0.02)
        assert replay.violations["waypoint"] <= 1e-3


def test_a_plan_moves_its_bounce_past_a_time_that_is_bound() -> None:
    # A cost that changes next to nothing, but phases have to meet at its time.
    program = make_ball_task(World.from_scenario(STEADY), STEADY).transcription
    program.prog().AddCost(1e-9 * program.state(program.knot_at(0.5))[0])
    held = BallTask(program)
    path = held.transcription.GetSampleTimes(), held.transcription.split(held.box.center)[0]
    for time in (0.45, 0.5, 0.55):
        found = held.polish_along(path, (Touch.bounce(time),))
        (touch,) = found.sequence
        assert touch.start == pytest.approx(free_plan().best.contacts[0].time, abs=1e-4)
        assert held.cost(found) == pytest.approx(free_plan().cost, rel=1e-3)


@pytest.mark.slow
def test_a_spring_is_taken_through_a_waypoint() -> None:
    # Neither flight nor costs have a closed form there: replays integrate.
    world = World.from_diagram(make_diagram(spring=3.0))
    swinging = Planner(STEADY, PlanOptions(confirm=False), world)
    program = swinging.transcription
    at = program.state(program.knot_at(0.3))
    program.prog().AddConstraint(at[0] == 0.6).evaluator().set_description("waypoint")
    found = swinging.plan()
    assert found.holds
    assert found.replay.event_driven.violations["waypoint"] <= 1e-3


def test_changed_ends_keep_what_was_added() -> None:
    found, _ = through_waypoint()
    again = found.plan(initial_velocity=-1.5, goal_position=0.9)
    row = int(np.argmin(np.abs(again.trajectory.times - 0.3)))
    assert again.trajectory.positions[row, 0] == pytest.approx(0.6, abs=1e-9)
    assert set(again.best.added_costs) == {"near the wall", "slow end"}
    assert again.holds


def test_nothing_is_added_after_the_first_plan() -> None:
    found, _ = through_waypoint()
    program = found.transcription
    with pytest.raises(ProgramError, match="after the first plan, expected all of them before"):
        program.AddFinalCost(program.state()[0])
    late = planner()
    late.plan()
    assert late.transcription.prog().num_vars() > 0  # Looking at it is no addition.
    late.plan()
    late.transcription.prog().AddConstraint(late.transcription.state(3)[0] >= 0.0)
    with pytest.raises(ProgramError, match="after the first plan"):
        late.plan()
    quick = PlanOptions(renewals=0, starts=12, finalists=1)
    mechanism = Planner(Scenario.named("cart_pole/soft_06"), quick)
    mechanism.plan()
    with pytest.raises(ProgramError, match="a cost or constraint after the first plan"):
        mechanism.transcription.AddFinalCost(mechanism.transcription.state()[0])


def test_a_plan_that_a_simulation_breaks_a_constraint_of_does_not_hold() -> None:
    found, plan = through_waypoint()
    drake = plan.replay.drake
    assert drake is not None
    broken = dataclasses.replace(drake, violations={"waypoint": 3e-3})
    failing = dataclasses.replace(plan, replay=dataclasses.replace(plan.replay, drake=broken))
    assert plan.holds and not failing.holds
    text = format_plan(failing, found.world)
    assert "on Drake's plant, breaks 'waypoint'" in " ".join(text.split())
    assert "waypoint violated by 3e-03 of the task's scales" in text


@pytest.mark.slow
def test_what_no_motion_meets_is_an_error_that_names_it() -> None:
    pushed = planner()
    program = pushed.transcription
    u = program.input()[0]
    program.AddConstraintToAllKnotPoints([u <= 0.1, u >= -0.1], "weak")
    at = program.state(program.knot_at(0.3))
    program.prog().AddConstraint(at[0] == 0.6).evaluator().set_description("waypoint")
    with pytest.raises(PlanningError, match=r"no candidate meets .* smallest defect .*waypoint"):
        pushed.plan()


def test_a_saved_plan_names_what_was_added_and_replays_without_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, plan = through_waypoint()
    path = tmp_path / "plan.json"
    plan.save(path)
    assert Plan.load(path) == plan
    assert main(["replay", str(path), "--no-confirm"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert re.search(r"near the wall \d\S+, slow end \d\S+, waypoint, simulated and compared", text)
    assert "a plan file has only their names" in text


@pytest.mark.slow
def test_a_report_names_what_was_added_and_a_gradient_solver_does_without(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, plan = through_waypoint()
    assert plan.additions == ("near the wall", "slow end", "waypoint")
    path, page = tmp_path / "plan.json", tmp_path / "page.html"
    plan.save(path)
    assert main(["report", str(path), "--html", str(page)]) == 0
    text = page.read_text(encoding="utf-8")
    names = "near the wall, slow end, waypoint"
    assert f"program in Python: {names}." in text
    assert re.search(rf"boxes can.{{1,6}}t be run again: .* by name only \({names}\)", text)
    assert main(["play", str(path), "--html", str(page), "--beside", "gradient"]) == 0
    assert f"SNOPT plans without what was added: {names}" in capsys.readouterr().out
    assert main(["play", str(path), "--html", str(page), "--optimization"]) == 2


@pytest.mark.slow
def test_a_rest_goes_on_past_a_time_that_is_bound() -> None:
    # Without rebound, on a floor: staying there costs nothing, and hovering does.
    world = World.from_diagram(make_diagram(gravity=9.81))
    scenario = make_scenario(0.3, 0.0, 0.5, duration=2.0, time_step=0.02, restitution=0.0)
    resting = Planner(scenario, PlanOptions(confirm=False), world)
    program = resting.transcription
    state = program.state(program.knot_at(0.8))
    program.prog().AddConstraint(state[0] <= 1e-3).evaluator().set_description("down")
    program.prog().AddCost(1e-6 * program.input(program.knot_at(0.6))[0] ** 2)
    found = resting.plan()
    (contact,) = found.best.contacts
    assert found.holds and contact.time < 0.3 and contact.last_time > 1.0
