"""How the one contact of a world moves, in numbers: distance, rates, and what an impulse does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from pydrake.symbolic import Expression

from drake_aigto.transcription.shared import only_contact
from drake_aigto.world.polynomials import PolynomialMap

if TYPE_CHECKING:
    import numpy.typing as npt

    from drake_aigto.world import World


class ContactMotion:
    """The distance φ of a world's contact along a motion x = (q, v), and what impulses do to it."""

    def __init__(self, world: World) -> None:
        """Compiles φ and its rates.

        Raises:
            ModelError: there are several contacts.
        """
        self._world = world
        contact = only_contact(world, "the replay")
        x = np.concatenate([world.positions, world.velocities])
        rate = _calc_rate(contact.signed_distance, world)
        curvature = _calc_rate(rate, world)
        self._distance_map = PolynomialMap(np.array([contact.signed_distance, rate]), x)
        self._curvature_map = PolynomialMap(np.array([curvature]), x)

    def calc_distance(self, x: npt.NDArray[np.float64]) -> tuple[float, float]:
        """Returns φ(q) [m] and φ̇ = J v [m/s]."""
        distance, rate = self._distance_map(x).tolist()
        return distance, rate

    def calc_push(self, x: npt.NDArray[np.float64], acceleration: npt.NDArray[np.float64]) -> float:
        """Returns φ̈ = J v̇ + J̇ v [m/s²]; negative is into the wall."""
        (J,) = self._world.calc_contact_jacobian(x[: self._world.num_positions])
        return float(J @ acceleration + self._curvature_map(x)[0])

    def calc_lift(self, q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Returns how an impulse of the wall that changes φ̇ by one changes v, shape (nv,).

        M⁻¹ Jᵀ (J M⁻¹ Jᵀ)⁻¹
        """
        (J,) = self._world.calc_contact_jacobian(q)
        direction = self._world.calc_velocity_change(q, np.ones(1))
        return direction / (J @ direction)

    def calc_mass(self, q: npt.NDArray[np.float64]) -> float:
        """Returns the mass that the wall feels, (J M⁻¹ Jᵀ)⁻¹ [kg]."""
        (J,) = self._world.calc_contact_jacobian(q)
        return float(1 / (J @ self._world.calc_velocity_change(q, np.ones(1))))

    def calc_kinetic_energy(self, v: npt.NDArray[np.float64]) -> float:
        """Returns ½ vᵀ M v [J]."""
        return float(v @ self._world.mass_matrix_values @ v) / 2


def _calc_rate(expression: Expression, world: World) -> Expression:
    """Returns Σ ∂f/∂q_i v_i; summed here, for NumPy takes Drake's boxed constants for NaN."""
    terms = (
        expression.Differentiate(q) * v
        for q, v in zip(world.positions, world.velocities, strict=True)
    )
    return sum(terms, Expression(0.0))


def calc_time_to_wall(distance: float, rate: float, push: float) -> float:
    """Returns the first t ≥ 0 at which φ + φ̇ t + φ̈ t²/2 = 0 [s]; infinity if there is none.

    Args:
        distance: φ ≥ 0 [m].
        rate: φ̇ [m/s].
        push: φ̈, taken for constant [m/s²].
    """
    discriminant = rate**2 - 2 * push * distance
    if discriminant < 0:
        return math.inf
    if rate < 0:
        return 2 * distance / (math.sqrt(discriminant) - rate)
    return (math.sqrt(discriminant) + rate) / -push if push < 0 else math.inf
