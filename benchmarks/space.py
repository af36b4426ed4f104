"""Plans in space, from several seeds: whether they reach their goals, and hold in both replays.

    python -m benchmarks.space [--only push] [--seeds 5] [--renewals 48] [--keep FILE]
    python -m benchmarks.space --poses 50 [--only three_fingers/lift] [--renewals 0]
    python -m benchmarks.space --rivals [--mujoco] [--only push] [--seeds 1] [--renewals 24]

What counts was fixed beforehand: objects within 2 cm and 0.1 rad of their goals, in our own
integration and on Drake's continuous plant. Exits with 1 where a plan misses that. Worlds of MJCFs
(extra "models") are simulated in MuJoCo, too, with the file's own contact and the plan's feedback:
what is asked for has to end within 5 cm and 0.3 rad of its goal there, limits that were chosen
after the first such run.

With `--rivals`, samplers have as many CPU seconds each as the plan took: the cross-entropy method,
MPPI and predictive sampling (`benchmarks.rivals`), of controls over the whole task, by their cost
in the plan's own compiled dynamics, in implicit steps. The best control of each is judged as the
plan is, by our integration. Where one alone reaches the goal, it is better, else the cheaper one.
With `--mujoco` these methods are controllers in MuJoCo, and MuJoCo judges them (`mujoco_peers`).

With `--poses`, tasks of one world are drawn, and Drake's plant judges. push_tee's T, where none is
named, starts at random poses, and at the end has to cover 95 % of its goal. Both are diffusion
policy's (Chi et al., arXiv 2303.04137), a pixel a millimeter: disc within 50 to 450, T within 100
to 400 in x and y and turned by 2 π N(0, 1) - π, goal at 256 and 256, turned by π/4. A disc that
starts in the T is drawn anew; walls of their table are not there.

three_fingers' cube is lifted, flipped or turned as by Jin (arXiv 2408.07855): it starts within
25 mm of the middle, turned by up to 180° about z, with tips 0.1 m from there. Its goal is within
0.1 m of it in x and y; lifted, 0.05 to 0.1 m high and turned by up to 180° about (0, 1, 1) +
0.1 N(0, 1); flipped, 0.05 m high with any yaw, and roll and pitch of up to 90°; turned, on the
ground with any yaw. It has to be within 2 cm of it, and 1 - (q · q*)² < 0.04, in the last 20 steps.
Jin's controller has 300 s for that, a plan here 3 s.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import cache, partial
from operator import itemgetter
from typing import NamedTuple, TypeAlias

import numpy as np
from matplotlib.path import Path
from matplotlib.transforms import Bbox

from benchmarks.mujoco_judge import MujocoJudge
from benchmarks.mujoco_peers import MujocoTask
from benchmarks.rivals import SAMPLERS, roll_out, sample
from benchmarks.robots.judge import Control
from benchmarks.script import clock, machine, read_flags, run_all, run_as, within
from drake_aigto import Planner, PlanOptions, Scenario, World, scenario_names
from drake_aigto.arrays import Floats
from drake_aigto.planning import Feedback, make_mechanism_task
from drake_aigto.shooting import IMPLICIT, ShootingProblem
from drake_aigto.simulation import Replay, replay_event_driven, replay_with
from drake_aigto.world import TaskCost

FROM_WHEELS = (
    "dm_cheetah/leap",
    "dm_finger/turn",
    "dm_walker/step",
    "gymnasium_hopper/hop",
    "half_cheetah/leap",
    "walker2d/step",
)
WORLDS = (
    "arm_and_box/push",
    "arm_and_gripper/pick",
    "drone/deliver",
    "drone/perch",
    "finger_and_ball/roll",
    "finger_and_box/push",
    "finger_and_box/tip",
    "planar_hand/turn",
    "puck/spin",
    "push_tee/to_pose",
    "quadruped/leap_up",
    "space_hopper/hop",
    "three_fingers/flip",
    "three_fingers/lift",
    "three_fingers/turn",
    "throwing_arm/into_the_box",
    *FROM_WHEELS,
)
TEE = (np.array([[0.0, 0.02571], [0.0, -0.03429]]), np.array([[0.06, 0.015], [0.015, 0.045]]))
MOST, MOST_IN_MUJOCO = (0.02, 0.1), (0.05, 0.3)  # [m], [rad]


class Run(NamedTuple):
    """What came of one world and seed."""

    name: str  # of the world, with the seed
    cost: float  # J of the plan
    replayed: float  # that on Drake's plant
    # How far sliders and turns that the goal asks for end off it at most [m], [rad]: in the plan,
    # our simulation, Drake's, and of MJCFs MuJoCo's.
    misses: tuple[tuple[float, float], ...]
    holds: bool  # in our simulation and in Drake's
    seconds: float  # of the processor, machine code compiled

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
        return f"{self.name:28}{costs}{misses:76}  {mark:9}{self.seconds:8.1f}"


def main() -> int:
    """Plans all, and prints a table and a share."""
    arguments = read_flags(
        __doc__,
        only=("", "worlds whose name has this in it"),
        seeds=(5, "of each world"),
        renewals=(48, "of each plan"),
        poses=(0, "tasks that are drawn of one world, push_tee/to_pose if none is named"),
        rivals=(False, "compare plans with samplers"),
        mujoco=(False, "samplers are controllers in MuJoCo"),
    )
    print(machine())
    if arguments.poses:
        return plan_drawn(arguments)
    known, seeds = set(scenario_names()), range(arguments.seeds)
    worlds = [each for each in WORLDS if arguments.only in each and each in known]
    names = [f"{world} {seed}" for world in worlds for seed in seeds]
    if arguments.rivals:
        return compare(names, arguments)
    ends = ("plan", "ours", "Drake", "MuJoCo")
    heads = "".join(f"{f'{each} mm':>10} {'rad':>8}" for each in ends)
    print(f"{'':28}{'cost':>12}{'in Drake':>12}{heads}  {'':9}{'CPU s':>8}")
    runs = run_all(partial(run, renewals=arguments.renewals), names, arguments)
    for each in runs:
        print(each)
    met = [each.is_met for each in runs]
    print(f"{sum(met)} of {len(met)} end as near as asked in all simulations, and hold")
    return 0 if all(met) else 1


def plan_drawn(arguments: argparse.Namespace) -> int:
    """Plans for tasks that are drawn, and prints how good each plan is and how many enough."""
    name = arguments.only or "push_tee/to_pose"
    least, unit = DRAWN[name][2:]
    print(f"pose  {unit:>8}{'in plan':>9}{'m away':>8}{'rad':>7}{'CPU s':>7}")
    plan_it = partial(plan_one, name, renewals=arguments.renewals)
    found = run_all(plan_it, range(arguments.poses), arguments)
    for pose, value, planned, far, turn, holds, seconds in found:
        row = f"{pose:4}{value:10.2f}{planned:9.2f}{far:8.3f}{turn:7.2f}"
        print(f"{row}{seconds:7.1f}{'' if holds else '  does not hold'}")
    values, seconds = np.array([each[1] for each in found]), [each[-1] for each in found]
    met = int(np.sum(values >= least))
    print(f"{met} of {len(found)} have {least:g} {unit} on Drake's plant, ", end="")
    print(f"CPU seconds: median {np.median(seconds):.1f}, at most {max(seconds):.1f}")
    return 0 if met >= 0.9 * arguments.poses else 1


def plan_one(
    name: str, pose: int, *, renewals: int
) -> tuple[int, float, float, float, float, bool, float]:
    """Returns the pose, measures in Drake and in the plan, m and rad to go, holds, CPU seconds."""
    scenario = DRAWN[name].draw(pose)
    world = World.from_scenario(scenario)
    planner = Planner(scenario, PlanOptions(renewals=renewals, finalists=1), world)
    _compile(name)
    plan, spent = clock(planner.plan)
    cost, in_drake = TaskCost.of(world, planner.scenario), plan.replay.drake
    assert in_drake is not None, "options confirm"
    goal = planner.scenario.goal_position
    value, planned = (DRAWN[name].measure(q.positions, goal) for q in (in_drake, plan.trajectory))
    off = np.where(cost.is_asked, cost.goal_errors(planner.scenario.initial_position), 0.0)
    far, turn = (float(np.linalg.norm(off[each])) for each in (~world.turns, world.turns))
    return pose, value, planned, far, turn, plan.holds, spent.cpu


@cache
def _compile(name: str) -> None:
    """Has machine code compiled, by a plan of few searches."""
    Planner(Scenario.named(name), PlanOptions(starts=1, renewals=0, finalists=1)).plan()


def draw_pose(seed: int) -> Scenario:
    """Returns push_tee from a random start, as the module says; the T turns the shorter way."""
    rng, shipped = np.random.default_rng(seed), Scenario.named("push_tee/to_pose")
    world, plain = World.from_scenario(shipped), shipped.to_plain()
    bar_to_center = 0.04071  # From the bar's outer edge, by which they place the T [m].

    def place(x: float, y: float, angle: float) -> dict[str, float]:
        # Their stem points along +y of the T, ours along -y.
        center = np.array([x, y]) + bar_to_center * np.array([-np.sin(angle), np.cos(angle)])
        turn = (angle + np.pi - 1.25 * np.pi + np.pi) % (2 * np.pi) - np.pi  # To the goal's.
        return {"tee_x": center[0], "tee_y": center[1], "tee_turn": turn + 1.25 * np.pi}

    x, y = rng.uniform(0.1, 0.4, 2)
    tee = place(x, y, 2 * np.pi * rng.standard_normal() - np.pi)
    plain |= {"goal_position": place(0.256, 0.256, np.pi / 4), "duration": 3.0, "time_step": 0.06}
    while True:
        disc = dict(zip(("disc_x", "disc_y"), rng.uniform(0.05, 0.45, 2), strict=True))
        if min(world.calc_signed_distance(np.array([*tee.values(), *disc.values()]))) > 0.0:
            return Scenario.from_plain({**plain, "initial_position": tee | disc})


def draw_cube(name: str, seed: int) -> Scenario:
    """Returns three_fingers from a random start to a random goal, as the module says."""
    rng, plain = np.random.default_rng(seed), Scenario.named(name).to_plain()
    start_height = 0.02975  # It sinks in by its weight [m].
    at, yaw = rng.uniform(-0.025, 0.025, 2), rng.uniform(-180, 180)
    to, height, angle = (
        rng.uniform(-0.1, 0.1, 2),
        rng.uniform(0.05, 0.1),
        rng.uniform(-np.pi, np.pi),
    )
    axis = np.array([0.0, 1.0, 1.0]) + 0.1 * rng.standard_normal(3)
    along = np.sin(angle / 2) * axis / np.linalg.norm(axis)
    goal: dict[str, object] = {"quaternion": [float(np.cos(angle / 2)), *along.tolist()]}
    if name.endswith("flip"):
        height, roll_and_pitch = 0.05, rng.uniform(-90, 90, 2)
        goal = {"rpy_deg": [*roll_and_pitch.tolist(), float(np.rad2deg(angle))]}
    elif name.endswith("turn"):
        height, goal = start_height, {"rpy_deg": [0.0, 0.0, float(np.rad2deg(angle))]}
    start = {"xyz": [*at.tolist(), start_height], "rpy_deg": [0.0, 0.0, yaw]}
    tips = {"left_x": -0.1, "right_x": 0.1, "back_y": 0.1}
    tips |= dict.fromkeys(("left_z", "right_z", "back_z"), 0.03)
    plain |= {"initial_position": {"cube": start, **tips}, "duration": 3.0}
    # It has to be held there; places count beside turns as in Jin's 500 |p|² + 5 (1 - (q · q*)²).
    plain["position_weight"] = {"cube": {"xyz": 400.0, "turn": 1.0}}
    plain["goal_weight"] = {"cube": {"xyz": 4000.0, "turn": 10.0}}
    plain["goal_position"] = {"cube": {"xyz": [*to.tolist(), height], **goal}}
    return Scenario.from_plain(plain)


def count_held(positions: Floats, goal: Floats) -> float:
    """Returns in how many of its last rows a cube is at its goal, a quaternion and a place last."""
    turned = 1.0 - (positions[:, -7:-3] @ goal[-7:-3]) ** 2
    off = np.linalg.norm(positions[:, -3:] - goal[-3:], axis=1)
    others = np.flatnonzero((turned >= 0.04) | (off >= 0.02))
    return float(len(positions) - 1 - np.max(others, initial=-1))


def cover(pose: Floats, goal: Floats) -> float:
    """Returns the share of the goal's area that a T at a pose (x, y, turn) covers."""
    (centers, halves), area = TEE, 0.0
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]])
    turn = _turn(goal[2]).T @ _turn(pose[2])
    for center, half in zip(centers, halves, strict=True):
        shape = (center + corners * half) @ turn.T + _turn(goal[2]).T @ (pose[:2] - goal[:2])
        for other, width in zip(centers, halves, strict=True):
            bounds = Bbox(np.array([other - width, other + width]))
            x, y = np.asarray(Path(shape, closed=True).clip_to_bbox(bounds).vertices).T
            area += abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)) / 2.0
    return area / float(4.0 * np.sum(np.prod(halves, axis=1)))


