"""Plans in space, from several seeds: whether they reach their goals, and hold in both replays.

    python -m benchmarks.space [--only push] [--seeds 5] [--renewals 48] [--keep FILE]

What counts was fixed beforehand: objects within 2 cm and 0.1 rad of their goals, in our own
integration and on Drake's continuous plant. Exits with 1 where a plan misses that.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.script import clock, machine, read_flags, run_all, run_as
from drake_aigto import Planner, PlanOptions, Scenario
from drake_aigto.arrays import Floats
from drake_aigto.world import TaskCost

WORLDS = (
    "finger_and_ball/roll",
    "finger_and_box/push",
    "finger_and_box/tip",
    "puck/spin",
    "push_tee/to_pose",
)
MOST = 0.02, 0.1  # [m], [rad]


@dataclass(frozen=True)
class Run:
    """What came of one world and seed.

    Attributes:
        name: of the world, with the seed.
        cost: J of the plan.
        misses: of the plan, our simulation, and Drake's: how far sliders and turns that the goal
            asks for end off it at most [m], [rad].
        holds: whether both simulations confirm the plan.
        seconds: of the processor, machine code compiled.
    """

    name: str
    cost: float
    misses: tuple[tuple[float, float], ...]
    holds: bool
    seconds: float

    @property
    def is_met(self) -> bool:
        """Whether the goal is reached in all of them, and the plan holds."""
        return self.holds and bool(np.all(np.array(self.misses) <= MOST))

    def __str__(self) -> str:
        """Returns a line of a table."""
        misses = "".join(f"{1e3 * far:10.2f} {turn:8.4f}" for far, turn in self.misses)
        mark = "holds" if self.holds else "does not"
        return f"{self.name:24}{self.cost:12.5g}{misses}  {mark:9}{self.seconds:8.1f}"


def main() -> int:
    """Plans all, and prints a table and a share."""
    arguments = read_flags(
        __doc__,
        only=("", "worlds whose name has this in it"),
        seeds=(5, "of each world"),
        renewals=(48, "of each plan"),
    )
    print(machine())
    heads = "".join(f"{f'{each} [mm]':>10} {'[rad]':>8}" for each in ("plan", "ours", "Drake"))
    print(f"{'':24}{'cost':>12}{heads}  {'':9}{'seconds':>8}")
    seeds = range(arguments.seeds)
    names = [f"{world} {seed}" for world in WORLDS if arguments.only in world for seed in seeds]
    runs = run_all(partial(run, renewals=arguments.renewals), names, arguments)
    met = [each.is_met for each in runs]
    print(f"{sum(met)} of {len(met)} end within 2 cm and 0.1 rad in both simulations, and hold")
    return 0 if all(met) else 1


def run(name: str, *, renewals: int) -> Run:
    """Plans for one world from one seed, code compiled before."""
    world, _, seed = name.partition(" ")
    scenario = Scenario.named(world)
    Planner(scenario, PlanOptions(starts=1, renewals=0, finalists=1)).plan()
    planner = Planner(scenario, PlanOptions(renewals=renewals, finalists=1, seed=int(seed)))
    plan, spent = clock(planner.plan)
    cost, turns = TaskCost.of(planner.world, planner.scenario), planner.world.turns

    def miss(positions: Floats) -> tuple[float, float]:
        off = np.abs(np.where(cost.is_asked, cost.goal_errors(positions[-1]), 0.0))
        return float(np.max(off[~turns])), float(np.max(off[turns], initial=0.0))

    ends = [plan.trajectory.positions, *(replay.positions for replay in plan.replay)]
    found = Run(name, plan.cost, tuple(map(miss, ends)), plan.holds, spent.cpu)
    print(found, flush=True)
    return found


if __name__ == "__main__":
    run_as("benchmarks.space")
