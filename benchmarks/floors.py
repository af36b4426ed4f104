"""How often is the plan the best motion on a floor, where balls settle, rest and jump?

    python -m benchmarks.floors --count 200 --seed 0 --workers 2

Starts, goals, durations, masses and gravities are drawn by chance, and e is in turn from 1 to 0. A
plan succeeds if its event-driven replay costs no more than 1.01 J* + 1e-7, where J* is the best of
doing nothing and of what `floor_optimum` finds. What costs less than J* is reported: then J* is not
what it is said to be. Exits with 1 if fewer than 95 % succeed.

`floor_optimum` is no part of the package, and knows no knots, no boxes and no planner. It searches
globally on a grid of times and impact speeds: dynamic programming over touches, from the last one
back, by the number of those to come. Then exactly: Newton's method on times and speeds
(`LineSequence`), from the best motion of the grid for each number of touches and each local optimum
of the first one's time.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from benchmarks.optima.line_optimum import Line, LineSequence, Wall
from benchmarks.script import read_flags, run_all, run_as
from benchmarks.worlds import ABSOLUTE, RELATIVE, plan
from drake_aigto.arrays import Floats, Ints
from drake_aigto.kernels import kernel
from drake_aigto.simulation import replay_event_driven
from drake_aigto.world import Scenario, World, models_directory

# The grid: times of touches, speeds before them, and the fastest, of what falling freely reaches.
_TIMES, _SPEEDS, _FASTEST = 100, 90, 1.6
# The most touches that are tried, or the most beyond the best number, at which costs only rise.
_MOST_TOUCHES, _BEYOND = 16, 4
# Below the floor by this much is on it.
_TOLERANCE = 1e-9


@dataclass(frozen=True)
class FloorMotion:
    """The best motion of some kind."""

    cost: float  # of it
    touches: int  # how many have a speed; of settling the first one only
    rests: bool = False  # whether it settles
    leaves: bool = False  # whether it jumps off, after that


def floor_optimum(scenario: Scenario, gravity: float, mass: float) -> FloorMotion:
    """Returns the best motion that is found of a point mass on the floor q ≥ 0.

    Args:
        scenario: start, goal, duration, weights and restitution.
        gravity: towards the floor [m/s²].
        mass: [kg].
    """
    T = scenario.duration
    price = mass**2 * scenario.control_weight / T**3
    line = Line(
        position=float(scenario.initial_position[0]),
        velocity=float(scenario.initial_velocity[0] * T),
        goal=float(scenario.goal_position[0]),
        weight=scenario.goal_weight / price,
        gravity=gravity * T**2,
        walls=(Wall(0.0, 1, scenario.restitution),),
    )
    best = min(_list_motions(line), key=lambda motion: motion.cost)
    return FloorMotion(price * best.cost, best.touches, best.rests, best.leaves)


def _list_motions(line: Line) -> Iterator[FloorMotion]:
    """Yields what may be the best motion, in unit time."""
    simple = line.optimum(most_touches=0)  # It flies, or falls and stays.
    yield FloorMotion(simple.cost, len(simple.bounces), simple.rest is not None)
    grid, least, last = _Grid(line), math.inf, 0
    for number in range(1, _MOST_TOUCHES + 1):
        grid.add_touch()
        for cost, legs in grid.best_motions():
            if cost < least:
                least, last = cost, number
            yield from _polish(line, cost, legs)
        if number - last >= _BEYOND:
            return


@dataclass(frozen=True)
class _Leg:
    """A flight of a motion on the grid to a touch, and how long it rests after that, if it does."""

    time: float
    speed: float
    rest: float | None


def _polish(line: Line, cost: float, legs: list[_Leg]) -> Iterator[FloorMotion]:
    """Yields a motion of the grid, and the local optima next to it that have its touches."""
    number, rests = len(legs), [i for i, leg in enumerate(legs) if leg.rest is not None]
    stays = bool(rests) and math.isinf(legs[-1].rest or 0.0)
    yield FloorMotion(cost, number, bool(rests), bool(rests) and not stays)
    if stays or len(rests) > 1:
        return
    place = rests[0] if rests else None
    z = [*(leg.time for leg in legs), *(leg.speed for leg in legs)]
    for slack in (False, True) if rests else (False,):
        sequence = LineSequence(line, (0,) * number, place, slack)
        start = [*z, *(max(legs[i].rest or 0.0, 1e-3) for i in rests if slack)]
        for exact, found in sequence.flights.minimize(np.array([start])):
            if sequence.is_admissible(found):
                yield FloorMotion(exact, number, bool(rests), bool(rests))


class _Grid:
    """Motions of a line in unit time whose touches are on a grid.

    Tables are over the time i/n of a touch and the speed y_j before it, from which on the ball
    flies with e y_j, or settles, at no cost, in 2 e y_j/(g (1 − e)), and jumps when it likes. Lists
    have a table for each number of touches to come.
    """

    def __init__(self, line: Line) -> None:
        self.line = line
        g, (wall,) = line.gravity, line.walls
        self.times = np.arange(_TIMES) / _TIMES
        fall = math.sqrt(line.velocity**2 + 2 * g * max(line.position, line.goal))
        self.speeds = _FASTEST * fall * (np.arange(_SPEEDS) + 0.5) / _SPEEDS
        self.after = np.append(wall.restitution * self.speeds, 0.0)  # At last, from rest.
        self.durations = np.arange(1, _TIMES) / _TIMES
        v, y, t = self.after[:, None], self.speeds, self.durations[:, None, None]
        self.hops = (g * t - y - v) ** 2 / t + 3 * (y - v) ** 2 / t
        self.first = self._first_flights()
        self.settled = np.full((_TIMES, _SPEEDS), _TIMES)  # When; never, with e = 1.
        if wall.restitution < 1:
            ends = self.times[:, None] + line.settling(wall) * self.speeds
            self.settled = np.minimum(np.ceil(ends * _TIMES - 1e-9), _TIMES).astype(np.int64)
        self.flights = [
            np.array([[self._finish(v, 1 - t) for v in self.after] for t in self.times])
        ]
        self.hopped: list[Ints] = [np.empty((0, 0), dtype=np.int64)]  # To which state, k n + l.
        self.jumps: list[Ints] = []  # When, from rest at each time.
        self.touched: list[Floats] = []
        self.settles: list[Ints] = []

    def _finish(self, v: float, left: float) -> float:
        """Returns what the last flight from the floor costs; infinity if it would go below."""
        w, g, goal = self.line.weight, self.line.gravity, self.line.goal
        missed = goal - v * left + g * left**2 / 2
        lift = w / (3 + w * left**3) * missed
        # x(s) = s (v + slope s/2 − lift s²/2), s up to what is left: lowest at an end or between.
        slope = 3 * lift * left - g
        lows = [v, v + slope * left / 2 - lift * left**2 / 2]
        if lift < 0 and 0 < (at := slope / (2 * lift)) < left:
            lows.append(v + slope * at / 2 - lift * at**2 / 2)
        if min(lows) < -_TOLERANCE:
            return math.inf
        return 3 * w / (3 + w * left**3) * missed**2

    def _first_flights(self) -> Floats:
        """Returns what it costs to be at the floor at a time, with a speed."""
        p, v, g = self.line.position, self.line.velocity, self.line.gravity
        t, end = self.durations[:, None], -self.speeds
        cost = (end - v + g * t) ** 2 / t + 12 * (p + (v + end) * t / 2) ** 2 / t**3
        # In parts s of the time: (1 − s)(p + (p + vt) s + bend s²), with p > 0.
        slope, bend = p + v * t, -(2 * p + (v + end) * t)
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -slope / (2 * bend)
            dips = (bend > 0) & (at > 0) & (at < 1) & (p < slope**2 / (4 * bend))
        return np.where(dips, math.inf, cost)

    def add_touch(self) -> None:
        """Adds the tables of one touch more."""
        number = len(self.touched)
        if number:
            costs, states = _hop(self.hops, self.touched[-1])
            self.flights.append(costs)
            self.hopped.append(states)
        rest = np.append(self.flights[-1][:, -1], math.inf)
        if number == 0:
            rest[-1] = self.line.weight * self.line.goal**2  # It stays.
        later = np.minimum.accumulate(rest[::-1])[::-1]
        when = np.array([i + int(np.argmin(rest[i:])) for i in range(_TIMES + 1)])
        settled = later[self.settled]
        settled[self.settled == _TIMES] = math.inf
        flying = self.flights[-1][:, :-1]
        self.jumps.append(when)
        self.settles.append((settled < flying).astype(np.int64))
        self.touched.append(np.minimum(settled, flying))

    def best_motions(self) -> Iterator[tuple[float, list[_Leg]]]:
        """Yields cost and legs of the best motions with as many touches as there are tables.

        There is one for each local optimum of the first touch's time.
        """
        total = self.first + self.touched[-1][1:]
        costs = np.append(np.append(math.inf, np.min(total, axis=1)), math.inf)
        for i in range(1, _TIMES):
            if costs[i] < math.inf and costs[i] <= min(costs[i - 1], costs[i + 1]):
                yield float(costs[i]), self._trace(i, int(np.argmin(total[i - 1])))

    def _trace(self, time: int, speed: int) -> list[_Leg]:
        """Returns the legs of the best motion whose first touch is this."""
        legs, left = [], 0
        for number in range(len(self.touched) - 1, -1, -1):
            duration, state, rest = (time - left) / _TIMES, speed, None
            left = time
            if self.settles[number][time, speed]:
                settled = int(self.settled[time, speed])
                left, state = int(self.jumps[number][settled]), _SPEEDS
                slack = left / _TIMES - self.times[time] - self._settling(speed)
                rest = math.inf if left == _TIMES else slack
            legs.append(_Leg(duration, float(self.speeds[speed]), rest))
            if number:
                time, speed = divmod(int(self.hopped[number][left, state]), _SPEEDS)
        return legs

    def _settling(self, speed: int) -> float:
        return self.line.settling(self.line.walls[0]) * float(self.speeds[speed])


@kernel
def _hop(hops: Floats, touched: Floats) -> tuple[Floats, Ints]:
    """Returns the least cost from each time and state on over a hop, and which touch that ends in.

    Args:
        hops: the effort by duration, state before and speed after it.
        touched: what is left from each touch on.
    """
    n, m = touched.shape
    costs, states = np.full((n, m + 1), np.inf), np.zeros((n, m + 1), np.int64)
    for i in range(n):
        for s in range(m + 1):
            for k in range(i + 1, n):
                for j in range(m):
                    cost = hops[k - i - 1, s, j] + touched[k, j]
                    if cost < costs[i, s]:
                        costs[i, s] = cost
                        states[i, s] = k * m + j
    return costs, states


ASKED = 0.95
RESTITUTIONS = (1.0, 0.8, 0.5, 0.3, 0.1, 0.0)
# What others are drawn from, evenly: [m], [m/s], [m], [s], [m/s²], [kg].
POSITIONS, VELOCITIES, GOALS = (0.1, 1.0), (-2.0, 2.0), (0.0, 1.0)
DURATIONS, GRAVITIES, MASSES = (0.5, 2.0), (1.6, 20.0), (0.3, 3.0)


@dataclass(frozen=True)
class Job:
    """One scenario, how strongly it is pulled down [m/s²], and the mass [kg]."""

    scenario: Scenario
    gravity: float
    mass: float


@dataclass(frozen=True)
class Outcome:
    """What became of it: the best that is known, and what the plan costs."""

    job: Job
    known: FloorMotion
    cost: float
    seconds: float
    told: str

    @property
    def succeeded(self) -> bool:
        """Whether the plan is the best that is known."""
        return self.cost <= (1 + RELATIVE) * self.known.cost + ABSOLUTE


def draw(count: int, seed: int) -> Iterator[tuple[Scenario, float, float]]:
    """Yields scenarios with their gravity and mass; the first ones do not depend on the count."""
    generator = np.random.default_rng(seed)
    for number in range(count):
        q, v, goal, T, gravity, mass = (
            generator.uniform(*interval)
            for interval in (POSITIONS, VELOCITIES, GOALS, DURATIONS, GRAVITIES, MASSES)
        )
        scenario = Scenario(
            model="package://drake_aigto_models/floor.sdf",
            initial_position=q,
            initial_velocity=v,
            goal_position=goal,
            duration=round(T, 1),
            restitution=RESTITUTIONS[number % len(RESTITUTIONS)],
        )
        yield scenario, gravity, mass


def make_world(gravity: float, mass: float) -> World:
    """Returns the shipped floor with another gravity [m/s²] and mass [kg]."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    Parser(plant).AddModels(str(models_directory() / "floor.sdf"))
    plant.mutable_gravity_field().set_gravity_vector([0.0, 0.0, -gravity])
    plant.Finalize()
    return World.from_diagram(builder.Build(), mass)


