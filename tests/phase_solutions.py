"""Multi-phase problems, solved and checked, and what their optima cost by closed forms."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from replay_worlds import make_scenario
from scipy.optimize import minimize_scalar

from drake_aigto import Scenario, World
from drake_aigto.local import InteriorPoint, LocalStatus
from drake_aigto.planning import Arcs, PhaseMotion, PhaseProblem
from drake_aigto.simulation import Replay, replay_event_driven
from drake_aigto.transcription import Facing, Touch, joint_times

# What the local solver leaves in the rows, which are of the order of 1 m and 1 m/s.
MET = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Solved(PhaseMotion):
    """The local optimum of a multi-phase problem."""

    status: LocalStatus = LocalStatus.CONVERGED

    def replay(self) -> Replay:
        motion = self.trajectory
        return replay_event_driven(
            self.phases.world, self.phases.scenario, motion.times, motion.controls
        )


def solve(phases: PhaseProblem) -> Solved:
    """Solves at all knots, from where the planner starts: from wall to wall and on to the goal."""
    arcs = Arcs(phases, range(phases.num_steps))
    result = InteriorPoint().solve(arcs.nlp, arcs.vector(phases.guess()))
    return Solved(phases, arcs.trajectory(result.x), status=result.status)


def optimise(
    world: World, scenario: Scenario, *touches: Touch, facings: Sequence[Facing] | None = None
) -> Solved:
    solved = solve(PhaseProblem(world, scenario, touches, facings))
    assert solved.status is LocalStatus.CONVERGED
    assert max(solved.defects.values()) < MET
    check_clock(solved)
    return solved


def free_flight_cost(
    scenario: Scenario, mass: float = 1.0, weight: float = 0.0, acts: float = 0.5
) -> float:
    """Returns the least cost of a flight under held controls, by linear least squares.

    The weight pulls down [N]. A control moves the mass as a push at this part of its time step
    does: in the middle, or by explicit Euler at the end.
    """
    N, dt = scenario.num_steps, scenario.time_step
    T, w_u, w_f = scenario.duration, scenario.control_weight, scenario.goal_weight
    reach = (T - dt * (np.arange(N) + acts)) * dt / mass
    drift = scenario.initial_position + T * scenario.initial_velocity - weight / mass * T**2 / 2
    rows = np.vstack([math.sqrt(w_u * dt) * np.eye(N), math.sqrt(w_f) * reach])
    target = np.append(np.zeros(N), math.sqrt(w_f) * (scenario.goal_position - drift))
    best, *_ = np.linalg.lstsq(rows, target, rcond=None)
    return float(np.sum((rows @ best - target) ** 2))


def check_clock(solved: Solved) -> None:
    """Steps within a phase are equal, and take T together; what the wall does has its sign."""
    motion, touches, T = solved.trajectory, solved.sequence, solved.phases.scenario.duration
    turns = (facing.start for facing in solved.facings)
    joints = sorted({0.0, *joint_times(touches), *turns, T})
    knots = np.searchsorted(motion.times, np.array(joints) - 1e-12 * T)
    np.testing.assert_allclose(motion.times[knots], joints, atol=1e-12 * T)
    assert motion.times[0] == 0.0
    assert motion.times[-1] == T
    for first, last in pairwise(knots):
        steps = np.diff(motion.times[first : last + 1])
        assert np.all(steps > 0)
        np.testing.assert_allclose(steps, steps[0], atol=1e-9 * T)
    world = solved.phases.world
    assert np.all(motion.impulses >= -MET)
    assert np.all(motion.forces >= 0)
    J = world.calc_contact_jacobian(motion.positions[0])
    for touch in touches:
        k = int(np.argmin(np.abs(motion.times - touch.start)))
        assert J[touch.contact] @ motion.velocities[k] <= MET
        assert world.calc_signed_distance(motion.positions[k])[touch.contact] == pytest.approx(
            0, abs=MET
        )


def effort(distance: float, arrival: float, time: float) -> float:
    """Returns the least ∫ v̇² of a flight in so much time.

    Args:
        distance: to go beyond what the speed at the start takes it [m].
        arrival: the speed at the end beyond that at the start [m/s]; NaN: any.
        time: how long it takes [s].
    """
    any_arrival = 3 * distance**2 / time**3
    missed = 0.0 if math.isnan(arrival) else arrival - 1.5 * distance / time
    return any_arrival + 4 * missed**2 / time


def goal_cost(scenario: Scenario, miss: float, time: float) -> float:
    """Returns the least of effort and goal, if a ballistic path misses the goal by so much."""
    w_u, w_f = scenario.control_weight, scenario.goal_weight
    return 3 * w_u * w_f / (3 * w_u + w_f * time**3) * miss**2


@cache
def one_bounce(q: float, v: float, goal: float, e: float) -> tuple[float, float, float]:
    """Returns the least cost of a motion of 1 s that bounces once, when, and how fast it hits."""
    scenario = make_scenario(q, v)

    def cost(time: float, speed: float) -> float:
        before = effort(-q - v * time, -speed - v, time)
        miss = goal - e * speed * (1 - time)
        return scenario.control_weight * before + goal_cost(scenario, miss, 1 - time)

    def best_speed(time: float) -> float:
        low, middle, high = (cost(time, speed) for speed in (0.0, 1.0, 2.0))
        curvature = high - 2 * middle + low
        return max(0.0, 1.0 - (high - low) / 2 / curvature)  # The cost is a parabola in it.

    def least(time: float) -> float:
        return cost(time, best_speed(time))

    grid = np.concatenate([np.geomspace(1e-5, 0.1, 100), np.linspace(0.1, 0.999, 200)[1:]])
    k = int(np.clip(np.argmin([least(time) for time in grid]), 1, len(grid) - 2))
    time, value = find_least(least, grid[k - 1], grid[k + 1])
    return value, time, best_speed(time)


def find_least(cost: Callable[[float], float], low: float, high: float) -> tuple[float, float]:
    """Returns where the one minimum between two numbers is, and how low."""
    options = {"xatol": 1e-12 * high}
    found = minimize_scalar(cost, bounds=(low, high), method="bounded", options=options)
    return float(found.x), float(found.fun)


def bouncing(e: float, N: int, q: float = 1.0, v: float = -2.0, goal: float = 0.73) -> Scenario:
    scenario = make_scenario(q, v, time_step=1 / N, restitution=e)
    return dataclasses.replace(scenario, goal_position=goal)


def two_joints(e: float) -> Scenario:
    """Returns a task for the ball on a carriage of `make_diagram(num_joints=2)`."""
    return Scenario(
        initial_position=[0.0, 0.5],
        initial_velocity=[0.3, -0.5],
        goal_position=[0.4, 0.3],
        duration=2.0,
        time_step=0.05,
        goal_weight=100.0,
        restitution=e,
    )


def least_rest(
    height: float,
    duration: float,
    e: float,
    mass: float,
    gravity: float,
    control_weight: float = 1e-3,
    goal_weight: float = 1.0,
) -> tuple[float, float, float]:
    """Returns the least cost of a fall from rest to a floor and a jump back up to that height.

    There has to be time for the hops in between.

    Returns:
        The cost, when it lands, and when it jumps [s].
    """
    # The weight is as much control as it takes: ∫(v̇ + g)² = ∫v̇² + 2 g Δv + g² t, from rest to rest.
    heavy = Scenario(
        initial_position=height,
        initial_velocity=0.0,
        goal_position=height,
        duration=duration,
        time_step=duration,
        control_weight=mass**2 * control_weight,
        goal_weight=goal_weight,
    )

    def jump(time: float) -> float:
        return goal_cost(heavy, height + gravity * time**2 / 2, time)

    def land(time: float) -> float:
        return heavy.control_weight * (effort(-height, 0.0, time) + gravity**2 * time)

    jump_time, jump_cost = find_least(jump, 1e-3, 0.75 * duration)
    land_time, land_cost = math.sqrt(2 * height / gravity), 0.0
    if e == 1:  # It lands without speed; else it settles by hops that cost nothing.
        land_time, land_cost = find_least(land, 1e-3, 0.75 * duration)
    return land_cost + jump_cost, land_time, duration - jump_time
