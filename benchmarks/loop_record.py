"""Worlds, what disturbs them, and five controllers of the same plan: what each makes of it.

    python -m benchmarks.loop_record [--only soft,rigid] [--seeds 1] [--keep FILE] [--minutes 60]

Every plant is another one than the plan's by a single thing, or by all of them at once; noise and
kicks are drawn by seed, all else runs once. Plants run in Drake's Simulator until the scenario
ends; costs are those of what happened, and CPU is that of a tick (the median of a run, then of
all; the longest in medians of its run, then the median of all runs, and the worst).

Controllers: the plan's control alone; a time-varying LQR as one writes it by hand, by the clock,
about the smooth dynamics, compliant walls included; `TrackingController`, which estimates mass,
friction and stiffness where its laws are judged by a model; `ModelPredictiveController` from the
same plan, which estimates what mechanisms' models may have wrong; and MPPI, which moves the plan's
control to samples about it, by their cost in our own simulation, but not where a tick of it would
take seconds (`_SLOW`). The tracker and what plans again are told the
delay and the limits of actuators. Where states are measured with noise, all of these
get as many from a `StateFilter`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, EventStatus, State

from benchmarks.baselines import weigh
from benchmarks.script import machine, read_flags, run_all, run_as
from drake_aigto import (
    AigtoError,
    ModelPredictiveController,
    Plan,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
    World,
)
from drake_aigto.arrays import Floats
from drake_aigto.control import (
    ClosedLoopRun,
    Disturbance,
    ModelEstimate,
    PlannedMotion,
    Safety,
    run_in_loop,
)
from drake_aigto.errors import ControlError
from drake_aigto.planning import make_mechanism_task
from drake_aigto.simulation import EVENT_DRIVEN, Held, HeldControl, Parabolas
from drake_aigto.world import Scales, TaskCost

WORLDS = (
    *("table1/1", "corridor/three_bounces", "room/bank_shot", "floor/rebound"),
    *("cart_pole/soft_06", "cart_pole/rigid_06", "hopper/hop", "spinner/two_radians"),
    *("acrobot/swing_up", "pushed_block/slide"),
)
_SLOW = ("cart_pole/rigid_06", "hopper/hop")
METHODS = ("open loop", "TVLQR", "tracking", "planning again", "MPPI")
# Factors of masses, friction and stiffness; walls are as much nearer, of their room (`find_room`).
OFF = (0.2, -0.2, 0.1, -0.1, 0.05, -0.05)
NOISES = (2e-3, 5e-3)  # [m, rad], and ten times as much of velocities [1/s]
DELAYS = (0.01, 0.02, 0.04)  # [s]
KICK, CUT = 0.3, 0.8  # of the task's velocity, and of the largest control of the plan
# Of controls of the plan; and the part of the mean excess of costs that weighs as 1 / e.
_SPREAD, _TEMPERATURE, _SAMPLES, _KNOTS = 0.1, 0.1, 16, 8
_BALLS = PlanOptions(branches=0, finalists=1, threads=1)
_UNKNOWN: tuple[Any, ...] = ("mass", "friction", "stiffness", "walls")
_WITHIN = 1.1  # times the best counts as best


Job = tuple[str, int, str]  # a world, a seed, and the disturbance's name


class Prepared(NamedTuple):
    """A world, its plan, and how it is planned again."""

    world: World
    plan: Plan
    planner: Planner
    period: float  # of samples and ticks [s]
    options: dict[str, Any]


class Outcome(NamedTuple):
    """A run of a method."""

    cost: float
    seconds: float  # of CPU, of a tick: the median
    longest: float  # in medians


@cache
def prepare(name: str) -> Prepared:
    """Returns a world's plan and planner."""
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    planner = Planner(scenario, PlanOptions(threads=1), world)
    options: dict[str, Any] = {"horizon": "shrinking", "search_ticks": "auto"}
    if planner.is_of_balls:
        return Prepared(world, planner.plan(), Planner(scenario, _BALLS, world), 0.01, options)
    if not world.frictions:
        options["feedback_period"] = 0.005
    if world.contacts and (scenario.contact == "rigid" or world.frictions):
        options["surprise"] = np.inf
    options["estimate"] = [each for each in _UNKNOWN if may_be_unknown(world, scenario, each)]
    period = scenario.time_step if world.frictions else 0.02
    return Prepared(world, planner.plan(), planner, period, options)


