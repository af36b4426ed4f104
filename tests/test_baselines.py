"""Baselines: one interface, one verdict, one clock."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from replay_worlds import make_diagram, make_scenario

from benchmarks.baselines import (
    BASELINES,
    Baseline,
    BaselineRun,
    Improvement,
    Recorder,
    check_baselines,
    registry,
    run_baseline,
)
from benchmarks.baselines.gradient import GaussianSmoothing, list_sequences
from benchmarks.baselines.sampling import ControlSpace
from drake_aigto import Scenario, World, replay_event_driven
from drake_aigto.aigo import Box, minimize
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import MissingExtraError, ModelError, OptionsError
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
    """Returns one whose mass flies past the wall to its goal by itself: J* = 0."""
    return Scenario(initial_position=0.3, initial_velocity=0.5, goal_position=0.8, time_step=0.05)


@pytest.fixture(scope="module")
def bounce() -> Scenario:
    """Returns one whose optimum bounces."""
    return make_scenario(0.5, -1.5, 0.7, restitution=0.8, time_step=0.05)


def test_an_offer_is_replayed_and_only_what_is_cheaper_is_kept(
    world: World, scenario: Scenario
) -> None:
    recorder = Recorder(world, scenario, 100.0, clock=FakeClock())
    costs = [recorder.offer([0.0, 0.5, 1.0], [[u], [0.0]]) for u in (2.0, 3.0, 0.0)]
    assert costs[2] == pytest.approx(0.0, abs=1e-12) and costs[2] < costs[0] < costs[1]
    run = recorder.finish("hand")
    assert [each.cost for each in run.improvements] == [costs[0], costs[2]]
    assert run.evaluations == 3 and run.cost == costs[2] and run.claims == ()
    assert run.controls is not None and not run.controls.flags.writeable
    np.testing.assert_array_equal(run.controls, [[0.0], [0.0]])


def test_claims_are_kept_apart_from_replays(world: World, scenario: Scenario) -> None:
    recorder = Recorder(world, scenario, 100.0, clock=FakeClock())
    for claim in (3.0, 5.0, 2.0):
        recorder.offer([0.0, 1.0], [[0.0]], claim)
    run = recorder.finish("hand")
    assert [each.cost for each in run.claims] == [3.0, 2.0]
    assert len(run.improvements) == 1


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


def test_cost_within_is_what_was_known_by_then() -> None:
    found = (Improvement(1.0, 5.0), Improvement(3.0, 2.0))
    run = BaselineRun("hand", found, (), 4.0, 7, None, None)
    assert [run.cost_within(t) for t in (0.5, 1.0, 2.9, 3.0, 9.0)] == [np.inf, 5.0, 5.0, 2.0, 2.0]


def test_an_unknown_baseline_is_refused_with_all_names(world: World, scenario: Scenario) -> None:
    with pytest.raises(OptionsError, match="unknown baseline 'snop'") as caught:
        run_baseline("snop", world, scenario, 1.0)
    text = str(caught.value)
    assert all(name in text for name in BASELINES) and text.startswith("Did you mean 'snopt'? ")


def test_a_missing_library_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    class NeedsMore(Baseline):
        name, modules = "hungry", ("no_such_library",)

        def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
            raise AssertionError

    monkeypatch.setattr(registry, "BASELINES", {"hungry": NeedsMore()})
    with pytest.raises(MissingExtraError) as caught:
        check_baselines(["hungry"])
    text = (
        "the baseline 'hungry': got no module 'no_such_library', expected it to be installed. "
        "Install the extra: pip install 'drake_aigto[bench]'."
    )
    assert str(caught.value) == text
    assert str(pickle.loads(pickle.dumps(caught.value))) == text


@pytest.mark.parametrize("name", [name for name in BASELINES if "literal" not in name])
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


def test_literal_gradients_claim_what_no_rigid_wall_gives(world: World, bounce: Scenario) -> None:
    run = run_baseline("snopt literal", world, bounce, 12.5, clock=FakeClock())
    assert run.claims and run.claims[-1].cost < run.cost
    assert run_baseline("snopt", world, bounce, 4.5, clock=FakeClock()).claims == ()


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


def test_points_are_controls_of_three_straight_pieces(world: World, bounce: Scenario) -> None:
    space = ControlSpace(Recorder(world, bounce, 1.0))
    assert space.dimension == 2 + 2 * 3
    points = np.random.default_rng(5).normal(0, 2, (50, space.dimension))
    times, controls = space.decode(points)
    assert times.shape == (50, 31) and controls.shape == (50, 30, 1)
    assert np.all(times[:, 0] == 0) and np.all(times[:, -1] == bounce.duration)
    assert np.all(np.diff(times) > 0)
    # Within a piece steps are even, and controls on a line.
    steps, heights = np.diff(times).reshape(50, 3, 10), controls.reshape(50, 3, 10)
    np.testing.assert_allclose(steps, steps[..., :1] * np.ones(10), rtol=1e-9)
    np.testing.assert_allclose(np.diff(heights, 2, axis=2), 0, atol=1e-12)
    lone = space.decode(points[7])
    np.testing.assert_array_equal(lone[0][0], times[7])
    even, still = space.decode(np.zeros(space.dimension))
    np.testing.assert_allclose(even[0], np.linspace(0, 1, 31), rtol=1e-12)
    assert not np.any(still)


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
