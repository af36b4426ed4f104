"""Plans in the loop on plants that are not their models: five methods on the same disturbances.

    python -m benchmarks.in_the_loop [table1/1 corridor/three_bounces …] [--count 100] [--seed 2026]
        [--changing] [--workers 1] [--minutes 10]

Masses, walls and restitution are off by up to 10 % (a wall, of how far the start is from the
nearest), the state is told with noise every 10 ms, and what moves is kicked once. After most kicks
the plan's contact sequence is still the best; with `--changing` only such kicks are drawn, harder
and harder, after which another one is better by what a controller switches for. Plants run in
Drake's Simulator, with Drake's own contact, until the scenario ends; costs are those of what
happened.

Methods: the plan's control alone; `TrackingController`, LQR between bounces; and
`ModelPredictiveController`, warm without searches, warm with one every 100 ms and after surprises,
and the latter with the true plant for its model and no noise: that is the yardstick, which does not
know of the kick before it comes.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from benchmarks.script import Spread, machine, read_flags, run_all, run_as
from drake_aigto import (
    AigtoError,
    ModelPredictiveController,
    Plan,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
    World,
)
from drake_aigto.arrays import Floats
from drake_aigto.control import (
    ClosedLoopRun,
    Disturbance,
    Horizon,
    PlannedMotion,
    Safety,
    make_horizon,
    run_in_loop,
)
from drake_aigto.planning import needs_shooting
from drake_aigto.world import Scales

SCENARIOS = (
    "table1/1",
    "corridor/three_bounces",
    "room/bank_shot",
    "floor/rebound",
    "cart_pole/soft_06",
)
PERIOD = 0.01  # [s]
OFF = 0.1  # Masses, walls and restitution are off by up to this part.
# Standard deviations of what is told, and of the kick, in the task's lengths and velocities.
NOISE, KICK = 1e-3, 0.5
SEARCH_EVERY = 10  # ticks
MARGIN = 0.02  # By which another sequence is better; that of controllers.
# So many kicks are drawn at most, each harder than the last by KICK over HARDER.
MOST_KICKS, HARDER = 60, 20
BALLS = PlanOptions(branches=0, finalists=1, threads=1, aigo_steps=30)
MECHANISMS = PlanOptions(renewals=24, search_steps=30)
BEST = "knows the truth"


def make_open_loop(plan: Plan, period: float) -> TrackingController:
    """Returns a plan's control alone, in the ports of what tracks it: nothing is near enough."""
    return TrackingController(plan, period=period, safety=Safety(far=1e-12))


class Task(NamedTuple):
    """A scenario, as all methods are asked it.

    Attributes:
        plan: what is tracked.
        planner: of controllers that plan again.
        horizon: asks the task from anywhere.
        motion: the plan, as that has it.
    """

    plan: Plan
    planner: Planner
    horizon: Horizon
    motion: PlannedMotion

    def has_better(self, time: float, kick: Floats) -> bool:
        """Returns whether another contact sequence is better after a kick, by the usual margin."""
        x = self.motion.calc_state(time)
        x[len(kick) :] += kick
        warm, found = self.horizon.advance(self.motion, time, x), self.horizon.search(time, x)
        if found is None:
            return False
        contacts = [touch.contact for touch in found.touches]
        left = [touch.contact for touch in self.motion.touches if touch.start > time]
        return contacts != left and (warm is None or found.cost < (1 - MARGIN) * warm.cost)


def draw(task: Task, rng: np.random.Generator, changing: bool = False) -> Disturbance | None:
    """Returns a disturbance by chance; None if no kick changes which contact sequence is best."""
    scenario, world = task.planner.scenario, task.planner.world
    disturbance, speed = _draw_one(scenario, world, rng)
    for number in range(MOST_KICKS):
        if not changing or task.has_better(disturbance.kick_time, disturbance.kick):
            return disturbance
        harder = KICK * (1 + number / HARDER) * speed * rng.normal(size=world.num_positions)
        disturbance = dataclasses.replace(disturbance, kick=harder)
    return None


def _draw_one(
    scenario: Scenario, world: World, rng: np.random.Generator
) -> tuple[Disturbance, float]:
    """Returns a disturbance with any kick, and what counts as a speed [m/s]."""
    n, scales = world.num_positions, Scales.of(world, scenario)
    speed = max(scales.velocity, float(np.linalg.norm(scenario.initial_velocity)))
    is_rigid = scenario.contact == "rigid"
    most = min(1 + OFF, 1 / scenario.restitution) if is_rigid else 1.0
    nearest = float(np.min(world.calc_clearance(scenario.initial_position)))
    lengths = np.repeat([scales.length, speed], n)
    disturbance = Disturbance(
        mass_factor=rng.uniform(1 - OFF, 1 + OFF),
        wall_shift=OFF * nearest * rng.uniform(-1, 1),
        restitution_factor=rng.uniform(1 - OFF, most) if is_rigid else 1.0,
        kick=KICK * speed * rng.normal(size=n),
        kick_time=float(rng.uniform(0.1, 0.7) * scenario.duration),
        noise=NOISE * lengths,
        seed=int(rng.integers(2**31)),
    )
    return disturbance, speed


