"""Motions between walls to hold against the exact optimum: by chance, by SNOPT, and its own.

They share no formula with it: forces are lines, or held, and what they do is integrated here.
Random scenarios of the shipped worlds, and their optima.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from hypothesis import strategies as st
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from benchmarks.optima import ContactOptimum
from benchmarks.optima.line_optimum import Line, LineBounce
from benchmarks.worlds import WORLDS
from drake_aigto.world import Scenario, World

Array = npt.NDArray[np.float64]

SAMPLES = np.linspace(0.0, 1.0, 101)


class Leg:
    """A flight from (x, v) to (x_end, v_end) by an acceleration a + b t."""

    def __init__(self, x: float, v: float, x_end: float, v_end: float, time: float) -> None:
        gains = [[time**2 / 2, time**3 / 6], [time, time**2 / 2]]
        self.start, self.speed, self.time = x, v, time
        self.a, self.b = np.linalg.solve(gains, [x_end - x - v * time, v_end - v])

    def effort(self, gravity: float) -> float:
        """Returns ∫ (ẍ + g)² dt, by Simpson's rule, which is exact here."""
        u = self.a + self.b * self.time * np.array([0.0, 0.5, 1.0]) + gravity
        return float(self.time / 6 * (u**2 @ [1.0, 4.0, 1.0]))

    def path(self) -> Array:
        """Returns positions at 101 times."""
        t = self.time * SAMPLES
        return self.start + self.speed * t + self.a * t**2 / 2 + self.b * t**3 / 6

    def end_controls(self, gravity: float) -> tuple[float, float]:
        """Returns ẍ + g at both ends."""
        return self.a + gravity, self.a + self.b * self.time + gravity


def legs_of(line: Line, bounces: Sequence[LineBounce]) -> list[Leg]:
    """Returns the flights between these bounces, and the cheapest one to the end."""
    time, x, v = 0.0, line.position, line.velocity
    legs = []
    for bounce in bounces:
        wall = line.walls[bounce.wall]
        legs.append(Leg(x, v, wall.place, -wall.side * bounce.speed, bounce.time - time))
        time, x, v = bounce.time, wall.place, wall.side * wall.restitution * bounce.speed
    left = max(1.0 - time, 1e-6)  # A bounce may be the end.
    coast = x + v * left - line.gravity * left**2 / 2
    # A force c (1 − t) moves the end by c left³/3, at an effort of c² left³/3.
    c = 3 * line.weight * (line.goal - coast) / (3 + line.weight * left**3)
    end = coast + c * left**3 / 3
    legs.append(Leg(x, v, end, v - line.gravity * left + c * left**2 / 2, left))
    return legs


def cost_of(line: Line, bounces: Sequence[LineBounce]) -> float:
    """Returns the cost of a motion with these bounces, infinite if it leaves the line."""
    legs = legs_of(line, bounces)
    path = np.concatenate([leg.path() for leg in legs])
    for wall in line.walls:
        if np.any(wall.side * (path - wall.place) < -1e-8):
            return math.inf
    effort = sum(leg.effort(line.gravity) for leg in legs)
    return effort + line.weight * (path[-1] - line.goal) ** 2


def bounces_by_chance(line: Line, count: int, rng: np.random.Generator) -> list[LineBounce]:
    """Returns some bounces."""
    times = np.sort(rng.uniform(0.02, 0.98, count))
    speeds = rng.uniform(0.0, 1.5, count) * max(abs(line.velocity), 1.0, abs(line.gravity) / 4)
    walls = rng.integers(0, len(line.walls), count)
    return [LineBounce(*bounce) for bounce in zip(times, walls.tolist(), speeds, strict=True)]


def transcribe(line: Line, guess: Sequence[LineBounce], K: int = 20) -> float:
    """Returns the cost that SNOPT ends with, infinite if it does not meet the constraints.

    Forces are held over K intervals a phase, phases last as long as they like, and walls count at
    all knots. In phase time, from 0 to 1, positions are linear in accelerations and start velocity.

    Args:
        line: the problem.
        guess: the bounces.
        K: the number of intervals a phase.
    """
    prog = MathematicalProgram()
    phases = len(guess) + 1
    A = prog.NewContinuousVariables(phases, K, "a")
    V = prog.NewContinuousVariables(phases, "v")
    h = prog.NewContinuousVariables(phases, "h")
    prog.AddBoundingBoxConstraint(1e-3, 1.0, h)
    prog.AddLinearEqualityConstraint(np.ones((1, phases)), [1.0], h)
    prog.AddLinearEqualityConstraint(np.array([[1.0, -line.velocity]]), [0.0], [V[0], h[0]])
    with np.errstate(invalid="ignore"):  # NumPy takes Drake's boxed constants for that.
        prog.AddCost(add_phases(prog, line, guess, (A, V, h)))
    set_guess(prog, line, guess, (A, V, h))
    return run_snopt(prog)


