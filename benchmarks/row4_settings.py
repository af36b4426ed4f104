"""Which settings that the paper does not print reach its Table I, row 4 (3.67e-7)?

    python -m benchmarks.row4_settings

Scans duration T, control weight w_u and δ, with the literal transcription and φ free, and prints
the best plan of the ladder for each.
"""

from __future__ import annotations

import dataclasses
import itertools

from drake_aigto.paper import PAPER_COSTS, LiteralOptions, plan_literal
from drake_aigto.world import Scenario

DURATIONS = (0.9, 1.0, 1.1)  # [s]
CONTROL_WEIGHTS = (1e-4, 1e-3, 1e-2)  # [1/(N² s)]
DELTAS = (1e-4, 1e-3, 1e-2)  # [m]


def main() -> None:
    """Prints a line for every choice of settings."""
    options = LiteralOptions(nonpenetration=False, confirm=False)
    target = PAPER_COSTS[4].aigto
    for duration, weight, delta in itertools.product(DURATIONS, CONTROL_WEIGHTS, DELTAS):
        scenario = dataclasses.replace(
            Scenario.named("table1/4"), duration=duration, control_weight=weight, delta=delta
        )
        found = plan_literal(scenario, options)
        print(
            f"T {duration:g} s  w_u {weight:g}  δ {delta:g} m  cost {found.cost:.2e}  "
            f"defect {found.best.max_defect:.0e}  "
            f"on a rigid wall {found.replay.event_driven.cost:.1e}  "
            f"{'reaches' if found.cost <= target else 'misses'} {target:g}",
            flush=True,
        )


if __name__ == "__main__":
    main()
