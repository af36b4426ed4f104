"""The paper's transcription, and contact impulses as decision variables, which it rejects.

With λ a variable, the mean of (φ λ)² over a box is (φ² + w_φ²/3)(λ² + w_λ²/3), least at zero
(AIGTO Sec. III-B, Fig. 1): "the optimizer converges to the trivial solution". Often, not always:

- With rigid rows under the weights that find the bounce without forces, p goes to zero and the plan
  is the free flight, whatever the first width of p. The half widths of p shrink to nothing, where
  the same impulse written as M Δv − dt (B u − h) stays as uncertain as v.
- With the row that ties p to the motion ten times lighter and a light restitution row, slowly
  annealed boxes find the bounce. A box that starts in the bounce, around the uncontrolled motion,
  keeps it.
"""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Chebyshev, Polynomial
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import ModelError, OptionsError
from drake_aigto.transcription import (
    CONTACT,
    DYNAMICS,
    KINEMATICS,
    NONPENETRATION,
    RESTITUTION,
    RigidTranscription,
    Transcription,
    as_expression,
    cut_to,
    shared_constraint,
)
from drake_aigto.world import Scenario, World

PUSH = "push"


@dataclass(frozen=True)
class PolynomialLaw:
    """λ(φ) = Σ_j c_j φ^j [N].

    Attributes:
        coefficients: c, the constant first [N/m^j].
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        """Checks."""
        if not self.coefficients or not all(map(math.isfinite, self.coefficients)):
            raise OptionsError(
                "coefficients", got=self.coefficients, expected="finite numbers, one at least"
            )

    @classmethod
    def fit(cls, scenario: Scenario, degree: int, reach: float) -> PolynomialLaw:
        """Returns ε/(φ + δ), interpolated at Chebyshev's points of 0 ≤ φ ≤ reach.

        Each degree divides the error by ρ = 1 + 2r + 2√(r² + r), r = δ/reach. At the paper's δ =
        1 mm before a wall 1 m away that is 1.07: 36 degrees more for a tenth of the error. As sums
        of powers, rounding ends all gain before a degree of 30.

        Raises:
            OptionsError: a degree below 0, a reach that is not above 0, or δ = 0.
        """
        if degree < 0:
            raise OptionsError("degree", got=degree, expected="0 or more")
        if not 0 < reach < math.inf:
            raise OptionsError("reach", got=f"{reach:g} m", expected="a number above 0")
        epsilon, delta = scenario.epsilon, scenario.delta
        if not delta > 0:
            remedy = "ε/φ has no polynomial near it at the wall."
            raise OptionsError("delta", got="0 m", expected="more than 0 m", remedy=remedy)
        law = Chebyshev.interpolate(lambda phi: epsilon / (phi + delta), degree, [0.0, reach])
        return cls(tuple(law.convert(kind=Polynomial).coef.tolist()))

    def __call__(self, distance: Any) -> Any:
        """Returns λ(φ) [N] for floats, arrays or Expressions [m]."""
        total = self.coefficients[-1]
        for coefficient in reversed(self.coefficients[:-1]):
            total = total * distance + coefficient
        return total


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
        law: λ(φ) in place of ε/(φ + δ), which needs no factor.
    """

    ROWS: ClassVar[tuple[str, ...]] = (KINEMATICS, DYNAMICS, NONPENETRATION)

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        nonpenetration: bool = True,
        law: PolynomialLaw | None = None,
    ) -> None:
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
        self.nonpenetration, self.law = nonpenetration, law
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
        (contact,) = self.world.contacts
        for impulse, direction in zip(self._momentum(), contact.jacobian, strict=True):
            self._bind_stages(shared_constraint(self._law_row(impulse, direction), DYNAMICS))

    def _law_row(self, impulse: Any, share: Any) -> Expression:
        """Returns impulse − dt λ(φ) share, times φ + δ if λ is a fraction that acts on it."""
        (contact,), dt = self.world.contacts, self._dt
        if self.law is not None:
            return as_expression(impulse - dt * self.law(contact.signed_distance) * share)
        if as_expression(share).Expand().EqualTo(Expression(0.0)):
            return as_expression(impulse)
        gap = contact.signed_distance + self.scenario.delta
        return as_expression(impulse * gap - dt * self.scenario.epsilon * share)

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
        if self.law is not None:
            forces = np.broadcast_to(self.law(distances), distances.shape)
        else:
            forces = scenario.epsilon / (distances + scenario.delta)
        impulses: Floats = self._dt * forces
        impulses[-1] = 0.0
        return impulses


