"""Controls as the only variables, states as their polynomials, rejected by AIGTO Sec. III-B."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt
from pydrake.solvers import MathematicalProgram
from pydrake.symbolic import (
    Expression,
    MakeMatrixContinuousVariable,
    Polynomial,
    Variable,
    Variables,
)

from drake_aigto.arrays import Floats
from drake_aigto.errors import UnsupportedTermError
from drake_aigto.paper.transcriptions import LiteralTranscription, PolynomialLaw
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import as_expression, shared_cost
from drake_aigto.world import Scenario, World

# The state two steps later has about the square of a state's terms, soon too many for memory.
MAX_TERMS = 25_000
_NO_CONTACT = PolynomialLaw((0.0,))


class SingleShooting:
    """A contact problem as a polynomial of its controls alone (AIGTO Sec. III-B).

        minimize over u_k    Σ_{k<N} dt w_u ‖u_k‖² + w_f ‖q_N(u) − goal‖²
        q_{k+1} = q_k + dt v_k,    v_{k+1} = v_k + dt M⁻¹ (B u_k − h(q_k, v_k) + J_kᵀ λ(φ_k))

    There are no rows: each state is substituted, as a polynomial, into the next. The result depends
    on the contact:

    - Without one, and with an affine h, states are affine and the cost is quadratic, of about N²/2
      terms. The paper's objection does not hold there.
    - λ = ε/(φ + δ) makes states nested fractions, whose means have no closed form. To multiply the
      denominators out, as `LiteralTranscription` does, takes rows, and so states as variables.
    - A `PolynomialLaw` of degree d keeps states polynomials, whose degree grows d-fold with every
      other step and whose terms are squared (`count_terms`). One can plan eight steps with d = 2,
      and no law of so low a degree is near the paper's (`PolynomialLaw.fit`).

    φ ≥ 0 is an inequality of many variables here, whose penalty has no mean in closed form: only
    the law keeps the ball off. Methods are named as in `Transcription`, but `state(k)` returns
    expressions. Only the scenario's own costs count.

    Args:
        world: the plant, read.
        scenario: the task; its ε and δ act through the law alone.
        law: of the contact force; walls have no effect if None.

    Attributes:
        multiple_shooting: the same problem with states as variables: equal optima.
    """

    def __init__(self, world: World, scenario: Scenario, law: PolynomialLaw | None = None) -> None:
        """Substitutes, and adds the scenario's costs.

        Raises:
            ModelError: the world has several contacts.
            UnsupportedTermError: there would be too many terms; says how many, and at which step.
        """
        law = law or _NO_CONTACT
        self.multiple_shooting = LiteralTranscription(world, scenario, False, law)
        self.world, self.scenario, self.law = world, scenario, law
        self._prog, N = MathematicalProgram(), scenario.num_steps
        u = self._prog.NewContinuousVariables(N * world.num_actuators, "u")
        self._u = u.reshape(N, world.num_actuators)
        self._states = list(_states(world, scenario, law, self._u, MAX_TERMS))
        # NumPy takes Drake's boxed constants for invalid numbers, and warns.
        with np.errstate(invalid="ignore"):
            error = world.positions - scenario.goal_position
            effort = scenario.control_weight * scenario.time_step * u.dot(u)
            miss = as_expression(scenario.goal_weight * error.dot(error))
        last = dict(zip(_names(world), self._states[-1], strict=True))
        label = f"the cost 'goal' of {N} steps"
        goal = _substitute(label, miss, last, MAX_TERMS).ToExpression()
        for cost in shared_cost(effort, "control effort"), shared_cost(goal, "goal"):
            self._prog.AddCost(cost.evaluator, vars=list(cost.placeholders))

    def prog(self) -> MathematicalProgram:
        """Returns the program: costs, and no rows to penalize."""
        return self._prog

    def num_samples(self) -> int:
        """Returns the number of knots, N + 1."""
        return len(self._states)

    def state(self, k: int) -> npt.NDArray[Any]:
        """Returns x_k = [q_k, v_k] as expressions in u."""
        return np.array([part.ToExpression() for part in self._states[k]])

    def input(self, k: int) -> npt.NDArray[Any]:
        """Returns u_k, shape (nu,), 0 ≤ k < N."""
        return self._u[k]

    def num_terms(self, k: int) -> int:
        """Returns the largest number of terms of an entry of x_k."""
        return max(map(_count, self._states[k]))

    def GetSampleTimes(self) -> Floats:
        """Returns the knots' times, shape (N+1,) [s]."""
        return self.multiple_shooting.GetSampleTimes()

    def initial_box(self) -> tuple[Floats, Floats]:
        """Returns center and half width of AIGO's first box: `multiple_shooting`'s, of controls."""
        rows = self.multiple_shooting
        center, half_width = (rows.split(part)[2].ravel() for part in rows.initial_box())
        return center, half_width

    def vector(self, x: Floats) -> Floats:
        """Returns all decision variables of `multiple_shooting`: x, and its states."""
        world, scenario, dt = self.world, self.scenario, self.scenario.time_step
        controls = x.reshape(self._u.shape)
        q, v = [scenario.initial_position], [scenario.initial_velocity]
        for u in controls:
            push = dt * np.broadcast_to(self.law(world.calc_signed_distance(q[-1])), (1,))
            kick = dt * world.calc_acceleration(q[-1], v[-1], u)
            kick = kick + world.calc_velocity_change(q[-1], push)
            q, v = [*q, q[-1] + dt * v[-1]], [*v, v[-1] + kick]
        return self.multiple_shooting.vector_of(np.array(q), np.array(v), controls)

    def trajectory(self, x: Floats) -> Trajectory:
        """Returns the trajectory of controls x."""
        return self.multiple_shooting.trajectory(self.vector(x))

    def scenario_cost(self, x: Floats) -> float:
        """Returns J = w_u Σ dt ‖u_k‖² + w_f ‖q_N − goal‖²."""
        return self.multiple_shooting.scenario_cost(self.vector(x))