def may_be_unknown(world: World, scenario: Scenario, what: Any) -> bool:
    """Returns whether a model has something that may be estimated."""
    try:
        ModelEstimate.of(world, scenario, [what])
    except AigtoError:
        return False
    return True


class Clocked(ModelPredictiveController):
    """One that also keeps what CPU time each tick took, in `cpu` [s]."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self.cpu: list[float] = []

    def _tick(self, context: Context, state: State) -> EventStatus:
        begin = time.thread_time()  # Searches have threads of their own.
        status = super()._tick(context, state)
        self.cpu.append(time.thread_time() - begin)
        return status


class ByTheClock:
    """The plan's states and controls, for laws that count no bounces."""

    stretches = ()

    def __init__(self, plan: Plan, world: World) -> None:
        self.world, self.motion = world, PlannedMotion.of(plan.best)
        self.scenario, self.trajectory = plan.scenario, plan.trajectory
        self.end, self.cost = plan.scenario.duration, TaskCost.of(world, plan.scenario)
        self.bounds = world.bounds(plan.scenario).control
        self.seconds: list[float] = []

    def find_state(self, time: float, bounces: Sequence[int]) -> Floats:
        """Returns q and v of the plan."""
        return self.motion.calc_state(time)

    def sample(self, now: float, x: Floats, bounces: Sequence[int]) -> Held:
        """Returns the law's control, and notes its CPU time."""
        begin = time.process_time()
        u = np.clip(self.answer(now, x), *self.bounds)
        self.seconds.append(time.process_time() - begin)
        return Held(u, np.inf)

    def answer(self, now: float, x: Floats) -> Floats:
        """Returns u."""
        raise NotImplementedError


class Regulated(ByTheClock):
    """u = u_k − K_k (x − x*(t)), with K_k of Riccati's equation and the task's weights."""

    def __init__(self, plan: Plan, world: World) -> None:
        super().__init__(plan, world)
        cost, (t, us) = self.cost, (self.trajectory.times, self.trajectory.controls)
        S = np.block([[cost.QT, 0 * cost.QT], [0 * cost.QT, cost.QTv]])
        Q, self._gains = np.diag(np.concatenate([cost.Q, cost.Qv])), list[Floats]()
        for k in reversed(range(len(us))):
            x, dt = self.motion.calc_state((t[k] + t[k + 1]) / 2), t[k + 1] - t[k]
            A, B = self._differentiate(x, us[k], dt)
            K = np.linalg.solve(np.diag(cost.R) * dt + B.T @ S @ B, B.T @ S @ A)
            S = Q * dt + A.T @ S @ (A - B @ K)
            self._gains.insert(0, K)

    def _differentiate(self, x: Floats, u: Floats, dt: float) -> tuple[Floats, Floats]:
        both, step = np.concatenate([x, u]), 1e-6
        columns = [
            (self._move(both + e, dt) - self._move(both - e, dt)) / (2 * step)
            for e in step * np.eye(len(both))
        ]
        A, B = np.split(np.array(columns).T, [len(x)], axis=1)
        return A, B

    def _move(self, both: Floats, dt: float) -> Floats:
        x, u = np.split(both, [len(both) - self.world.num_actuators])
        if self.scenario.contact == "rigid":
            q, v = np.split(x, 2)
            for _ in range(10):
                a = self.world.calc_acceleration(q, v, u)
                middle = v + dt / 20 * a
                a = self.world.calc_acceleration(q + dt / 20 * v, middle, u)
                q, v = q + dt / 10 * middle, v + dt / 10 * a
            return np.concatenate([q, v])
        held, state = HeldControl(np.array([0.0, dt]), u[None]), self.world.split(x)
        end = EVENT_DRIVEN.simulate(self.world, self.scenario, held, state)
        return np.concatenate([end.positions[-1], end.velocities[-1]])

    def answer(self, now: float, x: Floats) -> Floats:
        k = int(np.searchsorted(self.trajectory.times, now, side="right")) - 1
        k = min(max(k, 0), len(self._gains) - 1)
        planned = self.motion.calc_state(now)
        error = self.world.calc_error(x, planned)
        return np.asarray(self.trajectory.controls[k] - self._gains[k] @ error)


