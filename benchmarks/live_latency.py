"""How long it takes from moving a slider of `drake_aigto.show.Live` until the new plan is shown.

    python -m benchmarks.live_latency [--count 12]

The goal, a wall and the weight of control are moved to and fro, of a scenario of each world of
balls and of `cart_pole/soft_06`, each time by less than a tenth of the slider's range and as soon
as the plan before is there, without a browser. What is asked for is of the median, by the clock, so
that nothing else should go on: the load of the machine is printed, and the seconds of processors
that the process took, which a load changes less. The first plan, which compiles, does not count.

Then the slider rests, and the whole search follows: how long after that its plan is there, and how
many times as much the first one costs. Exits with 1 if what is asked for is missed.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable

import numpy as np

from benchmarks.script import Seconds, clock, is_met, machine, read_flags
from drake_aigto import Scenario
from drake_aigto.show import Live

# Scenario → its sliders, and what is asked for [s].
_WEIGHT = "control weight × 10^"
ASKED = {
    "table1/1": (("goal x [m]", "wall nearer [m]", _WEIGHT), 0.1),
    "corridor/three_bounces": (("goal x [m]", "left wall nearer [m]", _WEIGHT), 0.1),
    "floor/rebound": (("goal z [m]", "floor nearer [m]", _WEIGHT), 0.1),
    "room/bank_shot": (("goal x [m]", "left wall nearer [m]", _WEIGHT), 0.1),
    "room_with_block/around": (("goal x [m]", "left wall nearer [m]", _WEIGHT), 0.1),
    "two_masses/handed_on": (
        ("goal left slider [m]", "left ball against left wall nearer [m]", _WEIGHT),
        0.1,
    ),
    "cart_pole/soft_06": (("goal rail [m]", "left wall nearer [m]", _WEIGHT), 1.5),
}


def wait_while(is_so: Callable[[], bool], live: Live) -> Seconds:
    """Looks at sliders as long as something is so, and returns how long that took."""

    def look() -> None:
        while is_so():
            live.look()
            time.sleep(live.PERIOD)

    return clock(look)[1]


def move(live: Live, slider: str, value: float) -> Seconds:
    """Returns how long it takes from moving a slider until another plan is shown."""
    before = live.plan
    live.meshcat.SetSliderValue(slider, value)
    return wait_while(lambda: live.plan is before, live)


def measure(name: str, slider: str, count: int) -> tuple[list[Seconds], str]:
    """Returns what a count of moves take until a plan is shown, and words about the last one."""
    live = Live(Scenario.named(name))
    start = live.open().GetSliderValue(slider)
    wait_while(lambda: live.plan is None or live.is_searching, live)
    ways = (0.05 * (-1) ** number * (1 + number % 3) for number in range(1, count + 1))
    took = [move(live, slider, start + way) for way in ways]
    assert live.plan is not None
    first = live.plan.cost
    rest = wait_while(lambda: live.is_searching, live)
    words = f"at rest the search ends {rest.wall:.1f} s later ({rest.cpu:.1f} of processors)"
    words = f"{words}; the first plan costs {first / live.plan.cost:.4f} times as much"
    live.stop()
    return took, words


def main() -> int:
    """Prints the figures, and returns the exit status."""
    count = read_flags(__doc__, workers=None, count=(12, "moves of each slider")).count
    print(f"{machine()}; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    met = True
    for name, (sliders, most) in ASKED.items():
        for slider in sliders:
            took, words = measure(name, slider, count)
            (middle, used), (worst, _) = np.median(took, axis=0), np.max(took, axis=0)
            what, ms = f"{name}, {slider}", [f"{1e3 * each:.0f}" for each in (middle, worst, used)]
            print(f"{what}: {ms[0]} ms in the median, {ms[1]} at most, {ms[2]} of processors")
            print(f"  {words}")
            met &= is_met(f"{what}, from slider to plan, median [s]", middle, most)
    print(f"load {os.getloadavg()[0]:.1f} by then")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
