"""Where boxes begin: a start inside of a wall that yields is left to its throw at first."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact import CompliantLaw, calc_pushes
from drake_aigto.shooting import ShootingResult
from drake_aigto.world import World

# A throw takes this part of the duration at most: in more, control has a say in where it leads.
_SOON = 0.1
# By how much a hinge that was thrown turns in a time step of drawn boxes, at most [rad].
_TURN = 1.0


class Launch(NamedTuple):
    """From where on boxes have a say.

    A wall that throws a start off does so within one time step of boxes, in which they take its
    first push for one that lasts, so that all that follows is wrong. Of 20 starts deep in the walls
    of `cart_pole/soft_06`, drawn for this, plans are within 1 % of the best known of 13 with boxes
    from where these leave the walls on, in time steps that resolve how fast they turn and with more
    patience; of 9 with boxes from the start on, a mean of three seeds (2.9 and 2.2 CPU seconds).

    Attributes:
        knot: of motions as they are searched for; 0: the start.
        time: of it [s].
        position: q there, shape (n,).
        velocity: v there, shape (n,).
    """

    knot: int
    time: float
    position: Floats
    velocity: Floats

    def find_haste(self, time_step: float, is_hinge: Bools) -> int:
        """Returns into how many parts time steps of boxes are divided to resolve what turns.

        Args:
            time_step: what they are elsewhere [s].
            is_hinge: which coordinates turn, shape (n,).
        """
        fastest = np.max(np.abs(self.velocity[is_hinge]), initial=0.0)
        return max(1, int(np.ceil(time_step * fastest / _TURN)))


def find_launch(world: World, law: CompliantLaw, coast: ShootingResult) -> Launch:
    """Returns where the motion without control first touches nothing, if that is soon.

    Args:
        world: the mechanism.
        law: what its contacts push with.
        coast: the motion without control.
    """
    q, v = np.split(coast.states, 2, axis=1)
    is_finite = np.isfinite(coast.states).all(axis=1)
    is_soon = is_finite & (coast.times <= _SOON * coast.times[-1])
    pushes = calc_pushes(world, law, q[is_soon], v[is_soon])
    knot = int(np.argmin(np.any(pushes > 0, axis=1)))
    return Launch(knot, float(coast.times[knot]), q[knot], v[knot])
