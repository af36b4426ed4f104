"""The paper's transcription: explicit Euler, with the contact force ε/(φ + δ)."""

from __future__ import annotations

from collections.abc import Hashable
from typing import ClassVar

import numpy as np
import numpy.typing as npt
from pydrake.symbolic import Expression

from drake_aigto.arrays import Floats
from drake_aigto.errors import ModelError
from drake_aigto.transcription import (
    DYNAMICS,
    KINEMATICS,
    NONPENETRATION,
    Transcription,
    as_expression,
    shared_constraint,
)
from drake_aigto.world import Scenario, World


class LiteralTranscription(Transcription):
    """AIGTO Sec. IV as printed: collocation without forces, by explicit Euler.

        q_{k+1} = q_k + dt v_k                                                         "kinematics"
        M (v_{k+1} − v_k) = dt (B u_k − h(q_k, v_k) + J_kᵀ λ_k),   λ_k = ε/(φ_k + δ)     "dynamics"
        φ(q_k) ≥ 0, k ≥ 1, if requested                                          "nonpenetration"

    The dynamics rows that the contact acts on are multiplied out, so that all rows are polynomial:
    (φ_k + δ)(M Δv − dt (B u − h)) − dt ε Jᵀ = 0.

    The discrete contact is no rigid wall: a knot with φ_k + δ ≈ 0 makes dt λ_k an impulse of any
    size, also a pull where φ_k < −δ. Replay every plan before believing its cost.

    Args:
        world: the plant, read.
        scenario: the task, with its ε and δ.
        nonpenetration: whether φ(q_k) ≥ 0 is a constraint. The paper's figures need it off.
    """

    ROWS: ClassVar[tuple[str, ...]] = (KINEMATICS, DYNAMICS, NONPENETRATION)

    def __init__(self, world: World, scenario: Scenario, nonpenetration: bool = True) -> None:
        """Makes the program.

        Raises:
            ModelError: the world has several contacts.
        """
        if world.num_contacts > 1:
            raise ModelError(
                "the literal transcription is for one contact",
                got=", ".join(contact.name for contact in world.contacts),
                expected="one of them",
                remedy="Use the rigid transcription, or exclude pairs of shapes with a "
                "<drake:collision_filter_group>.",
            )
        self.nonpenetration = nonpenetration
        super().__init__(world, scenario)

    @property
    def structure(self) -> Hashable:
        """All that rows and costs depend on besides the world, users, and `parameters`."""
        return super().structure, self._dt

    def _is_bounded(self) -> npt.NDArray[np.bool_]:
        return np.full(self.world.num_contacts, self.nonpenetration)

    def _add_rows(self) -> None:
        for row in self._next_q - self.world.positions - self._dt * self.world.velocities:
            self._bind_stages(shared_constraint(row, KINEMATICS))
        self._add_dynamics_rows()
        if self.nonpenetration:
            self._bound_distances(
                np.ones((self.num_samples(), self.world.num_contacts), dtype=bool)
            )

    def _add_dynamics_rows(self) -> None:
        (contact,), dt = self.world.contacts, self._dt
        for row, direction in zip(self._momentum(), contact.jacobian, strict=True):
            if not direction.Expand().EqualTo(Expression(0.0)):
                gap = contact.signed_distance + self.scenario.delta
                row = row * gap - dt * self.scenario.epsilon * direction
            self._bind_stages(shared_constraint(as_expression(row), DYNAMICS))

    def _momentum(self) -> npt.NDArray[np.object_]:
        """Returns the residual of flight, M Δv − dt (B u − h) [N s]."""
        world = self.world
        force = world.actuation @ world.controls - world.bias
        return world.mass_matrix @ (self._next_v - world.velocities) - self._dt * force

    def defects(self, x: Floats) -> dict[str, float]:
        """Returns the largest of each kind: kinematics [m], dynamics [m/s], nonpenetration [m].

        The dynamics are measured with λ(φ) itself, not with the row multiplied out, which
        is blind near the wall.
        """
        q, v, _ = self.split(x)
        found = {
            KINEMATICS: np.max(np.abs(q[1:] - q[:-1] - self._dt * v[:-1])),
            DYNAMICS: np.max(np.abs(self._dynamics_defects(x))),
        }
        if self.nonpenetration:
            found[NONPENETRATION] = self._depth(x)
        return {name: float(value) for name, value in found.items()}

    def close_rows(self, x: Floats) -> Floats:
        """Returns x with controls changed by B⁺ M d/dt, which cancels dynamics defects d.

        A solver that meets the rows multiplied out to 1e-13 may leave 1e-7 m/s where φ + δ is
        1e-5 m. Defects along actuators vanish.
        """
        q, v, u = self.split(x)
        M, inverse = self.world.calc_mass_matrix(q[:-1]), np.linalg.pinv(self.world.actuation)
        missed = np.einsum("kij,kj->ki", M, self._dynamics_defects(x)) / self._dt
        return self.vector_of(q, v, u + missed @ inverse.T)

    def _dynamics_defects(self, x: Floats) -> Floats:
        """Returns v_{k+1} − v_k − dt M⁻¹ (B u_k − h + J_kᵀ λ_k), shape (N, nv) [m/s]."""
        q, v, u = self.split(x)
        free = self.world.calc_acceleration(q[:-1], v[:-1], u)
        kick = self.world.calc_velocity_change(q, self.impulses(x))[:-1]
        defects: Floats = v[1:] - v[:-1] - self._dt * free - kick
        return defects

    def impulses(self, x: Floats) -> Floats:
        """Returns dt λ(φ(q_k)), shape (N+1, m) [N s]; 0 at the last knot: no step follows."""
        distances, scenario = self.signed_distances(x), self.scenario
        forces = scenario.epsilon / (distances + scenario.delta)
        impulses = np.broadcast_to(self._dt * forces, distances.shape).copy()
        impulses[-1] = 0.0
        return impulses