def make_controllers(
    plan: Plan, planner: Planner, disturbance: Disturbance
) -> Iterator[tuple[str, Any, Disturbance]]:
    """Yields the methods' controllers, and what disturbs each."""
    yield "open loop", make_open_loop(plan, PERIOD), disturbance
    yield "tracking", TrackingController(plan, period=PERIOD), disturbance
    again: dict[str, Any] = {"period": PERIOD, "horizon": "shrinking"}
    warm = ModelPredictiveController(planner, **again, surprise=np.inf)
    yield "warm", warm, disturbance
    search = ModelPredictiveController(planner, **again, search_every=SEARCH_EVERY)
    yield "warm, search", search, disturbance
    world, scenario = disturbance.apply(planner.world, planner.scenario)
    true = Planner(scenario, planner.options, world)
    silent = dataclasses.replace(disturbance, noise=np.empty(0))
    yield BEST, ModelPredictiveController(true, **again, search_every=SEARCH_EVERY), silent


@dataclass(frozen=True)
class Outcome:
    """A run of a method.

    Attributes:
        cost: of what happened.
        switches: how often another plan was taken.
        warm: seconds of each tick after the first that is warm only.
        searched: of each that searches.
    """

    cost: float
    switches: int
    warm: tuple[float, ...]
    searched: tuple[float, ...]

    @classmethod
    def of(cls, run: ClosedLoopRun) -> Outcome:
        """Returns what a run comes to."""
        ticks = run.ticks[1:]
        searched = [each.has_switched or each.reason.startswith("warm;") for each in ticks]
        return cls(
            cost=run.cost,
            switches=len(run.switches),
            warm=tuple(each.seconds for each in ticks if each.reason == "warm"),
            searched=tuple(
                each.seconds for each, is_so in zip(ticks, searched, strict=True) if is_so
            ),
        )


# What all methods make of one disturbance.
Outcomes = Mapping[str, Outcome]


def report(name: str, runs: Sequence[Outcomes]) -> str:
    """Returns a table: costs above those of the one that knows, and how long ticks take."""
    known = np.array([each[BEST].cost for each in runs])
    lines = [
        f"{name}: {len(known)} disturbances; {BEST!r} costs {known.mean():.3g} in the mean",
        f"{'method':<16} mean above   median (quartiles)            switches"
        "  ms a warm tick, 99 %  a search, 90 %",
    ]
    lines += [_describe(method, [each[method] for each in runs], known) for method in runs[0]]
    return "\n".join(lines)


def _describe(method: str, outcomes: Sequence[Outcome], known: Floats) -> str:
    """Returns a row of the table."""
    above = np.array([each.cost for each in outcomes]) - known
    spread = Spread.of(above)
    line = f"{method:<16} {above.mean():10.3g}  {spread.median:9.3g}"
    line += f" ({spread.low:9.3g} … {spread.high:9.3g})"
    warm = [1e3 * second for each in outcomes for second in each.warm]
    searched = [1e3 * second for each in outcomes for second in each.searched]
    if warm:
        line += f"  {sum(each.switches for each in outcomes):6d}"
        line += "  {:12.1f} {:6.1f}".format(*np.percentile(warm, [50, 99]))
    if searched:
        line += "  {:8.1f} {:5.1f}".format(*np.percentile(searched, [50, 90]))
    return line


@cache
def prepare(name: str) -> Task:
    """Returns a scenario's task."""
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    options = MECHANISMS if needs_shooting(world, scenario) else BALLS
    planner = Planner(scenario, options, world)
    horizon = make_horizon(planner, is_receding=False, iterations=5, period=PERIOD)
    x = np.concatenate([scenario.initial_position, scenario.initial_velocity])
    motion = horizon.search(0.0, x)
    assert motion is not None
    return Task(Planner(scenario, None, world).plan(), planner, horizon, motion)


def run(job: tuple[str, int, int, bool]) -> Outcomes | None:
    """Returns what all methods make of a disturbance; None if it, or one of them, is refused.

    Args:
        job: the scenario, the seed of all its disturbances, the number of this one, and whether the
            best contact sequence has to change.
    """
    name, seed, number, changing = job
    task = prepare(name)
    scenario, world = task.planner.scenario, task.planner.world
    try:
        disturbance = draw(task, np.random.default_rng((seed, number)), changing)
        if disturbance is None:
            print(f"{name}: disturbance {number} left out, no kick changes its mind", flush=True)
            return None
        return {
            method: Outcome.of(run_in_loop(controller, scenario, world, which))
            for method, controller, which in make_controllers(task.plan, task.planner, disturbance)
        }
    except AigtoError as error:
        print(f"{name}: disturbance {number} left out, {error}", flush=True)
        return None


def main() -> int:
    """Runs all methods on the same disturbances, and prints a table of each scenario."""
    options = read_flags(
        __doc__,
        place=("scenarios", {"nargs": "*", "default": SCENARIOS, "help": "of those shipped"}),
        count=(100, "of disturbances of each"),
        seed=(2026, "of the disturbances"),
        changing=(False, "only kicks that change the best contact sequence"),
    )
    print(machine(), flush=True)
    for name in options.scenarios:
        jobs = [(name, options.seed, k, options.changing) for k in range(options.count)]
        if runs := [each for each in run_all(run, jobs, options) if each]:
            title = f"{name}, kicks that change the best sequence" if options.changing else name
            print(report(title, runs), flush=True)
    return 0


if __name__ == "__main__":
    run_as("benchmarks.in_the_loop")