class Sampled(ByTheClock):
    """MPPI (Williams et al., 2017) about the plan's control, over what is left of the horizon."""

    def __init__(self, plan: Plan, prepared: Prepared) -> None:
        super().__init__(plan, prepared.world)
        self._rng, self._us = np.random.default_rng(0), np.array(self.trajectory.controls)
        self._spread = _SPREAD * np.max(np.abs(self._us), axis=0)
        self._problem = None
        if not prepared.planner.is_of_balls:
            task = make_mechanism_task(self.world, self.scenario, PlanOptions())
            self._problem = task.shooting(len(self._us))

    def answer(self, now: float, x: Floats) -> Floats:
        times = self.trajectory.times
        k = min(int(np.searchsorted(times, now + 1e-9, side="right")) - 1, len(self._us) - 1)
        knots = np.concatenate([[now], times[k + 1 :]])
        if knots[-1] - now < 1e-3 * self.scenario.time_step:
            return self._us[-1]
        count = len(knots) - 1
        shares = np.linspace(0, 1, _KNOTS), (np.arange(count) + 0.5) / count
        samples = 8 * _SAMPLES if self._problem is None else _SAMPLES
        noise = self._spread * self._rng.normal(size=(samples, _KNOTS, len(self._spread)))
        noise[0] = 0.0
        held = np.array(
            [[np.interp(shares[1], shares[0], column) for column in each.T] for each in noise]
        ).transpose(0, 2, 1)
        us = np.clip(self._us[k:] + held, *self.bounds)
        costs = self._price(knots, us, x)
        costs = np.where(np.isfinite(costs), costs, np.inf)
        if not np.any(np.isfinite(costs)):
            return self._us[k]
        weights = weigh(costs, _TEMPERATURE)
        self._us[k:] = np.tensordot(weights / weights.sum(), us, 1)
        return self._us[k]

    def _price(self, knots: Floats, us: Floats, x: Floats) -> Floats:
        """Returns what controls (S, N, nu) from a state on cost, shape (S,)."""
        if self._problem is not None:
            problem = dataclasses.replace(self._problem, times=knots, start=np.array(x))
            return np.array([problem.simulate(u, substeps=4).exact_cost for u in us])
        e, state = self.world.restitutions(self.scenario), self.world.split(x)
        rolls = Parabolas(self.world.constant_dynamics, e, state, knots - knots[0])
        ends = rolls.find_ends(us)
        efforts = [self.cost.effort(knots, u) for u in us]
        return np.asarray(efforts + self.cost.final(ends, np.zeros_like(ends)))


def list_disturbances(
    world: World, scenario: Scenario, seed: int, largest: Floats
) -> Iterator[tuple[str, Disturbance]]:
    """Yields names and disturbances; of all seeds but 0, only what is random.

    Args:
        world: of the scenario.
        scenario: its task.
        seed: of noise and kicks.
        largest: |u| of the plan, shape (nu,) [N, N m].
    """
    n, scales = world.num_positions, Scales.of(world, scenario)
    rng = np.random.default_rng((2035, seed))
    noise = np.repeat([1.0, 10.0], n)
    kick: dict[str, Any] = {
        "kick": KICK * scales.velocity * rng.normal(size=n),
        "kick_time": float(rng.uniform(0.1, 0.7) * scenario.duration),
    }
    walls = find_room(world, scenario)
    for size in NOISES:
        yield f"noise {1e3 * size:g}", Disturbance(noise=size * noise, seed=seed)
    yield "kick", Disturbance(**kick)
    signs = rng.choice([-1.0, 1.0], size=4)
    everything: dict[str, Any] = {
        "mass_factor": 1 + 0.1 * signs[0],
        "noise": NOISES[0] * noise,
        "seed": seed,
        "delay": DELAYS[0],
        **kick,
    }
    if world.frictions:
        everything["friction_factor"] = 1 + 0.1 * signs[1]
    if walls:
        everything["wall_shift"] = 0.05 * signs[2] * walls
    yield "all at once", Disturbance(**everything)
    if seed:
        return
    yield "nothing", Disturbance()
    yield f"cut at {CUT:g}", Disturbance(saturation=CUT * largest)
    for delay in DELAYS:
        yield f"delay {1e3 * delay:g}", Disturbance(delay=delay)
    for off in OFF:
        yield f"mass {off:+g}", Disturbance(mass_factor=1 + off)
        if world.frictions:
            yield f"friction {off:+g}", Disturbance(friction_factor=1 + off)
        if walls:
            yield f"wall {off:+g}", Disturbance(wall_shift=off * walls)
        if scenario.contact == "compliant":
            yield f"stiffness {off:+g}", Disturbance(stiffness_factor=1 + off)


