"""Rotation vectors in compiled code: how they follow turns, and derivatives of both."""

from __future__ import annotations

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.kernels import borrowing

# Angles below which series replace closed forms that cancel; their next terms are below 1e-15.
_SMALL = 0.1


@borrowing
def find_turning(x: float, y: float, z: float, D: Floats) -> None:
    """Computes D, 3 × 3, by rows: exp(δ + dδ) = exp(D dδ) exp(δ), the left Jacobian.

    D = 1 + (1 − cos θ)/θ² [δ×] + (θ − sin θ)/θ³ [δ×]² with θ = ‖δ‖.
    """
    square = x * x + y * y + z * z
    if square < _SMALL * _SMALL:
        a = 0.5 - square / 24 * (1 - square / 30 * (1 - square / 56))
        b = 1 / 6 - square / 120 * (1 - square / 42 * (1 - square / 72))
    else:
        angle = np.sqrt(square)
        a, b = (1 - np.cos(angle)) / square, (angle - np.sin(angle)) / (square * angle)
    D[0], D[1], D[2] = 1 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y
    D[3], D[4], D[5] = b * x * y + a * z, 1 - b * (x * x + z * z), b * y * z - a * x
    D[6], D[7], D[8] = b * x * z - a * y, b * y * z + a * x, 1 - b * (x * x + y * y)


@borrowing
def find_rate(delta: Floats, turn: Floats, rate: Floats, by_delta: Floats, by_turn: Floats) -> None:
    """Computes δ̇ = D⁻¹ ω of a turn at ω, shape (3,), and its derivatives by δ and ω, by rows.

    D⁻¹ ω = ω − ½ δ × ω + c δ × (δ × ω),    c = (1 − θ/2 cot θ/2)/θ²
    """
    x, y, z = delta[0], delta[1], delta[2]
    square, along = x * x + y * y + z * z, x * turn[0] + y * turn[1] + z * turn[2]
    if square < _SMALL * _SMALL:
        c = 1 / 12 + square / 720 * (1 + square / 42 * (1 + square / 40))
        bend = 1 / 360 + square / 7560 * (1 + 0.0375 * square)
    else:
        angle = np.sqrt(square)
        cot = 1 / np.tan(angle / 2)
        c = (1 - angle / 2 * cot) / square
        bend = (-2 * c - cot / (2 * angle) + (1 + cot * cot) / 4) / square
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        across = delta[j] * turn[k] - delta[k] * turn[j]
        bent = delta[i] * along - turn[i] * square
        rate[i] = turn[i] - across / 2 + c * bent
        for m in range(3):
            by_turn[3 * i + m] = c * delta[i] * delta[m] + (1 - c * square if i == m else 0.0)
            by_delta[3 * i + m] = (
                c * (delta[i] * turn[m] - 2 * turn[i] * delta[m] + (along if i == m else 0.0))
                + bend * bent * delta[m]
            )
        by_turn[3 * i + j] += delta[k] / 2
        by_turn[3 * i + k] -= delta[j] / 2
        by_delta[3 * i + j] -= turn[k] / 2
        by_delta[3 * i + k] += turn[j] / 2
