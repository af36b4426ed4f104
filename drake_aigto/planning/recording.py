"""What a simulation of a held control saw: states, and contacts with walls."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


class Impact(NamedTuple):
    """A contact that throws the ball back."""

    time: float  # when the wall was touched [s]
    contact: int  # which of the world's contacts
    speed: float  # of approach, −φ̇ > 0 [m/s]
    push: float  # φ̈ without contact; negative is into the wall [m/s²]
    energy_before: float  # kinetic, ½ vᵀ M v, when the wall was touched [J]
    energy_after: float  # kinetic, when it was left [J]


class Rest(NamedTuple):
    """A contact that is pressed together so slowly that it stays, or nearly."""

    time: float  # when it began [s]
    contact: int  # which of the world's contacts


@dataclass
class Recording:
    """Filled while a simulation runs; the last row is its end.

    Attributes:
        times: never decreasing; equal before and after an impact that takes no time [s].
        positions: q for each time, shape (nq,) [m].
        velocities: v for each time, shape (nv,) [m/s].
        impacts: in order of time.
        rests: in order of time, on compliant walls.
        max_penetration: the deepest −φ, at least 0 [m].
        matched_speeds: for which dissipation was set, on compliant walls [m/s].
    """

    times: list[float] = field(default_factory=list)
    positions: list[npt.NDArray[np.float64]] = field(default_factory=list)
    velocities: list[npt.NDArray[np.float64]] = field(default_factory=list)
    impacts: list[Impact] = field(default_factory=list)
    rests: list[Rest] = field(default_factory=list)
    max_penetration: float = 0.0
    matched_speeds: list[float] = field(default_factory=list)

    def add(self, time: float, q: npt.NDArray[np.float64], v: npt.NDArray[np.float64]) -> None:
        """Appends a state."""
        self.times.append(time)
        self.positions.append(q)
        self.velocities.append(v)
