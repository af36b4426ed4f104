"""The numbers of a scenario that a program's rows and costs read."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydrake.symbolic import MakeVectorVariable

from drake_aigto.arrays import Floats
from drake_aigto.world import Scenario


class Parameters(NamedTuple):
    """What a program reads of a scenario, but for its start: numbers, or symbols for them.

    Rows divide by none of these, so that programs are polynomials of the symbols.

    Attributes:
        goal: where q(T) should be, shape (nq,) [m].
        control_weight: w_u [1/(N² s)].
        goal_weight: w_f [1/m²].
        time_step: dt [s].
        rate: 1/dt [1/s].
        per_length: 1/L, of the length scale [1/m].
        restitutions: e of each contact, shape (m,).
    """

    goal: NDArray[Any]
    control_weight: Any
    goal_weight: Any
    time_step: Any
    rate: Any
    per_length: Any
    restitutions: NDArray[Any]

    @classmethod
    def of(cls, scenario: Scenario, length_scale: float, restitutions: Floats) -> Parameters:
        """Returns a scenario's numbers."""
        return cls(
            goal=scenario.goal_position,
            control_weight=scenario.control_weight,
            goal_weight=scenario.goal_weight,
            time_step=scenario.time_step,
            rate=1 / scenario.time_step,
            per_length=1 / length_scale,
            restitutions=restitutions,
        )

    @classmethod
    def symbols(cls, num_positions: int, num_contacts: int) -> Parameters:
        """Returns new symbols."""
        names = cls._fields[1:-1]
        found = MakeVectorVariable(num_positions + len(names) + num_contacts, "p")
        goal, scalars, returned = np.split(found, [num_positions, num_positions + len(names)])
        given = dict(zip(names, scalars.tolist(), strict=True))
        return cls(goal=goal, **given, restitutions=returned)

    def vector(self) -> NDArray[Any]:
        """Returns all of them, shape (nq + 5 + m,)."""
        return np.array([*self.goal, *self[1:-1], *self.restitutions])