def count_terms(
    world: World, scenario: Scenario, law: PolynomialLaw | None = None, max_terms: int = MAX_TERMS
) -> list[int]:
    """Returns numbers of terms of states after 1, 2, … steps, as far as `max_terms` and T allow.

    With one coordinate and a law of degree 2: 2, 3, 5, 8, 16, 32, 88, 240, 968. A cost has more.
    """
    controls = MakeMatrixContinuousVariable(scenario.num_steps, world.num_actuators, "u")
    counts = []
    with suppress(UnsupportedTermError):
        for state in _states(world, scenario, law or _NO_CONTACT, controls, max_terms):
            counts.append(max(map(_count, state)))
    return counts[1:]


def _states(
    world: World, scenario: Scenario, law: PolynomialLaw, controls: npt.NDArray[Any], max_terms: int
) -> Iterator[list[Polynomial]]:
    """Yields x_0, x_1, … as polynomials of the controls, shape (nq + nv,) each."""
    names, step = [*_names(world), *world.controls], _euler_step(world, scenario.time_step, law)
    state = [Polynomial(Expression(value)) for value in scenario.initial_state]
    yield state
    for k, u_k in enumerate(controls, 1):
        inputs = [Polynomial(Expression(u)) for u in u_k]
        values = dict(zip(names, [*state, *inputs], strict=True))
        label = f"the state after {k} of {len(controls)} steps"
        state = [_substitute(label, part, values, max_terms) for part in step]
        yield state


# NumPy takes Drake's boxed constants for invalid numbers, and warns.
@np.errstate(invalid="ignore")
def _euler_step(world: World, dt: float, law: PolynomialLaw) -> list[Expression]:
    """Returns x a step later."""
    force = world.actuation @ world.controls - world.bias
    for contact in world.contacts:
        force = force + contact.jacobian * law(contact.signed_distance)
    slope = np.concatenate([world.velocities, world.constant_inertia.inverse_mass @ force])
    return [as_expression(part).Expand() for part in _names(world) + dt * slope]


def _names(world: World) -> npt.NDArray[Any]:
    """Returns the placeholders of x."""
    return np.concatenate([world.positions, world.velocities])


def _count(polynomial: Polynomial) -> int:
    return len(polynomial.monomial_to_coefficient_map())


def _substitute(
    label: str, expression: Expression, values: dict[Variable, Polynomial], max_terms: int
) -> Polynomial:
    """Returns an expression with polynomials in place of its variables, multiplied out.

    Raises:
        UnsupportedTermError: that might have more terms than `max_terms`.
    """
    outer = Polynomial(expression, Variables(np.array(list(values))))
    # A variable as a key is only found by itself, not by an equal one.
    counts = {name.get_id(): _count(value) for name, value in values.items()}
    # A power p of a sum of n terms has no more than there are multisets of p out of n.
    largest = sum(
        math.prod(math.comb(counts[x.get_id()] + p - 1, p) for x, p in term.get_powers().items())
        for term in outer.monomial_to_coefficient_map()
    )
    if largest > max_terms:
        raise UnsupportedTermError(
            f"{label} has too many terms for single shooting",
            got=f"up to {largest:,}, products of states of {max(counts.values()):,} terms",
            expected=f"at most {max_terms:,}",
            remedy="Take fewer steps or a law of lower degree; or LiteralTranscription, whose "
            "states are variables and whose terms grow like N.",
        )
    return outer.SubstituteAndExpand(values)
