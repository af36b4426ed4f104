"""Where a plan's time goes: by its parts, and inside of them by module and by function.

    python -m benchmarks.plan_profile [--repeats 5] [--scenarios 8]

Plans with ``confirm=False`` on Table I's rows and on random scenarios, one thread. The parts are
the planner's own clock (`PlanStats`): aigo, polish, replay, and what is left; the program is
compiled before, when a planner is made, and told apart. Then the same
plans under Python's profiler, which slows down what calls much: shares, not seconds, are to be
believed there. Compiled code counts for who calls it. Writes plan_profile.csv.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cProfile
import pstats
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.script import clock, read_flags, write_csv
from benchmarks.study import ScenarioQuestion
from drake_aigto.paper import ROWS
from drake_aigto.planning import Planner, PlanOptions
from drake_aigto.world import Scenario

PARTS = ("aigo", "polish", "replay")
BUILD = "build, before"
PACKAGE = "drake_aigto"
SHOWN = 25


@dataclass(frozen=True)
class Share:
    """A line of the CSV file."""

    kind: str  # part, module or function
    name: str
    seconds: float  # of a plan
    share: float


def main() -> None:
    """Measures, prints and writes."""
    arguments = read_flags(
        __doc__,
        workers=None,
        repeats=(5, "plans of each scenario"),
        scenarios=(8, "random ones, besides Table I"),
        seed=(0, ""),
        out=(Path(), "folder of the CSV"),
    )
    scenarios = [Scenario.named(f"table1/{row}") for row in ROWS]
    question = ScenarioQuestion(count=arguments.scenarios, seed=arguments.seed)
    scenarios += question.scenarios() if arguments.scenarios else []
    planners = [Planner(scenario, PlanOptions(confirm=False)) for scenario in scenarios]
    for planner in planners:
        planner.plan()  # Loads compiled code.
    shares = time_parts(planners, arguments.repeats)
    profile = cProfile.Profile()
    for planner in planners:
        profile.runcall(planner.plan)
    shares += read_profile(profile, len(planners))
    for kind in ("part", "module", "function"):
        print(f"\n{kind:40}ms a plan   share")
        for each in [share for share in shares if share.kind == kind][:SHOWN]:
            print(f"{each.name:40}{1e3 * each.seconds:9.2f}{each.share:8.1%}")
    write_csv(arguments.out / "plan_profile.csv", shares, f"one thread, {len(planners)} scenarios")


def time_parts(planners: list[Planner], repeats: int) -> list[Share]:
    """Returns the parts of a plan, medians over all plans."""
    found: defaultdict[str, list[float]] = defaultdict(list)
    for _ in range(repeats):
        for planner in planners:
            plan, seconds = clock(planner.plan)
            for part in PARTS:
                found[part].append(plan.stats.seconds.get(part, 0.0))
            found[BUILD].append(plan.stats.seconds["build"])
            found["the rest"].append(seconds.wall - sum(found[part][-1] for part in PARTS))
            found["all"].append(seconds.wall)
    medians = {part: float(np.median(seconds)) for part, seconds in found.items()}
    return [Share("part", part, each, each / medians["all"]) for part, each in medians.items()]


def read_profile(profile: cProfile.Profile, plans: int) -> list[Share]:
    """Returns the own time of modules and functions, the largest first."""
    stats: dict[Any, Any] = vars(pstats.Stats(profile))["stats"]
    total = sum(own for _, _, own, _, _ in stats.values())

    def group(kind: str, name: Callable[[tuple[str, int, str]], str]) -> list[Share]:
        sums: defaultdict[str, float] = defaultdict(float)
        for place, (_, _, own, _, _) in stats.items():
            sums[name(place)] += own
        ordered = sorted(sums.items(), key=lambda item: -item[1])
        return [Share(kind, key, own / plans, own / total) for key, own in ordered]

    return [
        *group("module", lambda place: name_module(place[0])),
        *group("function", lambda place: f"{name_module(place[0])}: {place[2]}"),
    ]


def name_module(path: str) -> str:
    """Returns a module's name within the package, or the library that a file is of."""
    parts = Path(path).with_suffix("").parts
    if PACKAGE in parts:
        return ".".join(parts[len(parts) - parts[::-1].index(PACKAGE) :])
    if "site-packages" in parts:
        return parts[parts.index("site-packages") + 1]
    return "built in" if path.startswith("~") else "Python's library"


if __name__ == "__main__":
    main()
