"""Tasks by chance for mechanisms, and the boxes of their motions."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from mechanisms import build, build_world, joint, link, plane, sphere, wall

from drake_aigto.contact import CompliantLaw
from drake_aigto.planning import MechanismBoxes
from drake_aigto.transcription import Ends, MechanismProgram
from drake_aigto.world import TaskCost, World

N, DURATION = 6, 1.2

read = cache(build)


def make_cost(world: World, goal: Any, **changes: Any) -> TaskCost:
    """Returns weights by chance, with chords for angles."""
    n, rng = world.num_positions, np.random.default_rng(3)
    final = rng.uniform(0, 1, (n, n)) * (~world.is_hinge & ~world.is_hinge[:, np.newaxis])
    fields = {
        "R": rng.uniform(0.1, 1, world.num_actuators),
        "Q": rng.uniform(0, 1, n),
        "Qv": rng.uniform(0, 1, n),
        "QT": final @ final.T + np.diag(rng.uniform(0, 1, n)),
        "QTv": np.eye(n) + 0.1,
        "goal": goal,
        "goal_velocity": np.full(n, 0.3),
        "is_modulo": np.zeros(n, dtype=bool),
        "is_chordal": world.is_hinge,
        "times": np.zeros(1),
        "positions": np.array([goal]),
        "velocities": np.full((1, n), 0.3),
    }
    return TaskCost(**{**fields, **changes})


def make_law(world: World, dissipation: float = 0.0) -> CompliantLaw:
    ones = np.ones(world.num_contacts)
    return CompliantLaw(50.0 * ones, dissipation * ones)


def make_ends(world: World, rng: np.random.Generator, **changes: Any) -> Ends:
    q, v, goal = rng.normal(size=(3, world.num_positions))
    return Ends(q, v, make_cost(world, goal, **changes))


def make_boxes(
    world: World, ends: Ends, law: CompliantLaw, num_steps: int = N, most: float = 3.0
) -> MechanismBoxes:
    bounds = np.array([np.full(world.num_actuators, side) for side in (-most, most)])
    program = MechanismProgram(world, ends.cost, law, DURATION, num_steps)
    return MechanismBoxes(program, bounds, ends)


def drop_ball() -> World:
    return build_world(
        link("ball", 2.0, ">0 0 0.5 0 0 0", shape=sphere("ball", "0 0 0"))
        + joint("prismatic", "world", "ball", "0 0 1")
        + wall(plane("floor", "0 0 0 0 0 0"))
    )