def find_room(world: World, scenario: Scenario) -> float:
    """Returns how far off the nearest wall is at the start or the goal, where it is farther [m].

    0 if there are none, if both touch one, or if not all have one face each that stands still.
    """
    try:
        Disturbance(wall_shift=1e-3).apply(world, scenario)
    except AigtoError:
        return 0.0
    ends = np.stack([scenario.initial_position, scenario.goal_position])
    room = float(np.min(np.max(world.calc_signed_distance(ends), axis=0)))
    return room if room > 1e-9 else 0.0


def list_jobs(names: Sequence[str], seeds: int) -> list[Job]:
    """Returns all worlds, seeds and disturbances.

    Whenever time is up, all worlds have had about as many.
    """
    asked = {each: Scenario.named(each) for each in names}
    worlds = {each: World.from_scenario(scenario) for each, scenario in asked.items()}
    listed = [
        (seed, number, name, what)
        for seed in range(seeds)
        for name, world in worlds.items()
        for number, (what, _) in enumerate(
            list_disturbances(world, asked[name], seed, np.ones(world.num_actuators))
        )
    ]
    return [(name, seed, what) for seed, _, name, what in sorted(listed)]


def make_controller(method: str, prepared: Prepared, disturbance: Disturbance) -> Any:
    """Returns a method's controller; ours know the delay, and the limits of actuators."""
    world, plan, planner, period, options = prepared
    if method == "open loop":
        # Nothing is near enough to be brought back.
        return TrackingController(plan, period=period, safety=Safety(far=1e-12))
    known: dict[str, Any] = {"delay": disturbance.delay}
    if disturbance.saturation.any():
        known["safety"] = Safety(control=disturbance.saturation)
    if method == "planning again":
        return Clocked(planner, period, plan=plan, **known, **options)
    # No sensor of noise is read more often by one than by another.
    often = period if disturbance.noise.any() else min(period, plan.scenario.time_step / 5)
    if method == "tracking":
        unknown = [each for each in options.get("estimate", ()) if each != "walls"]
        try:
            return TrackingController(plan, world, period=often, estimate=unknown, **known)
        except ControlError:  # It has one law at a time, which no model judges.
            return TrackingController(plan, world, period=often, **known)
    law = Regulated(plan, world) if method == "TVLQR" else Sampled(plan, prepared)
    each = often if method == "TVLQR" else period
    controller: Any = TrackingController(plan, world, period=each)
    controller.feedback = law
    return controller


def simulate(
    job: Job, methods: Sequence[str], beyond: float = 0.0
) -> Iterator[tuple[str, Any, ClosedLoopRun | None]]:
    """Yields methods, their controllers, and their runs under a disturbance; None: it failed.

    Args:
        job: world, seed and disturbance.
        methods: their names.
        beyond: how long runs go on after the scenario's end [s].
    """
    name, seed, what = job
    prepared = prepare(name)
    plan, world = prepared.plan, prepared.world
    largest = np.max(np.abs(plan.trajectory.controls), axis=0)
    disturbance = dict(list_disturbances(world, plan.scenario, seed, largest))[what]
    end = plan.scenario.duration + beyond
    for method in methods:
        controller = make_controller(method, prepared, disturbance)
        try:
            filters = bool(disturbance.noise.any()) and method != "open loop"
            about = controller, plan.scenario, world, disturbance, end
            loop = run_in_loop(*about, filters=filters)
        except AigtoError as error:
            print(f"{name}, {what}, seed {seed}: {method}: {error}", flush=True)
            loop = None
        yield method, controller, loop


