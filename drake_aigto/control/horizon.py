"""A task, asked again from where things are: what a controller that plans again goes through."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.control.bounces_seen import SeenBounces
from drake_aigto.control.motion import Motion
from drake_aigto.trajectory import Trajectory
from drake_aigto.world import Scenario, World

# A step of which less than this part is left is over.
OVER = 1e-3


class Horizon(ABC):
    """A task, as it is asked again from where things are.

    Attributes:
        world: where the task is.
        scenario: the task; its start does not count.
        is_receding: whether the horizon always lasts as long as the scenario, or ends with it.
    """

    def __init__(self, world: World, scenario: Scenario, is_receding: bool, num_steps: int) -> None:
        """Takes the task, and how many steps its motions have."""
        self.world, self.scenario, self.is_receding = world, scenario, is_receding
        self._num_steps, self._step = num_steps, scenario.duration / num_steps

    def end(self, now: float) -> float:
        """Returns when a horizon ends that begins now [s]."""
        return now + self.scenario.duration if self.is_receding else self.scenario.duration

    def is_over(self, now: float) -> bool:
        """Returns whether hardly anything is left of a horizon that begins now [s]."""
        return self.end(now) - now <= OVER * self._step

    def rest(self, now: float, x: Floats) -> Motion:
        """Returns no control, as far as bounds allow, where nothing better is known."""
        times = np.linspace(now, max(self.end(now), now + self._step), self._num_steps + 1)
        q, v = (np.tile(part, (len(times), 1)) for part in np.split(x, 2))
        none = np.zeros((self._num_steps, self.world.num_actuators))
        m = self.world.num_contacts
        return Motion(
            trajectory=Trajectory(
                times=times,
                positions=q,
                velocities=v,
                controls=np.clip(none, *self.world.bounds(self.scenario).control),
                impulses=np.zeros((len(times), m)),
                forces=np.zeros((self._num_steps, m)),
            ),
            cost=np.inf,
            touches=(),
        )

    @property
    def restitution(self) -> float | None:
        """What walls are planned to return; None where that is no number."""
        return None

    def watch(
        self, seen: SeenBounces, samples: tuple[Floats, Floats], elapsed: float, control: Floats
    ) -> SeenBounces:
        """Returns what is seen of bounces by now; the arguments are those of `SeenBounces`."""
        return seen

    def knowing(self, seen: SeenBounces) -> Horizon:
        """Returns the same task between walls that return what was seen."""
        return self

    @abstractmethod
    def is_inside(self, x: Floats) -> bool:
        """Returns whether a state is inside of a wall that nothing can be planned from."""

    @abstractmethod
    def advance(self, motion: Motion, now: float, x: Floats) -> Motion | None:
        """Returns the best motion near what is left of another one; None if there is none."""

    @abstractmethod
    def search(self, now: float, x: Floats) -> Motion | None:
        """Returns the best motion that the planner finds; None if it finds none.

        It takes what the planner's options allow: counts, not seconds.
        """

    @property
    @abstractmethod
    def cost_scale(self) -> float:
        """What the task costs where all is off by its scale."""
