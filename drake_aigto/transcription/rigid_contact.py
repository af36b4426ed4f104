"""What a rigid contact does to a motion: impact map, exact flight, and how far a motion is off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_aigto.errors import ModelError
from drake_aigto.transcription.shared import as_expression
from drake_aigto.transcription.transcription import NONPENETRATION, Transcription
from drake_aigto.world.polynomials import evaluate_constants

if TYPE_CHECKING:
    import numpy.typing as npt

    from drake_aigto.trajectory import Trajectory
    from drake_aigto.world import Scenario, World

FLIGHT, DYNAMICS, CONTACT, RESTITUTION = "flight", "dynamics", "contact", "restitution"


@dataclass(frozen=True, eq=False)
class RigidContact:
    """The one contact of a world, frictionless, with a constant Jacobian.

    Attributes:
        jacobian: J = ∂φ/∂q, shape (nv,).
        lift: how an impulse that changes φ̇ by one changes v, M⁻¹ Jᵀ / (J M⁻¹ Jᵀ), shape (nv,).
        mass: what the wall feels, (J M⁻¹ Jᵀ)⁻¹ [kg].
        tangents: basis of the velocities along the wall, J t = 0, shape (nv, nv − 1).
    """

    jacobian: npt.NDArray[np.float64]
    lift: npt.NDArray[np.float64]
    mass: float
    tangents: npt.NDArray[np.float64]

    @classmethod
    def of(cls, world: World) -> RigidContact:
        """Returns the contact of a world.

        Raises:
            ModelError: φ is not affine in q.
        """
        (contact,) = world.contacts
        if any(not entry.GetVariables().empty() for entry in contact.jacobian):
            raise ModelError(
                f"the contact {contact.name} turns as the plant moves",
                got=f"the signed distance {contact.signed_distance}",
                expected="one that is affine in the positions",
                remedy="Use the literal transcription.",
            )
        J = evaluate_constants(contact.jacobian)
        kick = world.calc_velocity_change(np.zeros(world.num_positions), np.ones(1))
        mass = 1 / float(J @ kick)
        tangents = np.linalg.svd(J[np.newaxis])[2][1:].T
        return cls(J, mass * kick, mass, tangents)

    def impact_map(self, restitution: float) -> npt.NDArray[np.float64]:
        """Returns R with v⁺ = R v⁻, so that J v⁺ = −e J v⁻, shape (nv, nv)."""
        nv = len(self.jacobian)
        R: npt.NDArray[np.float64] = np.eye(nv) - (1 + restitution) * np.outer(
            self.lift, self.jacobian
        )
        return R


class ImpactTranscription(Transcription):
    """A transcription whose contacts are those of a rigid wall with Newton's restitution."""

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Reads the contact, then makes the program."""
        self._contact = RigidContact.of(world)
        super().__init__(world, scenario)

    def defects(self, x: npt.NDArray[np.float64]) -> dict[str, float]:
        """Returns the largest of each kind, as `rigid_defects`, and nonpenetration [m]."""
        found = rigid_defects(self.world, self.scenario.restitution, self.trajectory(x))
        return {**found, NONPENETRATION: self._depth(x)}


def bias_at(
    world: World, positions: npt.NDArray[Any], velocities: npt.NDArray[Any]
) -> npt.NDArray[np.object_]:
    """Returns h at other expressions of q and v, shape (nv,)."""
    values = np.concatenate([positions, velocities])
    names = np.concatenate([world.positions, world.velocities])
    table = dict(zip(names, map(as_expression, values), strict=True))
    return np.array([entry.Substitute(table) for entry in world.bias], dtype=object)


def rigid_defects(world: World, restitution: float, trajectory: Trajectory) -> dict[str, float]:
    """Returns how far a trajectory is from a motion with rigid impacts at its knots.

    With v⁺_k = v_k + M⁻¹ Jᵀ p_k, τ_k = t_{k+1} − t_k and means over the interval marked by a bar:

        flight          ‖q_{k+1} − q_k − τ_k v̄_k‖∞                                           [m]
        dynamics        ‖v_{k+1} − v⁺_k − τ_k M⁻¹ (B u_k − h(q̄_k, v̄_k) + Jᵀ λ_k)‖∞           [m/s]
        contact         min(φ_k, τ_k Δφ̇_k): the wall pushes from afar; φ_k, φ_{k+1} if λ_k ≠ 0   [m]
        restitution     min(Δφ̇_k, |φ̇⁺_k + e φ̇_k|): the impact returns another speed         [m/s]

    and likewise a pull, Δφ̇_k < 0 or λ_k < 0, counts as restitution.
    """
    contact = RigidContact.of(world)
    tau = np.diff(trajectory.times)[:, np.newaxis]
    q, v, u = trajectory.positions, trajectory.velocities, trajectory.controls
    jumps = trajectory.impulses[:, 0] / contact.mass
    after = v + np.outer(jumps, contact.lift)
    q_mean, v_mean = (q[:-1] + q[1:]) / 2, (after[:-1] + v[1:]) / 2
    stages = zip(q_mean, v_mean, u, strict=True)
    free = np.array([world.calc_acceleration(*stage) for stage in stages])
    push = trajectory.forces * contact.lift / contact.mass
    distances = np.array([world.calc_signed_distance(p)[0] for p in q])
    rate = v @ contact.jacobian
    reach = np.append(tau, tau[-1]) * jumps
    missed = np.abs((1 + restitution) * rate + jumps)
    gaps = np.abs(distances)
    held = np.where(trajectory.forces[:, 0] != 0, np.maximum(gaps[:-1], gaps[1:]), 0.0)
    pull = np.maximum(np.max(-jumps), np.max(-tau * trajectory.forces / contact.mass))
    return {
        FLIGHT: float(np.max(np.abs(q[1:] - q[:-1] - tau * v_mean))),
        DYNAMICS: float(np.max(np.abs(v[1:] - after[:-1] - tau * (free + push)))),
        CONTACT: float(max(np.max(np.minimum(gaps, np.abs(reach))), np.max(held))),
        RESTITUTION: float(max(np.max(np.minimum(np.abs(jumps), missed)), pull, 0.0)),
    }
