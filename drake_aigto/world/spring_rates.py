"""The equations of motion between walls that yield, compiled as one, for simulations."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeAlias

import numpy as np

from drake_aigto.arrays import Bools, Floats, read_only
from drake_aigto.world.law import NO_ROOM, CompliantLaw
from drake_aigto.world.world import World

# States (2n,), B u (n,) and which contacts are pressed (m,) → ẋ (2n,).
SpringRates: TypeAlias = Callable[[Floats, Floats, Bools], Floats]


def compile_springs(world: World, law: CompliantLaw) -> SpringRates:
    """Returns ẋ of a state x = (q, v) as one compiled function, see `calc_spring_rates`.

    It is that of `World.calc_acceleration` with what the law's springs push and rub with, which
    takes ten times as long, state by state.
    """
    from drake_aigto.world import spring_kernels  # Numba takes a second to load.

    dynamics, dry = world.dynamics_map.tables, world.dry_friction
    none = np.zeros(world.num_velocities)
    tables = spring_kernels.SpringTables(
        dynamics=dynamics,
        tangents=world.rubbing.soft_tangent_map.tables if law.rubs else dynamics,
        stiffness=law.stiffness,
        dissipation=law.dissipation,
        friction=law.friction,
        reaches=law.reaches,
        no_room=NO_ROOM,
        dry_friction=read_only(none if dry is None else dry),
        stiction_speed=world.stiction_speed,
    )
    return partial(spring_kernels.calc_spring_rates, tables=tables)
