"""Fingerprint of a world: names and numbers that fit into a file."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydrake.multibody.plant import MultibodyPlant

from drake_aigto.dynamics import EquationsOfMotion
from drake_aigto.errors import ModelError
from drake_aigto.world.limits import Limits, name_controls

_Rows = tuple[tuple[float, ...], ...]

# Of the largest number of its kind: what another machine, or another version of Drake, may round.
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Fingerprint:
    """Names and numbers of a world.

    The numbers are at a state that is in no way special, q_i = sin i and v_i = cos i for i = 1, 2,
    …: worlds with other equations have other numbers there.

    Attributes:
        model: what the world was built from; None: a diagram of one's own.
        coordinates: names of the positions, nq.
        actuators: their names, nu.
        contacts: their names, m.
        restitutions: the model's own, m; None where it is the scenario's.
        accelerations: v̇ without control, then with 1 N of each actuator, (1 + nu, nv) [m/s²].
        distances: φ, m [m].
        jacobian: J = ∂φ/∂q, (m, nv).
        kicks: M⁻¹ J_iᵀ, what 1 N s of each contact changes, (m, nv) [m/s].
        materials: stiffness [N/m] and dissipation [s/m] of both shapes of each contact, (m, 4),
            None where the model gives none; None: a file without any.
        limits: lower and upper ones of q, v and u; None: a file without any.
        friction: μ of each contact, and where spheres are stuck; None: a file without any.
    """

    model: str | None
    coordinates: tuple[str, ...]
    actuators: tuple[str, ...]
    contacts: tuple[str, ...]
    restitutions: tuple[float | None, ...]
    accelerations: _Rows
    distances: tuple[float, ...]
    jacobian: _Rows
    kicks: _Rows
    materials: tuple[tuple[float | None, ...], ...] | None = None
    limits: _Rows | None = None
    friction: tuple[float, ...] | None = None

    @classmethod
    def of(
        cls,
        motion: EquationsOfMotion,
        plant: MultibodyPlant,
        model: str | None,
        materials: tuple[tuple[float | None, ...], ...],
        limits: Limits,
        friction: ArrayLike,
    ) -> Fingerprint:
        """Returns that of a world."""
        q = motion.normalized(np.sin(np.arange(1.0, 1.0 + motion.num_positions)))
        v = np.cos(np.arange(1.0, 1.0 + motion.num_velocities))
        controls = np.vstack([np.zeros(motion.num_actuators), np.eye(motion.num_actuators)])
        return cls(
            model=model,
            coordinates=tuple(plant.GetPositionNames()),
            actuators=tuple(name_controls(plant, motion.num_actuators)),
            contacts=tuple(contact.name for contact in motion.contacts),
            restitutions=tuple(contact.restitution for contact in motion.contacts),
            accelerations=_rows(motion.calc_acceleration(q, v, controls)),
            distances=tuple(motion.calc_signed_distance(q).tolist()),
            jacobian=_rows(motion.calc_contact_jacobian(q)),
            kicks=_rows(motion.calc_velocity_change(q, np.eye(motion.num_contacts))),
            materials=materials,
            limits=_rows(np.hstack([limits.position, limits.velocity, limits.control])),
            friction=tuple(np.asarray(friction).tolist()),
        )

    def check(self, other: Fingerprint, remedy: str) -> None:
        """Checks that another world is the same, wherever it was built from.

        Raises:
            ModelError: it is not; names the first thing that differs, and the remedy.
        """
        for field in dataclasses.fields(self)[1:]:  # All but the model.
            mine, yours = getattr(self, field.name), getattr(other, field.name)
            is_known = field.default is dataclasses.MISSING or None not in (mine, yours)
            if is_known and not _is_same(mine, yours):
                got = f"{field.name} {yours}"
                raise ModelError("the world has changed", got, expected=mine, remedy=remedy)


def _rows(values: ArrayLike) -> _Rows:
    return tuple(map(tuple, np.asarray(values).tolist()))


def _is_same(mine: Any, yours: Any) -> bool:
    """Returns whether names are equal, and numbers but for rounding."""
    if mine == yours:
        return True
    try:
        one, other = np.asarray(mine, dtype=float), np.asarray(yours, dtype=float)
    except (TypeError, ValueError):  # Names.
        return False
    if one.shape != other.shape:
        return False
    largest = np.abs(one[np.isfinite(one)]).max(initial=0.0)
    return bool(np.isclose(other, one, rtol=0.0, atol=_ROUNDING * largest, equal_nan=True).all())