def run(job: Job) -> tuple[Job, dict[str, Outcome]]:
    """Returns what all methods make of a disturbance."""
    name, seed, what = job
    found = dict.fromkeys(METHODS, Outcome(np.nan, np.nan, np.nan))
    for method, controller, loop in simulate(job, METHODS[:-1] if name in _SLOW else METHODS):
        seconds = getattr(controller, "cpu", None) or getattr(controller.feedback, "seconds", [])
        middle = float(np.median(seconds)) if seconds and loop else np.nan
        longest = max(seconds) / middle if seconds and loop else np.nan
        found[method] = Outcome(loop.cost if loop else np.inf, middle, longest)
    costs = ", ".join(f"{method} {found[method].cost:.4g}" for method in found)
    print(f"{name}, {what}, seed {seed}: {costs}", flush=True)
    return job, found


def report(name: str, runs: Sequence[tuple[str, dict[str, Outcome]]]) -> str:
    """Returns a table of a world: medians of cost, of each kind of disturbance."""
    lines = [f"{name}: cost, the median of n runs", f"{'':<14}{'n':>4}"]
    lines[1] += "".join(f"{method:>16}" for method in METHODS)
    for what in dict.fromkeys(each for each, _ in runs):
        rows = [found for each, found in runs if each == what]
        costs = [np.median([row[method].cost for row in rows]) for method in METHODS]
        lines.append(f"{what:<14}{len(rows):>4}" + _list_cells(costs, "16.4g"))
    all_costs = np.array([[found[method].cost for method in METHODS] for _, found in runs])
    shares = np.mean(all_costs <= _WITHIN * np.nanmin(all_costs, axis=1, keepdims=True), axis=0)
    near = np.where(np.isnan(all_costs).all(axis=0), np.nan, shares)
    lines.append(f"{'within 10 %':<18}" + _list_cells(near, "16.0%"))
    ticks = np.array([[found[method][1:] for method in METHODS] for _, found in runs])
    for label, statistic, values, form in (
        ("ms a tick", np.median, 1e3 * ticks[..., 0], "16.2f"),
        ("longest / median", np.median, ticks[..., 1], "16.1f"),
        ("of the worst run", np.max, ticks[..., 1], "16.1f"),
    ):
        lines.append(f"{label:<18}" + _list_cells(_sum_up(statistic, values), form))
    ahead = np.mean(all_costs[:, 2] <= _WITHIN * all_costs[:, 1])
    lines.append(f"tracking costs at most 10 % more than TVLQR in {100 * ahead:.0f} %")
    return "\n".join(lines)


def _sum_up(statistic: Callable[[Floats], Any], values: Floats) -> list[float]:
    """Returns a statistic of each column (R, M), without what was not measured."""
    return [
        float(statistic(each)) if len(each) else np.nan
        for each in (column[np.isfinite(column)] for column in values.T)
    ]


def _list_cells(values: Iterable[float], form: str) -> str:
    """Returns columns of a table; what was not measured is a dash."""
    return "".join(f"{'-':>16}" if np.isnan(value) else f"{value:{form}}" for value in values)


def pick(worlds: Sequence[str], only: str) -> list[str]:
    """Returns the worlds that have one of several parts, separated by commas, in their names."""
    return [each for each in worlds if any(part in each for part in only.split(","))]


def run_worlds(
    doc: str | None,
    worlds: Sequence[str],
    run: Callable[[Job], tuple[Job, Any]],
    report: Callable[[str, Any], str],
) -> int:
    """Runs a script's jobs on all disturbances of its worlds, and prints a report of each world."""
    options = read_flags(
        doc, only=("", "worlds with one of these in their names"), seeds=(1, "of noise and kicks")
    )
    print(machine(), flush=True)
    names = pick(worlds, options.only)
    done = run_all(run, list_jobs(names, options.seeds), options)
    for name in names:
        if runs := [(what, found) for (other, _, what), found in done if other == name]:
            print(f"\n{report(name, runs)}", flush=True)
    return 0


def main() -> int:
    """Runs all methods on all disturbances of all worlds, and prints a table of each world."""
    return run_worlds(__doc__, WORLDS, run, report)


if __name__ == "__main__":
    run_as("benchmarks.loop_record")
