"""How long it takes from moving a slider of `drake_aigto.show.Live` until the new plan is shown.

    python -m benchmarks.live_latency [--count 12]

The goal, a wall and the weight of control are moved to and fro, of `table1/1` and of
`cart_pole/soft_06`, each time by less than a tenth of the slider's range, without a browser. What
is asked for is of the median, by the clock, so that nothing else should go on; the first plan,
which compiles, does not count. Exits with 1 if it is missed.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np

from benchmarks.script import is_met, machine
from drake_aigto import Plan, Scenario
from drake_aigto.cli import positive
from drake_aigto.show import Live

# Scenario → its sliders, and what is asked for [s].
ASKED = {
    "table1/1": (("goal x [m]", "wall nearer [m]", "control weight × 10^"), 0.1),
    "cart_pole/soft_06": (("goal rail [m]", "left wall nearer [m]", "control weight × 10^"), 1.5),
}
_LOOK = 0.005  # from look to look [s]


def wait_for_another(live: Live, before: Plan | None) -> float:
    """Returns how long it takes until another plan is shown [s]."""
    begin = time.monotonic()
    while live.plan is before:
        live.look()
        time.sleep(_LOOK)
    return time.monotonic() - begin


def measure(name: str, slider: str, count: int) -> list[float]:
    """Returns seconds from moving a slider until a plan is shown, of a count of moves."""
    live = Live(Scenario.named(name))
    meshcat = live.open()
    wait_for_another(live, None)
    start, seconds = meshcat.GetSliderValue(slider), []
    for number in range(1, count + 1):
        before = live.plan
        meshcat.SetSliderValue(slider, start + 0.05 * (-1) ** number * (1 + number % 3))
        seconds.append(wait_for_another(live, before))
    live.stop()
    return seconds


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints the figures, and returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--count", type=positive, default=12, help="moves of each slider")
    count = parser.parse_args(arguments).count
    print(machine())
    met = True
    for name, (sliders, most) in ASKED.items():
        for slider in sliders:
            seconds = measure(name, slider, count)
            middle, worst = float(np.median(seconds)), max(seconds)
            what = f"{name}, {slider}"
            print(f"{what}: {1e3 * middle:.0f} ms in the median, {1e3 * worst:.0f} ms at most")
            met &= is_met(f"{what}, from slider to plan, median [s]", middle, most)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
