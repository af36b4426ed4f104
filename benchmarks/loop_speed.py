"""How long the ticks of a controller that plans again take.

    python -m benchmarks.loop_speed [--count 20] [--seed 2027]

The runs are those of `benchmarks.in_the_loop`: masses, walls and restitution off by up to 10 %,
noise and a kick, in Drake's Simulator, under `ModelPredictiveController`, which searches every
100 ms and after surprises. The first run of a scenario compiles, and does not count. Plans of balls
have 50 time steps to the end of the task; those of SPOT's cart-pole between soft walls 30, over a
horizon that recedes.

What is asked for is of CPU time, which is that of a clock where nothing else goes on. Exits with 1
if a figure that is asked for is missed.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dataclasses
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, EventStatus, State

from benchmarks.in_the_loop import MECHANISMS, PERIOD, SEARCH_EVERY, Outcome, draw, prepare
from benchmarks.script import is_met, machine, read_flags
from drake_aigto import AigtoError, ModelPredictiveController
from drake_aigto.control import run_in_loop


class Asked(NamedTuple):
    """A task, and what is asked for.

    Attributes:
        most: of a warm tick's median and 99th percentile, a search's median [ms].
        num_steps: of the scenario; None: its own, of which plans in the loop have fewer.
        in_the_loop: how many time steps these have.
        horizon: shrinking or receding.
    """

    most: Mapping[str, float]
    num_steps: int | None = 50
    in_the_loop: int = 50
    horizon: str = "shrinking"


ASKED: Mapping[str, Asked] = {
    "table1/1": Asked({"a warm tick": 2.0, "a warm tick, 99 %": 5.0, "a search": 15.0}),
    "corridor/three_bounces": Asked({"a warm tick, 99 %": 5.0, "a search": 60.0}),
    "cart_pole/soft_10": Asked({"a warm tick": 10.0}, None, MECHANISMS.search_steps, "receding"),
}


class Clocked(ModelPredictiveController):
    """One that also keeps what CPU time each tick took, in `cpu` [s]."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.cpu: list[float] = []

    def _tick(self, context: Context, state: State) -> EventStatus:
        begin = time.process_time()
        status = super()._tick(context, state)
        self.cpu.append(time.process_time() - begin)
        return status


class Times(NamedTuple):
    """What ticks of disturbed runs took, by the clock and of CPU [s]."""

    clock: Outcome
    cpu: Outcome


def run(name: str, count: int, seed: int) -> Iterator[Times]:
    """Yields what ticks took in so many disturbed runs."""
    asked = ASKED[name]
    task = prepare(name, asked.num_steps)
    scenario, world = task.planner.scenario, task.planner.world
    for number in range(count):
        disturbance = draw(task, np.random.default_rng((seed, number)))
        assert disturbance is not None
        controller = Clocked(task.planner, PERIOD, asked.horizon, search_every=SEARCH_EVERY)
        try:
            found = run_in_loop(controller, scenario, world, disturbance)
        except AigtoError as error:
            print(f"{name}: disturbance {number} left out, {error}", flush=True)
            continue
        pairs = zip(found.ticks[1:], controller.cpu, strict=True)
        ticks = [dataclasses.replace(tick, seconds=seconds) for tick, seconds in pairs]
        used = dataclasses.replace(found, ticks=(found.ticks[0], *ticks))
        yield Times(Outcome.of(found), Outcome.of(used))


def report(name: str, count: int, seed: int) -> bool:
    """Prints a scenario's times; returns whether what is asked for is met."""
    runs = list(run(name, count + 1, seed))[1:]
    asked = ASKED[name]
    print(f"{name}, {asked.in_the_loop} time steps, {len(runs)} runs; ms of CPU (by the clock)")
    warm = _describe("warm ticks, 99 %", [(t.cpu.warm, t.clock.warm) for t in runs], 99)
    searched = _describe("searches, 90 %", [(t.cpu.searched, t.clock.searched) for t in runs], 90)
    found = {"a warm tick": warm[0], "a warm tick, 99 %": warm[1], "a search": searched[0]}
    met = [is_met(f"{what} [ms]", found[what], most) for what, most in asked.most.items()]
    return all(met)


def _describe(
    what: str, runs: Sequence[tuple[Sequence[float], Sequence[float]]], late: int
) -> tuple[float, float]:
    """Prints how long ticks of some kind took; returns the CPU times' median and a percentile."""
    cpu, wall = (1e3 * np.concatenate(times) for times in zip(*runs, strict=True))
    (middle, slow), walls = (np.percentile(each, [50, late]).tolist() for each in (cpu, wall))
    line = "{:6d} {:<17} {:6.2f}, {:6.2f}  ({:.2f}, {:.2f})"
    print(line.format(cpu.size, what, middle, slow, *walls), flush=True)
    return middle, slow


def main() -> int:
    """Prints the times of all scenarios; returns 1 if a figure is missed."""
    options = read_flags(
        __doc__,
        workers=None,
        count=(20, "of disturbances of each"),
        seed=(2027, "of the disturbances"),
    )
    print(machine(), flush=True)
    met = [report(name, options.count, options.seed) for name in ASKED]
    return int(not all(met))


if __name__ == "__main__":
    sys.exit(main())
