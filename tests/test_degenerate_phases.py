"""Contact sequences that degenerate: touches at the ends, that merge, of any scale."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from phase_solutions import bouncing, check_clock, one_bounce, optimise, solve
from replay_worlds import make_scenario, shipped_world

from drake_aigto import Scenario
from drake_aigto.errors import OptionsError
from drake_aigto.planning import PhaseProblem
from drake_aigto.transcription import Touch, TouchSequence


@pytest.mark.parametrize("e", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("guess", [1e-4, 5e-4, 0.01])
def test_a_bounce_right_after_the_start(e: float, guess: float) -> None:
    exact, time, _ = one_bounce(1e-3, -2.0, 0.73, e)
    assert time < 1e-3
    bounce = optimise(shipped_world(), bouncing(e, 50, q=1e-3), Touch.bounce(guess))
    assert bounce.cost == pytest.approx(exact, rel=1e-3)
    (touch,) = bounce.sequence
    assert touch.start == pytest.approx(time, rel=1e-3)
    assert bounce.replay().cost == pytest.approx(bounce.cost, rel=1e-9)


@pytest.mark.parametrize("e", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("guess", [0.9, 0.999])
def test_a_bounce_right_before_the_end(e: float, guess: float) -> None:
    # Control is so dear that it comes to the wall nearly by itself, too late to turn back.
    scenario = dataclasses.replace(bouncing(e, 50, v=-1.001), control_weight=1e3)
    bounce = optimise(shipped_world(), scenario, Touch.bounce(guess))
    (touch,) = bounce.sequence
    assert 0.998 < touch.start < 1.0
    assert bounce.cost == pytest.approx(0.73**2, rel=5e-3)
    assert bounce.replay().cost == pytest.approx(bounce.cost, rel=1e-7)


@pytest.mark.parametrize("e", [1.0, 0.8, 0.0])
@pytest.mark.parametrize(
    "touches",
    [
        (Touch.bounce(0.5), Touch.bounce(0.52)),
        (Touch.bounce(0.3), Touch.bounce(0.8)),
        (Touch(0.4, 0.6),),
        (Touch(0.4, 0.6), Touch.bounce(0.8)),
        (Touch.bounce(0.4), Touch(0.6, 0.8)),
        (Touch.bounce(0.2), Touch.bounce(0.4), Touch.bounce(0.6)),
    ],
    ids=["two close", "two", "lasts", "lasts, bounce", "bounce, lasts", "three"],
)
def test_touches_that_had_better_merge_stay_apart_and_feasible(
    touches: TouchSequence, e: float
) -> None:
    scenario = bouncing(e, 50)
    found = solve(PhaseProblem(shipped_world(), scenario, touches))
    check_clock(found)
    assert max(found.defects.values()) < 1e-8
    assert len(found.sequence) == len(touches)
    # One bounce is better, and a plan that is feasible is not better than it promises.
    assert found.cost > one_bounce(1.0, -2.0, 0.73, e)[0]
    assert found.replay().cost == pytest.approx(found.cost, rel=1e-4)


@pytest.mark.parametrize(
    ("length", "duration"), [(1e-3, 1e-3), (1e-3, 1), (1, 1e-3), (1, 1e3), (1e3, 1), (1e3, 1e3)]
)
def test_scales_do_not_matter(length: float, duration: float) -> None:
    scenario = Scenario(
        initial_position=length,
        initial_velocity=-2.0 * length / duration,
        goal_position=0.73 * length,
        duration=duration,
        time_step=duration / 40,
        goal_weight=1 / length**2,
        control_weight=1e-3 * duration**3 / length**2,
        restitution=0.8,
    )
    bounce = optimise(shipped_world(), scenario, Touch.bounce(0.5 * duration))
    exact, time, _ = one_bounce(1.0, -2.0, 0.73, 0.8)
    assert bounce.cost == pytest.approx(exact, rel=1e-3)
    assert bounce.sequence[0].start == pytest.approx(time * duration, rel=1e-3)
    assert bounce.replay().cost == pytest.approx(bounce.cost, rel=1e-4)


def test_each_phase_gets_a_step_though_it_is_short() -> None:
    scenario = make_scenario(time_step=0.2)
    touches = Touch.bounce(1e-9), Touch(0.5, 0.5 + 1e-9), Touch.bounce(1 - 1e-9)
    with pytest.raises(OptionsError) as error:
        PhaseProblem(shipped_world(), scenario, (*touches[:2], Touch.bounce(0.7), touches[2]))
    assert str(error.value) == (
        "sequence: got 6 phases, expected at most the 5 steps of the scenario."
    )
    phases = PhaseProblem(shipped_world(), scenario, touches)
    guess = phases.guess(np.zeros((4, 1)))
    np.testing.assert_allclose(guess.times, [0, 1e-9, 0.5, 0.5 + 1e-9, 1 - 1e-9, 1])


@pytest.mark.parametrize(
    ("touches", "times"),
    [
        ((Touch.bounce(0.0),), "[0.0]"),
        ((Touch.bounce(1.0),), "[1.0]"),
        ((Touch.bounce(1.5),), "[1.5]"),
        ((Touch.bounce(-0.5),), "[-0.5]"),
        ((Touch(0.5, 1.0),), "[0.5, 1.0]"),
        ((Touch.bounce(0.6), Touch.bounce(0.4)), "[0.6, 0.4]"),
        ((Touch.bounce(0.6), Touch.bounce(0.6)), "[0.6, 0.6]"),
        ((Touch(0.2, 0.6), Touch.bounce(0.5)), "[0.2, 0.6, 0.5]"),
    ],
)
def test_times_out_of_order_or_outside_are_refused(touches: TouchSequence, times: str) -> None:
    with pytest.raises(OptionsError) as error:
        PhaseProblem(shipped_world(), make_scenario(), touches)
    assert str(error.value) == (
        f"sequence: got contacts at {times} s, expected increasing times between 0 and 1 s."
    )
