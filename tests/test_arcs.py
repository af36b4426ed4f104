"""Arcs: the multi-phase problem in a few unknowns has the optimum of the one with every knot."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from phase_solutions import MET, bouncing, solve, two_joints
from replay_worlds import make_diagram, make_scenario, make_task, shipped, shipped_world
from rigid_worlds import Array

from drake_aigto import Scenario, World
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.local import InteriorPoint, LocalResult, PolynomialNlp
from drake_aigto.planning import ArcPrograms, Arcs, PhaseMotion, PhaseProblem, solve_in_arcs
from drake_aigto.transcription import Facing, Touch, TouchSequence

# Contacts of the room, and of the block in it.
LEFT, FRONT_WALL = 0, 2
BLOCK_RIGHT, BLOCK_LEFT, BACK, FRONT = 4, 5, 6, 7


def solve_nlp(nlp: PolynomialNlp, x: Array) -> LocalResult:
    return InteriorPoint(max_iterations=200).solve(nlp, x)


def check_same(phases: PhaseProblem, cost_within: float = 1e-8) -> PhaseMotion:
    """Solves in long arcs, and compares with arcs between all knots."""
    motion = solve_in_arcs(phases, phases.guess(), solve_nlp)
    assert motion is not None
    found = PhaseMotion(phases, motion)
    assert max(found.defects.values()) < MET
    assert found.cost == pytest.approx(solve(phases).cost, rel=cost_within, abs=1e-9)
    return found


ROOM = make_task("room", [0.3, 0.7], [-1.5, -1.0], time_step=0.05)
MASSES = make_task("two_masses", [0.3, 0.7], [-1.0, -0.5], time_step=0.05)
TASKS: dict[str, tuple[World, Scenario, TouchSequence]] = {
    "flight": (shipped_world(), make_scenario(time_step=0.05), ()),
    "one step": (shipped_world(), make_scenario(time_step=1.0), ()),
    "bounce": (shipped_world(3.0), bouncing(0.8, 20), (Touch.bounce(0.4),)),
    "short phases": (shipped_world(), bouncing(0.8, 2), (Touch.bounce(0.4),)),
    "floor": (
        shipped("floor"),
        make_task("floor", 0.5, -1.0, time_step=0.05, restitution=0.7),
        (Touch.bounce(0.3),),
    ),
    "room": (shipped("room"), ROOM, (Touch.bounce(0.2, LEFT), Touch.bounce(0.6, FRONT_WALL))),
    "two masses": (shipped("two_masses"), MASSES, (Touch.bounce(0.3, 0), Touch.bounce(0.5, 1))),
    "askew": (
        World.from_diagram(make_diagram(num_joints=2, gravity=3.0)),
        two_joints(0.5),
        (Touch.bounce(0.4), Touch.bounce(1.2)),
    ),
    "lasts": (
        World.from_diagram(make_diagram(num_joints=2, gravity=3.0)),
        two_joints(0.0),
        (Touch(0.5, 1.4),),
    ),
}


@pytest.mark.parametrize(
    "name", sorted(TASKS.keys() - {"two masses"})
)  # Which costs next to nothing.
def test_it_does_not_matter_where_arcs_are_cut(name: str) -> None:
    phases = PhaseProblem(*TASKS[name])
    rng = np.random.default_rng(3)
    costs = [check_same(phases).cost]
    for count in {min(count, phases.num_steps) for count in (0, 2, 7)}:
        cuts = rng.choice(np.arange(1, phases.num_steps + 1), count, replace=False).tolist()
        arcs = Arcs(phases, cuts)
        result = solve_nlp(arcs.nlp, arcs.vector(phases.guess()))
        assert result.is_success
        costs.append(result.cost)
    np.testing.assert_allclose(costs, costs[0], rtol=1e-8)


@pytest.mark.parametrize("name", ["bounce", "room", "askew", "two masses"])
def test_one_program_serves_walls_elsewhere_that_return_something_else(name: str) -> None:
    world, scenario, sequence = TASKS[name]
    programs = ArcPrograms()
    first = Arcs(PhaseProblem(world, scenario, sequence), (), programs).nlp
    moved = world.with_walls_nearer(np.linspace(0.02, -0.03, world.num_contacts))
    phases = PhaseProblem(moved, dataclasses.replace(scenario, restitution=0.6), sequence)
    arcs = Arcs(phases, (), programs)
    assert arcs.nlp.terms is first.terms
    found = solve_nlp(arcs.nlp, arcs.vector(phases.guess()))
    assert found.cost == pytest.approx(check_same(phases).cost, rel=1e-9)


def test_arcs_keep_out_of_walls_between_their_ends() -> None:
    scenario = make_scenario(0.3, -3.0, time_step=0.02)
    phases = PhaseProblem(shipped_world(), scenario)
    arcs = Arcs(phases)
    through = arcs.trajectory(solve_nlp(arcs.nlp, arcs.vector(phases.guess())).x)
    assert np.min(through.positions) < -0.05
    found = check_same(phases, 1e-6)
    assert np.min(found.trajectory.positions) > -1e-11


@pytest.mark.parametrize("side", [BACK, FRONT])
def test_arcs_pass_a_block_on_the_side_that_was_asked_for(side: int) -> None:
    scenario = make_task("room_with_block", [0.1, 0.5], [0.0, 0.0], time_step=0.05)
    scenario = dataclasses.replace(scenario, goal_position=[0.9, 0.5])
    facings = [Facing(0.0, BLOCK_LEFT), Facing(0.3, side), Facing(0.7, BLOCK_RIGHT)]
    phases = PhaseProblem(shipped("room_with_block"), scenario, (), facings)
    x, y = check_same(phases, 1e-6).trajectory.positions.T
    beside = y[(x > 0.4) & (x < 0.6)]
    assert beside.size > 2
    assert np.all(beside > 0.6 - MET if side == BACK else beside < 0.4 + MET)


def test_a_motion_through_arcs_and_back_is_the_same() -> None:
    phases = PhaseProblem(*TASKS["lasts"])
    arcs = Arcs(phases, [3, 4, 11])
    motion = arcs.trajectory(solve_nlp(arcs.nlp, arcs.vector(phases.guess())).x)
    again = arcs.trajectory(arcs.vector(motion))
    for name in ("times", "positions", "velocities", "controls", "forces"):
        np.testing.assert_allclose(getattr(again, name), getattr(motion, name), atol=1e-9)


def test_springs_and_dampers_have_an_arc_for_each_step() -> None:
    world = World.from_diagram(make_diagram(spring=30.0))
    phases = PhaseProblem(world, make_scenario(time_step=0.05))
    assert not phases.has_long_arcs
    assert Arcs(phases).trajectory(Arcs(phases).vector(phases.guess())).times.size == 21


def test_no_arcs_where_the_solver_fails_or_walls_would_pull() -> None:
    phases = PhaseProblem(*TASKS["lasts"])

    def stop_early(nlp: PolynomialNlp, x: Array) -> LocalResult:
        return InteriorPoint(max_iterations=1).solve(nlp, x)

    assert solve_in_arcs(phases, phases.guess(), stop_early) is None
    arcs = Arcs(phases)
    result = solve_nlp(arcs.nlp, arcs.vector(phases.guess()))
    assert not arcs.would_pull(result)
    # Were the cost tiny, what is left of the barrier would count.
    result = InteriorPoint(tolerance=1e-2).solve(arcs.nlp, arcs.vector(phases.guess()))
    assert arcs.would_pull(result)


def test_walls_that_leave_no_place_are_refused() -> None:
    scenario = make_task("room_with_block", [0.7, 0.7], [0.0, 0.0], time_step=0.05)
    facings = [Facing(0.0, BLOCK_RIGHT)]
    phases = PhaseProblem(shipped("room_with_block"), scenario, (Touch.bounce(0.5, LEFT),), facings)
    with pytest.raises(UnsupportedTermError) as error:
        solve_in_arcs(phases, phases.guess(), solve_nlp)
    assert "leave it no value: got [0.6, 0], expected lower ≤ upper." in str(error.value)