def _turn(angle: float) -> Floats:
    """Returns the matrix of a turn."""
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def run(name: str, *, renewals: int) -> Run:
    """Plans for one world from one seed, code compiled before."""
    planner = _make_planner(name, renewals)
    plan, spent = clock(planner.plan)
    replays, in_drake = list(plan.replay), plan.replay.drake
    assert in_drake is not None, "options confirm"
    if name.partition(" ")[0] in FROM_WHEELS:
        feedback = Feedback(planner.world, planner.scenario, plan.trajectory)
        replays.append(replay_with(MujocoJudge(), planner.world, planner.scenario, feedback))
    ends = [plan.trajectory.positions, *(replay.positions for replay in replays)]
    misses = tuple(_miss(planner, each[-1]) for each in ends)
    return Run(name, plan.cost, in_drake.cost, misses, plan.holds, spent.cpu)


def _make_planner(name: str, renewals: int) -> Planner:
    """Returns a planner for a world and a seed, machine code compiled."""
    world, _, seed = name.partition(" ")
    _compile(world)
    return Planner(
        Scenario.named(world), PlanOptions(renewals=renewals, finalists=1, seed=int(seed))
    )


def _miss(planner: Planner, end: Floats) -> tuple[float, float]:
    """Returns how far sliders and turns that the goal asks for are off it, [m] and [rad]."""
    cost, turns = TaskCost.of(planner.world, planner.scenario), planner.world.turns
    off = np.abs(np.where(cost.is_asked, cost.goal_errors(end), 0.0))
    return float(np.max(off[~turns], initial=0.0)), float(np.max(off[turns], initial=0.0))


