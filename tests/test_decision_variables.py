"""Decision variables of all transcriptions: nothing gets lost or mixed up between forms."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from box_programs import compile_program, mean_by_block
from replay_worlds import make_diagram, make_scenario, shipped_world
from rigid_worlds import indices

from drake_aigto import Scenario, World
from drake_aigto.aigo import Annealing
from drake_aigto.errors import OptionsError
from drake_aigto.paper import (
    LiteralOptions,
    LiteralSearch,
    LiteralTask,
    LiteralTranscription,
    LiteralWithForces,
    RigidWithForces,
    rigid_optimum,
)
from drake_aigto.planning import BALL_LADDER, BallSearch, BallTask, PlanOptions, Rung, run_search
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import RigidTranscription, Transcription

KINDS: dict[str, Callable[[World, Scenario], Transcription]] = {
    "literal": LiteralTranscription,
    "rigid": RigidTranscription,
    "literal, forces": LiteralWithForces,
    "rigid, forces": RigidWithForces,
}
PLANTS: list[dict[str, Any]] = [
    {},
    {"num_joints": 2},
    {"num_joints": 2, "rail": (0.0, 1.0)},
    {"num_joints": 2, "num_actuators": 1},
]


@pytest.fixture(scope="module", params=PLANTS, ids=["one", "two", "apart", "underactuated"])
def plant(request: pytest.FixtureRequest) -> tuple[World, Scenario]:
    world = World.from_diagram(make_diagram(**request.param))
    start = ([0.3, 0.6], [-0.4, -1.0]) if world.num_positions == 2 else (0.9, -1.4)
    return world, make_scenario(*start, time_step=0.1)


@pytest.fixture(params=KINDS)
def transcription(request: pytest.FixtureRequest, plant: tuple[World, Scenario]) -> Transcription:
    return KINDS[request.param](*plant)


def make_trajectory(transcription: Transcription, seed: int = 0) -> Trajectory:
    """Returns numbers by chance, all different, where the transcription has variables for them."""
    world, rng = transcription.world, np.random.default_rng(seed)
    N = transcription.num_samples() - 1
    q, v = rng.normal(size=(2, N + 1, world.num_positions))
    u = rng.normal(size=(N, world.num_actuators))
    none = np.zeros((N + 1, 1))
    return Trajectory(transcription.GetSampleTimes(), q, v, u, none, none[1:])


def test_vector_undoes_trajectory(transcription: Transcription) -> None:
    planned = make_trajectory(transcription)
    x = transcription.vector(planned)
    q, v, u = transcription.split(x)
    np.testing.assert_array_equal(q, planned.positions)
    np.testing.assert_array_equal(v, planned.velocities)
    np.testing.assert_array_equal(u, planned.controls)
    again = transcription.trajectory(x)
    np.testing.assert_array_equal(transcription.vector(again), x)
    np.testing.assert_allclose(again.times, planned.times, atol=1e-15)
    # Each knot's variables are the program's own.
    for k in (0, 3, 10):
        places = transcription.prog().FindDecisionVariableIndices(transcription.state(k))
        np.testing.assert_array_equal(x[places], np.concatenate([q[k], v[k]]))


def test_clearances_are_the_signed_distances(transcription: Transcription) -> None:
    x = transcription.vector(make_trajectory(transcription))
    rows = [
        binding
        for binding in transcription.prog().GetAllConstraints()
        if binding.evaluator().get_description() == "clearance"
    ]
    reads_two = len(transcription.world.contacts[0].signed_distance.GetVariables()) == 2
    assert len(rows) == (transcription.num_samples() if reads_two else 0)
    for binding in rows:
        assert transcription.prog().EvalBinding(binding, x) == pytest.approx(0, abs=1e-14)


def test_the_elimination_order_counts_all_variables_stage_by_stage(
    transcription: Transcription,
) -> None:
    order = transcription.elimination_order()
    np.testing.assert_array_equal(np.sort(order), np.arange(transcription.prog().num_vars()))
    prog, place = transcription.prog(), np.argsort(order)
    rank = [place[prog.FindDecisionVariableIndices(transcription.state(k))] for k in range(11)]
    assert all(np.max(a) < np.min(b) for a, b in pairwise(rank))
    # Whatever one row reads is near each other.
    spread = [
        np.ptp(place[prog.FindDecisionVariableIndices(binding.variables())])
        for binding in prog.GetAllConstraints()
        if binding.evaluator().get_description() not in ("initial state", "duration", "")
    ]
    assert max(spread) <= 2 * prog.num_vars() / 11 + 2


@pytest.mark.parametrize("kind", ["literal", "rigid"])
def test_the_first_box_holds_the_start_the_straight_way_and_bounds(
    kind: str, plant: tuple[World, Scenario]
) -> None:
    world, scenario = plant
    transcription = KINDS[kind](world, scenario)
    transcription.AddConstraintToAllKnotPoints(transcription.input()[0] <= 0.5)
    center, half_width = transcription.initial_box()
    low, high = center - half_width, center + half_width
    q, _, u, s = indices(transcription)
    nq = world.num_positions
    way = np.linspace(scenario.initial_position, scenario.goal_position, 11)
    assert np.all(low[q].reshape(11, nq) <= way + 1e-15)
    assert np.all(way <= high[q].reshape(11, nq) + 1e-15)
    start = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    places = transcription.prog().FindDecisionVariableIndices(transcription.state(0))
    np.testing.assert_array_equal(low[places], start)
    np.testing.assert_array_equal(high[places], start)
    assert high[u].reshape(10, -1)[:, 0] == pytest.approx(0.5)
    assert np.all(half_width[np.setdiff1d(np.arange(center.size), places)] > 0)
    # It ends at the wall, in those variables that say where that is.
    if s.size:
        distances = way @ world.calc_contact_jacobian(way[0])[0]
        assert np.all(low[s] <= distances)
        assert np.all(distances <= high[s])
        assert np.max(np.abs(low[s][1:])) < 1e-15
    else:
        assert np.max(np.abs(low[q].reshape(11, nq)[1:, -1])) < 1e-15


# The optimum bounces, and boxes of the hot rung find it without forces as variables.
BOUNCE = dataclasses.replace(Scenario.named("table1/3"), time_step=0.02)
HOT = BALL_LADDER[0]


@pytest.mark.parametrize("relaxation", [0.0, 0.3])
def test_the_mean_of_the_contact_row_is_that_of_fig_1_and_least_at_zero(relaxation: float) -> None:
    # Two steps: the only products are φ_1 p_1, and p_0 for the start. The mass is 1 kg.
    scenario = make_scenario(1.0, -2.0, time_step=0.5)
    transcription = RigidWithForces(shipped_world(), scenario, relaxation)
    f = compile_program(transcription.penalized(), transcription.elimination_order())
    center, half_width = np.zeros((2, f.num_variables))
    q1 = transcription.prog().FindDecisionVariableIndex(transcription.state(1)[0])
    p1 = transcription.impulse_indices()[1]
    L, w_q, w_p = transcription.length_scale(), 0.7, 1.3
    half_width[[q1, p1]] = w_q, w_p
    pushed = scenario.time_step * relaxation * L**2 / scenario.duration**2
    means = {}
    for phi in (-0.5, 0.0, 0.2, 0.9):
        for p in (-1.0, 0.0, 0.4, 2.0):
            center[[q1, p1]] = phi, p
            means[phi, p] = mean_by_block(f, center, half_width)["contact"]
            closed = (phi**2 + w_q**2 / 3) * (p**2 + w_p**2 / 3) - 2 * pushed * phi * p + pushed**2
            unit = scenario.num_steps * (scenario.duration / L**2) ** 2
            assert means[phi, p] == pytest.approx(closed * unit, rel=1e-12)
    assert relaxation or min(means, key=lambda at: means[at]) == (0.0, 0.0)


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_the_first_box_is_as_wide_as_asked_and_holds_no_pull(share: float) -> None:
    transcription = RigidWithForces(shipped_world(), BOUNCE, impulse_width=share)
    center, half_width = transcription.initial_box()
    turned = 4 * transcription.length_scale() / BOUNCE.duration
    where = transcription.impulse_indices()
    np.testing.assert_allclose((center + half_width)[where[1:]], share * turned)
    np.testing.assert_allclose((center - half_width)[where], 0.0, atol=1e-12)
    q, v, _ = transcription.split(center)
    grown, late = (transcription.box_around(q, v, share=0.7), where[5:])
    growth = (np.arange(5, len(where)) / len(where)) ** 2
    np.testing.assert_allclose(np.add(*grown)[late], 0.7 * share * turned * growth, rtol=1e-12)


def read(transcription: RigidTranscription, rung: Rung) -> tuple[int, float]:
    """Returns how many contacts the last box shows, and its largest impulse.

    Annealed slowly, so that what is seen is the transcription's doing.
    """
    problem = BallTask(transcription)
    start = rung.temperature * transcription.cost_scale()
    slowly = Annealing(initial_temperature=start, final_temperature=1e-7 * start)
    result = problem.run_aigo(rung, algorithm=slowly)
    impulses = transcription.impulses(result.box.center)
    return len(problem.find_sequences(result, rung)[0]), float(np.max(impulses))


@pytest.mark.parametrize("row", [1, 4])
def test_plans_collapse_where_those_without_forces_bounce(row: int) -> None:
    world = shipped_world()
    scenario = dataclasses.replace(Scenario.named(f"table1/{row}"), time_step=0.02)
    assert len(rigid_optimum(world, scenario).bounce_times) == 1
    contacts, largest = read(RigidTranscription(world, scenario), HOT)
    assert contacts == 1
    for impulse_width in (0.01, 1.0):
        collapsed = RigidWithForces(world, scenario, impulse_width=impulse_width)
        found, remaining = read(collapsed, HOT)
        assert found == 0
        assert remaining < 0.05 * largest


def test_they_do_not_always_collapse() -> None:
    light = {"dynamics": 30.0, "contact": 30.0, "restitution": 0.02}
    rung = dataclasses.replace(HOT, weights={**HOT.weights, **light})
    assert read(RigidWithForces(shipped_world(), BOUNCE), rung)[0] == 1


def test_a_plan_with_forces_is_polished_like_any_other() -> None:
    search = BallSearch(
        BallTask(RigidWithForces(shipped_world(), BOUNCE), PlanOptions(exhaustive=True))
    )
    found = run_search(search, BOUNCE)
    exact = rigid_optimum(shipped_world(), BOUNCE).cost
    assert found.replay.event_driven.cost == pytest.approx(exact, rel=1e-3)
    # The boxes around the coasting motion start in the bounce; those around the line lose it.
    assert found.stats.box_contacts == (0, 0, 0, 1, 1)


def test_literal_plans_with_forces_keep_the_penalty_of_their_row() -> None:
    ladder = (Rung(1e-4, {"contact": 1e4, "kinematics": 1e3, "dynamics": 1e-2}),)
    options = LiteralOptions(ladder=ladder, knot_steps=())
    search = LiteralSearch(LiteralTask(LiteralWithForces(shipped_world(), BOUNCE), options))
    search.run()
    best = search.find_feasible()[0]
    assert max(best.defects.values()) < 1e-6
    assert {"dynamics", "kinematics"} < set(best.defects)


@pytest.mark.parametrize("transcribe", [RigidWithForces, LiteralWithForces])
@pytest.mark.parametrize("width", [0.0, -1.0, np.inf, np.nan])
def test_widths_that_are_none_are_refused(transcribe: Any, width: float) -> None:
    with pytest.raises(OptionsError, match=r"impulse_width: got .*, expected a number above 0"):
        transcribe(shipped_world(), BOUNCE, impulse_width=width)


def test_weights_of_impulse_rows_need_impulses_as_variables() -> None:
    options = PlanOptions(ladder=(Rung(1.0, {"push": 1.0}),))
    BallTask(RigidWithForces(shipped_world(), BOUNCE), options)
    with pytest.raises(OptionsError, match="got a weight for 'push', expected names of rows: fli"):
        BallTask(RigidTranscription(shipped_world(), BOUNCE), options)


@pytest.mark.parametrize("kind", ["rigid", "rigid, forces"])
def test_what_users_add_is_kept_along_another_path(kind: str) -> None:
    transcription: Any = KINDS[kind](shipped_world(), BOUNCE)
    transcription.impulse_width = 0.3
    (u,) = transcription.input()
    transcription.AddRunningCost(1.0 * u**2, "again")
    other = transcription.again(BOUNCE, np.ones((BOUNCE.num_steps + 1, 1)))
    named = {cost.evaluator().get_description() for cost in other.prog().GetAllCosts()}
    assert "again" in named
    assert type(other) is type(transcription)
    assert getattr(other, "impulse_width", 0.3) == 0.3