def run(job: Job) -> Outcome:
    """Plans, and searches for what is better."""
    scenario, world = job.scenario, make_world(job.gravity, job.mass)
    known = floor_optimum(scenario, job.gravity, job.mass)
    times = np.linspace(0.0, scenario.duration, scenario.num_steps + 1)
    idle = replay_event_driven(world, scenario, times, np.zeros((scenario.num_steps, 1)))
    if idle.cost < known.cost:
        known = FloorMotion(idle.cost, len(idle.bounce_times))
    start = time.perf_counter()
    made, cost = plan(world, scenario)
    seconds = time.perf_counter() - start
    told = f"{made.best.origin}: {made.best.describe_contacts()}" if made else "no plan"
    return Outcome(job, known, cost, seconds, told)


def report(outcomes: list[Outcome]) -> bool:
    """Prints the figures; returns whether enough plans are the best."""
    for outcome in outcomes:
        job, known = outcome.job, outcome.known
        scenario = job.scenario
        about = (
            f"q {scenario.initial_position[0]:.6f}, v {scenario.initial_velocity[0]:.5f}, "
            f"goal {scenario.goal_position[0]:.6f}, T {scenario.duration:g}, "
            f"e {scenario.restitution:g}, mass {job.mass:.5f}, gravity {job.gravity:.5f}"
        )
        if not outcome.succeeded:
            print(f"MISSED  {outcome.cost:.4e} by {outcome.told}; known {known}: {about}")
        if outcome.cost < (1 - RELATIVE) * known.cost - ABSOLUTE:
            print(f"BELOW the known {known.cost:.4e}: plan {outcome.cost:.4e}, {about}")
    count, right = len(outcomes), sum(outcome.succeeded for outcome in outcomes)
    print(f"floors, the best known: {right} of {count}, asked: {ASKED:.0%}")
    for e in RESTITUTIONS:
        mine = [o.succeeded for o in outcomes if o.job.scenario.restitution == e]
        print(f"  e = {e:g}: {sum(mine)} of {len(mine)}")
    shapes = Counter((o.known.rests, o.known.leaves) for o in outcomes)
    print(
        f"the best motion rests and jumps: {shapes[True, True]}, "
        f"rests to the end: {shapes[True, False]}, never rests: {shapes[False, False]}"
    )
    seconds = [outcome.seconds for outcome in outcomes]
    print(f"seconds a plan: median {np.median(seconds):.2f}, at most {np.max(seconds):.2f}")
    return right >= ASKED * count


def main() -> int:
    """Runs all scenarios and returns the exit status."""
    options = read_flags(__doc__, count=(200, ""), seed=(0, ""))
    jobs = [Job(*each) for each in draw(options.count, options.seed)]
    outcomes = run_all(run, jobs, options)
    is_enough = report(outcomes)
    print(f"{len(outcomes)} of {len(jobs)} scenarios done")
    return 0 if is_enough and len(outcomes) == len(jobs) else 1


if __name__ == "__main__":
    run_as("benchmarks.floors")
