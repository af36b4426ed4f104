"""Contact as impulses at knots: the transcription whose plans hold on a rigid wall."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pydrake.solvers import MathematicalProgram

from drake_aigto.errors import OptionsError
from drake_aigto.transcription.penalties import InequalityPenalty, penalize
from drake_aigto.transcription.rigid_contact import (
    CONTACT,
    DYNAMICS,
    FLIGHT,
    RESTITUTION,
    ImpactTranscription,
    bias_at,
)
from drake_aigto.transcription.shared import as_expression, shared_constraint
from drake_aigto.transcription.transcription import CLEARANCE, NONPENETRATION
from drake_aigto.world import Scenario, World

if TYPE_CHECKING:
    import numpy.typing as npt


class RigidTranscription(ImpactTranscription):
    """Impulses at knots, exact flight between them, relaxed complementarity, Newton restitution.

    The impulse at knot k is what flight leaves unexplained, so it is no decision variable:

        p_k = M (v_{k+1} − v_k) − dt (B u_k − h̄_k),   h̄_k = h((q_k + q_{k+1})/2, (q_{k+1} − q_k)/dt)

    Along the wall it has to vanish. Across it, with the contact's mass m = (J M⁻¹ Jᵀ)⁻¹, it is
    λ_k = m J M⁻¹ p_k, and v⁺_k = v_{k+1} − dt M⁻¹ (B u_k − h̄_k) is the velocity after it:

        q_{k+1} = q_k + dt v_{k+1} − (dt²/2) M⁻¹ (B u_k − h̄_k)                             "flight"
        tᵀ p_k = 0 for all t along the wall, J t = 0                                     "dynamics"
        φ(q_k) λ_k = dt ε, k ≥ 1;  λ_0 = 0, for the start is off the wall                 "contact"
        λ_k (J v⁺_k + e J v_k) = 0, k ≥ 1                                             "restitution"
        φ(q_k) ≥ 0, k ≥ 1                                                          "nonpenetration"

    Flight is exact for a constant h, gravity for one, and the implicit midpoint rule, of second
    order in dt, where there are springs and dampers. For ε = 0 contacts are rigid. With ε > 0 the
    wall pushes a little from afar, λ_k = dt ε/φ_k as in AIGTO Sec. IV, which contradicts its
    restitution: such a program is for penalties, not for a solver that wants its rows met.

    Rows, or their penalties, are divided by their units, those of mass m, the `length_scale` L and
    T, so that penalty weights mean the same for every scale.

    Args:
        world: the plant, read; its signed distance has to be affine.
        scenario: the task, with its restitution e; its ε and δ are the literal transcription's.
        relaxation: ε ≥ 0, in units of m L²/T² [1].
    """

    def __init__(self, world: World, scenario: Scenario, relaxation: float = 1e-4) -> None:
        """Makes the program."""
        if not 0 <= relaxation < np.inf:
            raise OptionsError("relaxation", got=relaxation, expected="a number, 0 or more")
        self.relaxation = relaxation
        super().__init__(world, scenario)

    def _add_rows(self) -> None:
        world, dt, contact = self.world, self._dt, self._contact
        L, T = self.length_scale(), self.scenario.duration
        inverse = np.linalg.inv(world.mass_matrix_values)
        mean_velocity = (self._next_q - world.positions) / dt
        bias = bias_at(world, (world.positions + self._next_q) / 2, mean_velocity)
        kick = dt * inverse @ (world.actuation @ world.controls - bias)  # of control and bias
        after = self._next_v - kick
        change = after - world.velocities
        jump = contact.jacobian @ change  # Δφ̇ = λ/m
        rebound = contact.jacobian @ after
        approach = contact.jacobian @ world.velocities
        distance = world.contacts[0].signed_distance
        for row in self._next_q - world.positions - dt * (self._next_v - kick / 2):
            self._bind_stages(shared_constraint(as_expression(row / L), FLIGHT))
        for row in contact.tangents.T @ world.mass_matrix_values @ change:
            row = row / contact.mass * T / L
            self._bind_stages(shared_constraint(as_expression(row), DYNAMICS))
        pushed = distance * jump * T / L**2 - self.relaxation * dt / T
        self._bind(shared_constraint(as_expression(jump * T / L), CONTACT), 0)
        self._bind_each(shared_constraint(as_expression(pushed), CONTACT), range(1, len(self._u)))
        returned = jump * (rebound + self.scenario.restitution * approach) * (T / L) ** 2
        restitution = shared_constraint(as_expression(returned), RESTITUTION)
        self._bind_each(restitution, range(1, len(self._u)))
        self._add_nonpenetration(range(1, self.num_samples()))

    def cost_scale(self) -> float:
        """Returns what L costs to overcome in T from rest, without a wall.

        The optimum of ∫ w_u u² dt + w_f (L − q(T))² with m q̈ = u, which is w_f L² / (1 + w_f T³ /
        (3 w_u m²)): penalty weights and temperatures in this unit mean the same for every scale.
        """
        scenario = self.scenario
        effort = 3 * scenario.control_weight * self.inertia() ** 2 / scenario.duration**3
        miss = scenario.goal_weight
        price = effort * miss / (effort + miss) if miss else effort
        return price * self.length_scale() ** 2

    def penalized(self, inequality: InequalityPenalty = "squared hinge") -> MathematicalProgram:
        """Returns `prog` with constraints as costs, each row r_k as N r_k²: r_k²/dt in units of T.

        So weights mean the same for every N and T. Distances are in units of L here too: Drake
        makes φ/L ≥ 0 a bound on q, which has no unit left.
        """
        units = dict.fromkeys((NONPENETRATION, CLEARANCE), self.length_scale())
        return penalize(self._prog, inequality, scale=self.scenario.num_steps, units=units)

    def impulses(self, x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns λ_k, shape (N+1, 1) [N s]; 0 at the last knot: no step follows."""
        q, v, u = self.split(x)
        means = zip((q[:-1] + q[1:]) / 2, np.diff(q, axis=0) / self._dt, u, strict=True)
        free = np.array([self.world.calc_acceleration(*stage) for stage in means])
        jumps = (np.diff(v, axis=0) - self._dt * free) @ self._contact.jacobian
        return np.append(self._contact.mass * jumps, 0.0)[:, np.newaxis]