class Judged(NamedTuple):
    """What our integration makes of a control."""

    cost: float
    miss: tuple[float, float]  # of its goal [m], [rad]

    @property
    def rank(self) -> tuple[bool, float]:
        """Reaching the goal comes first, then the cost."""
        return bool(np.any(np.array(self.miss) > MOST)), self.cost

    def __str__(self) -> str:
        """Returns three columns of a table."""
        return f"{self.cost:11.4g}{1e3 * self.miss[0]:8.1f}{self.miss[1]:7.3f}"


def compare(names: Sequence[str], arguments: argparse.Namespace) -> int:
    """Compares plans with samplers, and prints a table and how often plans are better."""
    print(f"{'':27}{'plan':>11}{'mm':>8}{'rad':>7}", end="")
    print("".join(f"{each:>22}{'':4}" for each in SAMPLERS) + f"{'CPU s':>8}")
    ask = ask_controllers if arguments.mujoco else ask_samplers
    better, work = 0, partial(compare_one, renewals=arguments.renewals, ask=ask)
    found = run_all(work, names, arguments)
    for name, ours, others, seconds in found:
        print(f"{name:27}{ours}{''.join(map(str, others))}{seconds:8.1f}")
        better += all(ours.rank < each.rank for each in others)
    print(f"{better} of {len(found)} plans are better than all samplers with as many CPU seconds")
    return 0 if better >= 8 / 9 * len(found) else 1


