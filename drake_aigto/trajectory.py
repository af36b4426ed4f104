"""Trajectories with impacts: held controls, states and impulses at knots."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from pydrake.polynomial import Polynomial
from pydrake.trajectories import PiecewisePolynomial

from drake_aigto.arrays import ArrayRecord, Floats, read_only
from drake_aigto.errors import TrajectoryError

_FLOATING = 7  # Positions of a body that floats.


@dataclass(frozen=True, eq=False)
class Trajectory(ArrayRecord):
    """States at knots, the control held between them, and the impulses of the wall.

    Letters: N intervals between N + 1 knots, which need not be evenly spaced; nq positions,
    nv velocities, fewer if there are quaternions; nu controls, m contacts. Arrays are read-only.

    Attributes:
        times: t_k, shape (N+1,), strictly increasing [s].
        positions: q_k, shape (N+1, nq) [m, rad]. They never jump.
        velocities: v_k, shape (N+1, nv) [m/s, rad/s], just *before* an impulse at t_k.
        controls: u_k, shape (N, nu) [N, N m], held over [t_k, t_{k+1}).
        impulses: p_k ≥ 0 of the contacts along their normals, shape (N+1, m) [N s]. The velocity
            just after t_k is v_k + M⁻¹ Jᵀ p_k, and what friction adds.
        forces: λ_k ≥ 0 of sustained contacts, held over [t_k, t_{k+1}), shape (N, m) [N].

    Raises:
        TrajectoryError: shapes that do not fit, times that do not increase, NaN or infinity.
    """

    times: Floats
    positions: Floats
    velocities: Floats
    controls: Floats
    impulses: Floats
    forces: Floats

    def __post_init__(self) -> None:
        """Checks, and makes the arrays read-only."""
        times, controls = check_control(self.times, self.controls)
        checked = {"times": times, "controls": controls}
        for name in ("positions", "velocities", "impulses"):
            checked[name] = _check_rows(name, getattr(self, name), len(times), "one for each knot")
        count = len(controls)
        checked["forces"] = _check_rows("forces", self.forces, count, "one for each interval")
        for name, array in checked.items():
            object.__setattr__(self, name, array)
        nq, nv = self.positions.shape[1], self.velocities.shape[1]
        # A body that floats has 7 positions, a quaternion among them, and 6 velocities.
        if nq != nv and not 0 < _FLOATING * (nq - nv) <= nq:
            raise TrajectoryError(
                "velocities",
                got=f"shape {self.velocities.shape}",
                expected=f"that of positions, {self.positions.shape}",
            )

    @property
    def states(self) -> Floats:
        """Q and v at the knots, shape (N+1, nq + nv)."""
        return np.hstack([self.positions, self.velocities])

    def later(self, by: float) -> Trajectory:
        """Returns the same motion, later by a duration [s].

        Raises:
            TrajectoryError: times that no longer increase, by rounding, or are not finite.
        """
        other = copy.copy(self)
        object.__setattr__(other, "times", _check_times(self.times + by))
        return other

    def to_piecewise(self) -> tuple[PiecewisePolynomial, PiecewisePolynomial]:
        """Returns the state (q, v)(t), shape (nq + nv, 1), and the control u(t), shape (nu, 1).

        Between knots q(t) is the cubic through q_k, q_{k+1} with slopes v_k, v_{k+1}. Where an
        impulse acts at t_k the slope after it is not v_k, so q(t) is the parabola that ends with
        slope v_{k+1}: exact under a constant acceleration, which is what a held control gives a
        point mass. v(t) is the derivative of q(t); at an impulse it jumps, and its value at t_k is
        the velocity *after* the impulse. u(t) is right on every [t_k, t_{k+1}), and u_{N−1} at the
        end. With quaternions, q(t) and v(t) are linear between knots.
        """
        held = np.vstack([self.controls, self.controls[-1:]])
        control = PiecewisePolynomial.ZeroOrderHold(self.times, held.T)
        if self.velocities.shape != self.positions.shape:
            return PiecewisePolynomial.FirstOrderHold(self.times, self.states.T), control
        polynomials = []  # Of q and v in t − t_k, on each interval.
        for c in self._cubics:
            slopes = c[1:] * np.arange(1, 4)[:, np.newaxis]
            entries = [Polynomial(coefficients) for coefficients in (*c.T, *slopes.T)]
            polynomials.append(np.array(entries).reshape(-1, 1))
        return PiecewisePolynomial(polynomials, self.times), control

    def calc_state(self, time: float) -> Floats:
        """Returns q and v of `to_piecewise` at a time, shape (nq + nv,); beyond it, of its end."""
        times = self.times
        time = min(max(time, times[0]), times[-1])
        k = min(int(np.searchsorted(times, time, side="right")) - 1, len(times) - 2)
        elapsed = time - times[k]
        if self.velocities.shape != self.positions.shape:
            first, last = self.states[k : k + 2]
            return np.asarray(first + elapsed / (times[k + 1] - times[k]) * (last - first))
        c = self._cubics[k]
        q = c[0] + elapsed * (c[1] + elapsed * (c[2] + elapsed * c[3]))
        return np.concatenate([q, c[1] + elapsed * (2 * c[2] + 3 * elapsed * c[3])])

    @cached_property
    def _cubics(self) -> Floats:
        """Coefficients of q in t − t_k, rising, of all intervals, shape (N, 4, nq)."""
        h, (q, v) = np.diff(self.times)[:, np.newaxis], (self.positions, self.velocities)
        mean, end = np.diff(q, axis=0) / h, v[1:]
        is_hit = np.any(self.impulses[:-1] != 0, axis=1, keepdims=True)
        start = np.where(is_hit, 2 * mean - end, v[:-1])
        quadratic, cubic = (3 * mean - 2 * start - end) / h, (start + end - 2 * mean) / h**2
        return np.stack([q[:-1], start, quadratic, cubic], axis=1)


def check_control(times: ArrayLike, controls: ArrayLike) -> tuple[Floats, Floats]:
    """Returns the times (N+1,) [s] and controls (N, nu) [N] of a held control, read-only.

    Raises:
        TrajectoryError: shapes that do not fit, times that do not increase, NaN or infinity.
    """
    t = _check_times(times)
    return t, _check_rows("controls", controls, len(t) - 1, "one for each interval")


def _check_times(times: ArrayLike) -> Floats:
    """Returns finite, increasing times, read-only."""
    t = _check_finite("times", times)
    if t.ndim != 1 or len(t) < 2:
        raise TrajectoryError("times", got=f"shape {t.shape}", expected="(N+1,) with N ≥ 1")
    if not np.all(t[1:] > t[:-1]):
        k = int(np.argmax(t[1:] <= t[:-1]))
        raise TrajectoryError(
            "times",
            got=f"{t[k]:.17g} s, then {t[k + 1]:.17g} s (knots {k} and {k + 1})",
            expected="strictly increasing times",
        )
    return t


def _check_rows(name: str, values: ArrayLike, count: int, what: str) -> Floats:
    """Returns a finite, read-only array of two dimensions with `count` rows."""
    rows = _check_finite(name, values)
    if rows.ndim != 2 or len(rows) != count:
        raise TrajectoryError(name, got=f"shape {rows.shape}", expected=f"{count} rows, {what}")
    return rows


def _check_finite(name: str, values: ArrayLike) -> Floats:
    try:
        array = read_only(values)
    except (TypeError, ValueError) as error:
        raise TrajectoryError(name, got=error, expected="an array of numbers") from error
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise TrajectoryError(
            name, got=f"{array[where]} at index {where}", expected="finite numbers"
        )
    return array
