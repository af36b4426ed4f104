"""Friction: closed forms, and how good plans are for shots with spin, against a list of all modes.

    python -m benchmarks.friction --shots 100 --workers 2 --minutes 30
    python -m benchmarks.friction --shots 20 --tuning      # others, to choose settings on

A shot is a random question about the shipped billiard: start, velocity, spin, goal, restitution and
μ. The list (`listed_modes`) is of all sequences of up to three walls, each touch in all modes. For
each shot the table has what the plan's event-driven replay costs above it, what Drake's costs above
that, and, of every fifth, what the plan for the same question without friction costs.

Slides, rolls and impacts with friction, against what calculus says of them.
"""

from __future__ import annotations

import argparse
import dataclasses
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from benchmarks.listed_modes import ListOfModes
from benchmarks.script import plan_all, read_flags, run_all, run_as
from drake_aigto import PlanOptions, Scenario, World, replay_event_driven
from drake_aigto.arrays import Floats
from drake_aigto.contact import Mobility, calc_impulse
from drake_aigto.jobs import Answer
from drake_aigto.simulation import Replay

_RADIUS, _MU, _G = 0.1, 0.3, 9.81
_NOTHING = """<inertial><mass>0</mass>
  <inertia><ixx>0</ixx><iyy>0</iyy><izz>0</izz></inertia></inertial>"""
_MATERIAL = f"""<drake:proximity_properties>
  <drake:point_contact_stiffness>2e9</drake:point_contact_stiffness>
  <drake:mu_dynamic>{_MU}</drake:mu_dynamic><drake:mu_static>{_MU}</drake:mu_static>
  </drake:proximity_properties>"""
_FREE = "<limit><effort>0</effort></limit>"


def list_forms() -> list[tuple[str, float]]:
    """Returns what is compared, and the largest error of each, in SI units."""
    return [*_list_slides(), *_list_rolls(), *_list_bounces(), *_list_rods()]


def _build(turns: bool) -> World:
    """Returns a solid ball of 1 kg above the ground, q = (x, z, turn about y) or without the last.

    A motor pushes it along x.
    """
    ball = f"""<link name="ball"><inertial><mass>1</mass><inertia><ixx>0.004</ixx><iyy>0.004</iyy>
      <izz>0.004</izz></inertia></inertial><collision name="ball"><geometry><sphere>
      <radius>{_RADIUS}</radius></sphere></geometry>{_MATERIAL}</collision></link>"""
    kind = f"<axis><xyz>0 1 0</xyz>{_FREE}</axis>" if turns else ""
    text = f"""<?xml version="1.0"?><sdf version="1.9" xmlns:drake="drake.mit.edu">
      <model name="disc">{ball}
      <link name="slide">{_NOTHING}</link><link name="lift">{_NOTHING}</link>
      <joint name="x" type="prismatic"><parent>world</parent><child>slide</child>
        <axis><xyz>1 0 0</xyz></axis></joint>
      <joint name="z" type="prismatic"><parent>slide</parent><child>lift</child>
        <axis><xyz>0 0 1</xyz>{_FREE}</axis></joint>
      <joint name="turn" type="{"revolute" if turns else "fixed"}"><parent>lift</parent>
        <child>ball</child>{kind}</joint>
      <link name="ground"><collision name="ground"><geometry><plane><normal>0 0 1</normal></plane>
        </geometry>{_MATERIAL}</collision></link>
      <joint name="still" type="fixed"><parent>world</parent><child>ground</child></joint>
      </model></sdf>"""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.Finalize()
    plant.SetDefaultPositions([0.0, 2 * _RADIUS, *[0.0] * turns])
    return World.from_diagram(builder.Build())


def _replay(world: World, q: list[float], v: list[float], push: float, e: float = 0.0) -> Replay:
    """Returns what a push does in a second."""
    scenario = Scenario(
        initial_position=q,
        initial_velocity=v,
        goal_position=q,
        goal_weight=np.ones(len(q)),
        restitution=e,
    )
    return replay_event_driven(world, scenario, np.array([0.0, 1.0]), np.array([[push]]))


