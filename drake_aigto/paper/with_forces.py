"""Contact impulses as decision variables: the collocation that AIGTO Sec. III-B rejects.

With λ a variable, the mean of (φ λ)² over a box is (φ² + w_φ²/3)(λ² + w_λ²/3), least at zero
(AIGTO Fig. 1): "the optimizer converges to the trivial solution". Measured, that is half of it.

- With rigid rows under the weights that find the bounce without forces, p goes to zero and nearly
  every plan from the straight line is the free flight, at every temperature and for every first
  width of p. The half widths of p are its own and shrink to nothing, where the same impulse written
  as M Δv − dt (B u − h) stays as uncertain as v.
- But not always: with the row that ties p to the motion ten times lighter and a light restitution
  row, hot boxes find the bounce nearly as often as without forces. A box that starts in the bounce,
  around the uncontrolled motion, keeps it.
- With literal rows and a heavy contact row φ goes to −δ instead, and p is arbitrary.

`python -m benchmarks ablations` counts this beside the transcriptions without forces.
"""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
from pydrake.symbolic import Expression, MakeVectorVariable

from drake_aigto.arrays import Floats, Ints
from drake_aigto.errors import OptionsError
from drake_aigto.paper.literal import LiteralTranscription
from drake_aigto.transcription import (
    CONTACT,
    DYNAMICS,
    RESTITUTION,
    RigidTranscription,
    Transcription,
    as_expression,
    cut_to,
    shared_constraint,
)
from drake_aigto.world import Scenario, World

PUSH = "push"


class ForceVariables(Transcription):
    """Base of transcriptions with impulses p_k = dt λ_k ≥ 0 as decision variables.

    p has shape (N, m) [N s], and stands by its knot in the elimination order.

    Attributes:
        impulse_width: half width of p in AIGO's first box, in units of m · 4L/T, the impulse that
            reverses the fastest motion in that box.
    """

    impulse_width: float

    def _set_impulse_width(self, impulse_width: float) -> None:
        if not 0 < impulse_width < np.inf:
            raise OptionsError("impulse_width", got=impulse_width, expected="a number above 0")
        self.impulse_width = impulse_width

    def _lay_out(self) -> None:
        super()._lay_out()
        self._p = self._layout.new("p", self.scenario.num_steps, self.world.num_contacts)

    @cached_property
    def _impulse(self) -> npt.NDArray[Any]:
        return MakeVectorVariable(self.world.num_contacts, "p")

    def _stage_indices(self, k: int) -> Ints:
        return np.concatenate([super()._stage_indices(k), *self._p[k : k + 1]])

    def _stage(self, k: int) -> list[tuple[npt.NDArray[Any], npt.NDArray[Any]]]:
        return super()._stage(k) + [
            (self._impulse, self._variables_at(p_k)) for p_k in self._p[k : k + 1]
        ]

    def _add_impulse_rows(self, momentum: npt.NDArray[Any], per_unit: Any) -> None:
        """Adds momentum = Jᵀ p, where momentum is the residual of flight, and p ≥ 0."""
        J = np.array([contact.jacobian for contact in self.world.contacts])
        for row in (momentum - J.T @ self._impulse) * per_unit:
            self._bind_stages(shared_constraint(as_expression(row), DYNAMICS))
        for p_i in self._impulse:
            self._bind_stages(shared_constraint(Expression(p_i), PUSH, 0.0, np.inf))

    @abstractmethod
    def implied_impulses(self, x: Floats) -> Floats:
        """Returns the impulses that q, v and u in x imply, shape (N+1, m) [N s]."""

    def vector_of(self, positions: Floats, velocities: Floats, controls: Floats) -> Floats:
        """Returns all decision variables, impulses as q, v and u imply them."""
        x = super().vector_of(positions, velocities, controls)
        x[self.impulse_indices()] = self.implied_impulses(x)[:-1].ravel()
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
        sizes = self.impulse_width * turned * shares[:-1]
        half_width[self.impulse_indices()] = np.repeat(sizes, self.world.num_contacts)
        return cut_to(self.bounds(), center, half_width)


class LiteralWithForces(ForceVariables, LiteralTranscription):
    """AIGTO's collocation with forces, by explicit Euler.

        q_{k+1} = q_k + dt v_k                                                         "kinematics"
        M (v_{k+1} − v_k) = dt (B u_k − h(q_k, v_k)) + J_kᵀ p_k                          "dynamics"
        (φ_k + δ) p_k = dt ε,   p_k ≥ 0                                          "contact", "push"

    Rows are in SI units. It is for one contact, with the arguments of `LiteralTranscription`
    without a law, and `impulse_width` (`ForceVariables`).
    """

    ROWS: ClassVar[tuple[str, ...]] = (*LiteralTranscription.ROWS, CONTACT, PUSH)

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        nonpenetration: bool = True,
        impulse_width: float = 1.0,
    ) -> None:
        """Makes the program."""
        self._set_impulse_width(impulse_width)
        super().__init__(world, scenario, nonpenetration)

    def _add_dynamics_rows(self) -> None:
        scenario = self.scenario
        self._add_impulse_rows(self._momentum(), 1.0)
        for contact, p_i in zip(self.world.contacts, self._impulse, strict=True):
            row = (contact.signed_distance + scenario.delta) * p_i - self._dt * scenario.epsilon
            self._bind_stages(shared_constraint(as_expression(row), CONTACT))

    def implied_impulses(self, x: Floats) -> Floats:
        """Returns dt ε/(φ(q_k) + δ), shape (N+1, m) [N s]; 0 at the last knot."""
        return LiteralTranscription.impulses(self, x)


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

    def __init__(
        self,
        world: World,
        scenario: Scenario,
        relaxation: float = 1e-4,
        path: Floats | None = None,
        impulse_width: float = 1.0,
    ) -> None:
        """Makes the program."""
        self._set_impulse_width(impulse_width)
        super().__init__(world, scenario, relaxation, path)

    def again(self, scenario: Scenario, path: Floats | None = None) -> RigidWithForces:
        """Returns the same, with additions, for another scenario or around another path."""
        args = self.world, scenario, self.relaxation, path, self.impulse_width
        return RigidWithForces(*args).with_additions(self.additions())

    def _add_rows(self) -> None:
        per_speed, relaxation = self._per_speed, self.relaxation / self.scenario.num_steps
        after, momentum = self._add_flight_rows()
        self._add_impulse_rows(momentum, per_speed / np.max(self._inertia.masses))
        restitutions = self.world.restitutions(self.scenario)
        before = self.world.velocities
        for i, d in enumerate(self._inertia.jacobian):
            jump = self._impulse[i] / self._inertia.masses[i] * per_speed
            phi = self.world.contacts[i].signed_distance * self._given.per_length
            pushed = jump * phi - relaxation
            returned = jump * (d @ after + float(restitutions[i]) * (d @ before)) * per_speed
            knots = (np.flatnonzero(self._fronts[1:-1, i]) + 1).tolist()
            self._bind(shared_constraint(as_expression(jump), CONTACT), 0)
            self._bind_each(shared_constraint(as_expression(pushed), CONTACT), knots)
            row = shared_constraint(as_expression(returned), RESTITUTION)
            self._bind_each(row, range(1, len(self._u)))
        self._bound_distances(self._fronts)

    def implied_impulses(self, x: Floats) -> Floats:
        """Returns the residual of flight, shape (N+1, m) [N s]; 0 at the last knot."""
        return RigidTranscription.impulses(self, x)
