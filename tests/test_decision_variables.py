"""Decision variables of all transcriptions: nothing gets lost or mixed up between forms."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from replay_worlds import make_diagram, make_scenario, shipped_world
from rigid_worlds import indices

from drake_aigto import Scenario, World
from drake_aigto.errors import OptionsError
from drake_aigto.paper import LiteralTranscription
from drake_aigto.planning import BallTask, PlanOptions, Rung
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import RigidTranscription, Transcription

KINDS: dict[str, Callable[[World, Scenario], Transcription]] = {
    "literal": LiteralTranscription,
    "rigid": RigidTranscription,
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


@pytest.mark.parametrize("kind", KINDS)
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


BOUNCE = dataclasses.replace(Scenario.named("table1/3"), time_step=0.02)


def test_weights_of_rows_that_are_not_there_are_refused() -> None:
    options = PlanOptions(ladder=(Rung(1.0, {"push": 1.0}),))
    with pytest.raises(OptionsError, match="got a weight for 'push', expected names of rows: fli"):
        BallTask(RigidTranscription(shipped_world(), BOUNCE), options)


def test_what_users_add_is_kept_along_another_path() -> None:
    transcription = RigidTranscription(shipped_world(), BOUNCE)
    (u,) = transcription.input()
    transcription.AddRunningCost(1.0 * u**2, "again")
    other = transcription.again(BOUNCE, np.ones((BOUNCE.num_steps + 1, 1)))
    named = {cost.evaluator().get_description() for cost in other.prog().GetAllCosts()}
    assert "again" in named