def add_phases(
    prog: MathematicalProgram,
    line: Line,
    guess: Sequence[LineBounce],
    variables: tuple[Any, Any, Any],
) -> Any:
    """Adds the rows of each phase and of the touches between them; returns the cost."""
    A, V, h = variables
    phases, K = A.shape
    k, j = np.arange(1, K + 1)[:, None], np.arange(K)[None, :]
    displacement = np.hstack([np.where(j < k, k - j - 0.5, 0.0) / K**2, k / K])
    end_velocity = np.append(np.full(K, 1 / K), 1.0)
    g, cost, start = line.gravity, 0.0, line.position
    lower = max((wall.place for wall in line.walls if wall.side > 0), default=-math.inf)
    upper = min((wall.place for wall in line.walls if wall.side < 0), default=math.inf)
    for i in range(phases):
        x = np.append(A[i], V[i])
        bounds = np.full(K, lower - start), np.full(K, upper - start)
        prog.AddLinearConstraint(displacement, *bounds, x)
        cost += A[i] @ A[i] / K / h[i] ** 3 + 2 * g * sum(A[i]) / K / h[i] + g**2 * h[i]
        if i < phases - 1:
            wall = line.walls[guess[i].wall]
            prog.AddLinearEqualityConstraint(displacement[-1:], [wall.place - start], x)
            sides = (-np.inf, 0.0) if wall.side > 0 else (0.0, np.inf)
            prog.AddLinearConstraint(end_velocity[None], [sides[0]], [sides[1]], x)
            prog.AddConstraint(
                V[i + 1] * h[i] + wall.restitution * (end_velocity @ x) * h[i + 1] == 0
            )
            start = wall.place
    miss = start + displacement[-1] @ x - line.goal
    return cost + line.weight * miss**2


def set_guess(
    prog: MathematicalProgram,
    line: Line,
    guess: Sequence[LineBounce],
    variables: tuple[Any, Any, Any],
) -> None:
    """Guesses held forces that lead from each touch to the next, but for their restitution."""
    A, V, h = variables
    time, x, v = 0.0, line.position, line.velocity
    stops = [(b.time, line.walls[b.wall].place, line.walls[b.wall], b.speed) for b in guess]
    for i, (end, place, wall, speed) in enumerate([*stops, (1.0, line.goal, None, 0.0)]):
        duration = end - time
        prog.SetInitialGuess(h[i], duration)
        prog.SetInitialGuess(V[i], v * duration)
        prog.SetInitialGuess(A[i], np.full(A.shape[1], 2 * (place - x - v * duration)))
        time, x = end, place
        v = 0.0 if wall is None else wall.side * wall.restitution * speed


def run_snopt(prog: MathematicalProgram) -> float:
    """Returns the cost at the end, infinite if a constraint is not met."""
    options = SolverOptions()
    for name, value in (
        ("Major feasibility tolerance", 1e-9),
        ("Major optimality tolerance", 1e-7),
        ("Major iterations limit", 150),
    ):
        options.SetOption(SnoptSolver.id(), name, value)
    result = SnoptSolver().Solve(prog, None, options)
    x = result.get_x_val()
    feasible = prog.CheckSatisfied(prog.GetAllConstraints(), x, 1e-8)
    return float(result.get_optimal_cost()) if feasible else math.inf


@cache
def world_of(name: str) -> World:
    (scenario,) = WORLDS[name].draw(1, seed=0)
    return World.from_scenario(scenario)


def draw(name: str, seed: int, **changes: Any) -> Scenario:
    (scenario,) = WORLDS[name].draw(1, seed)
    return dataclasses.replace(scenario, **changes)


def solve(name: str, scenario: Scenario) -> ContactOptimum:
    return WORLDS[name].optimum(world_of(name), scenario)


def ends(scenario: Scenario, axis: int) -> dict[str, float]:
    names = ("initial_position", "initial_velocity", "goal_position")
    return {name: float(getattr(scenario, name)[axis]) for name in names}


seeds = st.integers(0, 2**32 - 1)
restitutions = st.sampled_from([0.0, 0.5, 0.8, 1.0])
