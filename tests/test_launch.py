"""Starts inside of walls that yield: where boxes begin, and in which steps."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drake_aigto.planning import Aim, Launch, MechanismRung, MechanismTask, PlanOptions, Renewal
from drake_aigto.world import Scenario, World

# 0.37 m deep in the right wall, and free.
DEEP, FREE = {"initial_position": [0.77, 0.24]}, {"initial_position": [0.2, 0.24]}


def pose(**changes: Any) -> MechanismTask:
    changes = {"initial_velocity": [-0.7, 1.2], **changes}
    scenario = replace(Scenario.named("cart_pole/soft_06"), **changes)
    return MechanismTask(World.from_scenario(scenario), scenario, PlanOptions())


def test_boxes_begin_where_a_wall_has_thrown_the_start_off() -> None:
    problem = pose(**DEEP)
    launch, coast = problem.launch, problem.coast
    distances = problem.world.calc_signed_distance(coast.states[: launch.knot + 1, :2])
    assert launch.knot > 0 and launch.time == coast.times[launch.knot]
    assert np.all(distances[:-1].min(axis=1) < 0) and np.all(distances[-1] > 0)
    assert launch.velocity[1] < -10
    np.testing.assert_array_equal(np.hstack(launch[2:]), coast.states[launch.knot])


def test_boxes_begin_at_a_start_that_touches_nothing() -> None:
    launch = pose(**FREE).launch
    assert (launch.knot, launch.time) == (0, 0.0)
    np.testing.assert_array_equal(np.hstack(launch[2:]), [0.2, 0.24, -0.7, 1.2])


@pytest.mark.parametrize(
    "changes",
    [
        {"duration": 0.3},  # of which the throw takes longer than a tenth
        {"duration_range": [1.0, 2.0]},
    ],
    ids=["late", "free duration"],
)
def test_boxes_begin_at_the_start_where_a_throw_is_long_or_durations_are_free(
    changes: dict[str, Any],
) -> None:
    assert pose(**DEEP, **changes).launch.knot == 0


def test_what_boxes_show_lasts_from_the_throw_to_the_end_and_is_closed_from_the_start() -> None:
    problem = pose(**DEEP)
    center = problem.run_aigo(MechanismRung(temperatures=1, newton_steps=3))
    assert center.times[0] == problem.launch.time
    assert center.times[-1] == pytest.approx(1.5, abs=1e-12)
    np.testing.assert_allclose(center.positions[0], problem.launch.position)
    np.testing.assert_allclose(center.velocities[0], problem.launch.velocity)
    closed = problem.close(center, Aim())
    np.testing.assert_array_equal(closed.times, problem.coast.times)
    np.testing.assert_array_equal(closed.states[0], problem.coast.states[0])
    stretch = Renewal(first=1, count=3, shift=np.zeros(2), newton_steps=3)
    renewed = problem.renew(closed, stretch)
    assert renewed.times[0] == problem.launch.time and renewed.times[-1] == center.times[-1]


def test_what_turns_fast_once_thrown_off_is_renewed_in_shorter_steps() -> None:
    assert pose(**FREE).renewal_steps == 15
    assert pose(**DEEP).renewal_steps == 30  # 28 rad to turn

    turning = Launch(1, 0.5, np.zeros(2), np.array([99.0, -10.0]))
    steps = 0.05, 0.1, 0.11, 0.4
    assert [turning.find_haste(each, np.array([False, True])) for each in steps] == [1, 1, 2, 4]
    assert turning.find_haste(1.0, np.array([False, False])) == 1


def test_patience_is_twice_as_long_where_what_was_thrown_off_turns_fast() -> None:
    assert pose(**FREE).patience == PlanOptions().patience
    assert pose(**DEEP).patience == 2 * PlanOptions().patience
