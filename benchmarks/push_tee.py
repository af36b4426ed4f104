"""A T that a disc pushes to its goal from random poses: how much of the goal's area it covers.

    python -m benchmarks.push_tee [--poses 50] [--starts 12] [--renewals 48] [--keep FILE]

The task is that of diffusion policy, in millimeters for its pixels: the goal in the center of a
table, at 45°; the T's center of mass drawn within 0.15 m of that along x and y, at any angle, the
disc's within 0.2 m, until they do not overlap; controls held for 0.1 s. What counts: 4 s, and 95 %
of the goal's area covered in the plan, in our own integration and on Drake's continuous plant, in
nine of ten poses. Exits with 1 where that is missed.
"""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from pydrake.geometry import Box, Role

from benchmarks.script import clock, machine, read_flags, run_all, run_as
from drake_aigto import Planner, PlanOptions, Scenario, World
from drake_aigto.arrays import Floats
from drake_aigto.show import cut_polygon

_NAME, _DURATION, _TIME_STEP = "push_tee/to_pose", 4.0, 0.1  # [s]
_GOAL: Any = {"tee_x": 0.0, "tee_y": 0.0, "tee_turn": np.pi / 4}  # [m], [rad]
_FAR = {"tee_x": 0.15, "tee_y": 0.15, "tee_turn": np.pi, "disc_x": 0.2, "disc_y": 0.2}
_COVERED, _SHARE = 0.95, 0.9


@dataclass(frozen=True)
class Run:
    """What came of one pose.

    Attributes:
        pose: its number.
        cost: J of the plan.
        covered: shares of the goal's area: in the plan, our simulation, and Drake's.
        holds: whether both simulations confirm the plan.
        seconds: of the processor, machine code compiled.
    """

    pose: int
    cost: float
    covered: tuple[float, ...]
    holds: bool
    seconds: float

    @property
    def is_met(self) -> bool:
        """Whether the goal is covered in all of them, and the plan holds."""
        return self.holds and min(self.covered) >= _COVERED

    def __str__(self) -> str:
        """Returns a line of a table."""
        shares = "".join(f"{each:9.4f}" for each in self.covered)
        mark = "holds" if self.holds else "does not"
        return f"{self.pose:4}{self.cost:12.5g}{shares}  {mark:9}{self.seconds:8.1f}"


def draw_pose(number: int) -> Scenario:
    """Returns the task from a random pose; it depends on the number alone."""
    shipped, rng = Scenario.named(_NAME), np.random.default_rng(number)
    world = World.from_scenario(shipped)
    while True:
        start: Any = {name: float(rng.uniform(-far, far)) for name, far in _FAR.items()}
        drawn = dataclasses.replace(
            shipped,
            initial_position=start,
            goal_position=_GOAL,
            duration=_DURATION,
            time_step=_TIME_STEP,
        )
        if np.min(world.calc_signed_distance(world.place(drawn).initial_position)) > 0:
            return drawn


def calc_coverage(world: World, q: Floats, goal: Floats) -> float:
    """Returns the share of the area at a goal that the T covers at q, of exact polygons."""
    there, asked = _find_boxes(world, q), _find_boxes(world, goal)
    shared = sum(_calc_area(_intersect(*pair)) for pair in itertools.product(there, asked))
    return shared / sum(map(_calc_area, asked))


def _find_boxes(world: World, q: Floats) -> list[Floats]:
    """Returns corners of the T's boxes from above, counterclockwise, shape (4, 2) each [m]."""
    plant, inspector = world.plant, world.scene_graph.model_inspector()
    context, body = plant.CreateDefaultContext(), plant.GetBodyByName("tee")
    plant.SetPositions(context, q)
    X_WB, frame = body.EvalPoseInWorld(context), plant.GetBodyFrameIdOrThrow(body.index())
    found = []
    for shape in inspector.GetGeometries(frame, Role.kProximity):
        box = inspector.GetShape(shape)
        assert isinstance(box, Box)
        signs = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        X_WG = X_WB.multiply(inspector.GetPoseInFrame(shape))
        found.append(X_WG.multiply((signs * box.size() / 2).T).T[:, :2])
    return found


def _intersect(corners: Floats, other: Floats) -> Floats:
    """Returns the part of a convex polygon inside another one."""
    for corner, after in zip(other, np.roll(other, -1, axis=0), strict=True):
        outwards = np.array([after[1] - corner[1], corner[0] - after[0]])
        corners = cut_polygon(corners, float(-outwards @ corner), outwards)
    return corners


def _calc_area(corners: Floats) -> float:
    x, y = corners.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@cache
def _load_code() -> None:
    Planner(Scenario.named(_NAME), PlanOptions(starts=1, renewals=0, finalists=1)).plan()


def run(number: int, *, starts: int, renewals: int) -> Run:
    """Plans from one pose, code compiled before."""
    _load_code()
    scenario = draw_pose(number)
    planner = Planner(scenario, PlanOptions(starts=starts, renewals=renewals, finalists=1))
    plan, spent = clock(planner.plan)
    ends = [plan.trajectory.positions, *(replay.positions for replay in plan.replay)]
    goal = planner.world.place(scenario).goal_position
    covered = tuple(calc_coverage(planner.world, each[-1], goal) for each in ends)
    return Run(number, plan.cost, covered, plan.holds, spent.cpu)


def main() -> int:
    """Plans from all poses, and prints a table and a share."""
    arguments = read_flags(
        __doc__, poses=(50, "how many"), starts=(12, "of each plan"), renewals=(48, "of each plan")
    )
    print(machine())
    print(f"pose{'cost':>12}{'plan':>9}{'ours':>9}{'Drake':>9}  {'':9}{'CPU s':>8}")
    work = partial(run, starts=arguments.starts, renewals=arguments.renewals)
    runs: list[Run] = run_all(work, range(arguments.poses), arguments)
    for each in runs:
        print(each)
    met = sum(each.is_met for each in runs)
    print(f"{met} of {len(runs)} cover {_COVERED:.0%} of the goal in all simulations, and hold")
    return 0 if met >= _SHARE * arguments.poses else 1


if __name__ == "__main__":
    run_as("benchmarks.push_tee")
