"""Optima of two masses between walls: ghosts, mirrors, and what their contacts ask for."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from optimum_worlds import draw, ends, seeds, solve, world_of

from benchmarks.optima import masses_optimum
from benchmarks.optima.masses_optimum import _list_sequences, _make_pair, _Sequence
from benchmarks.worlds import load_unequal
from drake_aigto.world import Scenario


@settings(max_examples=8)
@given(seeds)
def test_ghosts_that_fly_through_each_other_cost_what_listed_sequences_cost(seed: int) -> None:
    scenario = draw("two_masses", seed)
    pair, _, price = _make_pair(world_of("two_masses"), scenario)
    exact = solve("two_masses", scenario)
    cost, contacts = pair.solve_listed(most_meetings=1)
    # Listed sequences are motions, so none can be below; and all are, up to one meeting.
    assert price * cost >= exact.cost * (1 - 1e-9)
    if exact.contacts.count(1) <= 1:
        assert price * cost == pytest.approx(exact.cost, rel=1e-6, abs=1e-14)
        found = sorted(contacts)
        assert [kind for _, kind, _ in found] == list(exact.contacts)
        speeds = [speed / scenario.duration for _, _, speed in found]
        assert speeds == pytest.approx([t.impact_speed for t in exact.touches], rel=1e-3)


@settings(max_examples=30)
@given(seeds)
def test_two_masses_in_a_mirror_cost_the_same(seed: int) -> None:
    scenario = draw("two_masses", seed)
    mirrored = dataclasses.replace(
        scenario,
        initial_position=1 - scenario.initial_position[::-1],
        initial_velocity=-scenario.initial_velocity[::-1],
        goal_position=1 - scenario.goal_position[::-1],
    )
    one, other = solve("two_masses", scenario), solve("two_masses", mirrored)
    assert one.cost == pytest.approx(other.cost, rel=1e-9)
    assert [2 - contact for contact in one.contacts] == list(other.contacts)


@pytest.mark.parametrize(("ratio", "e"), [(3.0, 1.0), (5.0, 0.8), (0.2, 1.0), (0.3, 0.8)])
@pytest.mark.parametrize("seed", [1, 4])
def test_unequal_masses_cost_what_the_times_of_their_contacts_ask_for(
    ratio: float, e: float, seed: int
) -> None:
    scenario = draw("two_masses", seed, restitution=e)
    world = load_unequal(scenario, ratio)
    found = masses_optimum(world, scenario, most_meetings=1)
    contacts, times = list(found.contacts), np.array([touch.start for touch in found.touches])
    least = cost_of_times(scenario, ratio, contacts, times)
    assert found.cost == pytest.approx(least, rel=1e-6, abs=1e-15)
    rng = np.random.default_rng(seed)
    for size in (1e-4, 1e-2):
        for moves in rng.uniform(-size, size, (20, times.size)):
            others = times + moves
            if np.all(np.diff([0.0, *others, scenario.duration]) > 0):
                cost = cost_of_times(scenario, ratio, contacts, others)
                assert cost >= found.cost * (1 - 1e-6) - 1e-15


def cost_of_times(
    scenario: Scenario, ratio: float, contacts: list[int], times: np.ndarray
) -> float:
    """Returns the least cost of two masses that are at these contacts at these times.

    Between given times all is linear: state x = (q, v), contact c at distance g · q + φ₀, where it
    sends v to V v. Each thing that is asked for, aᵀ x(t) = b, is ∫ k(s) · u(s) ds = b − aᵀ x₀(t),
    with x₀ the motion without control and k(s) the costate that a leaves at s. So the least of
    w_u ∫ u² is w_u rᵀ (∫ k kᵀ)⁻¹ r; a miss of the goal at a price w_f adds w_u/w_f to the diagonal.
    """
    masses, T = np.array([1.0, ratio]), scenario.duration
    slopes = np.array([[1.0, 0.0], [-1.0, 1.0], [0.0, -1.0]])
    maps = []
    for contact in contacts:
        J, kick = slopes[contact], slopes[contact] / masses
        V = np.eye(2) - (1 + scenario.restitution) * np.outer(kick, J) / (J @ kick)
        maps.append(np.block([[np.eye(2), np.zeros((2, 2))], [np.zeros((2, 2)), V]]))
    asked = [
        (t, np.append(slopes[c], [0, 0]), -float(c == 2))
        for t, c in zip(times, contacts, strict=True)
    ]
    asked += [(T, np.eye(4)[i], scenario.goal_position[i]) for i in range(2)]
    can_miss = np.array([0.0] * len(times) + [1.0, 1.0])
    joints = np.array([0.0, *times, T])
    start = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    kernels, misses = [], []
    for t, row, value in asked:
        # At both ends and in the middle of each interval, for Simpson's rule.
        kernel = np.zeros((len(joints) - 1, 3, 2))
        for j in reversed(range(len(joints) - 1)):
            h = joints[j + 1] - joints[j]
            if joints[j + 1] <= t:
                for k, left in enumerate((h, h / 2, 0.0)):
                    kernel[j, k] = (row[2:] + left * row[:2]) / masses
                row = np.concatenate([row[:2], row[2:] + h * row[:2]])
                if j > 0:
                    row = row @ maps[j - 1]
        kernels.append(kernel)
        misses.append(value - row @ start)
    h = np.diff(joints)[:, np.newaxis, np.newaxis] * np.array([1, 4, 1])[:, np.newaxis] / 6
    gram = np.einsum("aijk,bijk->ab", np.array(kernels), h * np.array(kernels))
    gram += np.diag(can_miss) * scenario.control_weight / scenario.goal_weight
    return float(scenario.control_weight * np.dot(misses, np.linalg.solve(gram, misses)))


@pytest.mark.slow
def test_masses_that_stay_apart_are_two_corridors() -> None:
    scenario = draw(
        "two_masses",
        0,
        initial_position=[0.2, 0.8],
        initial_velocity=[-0.5, 0.5],
        goal_position=[0.3, 0.7],
        restitution=0.5,
    )
    corridors = [draw("corridor", 0, restitution=0.5, **ends(scenario, axis)) for axis in range(2)]
    cost = sum(solve("corridor", each).cost for each in corridors)
    assert solve("two_masses", scenario).cost == pytest.approx(cost, rel=1e-9)


def test_a_meeting_keeps_momentum_and_loses_energy_by_restitution() -> None:
    scenario = draw("two_masses", 1, restitution=0.5)
    pair, _, _ = _make_pair(world_of("two_masses"), scenario)
    pair = dataclasses.replace(pair, masses=np.array([1.0, 3.0]), efforts=np.array([1.0, 9.0]))
    sequence = _Sequence(pair, (1,))
    z = np.array([0.4, 0.5, 1.2, -0.3])  # time, place, velocities
    before = sequence.flights.values(z)[:2, 2]
    after = sequence.flights.values(z)[2:, 1]
    assert pair.masses @ after == pytest.approx(pair.masses @ before)
    assert after[1] - after[0] == pytest.approx(0.5 * (before[0] - before[1]))


def test_listed_sequences_are_all_different_and_repeat_no_contact() -> None:
    sequences = list(_list_sequences(2))
    assert len(set(sequences)) == len(sequences) == 4 + 16 + 48
    for sequence in sequences:
        # Something that the contact feels comes between.
        for feels in ((0, 1, 2), (0, 1), (1, 2)):
            mine = [kind for kind in sequence if kind in feels]
            repeated = [one for one, other in itertools.pairwise(mine) if one == other]
            assert all(kind == 1 and len(feels) == 2 for kind in repeated)
