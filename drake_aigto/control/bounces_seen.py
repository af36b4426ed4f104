"""What bounces tell of restitution, as they are seen from one sample of a state to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.world import World


@dataclass(frozen=True)
class SeenBounces:
    """Speeds of bounces off walls that return what the scenario says, as sums over all of them.

    Attributes:
        squares: Σ (φ̇⁻)² [m²/s²].
        products: −Σ φ̇⁻ φ̇⁺ [m²/s²].
    """

    squares: float = 0.0
    products: float = 0.0

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
        there. Of several at once nothing is told.

        Args:
            world: balls, whose J does not change.
            samples: (q, v) before and after, shape (2n,) each.
            elapsed: h [s].
            control: u between them, shape (nu,).
            off: how far from where it is thought to be a wall may stand [m].
        """
        (q, v), (later, after) = (np.split(x, 2) for x in samples)
        phi, rate = world.calc_signed_distance(q), world.calc_contact_rate(q, v)
        phi_later, rate_later = (
            world.calc_signed_distance(later),
            world.calc_contact_rate(later, after),
        )
        push = world.calc_contact_rate(q, world.calc_acceleration(q, v, control))
        turns = (rate < 0) & (rate_later > 0)
        turns &= np.array([contact.restitution is None for contact in world.contacts], dtype=bool)
        if not turns.any():
            return self
        span = np.where(turns, rate - rate_later, 1.0)
        time = np.clip((phi_later - phi - rate_later * elapsed) / span, 0.0, elapsed)
        comes, leaves = rate + time * push, rate_later - (elapsed - time) * push
        turns &= (np.abs(phi + time * rate) <= off) & (comes < 0) & (leaves > 0)
        if np.count_nonzero(turns) != 1:
            return self
        (i,) = np.flatnonzero(turns)
        return SeenBounces(
            self.squares + float(comes[i] ** 2),
            self.products - float(comes[i] * leaves[i]),
        )
