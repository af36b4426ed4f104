"""Friction: closed forms, and how good plans are for shots with spin, against a list of all modes.

    python -m benchmarks.friction --shots 100 --workers 2 --minutes 30
    python -m benchmarks.friction --shots 20 --tuning      # others, to choose settings on

A shot is a random question about the shipped billiard: start, velocity, spin, goal, restitution and
μ. The list (`listed_modes`) is of all sequences of up to three walls, each touch in all modes. For
each shot the table has what the plan's event-driven replay costs above it, what Drake's costs above
that, and, of every fifth, what the plan for the same question without friction costs.
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.friction_forms import list_forms
from benchmarks.listed_modes import ListOfModes
from benchmarks.script import plan_all, read_flags, run_all, run_as
from drake_aigto import Answer, PlanOptions, Scenario, World

# Seeds that settings were chosen on, and those that are reported.
_TUNING, _REPORTED = 0, 1000
_NEAR = 1e-2
# Every so many shots are planned and listed without friction, too.
_COMPARED = 5
NAMES = {1: "forward", 0: "stick", -1: "backward"}


class Listed(NamedTuple):
    """The best of the list of a shot."""

    seed: int
    is_smooth: bool  # asked without friction
    cost: float
    modes: tuple[int, ...]  # of its touches


class Result(NamedTuple):
    """What came of it; costs are infinite where there is no plan."""

    seed: int
    planned: float  # J of the plan's event-driven replay
    drake: float  # the same in Drake
    listed: float  # J of the list's best
    modes: tuple[int, ...]  # of its touches
    smooth: float  # J of the plan without friction, NaN where it was not made
    smooth_listed: float  # of the list without friction
    seconds: float  # CPU time of the plan with friction


def draw_shot(seed: int) -> Scenario:
    """Returns a random question about the billiard."""
    rng = np.random.default_rng(seed)
    low, high = np.array([0.25, 0.25]), np.array([1.35, 0.75])
    angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 2.0)
    return dataclasses.replace(
        Scenario.named("billiard/spin_shot"),
        initial_position=np.array([*rng.uniform(low, high), 0.0]),
        initial_velocity=np.array(
            [speed * np.cos(angle), speed * np.sin(angle), rng.uniform(-20.0, 20.0)]
        ),
        goal_position=np.array([*rng.uniform(low, high), 0.0]),
        restitution=rng.uniform(0.5, 0.95),
        friction=rng.uniform(0.1, 0.6),
        control_weight=np.array([1.0, 1.0, 10 ** rng.uniform(0.0, 2.0)]),
        goal_weight=10 ** rng.uniform(0.5, 2.0) * np.array([1.0, 1.0, 0.0]),
    )


def list_modes(job: tuple[int, bool]) -> Listed:
    """Returns the best of the list of a shot, by its seed, with its friction or without."""
    seed, is_smooth = job
    scenario = draw_shot(seed)
    world = World.from_scenario(scenario)
    asked = dataclasses.replace(scenario, friction=0.0) if is_smooth else scenario
    best = ListOfModes(world, asked).find_best(seed)
    return Listed(seed, is_smooth, best.cost, best.modes)


def _collect(shots: Sequence[int], renewals: int, options: argparse.Namespace) -> Iterator[Result]:
    """Yields what came of the shots that are planned and listed."""
    compared = shots[::_COMPARED]
    jobs = [*((seed, False) for seed in shots), *((seed, True) for seed in compared)]
    scenarios = {str(seed): draw_shot(seed) for seed in shots}
    smooth = {
        str(seed): dataclasses.replace(scenarios[str(seed)], friction=0.0) for seed in compared
    }
    usual = PlanOptions(renewals=renewals, threads=1)
    plans = plan_all(scenarios, usual, options)
    unconfirmed = dataclasses.replace(usual, confirm=False)
    smooth_plans = plan_all(smooth, unconfirmed, options, "smooth_plans")
    best = {each[:2]: each for each in run_all(list_modes, jobs, options)}
    for seed in shots:
        if str(seed) not in plans or (seed, False) not in best:
            continue
        costs = _cost_of(plans[str(seed)])
        without = np.nan, np.nan
        if (seed, True) in best and str(seed) in smooth_plans:
            without = _cost_of(smooth_plans[str(seed)])[0], best[seed, True].cost
        listed = best[seed, False]
        seconds = plans[str(seed)].seconds
        yield Result(seed, *costs, listed.cost, listed.modes, *without, seconds)


def _cost_of(answer: Answer) -> tuple[float, float]:
    """Returns what a plan costs in its event-driven replay and in Drake's; infinite without one."""
    if answer.plan is None or not answer.holds:
        return np.inf, np.inf
    drake = answer.plan.replay.drake
    return answer.plan.replay.event_driven.cost, np.nan if drake is None else drake.cost


def report(results: Sequence[Result]) -> None:
    """Prints the table and its sums."""
    print(f"{'shot':>5} {'plan':>9} {'above':>8} {'Drake':>8} {'list':>9} {'mu = 0':>9} modes")
    for each in results:
        above, drake = each.planned / each.listed - 1, each.drake / each.planned - 1
        modes = ", ".join(NAMES[mode] for mode in each.modes) or "no touch"
        smooth = f"{each.smooth:>9.4f}" if each.smooth > 0 else 9 * " "
        print(
            f"{each.seed:>5} {each.planned:>9.4f} {100 * above:>7.2f}% {100 * drake:>7.2f}%"
            f" {each.listed:>9.4f} {smooth} {modes}"
        )
    compared = [each for each in results if each.smooth > 0]
    _sum_up("with friction", [each.planned / each.listed for each in results])
    _sum_up("without friction", [each.smooth / each.smooth_listed for each in compared])
    gains = [each.planned < 0.99 * each.smooth for each in compared]
    print(f"friction lowers the cost by more than 1 % in {np.sum(gains)} of {len(gains)}")
    drakes = np.abs([each.drake / each.planned - 1 for each in results])
    print(f"Drake's cost within 1 % of the plan's: {np.sum(drakes <= _NEAR)} of {len(drakes)}")
    print(f"CPU seconds a plan, median: {np.median([each.seconds for each in results]):.1f}")


def _sum_up(name: str, ratios: Sequence[float]) -> None:
    ratio = np.array(ratios)
    near, better = np.sum(ratio <= 1 + _NEAR), np.sum(ratio < 1 - _NEAR)
    print(
        f"{name}: within 1 % of the list {near} of {len(ratio)}, {100 * near / len(ratio):.0f} %;"
        f" better by more than 1 % {better}; worst {100 * (np.max(ratio) - 1):.2f} %"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints closed forms and shots; the exit status is 1 where figures are missed."""
    options = read_flags(
        __doc__,
        arguments,
        shots=(100, "how many shots", {"metavar": "N"}),
        tuning=(False, "shots to choose settings on"),
        renewals=(0, "`PlanOptions.renewals`"),
    )
    forms = list_forms()
    for name, error in forms:
        print(f"{name:<58} off by {error:.1e}")
    first = _TUNING if options.tuning else _REPORTED
    shots = range(first, first + options.shots)
    results = list(_collect(shots, options.renewals, options))
    if results:
        report(results)
    near = [each.planned <= (1 + _NEAR) * each.listed for each in results]
    is_good = max(error for _, error in forms) <= 1e-9 and sum(near) >= 0.95 * len(near)
    return int(not is_good)


if __name__ == "__main__":
    run_as("benchmarks.friction")
