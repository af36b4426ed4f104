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
import time
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.friction_forms import list_forms
from benchmarks.jobs import add_options, run_all, run_as
from benchmarks.listed_modes import ListOfModes
from drake_aigto import MechanismOptions, Planner, PlanningError, Scenario, World

# Seeds that settings were chosen on, and those that are reported.
_TUNING, _REPORTED = 0, 1000
_NEAR = 1e-2
# Every so many shots are planned and listed without friction, too.
_COMPARED = 5
NAMES = {1: "forward", 0: "stick", -1: "backward"}


class Job(NamedTuple):
    """One shot."""

    seed: int
    renewals: int
    is_compared: bool  # to the same without friction


class Result(NamedTuple):
    """What came of it; costs are infinite where there is no plan."""

    seed: int
    planned: float  # J of the plan's event-driven replay
    drake: float  # the same in Drake
    listed: float  # J of the list's best
    walls: int  # that the list's best touches
    modes: tuple[int, ...]  # how
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


def shoot(job: Job) -> Result:
    """Plans a shot, and lists its modes."""
    scenario = draw_shot(job.seed)
    smooth = dataclasses.replace(scenario, friction=0.0)
    begin = time.process_time()
    planned, drake = _plan(scenario, job.renewals, confirm=True)
    seconds = time.process_time() - begin
    world = World.from_scenario(scenario)
    best = ListOfModes(world, scenario).find_best(job.seed)
    without = without_listed = np.nan
    if job.is_compared:
        without = _plan(smooth, job.renewals, confirm=False)[0]
        without_listed = ListOfModes(world, smooth).find_best(job.seed).cost
    return Result(
        job.seed,
        planned,
        drake,
        best.cost,
        len(best.walls),
        best.modes,
        without,
        without_listed,
        seconds,
    )


def _plan(scenario: Scenario, renewals: int, confirm: bool) -> tuple[float, float]:
    """Returns what a plan costs in its event-driven replay and in Drake's."""
    options = MechanismOptions(renewals=renewals, confirm=confirm)
    try:
        found = Planner(scenario, options).plan()
    except PlanningError:
        return np.inf, np.inf
    drake = found.replay.drake
    return found.replay.event_driven.cost, np.nan if drake is None else drake.cost


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
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--shots", type=int, default=100, metavar="N", help="how many shots")
    parser.add_argument("--tuning", action="store_true", help="shots to choose settings on")
    parser.add_argument("--renewals", type=int, default=0, help="`MechanismOptions.renewals`")
    add_options(parser)
    options = parser.parse_args(arguments)
    forms = list_forms()
    for name, error in forms:
        print(f"{name:<58} off by {error:.1e}")
    first = _TUNING if options.tuning else _REPORTED
    jobs = [
        Job(first + number, options.renewals, number % _COMPARED == 0)
        for number in range(options.shots)
    ]
    results: list[Result] = run_all(shoot, jobs, options)
    if results:
        report(results)
    near = [each.planned <= (1 + _NEAR) * each.listed for each in results]
    is_good = max(error for _, error in forms) <= 1e-9 and sum(near) >= 0.95 * len(near)
    return int(not is_good)


if __name__ == "__main__":
    run_as("benchmarks.friction")
