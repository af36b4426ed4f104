"""Constant M and J, and h, with their derived quantities."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drake_aigto.arrays import Floats, read_only
from drake_aigto.dynamics.sums import evaluate, is_constant
from drake_aigto.errors import ModelError


@dataclass(frozen=True, eq=False)
class ConstantInertia:
    """Equations of motion whose M and J are constant, as those of bodies that only translate.

        φ(q) = J q + φ(0),    φ̇ = J v,    φ̈ = J v̇

    Effects of impulses and controls do not depend on q; with springs and dampers the bias h may
    still vary. Functions that need this take it instead of a World.

    Letters as in `EquationsOfMotion`. Arrays are read-only.

    Attributes:
        mass_matrix: M, shape (nv, nv) [kg].
        actuation: B, shape (nv, nu).
        jacobian: J, shape (m, nv).
        offset: φ(0), shape (m,) [m].
        solids: the contacts of each solid, S of them.
    """

    mass_matrix: Floats
    actuation: Floats
    jacobian: Floats
    offset: Floats
    solids: tuple[tuple[int, ...], ...]

    @cached_property
    def inverse_mass(self) -> Floats:
        """M⁻¹, shape (nv, nv) [1/kg]."""
        return read_only(np.linalg.inv(self.mass_matrix))

    @cached_property
    def gain(self) -> Floats:
        """M⁻¹ B, shape (nv, nu) [1/kg]: the acceleration by each control."""
        return read_only(self.inverse_mass @ self.actuation)

    @cached_property
    def kicks(self) -> Floats:
        """M⁻¹ J_iᵀ, shape (m, nv) [1/kg]: how v changes by an impulse of 1 N s at contact i."""
        return read_only(self.jacobian @ self.inverse_mass.T)

    @cached_property
    def delassus(self) -> Floats:
        """A = J M⁻¹ Jᵀ, shape (m, m) [1/kg]: how φ̇_i changes by 1 N s at contact j."""
        return read_only(self.jacobian @ self.kicks.T)

    @cached_property
    def masses(self) -> Floats:
        """1 / A_ii, shape (m,) [kg]: effective mass of each contact, infinite if it can't move."""
        with np.errstate(divide="ignore"):
            return read_only(1 / np.diag(self.delassus))

    @cached_property
    def lifts(self) -> Floats:
        """M⁻¹ J_iᵀ / A_ii, shape (m, nv): how v changes as contact i changes φ̇_i by 1.

        It is 0 if it can't move, as for an arm stretched out along the wall's normal.
        """
        mobility = np.diag(self.delassus)[:, np.newaxis]
        return read_only(self.kicks / np.where(mobility > 0, mobility, np.inf))


@dataclass(frozen=True, eq=False)
class ConstantDynamics(ConstantInertia):
    """Equations of motion with constant bias, too: held controls lead to parabolas.

        v̇ = M⁻¹ (B u − h)    without contact

    Attributes:
        bias: h, shape (nv,) [N].
    """

    bias: Floats

    @cached_property
    def drift(self) -> Floats:
        """−M⁻¹ h, shape (nv,) [m/s²]: the acceleration without control."""
        return read_only(-self.inverse_mass @ self.bias)


def read_constant(name: str, expressions: NDArray[Any], remedy: str) -> Floats:
    """Returns the values of expressions of this name, of the same shape, read-only.

    Raises:
        ModelError: they vary; with the remedy.
    """
    if not is_constant(expressions):
        got = ", ".join(map(str, expressions.flat))
        raise ModelError(name, got, expected="a constant", remedy=remedy)
    return read_only(evaluate(expressions))
