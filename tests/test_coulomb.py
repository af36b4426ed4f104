"""Impacts with friction against Routh's path integrated, exact fractions, and closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy

from drake_aigto.arrays import Floats
from drake_aigto.contact import Impulse, Mobility, Mode, calc_impulse


def draw(rng: np.random.Generator, size: int = 3) -> tuple[Mobility, Floats, Floats, Floats]:
    """Returns a mobility, and the mass matrix and rows J and T that it is of."""
    root = rng.normal(size=(size, size))
    mass_matrix = root @ root.T + 0.1 * np.eye(size)
    normal, tangent = rng.normal(size=(2, size))
    return Mobility.of(normal, tangent, mass_matrix), mass_matrix, normal, tangent


def test_energy_never_grows_and_impulses_stay_in_the_cone() -> None:
    rng = np.random.default_rng(1)
    slowed = 0
    for _ in range(2000):
        mobility, M, J, T = draw(rng)
        v, (e, mu) = rng.normal(size=3), rng.uniform(0.0, [1.0, 2.0])
        v = v if J @ v < 0 else -v
        p_n, p_t, mode = calc_impulse(mobility, float(J @ v), float(T @ v), e, mu)
        after = v + np.linalg.solve(M, J * p_n + T * p_t)
        size = v @ M @ v
        assert after @ M @ after <= size * (1 + 1e-12)
        assert abs(p_t) <= mu * p_n * (1 + 1e-12)
        assert -1e-12 <= J @ after <= -e * (J @ v) * (1 + 1e-9) + 1e-12
        slowed += bool(J @ after < -e * (J @ v) * (1 - 1e-9))
        assert (T @ after) * mode >= -1e-12
        assert mode or T @ after == pytest.approx(0.0, abs=1e-12)
    assert slowed  # Where Newton's rule alone would return more than was taken.


def integrate(mobility: Mobility, rate: float, slip: float, e: float, mu: float) -> Floats:
    """Returns p_n and p_t, of Routh's path integrated with a smooth sign of the slip velocity."""
    a, b, c = mobility
    smooth = 1e-7

    def slopes(_: float, y: Floats) -> list[float]:
        share = -mu * math.tanh(y[1] / smooth)
        return [a + b * share, b + c * share, share, y[0]]

    def compressed(_: float, y: Floats) -> float:
        return float(y[0])

    compressed.terminal, compressed.direction = True, 1.0  # type: ignore[attr-defined]
    options = {"method": "Radau", "rtol": 1e-9, "atol": 1e-11}
    far = (0.0, 1e4)
    half = scipy.integrate.solve_ivp(slopes, far, [rate, slip, 0, 0], events=compressed, **options)
    limit = (1 - e**2) * half.y[3, -1]

    def ended(_: float, y: Floats) -> float:
        return float(max(y[0] + e * rate, y[3] - limit))

    ended.terminal, ended.direction = True, 1.0  # type: ignore[attr-defined]
    start = half.y[:, -1]
    whole = scipy.integrate.solve_ivp(slopes, far, start, events=ended, **options)
    return np.array([half.t[-1] + whole.t[-1], whole.y[2, -1]])


def test_the_closed_form_is_the_integral_of_rouths_path() -> None:
    rng = np.random.default_rng(2)
    modes = set()
    for _ in range(12):
        mobility, _, _, _ = draw(rng, 2)
        rate, slip, e, mu = -rng.uniform(0.5, 2.0), rng.normal(), *rng.uniform(0.1, [0.9, 1.0])
        found = calc_impulse(mobility, rate, slip, e, mu)
        modes.add((found.mode, np.sign(slip) == found.mode))
        expected = integrate(mobility, rate, slip, e, mu)
        assert np.array(found[:2]) == pytest.approx(expected, rel=1e-5)
    assert len(modes) > 3  # Stick, slip that goes on, and slip that turns round.


@pytest.mark.parametrize("gyration", [2 / 5, 1 / 2])
@pytest.mark.parametrize("e", [0.0, 0.7, 1.0])
def test_a_round_ball_bounces_as_tables_of_spin_say(gyration: float, e: float) -> None:
    """Of a ball of unit mass and radius, with I = β: it grips where μ (1 + e) |v_n| ≥ |s| β/(1+β).

    Gripped, its spin and its speed along the wall end in rolling; else it loses μ (1 + e) |v_n|.
    """
    mobility = Mobility(1.0, 0.0, 1 + 1 / gyration)
    v_n, v_t, spin, mu = -2.0, 3.0, 1.5, 0.24
    s = v_t - spin
    p_n, p_t, mode = calc_impulse(mobility, v_n, s, e, mu)
    assert p_n == pytest.approx((1 + e) * 2.0)
    grip = abs(s) * gyration / (1 + gyration)
    assert p_t == pytest.approx(-min(grip, mu * p_n))
    assert (mode == Mode.STICK) == (grip <= mu * p_n)


def test_an_impact_whose_slip_turns_round_returns_no_more_work_than_was_taken() -> None:
    """Newton's rule alone would: all numbers are fractions but the root of the energy.

    a, b, c = 2, −1, 1, μ = 1/2, φ̇ = −1, s = 1/4, e = 1: slip lasts for p_n = 1/6, φ̇ rises by 5/2
    a unit; then it turns round, as |b| > μ c, with 3/2 a unit.
    """
    found = calc_impulse(Mobility(2.0, -1.0, 1.0), -1.0, 0.25, 1.0, 0.5)
    now = -1 + 5 / 2 / 6
    taken = now**2 / 3 + (1 - now) / 12
    assert found.mode == Mode.BACKWARD
    rest = (-now + min(1.0, math.sqrt(3 * taken))) / 1.5
    assert found == pytest.approx(Impulse(1 / 6 + rest, -1 / 12 + rest / 2, Mode.BACKWARD))
