"""Which contacts stick, slip or open: one way by Coulomb's law, or a refusal."""

from __future__ import annotations

import numpy as np
import pytest

from drake_aigto.arrays import Floats
from drake_aigto.contact import Mode, Touching, find_modes, list_modes
from drake_aigto.errors import FrictionError


def touch(
    rows: Floats, mass_matrix: Floats, rates: Floats, friction: list[float], slips: list[int]
) -> Touching:
    """Returns closed contacts of rows [J; T] at a mass matrix."""
    kicks = np.asarray(np.linalg.solve(mass_matrix, rows.T), dtype=float)
    return Touching(kicks, rows, rates, np.array(friction), slips)


def test_contacts_that_end_a_collapse_together_make_no_energy() -> None:
    """Some way always exists, and it obeys Coulomb's law."""
    rng = np.random.default_rng(5)
    for _ in range(60):
        n, k = int(rng.integers(2, 6)), int(rng.integers(1, 4))
        root, rows = rng.normal(size=(n, n)), rng.normal(size=(2 * k, n))
        M, v = root @ root.T + 0.2 * np.eye(n), rng.normal(size=n)
        friction = rng.uniform(0.0, 1.5, k)
        going = next(list_modes(touch(rows, M, rows @ v, friction.tolist(), [0] * k)))
        after = v + going.change
        normal, tangent = np.split(going.forces, 2)
        rates, slips = np.split(rows @ after, 2)
        assert after @ M @ after <= v @ M @ v * (1 + 1e-9)
        assert np.all(rates >= -1e-9)
        assert np.all(normal >= -1e-9)
        assert np.all(np.abs(tangent) <= friction * normal + 1e-9)
        assert normal @ rates == pytest.approx(0.0, abs=1e-8)
        assert tangent @ slips == pytest.approx(-(friction * normal) @ np.abs(slips), abs=1e-8)


# A rod that touches with its end: a = 1, b = −1, c = 2, so that slip backward at μ > 1 presses it
# down harder than it is pushed up.
ROD = np.array([[1.0, 0.0], [-1.0, 1.0]])


@pytest.mark.parametrize(
    ("push", "message"), [(-1.0, "got none of the ways"), (1.0, "several.*: backward or open")]
)
def test_what_painleve_found_is_refused(push: float, message: str) -> None:
    rates = np.array([push, 0.0])
    with pytest.raises(FrictionError, match=message):
        find_modes(touch(ROD, np.eye(2), rates, [1.5], [-1]))
    assert find_modes(touch(ROD, np.eye(2), rates, [0.5], [-1])).modes == (
        Mode.BACKWARD if push < 0 else Mode.OPEN,
    )


def test_feet_that_hold_each_other_up_without_need_stay_as_long_as_any_forces_hold_them() -> None:
    """A block on two feet, one of which carries next to nothing: the other holds it."""
    rows = np.array([[0.0, 1.0, -1.0], [0.0, 1.0, 1.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    for push, mode in ((0.49, Mode.STICK), (0.51, Mode.FORWARD)):
        rates = rows @ np.array([push, -1.0, 0.98])
        going = find_modes(touch(rows, np.eye(3), rates, [0.5, 0.5], [0, 0]))
        assert going.modes == (mode, mode)
