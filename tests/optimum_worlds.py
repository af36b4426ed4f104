"""Motions between walls to hold against the exact optimum: by chance, and its own.

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
    legs = legs_of(line, bounces)
    path = np.concatenate([leg.path() for leg in legs])
    for wall in line.walls:
        if np.any(wall.side * (path - wall.place) < -1e-8):
            return math.inf
    effort = sum(leg.effort(line.gravity) for leg in legs)
    return effort + line.weight * (path[-1] - line.goal) ** 2


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
