"""Baselines: one interface, one verdict, one clock."""

from __future__ import annotations

import numpy as np
import pytest
from marks import slow
from replay_worlds import make_diagram, make_scenario

from benchmarks.baselines import BASELINES, Recorder, run_baseline
from benchmarks.baselines.gradient import GaussianSmoothing, list_sequences
from benchmarks.baselines.sampling import ControlSpace
from drake_aigto import Scenario, World, replay_event_driven
from drake_aigto.aigo import Box, minimize
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import ModelError, OptionsError
from drake_aigto.paper import rigid_optimum
from drake_aigto.terms import Factor, FunctionKind, Term, TermBlock

# Readings of the clock in the longest step of any baseline.
MOST_LATE = 10.0
# Of which a single step takes long.
SLOW = ("snopt", "ipopt", "smoothing", "enumeration")


class FakeClock:
    """Seconds that only pass when they are asked for."""

    def __init__(self, tick: float = 1.0) -> None:
        self.now, self._tick = 0.0, tick

    def __call__(self) -> float:
        self.now += self._tick
        return self.now


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario(initial_position=0.3, initial_velocity=0.5, goal_position=0.8, time_step=0.05)


@pytest.fixture(scope="module")
def bounce() -> Scenario:
    return make_scenario(0.5, -1.5, 0.7, restitution=0.8, time_step=0.05)


def test_an_offer_is_replayed_and_only_what_is_cheaper_is_kept(
    world: World, scenario: Scenario
) -> None:
    recorder = Recorder(world, scenario, 100.0, clock=FakeClock())
    costs = [recorder.offer([0.0, 0.5, 1.0], [[u], [0.0]]) for u in (2.0, 3.0, 0.0)]
    assert costs[2] == pytest.approx(0.0, abs=1e-12) and costs[2] < costs[0] < costs[1]
    run = recorder.finish("hand")
    assert [each.cost for each in run.improvements] == [costs[0], costs[2]]
    assert run.evaluations == 3 and run.cost == costs[2]
    assert run.controls is not None and not run.controls.flags.writeable
    np.testing.assert_array_equal(run.controls, [[0.0], [0.0]])


def test_it_is_over_when_time_is_up_or_the_best_is_good_enough(
    world: World, scenario: Scenario
) -> None:
    recorder = Recorder(world, scenario, 2.5, clock=FakeClock())
    assert [recorder.is_over for _ in range(3)] == [False, False, True]
    patient = Recorder(world, scenario, 1e9, good_enough=1e-7, clock=FakeClock())
    assert not patient.is_over
    patient.offer([0.0, 1.0], [[0.0]])
    assert patient.is_over


@pytest.mark.parametrize("seconds", [0.0, -1.0, np.inf, np.nan])
def test_time_has_to_be_a_positive_number(world: World, scenario: Scenario, seconds: float) -> None:
    with pytest.raises(OptionsError, match=r"seconds: got .*, expected a finite number above 0"):
        Recorder(world, scenario, seconds)


RIGID = [name for name in BASELINES if "literal" not in name]
QUICK = [name for name in RIGID if not name.startswith(SLOW)]


@pytest.mark.parametrize("name", [*QUICK, *slow(*(name for name in RIGID if name not in QUICK))])
def test_every_rigid_baseline_finds_that_nothing_is_to_be_done(
    world: World, scenario: Scenario, name: str
) -> None:
    run = run_baseline(name, world, scenario, 1e6, 2, good_enough=1e-7, clock=FakeClock())
    assert run.method == name and run.cost <= 1e-7


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "ipopt")) for name in BASELINES]
)
def test_offers_depend_on_the_seed_and_end_soon_after_time_is_up(
    world: World, bounce: Scenario, name: str
) -> None:
    # The clock ticks whenever it is asked, so that both runs end after the same work.
    seconds = 3.5 if name.startswith(SLOW) else 20.5
    one, other = (run_baseline(name, world, bounce, seconds, 3, clock=FakeClock()) for _ in "12")
    assert one.improvements == other.improvements and one.evaluations == other.evaluations > 0
    np.testing.assert_array_equal(one.controls, other.controls)
    # One step may be under way when time is up; its offers ask the clock, too.
    assert one.seconds <= seconds + MOST_LATE
    exact = rigid_optimum(world, bounce).cost
    assert all(each.cost >= (1 - 1e-9) * exact for each in one.improvements)
    if name != "enumeration":
        third = run_baseline(name, world, bounce, seconds, 4, clock=FakeClock())
        assert third.improvements[0].cost != one.improvements[0].cost


def test_lists_hold_every_order_of_contacts_once_for_each_set_of_times() -> None:
    corridor = World.from_scenario(Scenario.named("corridor/lossy"))
    listed = list(list_sequences(corridor, 2.0))
    assert len(listed) == len(set(listed)) and listed[0] == ()
    # Two walls take turns, from either: 2 orders of each of 6 lengths, 3 sets of times.
    assert len(listed) == 1 + 2 * 6 * 3
    for sequence in listed:
        times = [touch.start for touch in sequence]
        assert times == sorted(times) and all(0 < t < 2.0 for t in times)


def test_smoothing_ends_at_the_bottom_of_a_bowl() -> None:
    bowl = TermBlock("bowl", (Term(1.0, (Factor(0, FunctionKind.POWER, 2, 1.0, -3.0),)),), [[0]])
    f = BoxPolynomial(2, (bowl,))
    box = Box(np.array([0.0, 7.0]), np.array([2.0, 0.0]))
    smoothing = GaussianSmoothing(seed=1)
    result = minimize(f, box, smoothing)
    # c = 3 but for the last noise, σ D = 0.02; what is held stays.
    assert result.box.center == pytest.approx([3.0, 7.0], abs=0.1)
    assert result.box.half_width == pytest.approx(smoothing.last * box.half_width)
    again = minimize(f, box, smoothing)
    np.testing.assert_array_equal(again.box.center, result.box.center)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.8, 1.0])
def test_a_space_costs_what_replays_do(world: World, restitution: float) -> None:
    scenario = Scenario(
        initial_position=0.3, initial_velocity=-2.0, goal_position=0.7, restitution=restitution
    )
    space = ControlSpace(Recorder(world, scenario, 1.0))
    # Many press the mass to the wall, or bounce more than once.
    points = np.random.default_rng(2).normal(-0.5, 2, (40, space.dimension))
    replays = [
        replay_event_driven(world, scenario, times, controls)
        for times, controls in zip(*space.decode(points), strict=True)
    ]
    assert max(len(replay.bounce_times) for replay in replays) > 1
    expected = [replay.cost for replay in replays]
    np.testing.assert_allclose(space.costs(points), expected, rtol=1e-9)


def test_a_space_offers_its_best_and_not_what_is_hardly_better(
    world: World, bounce: Scenario
) -> None:
    recorder = Recorder(world, bounce, 1.0)
    space = ControlSpace(recorder)
    points = np.random.default_rng(2).normal(0, 0.3, (40, space.dimension))
    costs = space.costs(points)
    assert recorder.run.evaluations == 1 and recorder.cost == pytest.approx(np.min(costs), rel=1e-9)
    space.costs(points)
    assert recorder.run.evaluations == 1


def test_sampling_refuses_flights_that_are_no_parabolas() -> None:
    world = World.from_diagram(make_diagram(spring=150.0))
    with pytest.raises(ModelError, match=r"the bias h\(q, v\): got .*, expected a constant\. Exac"):
        run_baseline("mppi", world, make_scenario(0.4, 0.0), 1.0)
