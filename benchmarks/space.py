"""Plans in space, from several seeds: whether they reach their goals, and hold in both replays.

    python -m benchmarks.space [--only push] [--seeds 5] [--renewals 48] [--keep FILE]

What counts was fixed beforehand: objects within 2 cm and 0.1 rad of their goals, in our own
integration and on Drake's continuous plant. Exits with 1 where a plan misses that. Worlds of MJCFs
(extra "models") are simulated in MuJoCo, too, with the file's own contact and the plan's feedback:
what is asked for has to end within 5 cm and 0.3 rad of its goal there, limits that were chosen
after the first such run.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.mujoco_judge import MujocoJudge
from benchmarks.script import clock, machine, read_flags, run_all, run_as
from drake_aigto import Planner, PlanOptions, Scenario, scenario_names
from drake_aigto.arrays import Floats
from drake_aigto.planning import Feedback
from drake_aigto.simulation import replay_with
from drake_aigto.world import TaskCost

FROM_WHEELS = ("dm_cheetah/leap", "gymnasium_hopper/hop", "half_cheetah/leap", "walker2d/step")
WORLDS = (
    "arm_and_box/push",
    "drone/deliver",
    "drone/perch",
    "finger_and_ball/roll",
    "finger_and_box/push",
    "finger_and_box/tip",
    "planar_hand/turn",
    "puck/spin",
    "push_tee/to_pose",
    "quadruped/leap_up",
    "three_fingers/turn",
    *FROM_WHEELS,
)
MOST, MOST_IN_MUJOCO = (0.02, 0.1), (0.05, 0.3)  # [m], [rad]


@dataclass(frozen=True)
class Run:
    """What came of one world and seed.

    Attributes:
        name: of the world, with the seed.
        cost: J of the plan.
        replayed: its cost on Drake's plant.
        misses: of the plan, our simulation, Drake's, and of MJCFs MuJoCo's: how far sliders and
            turns that the goal asks for end off it at most [m], [rad].
        holds: whether both simulations confirm the plan.
        seconds: of the processor, machine code compiled.
    """

    name: str
    cost: float
    replayed: float
    misses: tuple[tuple[float, float], ...]
    holds: bool
    seconds: float

    @property
    def is_met(self) -> bool:
        """Whether the goal is reached in all of them, and the plan holds."""
        most = np.array([MOST] * 3 + [MOST_IN_MUJOCO])[: len(self.misses)]
        return self.holds and bool(np.all(np.array(self.misses) <= most))

    def __str__(self) -> str:
        """Returns a line of a table."""
        misses = "".join(f"{1e3 * far:10.2f} {turn:8.4f}" for far, turn in self.misses)
        mark = "holds" if self.holds else "does not"
        costs = f"{self.cost:12.5g}{self.replayed:12.5g}"
        return f"{self.name:24}{costs}{misses:76}  {mark:9}{self.seconds:8.1f}"


def main() -> int:
    """Plans all, and prints a table and a share."""
    arguments = read_flags(
        __doc__,
        only=("", "worlds whose name has this in it"),
        seeds=(5, "of each world"),
        renewals=(48, "of each plan"),
    )
    print(machine())
    ends = ("plan", "ours", "Drake", "MuJoCo")
    heads = "".join(f"{f'{each} mm':>10} {'rad':>8}" for each in ends)
    print(f"{'':24}{'cost':>12}{'in Drake':>12}{heads}  {'':9}{'CPU s':>8}")
    known, seeds = set(scenario_names()), range(arguments.seeds)
    worlds = [each for each in WORLDS if arguments.only in each and each in known]
    names = [f"{world} {seed}" for world in worlds for seed in seeds]
    runs = run_all(partial(run, renewals=arguments.renewals), names, arguments)
    for each in runs:
        print(each)
    met = [each.is_met for each in runs]
    print(f"{sum(met)} of {len(met)} end as near as asked in all simulations, and hold")
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

    replays, in_drake = list(plan.replay), plan.replay.drake
    assert in_drake is not None, "options confirm"
    if world in FROM_WHEELS:
        feedback = Feedback(planner.world, planner.scenario, plan.trajectory)
        replays.append(replay_with(MujocoJudge(), planner.world, planner.scenario, feedback))
    ends = [plan.trajectory.positions, *(replay.positions for replay in replays)]
    misses = tuple(map(miss, ends))
    return Run(name, plan.cost, in_drake.cost, misses, plan.holds, spent.cpu)


if __name__ == "__main__":
    run_as("benchmarks.space")
