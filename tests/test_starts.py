"""Where searches for plans of balls start, and the bounces and rests that they come to."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from marks import slow
from mechanisms import build_world, drop_ball, joint, link, plane, sphere, wall
from phase_solutions import Solved, solve
from replay_worlds import make_task, make_wedge, shipped
from scaled_worlds import Factors, scale_scenario
from space_models import ball_and_finger, make_scenario

from benchmarks.floors import draw, floor_optimum, make_world
from benchmarks.optima import masses_optimum, walls_optimum
from benchmarks.worlds import WORLDS
from drake_aigto import PlanOptions, Scenario, World, plan, replay_drake, replay_event_driven
from drake_aigto.contact import RigidLaw
from drake_aigto.errors import OptionsError, ScenarioError, TrajectoryError
from drake_aigto.planning import (
    BALL_LADDER,
    BallSearch,
    BallTask,
    Candidate,
    Measures,
    MechanismTask,
    PhaseMotion,
    PhaseProblem,
    Planner,
    Rung,
    draw_shots,
    find_insertions,
    kinds,
    make_ball_task,
    make_mechanism_task,
    needs_shooting,
    read_sequences,
    soften,
)
from drake_aigto.transcription import Touch, TouchSequence, touches_at_once
from drake_aigto.world import SpaceWorld

COASTING = [rung for rung in BALL_LADDER if rung.start == "coast"]


def problem_of(name: str) -> BallTask:
    scenario = Scenario.named(name)
    problem = make_ball_task(World.from_scenario(scenario), scenario, PlanOptions())
    return problem


def test_an_unknown_start_is_refused() -> None:
    with pytest.raises(OptionsError, match=r"start: got 'corner', expected one of .*line.*coast"):
        Rung(1.0, {}, start="corner")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["corridor/three_bounces", "floor/rebound", "room/two_walls"])
def test_the_coasting_box_is_around_the_simulated_motion(name: str) -> None:
    problem = problem_of(name)
    start = problem.start("coast")
    assert start.transcription is problem.transcription
    q, v, u = start.transcription.split(start.box.center)
    widths = start.transcription.split(start.box.half_width)
    times = start.transcription.GetSampleTimes()
    world, scenario = start.transcription.world, start.transcription.scenario
    coast = replay_event_driven(world, scenario, times, u)
    np.testing.assert_array_equal(u, 0.0)
    for k, t in enumerate(times):
        near = np.flatnonzero(np.abs(coast.times - t) < 1e-9)[0]
        # At a wall the box is cut to what is in front of it, and still holds the motion.
        assert np.all(np.abs(q[k] - coast.positions[near]) <= widths[0][k] + 1e-9)
        np.testing.assert_allclose(v[k], coast.velocities[near], atol=1e-9)
    # The start is known; what follows is less and less.
    np.testing.assert_array_equal(widths[0][0], 0.0)
    assert np.all(np.diff(widths[1], axis=0) >= -1e-12)
    assert 0 < widths[0][-1, 0] < problem.transcription.split(problem.box.half_width)[0][-1, 0]


def test_around_a_block_other_faces_are_in_force_where_the_coast_goes() -> None:
    problem = problem_of("room_with_block/off_the_block")
    line, coast = problem.start("line"), problem.start("coast")
    assert coast.transcription is not line.transcription
    assert coast.transcription.prog().num_vars() == line.transcription.prog().num_vars()
    # Outside at every knot, by the faces that are in force there.
    costs = coast.polynomial.with_weights(
        {name: float(name == "nonpenetration") for name in coast.polynomial.weights}
    )
    still = np.zeros_like(coast.box.center)
    assert costs.mean(coast.box.center, still) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("restitution", [1.0, 0.8])
@pytest.mark.parametrize("velocity", [3.1, -2.2])
def test_cool_boxes_around_the_coast_keep_its_bounces(velocity: float, restitution: float) -> None:
    scenario = dataclasses.replace(
        Scenario.named("corridor/three_bounces"),
        initial_position=0.4,
        initial_velocity=velocity,
        duration=1.5,
        restitution=restitution,
    )
    world = World.from_scenario(scenario)
    times = np.linspace(0.0, scenario.duration, 301)
    coast = replay_event_driven(world, scenario, times, np.zeros((300, 1)))
    # What costs nothing is the best plan.
    scenario = dataclasses.replace(scenario, goal_position=coast.positions[-1])
    problem = make_ball_task(world, scenario, PlanOptions())
    rung = COASTING[0]
    sequences = problem.find_sequences(problem.run_aigo(rung), rung)
    assert list(coast.bounce_contacts) in [[t.contact for t in s] for s in sequences]


def test_impulses_of_each_wall_are_clusters_of_their_own() -> None:
    problem = problem_of("room/two_walls")
    transcription = problem.transcription
    q, v, u = transcription.split(problem.start("coast").box.center)
    q[:], v[:], u[:] = 0.5, 1.0, 0.0
    dt = transcription.time_step()
    # The walls give back at knots 10, 11 and 30 in x, and at 12 in y, what the control takes.
    for k, axis, size in ((10, 0, 1.0), (11, 0, 3.0), (12, 1, 1.0), (30, 0, -1.0)):
        u[k, axis] = -size / dt
    read = read_sequences(transcription, transcription.vector_of(q, v, u))[0]
    jacobians = transcription.world.calc_contact_jacobian(np.full(2, 0.5))
    normals = [tuple(jacobians[touch.contact].round(6).tolist()) for touch in read]
    assert normals == [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)]
    assert [touch.start for touch in read] == pytest.approx([10.75 * dt, 12 * dt, 30 * dt])


def test_bounces_of_two_walls_at_one_knot_come_one_after_the_other() -> None:
    transcription = problem_of("room/two_walls").transcription
    N, dt = transcription.scenario.num_steps, transcription.time_step()
    q, v, u = np.full((N + 1, 2), 0.5), np.ones((N + 1, 2)), np.zeros((N, 2))
    u[20] = -2.0 / dt
    (first, second) = read_sequences(transcription, transcription.vector_of(q, v, u))[0]
    assert first.start == pytest.approx(20 * dt)
    assert 0 < second.start - first.start < dt / 10
    assert first.contact != second.contact


CORRIDOR = "package://drake_aigto_models/corridor.sdf"


def make_ball_scenario(distance: float, **fields: Any) -> Scenario:
    ends: dict[str, Any] = {"initial_velocity": -2.0, "goal_position": 0.73}
    return Scenario(initial_position=distance, **ends, restitution=0.8, **fields)


@pytest.mark.parametrize("distance", [1e-12, *slow(1e-8, 1e-5)])
@pytest.mark.parametrize("fields", [{}, *slow({"model": CORRIDOR})], ids=["wall", "corridor"])
def test_a_plan_is_the_optimum_however_near_to_a_wall_it_starts(
    distance: float, fields: dict[str, str]
) -> None:
    scenario = make_ball_scenario(distance, **fields)
    world = World.from_scenario(scenario)
    found = plan(scenario, PlanOptions(confirm=False), world)
    assert found.cost == pytest.approx(walls_optimum(world, scenario).cost, rel=1e-3)
    assert found.best.contacts[0].time == pytest.approx(distance / 2, rel=0.01)


def test_what_is_touched_at_once_is_found_in_the_order_of_time() -> None:
    world = make_wedge(1.5)
    start = np.linalg.solve(world.calc_contact_jacobian(np.zeros(2)), [3e-9, 2e-9])
    toward = -start / np.linalg.norm(start)

    def bounces(position: Any, velocity: Any) -> list[tuple[float, int]]:
        scenario = Scenario(
            initial_position=position, initial_velocity=velocity, goal_position=[0.5, 0.5]
        )
        return [(touch.start, touch.contact) for touch in touches_at_once(world, scenario)]

    times = np.linalg.norm(start)  # Both walls at once, but for rounding.
    assert [time for time, _ in bounces(start, toward)] == pytest.approx([times, times])
    assert next(contact for _, contact in bounces(start, [0.0, -1.0])) == 0
    assert not bounces(start, -toward)
    assert not bounces([0.5, 0.4], toward)


@pytest.mark.parametrize("control", [0.0, -1.0])
def test_drake_sees_no_wall_any_more_once_it_is_left(control: float) -> None:
    # As its integrator's Jacobian is of differences, it did: the end was 4 to 33 cm off.
    ends: dict[str, Any] = {"initial_velocity": 0.05, "goal_position": 0.5}
    scenario = Scenario(model=CORRIDOR, initial_position=1 - 1e-11, **ends)
    world = World.from_scenario(scenario)
    times = np.concatenate([[0.0, 1e-10], np.linspace(2e-10, 1.0, 150)])
    controls = np.full((len(times) - 1, 1), control)
    rigid, drake = (
        replay(world, scenario, times, controls) for replay in (replay_event_driven, replay_drake)
    )
    assert drake.positions[-1] == pytest.approx(rigid.positions[-1], abs=2e-4)


QUICK = PlanOptions(confirm=False)


def insertions(model: str, q: Sequence[float], touches: Sequence[Touch]) -> list[tuple[float, int]]:
    """Returns time and contact of what is proposed for a guess, which is a motion for this."""
    scenario = dataclasses.replace(make_task(model, q, np.zeros(len(q))), time_step=0.02)
    phases = PhaseProblem(shipped(model), scenario, touches)
    found = find_insertions(PhaseMotion(phases, phases.guess()))
    return [(touch.start, touch.contact) for touch in found]


def test_a_free_flight_may_touch_every_wall_where_it_is_nearest() -> None:
    found = insertions("corridor", [0.8], ())  # down to 0.3
    assert [contact for _, contact in found] == [0, 1]
    (to_lower, _), (to_upper, _) = found
    assert 0.75 < to_lower < 0.8
    assert 0.2 < to_upper < 0.25


def test_gravity_alone_pulls_back_to_a_wall_just_left() -> None:
    found = insertions("corridor", [0.8], [Touch.bounce(0.5, 0)])
    assert [(time > 0.5, contact) for time, contact in found] == [(False, 1), (True, 1)]
    found = insertions("floor", [0.8], [Touch.bounce(0.5, 0)])
    assert [contact for _, contact in found] == [0] * 4  # At the nearest, and soon before the next.
    times = [time for time, _ in found]
    assert times[0] < 0.45 < times[1] < 0.5 < times[2] < 0.9 < times[3] < 1.0


def test_contacts_that_do_not_feel_each_other_share_no_gaps() -> None:
    names = [contact.name for contact in shipped("two_masses").contacts]
    (between,) = (i for i, name in enumerate(names) if "wall" not in name)
    walls = [i for i in range(3) if i != between]
    touches = list(map(Touch.bounce, (0.3, 0.6), walls))
    # A wall does not feel the other one, and is next to itself; the masses touch in three gaps.
    found = insertions("two_masses", [0.3, 0.7], touches)
    assert [contact for _, contact in found] == [between] * 3


@pytest.mark.slow
def test_a_bounce_that_no_box_shows_is_inserted() -> None:
    (*_, scenario) = WORLDS["two_masses"].draw(9, seed=21)
    world = World.from_scenario(scenario)
    found = plan(scenario, QUICK, world)
    optimum = masses_optimum(world, scenario)
    assert [contact.index for contact in found.best.contacts] == [2]
    assert found.replay.event_driven.cost <= 1.01 * optimum.cost


def test_a_polish_passes_the_block_on_the_way_to_the_goal_where_the_box_center_misses_it() -> None:
    (*_, scenario) = WORLDS["room_with_block"].draw(5, seed=21)
    problem = make_ball_task(World.from_scenario(scenario), scenario, QUICK)
    rung = next(rung for rung in QUICK.ball_ladder if rung.start == "coast")
    result = problem.run_aigo(rung)
    sequence = problem.find_sequences(result, rung)[0]
    center = problem.transcription.split(result.box.center)[0]
    assert np.linalg.norm(center[-1] - scenario.goal_position) > 0.3
    found = problem.polish(result.box.center, sequence)
    # The best known (`optima.block_optimum`).
    assert found.cost == pytest.approx(3.9686e-4, rel=0.01)


def test_no_neighbor_is_tried_whose_contacts_a_plan_has_that_holds(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scenario = Scenario.named("corridor/three_bounces")
    problem = make_ball_task(World.from_scenario(scenario), scenario, QUICK)
    search = BallSearch(problem)
    for wave in search.propose():
        search.close(wave)
    held = [kinds(each) for each, it in search.by_sequence.items() if it.is_confirmed]
    tried: list[list[tuple[int, bool]]] = []

    def refuse(self: BallSearch, other: TouchSequence, path: object) -> None:
        tried.append(kinds(other))

    monkeypatch.setattr(BallSearch, "_try", refuse)
    for wave in search.vary():
        search.close(wave)
    assert tried
    assert not [each for each in tried if each in held]


OPTIONS = PlanOptions(confirm=False)


def on_floor(q: float, v: float, goal: float, duration: float, e: float) -> Scenario:
    return Scenario(
        model="package://drake_aigto_models/floor.sdf",
        initial_position=q,
        initial_velocity=v,
        goal_position=goal,
        duration=duration,
        restitution=e,
    )


@pytest.fixture(scope="module")
def moon() -> World:
    return make_world(gravity=3.0, mass=1.5)


def rest(world: World, scenario: Scenario, land: float, leave: float) -> Solved:
    return solve(PhaseProblem(world, scenario, [Touch(land, leave)]))


@pytest.mark.parametrize("duration", [2.4, 1.8])
@pytest.mark.parametrize("e", [0.1, 0.7])
def test_hops_end_before_the_jump_however_short_the_time_is(
    moon: World, e: float, duration: float
) -> None:
    scenario = dataclasses.replace(
        on_floor(0.3, 0.0, 0.3, duration, e), time_step=duration / 40, goal_weight=100.0
    )
    found = rest(moon, scenario, 0.3 * duration, 0.65 * duration)
    (touch,), replay = found.sequence, found.replay()
    motion = found.trajectory
    (k,) = np.flatnonzero(motion.times == touch.start)
    pushed = float(np.diff(motion.times) @ motion.forces[:, 0])
    assert (1 - e) * pushed >= -2 * e * 1.5 * motion.velocities[k, 0] - 1e-9
    assert replay.cost == pytest.approx(found.cost, rel=1e-5)
    assert len(replay.bounce_times) > 2
    assert max(replay.bounce_times) < touch.end


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "gravity", "mass"),
    [
        pytest.param(  # Stays where it fell.
            *(on_floor(0.290604, -0.07273, 0.303735, 0.9, 0.3), 20.0, 3.0), marks=pytest.mark.slow
        ),
        pytest.param(
            *(on_floor(0.758673, 0.66295, 0.537131, 1.9, 0.3), 13.30707, 1.53598),
            marks=pytest.mark.slow,
        ),
        (on_floor(0.595983, -1.02674, 0.903772, 1.5, 0.1), 19.1117, 0.83202),
        *slow((on_floor(0.518778, 1.97036, 0.243520, 1.1, 0.1), 16.23448, 0.42458)),
    ],
)
def test_a_ball_that_settles_rests_until_it_is_time_to_jump(
    scenario: Scenario, gravity: float, mass: float
) -> None:
    made = Planner(scenario, OPTIONS, make_world(gravity, mass)).plan()
    known = floor_optimum(scenario, gravity, mass)
    assert made.replay.event_driven.cost <= 1.01 * known.cost
    # The hops are in the plan, as they are simulated.
    times = [contact.time for contact in made.best.contacts]
    assert len(times) > 1
    assert times == pytest.approx(made.replay.event_driven.bounce_times[: len(times)], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "gravity", "mass"),
    [
        pytest.param(  # High and late.
            *(on_floor(0.92168282, -1.50178118, 0.30328249, 1.5, 1.0), 9.81, 1.0),
            marks=pytest.mark.slow,
        ),
        (on_floor(0.36634367, -0.70831679, 0.10440947, 1.5, 1.0), 9.81, 1.0),  # Once more, late.
        (on_floor(0.373032, -0.35086, 0.014089, 1.0, 1.0), 8.62315, 1.73192),  # Just at the end.
    ],
)
def test_of_high_and_late_and_low_and_early_it_is_the_better_one(
    scenario: Scenario, gravity: float, mass: float
) -> None:
    made = Planner(scenario, OPTIONS, make_world(gravity, mass)).plan()
    assert made.replay.event_driven.cost <= 1.01 * floor_optimum(scenario, gravity, mass).cost


@pytest.mark.slow
def test_the_reference_of_floors_is_no_worse_than_all_listed_sequences() -> None:
    for scenario, gravity, mass in list(draw(12, seed=7))[::3]:
        world = make_world(gravity, mass)
        listed = walls_optimum(world, scenario, most_touches=4)
        assert floor_optimum(scenario, gravity, mass).cost <= listed.cost * (1 + 1e-6) + 1e-9


@pytest.mark.slow
def test_a_ball_that_lies_at_a_wall_leaves_it_as_cheaply_as_in_free_flight() -> None:
    shipped = Scenario.named("table1/1")
    lies: dict[str, Any] = {"initial_position": [0.0], "initial_velocity": [0.0]}
    scenario = dataclasses.replace(shipped, **lies, goal_position=[0.5])
    found = plan(scenario, PlanOptions(starts=2, renewals=0, threads=1))
    # Free flight from rest: J = 3 m² w_u x²/T³ + w_f (x − goal)² is least at this end x.
    effort = 3 * shipped.control_weight / shipped.duration**3
    end = 0.5 * shipped.goal_weight / (shipped.goal_weight + effort)
    least = effort * end**2 + shipped.goal_weight * (end - 0.5) ** 2
    assert found.holds and found.cost == pytest.approx(least, rel=1e-3)
    # Contact sequences of balls begin in flight.
    with pytest.raises(ScenarioError, match="got one against a wall, expected both away"):
        Planner(shipped).plan(**lies)


def make_room(start: list[float], velocity: list[float], goal: list[float]) -> Scenario:
    return dataclasses.replace(
        Scenario.named("room_with_block/around"),
        initial_position=start,
        initial_velocity=velocity,
        goal_position=goal,
        duration=2.25,
        time_step=0.0375,
        restitution=1.0,
    )


@pytest.mark.parametrize("name", ["floor/rebound", *slow("room/two_walls", "corridor/six_bounces")])
def test_the_first_shot_bounces_where_the_best_plan_does(name: str) -> None:
    scenario = dataclasses.replace(Scenario.named(name), restitution=1.0)
    best, world = plan(scenario, QUICK), World.from_scenario(scenario)
    task = world.place(scenario)
    first, again = (next(draw_shots(world, task, best.cost, 20)) for _ in range(2))
    assert list(first.bounce_contacts) == [each.index for each in best.best.contacts]
    assert again.positions.tolist() == first.positions.tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("start", "velocity", "goal", "most"),
    [
        # Shooting from controls knows 5.464e-5 of the first; both cost 7.1e-4 and 2.1e-4 by
        # boxes, contacts of the uncontrolled motion and neighbors of both alone.
        ([0.145087603, 0.54855293], [1.097545529, 1.473706911], [0.46478135, 0.224210219], 5.5e-5),
        (
            [0.578529358, 0.131142048],
            [-0.066247519, -1.72720329],
            [0.811419244, 0.587697358],
            5.1e-5,
        ),
    ],
)
def test_a_motion_that_passes_a_corner_on_its_other_side_is_found(
    start: list[float], velocity: list[float], goal: list[float], most: float
) -> None:
    found = plan(make_room(start, velocity, goal), QUICK)
    assert found.holds
    assert found.cost < most


@cache
def pose_task(name: str) -> MechanismTask:
    scenario = Scenario.named(name)
    return make_mechanism_task(World.from_scenario(scenario), scenario, PlanOptions())


@pytest.mark.parametrize("name", ["cart_pole/soft_06", "acrobot/swing_up", "paddle/bat"])
def test_the_same_draw_gives_the_same_bits_from_the_start_within_bounds(name: str) -> None:
    task = pose_task(name)
    start = np.concatenate([task.scenario.initial_position, task.scenario.initial_velocity])
    for start_name in task.guesses.starts:
        one, other = (task.guesses.draw(start_name, np.random.default_rng(7)) for _ in range(2))
        np.testing.assert_array_equal(one.controls, other.controls)
        assert np.all(one.controls >= task.bounds.control[0])
        assert np.all(one.controls <= task.bounds.control[1])
        if one.states is not None:
            np.testing.assert_allclose(one.states[0], start, atol=1e-12)


def test_lines_lead_to_the_goal_from_both_sides_where_turns_do_not_count() -> None:
    task = pose_task("cart_pole/soft_06")
    ends = [task.guesses.plain(start).states for start in ("line", "turn")]
    angles = [states[-1, 1] for states in ends if states is not None]
    assert abs(angles[0] - angles[1]) == pytest.approx(2 * np.pi)
    assert np.cos(angles[0]) == pytest.approx(np.cos(task.scenario.goal_position[1]))
    exact = dataclasses.replace(task.scenario, angles="exact")
    assert "turn" not in MechanismTask(task.world, exact, PlanOptions()).guesses.starts


def slide(length: float, mass: float, time: float, damping: float = 0.0) -> tuple[World, Scenario]:
    """Returns a ball on a rail before a wall, in other units of length, mass and time."""
    world = build_world(
        link("ball", mass, ">0 0 0 0 0 0", shape=sphere("ball", "0 0 0", radius=0.1 * length))
        + joint("prismatic", "world", "ball", "1 0 0", brake(damping))
        + wall(plane("wall", "0 0 0 0 1.5707963267948966 0"))
    )
    scenario = Scenario(
        model="ball",
        initial_position=[length],
        initial_velocity=[-length / time],
        goal_position=[2 * length],
        duration=2 * time,
        time_step=0.05 * time,
        contact="compliant",
    )
    return world, scenario


@pytest.mark.parametrize("units", [(10.0, 1.0, 1.0), (1.0, 0.01, 1.0), (1.0, 1.0, 100.0)])
def test_units_scale_with_lengths_masses_and_times_and_with_nothing_else(units: Any) -> None:
    length, _, time = units
    one, other = (Measures.of(*slide(*each)) for each in ((1.0, 1.0, 1.0), units))
    np.testing.assert_allclose(other.position, length * one.position)
    np.testing.assert_allclose(other.velocity, length / time * one.velocity)
    assert other.length == pytest.approx(length * one.length)
    assert other.speed == pytest.approx(length / time * one.speed)


def brake(damping: float) -> str:
    return f"<dynamics><damping>{damping}</damping></dynamics>"


@pytest.mark.parametrize("damping", [0.01, 1.0, 100.0])
@pytest.mark.parametrize("is_in_space", [False, True])
def test_the_scale_of_controls_moves_by_the_unit_in_the_duration_whatever_brakes(
    damping: float, is_in_space: bool, tmp_path: Path
) -> None:
    world, scenario = slide(1.0, 1.0, 1.0, damping)
    scenario = dataclasses.replace(scenario, contact="rigid")
    if is_in_space:
        text = ball_and_finger().replace(brake(0.2), brake(damping))
        scenario = make_scenario(tmp_path, text)
        world = SpaceWorld.from_scenario(scenario)
        scenario = world.place(scenario)
    problem = make_mechanism_task(world, scenario, PlanOptions()).shooting(20)
    i, T = int(np.argmax(world.actuation[:, 0])), scenario.duration
    m = world.calc_mass_matrix(scenario.initial_position)[i, i]
    # From rest, as m v̇ = u − d v.
    decay = m / damping
    way = problem.control_scales[0] / damping * (T - decay * (1 - np.exp(-T / decay)))
    assert 0.5 < way / problem.scales[i] < 1.0


def test_servos_are_no_forces_that_move_a_mechanism_without_control() -> None:
    bare = Scenario.named("acrobot/swing_up")
    held = Scenario.from_plain({**bare.to_plain(), "servos": {"*": [1e4, 1.0]}})
    one, other = (Measures.of(World.from_scenario(each), each) for each in (bare, held))
    assert other.period == pytest.approx(one.period)


def test_springs_in_place_of_rigid_walls_return_what_these_do_at_one_speed() -> None:
    law = soften(drop_ball(), RigidLaw(np.array([0.6])), 0.02, 1.5)
    assert law.stiffness[0] == pytest.approx(2.0 / 0.02**2)
    depth, speed, h = 0.0, 1.5, 1e-5  # Of its motion into the spring, without gravity.
    while depth >= 0.0:
        depth += h * speed
        push = law.stiffness[0] * depth * (1 + law.dissipation[0] * speed)
        speed -= h * push / 2.0
    assert speed == pytest.approx(-0.6 * 1.5, rel=1e-3)


FEW: dict[str, Any] = {"renewals": 0, "starts": 1, "confirm": False}
PENDULUM = Scenario.named("pendulum/off_the_wall")


@pytest.mark.parametrize(
    ("name", "share"), [("cart_pole/soft_10", 0.95), *slow(("cart_pole/rigid_10", 1.0))]
)
def test_a_motion_that_is_known_is_led_on(name: str, share: float) -> None:
    """One start alone finds less."""
    scenario = Scenario.named(name)
    known = plan(scenario, PlanOptions(renewals=8, confirm=False))
    found = plan(scenario, PlanOptions(**FEW), initial_guess=known.trajectory)
    assert str(found.best.origin) == "the given guess"
    assert found.cost < known.cost * (1 + 1e-3)
    assert found.cost < share * plan(scenario, PlanOptions(**FEW)).cost


def test_the_touches_of_a_guess_are_a_candidate_of_balls() -> None:
    scenario = Scenario.named("table1/1")
    known = plan(scenario)
    found = plan(scenario, initial_guess=known.trajectory)
    assert "the given guess" in [str(each.origin) for each in found.candidates]
    assert found.cost == pytest.approx(known.cost, rel=1e-9)


@pytest.mark.slow
def test_guesses_that_fit_nothing_are_refused_before_the_search() -> None:
    known = plan(PENDULUM, PlanOptions(**FEW))
    other = Scenario.named("cart_pole/rigid_06")
    motion = known.trajectory
    twice = dataclasses.replace(motion, times=2 * np.asarray(motion.times))
    refused: tuple[tuple[Scenario, Any, str], ...] = (
        (PENDULUM, known, "initial_guess: got Plan, expected a Trajectory. Of a plan, give its"),
        (PENDULUM, twice, f"from 0 to {2 * PENDULUM.duration:g} s, expected from 0 to"),
        (other, motion, r"initial_guess: got \(1, 1, 1\) positions, controls and contacts"),
    )
    for scenario, guess, message in refused:
        with pytest.raises(TrajectoryError, match=message):
            plan(scenario, initial_guess=guess)


# Ten and a hundred times as large, heavy or long-lasting, and as small; where gravity counts,
# lengths go with the square of times.
ANY = (Factors(0.1, 10.0, 100.0), Factors(100.0, 0.01, 10.0), Factors(0.01, 1.0, 1.0))
FALLING = (Factors(100.0, 10.0, 10.0), Factors(0.01, 0.1, 0.1))


def check(name: str, all_factors: tuple[Factors, ...], options: PlanOptions, folder: Path) -> None:
    """Plans in each of these units, and compares."""

    def find(factors: Factors) -> Candidate:
        return plan(scale_scenario(name, folder, factors), options).best

    shipped = find(Factors(1.0, 1.0, 1.0))
    for factors in all_factors:
        best = find(factors)
        assert best.cost == pytest.approx(shipped.cost, rel=1e-6), factors
        assert best.replay.cost == pytest.approx(shipped.replay.cost, rel=1e-6), factors
        assert [each.index for each in best.contacts] == [each.index for each in shipped.contacts]
        times = [[each.time for each in found.contacts] for found in (best, shipped)]
        assert np.array(times[0]) / factors.time == pytest.approx(times[1], rel=1e-6)


BALLS = PlanOptions(confirm=False)
FEW_STARTS = PlanOptions(confirm=False, starts=6, renewals=8, search_steps=30)


def test_a_ball_in_other_units_has_the_same_plan(tmp_path: Path) -> None:
    scenario = Scenario.named("table1/1")
    assert not needs_shooting(World.from_scenario(scenario), scenario)
    check("table1/1", ANY, BALLS, tmp_path)


@pytest.mark.slow
def test_an_acrobot_in_other_units_has_the_same_plan(tmp_path: Path) -> None:
    check("acrobot/swing_up", FALLING, FEW_STARTS, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "factors"), [("corridor/lossy", ANY), ("two_masses/apart", ANY)])
def test_balls_between_walls_in_other_units_have_the_same_plan(
    name: str, factors: tuple[Factors, ...], tmp_path: Path
) -> None:
    check(name, factors, BALLS, tmp_path)