class ForceVariables(Transcription):
    """Base of transcriptions with impulses p_k = dt λ_k ≥ 0 as decision variables.

    p has shape (N, m) [N s], and stands by its knot in the elimination order.

    Args:
        world: the plant, read.
        scenario: the task.
        args: the others of the transcription without forces.
        impulse_width: half width of p in AIGO's first box, in units of m · 4L/T, the impulse that
            reverses the fastest motion in that box.
        named: as `args`.
    """

    def __init__(
        self, world: World, scenario: Scenario, *args: Any, impulse_width: float = 1.0, **named: Any
    ) -> None:
        """Makes the program."""
        if not 0 < impulse_width < np.inf:
            raise OptionsError("impulse_width", got=impulse_width, expected="a number above 0")
        self.impulse_width = impulse_width
        super().__init__(world, scenario, *args, **named)

    def _lay_out(self) -> None:
        super()._lay_out()
        self._p = self._layout.new("p", self.scenario.num_steps, self.world.num_contacts)

    @cached_property
    def _impulse(self) -> npt.NDArray[Any]:
        return MakeVectorVariable(self.world.num_contacts, "p")

    def _stage_indices(self, k: int) -> Ints:
        return np.concatenate([super()._stage_indices(k), *self._p[k : k + 1]])

    def _stage(self, k: int) -> list[tuple[npt.NDArray[Any], npt.NDArray[Any]]]:
        impulses = self._variables_at(self._p[k : k + 1])
        return super()._stage(k) + [(self._impulse, p_k) for p_k in impulses]

    def _add_impulse_rows(self, momentum: npt.NDArray[Any], per_unit: Any = 1.0) -> None:
        """Adds momentum = Jᵀ p, where momentum is the residual of flight, and p ≥ 0."""
        J = np.array([contact.jacobian for contact in self.world.contacts])
        for row in (momentum - J.T @ self._impulse) * per_unit:
            self._bind_stages(shared_constraint(as_expression(row), DYNAMICS))
        for p_i in self._impulse:
            self._bind_stages(shared_constraint(Expression(p_i), PUSH, 0.0, np.inf))

    def vector_of(self, positions: Floats, velocities: Floats, controls: Floats) -> Floats:
        """Returns all decision variables, with the impulses that q, v and u imply."""
        x = super().vector_of(positions, velocities, controls)
        x[self._p] = super().impulses(x)[:-1]  # type: ignore[safe-super]
        return x

    def impulses(self, x: Floats) -> Floats:
        """Returns p, shape (N+1, m) [N s]; 0 at the last knot: no step follows."""
        return np.vstack([x[self._p], np.zeros((1, self.world.num_contacts))])

    def impulse_indices(self) -> Ints:
        """Returns where p is among all decision variables, knot by knot, shape (N m,)."""
        return self._p.ravel()

    def _box(self, center: Floats, shares: Floats) -> tuple[Floats, Floats]:
        center, half_width = super()._box(center, shares)
        turned = 4 * self.inertia() * self.length_scale() / self.scenario.duration
        half_width[self._p] = self.impulse_width * turned * shares[:-1, np.newaxis]
        return cut_to(self.bounds(), center, half_width)


class LiteralWithForces(ForceVariables, LiteralTranscription):
    """AIGTO's collocation with forces, by explicit Euler.

        q_{k+1} = q_k + dt v_k                                                         "kinematics"
        M (v_{k+1} − v_k) = dt (B u_k − h(q_k, v_k)) + J_kᵀ p_k                          "dynamics"
        (φ_k + δ) p_k = dt ε,   p_k ≥ 0                                          "contact", "push"

    Rows are in SI units. Arguments are those of `LiteralTranscription`, and `impulse_width`
    (`ForceVariables`).
    """

    ROWS: ClassVar[tuple[str, ...]] = (*LiteralTranscription.ROWS, CONTACT, PUSH)

    def _add_dynamics_rows(self) -> None:
        self._add_impulse_rows(self._momentum())
        self._bind_stages(shared_constraint(self._law_row(self._impulse[0], 1.0), CONTACT))


class RigidWithForces(ForceVariables, RigidTranscription):
    """The rigid transcription with forces: rows as `RigidTranscription`, but p a variable.

        p_k ≥ 0                                                                            "push"
        M (v_{k+1} − v_k) = dt (B u_k − h̄_k) + Jᵀ p_k                                  "dynamics"
        φ_ik p_ik = dt ε;   p_0 = 0                                                     "contact"
        p_ik (J_i v⁺_k + e J_i v_k) = 0, k ≥ 1                                      "restitution"

    Flight and nonpenetration are as without forces. Every contact has an impulse of its own, and so
    no products of several distances are needed. Arguments are those of `RigidTranscription`, and
    `impulse_width` (`ForceVariables`).
    """

    ROWS: ClassVar[tuple[str, ...]] = (*RigidTranscription.ROWS, PUSH)

    def again(self, scenario: Scenario, path: Floats | None = None) -> RigidWithForces:
        """Returns the same, with additions, for another scenario or around another path."""
        args = self.world, scenario, self.relaxation, path
        other = RigidWithForces(*args, impulse_width=self.impulse_width)
        return other.with_additions(self.additions())

    def _add_rows(self) -> None:
        per_speed, given = self._per_speed, self._given
        after, momentum = self._add_flight_rows()
        self._add_impulse_rows(momentum, per_speed / np.max(self._inertia.masses))
        jumps = self._impulse / self._inertia.masses * per_speed
        before = self.world.velocities
        for i, (d, jump) in enumerate(zip(self._inertia.jacobian, jumps, strict=True)):
            phi = self.world.contacts[i].signed_distance * given.per_length
            pushed = jump * phi - self.relaxation / self.scenario.num_steps
            returned = jump * (d @ after + given.restitutions[i] * (d @ before)) * per_speed
            knots = (np.flatnonzero(self._fronts[1:-1, i]) + 1).tolist()
            self._bind(shared_constraint(as_expression(jump), CONTACT), 0)
            self._bind_each(shared_constraint(as_expression(pushed), CONTACT), knots)
            row = shared_constraint(as_expression(returned), RESTITUTION)
            self._bind_each(row, range(1, len(self._u)))
        self._bound_distances(self._fronts)
