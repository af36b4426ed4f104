"""Measures what `drake-aigto list` says of how long plans take, and writes it beside the scenarios.

python -m docs.make_seconds [NAME …]

CPU seconds of the second of two plans with the default options: machine code and world are ready.
Scenarios that are not named keep what is written.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

import yaml

from drake_aigto import Planner, Scenario, scenario_names
from drake_aigto.world import models_directory, scenario_seconds


def measure(name: str) -> float:
    """Returns CPU seconds of a plan."""
    planner = Planner(Scenario.named(name))
    planner.plan()
    begin = time.process_time()
    planner.plan()
    return float(f"{time.process_time() - begin:.2g}")


def main(names: Sequence[str]) -> None:
    """Measures, and writes after each: what was measured stays if it is ended."""
    for name in names or scenario_names():
        known = scenario_seconds() | {name: measure(name)}
        print(f"{name}: {known[name]:g} s", flush=True)
        text = yaml.safe_dump(dict(sorted(known.items())), default_flow_style=False)
        path = models_directory() / "seconds.yaml"
        path.write_text(f"# CPU seconds of a plan, by docs/make_seconds.py\n{text}", "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
