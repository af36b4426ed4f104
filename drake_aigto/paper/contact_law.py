"""A contact force that is a polynomial of the distance, in place of ε/(φ + δ)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from drake_aigto.errors import OptionsError
from drake_aigto.world import Scenario


@dataclass(frozen=True)
class PolynomialLaw:
    """λ(φ) = Σ_j c_j φ^j [N].

    Attributes:
        coefficients: c, the constant first [N/m^j].
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        """Checks."""
        if not self.coefficients or not all(map(math.isfinite, self.coefficients)):
            raise OptionsError(
                "coefficients", got=self.coefficients, expected="finite numbers, one at least"
            )

    @classmethod
    def fit(cls, scenario: Scenario, degree: int, reach: float) -> PolynomialLaw:
        """Returns ε/(φ + δ), interpolated at Chebyshev's points of 0 ≤ φ ≤ reach.

        How near that is to ε/(φ + δ) depends on δ alone: the error falls by ρ = 1 + 2r + 2√(r² + r)
        with each degree, r = δ/reach (`largest_error` measures it). At the paper's δ = 1 mm before
        a wall 1 m away that is 1.07: 36 degrees more for a tenth of the error. As sums of powers,
        rounding ends all gain before a degree of 30.

        Raises:
            OptionsError: a degree below 0, a reach that is not above 0, or δ = 0.
        """
        if degree < 0:
            raise OptionsError("degree", got=degree, expected="0 or more")
        if not 0 < reach < math.inf:
            raise OptionsError("reach", got=f"{reach:g} m", expected="a number above 0")
        if not scenario.delta > 0:
            raise OptionsError(
                "delta",
                got="0 m",
                expected="more than 0 m",
                remedy="ε/φ has no polynomial near it at the wall.",
            )
        law = Chebyshev.interpolate(_law_of(scenario), degree, domain=[0.0, reach])
        return cls(tuple(law.convert(kind=Polynomial).coef.tolist()))

    def __call__(self, distance: Any) -> Any:
        """Returns λ(φ) [N] for floats, arrays or Expressions [m]."""
        total = self.coefficients[-1]
        for coefficient in reversed(self.coefficients[:-1]):
            total = total * distance + coefficient
        return total

    def largest_error(self, scenario: Scenario, reach: float) -> float:
        """Returns the largest |λ(φ) − ε/(φ + δ)| over 0 ≤ φ ≤ reach, on a fine grid [N]."""
        # Denser towards both ends, where it is largest.
        grid = reach * np.sin(np.linspace(0.0, np.pi / 2, 2001)) ** 2
        return float(np.max(np.abs(self(grid) - _law_of(scenario)(grid))))


def _law_of(scenario: Scenario) -> Any:
    return lambda distance: scenario.epsilon / (distance + scenario.delta)
