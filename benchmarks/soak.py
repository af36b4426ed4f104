"""A million ticks of a controller that plans again: does memory stay, is all finite, does it last?

    python -m benchmarks.soak [--count 1000000] [--seed 2026]

The point mass before its rigid wall in Drake's Simulator, with Drake's own contact, under
`ModelPredictiveController` with a horizon that recedes; a kick by chance every 200 ticks, at which
it searches, keeps it bouncing. Memory is what the process holds after a tenth, and at the end.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import resource
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import DiagramBuilder, EventStatus

from benchmarks.script import read_flags
from drake_aigto import ModelPredictiveController, Planner, PlanOptions, Scenario, World
from drake_aigto.control import TickStatus
from drake_aigto.simulation import make_simulator

PERIOD, KICK_EVERY, SPEED = 0.01, 200, 1.5  # [s], ticks, [m/s]
_REPORTS = 20


class Soak:
    """The point mass in the loop, and what its ticks said."""

    def __init__(self, seed: int, count: int) -> None:
        """Starts where the scenario does, with room for so many ticks."""
        scenario = Scenario.named("table1/1")
        options = PlanOptions(branches=0, finalists=1, threads=1)
        world = World.from_scenario(scenario)
        self.controller = ModelPredictiveController(Planner(scenario, options, world), PERIOD)
        builder = DiagramBuilder()
        plant: Any = builder.AddSystem(world.diagram.Clone())
        builder.AddSystem(self.controller)
        builder.Connect(plant.GetOutputPort("state"), self.controller.get_input_port(0))
        builder.Connect(self.controller.GetOutputPort("control"), plant.GetInputPort("actuation"))
        self._world = World.from_diagram(builder.Build())
        self._simulator = make_simulator(self._world, scenario)
        self._watch_contact = self._simulator.get_monitor()
        self._simulator.set_monitor(self._watch)
        self._rng = np.random.default_rng(seed)
        self._last = -1.0
        self.seconds = np.full(count + 1, np.nan)
        self._num_ticks = 0
        self.reasons: Counter[str] = Counter()
        self.is_finite = True

    def _watch(self, root: Any) -> EventStatus | None:
        context = self.controller.GetMyContextFromRoot(root)
        status: TickStatus = self.controller.GetOutputPort("status").Eval(context)
        if status.time != self._last:
            self._last = status.time
            self.seconds[self._num_ticks] = status.seconds
            self._num_ticks += 1
            self.reasons[status.reason.partition(":")[0]] += 1
            control = self.controller.GetOutputPort("control").Eval(context)
            self.is_finite &= bool(np.all(np.isfinite(control)))
        return self._watch_contact(root)

    def advance(self, ticks: int) -> None:
        """Kicks, and goes on for so many ticks."""
        plant = self._world.plant
        root = self._simulator.get_mutable_context()
        context = plant.GetMyMutableContextFromRoot(root)
        self._simulator.AdvanceTo(root.get_time() + ticks * PERIOD)
        plant.SetVelocities(context, SPEED * self._rng.normal(size=1))
        x = plant.GetPositionsAndVelocities(context)
        self.is_finite &= bool(np.all(np.isfinite(x)))


def read_memory() -> float:
    """Returns what the process holds now [MB]; where Linux does not say, what it held at most."""
    status = Path("/proc/self/statm")
    if status.exists():
        pages = int(status.read_text(encoding="ascii").split()[1])
        return pages * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> int:
    """Runs, reports, and returns 1 if anything was not finite."""
    options = read_flags(
        __doc__, workers=None, count=(1000000, "of ticks"), seed=(2026, "of the kicks")
    )
    rounds = max(1, options.count // KICK_EVERY)
    soak, begin = Soak(options.seed, rounds * KICK_EVERY), time.perf_counter()
    early = 0.0
    for number in range(rounds):
        soak.advance(KICK_EVERY)
        if number == rounds // 10:
            early = read_memory()
        if number % max(1, rounds // _REPORTS) == 0:
            done = (number + 1) * KICK_EVERY
            print(f"{done} ticks, {read_memory():.0f} MB", file=sys.stderr, flush=True)
    took, (middle, late) = (
        time.perf_counter() - begin,
        1e3 * np.nanpercentile(soak.seconds, [50, 99]),
    )
    print(f"{rounds * KICK_EVERY} ticks of {PERIOD} s in {took:.0f} s, no exception")
    print(f"all finite: {soak.is_finite}")
    print(f"memory after a tenth {early:.1f} MB, at the end {read_memory():.1f} MB")
    print(f"a tick takes {middle:.2f} ms, at 99 % {late:.2f} ms")
    for reason, count in soak.reasons.most_common():
        print(f"  {reason}: {count}")
    return int(not soak.is_finite)


if __name__ == "__main__":
    sys.exit(main())
