"""Random scenarios of the shipped worlds, and their optima."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

from hypothesis import strategies as st

from benchmarks.optima import ContactOptimum
from benchmarks.worlds import WORLDS
from drake_aigto.world import Scenario, World


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
