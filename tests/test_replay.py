"""Replay: on Drake's plant, and what both replays say of a plan."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from replay_worlds import hold, make_diagram, make_scenario, shipped_world

from drake_aigto.contact import calc_dissipation, contact_delay
from drake_aigto.errors import DamagedDataError, TrajectoryError
from drake_aigto.plain import from_plain, to_plain
from drake_aigto.simulation import Replay, confirms, replay_drake, replay_event_driven
from drake_aigto.world import Scales, Scenario, World

METRE = Scales(length=1.0, time=1.0, cost=1.0)


@pytest.mark.parametrize("row", [1, 3])
def test_drakes_elastic_wall_is_late_by_its_contact_and_else_agrees(row: int) -> None:
    scenario = Scenario.named(f"table1/{row}")
    world = World.from_scenario(scenario)
    control = hold(0.3)
    rigid = replay_event_driven(world, scenario, *control)
    drake = replay_drake(world, scenario, *control)
    (touch,) = drake.bounce_times
    assert touch == pytest.approx(rigid.bounce_times[0], abs=1e-9)
    speed = math.sqrt(2 * rigid.energies_before[0])
    late = drake.velocities[-1, 0] * contact_delay(world)
    assert rigid.positions[-1, 0] - drake.positions[-1, 0] == pytest.approx(late, rel=0.1)
    assert drake.max_penetration == pytest.approx(speed * math.sqrt(1 / 1e9), rel=1e-3)
    assert drake.energy_ratio == pytest.approx(1.0, abs=3e-5)
    assert drake.matched_speeds == () and drake.bounce_contacts == (0,)
    assert np.all(np.diff(drake.times) >= 0) and len(drake.times) == len(control[0]) + 3
    assert confirms(rigid.cost, drake, Scales.of(world, scenario), rigid.goal_error)


@pytest.mark.parametrize(("e", "speed"), [(1.0, 2.0), (0.9, 20.0), (0.2, 2.0), (0, 20)])
def test_what_a_compliant_wall_does_to_the_end_is_known_beforehand(e: float, speed: float) -> None:
    world, scenario = shipped_world(), make_scenario(1.0, -speed, restitution=e, goal_weight=3.0)
    rigid = replay_event_driven(world, scenario, *hold(0.0))
    drake = replay_drake(world, scenario, *hold(0.0))
    missed = abs(rigid.positions[-1, 0] - drake.positions[-1, 0])
    least = 0.5 if e == 0.2 else 0.65
    assert least * drake.compliance_error < missed < drake.compliance_error
    assert drake.energy_ratio == pytest.approx(e**2, abs=1e-3)
    assert drake.matched_speeds == pytest.approx([speed] if e < 1 else [], rel=1e-4)
    assert rigid.compliance_error == rigid.compliance_cost == 0
    nearer = drake.goal_error - drake.compliance_error
    explained = 3.0 * (drake.goal_error**2 - max(nearer, 0.0) ** 2)
    assert drake.compliance_cost == pytest.approx(explained)


def test_only_what_compliance_explains_is_forgiven() -> None:
    world, scenario = shipped_world(), make_scenario(1.0, -40.0)
    rigid = replay_event_driven(world, scenario, *hold(0.0))
    drake = replay_drake(world, scenario, *hold(0.0))
    ends = drake.goal_error  # 4 mm short of where the rigid wall leads
    promised = ends - drake.compliance_error
    assert confirms(promised**2, drake, METRE, promised - 0.0019)
    assert not confirms(promised**2, drake, METRE, promised - 0.0021)
    assert not confirms(promised**2, rigid, METRE, promised - 0.0021)


@pytest.mark.slow
def test_drake_rests_under_a_push() -> None:
    replay = replay_drake(shipped_world(), make_scenario(0.05, 0.0, restitution=0.1), *hold(-2.0))
    # At low speeds the dissipation takes little: what is left trembles for long.
    assert abs(replay.positions[-1, 0]) < 1e-4
    assert abs(replay.velocities[-1, 0]) < 1e-2


def test_the_contact_delay_is_half_a_period_of_the_mass_on_the_pairs_stiffness() -> None:
    assert contact_delay(shipped_world()) == pytest.approx(math.pi * math.sqrt(1 / 1e9))
    assert contact_delay(shipped_world(2.0)) == pytest.approx(math.pi * math.sqrt(2 / 1e9))
    world = World.from_diagram(make_diagram(num_joints=2, stiffness=1e7))
    J = world.calc_contact_jacobian(np.zeros(2))[0]
    mass = 1 / (J @ np.linalg.solve(world.constant_inertia.mass_matrix, J))
    assert contact_delay(world) == pytest.approx(math.pi * math.sqrt(mass / 5e6))


@given(st.floats(0.05, 0.999), st.floats(0.1, 10))
def test_dissipation_solves_its_equation(e: float, speed: float) -> None:
    y = calc_dissipation(e, speed) * speed
    excess = y - math.log1p(y) + e * y + math.log1p(-e * y)
    slope = y / (1 + y) + e - e / (1 - e * y)
    assert abs(excess / slope) < 1e-9 * y


def test_dissipation_at_its_ends() -> None:
    assert calc_dissipation(1.0, 2.0) == 0.0
    below, above = (calc_dissipation(1 - 1e-4 * part, 1.0) for part in (1.001, 0.999))
    assert below / 1.001 == pytest.approx(above / 0.999, rel=1e-6)
    assert calc_dissipation(0.0, 2.0) == calc_dissipation(1e-3, 2.0) == pytest.approx(500.0)


def test_a_replay_replaces_the_diagrams_own_controller() -> None:
    driven = World.from_diagram(make_diagram(push=7.0))
    free = World.from_diagram(make_diagram())
    replays = [replay_drake(world, make_scenario(), *hold(0.0)) for world in (driven, free)]
    assert replays[0] == replays[1]


def test_the_cost_is_effort_and_goal_error() -> None:
    scenario = make_scenario(1.0, 0.0, control_weight=0.5, goal_weight=3.0)
    times, forces = [0.0, 0.1, 0.4], [[2.0], [-1.0]]
    replay = replay_event_driven(shipped_world(), scenario, times, forces)
    end = 1.0 + 2.0 * 0.1**2 / 2 + 0.2 * 0.3 - 0.3**2 / 2
    assert replay.goal_error == pytest.approx(abs(end - 0.73))
    assert replay.cost == pytest.approx(0.5 * (0.1 * 4 + 0.3 * 1) + 3.0 * (end - 0.73) ** 2)
    assert replay.energy_ratio is None and replay.energy_ratios == ()


@pytest.mark.parametrize("replay_in", [replay_event_driven, replay_drake])
def test_a_replay_survives_json(replay_in: Any) -> None:
    for q in (1.0, 3.0):  # with and without a bounce
        replay = replay_in(shipped_world(), make_scenario(q, restitution=0.5), *hold(0.1, steps=9))
        read = from_plain(Replay, json.loads(json.dumps(to_plain(replay))))
        assert read == replay and hash(read) == hash(replay)
        assert not read.positions.flags.writeable
    with pytest.raises(DamagedDataError, match=r"Replay\.cost: got nothing, expected a value"):
        from_plain(Replay, {k: v for k, v in to_plain(replay).items() if k != "cost"})


def test_the_energy_ratio_weighs_contacts_by_their_energy() -> None:
    scenario = make_scenario(0.1, restitution=0.5)
    replay = replay_event_driven(shipped_world(), scenario, *hold(-9.0))
    assert len(replay.energy_ratios) > 5
    assert replay.energy_ratio == pytest.approx(0.25)
    fields = to_plain(replay) | {
        "bounce_times": [0.1, 0.2],
        "energies_before": [2.0, 1e-6],
        "energies_after": [0.5, 1e-6],
    }
    assert from_plain(Replay, fields).energy_ratio == pytest.approx(0.25, rel=1e-5)
    # A block that is pushed from rest has no ratio, and hides none.
    pushed = fields | {"energies_before": [2.0, 1e-6], "energies_after": [0.5, 3.0]}
    assert from_plain(Replay, pushed).energy_ratio == pytest.approx(0.25)
    pushed |= {"bounce_times": [0.2], "energies_before": [1e-6], "energies_after": [3.0]}
    assert from_plain(Replay, pushed).energy_ratio is None


@pytest.mark.parametrize("replay_in", [replay_event_driven, replay_drake])
@pytest.mark.parametrize(
    ("times", "forces", "message"),
    [
        ([0.0, 1.0], [[1.0], [2.0]], r"controls: got shape \(2, 1\), expected 1 rows"),
        ([0.0, 1.0], [[1.0, 2.0]], r"controls: got shape \(1, 2\), expected 1 columns, one for e"),
        ([1.0, 0.0], [[1.0]], r"times: got 1 s, then 0 s \(knots 0 and 1\), expected strictly inc"),
        ([0.0, 1.0], [[math.nan]], r"controls: got nan at index \(0, 0\), expected finite numbers"),
    ],
)
def test_a_bad_control_is_refused(
    replay_in: Any, times: npt.ArrayLike, forces: npt.ArrayLike, message: str
) -> None:
    with pytest.raises(TrajectoryError, match=message):
        replay_in(shipped_world(), make_scenario(), times, forces)


def test_a_plan_holds_if_its_replay_costs_and_misses_little_more() -> None:
    replay = replay_event_driven(shipped_world(), make_scenario(), *hold(0.0))
    cost, error = replay.cost, replay.goal_error  # 0.0729, 0.27 m
    assert confirms(cost, replay, METRE, error) and confirms(cost, replay, METRE)
    assert confirms(2 * cost, replay, METRE, 2 * error)  # better than promised
    assert confirms(cost / 1.04, replay, METRE, error)
    assert not confirms(cost / 1.06, replay, METRE, error)
    assert confirms(cost, replay, METRE, error - 0.0019)
    assert not confirms(cost, replay, METRE, error - 0.0021)
    assert confirms(cost - 3.9e-6, replay, METRE, relative_cost=0.0)
    assert not confirms(cost - 4.1e-6, replay, METRE, relative_cost=0.0)
    assert not confirms(math.nan, replay, METRE)
    assert not confirms(cost, replay, METRE, math.nan)


@given(size=st.sampled_from([1e-3, 1e-2, 1.0, 1e3]), miss=st.floats(1e-4, 1e-2))
def test_the_verdict_is_the_same_at_every_size(size: float, miss: float) -> None:
    # The same motion a thousand times smaller, with the same miss in proportion.
    verdicts = []
    for unit in (1.0, size):
        scenario = dataclasses.replace(
            make_scenario(unit, -2.0 * unit), goal_position=0.73 * unit, time_step=0.1
        )
        scales = Scales.of(shipped_world(), scenario)
        replay = replay_event_driven(shipped_world(), scenario, *hold(0.0))
        verdicts += [
            confirms(replay.cost, replay, scales, replay.goal_error - miss * unit),
            confirms(replay.cost - (miss * unit) ** 2, replay, scales, relative_cost=0.0),
        ]
    assert verdicts[:2] == verdicts[2:]
    assert verdicts[:2] == [miss < 2e-3] * 2 or miss == pytest.approx(2e-3, rel=1e-6)