_Ask: TypeAlias = Callable[[Planner, ShootingProblem, float], list[Judged]]


def compare_one(name: str, *, renewals: int, ask: _Ask) -> tuple[str, Judged, list[Judged], float]:
    """Returns the name, what a plan and each sampler have, and the CPU seconds of each."""
    planner = _make_planner(name, renewals)
    plan, spent = clock(planner.plan)
    task = make_mechanism_task(planner.world, planner.scenario, planner.options)
    others = ask(planner, task.shooting(planner.scenario.num_steps), spent.cpu)
    return name, _judge(planner, plan.replay.event_driven), others, spent.cpu


def _judge(planner: Planner, replay: Replay) -> Judged:
    return Judged(replay.cost, _miss(planner, replay.positions[-1]))


def ask_samplers(planner: Planner, problem: ShootingProblem, seconds: float) -> list[Judged]:
    """Returns what samplers of whole tasks find, in the plan's own dynamics."""

    def calc_cost(control: Control) -> float:
        return roll_out(problem, control, IMPLICIT)

    others = []
    for method in SAMPLERS:
        generations = sample(problem, calc_cost, method)
        best = min((next(generations) for _ in within(seconds)), key=itemgetter(0))
        replay = replay_event_driven(planner.world, planner.scenario, *best[1])
        others.append(_judge(planner, replay))
    return others


def ask_controllers(planner: Planner, problem: ShootingProblem, seconds: float) -> list[Judged]:
    """Returns what sampling controllers do in MuJoCo."""
    task = MujocoTask(planner.world, planner.scenario, problem)
    runs = (task.control(method, seconds) for method in SAMPLERS)
    return [Judged(cost, _miss(planner, end)) for cost, end in runs]


class Drawn(NamedTuple):
    """Tasks that are drawn of one world, and how good a plan for one is."""

    draw: Callable[[int], Scenario]  # by a seed
    measure: Callable[[Floats, Floats], float]  # of positions (N + 1, nq) and the goal (nq,)
    least: float
    unit: str


_OF_CUBES = ("three_fingers/flip", "three_fingers/lift", "three_fingers/turn")
DRAWN = {
    "push_tee/to_pose": Drawn(
        draw_pose, lambda q, goal: 100 * cover(q[-1, :3], goal[:3]), 95, "% covered"
    ),
    **{each: Drawn(partial(draw_cube, each), count_held, 20, "steps") for each in _OF_CUBES},
}


if __name__ == "__main__":
    run_as("benchmarks.space")
