"""Arcs: the multi-phase problem in a few unknowns has the optimum of the one with every knot."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from phase_solutions import MET, Solved, bouncing, optimise, solve, two_joints
from replay_worlds import make_diagram, make_scenario, make_task, shipped, shipped_world
from rigid_worlds import Array
from unfolded_flights import MODELS, Flight

from drake_aigto import Scenario, World
from drake_aigto.errors import OptionsError, UnsupportedTermError
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


@cache
def room() -> World:
    return World.from_scenario(make_block_task([0.1, 0.1], [0, 0], [0.9, 0.9]))


def make_block_task(q: Any, v: Any, goal: Any, steps: int = 40) -> Scenario:
    return make_scenario(q, v, goal, model=MODELS.format("room_with_block"), time_step=1 / steps)


def clearances(found: Solved) -> Array:
    """Returns them between knots, too: positions are parabolas there."""
    state, _ = found.trajectory.to_piecewise()
    times = np.linspace(0, 1, 801)
    return np.array([room().calc_clearance(state.value(t)[:2, 0])[-1] for t in times])


def test_a_flight_goes_around_the_block_as_close_as_it_may() -> None:
    scenario = make_block_task([0.1, 0.5], [1.0, 0.0], [0.9, 0.52])
    found = optimise(room(), scenario)
    facings = found.facings
    assert [facing.contact for facing in facings] == [BLOCK_LEFT, BACK, BLOCK_RIGHT]
    # The turns are free, so that nothing keeps it from passing the corners closely.
    motion = found.trajectory
    knots = np.searchsorted(motion.times, [facing.start - 1e-12 for facing in facings[1:]])
    nearest = np.linalg.norm(motion.positions[knots] - [[0.4, 0.6], [0.6, 0.6]], axis=1)
    assert np.min(nearest) < 1e-6
    assert np.min(clearances(found)) > -1e-6
    assert np.min(clearances(found)) < 1e-3
    # Around the other side it is farther, for the goal is higher.
    other = optimise(
        room(),
        scenario,
        facings=[Facing(0.0, BLOCK_LEFT), Facing(0.35, FRONT), Facing(0.65, BLOCK_RIGHT)],
    )
    assert other.cost > 1.05 * found.cost
    assert np.min(clearances(other)) > -1e-6


def test_a_bounce_off_the_block_unfolds() -> None:
    # Mirrored at x = 0.4; along y nothing is in the way.
    flights = Flight(0.1, 0.5, 0.8 - 0.2, 1.0), Flight(0.3, 0.4, 0.6, 1.0)
    scenario = make_block_task([0.1, 0.3], [0.5, 0.4], [0.2, 0.6])
    found = optimise(room(), scenario, Touch.bounce(0.5, BLOCK_LEFT))
    assert found.cost == pytest.approx(sum(flight.cost for flight in flights), rel=2e-3)
    (touch,) = found.sequence
    assert touch.contact == BLOCK_LEFT
    assert np.min(clearances(found)) > -1e-9
    replay = found.replay()
    assert replay.cost == pytest.approx(found.cost, rel=1e-6)
    assert replay.bounce_contacts == (BLOCK_LEFT,)


def test_a_face_is_touched_within_its_edges() -> None:
    # By itself it would pass the face's height at y = 0.65, above the corner.
    scenario = make_block_task([0.1, 0.65], [0.8, 0.0], [0.1, 0.65])
    found = optimise(room(), scenario, Touch.bounce(0.4, BLOCK_LEFT))
    (touch,) = found.sequence
    k = int(np.argmin(np.abs(found.trajectory.times - touch.start)))
    np.testing.assert_allclose(found.trajectory.positions[k], [0.4, 0.6], atol=1e-6)


@pytest.mark.parametrize(
    ("facings", "message"),
    [
        ([], "got faces of one box from [] s on, expected the first from 0 s, and increasing"),
        ([Facing(0.2, BLOCK_LEFT)], "got faces of one box from [0.2] s on"),
        ([Facing(0.0, BLOCK_LEFT), Facing(1.0, BACK)], "got faces of one box from [0.0, 1.0] s on"),
        ([Facing(0.0, 0)], "got contacts [0], expected those of [4, 5, 6, 7], the faces of boxes"),
        ([Facing(0.0, 8)], "got contacts [8], expected those of [4, 5, 6, 7], the faces of boxes"),
        (
            [Facing(0.0, BACK)],
            "got another face than ball against block, -x face, which is touched, expected that "
            "one at 0.5 s",
        ),
    ],
)
def test_faces_that_leave_out_the_box_are_refused(facings: list[Facing], message: str) -> None:
    scenario = make_block_task([0.1, 0.1], [0, 0], [0.2, 0.2])
    with pytest.raises(OptionsError) as error:
        PhaseProblem(room(), scenario, [Touch.bounce(0.5, BLOCK_LEFT)], facings)
    assert str(error.value).startswith(f"facings: {message}")
