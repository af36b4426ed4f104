"""Motions to hold against the exact optimum, by chance and by SNOPT, and its own.

All for a unit mass whose signed distance is its coordinate, and a duration of 1 s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import line_rivals
import numpy as np
import numpy.typing as npt
from line_rivals import legs_of

from benchmarks.optima.line_optimum import Line, LineBounce, Wall
from drake_aigto.paper import RigidOptimum
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


def line_of(scenario: Scenario) -> Line:
    """Returns the same problem on a line with one wall, at a cost of 1 / w_u."""
    return Line(
        position=scenario.initial_position[0],
        velocity=scenario.initial_velocity[0],
        goal=scenario.goal_position[0],
        weight=scenario.goal_weight / scenario.control_weight,
        gravity=0.0,
        walls=(Wall(0.0, 1, scenario.restitution),),
    )


def transcribe(scenario: Scenario, guess: Sequence[tuple[float, float]], K: int = 40) -> float:
    """Returns the cost that SNOPT ends with, infinite if it does not meet the constraints.

    Args:
        scenario: the problem.
        guess: (time, speed) of each touch.
        K: the number of intervals a phase.
    """
    bounces = [LineBounce(time, 0, speed) for time, speed in guess]
    return scenario.control_weight * line_rivals.transcribe(line_of(scenario), bounces, K)


def optimal_control(scenario: Scenario, optimum: RigidOptimum, K: int = 100) -> tuple[Array, Array]:
    """Returns knots and held forces: means of the optimal control, which is linear in each phase.

    Args:
        scenario: the problem.
        optimum: its optimum.
        K: the number of intervals a phase.
    """
    touches = zip(optimum.bounce_times, optimum.impact_velocities, strict=True)
    bounces = [LineBounce(time, 0, -velocity) for time, velocity in touches]
    time, parts = 0.0, (np.arange(K) + 0.5) / K
    knots, controls = [np.zeros(1)], []
    for leg in legs_of(line_of(scenario), bounces):
        controls.append(leg.a + leg.b * leg.time * parts)
        knots.append(time + leg.time * np.arange(1, K + 1) / K)
        time += leg.time
    return np.concatenate(knots), np.concatenate(controls)[:, None]