def _list_slides() -> Iterator[tuple[str, float]]:
    world, rest = _build(turns=False), [0.0, _RADIUS]
    found = _replay(world, rest, [2.0, 0.0], 0.0)
    way = 2.0**2 / (2 * _MU * _G)
    yield "a block slides v^2/(2 mu g) and stops", _off(found, [way, _RADIUS], [0.0, 0.0])
    found = _replay(world, rest, [0.0, 0.0], 0.99 * _MU * _G)
    yield "a block that is pushed by less than mu m g stays", _off(found, rest, [0.0, 0.0])
    found = _replay(world, rest, [0.0, 0.0], _MU * _G + 1.0)
    yield "a block that is pushed by more goes", _off(found, [0.5, _RADIUS], [1.0, 0.0])


def _list_rolls() -> Iterator[tuple[str, float]]:
    """Yields balls that slip at first: v = 5/7 v0 + 2/7 r w0 after |s0| / (3.5 mu g)."""
    world = _build(turns=True)
    for spin, what in ((0.0, "a ball rolls once 2/7 of its slip are lost"), (-60.0, "backspin")):
        found = _replay(world, [0.0, _RADIUS, 0.0], [1.5, 0.0, spin], 0.0)
        slip = 1.5 - _RADIUS * spin
        rolling, until = 1.5 - 2 / 7 * slip, abs(slip) / (3.5 * _MU * _G)
        way = (1.5 + rolling) / 2 * until + (1.0 - until) * rolling
        ways = np.abs(found.positions[-1, :2] - [way, _RADIUS])
        speeds = np.abs(found.velocities[-1] - [rolling, 0.0, rolling / _RADIUS])
        name = "a ball with backspin returns" if spin else what
        yield name, float(max(*ways, *speeds))


def _list_bounces() -> Iterator[tuple[str, float]]:
    """Yields balls that fall and spin: s/3.5 is lost at most, mu (1 + e) of the speed of fall."""
    world = _build(turns=True)
    for spin, mode in ((-20.0, "slips"), (12.0, "sticks")):
        found = _replay(world, [0.0, 0.3, 0.0], [1.0, 0.0, spin], 0.0, e=0.6)
        fall, slip = math.sqrt(2 * _G * 0.2), 1.0 - _RADIUS * spin
        lost = math.copysign(min(abs(slip) / 3.5, _MU * 1.6 * fall), slip)
        after = [1.0 - lost, 0.6 * fall, spin + lost / (0.4 * _RADIUS)]
        row = np.flatnonzero(np.diff(found.times) == 0)[0] + 1
        error = float(np.max(np.abs(found.velocities[row] - after)))
        yield f"a ball that falls, spins and {mode} as it hits", error


def _list_rods() -> Iterator[tuple[str, float]]:
    """Yields the ends of a uniform rod that hits the ground at an angle, Routh's example.

    Of unit mass, at an angle f to the ground: a = 1 + 3 cos^2 f, b = 3 sin f cos f and
    c = 1 + 3 sin^2 f.
    """
    rate, e = -1.0, 0.5
    for angle, slip, mu, what in (
        (1.2, 3.0, 0.2, "slips on"),
        (1.2, 0.2, 0.9, "sticks"),
        (0.6, -0.05, 0.2, "slips back"),
    ):
        sin, cos = math.sin(angle), math.cos(angle)
        a, b, c = 1 + 3 * cos**2, 3 * sin * cos, 1 + 3 * sin**2
        if what == "slips on":
            normal = -(1 + e) * rate / (a - mu * b)
            tangent = -mu * normal
        elif what == "sticks":
            normal = (-(1 + e) * rate * c + b * slip) / (a * c - b**2)
            tangent = -(slip + b * normal) / c
        else:  # What slips backward is pushed on by the impact itself, and then slips forward.
            e = 0.0
            until = -slip / (b + mu * c)
            left = rate + (a + mu * b) * until
            normal = until - left / (a - mu * b)
            tangent = mu * until - mu * (normal - until)
        found = calc_impulse(Mobility(a, b, c), rate, slip, e, mu)
        error = max(abs(found.normal - normal), abs(found.tangent - tangent))
        yield f"Routh: the end of a rod that {what}", error


def _off(found: Replay, q: list[float], v: list[float]) -> float:
    """Returns how far the end of a replay is off."""
    end: Floats = np.concatenate([found.positions[-1] - q, found.velocities[-1] - v])
    return float(np.max(np.abs(end)))


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
