"""Elastic walls unfolded: least-cost motions between them, in closed form and continuous time.

Between walls at 0 and 1 a motion that bounces with e = 1 is, unfolded, one flight to an image of
the goal. Its best control falls linearly to 0, and costs D² w_f e₁/(e₁ + w_f), e₁ = 3 w_u m²/T³, if
the ballistic motion misses the image by D.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from rigid_worlds import Array

from drake_aigto import Scenario
from drake_aigto.transcription import Touch, TouchSequence

MODELS = "package://drake_aigto_models/{}.sdf"


@dataclass(frozen=True)
class Flight:
    """The best flight of 1 kg to an image of the goal: q = q_0 + v_0 t + a (t²/2 − t³/(6 T))."""

    start: float
    speed: float
    image: float
    duration: float
    control_weight: float = 1e-3
    goal_weight: float = 1.0

    @property
    def miss(self) -> float:
        return self.image - self.start - self.speed * self.duration

    @property
    def cost(self) -> float:
        effort = 3 * self.control_weight / self.duration**3
        return self.miss**2 * self.goal_weight * effort / (effort + self.goal_weight)

    @property
    def push(self) -> float:
        """The control at the start [m/s²]."""
        effort = 3 * self.control_weight / self.duration**3
        return 3 * self.miss * self.goal_weight / (effort + self.goal_weight) / self.duration**2

    def position(self, t: Array) -> Array:
        return self.start + self.speed * t + self.push * (t**2 / 2 - t**3 / (6 * self.duration))

    def bounces(self) -> list[tuple[float, int]]:
        """Returns when it meets which wall: 0 at even numbers, 1 at odd ones."""
        found = []
        moves = np.array([-self.push / (6 * self.duration), self.push / 2, self.speed])
        moves[np.abs(moves) < 1e-200] = 0.0  # What would overflow where it divides.
        for wall in range(-12, 13):
            for root in np.roots(np.append(np.trim_zeros(moves, "f"), self.start - wall)):
                if abs(root.imag) < 1e-12 and 0 < root.real < self.duration:
                    found.append((float(root.real), wall % 2))
        return sorted(found)


def image_of(goal: float, bounces: int) -> float:
    """Returns where the goal is, unfolded over so many bounces; negative: to the left first."""
    # Over |n| walls to the right it is in (n, n + 1), over walls to the left in (−n, −n + 1).
    return bounces + (goal if bounces % 2 == 0 else 1 - goal)


def fold(positions: Array) -> Array:
    """Returns where between 0 and 1 an unfolded motion is."""
    return 1 - np.abs(1 - np.mod(positions, 2))


def touches_of(*flights: Flight) -> TouchSequence:
    """Returns what flights along x, y, … touch: contact 2 i at 0, 2 i + 1 at 1."""
    met = [
        (time, 2 * axis + wall)
        for axis, flight in enumerate(flights)
        for time, wall in flight.bounces()
    ]
    return tuple(Touch.bounce(time, contact) for time, contact in sorted(met))


def are_apart(sequence: TouchSequence, duration: float, least: float = 0.05) -> bool:
    """Returns whether all is at least a part of the duration apart, ends included."""
    times = [0.0, *(touch.start for touch in sequence), duration]
    return all(later - earlier >= least * duration for earlier, later in pairwise(times))


def scenario_of(model: str, *flights: Flight, steps: int = 50, e: float = 1.0) -> Scenario:
    """Returns the scenario of flights along x, y, …: the goal is what the images fold to."""
    (duration,) = {flight.duration for flight in flights}
    return Scenario(
        model=MODELS.format(model),
        initial_position=[flight.start for flight in flights],
        initial_velocity=[flight.speed for flight in flights],
        goal_position=[float(fold(np.array(flight.image))) for flight in flights],
        duration=duration,
        time_step=duration / steps,
        control_weight=flights[0].control_weight,
        goal_weight=flights[0].goal_weight,
        restitution=e,
    )
