"""Random scenarios: the same for everyone, and refused at once where they make no sense."""

from __future__ import annotations

import dataclasses
import itertools
import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scenario_studies import TOYS

from benchmarks.baselines import registry
from benchmarks.study.scenario_question import ScenarioQuestion, Spread
from drake_aigto.errors import AigtoError, MissingExtraError, OptionsError, ScenarioError
from drake_aigto.plain import from_plain, to_plain

FINITE = st.floats(allow_nan=False, allow_infinity=False)
LISTS = st.lists(FINITE, min_size=1, max_size=4).map(lambda values: Spread(tuple(values)))
RANGES = (
    st.tuples(FINITE, FINITE)
    .filter(lambda ends: ends[0] < ends[1])
    .map(lambda ends: Spread(ends, is_range=True))
)


@given(LISTS | RANGES)
def test_a_spread_reads_what_it_writes_bit_by_bit(spread: Spread) -> None:
    assert Spread.parse(str(spread)) == spread


@given(
    st.tuples(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6)).filter(lambda ends: ends[0] < ends[1]),
    st.floats(0.0, 1.0, exclude_max=True),
)
def test_a_range_is_not_left(ends: tuple[float, float], share: float) -> None:
    low, high = ends
    assert low <= Spread(ends, is_range=True).pick(0, share) <= high


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["1", "x"], r"values: got 1 x, expected a number, several \(1 0\.8 0\.5\), or one range"),
        (["0:1", "2"], r"got 0:1 2, expected a number, several"),
        (["1:2:3"], r"got 1:2:3, expected"),
        (["2:1"], r"range: got 2\.0:1\.0, expected low:high, the lower end first"),
        (["1:1"], r"range: got 1\.0:1\.0, expected low:high"),
        (["0:inf"], r"values: got \(0\.0, inf\), expected finite numbers"),
        ([], r"values: got none, expected finite numbers"),
    ],
)
def test_what_is_no_spread_is_refused(words: list[str], message: str) -> None:
    with pytest.raises(OptionsError, match=message):
        Spread.parse(words)


@given(st.integers(0, 2**40), st.integers(1, 6), st.integers(1, 6))
def test_a_larger_count_goes_on_where_a_smaller_one_ends(seed: int, few: int, more: int) -> None:
    small, large = (ScenarioQuestion(seed=seed, count=count) for count in (few, few + more))
    assert list(small.scenarios()) == list(large.scenarios())[:few]
    assert small.method_seed(few - 1) == large.method_seed(few - 1)


def test_scenarios_depend_on_the_seed_and_not_on_methods_or_other_quantities() -> None:
    question = ScenarioQuestion(count=20)
    starts = [scenario.initial_position[0] for scenario in question.scenarios()]
    other = dataclasses.replace(question, methods=("aigto", "snopt"), mass=Spread.parse("1:2"))
    assert starts == [scenario.initial_position[0] for scenario in other.scenarios()]
    reseeded = dataclasses.replace(question, seed=1)
    assert len({*starts, *(each.initial_position[0] for each in reseeded.scenarios())}) == 40


def test_scenarios_fill_their_ranges() -> None:
    scenarios = list(ScenarioQuestion(count=400).scenarios())
    for name, low, high in (
        ("initial_position", 0.2, 1.5),
        ("initial_velocity", -3.0, 0.5),
        ("goal_position", 0.2, 1.5),
    ):
        values = [getattr(scenario, name)[0] for scenario in scenarios]
        width = high - low
        # Of 400 draws, none in the first or last 5 % has a chance of 0.95⁴⁰⁰ = 1e-9.
        assert low <= min(values) < low + 0.05 * width
        assert high - 0.05 * width < max(values) <= high


def test_lists_are_taken_in_turn_in_all_combinations() -> None:
    question = ScenarioQuestion(
        count=12, restitution=Spread((1.0, 0.8, 0.5)), mass=Spread((1.0, 2.0))
    )
    pairs = [(scenario.restitution, scenario.mass) for scenario in question.scenarios()]
    assert [e for e, _ in pairs[:4]] == [1.0, 0.8, 0.5, 1.0]
    assert sorted(pairs) == sorted(2 * list(itertools.product((1.0, 0.8, 0.5), (1.0, 2.0))))


def test_any_duration_is_cut_into_as_many_steps() -> None:
    question = ScenarioQuestion(count=30, duration=Spread.parse("0.3:3"), num_steps=70)
    assert {scenario.num_steps for scenario in question.scenarios()} == {70}
    assert len({scenario.duration for scenario in question.scenarios()}) == 30


def test_a_question_is_the_same_after_json() -> None:
    question = ScenarioQuestion(
        count=3, goal=Spread.parse("0.1:0.30000000000000004"), methods=("aigto", "coast")
    )
    data = json.loads(json.dumps(to_plain(question)))
    assert from_plain(ScenarioQuestion, data) == question


@pytest.mark.parametrize(
    ("changes", "kind", "message"),
    [
        ({"count": 0}, OptionsError, "count: got 0, expected a whole number, 1 or more"),
        ({"count": -3}, OptionsError, "count: got -3"),
        ({"count": 2.5}, OptionsError, "count: got 2.5"),
        ({"seed": -1}, OptionsError, "seed: got -1, expected a whole number, 0 or more"),
        ({"num_steps": 0}, OptionsError, "num_steps: got 0"),
        ({"methods": ()}, OptionsError, "methods: got none"),
        ({"methods": ("coast", "coast")}, OptionsError, "methods: got coast twice"),
        ({"methods": ("cost",)}, OptionsError, "unknown baseline 'cost': expected aigto, the plan"),
        ({"methods": ("cost",)}, OptionsError, "or one of coast, crash, absent. Did you mean 'coa"),
        ({"methods": ("aigto", "absent")}, MissingExtraError, "no_such_library"),
        ({"methods": ("coast",)}, OptionsError, "seconds_per_unit: got none, expected seconds, as"),
        ({"seconds_per_unit": 0.0}, OptionsError, "seconds_per_unit: got 0.0, expected a number"),
        ({"budgets": ()}, OptionsError, "budgets: got (), expected numbers above 0"),
        ({"budgets": (0.0, 1.0)}, OptionsError, "budgets: got (0.0, 1.0), expected numbers above"),
        ({"budgets": (10.0, 1.0)}, OptionsError, "budgets: got (10.0, 1.0), expected increasing"),
        ({"start": "-0.1:1"}, ScenarioError, "start -0.1:1.0: initial_position is inside, behind"),
        ({"goal": "0:1"}, ScenarioError, "goal 0.0:1.0: goal_position is inside, behind"),
        ({"goal": "1 -2"}, ScenarioError, "goal 1.0 -2.0: goal_position is inside, behind"),
        ({"restitution": "0.5:1.5"}, ScenarioError, "restitution 0.5:1.5: restitution: got 1.5"),
        ({"mass": "0:1"}, ScenarioError, "mass 0.0:1.0: mass: got 0"),
        ({"duration": "1 0"}, ScenarioError, "duration 1.0 0.0: duration: got 0"),
    ],
)
def test_a_question_without_sense_is_refused(
    changes: dict[str, Any],
    kind: type[AigtoError],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(registry, "BASELINES", TOYS)
    spreads: dict[str, Any] = {
        name: Spread.parse(value) if isinstance(value, str) else value
        for name, value in changes.items()
    }
    with pytest.raises(kind) as error:
        ScenarioQuestion(**spreads).check()
    assert message in str(error.value)
