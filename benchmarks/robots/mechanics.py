"""The robots' equations, written out by hand: nothing is shared with what plans for them.

    M(q) v̇ = f(q, v, u) + J(q)ᵀ λ,    φ(q) ≥ 0 in front of each wall,    φ̈ = J v̇ + c(q, v)

Each mechanism writes M, f, φ, J and c into tables that are zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.kernels import inner


class Tables(NamedTuple):
    """What a mechanism writes; n coordinates, m walls."""

    mass: Any  # M (n, n)
    force: Any  # f (n,)
    gap: Any  # φ (m,)
    normal: Any  # J (m, n)
    curve: Any  # c = J̇ v (m,)


@inner
def cart_pole(q: Any, v: Any, u: Any, wall: float, out: Tables) -> None:
    """With q = (a, θ), 1 kg and 0.1 kg 0.8 m off, which hangs at θ = 0; walls at ±d."""
    s, c = np.sin(q[1]), np.cos(q[1])
    out.mass[0, 0], out.mass[1, 1] = 1.1, 0.064
    out.mass[0, 1] = out.mass[1, 0] = 0.08 * c
    out.force[0] = u[0] + 0.08 * s * v[1] ** 2
    out.force[1] = -0.1 * 9.8 * 0.8 * s
    for i in range(2):
        sign = 1.0 - 2.0 * i
        out.gap[i] = wall + sign * (q[0] + 0.8 * s)
        out.normal[i, 0], out.normal[i, 1] = sign, sign * 0.8 * c
        out.curve[i] = -sign * 0.8 * s * v[1] ** 2


@inner
def pendulum(q: Any, v: Any, u: Any, wall: float, out: Tables) -> None:
    """With q = (θ): 1 kg on a massless rod of 1 m, hanging at θ = 0; a wall where sin θ = −d."""
    out.mass[0, 0] = 1.0
    out.force[0] = u[0] - 9.81 * np.sin(q[0])
    out.gap[0] = np.sin(q[0]) + wall
    out.normal[0, 0] = np.cos(q[0])
    out.curve[0] = -np.sin(q[0]) * v[0] ** 2


@inner
def acrobot(q: Any, v: Any, u: Any, wall: float, out: Tables) -> None:
    """With q = (θ₁, θ₂), links of 1 m and 2 m of 1 kg; the motor is in the elbow, the wall at d."""
    s1, c1, s2, c2 = np.sin(q[0]), np.cos(q[0]), np.sin(q[1]), np.cos(q[1])
    s12, c12 = np.sin(q[0] + q[1]), np.cos(q[0] + q[1])
    out.mass[0, 0] = 0.083 + 0.33 + 0.25 + 1.0 + 1.0 + 2.0 * c2
    out.mass[0, 1] = out.mass[1, 0] = 0.33 + 1.0 + c2
    out.mass[1, 1] = 0.33 + 1.0
    lower = 9.81 * s12
    out.force[0] = s2 * (2.0 * v[0] + v[1]) * v[1] - 9.81 * 1.5 * s1 - lower - 0.1 * v[0]
    out.force[1] = u[0] - s2 * v[0] ** 2 - lower - 0.1 * v[1]
    out.gap[0] = wall - s1 - 2.0 * s12
    out.normal[0, 0], out.normal[0, 1] = -c1 - 2.0 * c12, -2.0 * c12
    out.curve[0] = s1 * v[0] ** 2 + 2.0 * s12 * (v[0] + v[1]) ** 2


@inner
def paddle(q: Any, v: Any, u: Any, wall: float, out: Tables) -> None:
    """With q = (h, θ, x, z): a paddle of 1 kg, lifted and turned, and a ball of 0.1 kg."""
    s, c = np.sin(q[1]), np.cos(q[1])
    height, rise = q[3] - q[0], v[3] - v[0]
    out.mass[0, 0], out.mass[1, 1], out.mass[2, 2], out.mass[3, 3] = 1.0, 0.06, 0.1, 0.1
    out.force[0], out.force[1], out.force[3] = u[0] - 9.81, u[1], -0.981
    out.gap[0] = height * c + q[2] * s - wall
    out.normal[0, 0], out.normal[0, 1] = -c, q[2] * c - height * s
    out.normal[0, 2], out.normal[0, 3] = s, c
    out.curve[0] = 2.0 * v[1] * (v[2] * c - rise * s) - (height * c + q[2] * s) * v[1] ** 2


@inner
def three_carts(q: Any, v: Any, u: Any, wall: float, out: Tables) -> None:
    """Three carts of 1 kg and 2 m, damped by 2 N s/m, of which the middle one is driven."""
    for i in range(3):
        out.mass[i, i] = 1.0
        out.force[i] = -2.0 * v[i]
    out.force[1] = u[0] - 2.0 * v[1]
    for i in range(2):
        out.gap[i] = q[i + 1] - q[i] - wall
        out.normal[i, i], out.normal[i, i + 1] = -1.0, 1.0


@inner
def throwing_ball(q: Any, v: Any, u: Any, wall: float, out: Tables) -> None:
    """With q = (x, z): a ball of 1 kg with a thrust, over a floor."""
    out.mass[0, 0] = out.mass[1, 1] = 1.0
    out.force[0], out.force[1] = u[0], u[1] - 9.81
    out.gap[0] = q[1] - wall
    out.normal[0, 1] = 1.0


@inner
def two_discs(q: Any, v: Any, u: Any, wall: float, out: Tables) -> None:
    """With q = (x₁, y₁, x₂, y₂), a driven disc of 2 kg and one of 1 kg; d is both radii."""
    out.mass[0, 0] = out.mass[1, 1] = 2.0
    out.mass[2, 2] = out.mass[3, 3] = 1.0
    out.force[0], out.force[1] = u[0], u[1]
    square = speed = 0.0
    for i in range(2):
        apart = q[i + 2] - q[i]
        out.normal[0, i], out.normal[0, i + 2] = -apart / wall, apart / wall
        square, speed = square + apart**2, speed + (v[i + 2] - v[i]) ** 2
    out.gap[0], out.curve[0] = (square - wall**2) / (2.0 * wall), speed / wall


class Mechanism(NamedTuple):
    """A mechanism, its sizes, and what its model bounds."""

    write: Any  # compiled
    coordinates: int
    controls: int
    walls: int
    wall: float  # where they are [m]
    force: float = np.inf  # on each control, at most [N]
    hinges: tuple[int, ...] = ()
    least: tuple[float, ...] = ()  # of q
    most: tuple[float, ...] = ()

    @property
    def number(self) -> int:
        """By which compiled code knows the equations."""
        return _ORDER.index(self.write)


_ORDER = (cart_pole, pendulum, acrobot, paddle, three_carts, throwing_ball, two_discs)
_FREE = np.inf


def _cart_pole_between(wall: float, walls: int = 2) -> Mechanism:
    return Mechanism(
        cart_pole, 2, 1, walls, wall, 20.0, hinges=(1,), least=(-1.0, -_FREE), most=(1.0, _FREE)
    )


# Model → mechanism.
MECHANISMS: Mapping[str, Mechanism] = {
    "cart_pole_soft_06": _cart_pole_between(0.6),
    "cart_pole_soft_10": _cart_pole_between(1.0),
    "cart_pole_rigid_06": _cart_pole_between(0.6),
    "cart_pole_rigid_10": _cart_pole_between(1.0),
    "pendulum": Mechanism(pendulum, 1, 1, 1, 0.5, hinges=(0,)),
    "acrobot": Mechanism(acrobot, 2, 1, 0, _FREE, hinges=(0, 1)),
    "acrobot_and_wall": Mechanism(acrobot, 2, 1, 1, 1.2, hinges=(0, 1)),
    "paddle": Mechanism(paddle, 4, 2, 1, 0.0, hinges=(1,)),
    "three_carts": Mechanism(three_carts, 3, 1, 2, 2.0, 20.0),
    "throwing_ball": Mechanism(throwing_ball, 2, 2, 1, 0.0),
    "two_discs": Mechanism(two_discs, 4, 2, 1, 0.5, 20.0),
}


@inner
def write_tables(number: int, q: Any, v: Any, u: Any, wall: float, out: Tables) -> None:
    """Fills the tables of a mechanism by its number."""
    out.mass[:] = 0.0
    out.force[:] = 0.0
    out.gap[:] = 1.0
    out.normal[:] = 0.0
    out.curve[:] = 0.0
    if number == 0:
        cart_pole(q, v, u, wall, out)
    elif number == 1:
        pendulum(q, v, u, wall, out)
    elif number == 2:
        acrobot(q, v, u, wall, out)
    elif number == 3:
        paddle(q, v, u, wall, out)
    elif number == 4:
        three_carts(q, v, u, wall, out)
    elif number == 5:
        throwing_ball(q, v, u, wall, out)
    else:
        two_discs(q, v, u, wall, out)


def make_tables(mechanism: Mechanism) -> Tables:
    """Returns room for tables: of one wall at least, which is far where there is none."""
    n, m = mechanism.coordinates, max(1, mechanism.walls)
    return Tables(np.zeros((n, n)), np.zeros(n), np.ones(m), np.zeros((m, n)), np.zeros(m))
