"""Random scenarios of the shipped worlds, each with the best that is known of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.optima import ContactOptimum, block_optimum, masses_optimum, walls_optimum
from drake_aigto.arrays import Floats
from drake_aigto.world import Scenario, World

Interval = tuple[float, float]

# Two masses start, and end, this far apart at least [m].
_APART = 0.1
# Half the width of the block in the middle of its room, and some space around it [m].
_HALF_BLOCK = 0.15


@dataclass(frozen=True)
class WorldStudy:
    """A shipped world, and from where random scenarios of it are drawn, evenly.

    Attributes:
        model: the name of its SDF file.
        size: the number of coordinates.
        positions: of every coordinate at the start [m].
        goals: likewise [m].
        velocities: likewise [m/s].
        restitutions: in turn.
        optimum: of a scenario.
        accepts: whether a position is one for a start or goal.
        duration: T [s].
    """

    model: str
    size: int
    positions: Interval
    goals: Interval
    velocities: Interval
    restitutions: tuple[float, ...]
    optimum: Callable[[World, Scenario], ContactOptimum]
    accepts: Callable[[Floats], bool] = lambda q: True
    duration: float = 1.5

    def draw(self, count: int, seed: int) -> Iterator[Scenario]:
        """Yields random scenarios; the first ones do not depend on the count."""
        generator = np.random.default_rng(seed)
        for number in range(count):
            start = self._draw_place(generator, self.positions)
            goal = self._draw_place(generator, self.goals)
            yield Scenario(
                model=f"package://drake_aigto_models/{self.model}.sdf",
                initial_position=start,
                initial_velocity=generator.uniform(*self.velocities, self.size),
                goal_position=goal,
                duration=self.duration,
                restitution=self.restitutions[number % len(self.restitutions)],
            )

    def _draw_place(self, generator: np.random.Generator, interval: Interval) -> Floats:
        while True:
            q = generator.uniform(*interval, self.size)
            if self.accepts(q):
                return q


def _is_in_order(q: Floats) -> bool:
    return bool(np.all(np.diff(q) >= _APART))


def _is_off_block(q: Floats) -> bool:
    return bool(np.max(np.abs(q - 0.5)) >= _HALF_BLOCK)


# The optimum is exact but for the room with a block, where it is the best known. Under gravity it
# is exact up to a number of touches, and of two masses for the restitution that is drawn here.
WORLDS = {
    study.model: study
    for study in (
        WorldStudy("corridor", 1, (0.1, 0.9), (0.1, 0.9), (-4.0, 4.0), (1.0, 0.8), walls_optimum),
        WorldStudy("floor", 1, (0.3, 1.0), (0.1, 1.0), (-2.0, 2.0), (1.0, 0.8), walls_optimum),
        WorldStudy("room", 2, (0.1, 0.9), (0.1, 0.9), (-3.0, 3.0), (1.0, 0.8), walls_optimum),
        WorldStudy(
            model="room_with_block",
            size=2,
            positions=(0.1, 0.9),
            goals=(0.1, 0.9),
            velocities=(-2.0, 2.0),
            restitutions=(1.0, 0.8),
            optimum=block_optimum,
            accepts=_is_off_block,
        ),
        WorldStudy(
            model="two_masses",
            size=2,
            positions=(0.1, 0.9),
            goals=(0.1, 0.9),
            velocities=(-1.0, 1.0),
            restitutions=(1.0,),
            optimum=masses_optimum,
            accepts=_is_in_order,
        ),
    )
}
