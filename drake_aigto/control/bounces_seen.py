"""What bounces tell of walls, as they are seen from one sample of a state to the next."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.world import World

# A ball that is deeper in a wall than this part of how far off walls may be shows that it stands
# elsewhere; then it is thought of as farther away in steps of that part.
_DEEP, _STEP = 0.025, 0.1
# No wall returns more than it is hit with, but for noise; a kick may.
_MOST_RETURNED = 1.2


class _Bounce(NamedTuple):
    """A bounce between two samples."""

    contact: int
    place: float  # φ there [m]
    comes: float  # φ̇⁻ [m/s]
    leaves: float  # φ̇⁺ [m/s]


@dataclass(frozen=True)
class SeenBounces:
    """What was seen of walls: how much they return, and where they stand.

    Attributes:
        squares: Σ (φ̇⁻)² of bounces off walls that return what the scenario says [m²/s²].
        products: −Σ φ̇⁻ φ̇⁺ of the same [m²/s²].
        nearer: by how much nearer the wall of each contact stands than the model has it, shape (m,)
            [m]; empty: nothing was seen.
        latest: the contact that bounced between the last two samples; None: none did.
    """

    squares: float = 0.0
    products: float = 0.0
    nearer: tuple[float, ...] = ()
    latest: int | None = None

    def find_restitution(self, expected: float, weight: float) -> float:
        """Returns the e in [0, 1] with the least w (e − e₀)² + Σ (φ̇⁺ + e φ̇⁻)².

        Args:
            expected: e₀, before any bounce.
            weight: w [m²/s²].
        """
        if not self.squares:
            return expected
        e = (weight * expected + self.products) / (weight + self.squares)
        return float(np.clip(e, 0.0, 1.0))

    def watch(
        self,
        world: World,
        samples: tuple[Floats, Floats],
        elapsed: float,
        control: Floats,
        off: float,
    ) -> SeenBounces:
        """Returns the same, with the bounce between two samples of a state, if there is one.

        Where a wall is, is not asked for: contact i bounces if φ̇_i changes its sign, when and where
        both flights meet, at

            t = (φ⁺ − φ⁻ − φ̇⁺ h) / (φ̇⁻ − φ̇⁺)

        after the first of two samples that are h apart. That is no kick in mid-air if φ_i is near 0
        there, and no more is returned than came. Of several at once nothing is told.

        Args:
            world: balls, whose J does not change, as the model has it.
            samples: (q, v) before and after, shape (2n,) each.
            elapsed: h [s].
            control: u between them, shape (nu,).
            off: how far from where it is thought to be a wall may stand [m].
        """
        bounce = _find_bounce(world, samples, elapsed, control, off)
        if bounce is None:
            return dataclasses.replace(self, latest=None)
        nearer = self._read(world)
        nearer[bounce.contact] = bounce.place
        seen = SeenBounces(self.squares, self.products, tuple(nearer.tolist()), bounce.contact)
        if world.contacts[bounce.contact].restitution is not None:
            return seen
        return dataclasses.replace(
            seen,
            squares=self.squares + bounce.comes**2,
            products=self.products - bounce.comes * bounce.leaves,
        )

    def pass_walls(self, world: World, q: Floats, off: float) -> SeenBounces:
        """Returns the same, with walls that the balls are inside of farther away.

        Nothing is deep inside of a rigid wall: it stands behind what seems to be.

        Args:
            world: see `watch`, as for off.
            q: where the balls are, shape (n,) [m].
            off: see `watch`.
        """
        nearer, step = self._read(world), _STEP * off
        distances = world.calc_signed_distance(q)
        for faces in map(list, world.solids):
            contact = faces[int(np.argmax((distances - nearer)[faces]))]
            depth = nearer[contact] - distances[contact]
            if depth > _DEEP * off and distances[contact] > -off:
                nearer[contact] -= step * (1 + depth // step)
        if np.array_equal(nearer, self._read(world)):
            return self
        return dataclasses.replace(self, nearer=tuple(nearer.tolist()))

    def _read(self, world: World) -> Floats:
        return np.array(self.nearer) if self.nearer else np.zeros(world.num_contacts)


def _find_bounce(
    world: World, samples: tuple[Floats, Floats], elapsed: float, control: Floats, off: float
) -> _Bounce | None:
    """Returns the only bounce between two samples; None if there is none, or several."""
    (q, v), (later, after) = (np.split(x, 2) for x in samples)
    phi, rate = world.calc_signed_distance(q), world.calc_contact_rate(q, v)
    phi_later, rate_later = (
        world.calc_signed_distance(later),
        world.calc_contact_rate(later, after),
    )
    turns = (rate < 0) & (rate_later > 0)
    if not turns.any():
        return None
    push = world.calc_contact_rate(q, world.calc_acceleration(q, v, control))
    span = np.where(turns, rate - rate_later, 1.0)
    time = np.clip((phi_later - phi - rate_later * elapsed) / span, 0.0, elapsed)
    comes, leaves = rate + time * push, rate_later - (elapsed - time) * push
    place = phi + time * (rate + comes) / 2
    turns &= (np.abs(place) <= off) & (comes < 0)
    turns &= (leaves > 0) & (leaves <= -_MOST_RETURNED * comes)
    if np.count_nonzero(turns) != 1:
        return None
    (i,) = np.flatnonzero(turns).tolist()
    return _Bounce(i, float(place[i]), float(comes[i]), float(leaves[i]))
