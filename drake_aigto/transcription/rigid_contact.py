"""How far a motion is off one with rigid contact."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from drake_aigto.arrays import Floats
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription.rows import CONTACT, DYNAMICS, FLIGHT, NONPENETRATION, RESTITUTION
from drake_aigto.transcription.transcription import Transcription
from drake_aigto.world import Scenario, World


class ImpactTranscription(Transcription):
    """A transcription whose contacts are those of a rigid wall with Newton's restitution."""

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Reads M and J, then makes the program."""
        self._inertia = world.constant_inertia
        super().__init__(world, scenario)

    def defects(self, x: Floats) -> dict[str, float]:
        """Returns the largest of each kind, as `rigid_defects`, and nonpenetration [m]."""
        found = rigid_defects(
            self.world, self.world.restitutions(self.scenario), self.trajectory(x)
        )
        return {**found, NONPENETRATION: self._depth(x)}


def rigid_defects(world: World, restitution: ArrayLike, trajectory: Trajectory) -> dict[str, float]:
    """Returns how far a trajectory is from a motion with rigid impacts at its knots.

    With v⁺_k = v_k + M⁻¹ Jᵀ p_k, τ_k = t_{k+1} − t_k and means over the interval marked by a bar:

        flight          ‖q_{k+1} − q_k − τ_k v̄_k‖∞                                           [m]
        dynamics        ‖v_{k+1} − v⁺_k − τ_k M⁻¹ (B u_k − h(q̄_k, v̄_k) + Jᵀ λ_k)‖∞           [m/s]
        contact         min(φ_k, τ_k p_k/m): the wall pushes from afar; φ_k, φ_{k+1} if λ_k ≠ 0  [m]
        restitution     min(p_k/m, |φ̇⁺_k + e φ̇_k|): the impact returns another speed         [m/s]

    the largest over all contacts, where m is the mass that a contact feels, so that p/m is how its
    own impulse changes φ̇. Likewise a pull, p_k < 0 or λ_k < 0, counts as restitution.

    Args:
        world: the plant, read.
        restitution: e of every contact, shape (m,), or of all.
        trajectory: the motion.
    """
    inertia = world.constant_inertia
    J, kicks, masses = inertia.jacobian, inertia.kicks, inertia.masses
    tau = np.diff(trajectory.times)[:, np.newaxis]
    q, v, u = trajectory.positions, trajectory.velocities, trajectory.controls
    jumps, pushes = trajectory.impulses / masses, tau * trajectory.forces / masses
    after = v + trajectory.impulses @ kicks
    q_mean, v_mean = (q[:-1] + q[1:]) / 2, (after[:-1] + v[1:]) / 2
    free = world.calc_acceleration(q_mean, v_mean, u)
    gaps = np.abs(world.calc_signed_distance(q))
    reach = np.vstack([tau, tau[-1]]) * np.abs(jumps)
    missed = np.abs(after @ J.T + np.asarray(restitution) * (v @ J.T))
    held = np.where(trajectory.forces != 0, np.maximum(gaps[:-1], gaps[1:]), 0.0)
    return {
        FLIGHT: float(np.abs(q[1:] - q[:-1] - tau * v_mean).max()),
        DYNAMICS: float(
            np.abs(v[1:] - after[:-1] - tau * (free + trajectory.forces @ kicks)).max()
        ),
        CONTACT: float(max(np.minimum(gaps, reach).max(), held.max())),
        RESTITUTION: float(
            max(np.minimum(np.abs(jumps), missed).max(), -jumps.min(), -pushes.min(), 0.0)
        ),
    }
