"""What a rigid contact does to a motion: impact map, exact flight, and how far a motion is off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from drake_aigto.errors import ModelError, OptionsError
from drake_aigto.transcription.shared import as_expression
from drake_aigto.transcription.transcription import NONPENETRATION, Transcription
from drake_aigto.world.once import once_per_world
from drake_aigto.world.polynomials import evaluate_constants

if TYPE_CHECKING:
    import numpy.typing as npt

    from drake_aigto.trajectory import Trajectory
    from drake_aigto.world import Scenario, World

FLIGHT, DYNAMICS, CONTACT, RESTITUTION = "flight", "dynamics", "contact", "restitution"

# Least eigenvalue of c contacts' inertia in units of their masses, 1 if they don't feel each other.
_DEPENDENT = 1e-9


@dataclass(frozen=True, eq=False)
class RigidContact:
    """One contact of a world, frictionless, with a constant Jacobian.

    Attributes:
        jacobian: J = ∂φ/∂q, shape (nv,).
        lift: how an impulse that changes φ̇ by one changes v, M⁻¹ Jᵀ / (J M⁻¹ Jᵀ), shape (nv,).
        mass: what the wall feels, (J M⁻¹ Jᵀ)⁻¹ [kg].
    """

    jacobian: npt.NDArray[np.float64]
    lift: npt.NDArray[np.float64]
    mass: float

    @classmethod
    def of(cls, world: World, index: int = 0) -> RigidContact:
        """Returns a contact of a world.

        Raises:
            ModelError: φ is not affine in q.
        """
        contact = world.contacts[index]
        if any(not entry.GetVariables().empty() for entry in contact.jacobian):
            raise ModelError(
                f"the contact {contact.name} turns as the plant moves",
                got=f"the signed distance {contact.signed_distance}",
                expected="one that is affine in the positions",
                remedy="Use the literal transcription.",
            )
        J = evaluate_constants(contact.jacobian)
        impulse = np.zeros(world.num_contacts)
        impulse[index] = 1.0
        kick = world.calc_velocity_change(np.zeros(world.num_positions), impulse)
        mass = 1 / float(J @ kick)
        return cls(J, mass * kick, mass)


@once_per_world
def rigid_contacts(world: World) -> tuple[RigidContact, ...]:
    """Returns all contacts of a world.

    Raises:
        ModelError: φ of one is not affine in q.
    """
    return tuple(RigidContact.of(world, i) for i in range(world.num_contacts))


@dataclass(frozen=True, eq=False)
class JointImpact:
    """What contacts that are struck together do: Newton's law for all of them at once.

        v⁺ = R v⁻ = v⁻ + M⁻¹ J_Cᵀ p,    p = P v⁻ = −(J_C M⁻¹ J_Cᵀ)⁻¹ (I + E) J_C v⁻

    so that J_C v⁺ = −E J_C v⁻. Contacts that rest take part: their impulse keeps them at rest.
    Where contacts are coupled, J_C M⁻¹ J_Cᵀ not diagonal, it is a convention of its own: impacts
    one after the other would end in other velocities, that depend on the order.

    Attributes:
        impulses: P, shape (c, nv) [kg].
        velocities: R, shape (nv, nv).
        coupled: which of the contacts have an impulse that another one's speed changes, shape (c,).
    """

    impulses: npt.NDArray[np.float64]
    velocities: npt.NDArray[np.float64]
    coupled: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, contacts: Sequence[RigidContact], restitutions: npt.ArrayLike) -> JointImpact:
        """Returns the impact of c contacts, with their restitutions, shape (c,).

        Raises:
            OptionsError: J_C has dependent rows: how they share an impulse is not defined.
        """
        J = np.array([contact.jacobian for contact in contacts])
        kicks = np.column_stack([contact.lift / contact.mass for contact in contacts])
        # In units of the contacts' own masses.
        root = np.sqrt([contact.mass for contact in contacts])
        inertia = root[:, np.newaxis] * (J @ kicks) * root
        if np.linalg.eigvalsh(inertia)[0] < _DEPENDENT:
            raise OptionsError(
                "sequence",
                got=f"{len(contacts)} contacts at once that can't all be told apart",
                expected="contacts with independent Jacobians",
                remedy="Leave out those that the others imply.",
            )
        closing = (1 + np.asarray(restitutions))[:, np.newaxis] * J
        impulses = -root[:, np.newaxis] * np.linalg.solve(inertia, root[:, np.newaxis] * closing)
        couplings = np.abs(inertia - np.diag(np.diag(inertia)))
        return cls(
            impulses=impulses,
            velocities=np.eye(J.shape[1]) + kicks @ impulses,
            coupled=np.any(couplings > _DEPENDENT, axis=1),
        )


class ImpactTranscription(Transcription):
    """A transcription whose contacts are those of a rigid wall with Newton's restitution."""

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Reads the contacts, then makes the program."""
        self._contacts = rigid_contacts(world)
        super().__init__(world, scenario)

    def defects(self, x: npt.NDArray[np.float64]) -> dict[str, float]:
        """Returns the largest of each kind, as `rigid_defects`, and nonpenetration [m]."""
        found = rigid_defects(
            self.world, self.world.restitutions(self.scenario), self.trajectory(x)
        )
        return {**found, NONPENETRATION: self._depth(x)}


def bias_at(
    world: World, positions: npt.NDArray[Any], velocities: npt.NDArray[Any]
) -> npt.NDArray[np.object_]:
    """Returns h at other expressions of q and v, shape (nv,)."""
    values = np.concatenate([positions, velocities])
    names = np.concatenate([world.positions, world.velocities])
    table = dict(zip(names, map(as_expression, values), strict=True))
    return np.array([entry.Substitute(table) for entry in world.bias], dtype=object)


def rigid_defects(
    world: World, restitution: npt.ArrayLike, trajectory: Trajectory
) -> dict[str, float]:
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
    contacts = rigid_contacts(world)
    J = np.array([contact.jacobian for contact in contacts])
    kicks = np.array([contact.lift / contact.mass for contact in contacts])
    masses = np.array([contact.mass for contact in contacts])
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
        FLIGHT: float(np.max(np.abs(q[1:] - q[:-1] - tau * v_mean))),
        DYNAMICS: float(
            np.max(np.abs(v[1:] - after[:-1] - tau * (free + trajectory.forces @ kicks)))
        ),
        CONTACT: float(max(np.max(np.minimum(gaps, reach)), np.max(held))),
        RESTITUTION: float(
            max(np.max(np.minimum(np.abs(jumps), missed)), -np.min(jumps), -np.min(pushes), 0.0)
        ),
    }
