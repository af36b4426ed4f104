"""Which contacts are touched, and which bounces are over: felt by the plant, or inferred."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.plant import ContactResults

from drake_aigto.arrays import Bools, Floats
from drake_aigto.control.stretches import is_at_rest_on
from drake_aigto.world import World


class BounceWatch:
    """Reads touches and bounces of a world, φ_i and J_i v being those that were planned with."""

    def __init__(self, world: World) -> None:
        """Takes the bodies that meet in each contact."""
        self._world = world
        inspector, plant = world.scene_graph.model_inspector(), world.plant
        bodies = [
            {int(plant.GetBodyFromFrameId(inspector.GetFrameId(shape)).index()) for shape in pair}
            for pair in world.shapes
        ]
        self._bodies = bodies

    def reaches(self, elapsed: float, last: Floats, control: Floats) -> Bools:
        """Returns which contacts are reached by what goes on as its control drives it, shape (m,).

        They are where J_i v < 0 at the last sample and φ_i(q + v t + a t² / 2) ≤ 0.

        Args:
            elapsed: t, since the last sample [s].
            last: q and v then, shape (2n,).
            control: u since then, shape (nu,).
        """
        world, (q, v) = self._world, np.split(last, 2)
        ahead = q + elapsed * (v + elapsed / 2 * world.calc_acceleration(q, v, control))
        return (world.calc_contact_rate(q, v) < 0) & (world.calc_signed_distance(ahead) <= 0)

    def is_inside(self, x: Floats) -> Bools:
        """Returns where φ_i ≤ 0, shape (m,)."""
        return np.asarray(self._world.calc_signed_distance(np.split(x, 2)[0]) <= 0)

    def rests(self, x: Floats) -> Bools:
        """Returns which contacts lie at their walls, shape (m,)."""
        q, v = np.split(x, 2)
        return is_at_rest_on(self._world, q, v)

    def feel(self, results: ContactResults, x: Floats) -> Bools:
        """Returns which contacts the plant reports, shape (m,).

        Bodies are told by their indices, which are the same in every plant of one model. Of several
        contacts between the same two bodies it is the nearest to its wall.
        """
        phi = self._world.calc_signed_distance(np.split(x, 2)[0])
        felt = np.zeros(len(phi), dtype=bool)
        for k in range(results.num_point_pair_contacts()):
            info = results.point_pair_contact_info(k)
            pair = {int(info.bodyA_index()), int(info.bodyB_index())}
            same = [i for i, bodies in enumerate(self._bodies) if bodies == pair]
            if same:
                felt[min(same, key=lambda i: phi[i])] = True
        return felt

    def is_leaving(self, x: Floats) -> Bools:
        """Returns where J_i v > 0, shape (m,)."""
        return np.asarray(self._world.calc_contact_rate(*np.split(x, 2)) > 0)
