"""Motions to hold against the exact optimum, by chance and by SNOPT, and its own.

All for a unit mass whose signed distance is its coordinate, and a duration of 1 s.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.solvers import MathematicalProgram, SnoptSolver, SolverOptions

from drake_aigto.study import RigidOptimum
from drake_aigto.world import Scenario

Array = npt.NDArray[np.float64]


@dataclass
class Motions:
    """Motions of one scenario, n of each, that go on phase by phase."""

    scenario: Scenario
    position: Array
    velocity: Array
    effort: Array
    is_admissible: npt.NDArray[np.bool_]

    @classmethod
    def begin(cls, scenario: Scenario, n: int) -> Motions:
        p, v = scenario.initial_position[0], scenario.initial_velocity[0]
        return cls(scenario, np.full(n, p), np.full(n, v), np.zeros(n), np.full(n, True))

    def move(self, position: Array, velocity: Array, time: Array) -> None:
        """Moves on by an acceleration a + b t."""
        h = time[:, None]
        t = h * np.linspace(0, 1, 101)
        gains = [np.hstack([h**2 / 2, h**3 / 6]), np.hstack([h, h**2 / 2])]
        drift = position - self.position - self.velocity * time, velocity - self.velocity
        solution = np.linalg.solve(np.stack(gains, axis=1), np.stack(drift, axis=-1)[..., None])
        a, b = solution[:, 0], solution[:, 1]
        path = self.position[:, None] + self.velocity[:, None] * t + a * t**2 / 2 + b * t**3 / 6
        self.is_admissible &= np.all(path >= -1e-12, axis=1)
        # Simpson's rule is exact for a square of what is linear.
        squares = a**2 + 4 * (a + b * h / 2) ** 2 + (a + b * h) ** 2
        self.effort += time / 6 * squares[:, 0]
        self.position, self.velocity = position, velocity

    def touch(self, speed: Array, time: Array) -> None:
        """Moves to the wall and bounces off it."""
        self.move(np.zeros_like(speed), -speed, time)
        self.velocity = self.scenario.restitution * speed

    def finish(self, position: Array, time: Array) -> Array:
        """Moves to the end with least effort; returns the costs, infinite if inadmissible."""
        average = (position - self.position) / time
        self.move(position, 1.5 * average - 0.5 * self.velocity, time)
        goal_errors = position - self.scenario.goal_position[0]
        costs = (
            self.scenario.control_weight * self.effort + self.scenario.goal_weight * goal_errors**2
        )
        return np.where(self.is_admissible, costs, np.inf)


def make_rivals(scenario: Scenario, touches: int, rng: np.random.Generator, n: int) -> Array:
    """Returns the costs of n motions by chance that touch so often, infinite where they fail."""
    p, v = scenario.initial_position[0], scenario.initial_velocity[0]
    rivals = Motions.begin(scenario, n)
    times = np.sort(rng.uniform(0.01, 0.99, (n, touches)), axis=1)
    # Half of the first touches are about when it would come by itself.
    times[::2, 0] = min(0.9, p / max(p, -v)) * np.exp(0.1 * rng.normal(size=len(times[::2])))
    spans = np.diff(times, axis=1, prepend=0.0, append=1.0)
    rivals.is_admissible &= np.all(spans > 1e-4, axis=1)
    spans = np.maximum(spans, 1e-4)
    for i in range(touches):
        # Some come gently: with two of them in a row, contact lasts.
        speed = rng.uniform(0, 1.5, n) * (rng.random(n) < 0.7) * max(abs(v), p)
        rivals.touch(speed, spans[:, i])
    return rivals.finish(scenario.goal_position[0] * np.exp(0.2 * rng.normal(size=n)), spans[:, -1])


def follow(scenario: Scenario, optimum: RigidOptimum) -> float:
    """Returns the cost of the motion that an optimum tells of, infinite if it is inadmissible."""
    motion, before = Motions.begin(scenario, 1), 0.0
    for time, velocity in zip(optimum.bounce_times, optimum.impact_velocities, strict=True):
        motion.touch(np.array([-velocity]), np.array([time - before]))
        before = time
    left = np.array([max(1.0 - before, 1e-6)])  # A touch may be the end.
    ballistic = motion.position + motion.velocity * left
    w = scenario.goal_weight / scenario.control_weight * left**3
    end = ballistic + w / (3 + w) * (scenario.goal_position - ballistic)
    return float(motion.finish(end, left)[0])


def transcribe(scenario: Scenario, guess: Sequence[tuple[float, float]], K: int = 40) -> float:
    """Returns the cost that SNOPT ends with, infinite if it does not meet the constraints.

    Forces are held over K intervals a phase, phases last as long as they like, and φ ≥ 0 at all
    knots. In phase time, from 0 to 1, positions are linear in accelerations and start velocity.

    Args:
        scenario: the problem.
        guess: (time, speed) of each touch.
        K: the number of intervals a phase.
    """
    prog = MathematicalProgram()
    phases = len(guess) + 1
    A = prog.NewContinuousVariables(phases, K, "a")
    V = prog.NewContinuousVariables(phases, "v")
    h = prog.NewContinuousVariables(phases, "h")
    prog.AddBoundingBoxConstraint(1e-3, 1.0, h)
    prog.AddLinearEqualityConstraint(np.ones((1, phases)), [1.0], h)
    v0 = scenario.initial_velocity[0]
    prog.AddLinearEqualityConstraint(np.array([[1.0, -v0]]), [0.0], [V[0], h[0]])
    with np.errstate(invalid="ignore"):  # NumPy takes Drake's boxed constants for that.
        cost = add_phases(prog, scenario, (A, V, h))
    prog.AddCost(cost)
    set_guess(prog, scenario, guess, (A, V, h))
    return scenario.control_weight * run_snopt(prog)


def add_phases(
    prog: MathematicalProgram, scenario: Scenario, variables: tuple[Any, Any, Any]
) -> Any:
    """Adds the rows of each phase and of the touches between them; returns the cost / w_u."""
    A, V, h = variables
    phases, K = A.shape
    k, j = np.arange(1, K + 1)[:, None], np.arange(K)[None, :]
    displacement = np.hstack([np.where(j < k, k - j - 0.5, 0.0) / K**2, k / K])
    end_velocity = np.append(np.full(K, 1 / K), 1.0)
    cost, start = 0.0, scenario.initial_position[0]
    for i in range(phases):
        x = np.append(A[i], V[i])
        prog.AddLinearConstraint(displacement, np.full(K, -start), np.full(K, np.inf), x)
        cost += A[i] @ A[i] / K / h[i] ** 3
        if i < phases - 1:
            prog.AddLinearEqualityConstraint(displacement[-1:], [-start], x)
            prog.AddLinearConstraint(end_velocity[None], [-np.inf], [0.0], x)
            bounce = V[i + 1] * h[i] + scenario.restitution * (end_velocity @ x) * h[i + 1]
            prog.AddConstraint(bounce == 0)
            start = 0.0
    miss = start + displacement[-1] @ x - scenario.goal_position[0]
    return cost + scenario.goal_weight / scenario.control_weight * miss**2


def set_guess(
    prog: MathematicalProgram,
    scenario: Scenario,
    guess: Sequence[tuple[float, float]],
    variables: tuple[Any, Any, Any],
) -> None:
    """Guesses held forces that lead from each touch to the next, but for their restitution."""
    stops = [*((time, 0.0, -speed) for time, speed in guess), (1.0, scenario.goal_position[0], 0.0)]
    time, x, v = 0.0, scenario.initial_position[0], scenario.initial_velocity[0]
    for a_i, v_i, h_i, (end, x_end, v_end) in zip(*variables, stops, strict=True):
        h = end - time
        prog.SetInitialGuess(h_i, h)
        prog.SetInitialGuess(v_i, v * h)
        prog.SetInitialGuess(a_i, np.full(len(a_i), 2 * (x_end - x - v * h)))
        time, x, v = end, x_end, -scenario.restitution * v_end


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


def optimal_control(scenario: Scenario, optimum: RigidOptimum, K: int = 100) -> tuple[Array, Array]:
    """Returns knots and held forces: means of the optimal control, which is linear in each phase.

    Args:
        scenario: the problem.
        optimum: its optimum.
        K: the number of intervals a phase.
    """
    time, x, v = 0.0, scenario.initial_position[0], scenario.initial_velocity[0]
    goal = scenario.goal_position[0]
    knots, controls = [np.zeros(1)], []
    touches = zip(optimum.bounce_times, optimum.impact_velocities, strict=True)
    for end, impact in [*touches, (1.0, None)]:
        h = end - time
        offset = -x - v * h
        if impact is None:
            w = scenario.goal_weight / scenario.control_weight
            force = 3 * w / (3 + w * h**3) * (goal + offset)
            first, last = force * h, 0.0
        else:
            first = 6 * offset / h**2 - 2 * (impact - v) / h
            last = 4 * (impact - v) / h - 6 * offset / h**2
            x, v = 0.0, -scenario.restitution * impact
        middles = (np.arange(K) + 0.5) / K
        controls.append(first + (last - first) * middles)
        knots.append(time + h * np.arange(1, K + 1) / K)
        time = end
    return np.concatenate(knots), np.concatenate(controls)[:, None]
